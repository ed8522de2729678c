"""Paths of inputs and products, and the record of files that a notebook reads. The checkout is the folder above this
package, or `RAILREPRO_ROOT`. An installed package has no checkout: it contains a copy of the inputs and writes to the
working folder. If `RAILREPRO_OUTPUT` is set, `product` writes below that folder and `source` prefers files there. A
notebook or IPython writes below build/tried/NAME, as only the complete run of all notebooks renews the products."""

import os
import sys
from collections import UserDict
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

_PACKAGE = Path(__file__).resolve().parent
_GIVEN = os.environ.get("RAILREPRO_ROOT")
INSTALLED = not _GIVEN and (_PACKAGE / "data").is_dir()
"""Whether the package is installed with a copy of the inputs, without a checkout."""
ROOT = Path.cwd() if INSTALLED else Path(_GIVEN or _PACKAGE.parent)
"""Folder of the checkout, or the working folder if there is none."""
DATA, FIGURES, NOTEBOOKS, BUILD = (ROOT / name for name in ("data", "figures", "notebooks", "build"))
READS = "RAILREPRO_READS"
"""Environment variable with the path of a log, to which this process and its children append the files they read."""
ALL = "*"
"""Mark in the log of `READS` for all entries of a file."""
_noted: set[tuple[str, str, str]] = set()
Value = TypeVar("Value")


def product(relative: str) -> Path:
    """Return the path to write a product, such as "data/results/f.csv", and create its folder, not the file. It is
    below the folder in the environment variable `RAILREPRO_OUTPUT`, else in a notebook or IPython below
    build/tried/NAME of the checkout, else below `ROOT`, the checkout (or working folder)."""
    path = (_redirected() or ROOT) / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def source(relative: str) -> Path:
    """Return the path from which an input or a product, such as "data/vehicle.toml", is read. The first folder that has
    it counts: the one to which products are redirected, the installed package, else the checkout."""
    folders = [folder for folder in (_redirected(), _PACKAGE if INSTALLED else None) if folder]
    return next((folder / relative for folder in folders if (folder / relative).exists()), ROOT / relative)


def _redirected() -> Path | None:
    """Return the folder to which products are redirected, None for the checkout."""
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
    """Audit hook: note each file below data/ and figures/ that this process opens for reading."""
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
    """Dict of the entries of the data file `file`, such as "data/scenarios.toml", that records which of them a notebook
    uses: a look-up appends the line "file<tab>name" to the log of `READS`, an iteration "file<tab>*". So a change of an
    entry concerns only the notebooks that used it."""

    def __init__(self, entries: dict[str, Value], file: str):
        super().__init__(entries)
        self._file = file

    def __getitem__(self, name: str) -> Value:
        _note(self._file, name)
        return super().__getitem__(name)

    def __iter__(self) -> Iterator[str]:
        _note(self._file, ALL)
        return super().__iter__()
