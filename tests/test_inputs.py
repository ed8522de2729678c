"""Wrong input is answered in one sentence: by a property of all classes that files are read into, and by a table.

inputs.toml holds calls and commands that no declared range covers, and a piece of the sentence that answers each.
Refused is what cannot be meant (`InputError`), warned of is what may be meant but is more likely another unit, told is
what a command says. A piece with … stands for several, in their order.
"""

import functools
import importlib
import os
import subprocess
import sys
import time
import tomllib
import types
import typing
import warnings
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated

import inputs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from railrepro import __main__ as command
from railrepro import paths
from railrepro.compile import cache
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.ndi import NDI
from railrepro.control.problem import MPCSettings
from railrepro.data import InputError, Quantity, build, read
from railrepro.estimation.sensors import Loop
from railrepro.evidence.chain import parent_death, verify
from railrepro.evidence.runs import tuning
from railrepro.own.lqg import LqgSettings
from railrepro.simulation.scenarios import Scenario
from railrepro.track import irregularity
from railrepro.track.alignment import CurveEntry, SegmentsEntry
from railrepro.vehicle.parameters import Vehicle

TABLE = tomllib.loads(Path(__file__).with_name("inputs.toml").read_text(encoding="utf-8"))


def rows(kind):
    """Calls of a kind with what they are answered."""
    return [pytest.param(*row, id=row[0]) for row in TABLE[kind].items()]


def holds(said, pieces):
    """Whether one line has all pieces, one after the other."""
    place = 0
    for piece in pieces.split("…"):
        place = said.find(piece, place)
        if place < 0:
            return False
        place += len(piece)
    return len(said.splitlines()) == 1


def called(call, folder, monkeypatch):
    monkeypatch.setattr(inputs, "folder", folder)
    return eval(call, vars(inputs))


@pytest.mark.parametrize(("call", "sentence"), rows("refused"))
def test_refused_in_one_sentence(call, sentence, tmp_path, monkeypatch):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        with pytest.raises(InputError) as refused:
            called(call, tmp_path, monkeypatch)
    assert holds(str(refused.value), sentence), refused.value


@pytest.mark.parametrize(("call", "sentence"), rows("failed"))
def test_a_run_that_fails_ends_in_one_sentence(call, sentence, tmp_path, monkeypatch):
    with pytest.raises(ArithmeticError) as failed:
        called(call, tmp_path, monkeypatch)
    assert holds(str(failed.value), sentence), failed.value


@pytest.mark.parametrize(("call", "sentence"), rows("warned"))
def test_warned_of_in_one_sentence(call, sentence, tmp_path, monkeypatch):
    with pytest.warns(UserWarning) as said:
        called(call, tmp_path, monkeypatch)
    assert [holds(str(warning.message), sentence) for warning in said] == [True], [str(each.message) for each in said]


@pytest.mark.parametrize(("arguments", "sentence"), rows("told"))
def test_told_in_one_sentence_before_anything_starts(arguments, sentence, capsys):
    try:
        code = command.main(arguments.split())
    except SystemExit as ended:
        code = ended.code
    said = capsys.readouterr().err
    assert code in (1, 2) and said.startswith("error: ") and holds(said, sentence), said


@pytest.mark.parametrize(("arguments", "sentence"), rows("ended"))
def test_a_module_run_by_name_ends_in_one_sentence(arguments, sentence, tmp_path):
    command = [sys.executable, "-m", *arguments.split()]
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and not done.stdout and holds(done.stderr, sentence), done.stderr
    assert not list(tmp_path.iterdir())


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


def beyond(quantity, whole, optional):
    """Values that a quantity does not allow."""
    least = -quantity.low if quantity.signed else None
    below = st.floats(least, quantity.low, exclude_max=quantity.closed)
    above = st.floats(quantity.high, exclude_min=True) if np.isfinite(quantity.high) else st.nothing()
    wrong = [float("nan"), True, "1", [], {}, 1j, 10**400, *([] if optional else [None]), *([1.5] if whole else [])]
    return st.one_of(below, above, st.sampled_from(wrong))


@pytest.mark.parametrize("kind", stated(), ids=lambda kind: kind.__name__)
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(data=st.data())
def test_a_number_beyond_its_declared_range_is_refused_in_a_line_that_names_its_key(kind, data):
    content = stated()[kind]
    key, quantity, *how = data.draw(st.sampled_from(quantities(kind)))
    value = data.draw(beyond(quantity, *how))
    entry = content.get(key)
    given_ = entry | {"value": value, "range": "fixed"} if isinstance(entry, dict) else value
    with pytest.raises(InputError) as refused:
        build(kind, content | {key: given_}, "here")
    said = str(refused.value)
    assert said.startswith(f"here: {key} ") and len(said.splitlines()) == 1, said


@settings(max_examples=300, deadline=None, derandomize=True, database=None)
@given(st.floats(-1e9, 1e9), st.floats(0, 1e9), st.floats(0.0, 1.0), st.booleans())
def test_a_number_within_its_range_is_taken_and_the_ends_are_those_that_are_stated(low, width, share, closed):
    quantity = Quantity(low, low + width, "m", closed=closed)
    inside = min(low + share * width, quantity.high)
    for value, taken in ((inside, inside > low or closed), (low, closed), (quantity.high, closed or width > 0)):
        try:
            quantity.check(value)
        except ValueError:
            assert not taken or low == low + width
        else:
            assert taken


SETTINGS = (MPCSettings, AdhesionSettings, LqgSettings, NDI)


@pytest.mark.parametrize("kind", SETTINGS, ids=lambda kind: kind.__name__)
def test_settings_of_controllers_refuse_what_is_no_number_of_a_possible_size(kind):
    made = kind()
    numbers = [field.name for field in fields(kind) if type(getattr(made, field.name)) in (int, float)]
    assert len(numbers) > 2
    for name in numbers:
        for value in (np.nan, np.inf, -1e15, 1e15, "text", None, [], True):
            with pytest.raises(InputError) as refused:
                kind(**{name: value})
            assert f" {name} " in str(refused.value) and len(str(refused.value).splitlines()) == 1


COMMANDS = ["tune", "probe", "robustness", "margins", "order", "bench", "report",
            "score", "leaderboard", "chain"]  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_help_starts_nothing(name, monkeypatch, capsys):
    monkeypatch.setattr(command.importlib, "import_module", lambda module: pytest.fail(f"{module} is imported"))
    with pytest.raises(SystemExit) as ended:
        command.main([name, "--help"])
    assert ended.value.code == 0 and "usage: python -m railrepro" in capsys.readouterr().out


@pytest.mark.parametrize("group", [(), ("chain",)])
def test_every_command_leads_to_a_function(group):
    parser = command.parser()
    for name in group:
        parser = parser._subparsers._group_actions[0].choices[name]
    for name, sub in parser._subparsers._group_actions[0].choices.items():
        call = sub.get_default("call")
        if call:
            module, _, function = call.partition(":")
            assert callable(getattr(importlib.import_module(module), function)), name


def test_only_a_folder_of_its_own_is_emptied(tmp_path):
    mine, made = tmp_path / "thesis", tmp_path / "made"
    mine.mkdir()
    (mine / "chapter.tex").write_text("years of work")
    (tmp_path / "link").symlink_to(mine)
    for folder in (mine, tmp_path / "link", mine / "chapter.tex"):
        with pytest.raises(InputError, match="is needed|no run of railrepro wrote"):
            verify.emptied(folder)
    assert (mine / "chapter.tex").read_text() == "years of work"
    for _ in range(2):
        verify.emptied(made)
        assert [file.name for file in made.iterdir()] == [verify.MARK]
        (made / "old.csv").touch()


def test_a_compiler_that_there_is_not_is_told(monkeypatch):
    monkeypatch.setenv("CC", "nonexistent-cc")
    cache.compiler.cache_clear()
    try:
        with pytest.raises(cache.CompilerError, match="CC='nonexistent-cc' is no compiler that can be found; "):
            cache.compiler()
    finally:
        cache.compiler.cache_clear()


HOLDING = """
import os, subprocess, sys
from railrepro.evidence.chain import parent_death
parent_death.follow(int(sys.argv[1]), lambda: None)
child = subprocess.Popen([sys.executable, "-c", "sum(range(10**11))"])
print(child.pid, flush=True)
child.wait()
"""


def test_what_is_in_a_long_call_ends_with_who_started_it():
    leader = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)}
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDING, str(leader.pid)], env=environment, stdout=subprocess.PIPE, text=True
    )
    child = int(holder.stdout.readline())
    assert child in parent_death.descendants(os.getpid())
    leader.communicate(b"\n")
    assert holder.wait(timeout=30) == 1
    end = time.monotonic() + 10
    while parent_death.alive(child) and time.monotonic() < end:
        time.sleep(0.1)
    assert not parent_death.alive(child)


def printed(*arguments, **environment):
    """What make says, with the database of its variables."""
    make = ["make", "--no-print-directory", "-np", *arguments]
    return subprocess.run(make, cwd=paths.ROOT, env=os.environ | environment, capture_output=True, text=True).stdout


def test_make_needs_no_home_that_can_be_written_and_a_lab_of_root_may_start(tmp_path):
    (tmp_path / "file").touch()
    environment = {"XDG_CACHE_HOME": "", "UV_CACHE_DIR": ""}
    for home, own in ((tmp_path, False), ("/dev/null", True), (tmp_path / "file", True)):
        assert ("UV_CACHE_DIR := " in printed("help", HOME=str(home), **environment)) is own, home
    assert ("--allow-root" in printed("lab")) is (os.getuid() == 0)


def test_a_half_made_environment_is_made_again(tmp_path):
    """What `python -m venv` leaves where ensurepip is missing: a Python without pip."""
    for name in ("Makefile", "environment.lock", "pyproject.toml", "notebooks", "railrepro"):
        (tmp_path / name).symlink_to(paths.ROOT / name)
    broken, other = tmp_path / ".venv/bin/python", tmp_path / "python"
    broken.parent.mkdir(parents=True)
    broken.write_text("#!/bin/sh\nexit 1\n")
    other.write_text(f'#!/bin/sh\ncase "$*" in *venv*) echo made again; exit 1;; esac\n{sys.executable} "$@"\n')
    for script in (broken, other):
        script.chmod(0o755)
    made = subprocess.run(["make", "check", f"PYTHON={other}"], cwd=tmp_path, capture_output=True, text=True)
    assert made.returncode == 2 and "made again" in made.stdout, made.stdout


def test_the_clone_in_the_working_directory_does_not_hide_the_package(tmp_path):
    """The folder of a clone is called like the package; where it lies beside a script it is none."""
    (tmp_path / "railrepro").mkdir()
    (tmp_path / "first.py").write_text("from railrepro import simulate; print(simulate.__name__)")
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    found = subprocess.run([sys.executable, "first.py"], cwd=tmp_path, env=clean, capture_output=True, text=True)
    assert found.stdout == "run\n", found.stderr
