"""What products depend on: hashes of inputs, stamps of runs, and the manifests that tell where each product comes from.

Staleness is decided by content, never by time.
"""

from __future__ import annotations

import ast
import csv
import fcntl
import hashlib
import json
import os
from functools import cache
from pathlib import Path

from railrepro import paths
from railrepro.chain.graph import Notebook


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def file_hash(path: Path) -> str:
    """SHA-256 of a file in hexadecimal, or "missing"."""
    return _hash(path.read_bytes()) if path.exists() else "missing"


@cache
def _imports(text: str) -> frozenset[str]:
    """Names of railrepro modules that a piece of Python imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("railrepro")}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("railrepro"):
            found |= {str(node.module)} | {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def _module_file(module: str) -> Path | None:
    base = paths.ROOT / Path(*module.split("."))
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.exists()), None)


def _code(notebook: Notebook) -> list[str]:
    cells = json.loads(notebook.path.read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def inputs_hash(notebook: Notebook, parameters: dict | None = None) -> str:
    """Hash of all that a notebook's products depend on: cells, parameters, reads, imported modules, environment."""
    cells = json.loads(notebook.path.read_text())["cells"]
    parts: dict[str, object] = {"cells": ["".join(cell["source"]) for cell in cells]}
    parts["parameters"] = notebook.parameters if parameters is None else parameters
    pending, modules = [module for code in _code(notebook) for module in _imports(code)], {}
    while pending:
        file = _module_file(pending.pop())
        if file is None or str(file) in modules:
            continue
        modules[str(file)] = file_hash(file)
        pending += _imports(file.read_text())
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


def is_fresh(notebook: Notebook) -> bool:
    """Whether inputs and products are those of the last successful run; without a readable stamp they are not."""
    stamp = _stamp(notebook)
    if not stamp.exists():
        return False
    try:
        known = json.loads(stamp.read_text())
    except ValueError:
        return False
    return known == {"inputs": inputs_hash(notebook), "products": products_hash(notebook)}


def write(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    scratch = path.with_name(f"{path.name}.{os.getpid()}.part")
    scratch.write_text(text)
    os.replace(scratch, path)


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
    stamp = _stamp(notebook)
    stamp.parent.mkdir(parents=True, exist_ok=True)
    write(stamp, json.dumps({"inputs": inputs, "products": products}, indent=1))


def _enter(notebook: Notebook, products: dict[str, str], inputs: str) -> None:
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
                write(file, "\n".join(lines) + "\n")
