"""From CasADi functions to C source text and to compiled functions. `cache` compiles text and keeps the objects,
`lanes` writes C for vector registers, `reciprocals` saves divisions."""

import ctypes
import hashlib
import hmac
import json
import math
import os
import re
import reprlib
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import casadi as ca
import numpy as np
import pandas as pd

from railrepro import code, numerics
from railrepro.compile import cache
from railrepro.data import InputError, write

Built = TypeVar("Built")
ELEMENTARY = Path(__file__).with_name("elementary.c").read_text(encoding="utf-8")
"""C source of elementary functions (sin, exp, …) that give the same bits on all machines, unlike the system's."""
PREAMBLE = Path(__file__).with_name("call.h").read_text(encoding="utf-8")
"""C source that comes before all hand-written C."""


def defines(values: dict) -> str:
    """Write C source with a line `#define NAME VALUE` for each entry of a dict."""
    return "".join(f"#define {name} {value}\n" for name, value in values.items())


def enumeration(names: Iterable[str]) -> str:
    """Write C source of an enum with the constants `names`, which count from 0; "NAME = 5" sets a value."""
    return f"enum {{ {', '.join(names)} }};\n"


def source_text(functions: Sequence[ca.Function]) -> str:
    """Write CasADi functions as one C source text, after elementary functions that round alike on all machines."""
    generator = ca.CodeGenerator("generated", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return ELEMENTARY + generator.dump()


def library(functions: Sequence[ca.Function], extra: str = "") -> ctypes.CDLL:
    """Load CasADi functions as a shared object, compiled or from the cache; `extra` is C source that may call them."""
    return ctypes.CDLL(str(cache.build(source_text(functions) + extra)))


def structure(name: str, text: str, sizes: Mapping[str, int], **kinds: Any) -> Any:
    """Make the `ctypes.Structure` class of a struct that C source `text` defines as `typedef struct { … } name;`.
    Members may be double, casadi_int, pointers, types in `kinds` (C type -> its ctypes type), and arrays of these.
    `sizes` maps C constants in the length of an array to their values."""
    known = {"double": ctypes.c_double, "casadi_int": ctypes.c_longlong} | kinds
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    (body,) = re.findall(rf"typedef struct(?: \w+)? {{([^{{}}]*)}} {name};", text)
    fields: list[tuple[str, Any]] = []
    for kind, members in re.findall(r"(?:const |struct )?(\w+) ([^;]+);", body):
        for member in members.split(","):
            entry_type: Any = ctypes.c_void_p if "*" in member.partition("[")[0] else known[kind]
            entry, *lengths = re.findall(r"\w[\w *]*", member)
            for length in reversed(lengths):
                entry_type *= math.prod(int(sizes.get(factor, factor)) for factor in re.findall(r"\w+", length))
            fields.append((entry, entry_type))
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def initialiser(of: ctypes.Structure) -> str:
    """Write a struct instance as C text `{.name = value, …}`: its doubles and integers, not its arrays and pointers."""
    scalars = [name for name, kind, *_ in of._fields_ if kind in (ctypes.c_double, ctypes.c_longlong)]
    return f"{{{', '.join(f'.{name} = {getattr(of, name)!r}' for name in scalars)}}}"


def arrays(of: ctypes.Structure) -> dict[str, np.ndarray]:
    """Return the arrays of doubles in a struct instance: name -> NumPy view, which shares the memory of the struct."""
    entries = {name: getattr(kind, "_type_", None) for name, kind, *_ in of._fields_}
    listed = [name for name, kind in entries.items() if kind is ctypes.c_double or hasattr(kind, "_length_")]
    return {name: np.ctypeslib.as_array(getattr(of, name)) for name in listed}


def for_c(what: str, value: Any, shape: tuple[int, ...], largest: float = sys.float_info.max) -> np.ndarray:
    """Copy an argument for C as a float64 array. InputError, which calls it `what`, unless it has this shape and
    consists of numbers up to `largest` in magnitude."""
    try:
        given = np.asarray(value)
    except (TypeError, ValueError):  # a list of lists of different lengths
        given = np.empty(0, dtype=object)
    numbers = given.dtype.kind in "iuf" and given.shape == shape
    if not numbers or not (np.abs(given.astype(float)) <= largest).all():
        size, of = " x ".join(map(str, shape)), "" if largest == sys.float_info.max else f" of at most {largest:g}"
        raise InputError(f"{what} is {reprlib.repr(value)}, {size} finite numbers{of} (SI) are needed")
    return given.astype(float)


def in_c(name: str, largest: float = sys.float_info.max) -> Any:
    """Make a property for a class that wraps a C struct: the array `name` in `self._arrays`, a dict as from `arrays`.
    An assignment copies numbers up to `largest` in magnitude into it; InputError for others or another shape."""

    def assign(instance: Any, value: Any) -> None:
        array = instance._arrays[name]
        array[:] = for_c(f"{type(instance).__name__}: {name}", value, array.shape, largest)

    return property(lambda instance: instance._arrays[name], assign)


class CompiledFunction:
    """A CasADi function as compiled code, called without copies: fill `arguments`, call, read `results`. Both lists
    have one float64 array per input or output, with its structural nonzeros in column-major order. `shared` is a shared
    object that has the function; by default it is compiled, or read from the cache."""

    def __init__(self, function: ca.Function, shared: ctypes.CDLL | None = None):
        shared = library([function]) if shared is None else shared
        self._symbol = getattr(shared, function.name())
        self.arguments = [np.zeros(function.nnz_in(i)) for i in range(function.n_in())]
        self.results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        arguments, results = ([array.ctypes.data for array in of] for of in (self.arguments, self.results))
        pointers = (ctypes.c_void_p * function.sz_arg())(*arguments), (ctypes.c_void_p * function.sz_res())(*results)
        self._memory = *pointers, (ctypes.c_longlong * function.sz_iw())(), (ctypes.c_double * function.sz_w())()

    def __call__(self) -> list[np.ndarray]:
        """Evaluate `arguments` into `results` and return `results`."""
        self._symbol(*self._memory, 0)
        return self.results


def stored(build: Callable[..., Built]) -> Callable[..., Built]:
    """Decorator that keeps the results of a function in this process and on disk. A result on disk is used only if it
    has the seal of this user (`cache.seal`) and if the arguments, the library (`code.version`), Python, the packages
    that compute, and the kernels chosen for NumPy and BLAS are the same. `build` is a function of the library outside
    `railrepro.evidence`. Its arguments are positional, and their `repr` tells them apart. Its result depends on
    arguments and code only. The annotated type of the result is one that JSON has, `casadi.Function`, `DataFrame`, or a
    tuple or dataclass of these."""
    name = f"{build.__module__}.{build.__qualname__}"

    @lru_cache
    @wraps(build)
    def look(*arguments):
        if not code.unchanged():
            return build(*arguments)
        call = f"{name}{arguments!r}"
        kernels = [os.environ.get(variable) for variable in numerics.WITH_AVX2]
        key = f"{code.version(), sys.version, code.packages(), kernels}{call}"
        file = cache.cache_folder() / f"{hashlib.sha256(call.encode()).hexdigest()[:24]}.graph"
        with suppress(OSError):
            content = file.read_bytes()
            seal, packed = content[:32], content[32:]
            if hmac.compare_digest(seal, cache.seal(key, packed)):
                return _restored(get_type_hints(build)["return"], json.loads(zlib.decompress(packed)))
        built = build(*arguments)
        if code.unchanged():
            packed = zlib.compress(json.dumps(built, default=_plain).encode(), 1)
            with suppress(InputError):  # otherwise it is built again next time
                write(file, cache.seal(key, packed) + packed)
        return built

    return look


def _plain(value: Any) -> Any:
    """Return a stand-in for a value that JSON does not have."""
    if isinstance(value, ca.Function):
        return value.serialize()
    if isinstance(value, pd.DataFrame):
        return value.to_dict("list")
    return {one.name: getattr(value, one.name) for one in fields(value)}


def _restored(kind: Any, plain: Any) -> Any:
    """Make a value of the type `kind` from JSON with the stand-ins of `_plain`."""
    if kind is ca.Function:
        return ca.Function.deserialize(plain)
    if kind is pd.DataFrame:
        return pd.DataFrame(plain)
    if is_dataclass(kind):
        hints: Any = get_type_hints(kind)
        return kind(**{name: _restored(hints[name], entry) for name, entry in plain.items()})  # type: ignore[operator]
    if get_origin(kind) is tuple:
        first, *others = get_args(kind)
        kinds = [first] * len(plain) if others == [...] else [first, *others]
        return tuple(map(_restored, kinds, plain))
    return plain
