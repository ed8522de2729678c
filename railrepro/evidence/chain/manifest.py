"""What products depend on: hashes of inputs, stamps of runs, and the manifests that tell where each product comes from.

Staleness is decided by content, never by time.
"""

from __future__ import annotations

import ast
import csv
import hashlib
import json
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from railrepro import FACADE, paths
from railrepro.errors import InputError
from railrepro.evidence.chain.graph import Notebook
from railrepro.files import alone, write, written


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a file in hexadecimal, or "missing" where there is none that can be read."""
    try:
        return _hash(path.read_bytes())
    except OSError:
        return "missing"


@cache
def _imports(text: str) -> frozenset[str]:
    """Names of railrepro modules that a piece of Python imports; none if it is not valid, it will fail when it runs."""
    found: set[str] = set()
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):
        return frozenset()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            own = {alias.name for alias in node.names if alias.name.partition(".")[0] == "railrepro"}
            found |= own | ({f"railrepro.{name}" for name in FACADE} if own else set())  # any of them may follow
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "railrepro":
            found |= {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
    homes = {FACADE[name] for name in FACADE if {f"railrepro.{name}", "railrepro.*"} & found}
    return frozenset(found | homes | {home.rpartition(".")[0] for home in homes})


def _module_file(module: str) -> Path | None:
    base = paths.ROOT / Path(*module.split("."))
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.exists()), None)


def cells(notebook: Notebook) -> list[dict]:
    """Cells of a notebook file; InputError when it cannot be read."""
    try:
        found = json.loads(notebook.path.read_text(encoding="utf-8"))["cells"]
        return [cell | {"source": "".join(cell["source"]), "cell_type": cell["cell_type"]} for cell in found]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{notebook.path.name}: cannot be read as a notebook ({error!r})") from error


def inputs_hash(notebook: Notebook, parameters: dict | None = None) -> str:
    """Hash of all that a notebook's products depend on: cells, parameters, reads, imported modules, environment."""
    content = cells(notebook)
    parts: dict[str, object] = {"cells": [cell["source"] for cell in content]}
    parts["parameters"] = notebook.parameters if parameters is None else parameters
    code = [cell["source"] for cell in content if cell["cell_type"] == "code"]
    pending, modules = [module for source in code for module in _imports(source)], {}
    while pending:
        file = _module_file(pending.pop())
        if file is None or str(file) in modules:
            continue
        modules[str(file)] = file_hash(file)
        pending += _imports(file.read_text(errors="replace"))
    parts["modules"] = sorted((str(Path(f).relative_to(paths.ROOT)), h) for f, h in modules.items())
    extra = sorted((paths.ROOT / "railrepro").rglob("*.[ch]"))
    parts["files"] = [file_hash(paths.source(read)) for read in notebook.reads] + [file_hash(f) for f in extra]
    parts["environment"] = file_hash(paths.ROOT / "environment.lock")
    return _hash(json.dumps(parts, sort_keys=True).encode())


def products_hash(notebook: Notebook) -> dict[str, str]:
    """Hash of every product that a notebook declares, see `file_hash`."""
    return {product: file_hash(paths.ROOT / product) for product in notebook.products}


def _stamp(notebook: Notebook) -> Path:
    return paths.BUILD / "stamps" / f"{notebook.name}.json"


def _stamped(notebook: Notebook) -> dict | None:
    """Stamp of the last successful run; None without a readable one."""
    try:
        known = json.loads(_stamp(notebook).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return known if isinstance(known, dict) else None


def is_fresh(notebook: Notebook) -> bool:
    """Whether inputs and products are those of the last successful run; without a readable stamp they are not."""
    return _stamped(notebook) == {"inputs": inputs_hash(notebook), "products": products_hash(notebook)}


def is_entered(notebook: Notebook) -> bool:
    """Whether the manifests hold what the stamp of a fresh notebook says."""
    known = _stamped(notebook) or {"products": {}, "inputs": ""}
    return all(text is None for _, text in _manifests(notebook, known["products"], known["inputs"]))


def enter_again(notebook: Notebook) -> None:
    """Enter the products of a fresh notebook where a manifest was lost or broken."""
    known = _stamped(notebook)
    if known is not None and not is_entered(notebook):
        _enter(notebook, known["products"], known["inputs"])


def record(notebook: Notebook, inputs: str) -> None:
    """Enter the products of a run into the manifests and stamp it as fresh.

    Parameters
    ----------
    notebook : Notebook
    inputs : str
        `inputs_hash` from before the run, so that an input edited meanwhile makes it stale.
    """
    products = products_hash(notebook)
    _enter(notebook, products, inputs)
    write(_stamp(notebook), json.dumps({"inputs": inputs, "products": products}, indent=1))


_COLUMNS = ("path", "sha256", "made_by", "inputs_sha256", "seed")


def _rows(file: Path) -> dict[str, dict]:
    """Rows of a manifest by path, without those that are broken."""
    try:
        with file.open(newline="", encoding="utf-8", errors="replace") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, csv.Error):
        return {}
    return {row["path"]: row for row in rows if set(row) == set(_COLUMNS) and None not in row.values()}


def _manifests(notebook: Notebook, products: dict[str, str], inputs: str) -> Iterator[tuple[Path, str | None]]:
    """Both manifests with what they should hold, or None where they do."""
    seed = "" if notebook.seed is None else str(notebook.seed)
    for folder in ("data", "figures"):
        file = paths.ROOT / folder / "MANIFEST.csv"
        rows = {path: row for path, row in _rows(file).items() if row["made_by"] != notebook.name}
        for product, digest in products.items():
            if product.startswith(folder + "/"):
                rows[product] = dict(zip(_COLUMNS, (product, digest, notebook.name, inputs, seed), strict=True))
        lines = [",".join(_COLUMNS)] + [",".join(rows[path][name] for name in _COLUMNS) for path in sorted(rows)]
        text = "\n".join(lines) + "\n"
        yield file, text if rows and file_hash(file) != _hash(text.encode()) else None


def _enter(notebook: Notebook, products: dict[str, str], inputs: str) -> None:
    """Enter products into data/MANIFEST.csv and figures/MANIFEST.csv under a lock."""
    with written():
        paths.BUILD.mkdir(exist_ok=True)
        with alone(paths.BUILD / "manifest.lock"):
            for file, text in _manifests(notebook, products, inputs):
                if text is not None:
                    write(file, text)
