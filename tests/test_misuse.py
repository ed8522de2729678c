"""Misuse, as a table: misuse.toml holds calls and commands, and a piece of the sentence that answers each.

Refused is what cannot be meant (`InputError`), warned of is what may be meant but is more likely another unit, told is
what a command says; nothing is silent, nothing ends in a traceback. A piece with … stands for several, in their order.
"""

import importlib
import json
import os
import subprocess
import sys
import time
import tomllib
import warnings
from dataclasses import MISSING, fields
from pathlib import Path

import misuse
import numpy as np
import pandas as pd
import pytest

from railrepro import __main__ as command
from railrepro import parent_death, paths, schema
from railrepro.compile import cache
from railrepro.contact import points, profiles
from railrepro.contact import table as contact
from railrepro.errors import InputError
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.chain import verify
from railrepro.evidence.runs import tuning
from railrepro.simulation.scenarios import Scenario, Sine, Sweep, load_scenarios
from railrepro.track import irregularity, rough
from railrepro.track.alignment import SegmentEntry, SegmentsEntry, alignments
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

TABLE = tomllib.loads(Path(__file__).with_name("misuse.toml").read_text(encoding="utf-8"))


def rows(kind):
    """Calls of a kind with what they are answered."""
    return [
        pytest.param(call, answer, id=f"{group}: {call}")
        for group, calls in TABLE[kind].items()
        for call, answer in calls.items()
    ]


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
    monkeypatch.setattr(misuse, "folder", folder)
    return eval(call, vars(misuse))


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


SWEPT = {
    "vehicle.toml": load_vehicle,
    "sensors.toml": load_loop,
    "scenarios.toml": load_scenarios,
    "tracks.toml": alignments,
    "irregularities.toml": irregularity.track_quality,
}
WRONG = {"a text": "text", "nan": np.nan, "inf": np.inf, "absurd": -1e15, "a list": [], "a table": {}}
OPTIONAL = {
    field.name
    for kind in (Scenario, Sine, Sweep, SegmentEntry, SegmentsEntry)
    for field in fields(kind)
    if not field.default is field.default_factory is MISSING
}


def leaves(content):
    """Every table of a file with each of its keys that is no table; of a parameter, which has six, its value only."""
    keys = ["value"] if "symbol" in content and content["symbol"] != "m_CB" else list(content)
    for key in keys:
        yield from leaves(content[key]) if isinstance(content[key], dict) else [(content, key)]


@pytest.mark.parametrize("name", SWEPT)
def test_every_key_of_every_file_is_checked(name, tmp_path):
    """Each key with a value of every wrong kind, missing, and beside an unknown one: a sentence with file and key."""
    content, file = schema.read(paths.ROOT / "data" / name), tmp_path / f"{name}.json"

    def answer():
        file.write_text(json.dumps(content))
        try:
            SWEPT[name](file)
        except InputError as refused:
            said = str(refused)
            assert said.startswith(f"{file.name}: ") and len(said.splitlines()) == 1, said
            return said
        return None

    assert answer() is None
    for holder, key in leaves(content):
        right = dict(holder)
        for what, value in WRONG.items():
            holder[key] = value
            said = answer()
            same = type(value) is type(right[key]) and what in ("a text", "a list")
            assert said or same or (key == "radius_m" and what in ("inf", "absurd")), f"{key} may be {what}"
        del holder[key]
        said = answer()
        assert key in OPTIONAL if said is None else key in said or "lacks the key" in said, f"without {key}: {said}"
        holder |= {key: right[key], "colour": 1}
        assert "colour" in (answer() or ""), f"an unknown key beside {key}"
        holder.clear()
        holder |= right


def test_nothing_that_the_project_holds_is_unusual():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_vehicle(), load_loop(), load_scenarios(), irregularity.track_quality(), tuning.load_task()


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


def test_verify_into_a_folder_of_somebody_leaves_it_as_it_is(tmp_path, capsys):
    (tmp_path / "chapter.tex").touch()
    assert command.main(["chain", "verify", "--quick", "--into", str(tmp_path)]) == 1
    assert "holds files that no run of railrepro wrote" in capsys.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["chapter.tex"]


def test_a_compiler_that_there_is_not_is_told(monkeypatch, capsys):
    monkeypatch.setenv("CC", "nonexistent-cc")
    monkeypatch.delenv("RAILREPRO_NO_COMPILER", raising=False)
    monkeypatch.setattr(cache, "_object", lambda *_: None)
    cache.compiler.cache_clear()
    try:
        used = cache.compiler()
        cache.compiler.cache_clear()
        assert cache.compiler() == used  # told once, also by the processes that this one starts
    finally:
        cache.compiler.cache_clear()
    said = capsys.readouterr().err
    assert said.count("CC='nonexistent-cc' is no compiler that can be found; ") == 1 and len(said.splitlines()) == 1


HOLDING = """
import os, subprocess, sys
from railrepro import parent_death
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


def test_a_track_of_chainage_and_radius_is_that_of_its_segments(tmp_path):
    """Against 10^5 steps of the integrals of curvature and heading, and the cant by its definition."""
    text = (
        "chainage_m,radius_m,cant_mm\n12000,,0\n12100,0,0\n12300,-1500,-120\n14800,-1500,-120\n15000,inf,0\n15100,,0\n"
    )
    (tmp_path / "mine.csv").write_text(text)
    table = load_track(tmp_path / "mine.csv").table
    s = np.linspace(0.0, 3100.0, 100_001)
    kappa = np.interp(s, [0, 100, 300, 2800, 3000, 3100], [0, 0, -1 / 1500, -1 / 1500, 0, 0])
    heading = np.concatenate([[0.0], np.cumsum((kappa[1:] + kappa[:-1]) / 2 * np.diff(s))])
    ends = [np.trapezoid(np.cos(heading), s), np.trapezoid(np.sin(heading), s)]
    assert table["psi_rad"].iloc[-1] == pytest.approx(-2700 / 1500) == pytest.approx(heading[-1])
    assert table[["x_m", "y_m"]].iloc[-1].tolist() == pytest.approx(ends, abs=1e-5)
    assert 1.5 * np.sin(table["phi_rad"].min()) == pytest.approx(-0.12)
    assert table["dphi_dp_1pm"].abs().max() == pytest.approx(np.arcsin(0.08) / 200)


def test_points_of_standard_profiles_give_the_contact_of_the_standard_ones(tmp_path, monkeypatch):
    """Points every 0.3 mm on the wheel and 0.2 mm on the rail, to 10 nm; a rail has any origin."""
    lateral_, (position, depth) = np.arange(-0.06, 0.058, 3e-4), profiles.inclined_rail(401)
    parts = {"wheel": (lateral_, profiles.s1002(lateral_)[0]), "rail": (position - 0.8, 0.1 - depth)}
    rows = [pd.DataFrame({"part": part, "lateral_mm": 1e3 * s, "height_mm": 1e3 * z}) for part, (s, z) in parts.items()]
    pd.concat(rows).to_csv(tmp_path / "pair.csv", index=False, float_format="%.5f")
    monkeypatch.setattr(contact, "SHIFTS", np.array([-4e-3, -2e-3, 0.0, 2e-3, 4e-3]))
    material = 0.4601, 78480.0, 1.14e11, 9.2e10  # a radius of no other test: tables are cached
    mine = contact.pair_table(*material, points.read_pair(tmp_path / "pair.csv")).frame
    theirs = contact.pair_table(*material).frame
    assert np.allclose(mine["rolling_radius_m"], theirs["rolling_radius_m"], rtol=0, atol=5e-6)
    assert np.allclose(mine["angle_rad"], theirs["angle_rad"], rtol=0, atol=1e-3)
    assert np.allclose(mine["semi_axis_y_m"], theirs["semi_axis_y_m"], rtol=0.03)


def test_measured_irregularities_begin_at_a_chainage(tmp_path):
    rows = pd.DataFrame({"p_m": 12000.0 + np.arange(101), "lateral_m": 1e-3 * np.sin(np.arange(101) / 5)})
    rows = rows.assign(vertical_m=0.0, crosslevel_rad=0.0, gauge_m=0.0)
    rows.to_csv(tmp_path / "mine.csv", index=False)
    found = rough.rough_track(np.arange(0.0, 50.0), str(tmp_path / "mine.csv"), chainage=12040.0)
    assert found["lateral_m"].iloc[25] == pytest.approx(
        rows["lateral_m"].iloc[65] * irregularity.smooth_step(np.array(24 / 30)).item()
    )


def printed(*arguments, **environment):
    """What make says, with the database of its variables."""
    make = ["make", "--no-print-directory", "-np", *arguments]
    return subprocess.run(make, cwd=paths.ROOT, env=os.environ | environment, capture_output=True, text=True).stdout


def test_make_needs_no_home_that_can_be_written_and_a_lab_of_root_may_start(tmp_path):
    (tmp_path / "file").touch()
    environment = {"XDG_CACHE_HOME": "", "UV_CACHE_DIR": ""}
    for home, own in ((tmp_path, False), ("/dev/null", True), (tmp_path / "file", True)):
        assert ("UV_CACHE_DIR := " in printed("help", HOME=str(home), **environment)) is own, home
    assert ("notebooks --allow-root" in printed("lab")) is (os.getuid() == 0)


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
