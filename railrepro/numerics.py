"""What makes the last digits the same on all machines: one thread and the same kernels of linear algebra and NumPy.

The number of threads decides in which order sums are taken. The commands of `python -m railrepro` set environment
variables, which libraries read when they load (`fix`), and make takes them from here: as a script this prints them. All
processors with AVX2 take the same path, also those that know wider registers. The matrices of a run are too small for
OpenBLAS to share them out among threads, so a run without these commands has the same digits.
"""

import os
import sys
from pathlib import Path

ALWAYS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Sums are taken in the same order, whatever the caller says."""
WITH_AVX2 = {
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F,AVX512CD,AVX512_SKX,AVX512_CLX,AVX512_CNL,AVX512_ICL,AVX512_SPR",
}
"""Where the caller says nothing else."""
_PROCESSOR = Path("/proc/cpuinfo")


def variables() -> dict[str, str]:
    """Environment variables by name that this process should have and does not have."""
    words = _PROCESSOR.read_text().split() if _PROCESSOR.exists() else []
    return ALWAYS | {name: value for name, value in WITH_AVX2.items() if "avx2" in words and name not in os.environ}


def fix() -> None:
    """Set them for this process and those that it starts, unless NumPy is loaded and has read others."""
    if "numpy" not in sys.modules:
        os.environ.update(variables())


if __name__ == "__main__":
    print("\n".join(f"{name}={value}" for name, value in variables().items()))
