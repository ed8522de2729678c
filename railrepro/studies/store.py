"""Store of results on disk: a result is read again as long as its inputs and the code are the same. The key of an entry
is a hash of all that the computation reads, of the code that it can reach (`railrepro.code`), the compiler and the
packages. An entry is a file of two lines: a hash of key and content, and the content as JSON. An entry that does not
fit its hash is computed anew."""

import hashlib
import json
import os
import platform
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import code
from railrepro.compile import cache
from railrepro.data import InputError, write

FOLDER = "RAILREPRO_STORE"
_NUMERICS = ("RAILREPRO_CFLAGS", "OPENBLAS_CORETYPE", "NPY_DISABLE_CPU_FEATURES", "GLIBC_TUNABLES")
"""Environment variables that choose flags of the compiler and kernels of NumPy, BLAS and the mathematical library."""
Entry = tuple[dict, pd.DataFrame | None]
"""Stored result: a dict of plain values, and a DataFrame of numbers or None."""


def _plain(value) -> object:
    """Convert a value to nested lists of text, which are equal for equal values; TypeError if it has no such form."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53:
        return repr(float(value))
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    if isinstance(value, np.ndarray) and value.dtype != object:
        return [str(value.dtype), value.shape, hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()]
    if isinstance(value, pd.DataFrame):
        return [[name, _plain(value[name].to_numpy())] for name in value]
    if isinstance(value, dict):
        return [[_plain(key), _plain(value[key])] for key in sorted(value, key=repr)]
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return [type(value).__qualname__, *([one.name, _plain(getattr(value, one.name))] for one in fields(value))]
    raise TypeError(f"{type(value).__qualname__} has no stored form")


def key(module: str, *parts) -> str | None:
    """Key of a computation in the store: a hexadecimal hash; None when its result cannot be stored. `module` is the
    module that computes, `parts` are the name of the computation and all that it reads: numbers, text, arrays,
    DataFrames, dataclasses, lists and dicts of these. The result cannot be stored with a part of another type, for a
    module outside of railrepro, or when files of railrepro were edited after their import."""
    if not module.startswith("railrepro.") or not code.unchanged(within=1.0):
        return None
    try:
        return digest(machine(), code.version(), code.reached_from(module), *parts)
    except TypeError:
        return None


def digest(*parts) -> str:
    """SHA-256 (hexadecimal) of values, equal on all machines. TypeError unless they are numbers, text, arrays,
    DataFrames, dataclasses, lists and dicts of these."""
    return hashlib.sha256(json.dumps(_plain(parts)).encode()).hexdigest()


@lru_cache(maxsize=1)
def machine() -> dict[str, str]:
    """Return what decides the last digits of results, a dict: name -> text. Entries: environment variables, compiler,
    Python, processor, packages."""
    return {
        **{f"environment {name}": os.environ.get(name, "") for name in _NUMERICS},
        "the compiler": cache.identity(cache.compiler(), cache.flags()),
        "Python": sys.version,
        "the processor": platform.machine(),
        **{f"package {name}": version for name, version in code.packages().items()},
    }


def folder() -> Path | None:
    """Folder in which results of simulations are stored: that of the environment variable RAILREPRO_STORE, else
    build/store, or the user's cache where build cannot be written. None, so that nothing is read or stored, if the
    variable is "off" or no folder can be written. InputError if the variable is no absolute path."""
    given = os.environ.get(FOLDER, "")
    if given == "off":
        return None
    if given and not os.path.isabs(given):
        raise InputError(f"{FOLDER}={given!r}, an absolute folder or off is needed")
    return Path(given) if given else next(cache.folders("store"), None)


def entry(name: str | None, compute: Callable[[], Entry]) -> Entry:
    """Return the result stored under the key `name`, a pair of a dict and a DataFrame or None. If there is none, call
    `compute`, store its result and return it. Nothing is read or stored when `name` is None; nothing is stored when
    railrepro was edited meanwhile."""
    file = None if name is None or (base := folder()) is None else base / name[:2] / f"{name[2:]}.json"
    content, intact = b"", False
    if file is not None:
        with suppress(OSError):  # there is none
            mark, _, content = file.read_bytes().partition(b"\n")
            intact = mark == _mark(name, content)
    if not intact:
        row, table = compute()
        values = [row, None if table is None else table.to_dict("list")]
        content = json.dumps(values, default=np.generic.item).encode()
        if file is not None and code.unchanged():
            write(file, _mark(name, content) + b"\n" + content)
    row, columns = json.loads(content)
    return row, None if columns is None else pd.DataFrame(columns)


def _mark(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + content).hexdigest().encode()
