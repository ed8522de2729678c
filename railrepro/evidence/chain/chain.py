"""The chain of notebooks: which of them are stale and why, how they run, and which product (written file) each makes.
notebooks/chain.toml declares what each notebook writes. What it reads is logged while it runs (`railrepro.paths`).
Content, never time, decides what is stale. Notebooks run in any order, because none reads a product of another one."""

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
"""Path of a file that a notebook read -> names of the entries that it used; [`paths.ALL`] for all."""
_PRODUCT = Annotated[str, data.matching(r"(data|figures)(/\w[\w.-]*)+", "a path below data/ or figures/")]
_FIGURE = Annotated[str, data.matching(r"fig(\d\d){1,2}_\w+", "a name of the form figNN_name")]
EDITED = "an input was edited while it ran"


@data.table
class Notebook:
    """Notebook of the chain, a table [[notebook]] in notebooks/chain.toml. `name` is its file name without ending,
    `title` its heading, `writes` has the paths of its tables, `figures` the names of its figures (figNN_name),
    `parameters` the values of its parameters cell, and `test_parameters` other values for tests. `minutes` is its run
    time (min), `memory_gb` the peak memory of its processes (GB, None if not measured), `seed` its seed or None."""

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
        """Path of the JSON file with the record of the notebook's last successful run, see `last_run`."""
        return paths.BUILD / "stamps" / f"{self.name}.json"


class Ran(NamedTuple):
    """Result of a run of a notebook: files that it read (path -> names of the tables read, of a TOML file), its run
    time (min), and the peak memory of its processes (GB)."""

    reads: Reads
    minutes: float
    memory_gb: float


@data.table
class Chain:
    """Content of notebooks/chain.toml: notebooks in order, and tolerances for comparing two runs (`verify`)."""

    notebook: tuple[Notebook, ...] = ()
    verify: compare.Tolerance = compare.Tolerance()


def load(path: Path | str | None = None) -> Chain:
    """Read all notebooks from a TOML file (default notebooks/chain.toml); InputError if something in it is wrong."""
    file = data.location(path, paths.NOTEBOOKS / "chain.toml")
    return data.build(Chain, data.read(file), file.name)


def chain() -> dict[str, Notebook]:
    """Notebooks of notebooks/chain.toml in order: name -> `Notebook`."""
    return {one.name: one for one in load().notebook}


def _makers() -> dict[str, str]:
    """Product -> name of the notebook that writes it."""
    return {product: notebook.name for notebook in chain().values() for product in notebook.products}


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _content(file: str) -> bytes:
    path = paths.ROOT / file
    return path.read_bytes() if path.is_file() else b"missing"


def inputs(notebook: Notebook, taken: Reads) -> dict[str, str]:
    """Present hash or version of all that the results of a notebook depend on, except the machine: name -> text. These
    are its cells, its parameters, files that it read, packages, and modules of railrepro that it can import. `taken`
    are the files that its last run read, with the names of tables read from them (`Ran.reads`)."""
    cells = data.read(notebook.path)["cells"]
    state = {"its cells": _hash(json.dumps(["".join(cell["source"]) for cell in cells]).encode())}
    state["its parameters"] = _hash(json.dumps(notebook.parameters, sort_keys=True).encode())
    for file, entries in taken.items():
        state |= _parts(file, entries)
    state |= {f"package {name}": version for name, version in code.packages().items()}
    return state | code.reached(*("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"))


def _parts(file: str, entries: list[str]) -> dict[str, str]:
    """Hash per entry of a TOML file, of some or of all and their order; one hash of another file."""
    content = _content(file)
    try:
        table = tomllib.loads(content.decode()) if file.endswith(".toml") else None
    except ValueError:
        table = None
    if table is None:
        return {file: _hash(content)}
    parts = {} if paths.ALL not in entries else {f"{file}, names of entries": _hash(repr(list(table)).encode())}
    names = table if paths.ALL in entries else entries
    return parts | {f"{file} [{name}]": _hash(repr(table.get(name)).encode()) for name in names}


def _products(notebook: Notebook) -> dict[str, str]:
    return {product: _hash(_content(product)) for product in notebook.products}


def last_run(notebook: Notebook) -> dict[str, dict]:
    """Read the record of a notebook's last successful run in this checkout; {} if there is none. Keys: reads, minutes
    and memory_gb, the fields of `Ran`; inputs, the dict that `inputs` gave then; machine (name -> value); products
    (path of each written file -> SHA-256)."""
    with suppress(InputError):
        return data.read(notebook.stamp)
    return {}


def why_stale(notebook: Notebook) -> str:
    """Say why a notebook must run again: what of machine, inputs, products first differs from its last run, or ""."""
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
    """Class of a kernel of this Python for papermill, with its own environment, folder and sockets."""
    from jupyter_client import AsyncKernelManager
    from jupyter_client.kernelspec import KernelSpecManager

    own = {"connection_file": str(staging / "kernel.json"), "kernel_spec_manager": KernelSpecManager(kernel_dirs=[])}
    # parallel kernels may get the same TCP port, so sockets are files unless their names are too long
    if len(str(staging)) < 90:
        own |= {"transport": "ipc", "ip": str(staging / "k")}
    # the user's settings do not count; products go to staging
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


def _peak_memory(staging: Path, ended: threading.Event) -> int:
    """Largest memory (bytes) of the kernel in `staging` with all processes that it starts, sampled until `ended`. Pages
    that processes share count in each of them, so the sum is an upper bound."""
    import psutil

    peak = 0
    while not ended.wait(0.2):
        with suppress(psutil.Error):  # a process may end meanwhile
            for kernel in psutil.Process().children():
                if any(str(staging) in argument for argument in kernel.cmdline()):
                    tree = [kernel, *kernel.children(recursive=True)]
                    peak = max(peak, sum(process.memory_info().rss for process in tree))
    return peak


def _execute(notebook: Notebook, parameters: dict, staging: Path) -> tuple[Any, str, int]:
    """Run a notebook with papermill; its content with outputs, what failed or "", and its peak memory (bytes). The
    content lacks what differs between equal runs, such as times and progress bars."""
    import nbformat
    import papermill

    logging.getLogger("papermill").setLevel(logging.CRITICAL)  # one sentence says what fails
    output, failure, ended = staging / "executed.ipynb", "", threading.Event()
    # a busy machine may delay a kernel: with shorter limits it is given up after 4 s and outputs are lost
    patient = {"start_timeout": 300, "iopub_timeout": 300, "extra_arguments": ["--log-level=50"]}
    kernel = {"kernel_name": "python3", "kernel_manager_class": _kernel(staging)}
    with ThreadPoolExecutor(1) as pool:
        memory = pool.submit(_peak_memory, staging, ended)
        try:
            papermill.execute_notebook(notebook.path, output, parameters, progress_bar=False, **kernel, **patient)
        except papermill.PapermillExecutionError as error:
            failure = f"cell {error.exec_count} failed with {error.ename}: {error.evalue}".splitlines()[0]
        except (RuntimeError, TimeoutError) as error:
            failure = f"its kernel did not start or ended early ({str(error).partition(chr(10))[0]})"
        finally:
            ended.set()
    content = nbformat.read(output if output.exists() else notebook.path, 4)
    content.metadata.pop("papermill", None)
    for i, cell in enumerate(content.cells):
        for key in ("papermill", "execution"):
            cell.metadata.pop(key, None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell["id"] = f"injected-{i}"
        if cell.cell_type == "code":
            cell.outputs = [one for one in cell.outputs if one.get("name") != "stderr"]
            if not failure and cell.source.strip() and cell.execution_count is None:
                failure = f"cell {i + 1} was not executed"  # after sys.exit(0) in another one
    return content, failure, memory.result()


def run(notebook: Notebook, parameters: dict, root: Path) -> Ran:
    """Execute a notebook and move its products below `root`, a folder that is the checkout or has the same layout.
    Returns what it read, its time and memory (`Ran`). `parameters` are values for its parameters cell by name. TOML
    files in root/data replace those of data/. The executed notebook goes to build/notebooks, for another root to
    root/notebooks; a failed one is NAME.failed.ipynb. InputError when a cell fails, a product was not written, a
    product of another notebook was read, or, with notebook, parameters and inputs as committed, a cell prints a
    sentence about results whose condition is false (`report.sentences`)."""
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
            raise InputError(f"{notebook.name}: {failure} (outputs in {kept})")
        for product in notebook.products:
            write(root / product, (staging / product).read_bytes())
    return Ran(taken, round((time.monotonic() - begin) / 60, 2), round(memory / 1e9, 2))


def _taken(log: Path, notebook: Notebook) -> Reads:
    """What a run read according to the log of its processes, without the products of the notebook itself."""
    logged: dict[str, set[str]] = {}
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        file, _, entry = line.partition("\t")
        logged.setdefault(file, set()).add(entry)
    read = sorted(logged.keys() - {*notebook.products})
    return {file: sorted(logged[file] - {""}) or [paths.ALL] for file in read}


def _is_committed(notebook: Notebook, parameters: dict, taken: Reads, root: Path) -> bool:
    """Whether notebook, parameters and inputs are those of the last commit, and none of them is replaced in `root`."""
    if parameters != notebook.parameters or (root != paths.ROOT and any((root / file).exists() for file in taken)):
        return False
    command = ["git", "-C", str(paths.ROOT), "status", "--porcelain", "--", str(notebook.path), *taken]
    done = subprocess.run(command, capture_output=True)
    return done.returncode == 0 and not done.stdout


def _fault(notebook: Notebook, taken: Reads, staging: Path, false: list[str]) -> str:
    """What is wrong with a run that reached its end, or ""; `false` are its false sentences with committed values."""
    makers = _makers()
    faults = [f"does not hold with the committed values: {' | '.join(false)}"] if false else []
    missing = [product for product in notebook.products if not (staging / product).exists()]
    faults += [f"did not write {product}, which chain.toml declares" for product in missing]
    foreign = [f"{file}, which {makers[file]} writes" for file in taken if file in makers]
    faults += [f"reads {product}: notebooks do not wait for each other" for product in foreign]
    return faults[0] if faults else ""


def refresh(notebook: Notebook) -> Ran:
    """Run a notebook in the checkout (InputError as from `run`). Write to its file `stamp` the files that it read, time
    and memory (the `Ran` that is returned), hashes of inputs and products. From this record `why_stale` tells whether
    it must run again; `run` alone records nothing. If an input is edited meanwhile, the notebook stays stale."""
    begin, before = time.time(), inputs(notebook, {})
    ran = run(notebook, notebook.parameters, paths.ROOT)
    after = inputs(chain()[notebook.name], ran.reads)
    files = [paths.ROOT / file for file in ran.reads]
    newer = any(file.is_file() and file.stat().st_mtime > begin for file in files)
    if newer or not before.items() <= after.items() or not code.unchanged():
        after[EDITED] = ""
    stamp = ran._asdict() | {"inputs": after, "machine": store.machine(), "products": _products(notebook)}
    write(notebook.stamp, json.dumps(stamp, indent=1))
    return ran


def figures(names: Sequence[str] = ()) -> int:
    """Command `figures`: run those notebooks among `names` that are stale, in parallel (up to four, one per core). Each
    name is the name of a notebook or its beginning, as "06", or the name of a figure or its number, as "fig0601";
    default all. InputError for a name that nothing has. Returns 1 when a notebook failed, else 0."""
    notebooks = chain()
    wanted = set() if names else set(notebooks)
    for name in names:
        chosen = {n for n in notebooks if n.startswith(name)}
        chosen |= {n for n, one in notebooks.items() if any(name in (f, f.split("_")[0]) for f in one.figures)}
        if not chosen or not name:
            raise InputError(f"{name!r} is no notebook and no figure of chain.toml, such as 06 or fig06")
        wanted |= chosen
    paths.BUILD.mkdir(exist_ok=True)
    with alone(paths.BUILD / "chain.lock"):
        stale = {name: why for name in sorted(wanted) if (why := why_stale(notebooks[name]))}
        _say(f"{len(stale)} of {len(wanted)} notebooks are stale")
        for name, why in stale.items():
            _say(f"{name} is stale: {why}")
        failed = _run_all(stale, refresh)
        _write_manifests(wanted - failed.keys())
    _say_false([notebooks[name].executed for name in sorted(wanted)], "with these values")
    return int(bool(failed))


def _run_all(names: Collection[str], task: Callable[[Notebook], Ran]) -> dict[str, str]:
    """Call `task` with notebooks in parallel; returns name -> message of those that failed, which stop no other."""
    notebooks = sorted((n for n in chain().values() if n.name in names), key=lambda n: -n.minutes)  # longest first
    left = {notebook.name: notebook.minutes for notebook in notebooks}
    processors = os.cpu_count() or 1
    jobs = max(1, min(processors, 4, len(left)))
    os.environ.setdefault("RAILREPRO_WORKERS", str(max(1, processors // jobs)))  # for the studies of each
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
            if error:
                failed[name] = str(error) if isinstance(error, InputError) else f"{name}: {error!r}"
                _say(f"error: {failed[name]}")
                continue
            ran, rest = future.result(), f", about {sum(left.values()) / jobs:.1f} min" if left else ""
            _say(f"{name}: done in {ran.minutes} min with {ran.memory_gb} GB; {len(left)} left{rest}")
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
    return failed


def _say(words: str) -> None:
    print(words + "\n", end="", file=sys.stderr, flush=True)  # in one piece, as several notebooks print


def _say_false(executed: list[Path], where: str) -> None:
    """Print the sentences that do not hold in those executed notebooks that exist."""
    for file in filter(Path.is_file, executed):
        for sentence in false_in(data.read(file)["cells"]):
            _say(f"{file.stem}: does not hold {where}: {sentence}")


def _write_manifests(names: Collection[str]) -> None:
    """Enter the products of some notebooks into data/MANIFEST.csv and figures/MANIFEST.csv; other rows stay."""
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
    """Command `drive`: run the notebooks 00 to 09 with another car; results are written to build/tried/NAME. `vehicle`
    is a file NAME.toml like data/vehicle.toml. Committed files stay as they are. Prints which sentences of the
    notebooks do not hold on this car; returns 1 when a notebook failed, else 0."""
    load_vehicle(vehicle)
    root = paths.BUILD / "tried" / vehicle.stem
    write(root / "data/vehicle.toml", vehicle.read_bytes())
    names = [name for name in chain() if name < "10"]
    failed = _run_all(names, lambda one: run(one, one.parameters, root))
    _say_false([root / f"notebooks/{name}.ipynb" for name in names if name not in failed], "on this car")
    _say(f"figures and executed chapters are in {root}")
    return int(bool(failed))


def verify() -> int:
    """Command `verify`: rerun all notebooks in build/verify and print how products differ from the committed ones.
    Returns 1 when a notebook fails or a product differs by more than its tolerance, else 0."""
    os.environ[store.FOLDER] = "off"  # a rerun reads no stored results
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
