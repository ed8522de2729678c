"""What products depend on: hashes of inputs, stamps of runs, and the manifests that say where each product comes from.

Staleness is decided by content, never by time.
"""

from __future__ import annotations

import csv
import hashlib
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

from railrepro import paths
from railrepro.errors import InputError
from railrepro.evidence.chain.graph import Notebook, chain
from railrepro.evidence.runs import sources
from railrepro.files import alone, write, written
from railrepro.reads import ALL


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _content(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:
        return b"missing"


def file_hash(path: Path) -> str:
    """SHA-256 of a file in hexadecimal, that of "missing" where there is none that can be read."""
    return _hash(_content(path))


def cells(notebook: Notebook) -> list[dict]:
    """Cells of a notebook file; InputError when it cannot be read."""
    try:
        found = json.loads(notebook.path.read_text(encoding="utf-8"))["cells"]
        return [cell | {"source": "".join(cell["source"]), "cell_type": cell["cell_type"]} for cell in found]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{notebook.path.name}: cannot be read as a notebook ({error!r})") from error


class Inputs:
    """All that a notebook's products depend on, as it is now: cells, parameters, reads, modules, environment.

    Parameters
    ----------
    notebook : Notebook
    parameters : dict, optional
        Instead of those of the chain.
    """

    def __init__(self, notebook: Notebook, parameters: dict | None = None):
        content = cells(notebook)
        code = [cell["source"] for cell in content if cell["cell_type"] == "code"]
        self._rest: dict[str, object] = {"cells": [cell["source"] for cell in content]}
        self._rest["parameters"] = notebook.parameters if parameters is None else parameters
        self._rest["code"] = sources.closure(code, paths.ROOT / "railrepro")
        self._rest["environment"] = file_hash(paths.ROOT / "environment.lock")
        self._reads = {read: _content(paths.source(read)) for read in notebook.reads}

    def hash(self, entries: dict[str, list[str]] | None = None) -> str:
        """Hash of the inputs; of a TOML file with known entries only these count, by value."""
        known = entries or {}
        reads = {read: _entries(content, known.get(read, [ALL])) for read, content in self._reads.items()}
        return _hash(json.dumps(self._rest | {"reads": reads}, sort_keys=True).encode())


def _entries(content: bytes, names: list[str]) -> str:
    """Hash of the named entries of a TOML file, of its bytes when all count or it cannot be read."""
    if ALL not in names:
        try:
            table = tomllib.loads(content.decode())
            return _hash(repr([(name, table.get(name)) for name in sorted(names)]).encode())
        except (ValueError, RecursionError):
            pass
    return _hash(content)


def entries_read(log: Path) -> dict[str, list[str]]:
    """Entries by file that a run noted (`railrepro.reads`)."""
    found: dict[str, set[str]] = {}
    for line in _content(log).decode(errors="replace").splitlines() if log.exists() else ():
        file, _, entry = line.partition("\t")
        found.setdefault(file, set()).add(entry)
    return {file: sorted(names) for file, names in sorted(found.items())}


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
    known = _stamped(notebook)
    if known is None or not isinstance(known.get("entries"), dict):
        return False
    inputs = Inputs(notebook).hash(known["entries"])
    return (known["inputs"], known["products"]) == (inputs, products_hash(notebook))


def is_entered(notebook: Notebook) -> bool:
    """Whether the manifests hold what the stamp of a fresh notebook says."""
    known = _stamped(notebook) or {"products": {}, "inputs": ""}
    return all(text is None for _, text in _manifests(notebook, known["products"], known["inputs"]))


def enter_again(notebook: Notebook) -> None:
    """Enter the products of a fresh notebook where a manifest was lost or broken."""
    known = _stamped(notebook)
    if known is not None and not is_entered(notebook):
        _enter(notebook, known["products"], known["inputs"])


def minutes(notebook: Notebook) -> float:
    """How long its last run here took, else what chain.toml says (minutes)."""
    seconds = (_stamped(notebook) or {}).get("seconds")
    return seconds / 60 if isinstance(seconds, int | float) else notebook.minutes


def record(
    notebook: Notebook, inputs: Inputs, entries: dict[str, list[str]] | None = None, seconds: float | None = None
) -> None:
    """Enter the products of a run into the manifests and stamp it as fresh.

    Parameters
    ----------
    notebook : Notebook
    inputs : Inputs
        From before the run, so that an input edited meanwhile makes it stale.
    entries : dict, optional
        See `entries_read`; other files count as a whole.
    seconds : float, optional
        How long the run took.
    """
    products, digest = products_hash(notebook), inputs.hash(entries)
    _enter(notebook, products, digest)
    stamp = {"inputs": digest, "entries": entries or {}, "products": products, "seconds": seconds}
    write(_stamp(notebook), json.dumps(stamp, indent=1))


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
    others = {other.name for other in chain()} - {notebook.name}
    for folder in ("data", "figures"):
        file = paths.ROOT / folder / "MANIFEST.csv"
        rows = {path: row for path, row in _rows(file).items() if row["made_by"] in others}
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
