"""From CasADi functions to C source text, and from there to functions that are called.

`cache` compiles text and keeps the objects, `lanes` writes C for vector registers, `reciprocals` saves divisions.
"""

from __future__ import annotations

import ctypes
import hashlib
import math
import pickle
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar

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


def enumeration(names: Iterable[str]) -> str:
    """C constants that count from 0, or have the values that stand with them."""
    return f"enum {{ {', '.join(names)} }};\n"


def source_text(functions: Sequence[ca.Function]) -> str:
    """C source of CasADi functions on `ELEMENTARY`, with their work-size and sparsity companions."""
    generator = ca.CodeGenerator("generated", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return ELEMENTARY + generator.dump()


def library(functions: Sequence[ca.Function], extra: str = "") -> ctypes.CDLL:
    """Load CasADi functions and extra C source as one shared object."""
    return ctypes.CDLL(str(cache.build(source_text(functions) + extra)))


def structure(name: str, text: str, sizes: Mapping[str, int], **kinds: Any) -> Any:
    """The ctypes class of a struct of hand-written C.

    Parameters
    ----------
    name : str
        That of `typedef struct { … } name;` in `text`. Its members are double, casadi_int, one of `kinds`, pointers, or
        arrays of these.
    text : str
    sizes : mapping
        Constants in the lengths of arrays.
    kinds : type
        Further types of members by name.
    """
    known = {"double": ctypes.c_double, "casadi_int": ctypes.c_longlong} | kinds
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    (body,) = re.findall(rf"typedef struct(?: \w+)? {{([^{{}}]*)}} {name};", text)
    fields: list[tuple[str, Any]] = []
    for kind, members in re.findall(r"(?:const |struct )?(\w+) ([^;]+);", body):
        for member in members.split(","):
            found: Any = ctypes.c_void_p if "*" in member.partition("[")[0] else known[kind]
            entry, *lengths = re.findall(r"\w[\w *]*", member)
            for length in reversed(lengths):
                found *= math.prod(int(sizes.get(factor, factor)) for factor in re.findall(r"\w+", length))
            fields.append((entry, found))
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def initialiser(of: ctypes.Structure) -> str:
    """The numbers in a struct as a value in C, without its arrays and pointers."""
    scalars = [name for name, kind, *_ in of._fields_ if kind in (ctypes.c_double, ctypes.c_longlong)]
    return f"{{{', '.join(f'.{name} = {getattr(of, name)!r}' for name in scalars)}}}"


def arrays(of: ctypes.Structure) -> dict[str, np.ndarray]:
    """The arrays of numbers in a struct by name, on its memory."""
    kinds = {name: getattr(kind, "_type_", None) for name, kind, *_ in of._fields_}
    listed = [name for name, kind in kinds.items() if kind is ctypes.c_double or hasattr(kind, "_length_")]
    return {name: np.ctypeslib.as_array(getattr(of, name)) for name in listed}


class CompiledFunction:
    """A function of a shared object with its work memory, evaluated on NumPy buffers without copies.

    `arguments` and `results` are contiguous float64 arrays in CasADi's column-major order; fill the first, call, read
    the second.
    """

    def __init__(self, library: ctypes.CDLL, function: ca.Function):
        self.name = function.name()
        self._symbol = getattr(library, self.name)
        self._symbol.restype = ctypes.c_int
        taken = [function.nnz_in(i) for i in range(function.n_in())]
        given = [function.nnz_out(i) for i in range(function.n_out())]
        self.arguments, self.results = list(map(np.zeros, taken)), list(map(np.zeros, given))
        work = [ctypes.c_longlong() for _ in range(4)]
        getattr(library, self.name + "_work")(*map(ctypes.byref, work))
        n_arg, n_res, n_iw, n_w = (max(1, size.value) for size in work)
        self._memory = (
            _pointers(self.arguments, n_arg),
            _pointers(self.results, n_res),
            (ctypes.c_longlong * n_iw)(),
            (ctypes.c_double * n_w)(),
        )

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
