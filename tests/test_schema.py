"""Reading files: whatever is broken in one, the answer is a valid result or one sentence that names the file."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from railrepro import paths
from railrepro.data import InputError
from railrepro.data import read as read_file
from railrepro.evidence.chain import chain
from railrepro.evidence.claims import statements
from railrepro.evidence.runs import tuning
from railrepro.simulation.scenarios import load_scenarios
from railrepro.track.alignment import alignments
from railrepro.track.table import read_table
from railrepro.vehicle.parameters import describe, load_vehicle, sample_ranges

READERS = {
    "data/vehicle.toml": lambda file: (load_vehicle(file), describe(file).to_csv(na_rep=""), sample_ranges(file)),
    "data/tracks.toml": alignments,
    "data/scenarios.toml": load_scenarios,
    "data/tuning.toml": tuning.load_task,
    "data/claims.toml": statements.load,
    "notebooks/chain.toml": chain.chain,
    "data/tuned/equal/ndi.json": lambda file: tuning.read("ndi", "equal", file.parent),
    "data/tracks/T3.csv": read_table,
}
VALUES = (
    *(True, False, "text", "", [], {}, [1], [[0, 1], [0, 1]], {"kind": "sine"}, [math.nan, 1], [1, math.inf, "log"]),
    *(0, -1, 1, 2.5, 10**400, -1e308, 1e308, 1e-308, math.nan, math.inf, -math.inf),
)
ENCODINGS = ("utf-16", "utf-32", "latin-1", "utf-8-sig")


def places(content) -> list[tuple[object, object]]:
    """Every table or list in a file with every key or index in it."""
    keys = content.keys() if isinstance(content, dict) else range(len(content)) if isinstance(content, list) else ()
    return [pair for key in keys for pair in [(content, key), *places(content[key])]]


def broken_content(draw, content):
    """Content with a key deleted, renamed, retyped or extreme, or with another order."""
    holder, key = draw(st.sampled_from(places(content)))
    change = draw(st.sampled_from(["delete", "rename", "value", "value", "value", "order"]))
    if change == "delete":
        del holder[key]
    elif change == "value":
        holder[key] = draw(st.sampled_from(VALUES))
    elif change == "rename" and isinstance(holder, dict):
        holder[draw(st.sampled_from(["", "name", "two\nlines", f"{key}_", "ä"]))] = holder.pop(key)
    elif isinstance(holder, dict):
        holder |= {name: holder.pop(name) for name in reversed(list(holder))}
    else:
        holder.reverse()
    return content


def broken_table(draw) -> str:
    """CSV with a cell changed, a column left out or rows in another order."""
    table = pd.read_csv(paths.ROOT / "data/tracks/T3.csv", nrows=60).astype(object)
    change = draw(st.sampled_from(["cell", "cell", "column", "order", "more"]))
    column = draw(st.sampled_from(list(table.columns)))
    if change == "cell":
        table.loc[draw(st.integers(0, 59)), column] = draw(st.sampled_from([str(value) for value in VALUES]))
    elif change == "column":
        table = table.drop(columns=column)
    elif change == "order":
        table = table.iloc[::-1]
    text = table.to_csv(index=False)
    return text.replace("\n", ",0\n").replace(",0\n", "\n", 1) if change == "more" else text


def broken_bytes(draw, data: bytes) -> bytes:
    """A file cut off, in another encoding, with foreign bytes, or empty."""
    change = draw(st.sampled_from(["truncate", "encoding", "insert", "empty", "comment"]))
    place = draw(st.integers(0, len(data)))
    if change == "truncate":
        return data[:place]
    if change == "encoding":
        return (data.decode() + "# ä\n").encode(draw(st.sampled_from(ENCODINGS)), "replace")
    if change == "insert":
        return data[:place] + draw(st.binary(min_size=1, max_size=4)) + data[place:]
    return b"" if change == "empty" else b"# nothing\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where broken files lie."""
    return tmp_path_factory.mktemp("broken")


def read(name: str, file: Path):
    """What a reader gives, or None when it refuses with one sentence that names the file."""
    try:
        return READERS[name](file)
    except InputError as error:
        assert file.name in str(error) and len(str(error).splitlines()) == 1, str(error)
        assert not str(error).endswith("\n")
        return None


@pytest.mark.parametrize("name", READERS)
def test_committed_files_are_read(name, folder):
    assert read(name, paths.ROOT / name) is not None


@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), database=None)
@given(data=st.data())
def test_broken_files_give_a_valid_result_or_one_sentence(data, folder):
    """Break one of the files in one way, and read it."""
    name = data.draw(st.sampled_from(list(READERS)))
    file = folder / Path(name).name
    original = (paths.ROOT / name).read_bytes()
    if data.draw(st.booleans()):
        text = original if not name.endswith(".csv") else b"\n".join(original.split(b"\n")[:60])
        file.write_bytes(broken_bytes(data.draw, text))
    elif name.endswith(".csv"):
        file.write_text(broken_table(data.draw))
    else:
        content = broken_content(data.draw, read_file(paths.ROOT / name))
        file = file.with_suffix(".json")  # read alike
        file.write_text(json.dumps(content))
    found = read(name, file)
    assert not re.search(r"\bnan\b", repr(found))
    if isinstance(found, pd.DataFrame):
        assert np.isfinite(found).all().all()


@pytest.mark.parametrize("name", READERS)
def test_empty_files_and_folders_are_refused(name, folder):
    file = folder / Path(name).name
    for text in ("", "# nothing\n"):
        file.write_text(text)
        assert read(name, file) is None
    file.unlink()
    file.mkdir()
    assert read(name, file) is None
    file.rmdir()
