"""What a notebook reads: files below data/ and figures/, and entries of some; noted on request, for the chain."""

from __future__ import annotations

import os
import sys
from collections import UserDict
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

LOG = "RAILREPRO_READS"
"""Environment variable with the file in which a process and those that it starts note what they read."""
ALL = "*"
"""Stands for all entries of a file."""
_noted: set[tuple[str, str, str]] = set()
Value = TypeVar("Value")


def _note(file: str, entry: str) -> None:
    log = os.environ.get(LOG)
    if log and (log, file, entry) not in _noted:
        _noted.add((log, file, entry))
        with open(log, "a", encoding="utf-8") as stream:
            stream.write(f"{file}\t{entry}\n")


def follow(root: Path) -> None:
    """From now on note each file below data/ and figures/ of a checkout that this process opens to read it."""

    def opened(event: str, arguments: tuple) -> None:
        if event != "open" or not isinstance(arguments[0], str | os.PathLike):
            return
        _, mode, flags = arguments
        if set(mode or "") & set("wax+") or (not mode and flags & (os.O_WRONLY | os.O_RDWR)):
            return
        file = os.path.abspath(arguments[0])
        for base in (os.environ.get("RAILREPRO_OUTPUT"), str(root)):
            name = os.path.relpath(file, base) if base and file.startswith(base + os.sep) else ""
            if name.startswith(("data/", "figures/")):
                _note(name, "")

    if os.environ.get(LOG):
        sys.addaudithook(opened)


class Entries(UserDict[str, Value]):
    """Entries of a data file by name that note which of them are taken; going through them takes all."""

    def __init__(self, entries: dict[str, Value], file: str):
        super().__init__(entries)
        self._file = file

    def __getitem__(self, name: str) -> Value:
        _note(self._file, name)
        return super().__getitem__(name)

    def __iter__(self) -> Iterator[str]:
        _note(self._file, ALL)
        return super().__iter__()
