"""Where files are, products also in another folder; and which of them a notebook reads, noted for the chain.

The checkout is the folder above this package, or `RAILREPRO_ROOT`. An installed package has none: it carries a copy of
the inputs, and what it writes goes to the working folder. With `RAILREPRO_OUTPUT` set, `product` writes below that
folder and `source` prefers a file there, so that tests and staging touch no committed products. A notebook that is run
by hand, as in JupyterLab, writes into build/tried/NAME: only the chain, which runs notebooks whole, renews products.
"""

from __future__ import annotations

import os
import sys
from collections import UserDict
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

_PACKAGE = Path(__file__).resolve().parent
_GIVEN = os.environ.get("RAILREPRO_ROOT")
INSTALLED = not _GIVEN and (_PACKAGE / "data").is_dir()
"""Whether the package is installed with its copy of the inputs, so that there is no checkout."""
ROOT = Path.cwd() if INSTALLED else Path(_GIVEN or _PACKAGE.parent)
"""Folder of the checkout, or the working folder where there is none."""
DATA, FIGURES, NOTEBOOKS, BUILD = (ROOT / name for name in ("data", "figures", "notebooks", "build"))
READS = "RAILREPRO_READS"
"""Environment variable with the path of a log. This process and its children append to it the names of files they
read."""
ALL = "*"
"""Entry in the log of `READS` that stands for all entries of a file."""
_noted: set[tuple[str, str, str]] = set()
Value = TypeVar("Value")


def product(relative: str) -> Path:
    """Path to write the product `relative` to, such as "data/results/f.csv". Missing folders are made. It is in the
    checkout, or in the folder that products are redirected to (see the head of this module)."""
    path = (_redirected() or ROOT) / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def source(relative: str) -> Path:
    """Path to read an input or a product from; `relative` is its path in the checkout, such as "data/vehicle.toml". The
    first place that has it counts: redirected products, the copy in an installed package, the checkout."""
    redirected = _redirected()
    places = [*([redirected] if redirected else []), *([_PACKAGE] if INSTALLED else [])]
    return next((place / relative for place in places if (place / relative).exists()), ROOT / relative)


def _redirected() -> Path | None:
    """Folder that takes the products in place of the checkout."""
    given = os.environ.get("RAILREPRO_OUTPUT")
    if given:
        return Path(given)
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None or not (NOTEBOOKS / "chain.toml").exists():
        return None
    notebook = os.environ.get("JPY_SESSION_NAME") or shell.user_ns.get("__vsc_ipynb_file__") or "session"
    return BUILD / "tried" / Path(notebook).stem


def _note(file: str, entry: str) -> None:
    log = os.environ.get(READS)
    if log and (log, file, entry) not in _noted:
        _noted.add((log, file, entry))
        with open(log, "a", encoding="utf-8") as stream:
            stream.write(f"{file}\t{entry}\n")


def _opened(event: str, arguments: tuple) -> None:
    """Note each file below data/ and figures/ that this process opens to read it; an audit hook."""
    if event != "open" or not isinstance(arguments[0], str | os.PathLike):
        return
    _, mode, flags = arguments
    if set(mode or "") & set("wax+") or (not mode and flags & (os.O_WRONLY | os.O_RDWR)):
        return
    file = os.path.abspath(arguments[0])
    for base in (os.environ.get("RAILREPRO_OUTPUT"), str(ROOT)):
        name = os.path.relpath(file, base) if base and file.startswith(base + os.sep) else ""
        if name.startswith(("data/", "figures/")):
            _note(name, "")


if os.environ.get(READS):
    sys.addaudithook(_opened)


class Entries(UserDict[str, Value]):
    """Dict of the entries of a data file by name, which notes look-ups in the log file that `READS` names.

    A look-up appends the line "file<tab>name", an iteration the line "file<tab>*". `file` is the name of the data file,
    such as "data/scenarios.toml".
    """

    def __init__(self, entries: dict[str, Value], file: str):
        super().__init__(entries)
        self._file = file

    def __getitem__(self, name: str) -> Value:
        _note(self._file, name)
        return super().__getitem__(name)

    def __iter__(self) -> Iterator[str]:
        _note(self._file, ALL)
        return super().__iter__()
