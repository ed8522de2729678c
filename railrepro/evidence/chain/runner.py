"""Running notebooks: papermill in a staging folder, products moved in place only when all is well.

papermill is imported only when something runs, so that a run with nothing to do costs a fraction of a second.
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from railrepro import paths, reads
from railrepro.errors import InputError
from railrepro.evidence.chain import manifest
from railrepro.evidence.chain.graph import Notebook, chain, find
from railrepro.evidence.chain.manifest import cells, enter_again, entries_read, is_entered, record, why_stale
from railrepro.files import move, scratch, write, written


def fresh() -> int:
    """Print which notebooks are stale; 0 when none is and the manifests hold all of them."""
    notebooks = chain()
    stale = {notebook: why for notebook in notebooks if (why := why_stale(notebook))}
    if stale:
        minutes = max(1, round(estimate(list(stale))))
        print(
            f"{len(stale)} of {len(notebooks)} notebooks are stale and run first, about {minutes} min", file=sys.stderr
        )
        for notebook, why in stale.items():
            print(f"  {notebook.name} is stale: {why}", file=sys.stderr)
    return int(bool(stale) or not all(map(is_entered, notebooks)))


def estimate(notebooks: Sequence[Notebook], at_once: int = 0) -> float:
    """How long notebooks take, several at a time (minutes), from their last runs here or from chain.toml.

    Parameters
    ----------
    notebooks : sequence of Notebook
    at_once : int
        How many of them; 0 takes what the Makefile takes, at most four.
    """
    times = [manifest.minutes(notebook) for notebook in notebooks]
    return max(max(times), sum(times) / (at_once or min(os.cpu_count() or 1, 4)))


def store_times() -> None:
    """Enter the durations of the last runs here into notebooks/chain.toml, for clones that have run nothing yet."""
    file = paths.NOTEBOOKS / "chain.toml"
    text = file.read_text(encoding="utf-8")
    for notebook in chain():
        entry = re.compile(rf'(name = "{notebook.name}"(?:(?!\[\[)[\s\S])*?^minutes = )[\d.]+', re.MULTILINE)
        text = entry.sub(lambda m: f"{m[1]}{max(manifest.minutes(notebook), 0.1):.1f}", text)  # noqa: B023
    write(file, text)


def refresh(name: str) -> None:
    """Run a notebook of the chain if it is stale, put its products in place and record where they come from."""
    notebook = find(name)
    why = why_stale(notebook)
    if not why:
        enter_again(notebook)
        return
    print(f"{name}: running, about {manifest.minutes(notebook):.1f} min ({why})", file=sys.stderr, flush=True)
    before, begin, log = manifest.inputs(notebook, {}), time.monotonic(), paths.BUILD / "stamps" / f"{name}.reads"
    with written():
        log.parent.mkdir(parents=True, exist_ok=True)
        log.unlink(missing_ok=True)
    with _environment({reads.LOG: str(log)}):
        run_notebook(notebook, notebook.parameters, paths.ROOT, paths.BUILD / "notebooks")
    seconds = round(time.monotonic() - begin, 1)
    record(notebook, before, entries_read(log), seconds)
    log.unlink(missing_ok=True)
    print(f"{name}: done in {seconds:.0f} s", file=sys.stderr, flush=True)


def run_notebook(notebook: Notebook, parameters: dict, root: Path, executed: Path, keep_going: bool = False) -> Path:
    """Execute a notebook and move its products below `root`.

    Parameters
    ----------
    notebook : Notebook
    parameters : dict
        Values for its parameters cell; unknown names are refused.
    root : Path
        Products land in root/data and root/figures; reads prefer files there.
    executed : Path
        Folder of the executed notebook; a failed one is kept there as NAME.failed.ipynb.
    keep_going : bool
        A failing cell does not stop the rest; the products that there are land below `root` before the error is raised.

    Returns
    -------
    Path
        The executed notebook.

    Raises
    ------
    InputError
        One line: unknown parameter, failing cell, cell not executed, missing product, no write permission.
    """
    _check_parameters(notebook, parameters)
    with written():
        executed.mkdir(parents=True, exist_ok=True)
        with scratch(paths.BUILD / "staging", f"{notebook.name}-{os.getpid()}") as staging:
            return _run_staged(notebook, parameters, root, executed, staging, keep_going)


def _run_staged(
    notebook: Notebook, parameters: dict, root: Path, executed: Path, staging: Path, keep_going: bool
) -> Path:
    if root != paths.ROOT:
        for read in notebook.reads:
            if (root / read).exists():
                (staging / read).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(root / read, staging / read)
    result, failed = executed / f"{notebook.name}.ipynb", executed / f"{notebook.name}.failed.ipynb"
    output, failure = staging / "executed.ipynb", None
    try:
        _execute(notebook, parameters, staging, output, failed, keep_going)
    except InputError as error:
        if not keep_going:
            raise
        failure = error
    missing = [product for product in notebook.products if not (staging / product).exists()]
    if missing and not failure:
        raise InputError(f"{notebook.name}: did not write {missing[0]}, which chain.toml declares")
    for product in notebook.products:
        if product not in missing:
            move(staging / product, root / product)
    if failure:
        raise failure
    move(output, result)
    failed.unlink(missing_ok=True)
    return result


def _check_parameters(notebook: Notebook, parameters: dict) -> None:
    tagged = [c for c in cells(notebook) if "parameters" in c.get("metadata", {}).get("tags", [])]
    try:
        tree = ast.parse(tagged[0]["source"] if tagged else "")
    except SyntaxError as error:
        raise InputError(f"{notebook.name}: the parameters cell is no Python ({error})") from error
    known = {
        target.id
        for node in tree.body
        if isinstance(node, ast.Assign)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for name in parameters:
        if name not in known:
            raise InputError(f"{notebook.name}: unknown parameter {name!r}; the notebook has {sorted(known)}")


@contextmanager
def _environment(values: Mapping[str, str | None]) -> Iterator[None]:
    """Set environment variables for a block; None removes one."""
    before = {key: os.environ.get(key) for key in values}
    _set(values)
    try:
        yield
    finally:
        _set(before)


def _set(values: Mapping[str, str | None]) -> None:
    for key, value in values.items():
        if value is None:
            os.environ.pop(key, None)
        else:
            os.environ[key] = value


def _execute(notebook: Notebook, parameters: dict, staging: Path, output: Path, failed: Path, keep_going: bool) -> None:
    """Run papermill into `output`; on failure keep `failed` and raise one line."""
    import nbformat
    import papermill

    from railrepro.evidence.chain.cleaning import deterministic
    from railrepro.evidence.chain.kernel import PARENT, Kernel

    jupyter = {f"JUPYTER_{k}_DIR": str(paths.BUILD / "jupyter" / k.lower()) for k in ("CONFIG", "DATA", "RUNTIME")}
    settings = jupyter | {
        "JUPYTER_PATH": "",
        "IPYTHONDIR": str(paths.BUILD / "ipython"),
        "MPLCONFIGDIR": str(paths.BUILD / "matplotlib"),
        "MPLBACKEND": None,
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONHASHSEED": "0",
        "PYDEVD_DISABLE_FILE_VALIDATION": "1",
        PARENT: str(os.getpid()),
        "RAILREPRO_OUTPUT": str(staging),
        "RAILREPRO_ROOT": str(paths.ROOT),
    }
    Kernel.prepare(paths.BUILD / "ipython")
    with _environment(settings):
        try:
            bar = {"desc": notebook.name, "leave": False} if sys.stderr.isatty() and not _beside_others() else False
            options = {"parameters": parameters, "kernel_name": "python3", "cwd": str(paths.ROOT), "progress_bar": bar}
            # a busy machine may let a kernel wait: without these nbclient gives up after 4 s and loses outputs
            patience = {"start_timeout": 300, "iopub_timeout": 300}
            own = {"allow_errors": keep_going, "kernel_manager_class": Kernel} | patience
            papermill.execute_notebook(str(notebook.path), str(output), **options, **own)
        except papermill.PapermillExecutionError:
            deterministic(output)
            move(output, failed)
            where, message = _first_failure(failed)
            raise InputError(f"{notebook.name}: {where} failed with {message} (kept {_short(failed)})") from None
        except (RuntimeError, TimeoutError) as error:
            reason = str(error).partition("\n")[0] + (f"; {words}" if (words := Kernel.last_words()) else "")
            raise InputError(f"{notebook.name}: the kernel did not start or ended before its time ({reason})") from None
        finally:
            Kernel.end_all()
    for i, cell in enumerate(nbformat.read(output, 4).cells):
        if cell.cell_type == "code" and cell.source.strip() and cell.execution_count is None:
            move(output, failed)
            raise InputError(f"{notebook.name}: cell {i + 1} was not executed (kept {_short(failed)})")
    deterministic(output)


def _first_failure(executed: Path) -> tuple[str, str]:
    """Place and first line of the first error in an executed notebook; others may follow from it."""
    import nbformat

    for cell in nbformat.read(executed, 4).cells:
        for output in cell.get("outputs", []):
            if output.output_type == "error":
                place = f"cell {cell.execution_count}" if cell.execution_count else "a cell"
                return place, f"{output.ename}: {output.evalue}".splitlines()[0]
    return "a cell", "an error that it does not show"


def _beside_others() -> bool:
    """Whether make runs several notebooks at a time, whose progress bars would overwrite each other."""
    return "--jobserver" in os.environ.get("MAKEFLAGS", "")


def _short(path: Path) -> str:
    return str(path.relative_to(paths.ROOT)) if path.is_relative_to(paths.ROOT) else str(path)
