"""Data in and out: TOML and JSON to checked, frozen dataclasses, and files that are written whole or not at all.

A class marked with `table` states keys, types and defaults once; `above` and `between` add unit and range to a
number, `__post_init__` what holds between keys. pydantic checks. Wrong input of any kind is an `InputError`: one
sentence with file, key, what was found and what is needed.
"""

from __future__ import annotations

import fcntl
import functools
import itertools
import json
import math
import numbers
import os
import pickle
import reprlib
import sys
import threading
import tomllib
import typing
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic_core import core_schema

Number = int | float


class InputError(ValueError):
    """Input that is refused. The message is one line with file, row or key, what was found and what is needed."""

    def __init__(self, message: str):
        super().__init__(" ".join(message.splitlines()))


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number; a bool is not."""
    real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    return real and abs(value) <= sys.float_info.max


@dataclass(frozen=True)
class Quantity:
    """Unit and permitted range of a number, to annotate a field of type `float`, `int` or `Number`.

    Attributes:
        low, high (float): Bounds in `unit`; `high` itself is permitted.
        unit (str): Such as "m/s"; "" for none.
        closed (bool): Whether `low` itself is permitted.
        signed (bool): Whether the bounds apply to the magnitude, so that either sign is permitted.
    """

    low: float
    high: float
    unit: str
    closed: bool = False
    signed: bool = False

    def __get_pydantic_core_schema__(self, source, handler):
        def checked(value):
            self.check(value, whole=source is int)
            return float(value) if source is float else value

        return core_schema.no_info_plain_validator_function(checked)

    def check(self, value: Any, whole: bool = False) -> None:
        """Raise ValueError unless `value` is a number in the range; with `whole` it has to be an integer."""
        kind = numbers.Integral if whole else numbers.Real
        if isinstance(value, kind) and (is_number(value) or abs(value) == math.inf):
            size: Any = abs(value) if self.signed else value
            if self.low < size <= self.high or (self.closed and size == self.low):
                return
        number = f"a{' whole' * whole} number{' of either sign' * self.signed}"
        bounds = f"{'from' if self.closed else 'above'} {self.low:g}"
        bounds += f" up to {self.high:g}" if math.isfinite(self.high) else ""
        raise ValueError(f"is {reprlib.repr(value)}, {number} {bounds} {self.unit}".rstrip() + " is needed")


def above(low: float, high: float, unit: str = "", signed: bool = False) -> Quantity:
    """`Quantity` of numbers x with low < x <= high in `unit`; with `signed` low < |x| <= high."""
    return Quantity(low, high, unit, signed=signed)


def between(low: float, high: float, unit: str = "") -> Quantity:
    """`Quantity` of numbers x with low <= x <= high in `unit`."""
    return Quantity(low, high, unit, closed=True)


def require(what: str, value, allowed: Quantity | type, whole: bool = False) -> None:
    """Raise InputError unless an argument is valid.

    Args:
        what (str): Name of the argument in the message.
        value: The argument.
        allowed (Quantity or type): Range that it has to lie in, or class that it has to be an instance of.
        whole (bool): Whether the number has to be an integer; only with a range.
    """
    if isinstance(allowed, Quantity):
        try:
            allowed.check(value, whole)
        except ValueError as fault:
            raise InputError(f"{what} {fault}") from None
    elif not isinstance(value, allowed):
        raise InputError(f"{what} is {reprlib.repr(value)}, an object of the class {allowed.__name__} is needed")


def check_fields(settings: Any) -> None:
    """Raise InputError if a field of a dataclass instance is invalid: a number outside its annotated `Quantity`, or a
    value of another type in a field of type bool or str."""
    kind: Any = type(settings)
    for name, hint in _hints(kind, include_extras=True).items():
        base, *notes = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint, hint)
        for allowed in notes:
            if isinstance(allowed, Quantity) or allowed in (bool, str):
                require(f"{kind.__name__}: {name}", getattr(settings, name), allowed, whole=base is int)


Plain = Annotated[Number, between(-1e12, 1e12)]
"""Annotation of a number without unit, within +-1e12."""
NOT_EMPTY = pydantic.Field(min_length=1)
"""Annotation of a list or table with at least one entry."""
AS_GIVEN = pydantic.WrapValidator(lambda value, validate: (validate(value), value)[1])
"""Annotation of a table that is checked against the annotated class but stays a dict."""


def _finite(value):
    try:
        json.dumps(value, allow_nan=False, default=str)
    except ValueError:
        raise ValueError(f"has {reprlib.repr(value)}, finite numbers are needed") from None
    return value


Free = Annotated[Any, pydantic.AfterValidator(_finite)]
"""Annotation of any value that contains neither nan nor infinity."""


def _increasing(points):
    for before, after in itertools.pairwise(points):
        if not before[0] < after[0]:
            raise ValueError(f"goes from {before[0]} to {after[0]}, increasing first entries are needed")
    return points


INCREASING = pydantic.AfterValidator(_increasing)
"""Annotation of a list of points whose first entries increase."""


def _known_keys(cls: type, value):
    """Refuse an unknown key with a list of the known ones, before pydantic looks at the values."""
    known = [one.name for one in fields(cls)]
    unknown = sorted(value.keys() - set(known)) if isinstance(value, dict) else []
    if unknown:
        raise ValueError(f"has the unknown key {unknown[0]!r}; allowed are {known}")
    return value


@typing.dataclass_transform(frozen_default=True, field_specifiers=(field,))
def table(cls: type) -> type:
    """Class decorator for what `build` reads from a file: makes a frozen dataclass that refuses unknown and missing
    keys."""
    cls._known_keys = pydantic.model_validator(mode="before")(classmethod(_known_keys))  # type: ignore
    return dataclass(frozen=True)(cls)


def location(path: Path | str | None, default: Path | None = None) -> Path:
    """`path` as a `Path`; where it is None, `default`. InputError for anything that is no path."""
    path = default if path is None else path
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"path is {reprlib.repr(path)}, a path (str or Path) is needed")
    return Path(path)


def read(path: Path) -> Any:
    """Content of a TOML or JSON file as dicts and lists; the suffixes .json and .ipynb mean JSON. Raises InputError
    when it cannot be read or is empty."""
    kind = "JSON" if path.suffix in (".json", ".ipynb") else "TOML"
    try:
        content = pickle.loads(_parsed(path.read_text(encoding="utf-8"), kind))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path.name}: cannot be read as {kind} ({error})") from error
    if not content:
        raise InputError(f"{path.name}: is empty")
    return content


@functools.lru_cache(maxsize=32)
def _parsed(text: str, kind: str) -> bytes:
    """Content of a file, packed: its reader may change what it gets, and every run reads the same few files."""
    return pickle.dumps(json.loads(text) if kind == "JSON" else tomllib.loads(text))


_adapter = functools.lru_cache(pydantic.TypeAdapter)
_hints = functools.cache(typing.get_type_hints)


def build(kind: type, content: Any, where: str) -> Any:
    """Check the content of a file and convert it to instances of a class. InputError names the first fault.

    Args:
        kind (type): Class marked with `table`; `dict[str, that class]` for a file of named tables, which gives a dict.
        content (Any): Dicts and lists as from `read`.
        where (str): Name of the file in the message.
    """
    try:
        return _adapter(kind).validate_python(content)
    except pydantic.ValidationError as error:
        finding = error.errors(include_url=False)[0]
    missing = finding["type"] == "missing"
    place = ".".join(_keys(content, finding["loc"], missing))
    own = "is missing" if missing else finding.get("ctx", {}).get("error")
    fault = own or f"{finding['msg']}, found {reprlib.repr(finding['input'])}"
    raise InputError(f"{where}: {place}{'' if own or not place else ':'} {fault}".replace(":  ", ": "))


def _keys(content: Any, location: tuple, missing: bool) -> Iterator[str]:
    """Keys on the way to a fault: names, or numbers from 1 on for list entries without name; classes of a union are
    left out."""
    for step in location:
        try:
            content = content[step]
        except (KeyError, IndexError, TypeError):
            continue
        named = isinstance(content, dict) and isinstance(content.get("name"), str)
        yield str(step) if isinstance(step, str) else content["name"] if named else str(step + 1)
    if missing:
        yield str(location[-1])


def write(path: Path, content: str | bytes) -> None:
    """Write text (UTF-8) or bytes to a file completely or not at all. Missing folders are made. Raises InputError when
    it cannot be written; an existing file is then unchanged."""
    scratch = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            scratch.write_bytes(content.encode() if isinstance(content, str) else content)
            os.replace(scratch, path)
        finally:
            scratch.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); what was there is intact") from error


@contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Context manager that holds an exclusive lock on the file `lock`, after waiting for it. The lock ends with the
    context or with the process."""
    with open(lock, "a") as guard:
        fcntl.flock(guard, fcntl.LOCK_EX)
        yield
