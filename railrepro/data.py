"""Reading and writing: TOML and JSON become checked, frozen dataclasses; a file is written completely or not at all. A
class marked with `table` states keys, types and defaults; `above` and `between` give a number its unit and range, and
`__post_init__` checks relations between keys. pydantic checks the content of a file and the arguments of the
constructor in the same way. Every fault is an `InputError`."""

import fcntl
import functools
import itertools
import json
import math
import numbers
import os
import re
import reprlib
import shutil
import stat
import sys
import tempfile
import threading
import tomllib
import typing
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic_core import core_schema

Number = int | float
LARGEST_FILE = 100_000_000
"""Size of the largest file that is read (bytes). The table of a track of 100 km has a third of it."""


class InputError(ValueError):
    """Invalid input. The message is one line: file or class, row or key, what was found and what is needed."""

    def __init__(self, message: str):
        super().__init__(" ".join(message.splitlines()))


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number. A bool is not a number."""
    real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    return real and abs(value) <= sys.float_info.max


@dataclass(frozen=True)
class Quantity:
    """Unit and permitted range of a number x, annotation of a field of type `float`, `int` or `Number`: low < x <=
    high. With `closed`, x = low is permitted as well. With `signed`, |x| must be in the range."""

    low: float
    high: float
    """Upper bound, which is permitted itself."""
    unit: str
    closed: bool = False
    """Whether `low` itself is permitted."""
    signed: bool = False
    """Whether the bounds apply to the magnitude, so that either sign is permitted."""

    def __get_pydantic_core_schema__(self, source, handler):
        def checked(value):
            self.check(value, whole=source is int)
            return float(value) if source is float else value

        return core_schema.no_info_plain_validator_function(checked)

    def check(self, value: Any, whole: bool = False) -> None:
        """Raise ValueError unless `value` is a number in the range. With `whole` it must be an integer."""
        kind = (int, numbers.Integral) if whole else (float, int, numbers.Real)
        if isinstance(value, kind) and not isinstance(value, bool):
            size: Any = abs(value) if self.signed else value
            inside = self.low < size <= self.high or (self.closed and size == self.low)
            if inside and (is_number(value) or abs(value) == math.inf):  # a whole number may be too large for a float
                return
        raise ValueError(f"is {reprlib.repr(value)}, {self.described(whole)} is needed")

    def described(self, whole: bool = False) -> str:
        """Describe the permitted range in words for an error message, such as "a number above 0 up to 2 m"."""
        number = f"a{' whole' * whole} number{' of either sign' * self.signed}"
        bounds = f"{'from' if self.closed else 'above'} {self.low:g}"
        bounds += f" up to {self.high:g}" if math.isfinite(self.high) else ""
        return f"{number} {bounds} {self.unit}".rstrip()


def above(low: float, high: float, unit: str = "", signed: bool = False) -> Quantity:
    """Annotation of a number x by unit and range: low < x <= high, or with `signed` low < |x| <= high, either sign."""
    return Quantity(low, high, unit, signed=signed)


def between(low: float, high: float, unit: str = "") -> Quantity:
    """Annotation of a number x by its unit and range, low <= x <= high."""
    return Quantity(low, high, unit, closed=True)


def require(what: str, value, allowed: Quantity | type, whole: bool = False) -> None:
    """Raise InputError unless `value` is in the range `allowed`, or an instance of the class `allowed`. `what` names
    the value in the message. With `whole` a number must be an integer."""
    if isinstance(allowed, Quantity):
        try:
            allowed.check(value, whole)
        except ValueError as fault:
            raise InputError(f"{what} {fault}") from None
    elif not isinstance(value, allowed):
        raise InputError(f"{what} is {reprlib.repr(value)}, an object of the class {allowed.__name__} is needed")


Plain = Annotated[Number, between(-1e12, 1e12)]
"""Annotation of a number without unit and of magnitude up to 1e12."""
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


def matching(pattern: str, needed: str) -> Any:
    """Annotation of a text field that must match a regular expression completely. `needed` says what is permitted."""

    def checked(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise ValueError(f"is {reprlib.repr(text)}, {needed} is needed")
        return text

    return pydantic.AfterValidator(checked)


Name = Annotated[str, matching(r"\w[\w .,+-]*", "a name of letters, digits, spaces and _ . , + -")]
"""Annotation of a name that may become part of a file name."""
Free = Annotated[Any, pydantic.AfterValidator(_finite)]
"""Annotation of a value of any type that contains neither NaN nor infinity."""


def _increasing(points):
    for before, after in itertools.pairwise(points):
        if not before[0] < after[0]:
            raise ValueError(f"goes from {before[0]} to {after[0]}, increasing first entries are needed")
    return points


INCREASING = pydantic.AfterValidator(_increasing)
"""Annotation of a list of points whose first entries increase."""


def _known_keys(cls: type, value):
    """Refuse an unknown key before pydantic checks the values; the message lists the known keys."""
    known: Any = cls.__dataclass_fields__  # type: ignore[attr-defined]
    unknown = value.keys() - known.keys() if isinstance(value, dict) else ()
    if unknown:
        raise ValueError(f"has the unknown key {min(unknown, key=str)!r}; allowed are {[*known]}")
    return value


@typing.dataclass_transform(frozen_default=True, field_specifiers=(field,))
def table(cls: type) -> type:
    """Class decorator: make a frozen dataclass whose constructor checks and converts arguments by annotations, as
    `build` does with a file. InputError names class and field if a value is wrong, a field unknown or missing."""
    cls._known_keys = pydantic.model_validator(mode="before")(classmethod(_known_keys))  # type: ignore
    made: Any = dataclass(frozen=True)(cls)
    names = [one.name for one in fields(made)]

    @functools.wraps(made.__init__)
    def checked(self, *values, **named):
        content = dict(zip(names, values, strict=False)) | named
        if len(content) < len(values) + len(named):
            raise InputError(f"{cls.__name__}: has more values than fields, at most one for each of {names} is needed")
        build(made, content, cls.__name__, self)

    made.__init__ = checked
    return made


def location(path: Path | str | None, default: Path | None = None) -> Path:
    """Return `path`, or `default` if it is None, as a `Path`. InputError if it is not a path."""
    chosen = default if path is None else path
    if not isinstance(chosen, str | os.PathLike) or not str(chosen) or "\0" in str(chosen):
        raise InputError(f"the path of a file is {reprlib.repr(chosen)}, a text or a Path is needed")
    return Path(chosen)


def text(path: Path) -> str:
    """Read a regular file in UTF-8. InputError if it is missing, not readable, or larger than `LARGEST_FILE`."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: is a folder, a pipe or a device, a regular file is needed")
        if status.st_size > LARGEST_FILE:
            raise InputError(f"{path}: has {status.st_size / 1e6:.0f} MB, at most {LARGEST_FILE / 1e6:.0f} MB are read")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise InputError(f"there is no file {path}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text in UTF-8 ({error.reason} at byte {error.start})") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error


def read(path: Path) -> Any:
    """Read a TOML file, or a JSON file (.json, .ipynb), as dicts and lists. InputError if it is invalid or empty."""
    kind, content = "JSON" if path.suffix in (".json", ".ipynb") else "TOML", text(path)
    try:
        content = json.loads(_parsed(content, kind))
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{path.name}: cannot be read as {kind} ({error})") from error
    if not content:
        raise InputError(f"{path.name}: is empty")
    return content


@functools.lru_cache(maxsize=32)
def _parsed(content: str, kind: str) -> str:
    """Convert the content of a file to JSON. JSON is cached, as every run reads the same files and may change dicts."""
    return json.dumps(json.loads(content, object_pairs_hook=_unique) if kind == "JSON" else tomllib.loads(content))


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Make a dict of a JSON object and refuse a key that occurs twice, which Python's parser permits."""
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise ValueError(f"the key {key!r} occurs twice")
        result[key] = value
    return result


_adapter = functools.cache(pydantic.TypeAdapter)


def build(kind: type, content: Any, where: str, instance: Any = None) -> Any:
    """Check dicts and lists as from `read` and convert them to instances of a class. `kind` is a class marked with
    `table`, or `dict[str, that class]` for named tables. `where` names the file in the message of the InputError, which
    tells the first fault. Only the constructors of such classes pass `instance`, their new object, which takes the
    values. The `context` that pydantic gives to validators is True for a file (no `instance`), where a
    `vehicle.parameters.Parameter` is a table with unit and source, and False in a constructor, where it is a number."""
    try:
        return _adapter(kind).validator.validate_python(content, self_instance=instance, context=instance is None)
    except pydantic.ValidationError as error:
        finding = error.errors(include_url=False)[0]
    missing = finding["type"] == "missing"
    key = ".".join(_keys(content, finding["loc"], missing))
    ours = "is missing" if missing else finding.get("ctx", {}).get("error")  # has a verb, unlike those of pydantic
    fault = ours or f"{finding['msg']}, found {reprlib.repr(finding['input'])}"
    raise InputError(f"{where}: {key}{'' if ours or not key else ':'} {fault}".replace(":  ", ": "))


def _keys(content: Any, location: tuple, missing: bool) -> Iterator[str]:
    """Yield the keys that lead to a fault: names, or numbers from 1 on for list entries without name. pydantic adds the
    classes of a union, which are left out."""
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
    """Write text (UTF-8) or bytes, and make missing folders. InputError if it fails: an old file is then unchanged."""
    part = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            part.write_bytes(content.encode() if isinstance(content, str) else content)
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); an old file is unchanged") from error


@contextmanager
def alone(lock: Path) -> Iterator[None]:
    """Context manager: wait until no other process holds the lock file `lock`, and hold it, so that processes do one
    task in turn. The lock is released at the end of the block or of the process."""
    with open(lock, "a", encoding="utf-8") as guard:
        fcntl.flock(guard, fcntl.LOCK_EX)
        yield


@contextmanager
def scratch() -> Iterator[Path]:
    """Context manager: make a temporary folder, removed at the end; first remove those of killed processes."""
    for left in Path(tempfile.gettempdir()).glob("railrepro-scratch-*"):
        with suppress(OSError), _locked(left):
            shutil.rmtree(left, ignore_errors=True)
    hidden = Path(tempfile.mkdtemp(prefix=".railrepro-scratch-"))  # from others, until it is locked
    folder = hidden.with_name(hidden.name[1:])
    with _locked(hidden):
        hidden.rename(folder)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on a folder. OSError if another process holds it or `folder` is not a folder."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)
