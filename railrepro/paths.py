"""Where files are, products also in another folder; and which of them a notebook reads, noted for the chain.

In a checkout inputs and products lie where one edits them: in its `data`, `figures`, `notebooks`, `build`. The checkout
is the folder above this package, or `RAILREPRO_ROOT`. An installed package has none: it carries a copy of the inputs
(pyproject.toml says which), and what it writes goes to the working folder.

With `RAILREPRO_OUTPUT` set, `product` writes below that folder and `source` prefers a file there, so notebooks run in
tests or in staging without touching committed products. A notebook that is run by hand, as in JupyterLab, writes into
build/tried/NAME: only the chain, which runs notebooks whole and records where products come from, renews them.
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
"""Environment variable: path of a log to which this process and its children append the name of each file they read."""
ALL = "*"
"""Entry in the log of `READS` that stands for all entries of a file."""
_noted: set[tuple[str, str, str]] = set()
Value = TypeVar("Value")


def product(relative: str) -> Path:
    """Path (checkout or redirected) to write the product `relative` to, as "data/results/f.csv"; makes its folder."""
    path = (_redirected() or ROOT) / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def source(relative: str) -> Path:
    """Path to read an input or product from; `relative` is its path in the checkout, such as "data/vehicle.toml".

    Redirected products come first, then the copy of an installed package, then the checkout; a folder `data` where one
    works changes nothing for an installed package.
    """
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
    """Dict of the entries of a data file by name, which notes in the log of `READS` what is read of the file.

    A look-up appends the line "file<tab>name", an iteration "file<tab>*". `file` is the name of the file in the log,
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
