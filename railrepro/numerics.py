"""What makes the last digits the same on all machines: one thread and the same kernels of linear algebra and NumPy.

The number of threads decides in which order sums are taken. The commands of `python -m railrepro` set environment
variables, which libraries read when they load (`fix`), and make takes them from here: as a script this prints them. All
processors with AVX2 take the same path, also those that know wider registers. A run without these commands has one
thread for its time (`one_thread`).
"""

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

ALWAYS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Sums are taken in the same order, whatever the caller says."""
WITH_AVX2 = {
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F,AVX512CD,AVX512_SKX,AVX512_CLX,AVX512_CNL,AVX512_ICL,AVX512_SPR",
}
"""Where the caller says nothing else."""
_PROCESSOR, _LOADED = Path("/proc/cpuinfo"), Path("/proc/self/maps")
_STEM = "openblas_{}_num_threads"
_NAMES = (f"scipy_{_STEM}64_", f"scipy_{_STEM}", f"{_STEM}64_", _STEM)


def variables() -> dict[str, str]:
    """Environment variables by name that this process should have and does not have."""
    words = _PROCESSOR.read_text().split() if _PROCESSOR.exists() else []
    return ALWAYS | {name: value for name, value in WITH_AVX2.items() if "avx2" in words and name not in os.environ}


def fix() -> None:
    """Set them for this process and those that it starts, unless NumPy is loaded and has read others."""
    if "numpy" not in sys.modules:
        os.environ.update(variables())


@lru_cache
def _switches() -> list[tuple[Callable, Callable]]:
    """Functions that get and set the number of threads of each OpenBLAS that is loaded; NumPy, SciPy have one each."""
    lines = _LOADED.read_text().splitlines() if _LOADED.exists() else []
    files = {line.split(maxsplit=5)[-1] for line in lines if "openblas" in line}
    found = []
    for library in (ctypes.CDLL(file) for file in sorted(files)):
        name = next((name for name in _NAMES if hasattr(library, name.format("set"))), None)
        if name is not None:
            found.append((getattr(library, name.format("get")), getattr(library, name.format("set"))))
    return found


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra of NumPy and SciPy with one thread for a block, whatever the environment says.

    Where there is no OpenBLAS, or the system does not report what is loaded, nothing changes. Blocks do not overlap:
    CasADi's objects must not be used by two Python threads at a time.
    """
    before = [get() for get, _ in _switches()]
    try:
        for _, switch in _switches():
            switch(1)
        yield
    finally:
        for (_, switch), number in zip(_switches(), before, strict=True):
            switch(number)


if __name__ == "__main__":
    print("\n".join(f"{name}={value}" for name, value in variables().items()))
