"""Named quantities: a table of names and units makes a frozen dataclass; vectors and columns follow from it. An entry
is a number or an expression, a list with labels, or a group of further entries. Its name is the path to it: `front.y`
is `y` of the group `front`, `tau_le.3` is entry 3 of the list `tau_le`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, make_dataclass
from functools import cache
from itertools import product
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

import casadi as ca

GEARS = ("front", "rear")
SIDES = ("le", "ri")
GEAR_AND_SIDE = dict(zip(("front_le", "front_ri", "rear_le", "rear_ri"), product(GEARS, SIDES), strict=True))
"""Name of a wheel -> (running gear, side): "front_le" -> ("front", "le"); le is left, ri right."""
WHEELS = tuple(GEAR_AND_SIDE)
Group = TypeVar("Group")


def listed(labels: Iterable) -> Any:
    """Annotation of a field of `group` that holds a list with one element for each of `labels`. `names` calls an
    element FIELD.LABEL."""
    return Annotated[list, tuple(map(str, labels))]


def group(name: str, *members: str | Mapping[str, Any]) -> Any:
    """Make a frozen dataclass of quantities.

    Args:
        name (str): Name of the class.
        members (str or mapping): Fields in order. A string gives names with units: "y m, psi rad". A mapping gives for
            each name a unit or a `data.Quantity`, a list `listed(…)`, or another such dataclass (a group). The function
            `names` calls field y of a group g "g.y". If the group is `Annotated[dataclass, prefix]`, the name is
            "prefix.y".
    """
    types: dict[str, Any] = {}
    for some in members:
        of = dict(each.split(" ", 1) for each in some.split(", ")) if isinstance(some, str) else some
        kinds = {entry: isinstance(note, type) or bool(get_args(note)) for entry, note in of.items()}
        types |= {entry: note if kinds[entry] else Annotated[Any, note] for entry, note in of.items()}
    return make_dataclass(name, types.items(), frozen=True)


@cache
def _members(of: Any) -> list[tuple[str, type | None, tuple[str, ...] | None, Any]]:
    """Each field with its class if it is a group, its labels if it is a list, and its annotation if it has one."""
    hints = get_type_hints(of, include_extras=True)
    found: list = []
    for field in fields(of):
        inner, *more = get_args(hints[field.name]) or (hints[field.name],)
        note = more[0] if more else None
        if is_dataclass(inner):
            found.append((field.name, inner, None, note))
        elif inner is not str:
            found.append((field.name, None, note if inner is list else None, note or inner))
    return found


def notes(of: type) -> list[tuple[str, Any]]:
    """Pairs (name, note) of all entries of a `group` class, in the order of `names`. The note is the unit (str) or the
    `data.Quantity` of the entry; its type where it has neither, None for an element of a list."""
    found: list[tuple[str, Any]] = []
    for name, inner, labels, note in _members(of):
        if inner:
            found += [(f"{note or name}.{entry}", unit) for entry, unit in notes(inner)]
        else:
            found += [(name, note)] if labels is None else [(f"{name}.{label}", None) for label in labels]
    return found


def names(of: type) -> tuple[str, ...]:
    """Names of all entries of a `group` class in order: "front.y" for a field of a group, "tau.le" for a list
    element."""
    return tuple(name for name, _ in notes(of))


def pack(values: Any) -> list:
    """Flat list of the entries of an instance of a `group` class, in the order of `names`."""
    found: list = []
    for name, inner, labels, _ in _members(type(values)):  # type: ignore[arg-type]
        value = getattr(values, name)
        found += pack(value) if inner else [value] if labels is None else value
    return found


def unpack(of: type[Group], entries: Iterable) -> Group:
    """Instance of the `group` class `of` from a flat list of its entries in the order of `names`."""
    source = iter(entries)
    made = object.__new__(of)
    for name, inner, labels, _ in _members(of):  # type: ignore[arg-type]
        if inner:
            vars(made)[name] = unpack(inner, source)
        else:
            vars(made)[name] = next(source) if labels is None else [next(source) for _ in labels]
    return made


def indices(of: type[Group]) -> Group:
    """Instance of the `group` class `of` in which each entry is its own index in the list of `pack`."""
    return unpack(of, range(len(names(of))))


def symbols(of: type[Group], name: str) -> tuple[ca.SX, Group]:
    """Pair: CasADi vector SX called `name`, shape (len(names(of)), 1); instance of the `group` class `of`, whose
    entries are the elements of this vector."""
    vector = ca.SX.sym(name, len(names(of)))
    return vector, unpack(of, ca.vertsplit(vector))


def named(columns: Iterable[str], vector: ca.SX) -> dict[str, ca.SX]:
    """Dict from column name to element of an SX vector; both have the same order and length."""
    return dict(zip(columns, ca.vertsplit(vector), strict=True))
