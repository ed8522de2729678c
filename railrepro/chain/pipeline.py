"""Running the notebooks: graph, staleness by content, atomic products, provenance, HTML book.

notebooks/chain.toml is the one source of the graph. Only this module imports papermill, and only when something runs,
so that a run with nothing to do costs a fraction of a second.
"""

from __future__ import annotations

import argparse
import ast
import csv
import fcntl
import hashlib
import json
import os
import re
import shutil
import sys
import tomllib
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from railrepro import paths
from railrepro.errors import InputError

SUFFIXES = ("pdf", "svg", "png", "csv")
_FIELDS = {"name", "title", "reads", "writes", "figures", "parameters", "test_parameters", "minutes", "seed"}


@dataclass(frozen=True)
class Notebook:
    """One entry of the chain; see the head of notebooks/chain.toml."""

    name: str
    title: str
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    figures: tuple[str, ...] = ()
    parameters: dict = field(default_factory=dict)
    test_parameters: dict = field(default_factory=dict)
    minutes: float = 1.0
    seed: int | None = None

    @property
    def path(self) -> Path:
        """The notebook file."""
        return paths.NOTEBOOKS / f"{self.name}.ipynb"

    @property
    def products(self) -> tuple[str, ...]:
        """All files that it writes, relative to the checkout."""
        return self.writes + tuple(f"figures/{figure}.{suffix}" for figure in self.figures for suffix in SUFFIXES)


def chain(path: Path | None = None) -> list[Notebook]:
    """Notebooks of the chain in order; refuses unknown fields, double products, reads before making."""
    file = path or paths.NOTEBOOKS / "chain.toml"
    notebooks, made = [], {}
    for entry in tomllib.loads(file.read_text()).get("notebook", []):
        unknown = set(entry) - _FIELDS
        if unknown:
            raise InputError(f"{file.name}: {entry.get('name')} has the unknown field {min(unknown)!r}")
        lists = {key: tuple(value) for key, value in entry.items() if isinstance(value, list)}
        notebook = Notebook(**entry | lists)
        for product in notebook.products:
            if product in made:
                raise InputError(f"{file.name}: {product} is written by {made[product]} and by {notebook.name}")
            made[product] = notebook.name
        notebooks.append(notebook)
    position = {notebook.name: i for i, notebook in enumerate(notebooks)}
    for notebook in notebooks:
        for read in notebook.reads:
            if read in made and position[made[read]] >= position[notebook.name]:
                raise InputError(f"{file.name}: {notebook.name} reads {read} before {made[read]} makes it")
    return notebooks


def find(name: str) -> Notebook:
    """A notebook of the chain by name."""
    known = {notebook.name: notebook for notebook in chain()}
    if name not in known:
        raise InputError(f"notebook {name!r} is not in chain.toml; there are {sorted(known)}")
    return known[name]


def rules() -> str:
    """Make rules of the chain: one stamp per notebook, after the stamps of what it reads."""
    notebooks = chain()
    maker = {product: notebook.name for notebook in notebooks for product in notebook.products}
    lines = ["STAMPS := " + " ".join(f"build/stamps/{n.name}.json" for n in notebooks), ""]
    for notebook in notebooks:
        stamp = f"build/stamps/{notebook.name}.json"
        before = sorted({f"build/stamps/{maker[read]}.json" for read in notebook.reads if read in maker})
        lines += [f"{stamp}: FORCE $(VENV) {' '.join(before)}".rstrip()]
        lines += [f"\t@$(PY) -m railrepro.chain.pipeline run {notebook.name}"]
        for figure in notebook.figures:
            lines += [f".PHONY: {figure[:5]}", f"{figure[:5]}: {stamp}"]
        lines.append("")
    return "\n".join(lines)


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _file_hash(path: Path) -> str:
    return _hash(path.read_bytes()) if path.exists() else "missing"


def _imports(text: str) -> set[str]:
    """Names of railrepro modules that a piece of Python imports."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("railrepro")}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("railrepro"):
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def _module_file(module: str) -> Path | None:
    base = paths.ROOT / Path(*module.split("."))
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.exists()), None)


def _code(notebook: Notebook) -> list[str]:
    cells = json.loads(notebook.path.read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def inputs_hash(notebook: Notebook, parameters: dict | None = None) -> str:
    """Hash of all that a notebook's products depend on: cells, parameters, reads, imported modules, environment."""
    cells = json.loads(notebook.path.read_text())["cells"]
    parts = {"cells": ["".join(cell["source"]) for cell in cells]}
    parts["parameters"] = notebook.parameters if parameters is None else parameters
    pending, modules = [module for code in _code(notebook) for module in _imports(code)], {}
    while pending:
        file = _module_file(pending.pop())
        if file is None or str(file) in modules:
            continue
        modules[str(file)] = _file_hash(file)
        pending += _imports(file.read_text())
    parts["modules"] = sorted((str(Path(f).relative_to(paths.ROOT)), h) for f, h in modules.items())
    extra = sorted((paths.ROOT / "railrepro").rglob("*.[ch]"))
    parts["files"] = [_file_hash(paths.source(read)) for read in notebook.reads] + [_file_hash(f) for f in extra]
    parts["environment"] = _file_hash(paths.ROOT / "environment.lock")
    return _hash(json.dumps(parts, sort_keys=True).encode())


def _stamp(notebook: Notebook) -> Path:
    return paths.BUILD / "stamps" / f"{notebook.name}.json"


def is_fresh(notebook: Notebook) -> bool:
    """Whether inputs and products are those of the last successful run."""
    stamp = _stamp(notebook)
    if not stamp.exists():
        return False
    known = json.loads(stamp.read_text())
    products = {product: _file_hash(paths.ROOT / product) for product in notebook.products}
    return known["inputs"] == inputs_hash(notebook) and known["products"] == products


def refresh(name: str) -> None:
    """Run a notebook of the chain if it is stale, put its products in place and record where they come from."""
    notebook = find(name)
    if is_fresh(notebook):
        return
    print(f"{name}: running, about {notebook.minutes:g} min", file=sys.stderr, flush=True)
    inputs = inputs_hash(notebook)
    run_notebook(notebook, notebook.parameters, paths.ROOT, paths.BUILD / "notebooks")
    products = {product: _file_hash(paths.ROOT / product) for product in notebook.products}
    _record(notebook, products, inputs)
    stamp = _stamp(notebook)
    stamp.parent.mkdir(parents=True, exist_ok=True)
    _write(stamp, json.dumps({"inputs": inputs, "products": products}, indent=1))


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
    staging = paths.BUILD / "staging" / f"{notebook.name}-{os.getpid()}"
    try:
        executed.mkdir(parents=True, exist_ok=True)
        staging.mkdir(parents=True)
    except OSError as error:
        raise InputError(f"{notebook.name}: no write permission for {error.filename}") from error
    result, scratch = (
        executed / f"{notebook.name}.ipynb",
        executed / f"{notebook.name}.{os.getpid()}.part.ipynb",
    )
    try:
        if root != paths.ROOT:
            for read in notebook.reads:
                if (root / read).exists():
                    (staging / read).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(root / read, staging / read)
        failure = None
        try:
            _execute(notebook, parameters, staging, scratch, executed / f"{notebook.name}.failed.ipynb", keep_going)
        except InputError as error:
            if not keep_going:
                raise
            failure = error
        missing = [product for product in notebook.products if not (staging / product).exists()]
        if missing and not failure:
            raise InputError(f"{notebook.name}: did not write {missing[0]}, which chain.toml declares")
        for product in notebook.products:
            if product not in missing:
                (root / product).parent.mkdir(parents=True, exist_ok=True)
                os.replace(staging / product, root / product)
        if failure:
            raise failure
        os.replace(scratch, result)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        scratch.unlink(missing_ok=True)
    (executed / f"{notebook.name}.failed.ipynb").unlink(missing_ok=True)
    return result


def _check_parameters(notebook: Notebook, parameters: dict) -> None:
    cells = json.loads(notebook.path.read_text())["cells"]
    tagged = [c for c in cells if "parameters" in c.get("metadata", {}).get("tags", [])]
    tree = ast.parse("".join(tagged[0]["source"])) if tagged else ast.parse("")
    known = {target.id for node in tree.body if isinstance(node, ast.Assign) for target in node.targets}
    for name in parameters:
        if name not in known:
            raise InputError(f"{notebook.name}: unknown parameter {name!r}; the notebook has {sorted(known)}")


@contextmanager
def _environment(**values: str):
    before = {key: os.environ.get(key) for key in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value


def _execute(notebook: Notebook, parameters: dict, staging: Path, output: Path, failed: Path, keep_going: bool) -> None:
    """Run papermill into `output`; on failure keep `failed` and raise one line."""
    import nbformat
    import papermill

    folders = {f"JUPYTER_{k}_DIR": str(paths.BUILD / "jupyter" / k.lower()) for k in ("CONFIG", "DATA", "RUNTIME")}
    settings = {"IPYTHONDIR": paths.BUILD / "ipython", "MPLCONFIGDIR": paths.BUILD / "matplotlib"}
    settings = {key: str(value) for key, value in settings.items()} | folders
    settings |= {
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONHASHSEED": "0",
        "JUPYTER_PATH": "",
    }
    settings |= {
        "RAILREPRO_OUTPUT": str(staging),
        "RAILREPRO_ROOT": str(paths.ROOT),
        "PYDEVD_DISABLE_FILE_VALIDATION": "1",
    }
    _quiet_kernel(paths.BUILD / "ipython")
    with _environment(**settings):
        os.environ.pop("MPLBACKEND", None)
        try:
            bar = {"desc": notebook.name, "leave": False} if sys.stderr.isatty() else False
            options = {"parameters": parameters, "kernel_name": "python3", "cwd": str(paths.ROOT), "progress_bar": bar}
            options["allow_errors"] = keep_going
            papermill.execute_notebook(str(notebook.path), str(output), **options)
        except papermill.PapermillExecutionError as error:
            _deterministic(output)
            os.replace(output, failed)
            where = f"cell {error.exec_count}" if error.exec_count else "a cell"
            message = f"{error.ename}: {error.evalue}".splitlines()[0]
            raise InputError(f"{notebook.name}: {where} failed with {message} (kept {_short(failed)})") from None
    for i, cell in enumerate(nbformat.read(output, 4).cells):
        if cell.cell_type == "code" and cell.source.strip() and cell.execution_count is None:
            os.replace(output, failed)
            raise InputError(f"{notebook.name}: cell {i + 1} was not executed (kept {_short(failed)})")
    _deterministic(output)


def _quiet_kernel(folder: Path) -> None:
    """Kernel settings: neither notices about the transport on stderr nor the interrupt that ends an idle kernel."""
    profile = folder / "profile_default"
    profile.mkdir(parents=True, exist_ok=True)
    _write(profile / "ipython_kernel_config.py", "c = get_config()\nc.IPKernelApp.log_level = 50\n")


def _short(path: Path) -> str:
    return str(path.relative_to(paths.ROOT)) if path.is_relative_to(paths.ROOT) else str(path)


def _deterministic(path: Path) -> None:
    """Remove what differs between two equal runs: times, metadata of papermill, ids of injected cells."""
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


def _write(path: Path, text: str) -> None:
    scratch = path.with_name(f"{path.name}.{os.getpid()}.part")
    scratch.write_text(text)
    os.replace(scratch, path)


def _record(notebook: Notebook, products: dict[str, str], inputs: str) -> None:
    """Enter products into data/MANIFEST.csv and figures/MANIFEST.csv under a lock."""
    paths.BUILD.mkdir(exist_ok=True)
    with open(paths.BUILD / "manifest.lock", "w") as guard:
        fcntl.flock(guard, fcntl.LOCK_EX)
        for folder in ("data", "figures"):
            file = paths.ROOT / folder / "MANIFEST.csv"
            rows = {}
            if file.exists():
                with file.open(newline="") as stream:
                    rows = {row["path"]: row for row in csv.DictReader(stream)}
            rows = {path: row for path, row in rows.items() if row["made_by"] != notebook.name}
            for product, digest in products.items():
                if product.startswith(folder + "/"):
                    seed = "" if notebook.seed is None else notebook.seed
                    values = {"path": product, "sha256": digest, "made_by": notebook.name}
                    rows[product] = values | {"inputs_sha256": inputs, "seed": seed}
            if rows:
                lines = ["path,sha256,made_by,inputs_sha256,seed"]
                lines += [",".join(str(value) for value in rows[path].values()) for path in sorted(rows)]
                _write(file, "\n".join(lines) + "\n")


def strip() -> None:
    """Remove outputs, execution counts and foreign metadata from the notebooks; name cells c01, c02, …"""
    for path in sorted(paths.NOTEBOOKS.glob("*.ipynb")):
        content = json.loads(path.read_text())
        for i, cell in enumerate(content["cells"]):
            cell["id"] = f"c{i + 1:02d}"
            tags = cell.get("metadata", {}).get("tags")
            cell["metadata"] = {"tags": tags} if tags else {}
            if cell["cell_type"] == "code":
                cell |= {"outputs": [], "execution_count": None}
        kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
        content["metadata"] = {"kernelspec": kernel, "language_info": {"name": "python"}}
        _write(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def html() -> Path:
    """Executed notebooks as an HTML book in build/html; returns its index."""
    from nbconvert import HTMLExporter

    folder = paths.BUILD / "html"
    folder.mkdir(parents=True, exist_ok=True)
    exporter = HTMLExporter()
    items = []
    for notebook in chain():
        source = paths.BUILD / "notebooks" / f"{notebook.name}.ipynb"
        body, _ = exporter.from_filename(str(source))
        back = '<p style="margin:1em 4em"><a href="index.html">all notebooks</a></p>'
        (folder / f"{notebook.name}.html").write_text(body.replace("<main>", back + "<main>", 1))
        items.append(f'<li><a href="{notebook.name}.html">{notebook.name[:2]} {notebook.title}</a></li>')
    report = paths.ROOT / "REPLICATION.md"
    link = ""
    if report.exists():
        _page(folder / "REPLICATION.html", "Replication report", _report_html(report.read_text(), folder))
        link = '<p><a href="REPLICATION.html">Replication report: every claim with its verdict</a></p>'
    index = folder / "index.html"
    _page(index, "railrepro", f"<h1>railrepro: the notebooks</h1>{link}<ol>{''.join(items)}</ol>")
    return index


def _page(path: Path, title: str, body: str) -> None:
    style = (
        "<style>body{font:16px/1.6 serif;max-width:70em;margin:3em auto;padding:0 1em}"
        "td,th{padding:.2em .6em;border-bottom:1px solid #ccc;text-align:left;vertical-align:top}"
        "img{max-width:100%}</style>"
    )
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>{style}'
    _write(path, f"{head}{body}</html>\n")


def _report_html(text: str, folder: Path) -> str:
    """The report with its links turned to pages of the book and to copies of the figures and tables."""
    from nbconvert.filters import markdown2html

    body = markdown2html(text)
    for target, cell in sorted(set(re.findall(r'(?:href|src)="([^"#:]+)(#[^"]*)?"', body))):
        source = paths.ROOT / target
        if target.startswith("notebooks/"):
            body = body.replace(f'"{target}{cell}"', f'"{source.stem}.html{cell}"')
        elif source.is_file():
            (folder / target).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, folder / target)
    return body


def verify_tolerance() -> dict:
    """Tolerances of a comparison of two runs, the table [verify] of chain.toml."""
    return tomllib.loads((paths.NOTEBOOKS / "chain.toml").read_text())["verify"]


def main(arguments: list[str] | None = None) -> int:
    """Command line: rules, run NAME, html, strip."""
    parser = argparse.ArgumentParser(prog="python -m railrepro.chain.pipeline", description=__doc__.splitlines()[0])
    parser.add_argument("command", choices=("rules", "run", "html", "strip"))
    parser.add_argument("name", nargs="?")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.command == "rules":
            print(rules())
        elif chosen.command == "run":
            refresh(chosen.name)
        elif chosen.command == "html":
            print(html())
        else:
            strip()
    except InputError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; nothing half-written, run again to resume", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
