"""The chain of notebooks: which are stale and why, how they run, and where each product (written file) comes from.

notebooks/chain.toml says what each notebook writes; what it reads is noted while it runs (`railrepro.paths`). Content
decides what is stale, never time. No notebook reads what another one writes, so they run in any order.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import shutil
import subprocess
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import field
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from railrepro import code, data, numerics, paths
from railrepro.data import InputError, Number, above, alone, between, scratch, write
from railrepro.evidence.chain import compare
from railrepro.evidence.report.sentences import false_in
from railrepro.studies import store
from railrepro.vehicle.parameters import load_vehicle

Reads = dict[str, list[str]]
"""Path of a file that a notebook read -> names of the entries that it took; [`paths.ALL`] for all."""
_PRODUCT = Annotated[str, data.matching(r"(data|figures)(/\w[\w.-]*)+", "a path below data/ or figures/")]
_FIGURE = Annotated[str, data.matching(r"fig\d\d_\w+", "a name of the form figNN_name")]
EDITED = "an input was edited while it ran"


@data.table
class Notebook:
    """Notebook of the chain, an entry of notebooks/chain.toml.

    `name` is its file name without ending, `writes` the paths of its tables, `figures` the names of its figures
    (figNN_name). `parameters` are the values of its parameters cell, `test_parameters` those in tests. `minutes` is its
    run time (min), `memory_gb` the peak memory of its processes (GB, None if it was not measured), `seed` the random
    seed that it uses (None if it uses none).
    """

    name: data.Name
    title: str
    writes: tuple[_PRODUCT, ...] = ()
    figures: tuple[_FIGURE, ...] = ()
    parameters: dict[str, data.Free] = field(default_factory=dict)
    test_parameters: dict[str, data.Free] = field(default_factory=dict)
    minutes: Annotated[Number, above(0.0, 1e4, "min")] = 1.0
    memory_gb: Annotated[Number, above(0.0, 1e3, "GB")] | None = None
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
        """Paths of all files that the notebook writes, relative to the checkout; each figure is a png and a csv."""
        return self.writes + tuple(f"figures/{figure}.{suffix}" for figure in self.figures for suffix in ("png", "csv"))

    @property
    def stamp(self) -> Path:
        """Path of the record of the notebook's last successful run, see `last_run`."""
        return paths.BUILD / "stamps" / f"{self.name}.json"


class Ran(NamedTuple):
    """What a run of a notebook read, how long it took (min), and the peak memory of its processes (GB)."""

    reads: Reads
    minutes: float
    memory_gb: float


@data.table
class Chain:
    """Content of notebooks/chain.toml: all notebooks in order, and the tolerances with which `verify` compares."""

    notebook: tuple[Notebook, ...] = ()
    verify: compare.Tolerance = compare.Tolerance()


def load(path: Path | str | None = None) -> Chain:
    """Read the chain of notebooks from a TOML file (default notebooks/chain.toml); InputError for wrong entries."""
    file = data.location(path, paths.NOTEBOOKS / "chain.toml")
    return data.build(Chain, data.read(file), file.name)


def chain() -> dict[str, Notebook]:
    """Notebooks of notebooks/chain.toml in order: name -> `Notebook`."""
    return {one.name: one for one in load().notebook}


def _makers() -> dict[str, str]:
    """Name of the notebook that writes each product."""
    return {product: notebook.name for notebook in chain().values() for product in notebook.products}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _content(file: Path) -> bytes:
    return file.read_bytes() if file.is_file() else b"missing"


def inputs(notebook: Notebook, taken: Reads) -> dict[str, str]:
    """Present state of the inputs of a notebook, except the machine (`store.machine`): name -> hash or version.

    Inputs are its cells, its parameters, files that it read, packages, and modules of railrepro that it can import.
    `taken` maps files to the entries that its last run read from them, as returned by `run`.
    """
    cells = data.read(notebook.path)["cells"]
    found = {"its cells": _hash(json.dumps(["".join(cell["source"]) for cell in cells]).encode())}
    found["its parameters"] = _hash(json.dumps(notebook.parameters, sort_keys=True).encode())
    for file, entries in taken.items():
        found |= _parts(file, _content(paths.ROOT / file), entries)
    found |= {f"package {name}": version for name, version in code.packages().items()}
    return found | code.reached(*("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"))


def _parts(file: str, content: bytes, entries: list[str]) -> dict[str, str]:
    """Hashes of some entries of a TOML file by value, or of all and their order; of another file that of its bytes."""
    try:
        table = tomllib.loads(content.decode()) if file.endswith(".toml") else None
    except ValueError:
        table = None
    if table is None:
        return {file: _hash(content)}
    found = {} if paths.ALL not in entries else {f"{file}, names of entries": _hash(repr(list(table)).encode())}
    names = table if paths.ALL in entries else entries
    return found | {f"{file} [{name}]": _hash(repr(table.get(name)).encode()) for name in names}


def _products(notebook: Notebook) -> dict[str, str]:
    return {product: _hash(_content(paths.ROOT / product)) for product in notebook.products}


def last_run(notebook: Notebook) -> dict[str, dict]:
    """Record of the last successful run of a notebook in this checkout; {} if there is none.

    Keys: reads (files and entries that it read, `Reads`), inputs (their state then, see `inputs`), machine
    (`store.machine`), products (path of each written file -> SHA-256), minutes and memory_gb as in `Ran`.
    """
    try:
        return data.read(notebook.stamp)
    except InputError:
        return {}


def why_stale(notebook: Notebook) -> str:
    """Why a notebook must run again: the input or product that changed since its last run, in words; "" if none."""
    last = last_run(notebook)
    if not last:
        return "it has not run here"
    for now, before, words in (
        (store.machine(), last["machine"], ""),
        (inputs(notebook, last["reads"]), last["inputs"], ""),
        (_products(notebook), last["products"], " was changed or is missing"),
    ):
        changed = [name for name in {**now, **before} if now.get(name) != before.get(name)]
        if changed:
            return f"{changed[0]}{words}" + (f" and {len(changed) - 1} more" if len(changed) > 1 else "")
    return "" if code.unchanged() else EDITED


def _kernel(staging: Path) -> type:
    """A kernel of this Python for papermill, with an environment, a folder and sockets of its own."""
    from jupyter_client import AsyncKernelManager
    from jupyter_client.kernelspec import KernelSpecManager

    own = {"connection_file": str(staging / "kernel.json"), "kernel_spec_manager": KernelSpecManager(kernel_dirs=[])}
    # kernels side by side may be given one TCP port, so that sockets are files, where their names are not too long
    if len(str(staging)) < 90:
        own |= {"transport": "ipc", "ip": str(staging / "k")}
    # nothing of the user's own settings; products go to staging
    around = {"IPYTHONDIR": str(staging / "ipython"), "MPLCONFIGDIR": str(paths.BUILD / "matplotlib")}
    around |= {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    around |= {"PYTHONHASHSEED": "0", "PYDEVD_DISABLE_FILE_VALIDATION": "1"} | numerics.variables()
    around |= {paths.READS: str(staging / "reads"), "RAILREPRO_OUTPUT": str(staging), "RAILREPRO_ROOT": str(paths.ROOT)}
    started = {"env": os.environ | around, "cwd": str(paths.ROOT), "stderr": subprocess.DEVNULL}

    class Kernel(AsyncKernelManager):
        def __init__(self, **options):
            super().__init__(**options | own)

        def start_kernel(self, **options):
            return super().start_kernel(**options | started)

    return Kernel


class _Memory(threading.Thread):
    """Samples the memory of the kernel of a notebook and of all processes that it starts until `join`.

    `peak` is the largest sum (bytes). Pages that processes share count in each of them, so the sum is an upper bound.
    """

    def __init__(self, staging: Path):
        super().__init__(daemon=True)
        self.peak, self._folder, self._ended = 0, str(staging), threading.Event()
        self.start()

    def run(self) -> None:
        import psutil

        while not self._ended.wait(0.2):
            with suppress(psutil.Error):  # a process may end meanwhile
                for kernel in psutil.Process().children():
                    if any(self._folder in argument for argument in kernel.cmdline()):
                        tree = [kernel, *kernel.children(recursive=True)]
                        self.peak = max(self.peak, sum(process.memory_info().rss for process in tree))

    def join(self, timeout: float | None = None) -> None:
        self._ended.set()
        super().join(timeout)


def _execute(notebook: Notebook, parameters: dict, staging: Path) -> tuple[Any, str, int]:
    """Run a notebook with papermill; its content with outputs, what failed or "", and its peak memory (bytes)."""
    import nbformat
    import papermill

    logging.getLogger("papermill").setLevel(logging.CRITICAL)  # what fails is said in one sentence
    output, failure, memory = staging / "executed.ipynb", "", _Memory(staging)
    try:
        # a busy machine may let a kernel wait: without these limits it is given up after 4 s and outputs are lost
        papermill.execute_notebook(
            notebook.path, output, parameters, kernel_name="python3", kernel_manager_class=_kernel(staging),
            progress_bar=False, start_timeout=300, iopub_timeout=300, extra_arguments=["--log-level=50"],
        )  # fmt: skip
    except papermill.PapermillExecutionError as error:
        failure = f"cell {error.exec_count} failed with {error.ename}: {error.evalue}".splitlines()[0]
    except (RuntimeError, TimeoutError) as error:
        failure = f"its kernel did not start or ended before its time ({str(error).partition(chr(10))[0]})"
    finally:
        memory.join()
    content = nbformat.read(output if output.exists() else notebook.path, 4)
    _make_deterministic(content)
    for i, cell in enumerate(content.cells, 1):
        if not failure and cell.cell_type == "code" and cell.source.strip() and cell.execution_count is None:
            failure = f"cell {i} was not executed"  # after sys.exit(0) in another one
    return content, failure, memory.peak


def _make_deterministic(content: Any) -> None:
    """Remove from an executed notebook what differs between two equal runs, as times and progress bars."""
    content.metadata.pop("papermill", None)
    for i, cell in enumerate(content.cells):
        for key in ("papermill", "execution"):
            cell.metadata.pop(key, None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell["id"] = f"injected-{i}"
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]


def run(notebook: Notebook, parameters: dict, root: Path) -> Ran:
    """Execute a notebook and move the files that it writes, its products, below `root`.

    The executed notebook goes to build/notebooks, for a root other than the checkout to root/notebooks, a failed one as
    NAME.failed.ipynb.

    Args:
        notebook: Notebook
        parameters (dict): Values for its parameters cell, by name.
        root (Path): Folder for data/ and figures/ that it writes; TOML files in root/data replace those of data/.

    Returns:
        Ran: What it read of data/ and figures/, its time and memory.

    Raises:
        InputError: When a cell fails, a product was not written, a product of another notebook was read, or a sentence
            that it prints (`report.sentences`) is false while notebook, parameters and inputs are as committed.
    """
    import nbformat

    begin = time.monotonic()
    with scratch() as staging:
        if root != paths.ROOT:
            (staging / "data").mkdir()
            for file in (root / "data").glob("*.toml"):
                shutil.copy2(file, staging / "data")
        content, failure, memory = _execute(notebook, parameters, staging)
        taken = _taken(staging / "reads", notebook)
        committed = not failure and _is_committed(notebook, parameters, taken, root)
        failure = failure or _fault(notebook, taken, staging, false_in(content.cells) if committed else [])
        executed = (paths.BUILD if root == paths.ROOT else root) / "notebooks"
        kept = executed / f"{notebook.name}.failed.ipynb"
        kept.unlink(missing_ok=True)
        write(kept if failure else executed / f"{notebook.name}.ipynb", nbformat.writes(content) + "\n")
        if failure:
            raise InputError(f"{notebook.name}: {failure} (kept {kept})")
        for product in notebook.products:
            write(root / product, (staging / product).read_bytes())
    return Ran(taken, round((time.monotonic() - begin) / 60, 2), round(memory / 1e9, 2))


def _taken(log: Path, notebook: Notebook) -> Reads:
    """What a run read, from the log of its processes, but for the products of the notebook itself."""
    found: dict[str, set[str]] = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        file, _, entry = line.partition("\t")
        found.setdefault(file, set()).add(entry)
    known = {file: sorted(entries - {""}) or [paths.ALL] for file, entries in sorted(found.items())}
    return {file: entries for file, entries in known.items() if file not in notebook.products}


def _is_committed(notebook: Notebook, parameters: dict, taken: Reads, root: Path) -> bool:
    """Whether notebook, parameters and inputs are those of the last commit; not with files of one's own in `root`."""
    if parameters != notebook.parameters or (root != paths.ROOT and any((root / file).exists() for file in taken)):
        return False
    command = ["git", "-C", str(paths.ROOT), "status", "--porcelain", "--", str(notebook.path), *taken]
    done = subprocess.run(command, capture_output=True)
    return done.returncode == 0 and not done.stdout


def _fault(notebook: Notebook, taken: Reads, staging: Path, false: list[str]) -> str:
    """What is wrong with a run that came to its end, or ""; `false` are its false sentences with committed values."""
    if false:
        return f"does not hold with the committed values: {' | '.join(false)}"
    for product in notebook.products:
        if not (staging / product).exists():
            return f"did not write {product}, which chain.toml declares"
    makers = _makers()
    for file in taken:
        if file in makers:
            return f"reads {file}, which {makers[file]} writes: notebooks do not wait for each other"
    return ""


def refresh(notebook: Notebook) -> Ran:
    """Run a notebook (errors as `run`), record it for `last_run`; it stays stale if an input was edited meanwhile."""
    begin, own = time.time(), inputs(notebook, {})
    ran = run(notebook, notebook.parameters, paths.ROOT)
    taken = ran.reads
    found = inputs(chain()[notebook.name], taken)
    files = [paths.ROOT / file for file in taken]
    edited = any(file.is_file() and file.stat().st_mtime > begin for file in files) or not own.items() <= found.items()
    found |= {EDITED: ""} if edited or not code.unchanged() else {}
    stamp = ran._asdict() | {"inputs": found, "machine": store.machine(), "products": _products(notebook)}
    write(notebook.stamp, json.dumps(stamp, indent=1))
    return ran


def figures(names: Sequence[str] = ()) -> int:
    """Command `figures`: run those notebooks among `names` that are stale, in parallel (up to four, one per core).

    `names` are names of notebooks or figures, or their beginnings, as "fig06"; empty takes all. InputError when nothing
    begins with a name, or a name is blank. Returns 1 when a notebook failed, else 0.
    """
    notebooks = chain()
    wanted = set() if names else set(notebooks)
    for name in names:
        found = {n.name for n in notebooks.values() if any(one.startswith(name) for one in (n.name, *n.figures))}
        if not found or not name:
            raise InputError(f"{name!r} begins the name of no notebook or figure of chain.toml, such as 06 or fig06")
        wanted |= found
    paths.BUILD.mkdir(exist_ok=True)
    with alone(paths.BUILD / "chain.lock"):
        stale = {name: why for name in sorted(wanted) if (why := why_stale(notebooks[name]))}
        _say(f"{len(stale)} of {len(wanted)} notebooks are stale")
        for name, why in stale.items():
            _say(f"{name} is stale: {why}")
        failed = _run_all(stale, refresh)
        _write_manifests(wanted - failed.keys())
    for notebook in [notebooks[name] for name in sorted(wanted) if notebooks[name].executed.is_file()]:
        for sentence in false_in(data.read(notebook.executed)["cells"]):
            _say(f"{notebook.name}: does not hold with these values: {sentence}")
    return int(bool(failed))


def _run_all(names: Collection[str], task: Callable[[Notebook], Ran]) -> dict[str, str]:
    """Call `task` with notebooks side by side; returns name -> message of those that failed, which stop no other."""
    notebooks = sorted((n for n in chain().values() if n.name in names), key=lambda n: -n.minutes)  # longest first
    left = {notebook.name: notebook.minutes for notebook in notebooks}
    processors = os.cpu_count() or 1
    jobs = max(1, min(processors, 4, len(left)))
    os.environ.setdefault("RAILREPRO_WORKERS", str(max(1, processors // jobs)))  # of the studies of each
    failed: dict[str, str] = {}

    def one(notebook: Notebook) -> Ran:
        _say(f"{notebook.name}: running, about {notebook.minutes:.1f} min")
        return task(notebook)

    pool = ThreadPoolExecutor(jobs)
    futures = {pool.submit(one, notebook): notebook.name for notebook in notebooks}
    try:
        for future in as_completed(futures):
            name, error = futures[future], future.exception()
            del left[name]
            if error:  # whatever it is, the other notebooks go on
                failed[name] = str(error) if isinstance(error, InputError) else f"{name}: {error!r}"
                _say(f"error: {failed[name]}")
            else:
                ran = future.result()
                _say(
                    f"{name}: done in {ran.minutes} min with {ran.memory_gb} GB; {len(left)} left"
                    + f", about {sum(left.values()) / jobs:.1f} min" * bool(left)
                )
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return failed


def _say(words: str) -> None:
    print(words + "\n", end="", file=sys.stderr, flush=True)  # at once: several notebooks speak


def _write_manifests(names: Collection[str]) -> None:
    """Enter the products of some fresh notebooks into data/MANIFEST.csv and figures/MANIFEST.csv; other rows stay."""
    notebooks, maker = chain(), _makers()
    made: dict[str, list[str]] = {}
    for notebook in [notebooks[name] for name in names]:
        last = last_run(notebook)
        if EDITED in last["inputs"]:
            continue
        digest = _hash(json.dumps(last["inputs"], sort_keys=True).encode())
        seed = "" if notebook.seed is None else str(notebook.seed)
        made |= {path: [path, content, notebook.name, digest, seed] for path, content in last["products"].items()}
    for folder in ("data", "figures"):
        file = paths.ROOT / folder / "MANIFEST.csv"
        lines = file.read_text(encoding="utf-8").splitlines()[1:] if file.is_file() else []
        rows = {row[0]: row for row in (line.split(",") for line in lines) if maker.get(row[0]) == row[2]}
        rows |= {path: row for path, row in made.items() if path.startswith(f"{folder}/")}
        written = ["path,sha256,made_by,inputs_sha256,seed", *(",".join(rows[path]) for path in sorted(rows))]
        if rows:
            write(file, "\n".join(written) + "\n")


def drive(vehicle: Path) -> int:
    """Command `drive`: run the notebooks 00 to 09 with another car; results are written to build/tried/NAME.

    `vehicle` is a file NAME.toml like data/vehicle.toml. Committed files stay as they are. Prints the sentences of the
    notebooks that do not hold on this car; returns 1 when a notebook failed, else 0.
    """
    load_vehicle(vehicle)
    root = paths.BUILD / "tried" / vehicle.stem
    write(root / "data/vehicle.toml", vehicle.read_bytes())
    names = [name for name in chain() if name < "10"]
    failed = _run_all(names, lambda one: run(one, one.parameters, root))
    for name in [name for name in names if name not in failed]:
        for sentence in false_in(data.read(root / f"notebooks/{name}.ipynb")["cells"]):
            _say(f"{name}: does not hold on this car: {sentence}")
    _say(f"figures and executed chapters are in {root}")
    return int(bool(failed))


def verify() -> int:
    """Command `verify`: run all notebooks anew in build/verify and print how products differ from the committed ones.

    Returns 1 when a notebook fails or a product differs by more than its tolerance, else 0.
    """
    os.environ[store.FOLDER] = "off"  # a rerun computes
    root = paths.BUILD / "verify"
    shutil.rmtree(root, ignore_errors=True)
    findings = list(_run_all(chain(), lambda one: run(one, one.parameters, root)).values())
    for product in _makers():
        entries = compare.compare(paths.ROOT / product, root / product, load().verify)
        said = f"{product}: {compare.summary(entries)}"
        print(said)
        findings += [said] if (entries["outcome"] == compare.DIFFERENT).any() else []
    for line in findings:
        print(f"not reproduced: {line}")
    return int(bool(findings))
