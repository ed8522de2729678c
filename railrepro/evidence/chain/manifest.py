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

from railrepro import code, paths
from railrepro.errors import InputError
from railrepro.evidence.chain.graph import Notebook, chain
from railrepro.evidence.runs import store
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


Inputs = dict[str, str]
"""What a notebook's products depend on by its name, and the hash of each."""
EDITED = "an input was edited while it ran"


def inputs(notebook: Notebook, entries: dict[str, list[str]], parameters: dict | None = None) -> Inputs:
    """All that a notebook's products depend on as it is now, the same on all machines.

    Parameters
    ----------
    notebook : Notebook
    entries : dict
        Entries of TOML files that the last run took (`entries_read`); of all others each counts.
    parameters : dict, optional
        Instead of those of the chain.
    """
    content = cells(notebook)
    found = {"its cells": _hash(json.dumps([cell["source"] for cell in content]).encode())}
    given = notebook.parameters if parameters is None else parameters
    found["its parameters"] = _hash(json.dumps(given, sort_keys=True).encode())
    for read in notebook.reads:
        found |= _entries(read, _content(paths.source(read)), entries.get(read, [ALL]))
    found |= {f"package {name}": version for name, version in code.packages().items()}
    reached = code.reached(*(cell["source"] for cell in content if cell["cell_type"] == "code"))
    return found | ({EDITED: ""} if reached is None else reached)


def _entries(file: str, content: bytes, names: list[str]) -> Inputs:
    """Hashes of the named entries of a TOML file by value, or of each and their order; of another file its bytes."""
    try:
        table = tomllib.loads(content.decode()) if file.endswith(".toml") else None
    except (ValueError, RecursionError):
        table = None
    if table is None:
        return {file: _hash(content)}
    found = {} if ALL not in names else {f"{file}, names of entries": _hash(repr(list(table)).encode())}
    entries = table if ALL in names else names
    return found | {f"{file} [{name}]": _hash(repr(table.get(name)).encode()) for name in entries}


def digest(found: Inputs) -> str:
    """One hash of all inputs."""
    return _hash(json.dumps(found, sort_keys=True).encode())


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
    parts = ("entries", "inputs", "machine", "products")
    whole = isinstance(known, dict) and all(isinstance(known.get(part), dict) for part in parts)
    return known if whole else None


def why_stale(notebook: Notebook) -> str:
    """The input or product that is not that of the last successful run; "" when the notebook is fresh."""
    known = _stamped(notebook)
    if known is None:
        return "it has not run here"
    if not code.unchanged():
        return EDITED
    for found, before, words in (
        (store.machine(), known["machine"], ""),
        (inputs(notebook, known["entries"]), known["inputs"], ""),
        (products_hash(notebook), known["products"], " was changed or is missing"),
    ):
        changed = [name for name in {**found, **before} if found.get(name) != before.get(name)]
        if changed:
            more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
            return f"{changed[0]}{words}{more}"
    return ""


def is_entered(notebook: Notebook) -> bool:
    """Whether the manifests hold what the stamp of a fresh notebook says."""
    known = _stamped(notebook)
    return known is None or all(text is None for _, text in _manifests(notebook, known))


def enter_again(notebook: Notebook) -> None:
    """Enter the products of a fresh notebook where a manifest was lost or broken."""
    known = _stamped(notebook)
    if known is not None and not is_entered(notebook):
        _enter(notebook, known)


def minutes(notebook: Notebook) -> float:
    """How long its last run here took, else what chain.toml says (minutes)."""
    seconds = (_stamped(notebook) or {}).get("seconds")
    return seconds / 60 if isinstance(seconds, int | float) else notebook.minutes


def record(
    notebook: Notebook, before: Inputs, entries: dict[str, list[str]] | None = None, seconds: float | None = None
) -> None:
    """Enter the products of a run into the manifests and stamp it, as stale where an input was edited meanwhile.

    Parameters
    ----------
    notebook : Notebook
    before : dict
        Its `inputs` before the run, with all entries.
    entries : dict, optional
        See `entries_read`; other files count as a whole.
    seconds : float, optional
        How long the run took.
    """
    same = code.unchanged() and before == inputs(notebook, {})
    taken = inputs(notebook, entries or {}) if same else before | {EDITED: ""}
    known = {"inputs": taken, "machine": store.machine(), "products": products_hash(notebook)}
    _enter(notebook, known)
    stamp = {"entries": entries or {}, **known, "seconds": seconds}
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


def _manifests(notebook: Notebook, known: dict) -> Iterator[tuple[Path, str | None]]:
    """Both manifests with what they should hold, or None where they do."""
    seed = "" if notebook.seed is None else str(notebook.seed)
    others = {other.name for other in chain()} - {notebook.name}
    for folder in ("data", "figures"):
        file = paths.ROOT / folder / "MANIFEST.csv"
        rows = {path: row for path, row in _rows(file).items() if row["made_by"] in others}
        for product, content in known["products"].items():
            if product.startswith(folder + "/"):
                row = product, content, notebook.name, digest(known["inputs"]), seed
                rows[product] = dict(zip(_COLUMNS, row, strict=True))
        lines = [",".join(_COLUMNS)] + [",".join(rows[path][name] for name in _COLUMNS) for path in sorted(rows)]
        text = "\n".join(lines) + "\n"
        yield file, text if rows and file_hash(file) != _hash(text.encode()) else None


def _enter(notebook: Notebook, known: dict) -> None:
    """Enter products into data/MANIFEST.csv and figures/MANIFEST.csv under a lock."""
    with written():
        paths.BUILD.mkdir(exist_ok=True)
        with alone(paths.BUILD / "manifest.lock"):
            for file, text in _manifests(notebook, known):
                if text is not None:
                    write(file, text)
