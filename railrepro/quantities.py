"""Dataclasses of quantities: names, order and units of the entries of a vector are stated once, as the fields of a
class. A field is a number, `Annotated[Scalar, unit]` or `Annotated[Scalar, unit, meaning]`; a list with one element for
each label, `Annotated[list[Scalar], labels]`; or another such dataclass. The name of an entry is the path to it:
"front.y" is `y` of the field `front`, "tau.front_le" is the element `front_le` of the list `tau`."""

from collections.abc import Iterable
from dataclasses import fields, is_dataclass, make_dataclass
from functools import cache
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import casadi as ca

GEARS = ("front", "rear")
SIDES = ("le", "ri")
GEAR_AND_SIDE = {f"{gear}_{side}": (gear, side) for gear in GEARS for side in SIDES}
"""Name of a wheel -> (running gear, side). "le" is left, "ri" is right."""
WHEELS = tuple(GEAR_AND_SIDE)
Scalar = Any
"""Type of an entry: a number, an array or a CasADi expression."""
Group = TypeVar("Group")


def reannotated(of: type[Group], **annotations: Any) -> type[Group]:
    """Make a subclass of a dataclass of quantities in which the fields `annotations` have another type or unit, in the
    same order. For example, reannotated(LawGains, lateral=Annotated[list[Scalar], ("k0", "k1")]) has a list of two
    numbers named "lateral.k0" and "lateral.k1"; each lateral law has its own gains."""
    return make_dataclass(of.__name__, annotations.items(), bases=(of,), frozen=True)


@cache
def _members(of: Any) -> list[tuple[str, type | None, tuple[str, ...] | None, Any]]:
    """Return for each field its name, its class if it is a dataclass, its labels if it is a list, and its note."""
    hints = get_type_hints(of, include_extras=True)
    result: list = []
    for field in fields(of):
        inner, *more = get_args(hints[field.name]) or (hints[field.name],)
        note = more[0] if more else None
        if is_dataclass(inner):
            result.append((field.name, inner, None, note))
        elif inner is not str:
            labels = tuple(map(str, more[0])) if get_origin(inner) is list else None
            result.append((field.name, None, labels, inner if inner is bool else note or inner))
    return result


def notes(of: type) -> list[tuple[str, Any]]:
    """Return (name, note) of all numbers in a dataclass of quantities, in order. The note is the `data.Quantity` (range
    and unit) that annotates the field, as in ("front.y", between(-0.03, 0.03, "m")), or the unit as text, as in
    ("front.phi", "rad"). Without annotation it is the type, for an element of a list None."""
    result: list[tuple[str, Any]] = []
    for name, inner, labels, note in _members(of):
        if inner:
            result += [(f"{note or name}.{entry}", unit) for entry, unit in notes(inner)]
        else:
            result += [(name, note)] if labels is None else [(f"{name}.{label}", None) for label in labels]
    return result


def names(of: type) -> tuple[str, ...]:
    """Return the names of all numbers in a dataclass of quantities, in order, such as "front.y". In a field
    `Annotated[dataclass, prefix]` the names begin with this prefix instead of the name of the field."""
    return tuple(name for name, _ in notes(of))


def pack(values: Any) -> list:
    """Return all numbers of an instance of a dataclass of quantities as a flat list in the order of `names`."""
    result: list = []
    for name, inner, labels, _ in _members(type(values)):  # type: ignore[arg-type]
        value = getattr(values, name)
        result += pack(value) if inner else [value] if labels is None else value
    return result


def unpack(of: type[Group], entries: Iterable) -> Group:
    """Make an instance of the dataclass of quantities `of` from a flat list of its numbers, as `pack` returns it."""
    source = iter(entries)
    made = object.__new__(of)
    for name, inner, labels, _ in _members(of):  # type: ignore[arg-type]
        if inner:
            vars(made)[name] = unpack(inner, source)
        else:
            vars(made)[name] = next(source) if labels is None else [next(source) for _ in labels]
    return made


def indices(of: type[Group]) -> Group:
    """Make an instance of the dataclass `of` in which each number is its own position in the list of `pack`."""
    return unpack(of, range(len(names(of))))


def symbols(of: type[Group], name: str) -> tuple[ca.SX, Group]:
    """Make a CasADi column vector (SX) called `name`, and an instance of the dataclass `of` that has its elements."""
    vector = ca.SX.sym(name, len(names(of)))
    return vector, unpack(of, ca.vertsplit(vector))


def named(columns: Iterable[str], vector: ca.SX) -> dict[str, ca.SX]:
    """Return the elements of an SX vector as a dict: name in `columns` -> element."""
    return dict(zip(columns, ca.vertsplit(vector), strict=True))
