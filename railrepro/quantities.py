"""Named quantities: a frozen dataclass states names, order and units of its entries; vectors and columns follow.

A field is a number, `Annotated[Scalar, unit]` or `Annotated[Scalar, unit, meaning]`; a list with one element for each
label, `Annotated[list[Scalar], labels]`; or a further such dataclass. The name of an entry is the path to it: `front.y`
is `y` of the field `front`, `tau.front_le` is the element `front_le` of the list `tau`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, is_dataclass, make_dataclass
from functools import cache
from itertools import product
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import casadi as ca

GEARS = ("front", "rear")
SIDES = ("le", "ri")
GEAR_AND_SIDE = dict(zip(("front_le", "front_ri", "rear_le", "rear_ri"), product(GEARS, SIDES), strict=True))
"""Name of a wheel -> (running gear, side): "front_le" -> ("front", "le"); le is left, ri right."""
WHEELS = tuple(GEAR_AND_SIDE)
Scalar = Any
"""Type of an entry: a number, an array or a CasADi expression."""
Group = TypeVar("Group")


def reannotated(of: type[Group], **annotations: Any) -> type[Group]:
    """Subclass of a dataclass of quantities in which some fields have other annotations, such as the labels of a list
    that are known at run time only. The order of the fields stays."""
    return make_dataclass(of.__name__, annotations.items(), bases=(of,), frozen=True)


@cache
def _members(of: Any) -> list[tuple[str, type | None, tuple[str, ...] | None, Any]]:
    """Each field with its class if it is a dataclass, its labels if it is a list, and its first note if it has one."""
    hints = get_type_hints(of, include_extras=True)
    found: list = []
    for field in fields(of):
        inner, *more = get_args(hints[field.name]) or (hints[field.name],)
        note = more[0] if more else None
        if is_dataclass(inner):
            found.append((field.name, inner, None, note))
        elif inner is not str:
            labels = tuple(map(str, more[0])) if get_origin(inner) is list else None
            found.append((field.name, None, labels, note or inner))
    return found


def notes(of: type) -> list[tuple[str, Any]]:
    """Pairs (name, note) of all entries of a dataclass of quantities, in the order of `names`. The note is the unit
    (str) or the `data.Quantity` of the entry; its type where it has neither, None for an element of a list."""
    found: list[tuple[str, Any]] = []
    for name, inner, labels, note in _members(of):
        if inner:
            found += [(f"{note or name}.{entry}", unit) for entry, unit in notes(inner)]
        else:
            found += [(name, note)] if labels is None else [(f"{name}.{label}", None) for label in labels]
    return found


def names(of: type) -> tuple[str, ...]:
    """Names of all entries of a dataclass of quantities in order: "y" for a number, "front.y" for an entry of the field
    `front`, "tau.front_le" for a list element. Entries of a field `Annotated[dataclass, prefix]` are "prefix.y"."""
    return tuple(name for name, _ in notes(of))


def pack(values: Any) -> list:
    """Flat list of the entries of an instance of a dataclass of quantities, in the order of `names`."""
    found: list = []
    for name, inner, labels, _ in _members(type(values)):  # type: ignore[arg-type]
        value = getattr(values, name)
        found += pack(value) if inner else [value] if labels is None else value
    return found


def unpack(of: type[Group], entries: Iterable) -> Group:
    """Instance of the dataclass of quantities `of` from a flat list of its entries in the order of `names`."""
    source = iter(entries)
    made = object.__new__(of)
    for name, inner, labels, _ in _members(of):  # type: ignore[arg-type]
        if inner:
            vars(made)[name] = unpack(inner, source)
        else:
            vars(made)[name] = next(source) if labels is None else [next(source) for _ in labels]
    return made


def indices(of: type[Group]) -> Group:
    """Instance of the dataclass of quantities `of` in which each entry is its own index in the list of `pack`."""
    return unpack(of, range(len(names(of))))


def symbols(of: type[Group], name: str) -> tuple[ca.SX, Group]:
    """Pair: CasADi vector SX called `name`, shape (len(names(of)), 1); instance of the dataclass of quantities `of`,
    whose entries are the elements of this vector."""
    vector = ca.SX.sym(name, len(names(of)))
    return vector, unpack(of, ca.vertsplit(vector))


def named(columns: Iterable[str], vector: ca.SX) -> dict[str, ca.SX]:
    """Dict from column name to element of an SX vector; both have the same order and length."""
    return dict(zip(columns, ca.vertsplit(vector), strict=True))
