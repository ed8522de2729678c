"""Linear algebra with one thread: how many there are decides in which order sums are taken, and so the last digits."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

_MAPS = Path("/proc/self/maps")
_STEM = "openblas_{}_num_threads"
_NAMES = (f"scipy_{_STEM}64_", f"scipy_{_STEM}", f"{_STEM}64_", _STEM)


@lru_cache
def _switches() -> list[tuple[Callable, Callable]]:
    """Functions that get and set the number of threads of each OpenBLAS that is loaded; NumPy, SciPy have one each."""
    lines = _MAPS.read_text().splitlines() if _MAPS.exists() else []
    files = {line.split(maxsplit=5)[-1] for line in lines if "openblas" in line}
    found = []
    for library in (ctypes.CDLL(file) for file in sorted(files)):
        for name in _NAMES:
            if hasattr(library, name.format("set")):
                found.append((getattr(library, name.format("get")), getattr(library, name.format("set"))))
                break
    return found


_LOCK = threading.Lock()
_inside = 0
_before: list[int] = []


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra of NumPy and SciPy with one thread for a block, whatever the environment says.

    Blocks may overlap in several Python threads. Where there is no OpenBLAS, or the system does not report what is
    loaded, nothing changes.
    """
    global _inside, _before
    with _LOCK:
        if _inside == 0:
            _before = [get() for get, _ in _switches()]
            for _, switch in _switches():
                switch(1)
        _inside += 1
    try:
        yield
    finally:
        with _LOCK:
            _inside -= 1
            if _inside == 0:
                for (_, switch), number in zip(_switches(), _before, strict=True):
                    switch(number)
