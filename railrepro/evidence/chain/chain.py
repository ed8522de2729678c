"""The chain of notebooks: which are stale and why, how they run, and where each product (written file) comes from.

notebooks/chain.toml says what each notebook writes; what it reads is noted while it runs (`railrepro.paths`). Staleness
is decided by content, never by time. No notebook reads what another one writes, so they run in any order. Each has a
kernel of its own and a temporary folder; its products are moved from there after a successful run.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import psutil

from railrepro import code, data, numerics, paths
from railrepro.data import InputError, Number, above, alone, between, write
from railrepro.evidence.chain import compare
from railrepro.evidence.report.sentences import false_in
from railrepro.evidence.runs import store
from railrepro.vehicle.parameters import load_vehicle

SUFFIXES = ("png", "csv")
Reads = dict[str, list[str]]
"""Path of a file that a notebook read -> names of the entries that it took; [`paths.ALL`] for all."""
Inputs = dict[str, str]
"""Name of an input on which the products of a notebook depend -> its hash or version."""
EDITED = "an input was edited while it ran"
_ENDING = threading.Event()
"""Set when the chain is interrupted, so that no thread starts another kernel."""
_COLUMNS = ("path", "sha256", "made_by", "inputs_sha256", "seed")


@data.table
class Notebook:
    """Notebook of the chain, an entry of notebooks/chain.toml: file name without ending, title, and what it writes.

    `writes` are paths of tables, `figures` names figNN_name; `parameters` and `test_parameters` are values for its
    parameters cell in the real run and in tests; `minutes` is its run time (min), `seed` the random seed that it uses.
    """

    name: str
    title: str
    writes: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    parameters: dict[str, data.Free] = field(default_factory=dict)
    test_parameters: dict[str, data.Free] = field(default_factory=dict)
    minutes: Annotated[Number, above(0.0, 1e4, "min")] = 1.0
    seed: Annotated[int, between(0, 2**63)] | None = None

    @property
    def path(self) -> Path:
        """Path of the notebook file."""
        return paths.NOTEBOOKS / f"{self.name}.ipynb"

    @property
    def executed(self) -> Path:
        """Path of the notebook as last executed, with outputs (in build/notebooks)."""
        return paths.BUILD / "notebooks" / f"{self.name}.ipynb"

    @property
    def products(self) -> tuple[str, ...]:
        """Paths of all files that the notebook writes, relative to the checkout; a figure is a png and a csv."""
        return self.writes + tuple(f"figures/{figure}.{suffix}" for figure in self.figures for suffix in SUFFIXES)

    @property
    def stamp(self) -> Path:
        """Path of the record of the notebook's last successful run, a `Stamp` as JSON."""
        return paths.BUILD / "stamps" / f"{self.name}.json"


@data.table
class Stamp:
    """Record of the last successful run of a notebook in this checkout.

    Files that it read (`Reads`), its `inputs`, machine (`store.machine`), product -> SHA-256, and run time (s).
    """

    reads: Reads
    inputs: Inputs
    machine: dict[str, str]
    products: dict[str, str]
    seconds: float


@data.table
class _File:
    """Content of notebooks/chain.toml."""

    notebook: tuple[Notebook, ...] = ()
    verify: compare.Tolerance = compare.Tolerance()


def _file(file: Path | None = None) -> _File:
    file = file or paths.NOTEBOOKS / "chain.toml"
    return data.build(_File, data.read(file), file.name)


def tolerance() -> compare.Tolerance:
    """Tolerances with which `verify` compares products, from notebooks/chain.toml."""
    return _file().verify


def chain(file: Path | None = None) -> dict[str, Notebook]:
    """Read chain.toml (`file`): name -> notebook, in order; InputError for wrong entries or a file written by two."""
    found: dict[str, Notebook] = {}
    maker: dict[str, str] = {}
    for one in _file(file).notebook:
        for written in (f"{one.name}.ipynb", *one.products):
            if written in maker:
                raise InputError(f"chain.toml: {written} is written by {maker[written]} and by {one.name}")
            maker[written] = one.name
        found[one.name] = one
    return found


def _makers(notebooks: dict[str, Notebook]) -> dict[str, str]:
    """Name of the notebook that writes each product."""
    return {product: notebook.name for notebook in notebooks.values() for product in notebook.products}


def cells(notebook: Notebook) -> list[dict]:
    """Cells of a notebook file as in its JSON, sources as single strings; InputError when it cannot be read."""
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
    """Name -> present hash or version of each input of a notebook except the machine (`store.machine`).

    Inputs are its cells, its parameters, the files and entries of `taken` (as `run` returns them), packages, and the
    modules of railrepro that it can import.
    """
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
    found = {} if paths.ALL not in entries else {f"{file}, names of entries": _hash(repr(list(table)).encode())}
    names = table if paths.ALL in entries else entries
    return found | {f"{file} [{name}]": _hash(repr(table.get(name)).encode()) for name in names}


def _products(notebook: Notebook) -> dict[str, str]:
    return {product: _hash(_content(paths.ROOT / product)) for product in notebook.products}


def last_run(notebook: Notebook) -> Stamp | None:
    """Record of the last successful run of a notebook in this checkout; None without a readable one."""
    try:
        return data.build(Stamp, data.read(notebook.stamp), notebook.stamp.name)
    except InputError:
        return None


def why_stale(notebook: Notebook) -> str:
    """Why a notebook is stale, in words: the first input or product that changed since its last run; "" if fresh."""
    last = last_run(notebook)
    if last is None:
        return "it has not run here"
    for now, before, words in (
        (store.machine(), last.machine, ""),
        (inputs(notebook, last.reads), last.inputs, ""),
        (_products(notebook), last.products, " was changed or is missing"),
    ):
        changed = [name for name in {**now, **before} if now.get(name) != before.get(name)]
        if changed:
            return f"{changed[0]}{words}" + (f" and {len(changed) - 1} more" if len(changed) > 1 else "")
    return "" if code.unchanged() else EDITED


def _environment(staging: Path) -> dict[str, str]:
    """Environment of a kernel: nothing of the user's own settings, products go to staging."""
    own = {"IPYTHONDIR": str(paths.BUILD / "ipython"), "MPLCONFIGDIR": str(paths.BUILD / "matplotlib")}
    own |= {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    own |= {"PYTHONHASHSEED": "0", "PYDEVD_DISABLE_FILE_VALIDATION": "1"} | numerics.variables()
    own |= {paths.READS: str(staging / "reads"), "RAILREPRO_OUTPUT": str(staging), "RAILREPRO_ROOT": str(paths.ROOT)}
    return os.environ | own


def _kernel(staging: Path, started: dict) -> type:
    """A kernel of this Python for papermill, started with an environment, a folder and a stderr of its own."""
    from jupyter_client import AsyncKernelManager
    from jupyter_client.kernelspec import KernelSpecManager

    own = {"connection_file": str(staging / "kernel.json"), "kernel_spec_manager": KernelSpecManager(kernel_dirs=[])}
    # kernels side by side may be given one TCP port, so that sockets are files, where their names are not too long
    if len(str(staging)) < 90:
        own |= {"transport": "ipc", "ip": str(staging / "k")}

    class Kernel(AsyncKernelManager):
        def __init__(self, **options):
            super().__init__(**options | own)

        def start_kernel(self, **options):
            if _ENDING.is_set():
                raise RuntimeError("the chain was interrupted")
            return super().start_kernel(**options, **started)

    return Kernel


def _execute(notebook: Notebook, parameters: dict, staging: Path, keep_going: bool) -> tuple[Any, str]:
    """Run a notebook with papermill; its content, and what failed or ""."""
    import nbformat
    import papermill

    if unknown := parameters.keys() - papermill.inspect_notebook(str(notebook.path)).keys():
        return None, f"has no parameter {min(unknown)!r}"
    logging.getLogger("papermill").setLevel(logging.CRITICAL)  # what fails is said in one sentence
    output, failure = staging / "executed.ipynb", ""
    with tempfile.TemporaryFile() as beside:  # what it writes beside its cells, as a traceback while it is stopped
        kernel = _kernel(staging, {"env": _environment(staging), "cwd": str(paths.ROOT), "stderr": beside})
        try:
            # a busy machine may let a kernel wait: without these nbclient gives up after 4 s and loses outputs
            papermill.execute_notebook(
                notebook.path, output, parameters, kernel_name="python3", kernel_manager_class=kernel,
                progress_bar=False, start_timeout=300, iopub_timeout=300, allow_errors=keep_going,
                extra_arguments=["--log-level=50"],
            )  # fmt: skip
        except papermill.PapermillExecutionError as error:
            failure = f"cell {error.exec_count} failed with {error.ename}: {error.evalue}".splitlines()[0]
        except (RuntimeError, TimeoutError) as error:
            failure = f"the kernel did not start or ended before its time ({str(error).partition(chr(10))[0]})"
            beside.seek(0)
            print(beside.read().decode(errors="replace"), end="", file=sys.stderr, flush=True)
    if not output.exists():
        return None, failure
    content = nbformat.read(output, 4)
    _make_deterministic(content)
    for i, cell in enumerate(content.cells, 1):
        if not failure and cell.cell_type == "code" and cell.source.strip() and cell.execution_count is None:
            failure = f"cell {i} was not executed"  # after sys.exit(0) in another one
    return content, failure


def _make_deterministic(content: Any) -> None:
    """Remove from an executed notebook what differs between two equal runs."""
    content.metadata.pop("papermill", None)
    for i, cell in enumerate(content.cells):
        for key in ("papermill", "execution"):
            cell.metadata.pop(key, None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell["id"] = f"injected-{i}"
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]


def run(notebook: Notebook, parameters: dict, root: Path, executed: Path, keep_going: bool = False) -> Reads:
    """Execute a notebook and move its products below `root`; returns as `Reads` what of data/ and figures/ it read.

    InputError when the notebook lacks a name of `parameters`, a cell fails, a product was not written, or a product of
    another notebook was read; and when notebook, parameters and inputs are as committed, yet a sentence that it prints
    (`report.sentences`) is false. With changed inputs a false sentence is no error.

    Parameters
    ----------
    notebook : Notebook
    parameters : dict
        Values for its parameters cell, by name.
    root : Path
        Products are written to root/data and root/figures; TOML files in root/data are read in place of those of data/.
    executed : Path
        Folder for the executed notebook; a failed one is kept there as NAME.failed.ipynb.
    keep_going : bool
        Continue after a failing cell, and write the products that there are before the error is raised.
    """
    import nbformat

    maker = _makers(chain())
    with tempfile.TemporaryDirectory(prefix="railrepro-") as folder:
        staging = Path(folder)
        if root != paths.ROOT:
            (staging / "data").mkdir()
            for file in (root / "data").glob("*.toml"):
                shutil.copy2(file, staging / "data")
        content, failure = _execute(notebook, parameters, staging, keep_going)
        taken = _taken(staging / "reads", notebook)
        made = {product: staging / product for product in notebook.products if (staging / product).exists()}
        missing = [product for product in notebook.products if product not in made]
        others = sorted(set(taken) & set(maker))
        false = false_in(content.cells) if content and not failure else []
        if false and _is_committed(notebook, parameters, set(taken), root):
            failure = f"{_counted(false)} with the committed values: {' | '.join(false)}"
        elif missing and not failure:
            failure = f"did not write {missing[0]}, which chain.toml declares"
        elif others and not failure:
            failure = f"reads {others[0]}, which {maker[others[0]]} writes: notebooks do not wait for each other"
        kept = executed / f"{notebook.name}.failed.ipynb"
        kept.unlink(missing_ok=True)
        if content:
            write(kept if failure else executed / f"{notebook.name}.ipynb", nbformat.writes(content) + "\n")
            failure += f" (kept {_short(kept)})" if failure else ""
        for product, temporary in made.items() if keep_going or not failure else ():
            write(root / product, temporary.read_bytes())
    if failure:
        raise InputError(f"{notebook.name}: {failure}")
    return taken


def false_sentences(executed: Path) -> list[str]:
    """Texts of the false sentences (`report.sentences`) in the executed notebook at a path; empty without the file."""
    return false_in(json.loads(executed.read_text(encoding="utf-8"))["cells"]) if executed.is_file() else []


def _counted(false: list[str]) -> str:
    return "1 sentence does not hold" if len(false) == 1 else f"{len(false)} sentences do not hold"


def _is_committed(notebook: Notebook, parameters: dict, given: set[str], root: Path) -> bool:
    """Whether a notebook, its parameters and the inputs that it reads are those of the last commit.

    A file of one's own below `root` counts as changed, and all do where no Git answers.
    """
    if parameters != notebook.parameters or (root != paths.ROOT and any((root / file).exists() for file in given)):
        return False
    command = ["git", "-C", str(paths.ROOT), "status", "--porcelain", "--", str(notebook.path), *sorted(given)]
    done = subprocess.run(command, capture_output=True)
    return done.returncode == 0 and not done.stdout


def _short(file: Path) -> str:
    """A path below the checkout from there on."""
    return str(file.relative_to(paths.ROOT)) if file.is_relative_to(paths.ROOT) else str(file)


def _taken(log: Path, notebook: Notebook) -> Reads:
    """What a run read, from the log of its processes, but for the products of the notebook itself."""
    found: dict[str, set[str]] = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        file, _, entry = line.partition("\t")
        found.setdefault(file, set()).add(entry)
    known = {file: sorted(entries - {""}) or [paths.ALL] for file, entries in sorted(found.items())}
    return {file: entries for file, entries in known.items() if file not in notebook.products}


def refresh(notebook: Notebook) -> None:
    """Run a notebook (errors as `run`) and write its `Stamp`; if an input was edited meanwhile it stays stale."""
    begin, own = time.time(), inputs(notebook, {})
    taken = run(notebook, notebook.parameters, paths.ROOT, paths.BUILD / "notebooks")
    found = inputs(chain()[notebook.name], taken)
    files = [paths.ROOT / file for file in taken]
    edited = any(file.is_file() and file.stat().st_mtime > begin for file in files) or not own.items() <= found.items()
    found |= {EDITED: ""} if edited or not code.unchanged() else {}
    stamp = {"reads": taken, "inputs": found, "machine": store.machine(), "products": _products(notebook)}
    write(notebook.stamp, json.dumps(stamp | {"seconds": time.time() - begin}, indent=1))


def figures(names: Sequence[str] = (), jobs: int | None = None) -> int:
    """Run the stale ones of some notebooks, `jobs` at a time (default one per processor, at most four).

    `names` are names of notebooks or figures, or their beginnings, as "fig06" (InputError if none fits); empty takes
    all. Returns 1 when a notebook failed, else 0.
    """
    notebooks = chain()
    wanted = set() if names else set(notebooks)
    for name in names:
        found = {n.name for n in notebooks.values() if any(one.startswith(name) for one in (n.name, *n.figures))}
        if not found:
            raise InputError(f"no notebook or figure of chain.toml begins with {name!r}")
        wanted |= found
    paths.BUILD.mkdir(exist_ok=True)
    with alone(paths.BUILD / "chain.lock"):
        stale = {name: why for name in sorted(wanted) if (why := why_stale(notebooks[name]))}
        _say(f"{len(stale)} of {len(wanted)} notebooks are stale")
        for name, why in stale.items():
            _say(f"{name} is stale: {why}")
        fresh = wanted - stale.keys()

        def renew(notebook: Notebook) -> None:
            refresh(notebook)
            fresh.add(notebook.name)

        try:
            failed = _run_all([notebooks[name] for name in stale], renew, jobs)
        finally:
            _write_manifests(notebooks, fresh)
    for name in sorted(wanted):
        for sentence in false_sentences(notebooks[name].executed):
            _say(f"{name}: does not hold with these values: {sentence}")
    return int(bool(failed))


def _run_all(notebooks: Sequence[Notebook], task: Callable[[Notebook], object], jobs: int | None = None) -> list[str]:
    """Call `task` with notebooks, side by side; returns a line for each that failed.

    It says which run, how many are left and for about how long (minutes): as long as the last run here, else what
    chain.toml says. One that fails does not stop the others.
    """
    known = [(notebook, last_run(notebook)) for notebook in notebooks]
    left = {notebook.name: last.seconds / 60 if last else notebook.minutes for notebook, last in known}
    processors = os.cpu_count() or 1
    jobs = min(jobs or min(processors, 4), max(1, len(left)))
    os.environ.setdefault("RAILREPRO_WORKERS", str(max(1, processors // jobs)))  # of the studies of each
    failed: list[str] = []

    def one(notebook: Notebook) -> None:
        _say(f"{notebook.name}: running, about {left[notebook.name]:.1f} min")
        task(notebook)

    pool = ThreadPoolExecutor(jobs)
    _ENDING.clear()
    longest_first = sorted(notebooks, key=lambda notebook: -left[notebook.name])
    futures = {pool.submit(one, notebook): notebook.name for notebook in longest_first}
    try:
        for future in as_completed(futures):
            name = futures[future]
            del left[name]
            try:
                future.result()
            except Exception as error:  # whatever it is, the other notebooks go on
                failed.append(str(error) if isinstance(error, InputError) else f"{name}: {error!r}")
                _say(f"error: {failed[-1]}")
                continue
            rest = max([0.0, *left.values(), sum(left.values()) / jobs])
            _say(f"{name}: done; {len(left)} left" + (f", about {max(1, round(rest))} min" if left else ""))
    except BaseException:
        _ENDING.set()
        pool.shutdown(wait=False, cancel_futures=True)
        while not all(future.done() for future in futures):  # kernels would go on, and one may be about to start
            for process in psutil.Process().children(recursive=True):
                with suppress(psutil.Error):
                    process.kill()
            time.sleep(0.1)
        raise
    return failed


def _say(words: str) -> None:
    print(words + "\n", end="", file=sys.stderr, flush=True)  # at once: several notebooks speak


def _write_manifests(notebooks: dict[str, Notebook], names: set[str]) -> None:
    """Enter the products of some fresh notebooks into data/MANIFEST.csv and figures/MANIFEST.csv; other rows stay."""
    maker = _makers(notebooks)
    made: dict[str, list[str]] = {}
    for notebook in [notebooks[name] for name in names]:
        last = last_run(notebook)
        if last is None or EDITED in last.inputs:
            continue
        digest = _hash(json.dumps(last.inputs, sort_keys=True).encode())
        seed = "" if notebook.seed is None else str(notebook.seed)
        made |= {path: [path, content, notebook.name, digest, seed] for path, content in last.products.items()}
    for folder in ("data", "figures"):
        file = paths.ROOT / folder / "MANIFEST.csv"
        lines = file.read_text(encoding="utf-8").splitlines()[1:] if file.is_file() else []
        rows = {row[0]: row for row in (line.split(",") for line in lines) if maker.get(row[0]) == row[2]}
        rows |= {path: row for path, row in made.items() if path.startswith(f"{folder}/")}
        if rows:
            write(file, "\n".join([",".join(_COLUMNS), *(",".join(rows[path]) for path in sorted(rows))]) + "\n")


def drive(vehicle: Path) -> int:
    """Run the notebooks 00 to 09 with the car of a file like data/vehicle.toml; results are in build/tried/NAME.

    Committed files stay as they are. Prints the sentences that do not hold on this car; returns 1 when a notebook
    failed, else 0.
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
    """Run notebooks by name, also past failing cells, with products below `root`; returns a message per failed one."""

    def again(notebook: Notebook) -> None:
        run(notebook, notebook.parameters, root, root / "notebooks", keep_going=True)

    return _run_all([chain()[name] for name in names], again)


def verify() -> int:
    """Run all notebooks with products in build/verify and print how these differ from the committed products.

    Returns 1 when a notebook fails or a product differs by more than its tolerance, else 0.
    """
    os.environ[store.FOLDER] = "off"  # a rerun computes
    root, all_entries = paths.BUILD / "verify", []
    shutil.rmtree(root, ignore_errors=True)
    findings = rerun(list(chain()), root)
    for product in _makers(chain()):
        entries = compare.compare(paths.ROOT / product, root / product, tolerance())
        said = f"{product}: {compare.summary(entries)}"
        print(said)
        findings += [said] if (entries["outcome"] == compare.DIFFERENT).any() else []
        all_entries.append(entries)
    print(f"all: {compare.summary(pd.concat(all_entries))}")
    for line in findings:
        print(f"not reproduced: {line}")
    return int(bool(findings))
