"""From CasADi functions to C source text, and from there to functions that are called.

`cache` compiles text and keeps the objects, `lanes` writes C for vector registers, `reciprocals` saves divisions.
"""

from __future__ import annotations

import ctypes
import hashlib
import pickle
import sys
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import TypeVar

import casadi as ca
import numpy as np

from railrepro import code
from railrepro.compile import cache
from railrepro.data import InputError, write

Built = TypeVar("Built")
ELEMENTARY = Path(__file__).with_name("elementary.c").read_text()
"""C of elementary functions that takes the place of the system's, see its head."""
PREAMBLE = Path(__file__).with_name("call.h").read_text()
"""C that stands before all hand-written C."""


def defines(values: dict) -> str:
    """C macros by name."""
    return "".join(f"#define {name} {value}\n" for name, value in values.items())


def source_text(functions: Sequence[ca.Function]) -> str:
    """C source of CasADi functions on `ELEMENTARY`, with their work-size and sparsity companions."""
    generator = ca.CodeGenerator("generated", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return ELEMENTARY + generator.dump()


def library(functions: Sequence[ca.Function], extra: str = "") -> ctypes.CDLL:
    """Load CasADi functions and extra C source as one shared object."""
    return ctypes.CDLL(str(cache.build(source_text(functions) + extra)))


class Call(ctypes.Structure):
    """A generated function with its memory, as C callers see it."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("evaluate", "arg", "res", "iw", "w")]


class CompiledFunction:
    """A function of a shared object with its work memory, evaluated on NumPy buffers without copies.

    `arguments` and `results` are contiguous float64 arrays in CasADi's column-major order; fill the first, call, read
    the second. Arrays may be shared between functions. `call` describes the function to callers written in C.
    """

    def __init__(self, library: ctypes.CDLL, function: ca.Function, arguments=None, results=None):
        self.name = function.name()
        self._symbol = getattr(library, self.name)
        self._symbol.restype = ctypes.c_int
        taken = [function.nnz_in(i) for i in range(function.n_in())]
        given = [function.nnz_out(i) for i in range(function.n_out())]
        self.arguments: list[np.ndarray] = arguments or list(map(np.zeros, taken))
        self.results: list[np.ndarray] = results or list(map(np.zeros, given))
        for size, array in zip([*taken, *given], [*self.arguments, *self.results], strict=True):
            if array.size != size or array.dtype != np.float64 or not array.flags.c_contiguous:
                raise ValueError(f"{self.name}: a contiguous float64 buffer of {size} numbers is needed")
        work = [ctypes.c_longlong() for _ in range(4)]
        getattr(library, self.name + "_work")(*map(ctypes.byref, work))
        n_arg, n_res, n_iw, n_w = (max(1, size.value) for size in work)
        self._memory = (
            _pointers(self.arguments, n_arg),
            _pointers(self.results, n_res),
            (ctypes.c_longlong * n_iw)(),
            (ctypes.c_double * n_w)(),
        )
        self.call = Call(ctypes.cast(self._symbol, ctypes.c_void_p), *map(ctypes.addressof, self._memory))

    def __call__(self) -> list[np.ndarray]:
        """Evaluate `arguments` into `results` (returned as the same arrays)."""
        if self._symbol(*self._memory, 0):
            raise ArithmeticError(f"compiled function {self.name} reported a failure")
        return self.results


def _pointers(arrays: Sequence[np.ndarray], length: int) -> ctypes.Array:
    """C array of `length` pointers to the given float64 arrays (the rest null)."""
    return (ctypes.c_void_p * length)(*(array.ctypes.data for array in arrays))


def compiled(function: ca.Function) -> CompiledFunction:
    """One CasADi function as compiled code, with buffers of its own."""
    return CompiledFunction(library([function]), function)


def stored(build: Callable[..., Built]) -> Callable[..., Built]:
    """Have a function look for what it built before, in this process (as `functools.cache`) and on disk.

    What is stored belongs to the code that built it: its key is the version of the library (`code.version`; `evidence`
    is above it and cannot reach a graph), those of Python and of the packages that compute, and the arguments. What has
    another key or is broken is built again.

    Parameters
    ----------
    build : callable
        Of arguments whose `repr` distinguishes them, and of nothing else but code; it gives CasADi functions and
        anything else that can be pickled.

    Raises
    ------
    ValueError
        For a function of any other place than the library: the key would not know its code.
    """
    name = f"{build.__module__}.{build.__qualname__}"
    if not name.startswith("railrepro.") or name.startswith("railrepro.evidence"):
        raise ValueError(f"{name} is not of the library; what it builds cannot be stored")

    @lru_cache
    @wraps(build)
    def look(*arguments):
        version = code.version()
        if version is None or not code.unchanged():
            return build(*arguments)
        asked = f"{name}{arguments!r}"
        key = hashlib.sha256(f"{version, sys.version, code.packages()}{asked}".encode()).digest()
        file = cache.cache_folder() / f"{hashlib.sha256(asked.encode()).hexdigest()[:24]}.graph"
        with suppress(OSError, zlib.error):
            content = file.read_bytes()
            if content.startswith(key):
                return pickle.loads(zlib.decompress(content[len(key) :]))
        built = build(*arguments)
        if code.unchanged():
            with suppress(InputError):  # it is built again next time
                write(file, key + zlib.compress(pickle.dumps(built), 1))
        return built

    return look
