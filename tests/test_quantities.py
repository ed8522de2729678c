"""Vectors of named quantities: names, order, lists, groups shown elsewhere, and the way from a vector and back."""

from dataclasses import dataclass
from typing import Annotated

from railrepro.quantities import Scalar, indices, names, notes, pack, reannotated, unpack
from railrepro.vehicle.parameters import WheelRail, load_vehicle


@dataclass(frozen=True)
class Point:
    y: Annotated[Scalar, "m"]
    psi: Annotated[Scalar, "rad", "a unit may be followed by what it is"]


@dataclass(frozen=True)
class Base:
    v: Annotated[Scalar, "m/s"]
    front: Point
    line: Annotated[list[Scalar], range(3)]
    none: Annotated[list[Scalar], ()]


@dataclass(frozen=True)
class All(Base):
    more: Annotated[Point, "front"]


def test_names_are_paths_in_the_order_of_the_vector():
    assert names(All) == ("v", "front.y", "front.psi", "line.0", "line.1", "line.2", "front.y", "front.psi")
    assert [unit for _, unit in notes(All)] == ["m/s", "m", "rad", None, None, None, "m", "rad"]


def test_a_vector_becomes_an_instance_and_a_vector_again():
    values = unpack(All, range(8))
    assert (values.v, values.front.psi, values.line, values.none, values.more.y) == (0, 2, [3, 4, 5], [], 6)
    assert pack(values) == list(range(8)) == pack(indices(All))


def test_labels_that_are_known_at_run_time_only_keep_their_place_in_the_order():
    labelled = reannotated(All, none=Annotated[list[Scalar], ("a", "b")], front=Base)
    entries = ("v", "front.v", "front.front.y", "front.front.psi", *(f"front.line.{k}" for k in range(3)))
    entries += ("line.0", "line.1", "line.2", "none.a", "none.b", "front.y", "front.psi")
    assert names(labelled) == entries and issubclass(labelled, All)
    assert unpack(labelled, range(14)).none == [10, 11]


def test_words_among_vehicle_data_are_no_entries_of_a_vector():
    contact = load_vehicle().contact
    assert isinstance(contact.profile, str) and "profile" not in names(WheelRail)
    assert pack(contact) == [getattr(contact, name) for name in names(WheelRail)]
