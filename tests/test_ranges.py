"""Properties of all classes that files are read into: each number has a range; beyond it, it is refused and named."""

import functools
import types
import typing
from dataclasses import is_dataclass
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from railrepro import paths
from railrepro.data import InputError, Quantity, build, read
from railrepro.estimation.sensors import Loop
from railrepro.evidence.runs import tuning
from railrepro.simulation.scenarios import Scenario
from railrepro.track import irregularity
from railrepro.track.alignment import CurveEntry, SegmentsEntry
from railrepro.vehicle.parameters import Vehicle

ROOTS = {
    "vehicle.toml": Vehicle,
    "sensors.toml": Loop,
    "scenarios.toml": dict[str, Scenario],
    "tracks.toml": dict[str, CurveEntry | SegmentsEntry],
    "irregularities.toml": dict[str, irregularity.Quality],
    "tuning.toml": tuning.TaskFile,
}
"""Files of data/ and what they are read into."""


@functools.cache
def hints(kind):
    return typing.get_type_hints(kind, include_extras=True)


def tables(kind, content):
    """Every class on the way through a file, with a table that it is read from."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if is_dataclass(kind):
        yield kind, content
        for key in content:
            yield from tables(hints(kind)[key], content[key])
    elif origin is Annotated:
        yield from tables(parts[0], content)
    elif origin in (dict, tuple):
        for part in content.values() if origin is dict else content:
            yield from tables(parts[1 if origin is dict else 0], part)
    elif origin in (types.UnionType, typing.Union) and isinstance(content, dict):
        known = [part for part in parts if is_dataclass(part) and content.keys() <= hints(part).keys()]
        of_kind = [part for part in known if content.get("kind") in (None, *typing.get_args(hints(part).get("kind")))]
        yield from tables(of_kind[0], content)


def declared(kind):
    """Numbers that a class declares: key, quantity, whether it is whole, whether it may be missing."""
    for key, hint in hints(kind).items():
        union = typing.get_origin(hint) in (types.UnionType, typing.Union)
        parts = typing.get_args(hint) if union else [hint]
        for part in (part for part in parts if typing.get_origin(part) is Annotated):
            base, *notes = typing.get_args(part)
            for quantity in (note for note in notes if isinstance(note, Quantity) and note.high > 0):
                if base is not bool and base is not str:
                    yield key, quantity, base is int, type(None) in typing.get_args(hint)


@functools.cache
def quantities(kind):
    return list(declared(kind))


@functools.cache
def stated():
    """One table of each class that declares numbers, the one with most keys."""
    found = {}
    for name, root in ROOTS.items():
        for kind, content in tables(root, read(paths.ROOT / "data" / name)):
            if quantities(kind) and len(content) > len(found.get(kind, ())):
                found[kind] = content if kind is not Scenario else content | {"name": "a"}
    return found


def not_allowed(quantity, whole, optional):
    """Values that a quantity does not allow."""
    least = -quantity.low if quantity.signed else None
    below = st.floats(least, quantity.low, exclude_max=quantity.closed)
    beyond = st.floats(quantity.high, exclude_min=True) if np.isfinite(quantity.high) else st.nothing()
    wrong = [float("nan"), True, "1", [], {}, 1j, 10**400, *([] if optional else [None]), *([1.5] if whole else [])]
    return st.one_of(below, beyond, st.sampled_from(wrong))


@pytest.mark.parametrize("kind", stated(), ids=lambda kind: kind.__name__)
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_a_number_beyond_its_declared_range_is_refused_in_a_line_that_names_its_key(kind, data):
    content = stated()[kind]
    key, quantity, *how = data.draw(st.sampled_from(quantities(kind)))
    value = data.draw(not_allowed(quantity, *how))
    entry = content.get(key)
    given_ = entry | {"value": value, "range": "fixed"} if isinstance(entry, dict) else value
    with pytest.raises(InputError) as refused:
        build(kind, content | {key: given_}, "here")
    said = str(refused.value)
    assert said.startswith(f"here: {key} ") and len(said.splitlines()) == 1, said


# Numbers of tuning.toml go to classes of the other files.
@pytest.mark.parametrize("name", sorted(ROOTS.keys() - {"tuning.toml"}))
def test_every_number_of_a_file_has_a_range(name):
    for kind, content in tables(ROOTS[name], read(paths.ROOT / "data" / name)):
        for key, value in content.items():
            number = value["value"] if isinstance(value, dict) and "value" in value else value
            assert type(number) not in (int, float) or key in {ranged for ranged, *_ in quantities(kind)}, key
