"""What makes the last digits the same on all machines: one thread and the same kernels of linear algebra and NumPy.

The commands of `python -m railrepro` set environment variables, which libraries read when they load (`fix`), and make
takes what this module prints as a script. All processors with AVX2 take the same path, also those with wider registers.
The matrices of a run are too small for OpenBLAS to use several threads, but without these commands the contact table
differs by rounding.
"""

import os
import sys
from functools import cache
from pathlib import Path

ALWAYS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Variables for one thread, so that sums are taken in the same order; they replace those of the caller."""
WITH_AVX2 = {
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F,AVX512CD,AVX512_SKX,AVX512_CLX,AVX512_CNL,AVX512_ICL,AVX512_SPR",
}
"""Variables for the kernels of AVX2, on processors that have it; each is left out if the caller has set it."""
_PROCESSOR = Path("/proc/cpuinfo")


@cache
def has_avx2() -> bool:
    """Whether the processor has the instructions AVX2 according to /proc/cpuinfo; False without that file."""
    return _PROCESSOR.exists() and "avx2" in _PROCESSOR.read_text(encoding="utf-8").split()


def variables() -> dict[str, str]:
    """Environment variables for reproducible digits as a dict from name to value. It holds `ALWAYS`. With AVX2 it also
    holds the entries of `WITH_AVX2` that the environment does not set already."""
    return ALWAYS | {name: value for name, value in WITH_AVX2.items() if has_avx2() and name not in os.environ}


def fix() -> None:
    """Set the environment variables of `variables` for this process and its children. Too late once NumPy is loaded."""
    if "numpy" not in sys.modules:
        os.environ.update(variables())


if __name__ == "__main__":
    print("\n".join(f"{name}={value}" for name, value in variables().items()))
