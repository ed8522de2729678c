"""Checked reading of TOML and JSON: from a file to frozen dataclasses, or to one sentence on what is wrong with it.

A class marked with `table` states keys, types and defaults once; `above`, `between` and `steps` add unit and range to a
number, `__post_init__` what holds between keys. pydantic does the checking, because it converts nothing by itself and
names the place of every fault; this module words the first of them.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import numbers
import pickle
import reprlib
import sys
import tomllib
import typing
import warnings
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any

import pydantic
from pydantic_core import core_schema

from railrepro.errors import InputError

Number = int | float
_SENTENCES = {
    **dict.fromkeys(("dict_type", "dataclass_type", "model_attributes_type"), "is {found}, a table is needed"),
    "tuple_type": "is {found}, a list is needed",
    "too_short": "is empty, at least one entry is needed",
    "string_type": "is {found}, a text is needed",
    "bool_type": "is {found}, true or false is needed",
    "literal_error": "is {found}, allowed are {expected}",
    "union_tag_not_found": "lacks the key {discriminator}",
    "union_tag_invalid": "kind {tag!r} is not known; there are {expected_tags}",
}
"""What is said about a kind of fault that pydantic finds; other faults bring their own message."""


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number; truth values are none."""
    real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    return real and abs(value) <= sys.float_info.max


@dataclass(frozen=True)
class Quantity:
    """Unit and range of a number, as metadata of an annotated `float`, `int` (whole) or `Number` (kept as it is).

    Attributes
    ----------
    low, high : float
        Range; `high` is inclusive, `low` when `closed`.
    unit : str
    closed : bool
    signed : bool
        The range holds for the magnitude, the number may have either sign.
    usual : tuple of float, optional
        Magnitudes that numbers other than zero usually have; others are taken, with a warning that names the unit.
    """

    low: float
    high: float
    unit: str
    closed: bool = False
    signed: bool = False
    usual: tuple[float, float] = (0.0, math.inf)

    def __get_pydantic_core_schema__(self, source, handler):
        def checked(value):
            self.check(value, whole=source is int)
            return float(value) if source is float else value

        return core_schema.no_info_plain_validator_function(checked)

    def check(self, value: Any, whole: bool = False) -> None:
        """Refuse what is no (whole) number in the range with a ValueError."""
        if isinstance(value, bool) or not isinstance(value, numbers.Integral if whole else numbers.Real):
            needed = ("a whole number" if whole else "a number") + (self.unit and f" in {self.unit}")
            raise ValueError(f"is {reprlib.repr(value)}, {needed} is needed")
        size: Any = abs(value) if self.signed else value
        inside = self.low <= size <= self.high and (self.closed or self.low < size)
        if not inside or (isinstance(value, int) and not is_number(value)):
            raise ValueError(self.refusal(value))

    def doubt(self, value) -> str:
        """What is said about a possible number of unusual size; empty for others."""
        low, high = self.usual
        if not is_number(value) or value == 0 or low <= abs(value) <= high:
            return ""
        return f"= {value:g} is unusual, {low:g} to {high:g} {self.unit} are usual: is it in {self.unit}?"

    def refusal(self, value) -> str:
        """What is said about a number beyond the range."""
        found, unit = reprlib.repr(value), f" {self.unit}".rstrip()
        if self.closed:
            upto = f"to {self.high:g}" if math.isfinite(self.high) else "on"
            return f"= {found}, a number from {self.low:g} {upto}{unit} is needed"
        limit = f" and up to {self.high:g}" if math.isfinite(self.high) else ""
        sign = " of either sign" if self.signed else ""
        return f"is {found}, a number{sign} above {self.low:g}{limit}{unit} is needed"


def above(low: float, high: float, unit: str = "", signed: bool = False, usual=(0.0, math.inf)) -> Quantity:
    """Numbers above `low` and up to `high`."""
    return Quantity(low, high, unit, signed=signed, usual=usual)


def between(low: float, high: float, unit: str = "", usual=(0.0, math.inf)) -> Quantity:
    """Numbers from `low` to `high`."""
    return Quantity(low, high, unit, closed=True, usual=usual)


def require(what: str, value, allowed: Quantity | type | tuple[type, ...], whole: bool = False) -> None:
    """Refuse an argument (`what`) that is no (whole) number in a range, or no object of a class, with an InputError."""
    if isinstance(allowed, Quantity):
        try:
            allowed.check(value, whole)
        except ValueError as fault:
            raise InputError(f"{what} {fault}") from None
    elif not isinstance(value, allowed):
        names = " or ".join(kind.__name__ for kind in (allowed if isinstance(allowed, tuple) else (allowed,)))
        raise InputError(f"{what} is {reprlib.repr(value)}, an object of the class {names} is needed")


Plain = Annotated[Number, between(-1e12, 1e12)]
"""A number without unit."""
NOT_EMPTY = pydantic.Field(min_length=1)
"""Lists and tables with at least one entry."""


def _distinct(values):
    for value in values:
        if values.count(value) > 1:
            raise ValueError(f"has {value!r} {values.count(value)} times, once is needed")
    return values


DISTINCT = pydantic.AfterValidator(_distinct)
"""Lists without repetitions."""
Flag = Annotated[bool, pydantic.Strict()]
"""True or false, nothing that stands for it."""


def steps(name: str, low: float, high: float) -> pydantic.BeforeValidator:
    """Lists of [p_m, value] with increasing p_m (m) and values from `low` to `high`, read as tuples of tuples."""

    def checked(points):
        pairs = isinstance(points, list | tuple) and all(isinstance(p, list | tuple) and len(p) == 2 for p in points)
        found = reprlib.repr(points)
        if not pairs or not all(is_number(value) for point in points for value in point):
            raise ValueError(f"needs [p_m, {name}] pairs of numbers, found {found}")
        if not all(before[0] < after[0] for before, after in itertools.pairwise(points)):
            raise ValueError(f"needs [p_m, {name}] pairs with increasing p_m, found {found}")
        if not all(low <= value <= high for _, value in points):
            raise ValueError(f"has a {name} outside {low:g} to {high:g}, found {found}")
        return tuple(map(tuple, points))

    return pydantic.BeforeValidator(checked)


def _finite(value):
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        _finite(item)
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"has {value}, finite numbers are needed")
    return value


Free = Annotated[Any, pydantic.AfterValidator(_finite)]
"""Any value without numbers that are not finite."""
_doubted: list[str] = []


def _as_given(value, handler, info):
    _doubted.extend(_doubts(handler(value), info.field_name or ""))
    return value


AS_GIVEN = pydantic.WrapValidator(_as_given)
"""Checked against the annotated class, but kept as the table that it is."""


class _KeyFault(ValueError):
    """A key that a table lacks or should not have: what is wrong, its name, allowed keys."""


def _known_keys(cls: type, value):
    if isinstance(value, cls):
        return value
    known = {field.name: field.default is field.default_factory for field in fields(cls)}
    if not isinstance(value, dict):
        raise ValueError(f"is {reprlib.repr(value)}, a table with the keys {sorted(known)} is needed")
    for key in sorted(value.keys() - known):
        raise _KeyFault("has the unknown", key, f"; allowed are {sorted(known)}")
    for key in (key for key, needed in known.items() if needed and key not in value):
        raise _KeyFault("lacks the", key, "")
    return value


@typing.dataclass_transform(frozen_default=True)
def table(cls: type) -> type:
    """Make a frozen dataclass that a table of a file is read into; unknown and missing keys are refused."""
    cls._known_keys = pydantic.model_validator(mode="before")(classmethod(_known_keys))  # type: ignore
    return dataclass(frozen=True)(cls)


def location(path: Path | str | None, default: Path | None = None) -> Path:
    """A file by its path, or the default for None; InputError for anything but a path."""
    if path is None and default is not None:
        return default
    if not isinstance(path, str | Path):
        raise InputError(f"{reprlib.repr(path)} is no path of a file")
    return Path(path)


def read(path: Path) -> Any:
    """Content of a TOML or (by its suffix) JSON file; InputError when it cannot be read or is empty."""
    kind = "JSON" if path.suffix == ".json" else "TOML"
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


def build(kind: type, content: Any, where: str) -> Any:
    """Check content of a file and make it into a class.

    Parameters
    ----------
    kind : type
        Class marked with `table`, or `dict[str, such a class]` for a file of named tables.
    content : Any
        What `read` gave, or changes of it.
    where : str
        File that the sentence names.

    Raises
    ------
    InputError
        One sentence on the first fault: file, key, what was found, what is allowed. A number of unusual size, as of a
        wrong unit, is a warning.
    """
    _doubted.clear()
    try:
        built = _adapter(kind).validate_python(content)
    except pydantic.ValidationError as error:
        finding = error.errors(include_url=False)[0]
        raise InputError(f"{where}: {_sentence(kind, content, finding)}") from None
    for doubt in (*_doubted, *_doubts(built)):
        warnings.warn(f"{where}: {doubt}", stacklevel=3)
    return built


def _doubts(value: Any, place: str = "") -> list[str]:
    """Sentences on numbers of unusual size in an object that was built."""
    if isinstance(value, dict):
        parts = value
    elif isinstance(value, tuple):
        parts = {str(i + 1): part for i, part in enumerate(value)}
    else:
        parts = vars(value) if is_dataclass(value) else {}
    known, found = _quantities(type(value)), []  # type: ignore[arg-type]
    for name, part in parts.items():
        key = f"{place}.{name}".lstrip(".")
        doubt = known[name].doubt(part) if name in known else ""
        found += [f"{key} {doubt}"] if doubt else _doubts(part, key)
    return found


@functools.lru_cache
def _quantities(kind: type) -> dict[str, Quantity]:
    """Quantities of the fields of a class that state what is usual."""
    if not is_dataclass(kind):
        return {}
    stated = {}
    for name, hint in typing.get_type_hints(kind, include_extras=True).items():
        inner = (part for part in (hint, *typing.get_args(hint)) if typing.get_origin(part) is Annotated)
        for one in (one for part in inner for one in part.__metadata__ if isinstance(one, Quantity)):
            stated[name] = one
    return {name: one for name, one in stated.items() if one.usual != (0.0, math.inf)}


@functools.lru_cache
def _adapter(kind: type) -> pydantic.TypeAdapter:
    return pydantic.TypeAdapter(kind)


def _sentence(kind: type, content: Any, finding: Any) -> str:
    tables, key = _place(kind, content, finding["loc"])
    details, found = finding.get("ctx", {}), reprlib.repr(finding["input"])
    fault = details.get("error")
    if isinstance(fault, _KeyFault):
        wrong, name, allowed = fault.args
        top = not key and not tables and isinstance(content.get(name, {}), dict)
        path = f"group [{name}]" if top else f"key {name!r}" if tables else f"key {key}.{name}".replace(" .", " ")
        return " ".join(filter(None, (tables, tables and key, wrong, path))) + allowed
    message = _SENTENCES.get(finding["type"], "{fault}")
    message = message.format(fault=fault or finding["msg"], found=found, **details)
    return f"{tables}: {key} {message}" if tables and key else f"{tables}{key} {message}".lstrip()


def _place(kind: type, content: Any, loc: tuple) -> tuple[str, str]:
    """Named tables on the way to a fault, and the dotted key in the last of them."""
    tables: list[str] = []
    key = ""
    for i, step in enumerate(loc, 1):
        if not isinstance(content, dict | list):  # which of several classes the value was checked against
            break
        if isinstance(content, dict) and step not in content:  # the same of a table
            key += f" of kind {step!r}" if i == len(loc) else ""
            continue
        content = content[step]
        if isinstance(step, int):
            named = isinstance(content, dict) and isinstance(content.get("name"), str)
            tables, key = [*tables, content["name"] if named else f"{key.removesuffix('s')} {step + 1}"], ""
        elif not tables and typing.get_origin(kind) is dict:
            tables = [f"[{step}]"]
        else:
            key = f"{key}.{step}".lstrip(".")
    return " ".join(tables), key
