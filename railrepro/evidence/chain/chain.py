"""The chain of notebooks: which are stale and why, how one runs, and where each product comes from.

notebooks/chain.toml says what each notebook writes; what it reads is noted while it runs (`railrepro.reads`). Staleness
is decided by content, never by time. Each notebook runs in a process of its own, with papermill and a temporary folder:
its products are put in place when all is well.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import field
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Annotated

from railrepro import code, data, numerics, paths, reads
from railrepro.data import InputError, Number, above, alone, between, write
from railrepro.evidence.chain.compare import Tolerance
from railrepro.evidence.report.sentences import false_in
from railrepro.evidence.runs import store
from railrepro.vehicle.parameters import load_vehicle

SUFFIXES = ("png", "csv")
Reads = dict[str, list[str]]
"""Files that a notebook read, and which of their entries; `reads.ALL` for a whole file."""
Inputs = dict[str, str]
"""What the products of a notebook depend on by its name, and the hash of each."""
EDITED = "an input was edited while it ran"
EXECUTED = "executed.ipynb"
_COLUMNS = ("path", "sha256", "made_by", "inputs_sha256", "seed")


@data.table
class Notebook:
    """One entry of the chain; see the head of notebooks/chain.toml."""

    name: str
    title: str
    after: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    parameters: dict[str, data.Free] = field(default_factory=dict)
    test_parameters: dict[str, data.Free] = field(default_factory=dict)
    minutes: Annotated[Number, above(0.0, 1e4, "min")] = 1.0
    seed: Annotated[int, between(0, 2**63)] | None = None

    @property
    def path(self) -> Path:
        """The notebook file."""
        return paths.NOTEBOOKS / f"{self.name}.ipynb"

    @property
    def executed(self) -> Path:
        """The executed notebook."""
        return paths.BUILD / "notebooks" / f"{self.name}.ipynb"

    @property
    def products(self) -> tuple[str, ...]:
        """All files that it writes, relative to the checkout."""
        return self.writes + tuple(f"figures/{figure}.{suffix}" for figure in self.figures for suffix in SUFFIXES)

    @property
    def reads(self) -> tuple[str, ...]:
        """What its last run here read below data/ and figures/."""
        return tuple((_stamped(self) or {"reads": ()})["reads"])

    @property
    def stamp(self) -> Path:
        """File with what its last successful run read, depended on and made."""
        return paths.BUILD / "stamps" / f"{self.name}.json"


@data.table
class _File:
    """Content of notebooks/chain.toml."""

    notebook: tuple[Notebook, ...] = ()
    verify: Tolerance = Tolerance()


def _file(file: Path | None) -> _File:
    file = file or paths.NOTEBOOKS / "chain.toml"
    return data.build(_File, data.read(file), file.name)


def tolerance() -> Tolerance:
    """Tolerances of a comparison of two runs."""
    return _file(None).verify


def chain(file: Path | None = None) -> dict[str, Notebook]:
    """Notebooks by name, in order; InputError for wrong entries, double products and a wrong order."""
    found: dict[str, Notebook] = {}
    maker: dict[str, str] = {}
    for one in _file(file).notebook:
        for other in one.after:
            if other not in found:
                raise InputError(f"chain.toml: {one.name} is after {other!r}, which is not above it")
        if one.name in found:
            raise InputError(f"chain.toml: {one.name} is there twice")
        for product in one.products:
            if product in maker:
                raise InputError(f"chain.toml: {product} is written by {maker[product]} and by {one.name}")
            maker[product] = one.name
        found[one.name] = one
    return found


def find(name: str) -> Notebook:
    """A notebook by name."""
    notebooks = chain()
    if name not in notebooks:
        raise InputError(f"notebook {name!r} is not in chain.toml; there are {list(notebooks)}")
    return notebooks[name]


def before(notebooks: dict[str, Notebook], names: Sequence[str]) -> set[str]:
    """Notebooks that must have run before some others."""
    first = {other for name in names for other in notebooks[name].after}
    return first | before(notebooks, list(first)) if first else first


def cells(notebook: Notebook) -> list[dict]:
    """Cells of a notebook file; InputError when it cannot be read."""
    try:
        found = json.loads(notebook.path.read_text(encoding="utf-8"))["cells"]
        return [cell | {"source": "".join(cell["source"]), "cell_type": cell["cell_type"]} for cell in found]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{notebook.path.name}: cannot be read as a notebook ({error!r})") from error


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _content(file: Path) -> bytes:
    return file.read_bytes() if file.is_file() else b"missing"


def inputs(notebook: Notebook, taken: Reads) -> Inputs:
    """All that the products of a notebook depend on as it is now, the same on all machines."""
    content = cells(notebook)
    found = {"its cells": _hash(json.dumps([cell["source"] for cell in content]).encode())}
    found["its parameters"] = _hash(json.dumps(notebook.parameters, sort_keys=True).encode())
    for file, entries in taken.items():
        found |= _parts(file, _content(paths.ROOT / file), entries)
    found |= {f"package {name}": version for name, version in code.packages().items()}
    reached = code.reached(*(cell["source"] for cell in content if cell["cell_type"] == "code"))
    return found | ({EDITED: ""} if reached is None else reached)


def _parts(file: str, content: bytes, entries: list[str]) -> Inputs:
    """Hashes of some entries of a TOML file by value, or of all and their order; of another file that of its bytes."""
    try:
        table = tomllib.loads(content.decode()) if file.endswith(".toml") else None
    except (ValueError, RecursionError):
        table = None
    if table is None:
        return {file: _hash(content)}
    found = {} if reads.ALL not in entries else {f"{file}, names of entries": _hash(repr(list(table)).encode())}
    names = table if reads.ALL in entries else entries
    return found | {f"{file} [{name}]": _hash(repr(table.get(name)).encode()) for name in names}


def _products(notebook: Notebook) -> dict[str, str]:
    return {product: _hash(_content(paths.ROOT / product)) for product in notebook.products}


def _stamped(notebook: Notebook) -> dict | None:
    """Stamp of the last successful run; None without a readable one."""
    try:
        known = json.loads(notebook.stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return known if isinstance(known, dict) and known.keys() == _PARTS else None


_PARTS = {"reads", "inputs", "machine", "products", "seconds"}


def why_stale(notebook: Notebook) -> str:
    """The input or product that is not that of the last successful run; "" when the notebook is fresh."""
    known = _stamped(notebook)
    if known is None:
        return "it has not run here"
    for now, last, words in (
        (store.machine(), known["machine"], ""),
        (inputs(notebook, known["reads"]), known["inputs"], ""),
        (_products(notebook), known["products"], " was changed or is missing"),
    ):
        changed = [name for name in {**now, **last} if now.get(name) != last.get(name)]
        if changed:
            return f"{changed[0]}{words}" + (f" and {len(changed) - 1} more" if len(changed) > 1 else "")
    return "" if code.unchanged() else EDITED


def minutes(notebook: Notebook) -> float:
    """How long its last run here took, else what chain.toml says (minutes)."""
    known = _stamped(notebook)
    return known["seconds"] / 60 if known else notebook.minutes


@contextmanager
def _environment(staging: Path) -> Iterator[None]:
    """Environment variables of a kernel, for a block: nothing of the user's own settings, products go to staging."""
    last = dict(os.environ)
    os.environ |= {f"JUPYTER_{k}_DIR": str(paths.BUILD / "jupyter" / k.lower()) for k in ("CONFIG", "DATA", "RUNTIME")}
    os.environ |= {"IPYTHONDIR": str(paths.BUILD / "ipython"), "MPLCONFIGDIR": str(paths.BUILD / "matplotlib")}
    os.environ |= {"JUPYTER_PATH": "", "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    os.environ |= {"PYTHONHASHSEED": "0", "PYDEVD_DISABLE_FILE_VALIDATION": "1"} | numerics.variables()
    os.environ[reads.LOG] = str(staging / "reads")
    os.environ |= {"RAILREPRO_OUTPUT": str(staging), "RAILREPRO_ROOT": str(paths.ROOT)}
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(last)


@contextmanager
def _kept_stderr() -> Iterator[None]:
    """Keep what a kernel and its workers write to stderr for the case that the kernel ends before its time.

    A kernel that is asked to stop may still write a traceback about its sockets.
    """
    sys.stderr.flush()
    with tempfile.TemporaryFile() as kept, os.fdopen(os.dup(2), "wb") as stderr:
        os.dup2(kept.fileno(), 2)
        try:
            yield
        except (RuntimeError, TimeoutError):
            kept.seek(0)
            stderr.write(kept.read())
            raise
        finally:
            os.dup2(stderr.fileno(), 2)


def _execute(notebook: Notebook, parameters: dict, staging: Path, keep_going: bool) -> str:
    """Run papermill into `staging`; what failed, or ""."""
    import papermill
    from traitlets.config import Config

    if unknown := parameters.keys() - papermill.inspect_notebook(str(notebook.path)).keys():
        return f"has no parameter {min(unknown)!r}"
    output = staging / EXECUTED
    options: dict = {"kernel_name": "python3", "cwd": str(paths.ROOT), "progress_bar": False}
    # a busy machine may let a kernel wait: without these nbclient gives up after 4 s and loses outputs
    options |= {"start_timeout": 300, "iopub_timeout": 300, "allow_errors": keep_going}
    # kernels side by side may be given one TCP port, so that sockets are files, where their names are not too long
    if len(str(staging)) < 90:
        options |= {"config": Config(AsyncKernelManager={"transport": "ipc", "ip": f"{staging}/k"})}
    try:
        with _environment(staging), _kept_stderr():
            papermill.execute_notebook(
                str(notebook.path), str(output), parameters, extra_arguments=["--log-level=50"], **options
            )
    except papermill.PapermillExecutionError as error:
        _deterministic(output)
        return f"cell {error.exec_count} failed with {error.ename}: {error.evalue}".splitlines()[0]
    except (RuntimeError, TimeoutError) as error:
        return f"the kernel did not start or ended before its time ({str(error).partition(chr(10))[0]})"
    for i, cell in enumerate(_deterministic(output)):
        if cell.cell_type == "code" and cell.source.strip() and cell.execution_count is None:
            return f"cell {i + 1} was not executed"
    return ""


def _deterministic(path: Path) -> list:
    """Remove from an executed notebook what differs between two equal runs; returns its cells."""
    import nbformat

    notebook = nbformat.read(path, 4)
    notebook.metadata.pop("papermill", None)
    for i, cell in enumerate(notebook.cells):
        for key in ("papermill", "execution"):
            cell.metadata.pop(key, None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell["id"] = f"injected-{i}"
        if cell.cell_type == "code":
            cell.outputs = [o for o in cell.outputs if o.get("name") != "stderr"]
    nbformat.write(notebook, path)
    return notebook.cells


def run(notebook: Notebook, parameters: dict, root: Path, executed: Path, keep_going: bool = False) -> Reads:
    """Execute a notebook and move its products below `root`.

    Parameters
    ----------
    notebook : Notebook
    parameters : dict
        Values for its parameters cell.
    root : Path
        Products land in root/data and root/figures; TOML files of one's own in root/data and products of notebooks
        before this one are read there, where they are.
    executed : Path
        Folder of the executed notebook; a failed one is kept there as NAME.failed.ipynb.
    keep_going : bool
        A failing cell does not stop the rest; the products that there are land below `root` before the error is raised.

    Returns
    -------
    dict
        What it read below data/ and figures/.

    Raises
    ------
    InputError
        One line: unknown parameter, failing cell, cell not executed, product that is missing or was read too early, no
        write permission.
    """
    notebooks = chain() | {notebook.name: notebook}
    first = before(notebooks, [notebook.name])
    with tempfile.TemporaryDirectory(prefix="railrepro-") as folder:
        staging = Path(folder)
        own = [str(file.relative_to(root)) for file in (root / "data").glob("*.toml")]
        for file in [*own, *(product for name in first for product in notebooks[name].products)]:
            if root != paths.ROOT and (root / file).exists():
                (staging / file).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / file, staging / file)
        failure, output = _execute(notebook, parameters, staging, keep_going), staging / EXECUTED
        taken = _taken(staging / "reads", notebook)
        if not failure and (false := false_sentences(output)) and _is_committed(notebook, parameters, taken, root):
            failure = f"{_counted(false)} with the committed values: {' | '.join(false)}"
        made = {product: staging / product for product in notebook.products if (staging / product).exists()}
        missing = [product for product in notebook.products if product not in made]
        failure = failure or (f"did not write {missing[0]}, which chain.toml declares" if missing else "")
        for other in notebooks.values():
            early = set(other.products) & set(taken) if other.name not in first else set()
            if early and not failure:
                failure = f"reads {min(early)} of {other.name}, which chain.toml does not name in `after`"
        kept = executed / f"{notebook.name}.failed.ipynb"
        kept.unlink(missing_ok=True)
        if output.exists():
            write(kept if failure else executed / f"{notebook.name}.ipynb", output.read_bytes())
            failure += f" (kept {_short(kept)})" if failure else ""
        for product, temporary in made.items() if keep_going or not failure else ():
            write(root / product, temporary.read_bytes())
    if failure:
        raise InputError(f"{notebook.name}: {failure}")
    return taken


def false_sentences(executed: Path) -> list[str]:
    """False sentences of an executed notebook; none where there is no such file."""
    return false_in(json.loads(executed.read_text(encoding="utf-8"))["cells"]) if executed.is_file() else []


def _counted(false: list[str]) -> str:
    return "1 sentence does not hold" if len(false) == 1 else f"{len(false)} sentences do not hold"


def _is_committed(notebook: Notebook, parameters: dict, taken: Reads, root: Path) -> bool:
    """Whether its parameters and what it reads, but for products of the chain, are those of the last commit.

    A file of one's own below `root` counts as changed, and all do where no Git answers.
    """

    def git(*arguments: str) -> subprocess.CompletedProcess:
        return subprocess.run(["git", "-C", str(paths.ROOT), *arguments], capture_output=True, text=True)

    given = set(taken) - {product for one in chain().values() for product in one.products}
    if root != paths.ROOT and any((root / file).exists() for file in given):
        return False
    if parameters != notebook.parameters or (given and git("status", "--porcelain", "--", *sorted(given)).stdout):
        return False
    committed = git("show", f"HEAD:{paths.NOTEBOOKS.name}/{notebook.path.name}").stdout
    return bool(committed) and _values(json.loads(committed)["cells"]) == _values(cells(notebook))


def _values(content: list[dict]) -> list[str]:
    """Sources of the cells that hold the parameters of a notebook."""
    return ["".join(cell["source"]) for cell in content if "parameters" in cell.get("metadata", {}).get("tags", [])]


def _short(path: Path) -> str:
    return str(path.relative_to(paths.ROOT)) if path.is_relative_to(paths.ROOT) else str(path)


def _taken(log: Path, notebook: Notebook) -> Reads:
    """What a run noted (`railrepro.reads`), but for the products of the notebook itself."""
    found: dict[str, set[str]] = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        file, _, entry = line.partition("\t")
        found.setdefault(file, set()).add(entry)
    known = {file: sorted(entries - {""}) or [reads.ALL] for file, entries in sorted(found.items())}
    return {file: entries for file, entries in known.items() if file not in notebook.products}


def refresh(name: str) -> None:
    """Run a notebook if it is stale, and stamp it: as stale where an input was edited meanwhile."""
    notebook = find(name)
    if not why_stale(notebook):
        return
    begin, own = time.time(), inputs(notebook, {})
    taken = run(notebook, notebook.parameters, paths.ROOT, paths.BUILD / "notebooks")
    found = inputs(find(name), taken)
    files = [paths.ROOT / file for file in taken]
    edited = any(file.is_file() and file.stat().st_mtime > begin for file in files) or not own.items() <= found.items()
    found |= {EDITED: ""} if edited or not code.unchanged() else {}
    stamp = {"reads": taken, "inputs": found, "machine": store.machine(), "products": _products(notebook)}
    write(notebook.stamp, json.dumps(stamp | {"seconds": time.time() - begin}, indent=1))


def figures(names: Sequence[str] = (), jobs: int = 0) -> int:
    """Run what is stale of some notebooks and of those before them, several at a time.

    Parameters
    ----------
    names : sequence of str
        Names of notebooks or figures, or how these begin, as "fig06"; empty takes all.
    jobs : int
        How many at a time; 0 takes one per processor, at most four.

    Returns
    -------
    int
        1 when one of them failed, else 0.
    """
    notebooks = chain()
    wanted = set() if names else set(notebooks)
    for name in names:
        found = {n.name for n in notebooks.values() if any(one.startswith(name) for one in (n.name, *n.figures))}
        if not found:
            raise InputError(f"no notebook or figure of chain.toml begins with {name!r}")
        wanted |= found | before(notebooks, list(found))
    paths.BUILD.mkdir(exist_ok=True)
    with alone(paths.BUILD / "chain.lock"):
        fresh: set[str] = set()
        try:
            return _run_stale([n for n in notebooks.values() if n.name in wanted], jobs, fresh)
        finally:
            _write_manifests(notebooks, fresh)
            for name in sorted(wanted):
                if false := false_sentences(notebooks[name].executed):
                    _say(f"{name}: {_counted(false)} with these values")


def drive(vehicle: Path) -> int:
    """Run the chapters 00 to 09 with a car of one's own, in build/tried/NAME; what is committed stays as it is.

    Parameters
    ----------
    vehicle : Path
        File like data/vehicle.toml.

    Returns
    -------
    int
        1 when a chapter was stopped, else 0; the sentences that do not hold on this car are printed.
    """
    load_vehicle(vehicle)
    root = paths.BUILD / "tried" / vehicle.stem
    write(root / "data/vehicle.toml", vehicle.read_bytes())
    names = [name for name in chain() if name < "10"]
    failed = rerun(names, root)
    for name in names:
        for sentence in false_sentences(root / "notebooks" / f"{name}.ipynb"):
            _say(f"{name}: does not hold on this car: {sentence}")
    _say(f"figures and executed chapters are in {_short(root)}")
    return int(bool(failed))


def rerun(names: Sequence[str], root: Path) -> list[str]:
    """Run notebooks below another folder, all of them whatever fails; returns a line for each that failed."""
    failed = []
    for notebook in map(find, names):
        _say(f"{notebook.name}: running, about {minutes(notebook):.1f} min")
        try:
            run(notebook, notebook.parameters, root, root / "notebooks", keep_going=True)
        except InputError as error:
            _say(str(error))
            failed.append(str(error))
    return failed


def _run_stale(wanted: list[Notebook], jobs: int, fresh: set[str]) -> int:
    """Run what is stale of some notebooks, and enter into `fresh` which of them need no run any more."""
    stale = {notebook.name: why for notebook in wanted if (why := why_stale(notebook))}
    left: dict[str, float] = {}  # a product of a stale one may make those after it stale, which are asked again then
    for notebook in wanted:
        if notebook.name in stale or set(notebook.after) & set(left):
            left[notebook.name] = minutes(notebook)
    fresh |= {notebook.name for notebook in wanted} - set(left)
    if not left:
        _say(f"nothing is stale of {len(wanted)} notebooks")
        return 0
    jobs = min(jobs or min(os.cpu_count() or 1, 4), len(left))
    _say(f"{len(stale)} of {len(wanted)} notebooks are stale, {_duration(left, jobs)}")
    for name, why in stale.items():
        _say(f"{name} is stale: {why}")
    graph = TopologicalSorter({n.name: set(n.after) & set(left) for n in wanted if n.name in left})
    graph.prepare()
    ready: list[str] = []
    running: dict[str, subprocess.Popen] = {}
    failed = False
    try:
        while graph.is_active() and not (failed and not running):
            ready = sorted([*ready, *graph.get_ready()], key=lambda name: -left[name])
            while ready and len(running) < jobs and not failed:
                name = ready.pop(0)
                running[name] = _start(name, jobs)
                _say(f"{name}: running, about {left[name]:.1f} min")
            time.sleep(0.05)
            for name in [name for name, process in running.items() if process.poll() is not None]:
                del left[name]
                if running.pop(name).returncode:
                    failed = True  # it has said why; those that run go on, no other one starts
                    continue
                graph.done(name)
                fresh.add(name)
                _say(f"{name}: done; {len(left)} left" + (f", {_duration(left, jobs)}" if left else ""))
    finally:
        for process in running.values():  # they were interrupted as this one was, and look after themselves
            with suppress(subprocess.TimeoutExpired):
                process.wait(5.0)
    return int(failed)


def _start(name: str, jobs: int) -> subprocess.Popen:
    """A process for a notebook, with the code as it is now; it ends with this one."""
    workers = os.environ.get("RAILREPRO_WORKERS") or str(max(1, (os.cpu_count() or 1) // jobs))
    own = {"RAILREPRO_WORKERS": workers, "RAILREPRO_ROOT": str(paths.ROOT), "RAILREPRO_LEADER": str(os.getpid())}
    return subprocess.Popen([sys.executable, "-m", "railrepro", "chain", "one", name], env=os.environ | own)


def _duration(left: dict[str, float], jobs: int) -> str:
    return f"about {max(1, round(max(max(left.values()), sum(left.values()) / jobs)))} min"


def _say(words: str) -> None:
    print(words, file=sys.stderr, flush=True)


def _write_manifests(notebooks: dict[str, Notebook], fresh: set[str]) -> None:
    """Enter the products of fresh notebooks into data/MANIFEST.csv and figures/MANIFEST.csv; other rows stay."""
    maker = {product: notebook.name for notebook in notebooks.values() for product in notebook.products}
    made: dict[str, list[str]] = {}
    for notebook in [notebooks[name] for name in fresh]:
        known = _stamped(notebook)
        if known is None or EDITED in known["inputs"]:
            continue
        digest = _hash(json.dumps(known["inputs"], sort_keys=True).encode())
        seed = "" if notebook.seed is None else str(notebook.seed)
        made |= {path: [path, content, notebook.name, digest, seed] for path, content in known["products"].items()}
    for folder in ("data", "figures"):
        file = paths.ROOT / folder / "MANIFEST.csv"
        lines = file.read_text(encoding="utf-8").splitlines()[1:] if file.is_file() else []
        rows = {row[0]: row for row in (line.split(",") for line in lines) if maker.get(row[0]) == row[2]}
        rows |= {path: row for path, row in made.items() if path.startswith(f"{folder}/")}
        text = "\n".join([",".join(_COLUMNS), *(",".join(rows[path]) for path in sorted(rows))]) + "\n"
        if rows and _content(file) != text.encode():
            write(file, text)
