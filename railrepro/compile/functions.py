"""Compiled functions on buffers: fill the arguments, call, read the results."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import casadi as ca
import numpy as np

_POINTER = ctypes.POINTER(ctypes.c_double)


class CompiledFunction:
    """A function of a shared object with its work memory, evaluated on NumPy buffers without copies.

    `arguments` and `results` are contiguous float64 arrays in CasADi's column-major order; fill the first, call, read
    the second. Arrays may be shared between functions. `call` describes the function to callers written in C.
    """

    def __init__(self, library: ctypes.CDLL, function: ca.Function, arguments=None, results=None):
        self.name = function.name()
        self._symbol = getattr(library, self.name)
        self._symbol.restype = ctypes.c_int
        self.arguments, self.results = _buffers(function, arguments, results)
        sizes = [ctypes.c_longlong() for _ in range(4)]
        getattr(library, self.name + "_work")(*(ctypes.byref(size) for size in sizes))
        n_arg, n_res, n_iw, n_w = (size.value for size in sizes)
        self._memory = (
            pointer_array(self.arguments, n_arg),
            pointer_array(self.results, n_res),
            (ctypes.c_longlong * max(1, n_iw))(),
            (ctypes.c_double * max(1, n_w))(),
        )
        self.call = Call(ctypes.cast(self._symbol, ctypes.c_void_p), *map(_address, self._memory))

    def __call__(self) -> list[np.ndarray]:
        """Evaluate `arguments` into `results` (returned as the same arrays)."""
        if self._symbol(*self._memory, 0):
            raise ArithmeticError(f"compiled function {self.name} reported a failure")
        return self.results


class Call(ctypes.Structure):
    """A generated function with its memory, as C callers see it."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("evaluate", "arg", "res", "iw", "w")]


def _address(block) -> int:
    return ctypes.addressof(block)


def _buffers(function: ca.Function, arguments, results) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Given buffers after a check of their sizes, or new ones."""
    arguments = arguments or [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
    results = results or [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    sizes = [function.nnz_in(i) for i in range(function.n_in())] + [
        function.nnz_out(i) for i in range(function.n_out())
    ]
    for size, array in zip(sizes, [*arguments, *results], strict=True):
        if array.size != size or array.dtype != np.float64 or not array.flags.c_contiguous:
            raise ValueError(f"{function.name()}: a contiguous float64 buffer of {size} numbers is needed")
    return arguments, results


def pointer_array(arrays: Sequence[np.ndarray], length: int) -> ctypes.Array:
    """C array of `length` pointers to the given float64 arrays (the rest null)."""
    pointers = (_POINTER * max(1, length))()
    for i, array in enumerate(arrays):
        pointers[i] = array.ctypes.data_as(_POINTER)
    return pointers
