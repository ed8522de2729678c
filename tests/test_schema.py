"""Reading files: a broken file gives a valid result or a message of one line that names file and key."""

import json
import math
import os
import re
import shutil
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from railrepro import paths
from railrepro.control import registry
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.ndi import NDI
from railrepro.control.problem import MPCSettings
from railrepro.control.registry import SETTINGS
from railrepro.data import InputError
from railrepro.data import read as read_file
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.chain import chain
from railrepro.evidence.claims import statements
from railrepro.own.lqg import LqgPreview
from railrepro.simulation.scenarios import load_scenarios
from railrepro.track.alignment import alignments
from railrepro.track.irregularity import track_quality
from railrepro.track.table import read_table
from railrepro.tuning.task import load_task
from railrepro.vehicle.parameters import load_vehicle

READERS = {
    "data/vehicle.toml": load_vehicle,
    "data/sensors.toml": load_loop,
    "data/tracks.toml": alignments,
    "data/scenarios.toml": load_scenarios,
    "data/tuning.toml": lambda file: [load_task(file, setting) for setting in SETTINGS],
    "data/claims.toml": statements.load,
    "notebooks/chain.toml": chain.load,
    "data/tuned/loop/ndi.json": lambda file: registry.read("ndi", "loop", file.parent),
    "data/tracks/T3.csv": read_table,
}
RANGED = {name: READERS[name] for name in [*READERS][:5]} | {"data/irregularities.toml": lambda file: track_quality()}
WRONG = (math.nan, math.inf, -math.inf, 1e300, -1e300, 10**400, True, "1", [], {}, 1j)  # for any number of a file
VALUES = (*WRONG[:-1], "", 0, -1, 1, 2.5, 1e-308, [[0, 1], [0, 1]], {"kind": "sine"}, [math.nan, 1])
USED = {"radius_m", "irregular", "controller"}  # keys whose numbers are checked where they are used


def places(content, *keys):
    """Every table or list in a file with each of its keys or indices, and the path of keys to it."""
    names = content.keys() if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    for name in names:
        yield content, name, (*keys, name)
        yield from places(content[name], *keys, name)


@pytest.mark.parametrize("name", RANGED)
def test_every_number_of_a_file_has_a_range_and_is_refused_beyond_it_with_its_key(name, monkeypatch):
    content = read_file(paths.ROOT / name)
    monkeypatch.setattr("railrepro.data.read", lambda file: content if name.endswith(file.name) else read_file(file))
    for holder, last, _ in [*places(content)]:
        if last == "range":  # it is checked against the value before the value itself
            holder[last] = "fixed"
    for holder, last, keys in [*places(content)]:
        number = holder[last]
        if type(number) not in (int, float) or USED & set(keys) or keys[::2] == ("run", "speed_kmh"):
            continue
        key = next(key for key in reversed(keys) if isinstance(key, str) and key != "value")
        for holder[last] in WRONG:
            with pytest.raises(InputError) as refused:
                RANGED[name](Path(name))
            assert key in str(refused.value) and len(str(refused.value).splitlines()) == 1, refused.value
        holder[last] = number


def instances(value):
    """Dataclass instances in a value and in each other, one for each class."""
    found = {type(value): value} if is_dataclass(value) else {}
    parts = vars(value) if found else value
    for part in parts.values() if isinstance(parts, dict) else parts if isinstance(parts, tuple) else ():
        found = instances(part) | found
    return found


CONTROL = (MPCSettings(), AdhesionSettings(), LqgPreview(), NDI())
FILES = (load_vehicle(), load_loop(), *load_scenarios().values(), chain.load(), *track_quality().values())
MADE = instances((*CONTROL, *FILES))


@pytest.mark.parametrize("made", MADE.values(), ids=lambda made: type(made).__name__)
def test_a_constructor_refuses_impossible_numbers(made):
    assert replace(made) == made
    for name in [one.name for one in fields(made) if type(getattr(made, one.name)) in (int, float)]:
        for value in WRONG:
            with pytest.raises(InputError, match=rf"^{type(made).__name__}: {name}\b.*needed") as refused:
                replace(made, **{name: value})
            assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("name", READERS)
@pytest.mark.timeout(60)  # a reader that opens the pipe never returns
def test_only_regular_files_up_to_a_size_are_read(name, tmp_path, monkeypatch):
    file = tmp_path / Path(name).name
    with pytest.raises(InputError, match=rf"there is no file {file}|there is no tuned set"):
        READERS[name](file)
    os.mkfifo(file)
    with pytest.raises(InputError, match="a regular file is needed"):
        READERS[name](file)
    file.unlink()
    shutil.copy(paths.ROOT / name, file)
    monkeypatch.setattr("railrepro.data.LARGEST_FILE", file.stat().st_size - 1)
    with pytest.raises(InputError, match="at most .* MB are read"):
        READERS[name](file)


def broken_content(draw, content):
    """Delete or rename a key, or replace a value."""
    holder, key, _ = draw(st.sampled_from([*places(content)]))
    change = draw(st.sampled_from(["delete", "rename", "value", "value", "value"]))
    if change == "delete":
        del holder[key]
    elif change == "rename" and isinstance(holder, dict):
        holder[draw(st.sampled_from(["", "name", "two\nlines", f"{key}_", "ä"]))] = holder.pop(key)
    else:
        holder[key] = draw(st.sampled_from(VALUES))
    return content


def broken_bytes(draw, data):
    """Cut off the bytes of a file, change their encoding, or insert some."""
    place = draw(st.integers(0, len(data)))
    recoded = (data.decode() + "# ä\n").encode(draw(st.sampled_from(["utf-16", "latin-1", "utf-8-sig"])), "replace")
    return draw(st.sampled_from([data[:place], recoded, data[:place] + b"\xff\0" + data[place:]]))


@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None)
@given(data=st.data())
def test_broken_files_give_a_valid_result_or_one_sentence(data, tmp_path):
    name = data.draw(st.sampled_from([*READERS]))
    file, original = tmp_path / Path(name).name, paths.ROOT / name
    if data.draw(st.booleans()):
        file.write_bytes(broken_bytes(data.draw, original.read_bytes()[:20_000]))
    elif name.endswith(".csv"):
        columns = pd.read_csv(original, nrows=60).astype(object).to_dict("list")
        columns = {column: pd.Series(cells) for column, cells in broken_content(data.draw, columns).items()}
        file.write_text(pd.DataFrame(columns).to_csv(index=False))
    else:
        file = file.with_suffix(".json")  # a reader accepts it, too
        file.write_text(json.dumps(broken_content(data.draw, read_file(original))))
    try:
        found = READERS[name](file)
    except InputError as error:
        assert file.name in str(error) and len(str(error).splitlines()) == 1, str(error)
        return
    assert not re.search(r"\bnan\b", repr(found))
    if isinstance(found, pd.DataFrame):
        assert np.isfinite(found).all().all()
