"""What makes the last digits the same on all machines: one thread and the same kernels of linear algebra and NumPy.

The number of threads decides in which order sums are taken. The commands of `python -m railrepro` set environment
variables, which libraries read when they load (`fix`), and make takes what this module prints as a script. All
processors with AVX2 take the same path, also those that know wider registers. The matrices of a run are too small for
OpenBLAS to share them out among threads, so a run without these commands has the same digits.
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
    """Whether the processor has AVX2, registers for four numbers, as far as the system tells."""
    return _PROCESSOR.exists() and "avx2" in _PROCESSOR.read_text().split()


def variables() -> dict[str, str]:
    """Environment variables by name: `ALWAYS`, and on a processor with AVX2 those of `WITH_AVX2` that are not set."""
    return ALWAYS | {name: value for name, value in WITH_AVX2.items() if has_avx2() and name not in os.environ}


def fix() -> None:
    """Set all `variables` in `os.environ`, for this process and its children; no effect once NumPy is loaded."""
    if "numpy" not in sys.modules:
        os.environ.update(variables())


if __name__ == "__main__":
    print("\n".join(f"{name}={value}" for name, value in variables().items()))
