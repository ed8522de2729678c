"""Graphs that were built once: CasADi functions beside the compiled objects, for processes that need them again.

A stored graph belongs to the code that built it. Its key is the version of the library (`code.version`; `evidence` is
above it and cannot reach a graph), those of Python and of the packages that compute, and the arguments. A graph with
another key, one that is broken, open to others or not the user's own is built again.
"""

from __future__ import annotations

import hashlib
import pickle
import sys
import zlib
from collections.abc import Callable
from functools import lru_cache, wraps
from typing import TypeVar

from railrepro import code
from railrepro.compile import cache
from railrepro.data import InputError, write

Built = TypeVar("Built")


def stored(build: Callable[..., Built]) -> Callable[..., Built]:
    """Have a function look for what it built before, in this process (as `functools.cache`) and on disk.

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
        asked = hashlib.sha256(f"{name}{arguments!r}".encode()).hexdigest()[:24]
        made_by = version, sys.version, code.packages()
        key = hashlib.sha256(f"{made_by}{name}{arguments!r}".encode()).hexdigest()
        try:
            file = cache.cache_folder() / f"{asked}.graph"
        except InputError:  # nowhere to store
            return build(*arguments)
        content = cache.own_file(file)
        if content is not None and content[:128] == _head(key, content[128:]):
            return pickle.loads(zlib.decompress(content[128:]))
        built = build(*arguments)
        if code.unchanged():
            packed = zlib.compress(pickle.dumps(built), 1)
            try:
                write(file, _head(key, packed) + packed)
                file.chmod(0o644)
            except (InputError, OSError):
                pass  # it is built again next time
        return built

    return look


def _head(key: str, packed: bytes) -> bytes:
    """Key and digest of what follows, 128 characters."""
    return f"{key}{hashlib.sha256(packed).hexdigest()}".encode()
