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
"""C source of elementary functions (sin, exp, …) that replace the system's and give the same bits on all machines."""
PREAMBLE = Path(__file__).with_name("call.h").read_text()
"""C source that stands before all hand-written C."""


def defines(values: dict) -> str:
    """C lines `#define NAME VALUE` of a dict from names to values."""
    return "".join(f"#define {name} {value}\n" for name, value in values.items())


def enumeration(names: Iterable[str]) -> str:
    """C source of an enum of constants `names` that count from 0; an entry "NAME = value" sets its own value."""
    return f"enum {{ {', '.join(names)} }};\n"


def source_text(functions: Sequence[ca.Function]) -> str:
    """C source of `ELEMENTARY`, then of CasADi functions with the C functions for their work sizes and sparsity."""
    generator = ca.CodeGenerator("generated", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return ELEMENTARY + generator.dump()


def library(functions: Sequence[ca.Function], extra: str = "") -> ctypes.CDLL:
    """Loaded shared object, compiled or from the cache, of CasADi functions and `extra` C source that may call them."""
    return ctypes.CDLL(str(cache.build(source_text(functions) + extra)))


def structure(name: str, text: str, sizes: Mapping[str, int], **kinds: Any) -> Any:
    """Make the subclass of `ctypes.Structure` for a struct that hand-written C defines.

    Args:
        name (str): Name of the struct, as in `typedef struct { … } name;`. Its members are double, casadi_int, one of
            `kinds`, pointers, or arrays of these.
        text (str): C source that contains the struct.
        sizes (mapping): C constant -> its value, for constants in the lengths of array members.
        kinds (type): ctypes type of each further C type of members, by its name in C.
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
    """C initialiser `{.name = value, …}` of the single doubles and integers of a struct instance `of`."""
    scalars = [name for name, kind, *_ in of._fields_ if kind in (ctypes.c_double, ctypes.c_longlong)]
    return f"{{{', '.join(f'.{name} = {getattr(of, name)!r}' for name in scalars)}}}"


def arrays(of: ctypes.Structure) -> dict[str, np.ndarray]:
    """NumPy views of the members of a struct instance that are arrays of doubles, by name; memory is shared."""
    kinds = {name: getattr(kind, "_type_", None) for name, kind, *_ in of._fields_}
    listed = [name for name, kind in kinds.items() if kind is ctypes.c_double or hasattr(kind, "_length_")]
    return {name: np.ctypeslib.as_array(getattr(of, name)) for name in listed}


class CompiledFunction:
    """A CasADi function compiled into a shared object, with its work memory; evaluated on NumPy buffers without copies.

    `arguments` and `results` are lists with one float64 array for each input and output of `function`: its nonzeros in
    column-major order. Fill `arguments`, call, read `results`. `library` is the shared object.
    """

    def __init__(self, library: ctypes.CDLL, function: ca.Function):
        self._symbol = getattr(library, function.name())
        taken = [function.nnz_in(i) for i in range(function.n_in())]
        given = [function.nnz_out(i) for i in range(function.n_out())]
        self.arguments, self.results = list(map(np.zeros, taken)), list(map(np.zeros, given))
        work = [ctypes.c_longlong() for _ in range(4)]
        getattr(library, function.name() + "_work")(*map(ctypes.byref, work))
        n_arg, n_res, n_iw, n_w = (max(1, size.value) for size in work)
        arguments, results = ([array.ctypes.data for array in of] for of in (self.arguments, self.results))
        pointers = (ctypes.c_void_p * n_arg)(*arguments), (ctypes.c_void_p * n_res)(*results)
        self._memory = *pointers, (ctypes.c_longlong * n_iw)(), (ctypes.c_double * n_w)()

    def __call__(self) -> list[np.ndarray]:
        """Evaluate `arguments` into `results`, which is returned; what has no value becomes nan."""
        self._symbol(*self._memory, 0)
        return self.results


def compiled(function: ca.Function) -> CompiledFunction:
    """`CompiledFunction` of a CasADi function, compiled or from the cache, with buffers of its own."""
    return CompiledFunction(library([function]), function)


def stored(build: Callable[..., Built]) -> Callable[..., Built]:
    """Decorator that keeps the results of a function, in this process (as `functools.lru_cache`) and on disk.

    The key on disk is the version of the library (`code.version`), those of Python and of the packages that compute,
    and the arguments. A result with another key, or that cannot be read, is computed again.

    Args:
        build (callable): Function of the library, but not of `railrepro.evidence`, whose code the key does not know;
            of positional arguments whose `repr` distinguishes them. Its result depends on these and on code only, and
            can be pickled (CasADi functions can).
    """
    name = f"{build.__module__}.{build.__qualname__}"

    @lru_cache
    @wraps(build)
    def look(*arguments):
        if not code.unchanged():
            return build(*arguments)
        asked = f"{name}{arguments!r}"
        key = hashlib.sha256(f"{code.version(), sys.version, code.packages()}{asked}".encode()).digest()
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
