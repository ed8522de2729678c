"""Dataclasses of quantities: names and order of the entries, units, and conversion from a vector and back."""

from dataclasses import dataclass
from typing import Annotated

from railrepro.quantities import Scalar, indices, names, notes, pack, reannotated, unpack


@dataclass(frozen=True)
class Point:
    y: Annotated[Scalar, "m"]
    psi: Annotated[Scalar, "rad", "a description may follow the unit"]


@dataclass(frozen=True)
class Base:
    v: Annotated[Scalar, "m/s"]
    front: Point
    line: Annotated[list[Scalar], range(3)]
    none: Annotated[list[Scalar], ()]


@dataclass(frozen=True)
class All(Base):
    more: Annotated[Point, "front"]


def test_names_are_paths_and_the_order_is_that_of_the_vector():
    assert names(All) == ("v", "front.y", "front.psi", "line.0", "line.1", "line.2", "front.y", "front.psi")
    assert [unit for _, unit in notes(All)] == ["m/s", "m", "rad", None, None, None, "m", "rad"]
    values = unpack(All, range(8))
    assert (values.v, values.front.psi, values.line, values.none, values.more.y) == (0, 2, [3, 4, 5], [], 6)
    assert pack(values) == list(range(8)) == pack(indices(All))


def test_reannotated_fields_keep_their_position():
    labelled = reannotated(All, none=Annotated[list[Scalar], ("a", "b")], front=Base)
    entries = ("v", "front.v", "front.front.y", "front.front.psi", *(f"front.line.{k}" for k in range(3)))
    entries += ("line.0", "line.1", "line.2", "none.a", "none.b", "front.y", "front.psi")
    assert names(labelled) == entries and issubclass(labelled, All)
    assert unpack(labelled, range(14)).none == [10, 11]
