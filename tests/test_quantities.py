"""Vectors of named quantities: names, order, lists, groups shown elsewhere, and the way from a vector and back."""

from typing import Annotated

from railrepro.quantities import group, indices, listed, names, pack, unpack
from railrepro.vehicle.parameters import WheelRail, load_vehicle

POINT = group("Point", "y m, psi rad")
ALL = group(
    "All", "v m/s", {"front": POINT, "line": listed(range(3)), "none": listed(())}, {"more": Annotated[POINT, "front"]}
)


def test_names_are_paths_in_the_order_of_the_vector():
    assert names(ALL) == ("v", "front.y", "front.psi", "line.0", "line.1", "line.2", "front.y", "front.psi")


def test_a_vector_becomes_an_instance_and_a_vector_again():
    values = unpack(ALL, range(8))
    assert (values.v, values.front.psi, values.line, values.none, values.more.y) == (0, 2, [3, 4, 5], [], 6)
    assert pack(values) == list(range(8)) == pack(indices(ALL))


def test_words_among_vehicle_data_are_no_entries_of_a_vector():
    contact = load_vehicle().contact
    assert isinstance(contact.profile, str) and "profile" not in names(WheelRail)
    assert pack(contact) == [getattr(contact, name) for name in names(WheelRail)]
