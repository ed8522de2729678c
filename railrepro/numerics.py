"""Same last digits of results on all machines: environment variables for one thread and the same kernels (routines for
one type of processor) in OpenBLAS and NumPy. Libraries read the variables when they load. The commands of `python -m
railrepro` set them (`fix`); make takes those that this module prints as a script. All processors with AVX2 use the same
kernels, also those with wider registers. Without the variables the contact table differs by rounding."""

import os
import sys
from functools import cache
from pathlib import Path

ALWAYS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""Variables for one thread, so that sums have the same order. They replace those of the caller."""
WITH_AVX2 = {
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F,AVX512CD,AVX512_SKX,AVX512_CLX,AVX512_CNL,AVX512_ICL,AVX512_SPR",
}
"""Variables for the kernels of AVX2. A variable that the caller has set stays."""
_PROCESSOR = Path("/proc/cpuinfo")


@cache
def has_avx2() -> bool:
    """Whether the processor has AVX2 (vector instructions), from /proc/cpuinfo; False without that file."""
    return _PROCESSOR.exists() and "avx2" in _PROCESSOR.read_text(encoding="utf-8").split()


def variables() -> dict[str, str]:
    """Environment variables that make results repeatable, name -> value: `ALWAYS`, for one thread, and on processors
    with AVX2 those of `WITH_AVX2` that are not set yet, which select the same kernels of OpenBLAS and NumPy."""
    return ALWAYS | {name: value for name, value in WITH_AVX2.items() if has_avx2() and name not in os.environ}


def fix() -> None:
    """Set the environment variables `variables` for this process and its children, so that results have the same last
    digits on all machines. Without effect if NumPy is loaded, as it has read them."""
    if "numpy" not in sys.modules:
        os.environ.update(variables())


if __name__ == "__main__":
    print("\n".join(f"{name}={value}" for name, value in variables().items()))
