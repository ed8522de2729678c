"""Misuse, as a table: each row is a call or the edit of a file, and the sentence that answers it.

Refused is what cannot be meant (`InputError`), warned of is what may be meant but is more likely another unit, told is
what a command says; nothing is silent, nothing ends in a traceback. `test_bad_inputs.py` holds an older table.
"""

import os
import subprocess
import sys
import time
import types
import warnings

import casadi as ca
import numpy as np
import pandas as pd
import pytest

from railrepro import __main__ as command
from railrepro import files, parent_death, paths
from railrepro.car.component import SteppedCar
from railrepro.compile import cache
from railrepro.contact import points, profiles
from railrepro.contact import table as contact
from railrepro.control import lateral
from railrepro.control.export import Export
from railrepro.control.ndi import NDI
from railrepro.errors import InputError
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.film import scene
from railrepro.evidence.runs import pso, tuning
from railrepro.evidence.uncertainty import robustness
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario, load_scenarios
from railrepro.track import irregularity, measured, rough
from railrepro.track.alignment import alignments
from railrepro.track.route import lay
from railrepro.track.table import load_track, read_table
from railrepro.vehicle.parameters import load_vehicle

NDI_LAW, WAY = NDI(), np.arange(0.0, 100.0, 0.5)


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


def planning(torque, **attributes):
    """A run whose slower controllers plan a torque."""
    controller = type("Plan", (), {"period": 0.01, "plan": lambda self, x, u: torque} | attributes)
    return lambda _: simulate.run(scenario(), lambda *_: controller())


class Law:
    """A 1 kHz law that answers what it is given."""

    memory = ()

    def __init__(self, answer, gains=None):
        self.answer, self.gains = answer, lambda: {} if gains is None else gains

    def torque(self, gear, track_ahead, memory, gain, model):
        return self.answer


def law(answer, gains=None):
    return lambda _: lateral.kind(Law(answer, gains))


def file(text, read, name="mine.csv"):
    """Read a file of some text, in bytes or not."""

    def call(folder):
        path = folder / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read(path)

    return call


def edited(name, old, new, read):
    """Read a file of the project with a passage replaced."""

    def call(folder):
        text = (paths.ROOT / "data" / name).read_text()
        assert old in text, "the row is out of date"
        return file(text.replace(old, new, 1), read, name)(folder)

    return call


def vehicle(**changes):
    return lambda _: load_vehicle(**{key.replace("__", "."): value for key, value in changes.items()})


def toml(text, read, name="mine.toml"):
    return file(text, read, name)


def quality(text):
    return toml(text, irregularity.track_quality, "irregularities.toml")


def line(text):
    return file(text, load_track)


def rails(text, **options):
    return file(text, lambda path: measured.read_irregularities(path, **options))


def task(old, new):
    return edited("tuning.toml", old, new, lambda path: tuning.load_task(path, "paper"))


def points_of(text):
    return file(text, points.read_pair, "pair.csv")


def wheel(scale, missing=None):
    """Points of a flat wheel from -60 to 60 mm, scaled."""
    return "".join(f"wheel,{scale * 1.5 * i},{-1e-3 * abs(i)}\n" for i in range(-40, 41) if i != missing)


POINTS = "part,lateral_mm,height_mm\n"
ROUGH = "p_m,lateral_m,vertical_m,crosslevel_rad,gauge_m\n"
GOOD = "".join(f"{p},0,0,0,0\n" for p in range(20))
REFUSED = {
    "a plan that is a text": (planning("a"), "plan() returned 'a', a number (N m) is needed"),
    "a plan that is nothing": (planning(None), "plan() returned None"),
    "a plan of two numbers": (planning(np.ones(2)), "plan() returned array([1., 1.])"),
    "a plan that is a truth value": (planning(True), "plan() returned True"),
    "a controller without period": (
        planning(0.0, period=None),
        "lateral controller Plan: period is None, a number in s",
    ),
    "a period that is a text": (planning(0.0, period="5 ms"), "period is '5 ms', a number in s"),
    "a controller without plan": (planning(0.0, plan=None), "lateral controller Plan: has no plan(x_hat, u_d)"),
    "a factory without arguments": (lambda _: simulate.run(scenario(), lambda: None), "cannot be called with (vehicle"),
    "a law that gives nothing": (law(None), "torque() returned None, a pair (du, memory by name)"),
    "a torque that is nothing": (law((None, {})), "its torque is None, a scalar expression"),
    "a torque that is a vector": (law((ca.SX.ones(2), {})), "an expression of shape (2, 1), a scalar"),
    "gains that are a list": (law((0.0, {}), [1]), "gains() gives [1], a table"),
    "half a step": (lambda _: tuning.tuned("nmpc", steps=2.5), "2.5 steps of 0.005 s; 2 or more"),
    "an export of a name": (lambda _: Export(NDI_LAW, "T3"), "export: route is 'T3'"),
    "an export of nothing": (lambda _: Export(NDI_LAW, None), "export: route is None"),
    "an export for a name": (lambda _: Export(NDI_LAW, lay(load_track("T3")), "v"), "export: vehicle is 'v'"),
    "an export without settings": (
        lambda _: Export(NDI_LAW, lay(load_track("T3")), settings=None),
        "export: settings is None, an object of the class LawSettings",
    ),
    "settings of an export in a row": (
        lambda _: Export(NDI_LAW, lay(load_track("T3")), settings=(None, None, 0.0, None)),
        "export: settings is (None, None, 0.0, None), an object of the class LawSettings",
    ),
    "an export to nowhere": (lambda _: Export(NDI_LAW, lay(load_track("T3"))).write_source(None), "None is no path"),
    "irregularities of nothing": (lambda _: measured.read_irregularities(None), "None is no path of a file"),
    "a track of a number": (lambda _: read_table(3), "3 is no path of a file"),
    "a vehicle of a number": (lambda _: load_vehicle(3), "3 is no path of a file"),
    "a film of nothing": (lambda _: scene.compose(scenario(), {}, load_vehicle(), 10, "x"), "at least one run"),
    "a film of no car": (lambda _: scene.compose(scenario(), {}, None, 10, "x"), "vehicle is None"),
    "no samples": (lambda _: robustness.robustness(0), "samples = 0, a number from 1 to 4096"),
    "a gear lighter to turn than its wheels": (
        vehicle(gear__inertia_z=10.0),
        "gear.inertia_z = 10 kg m2 contains those of the wheels, more than 64 kg m2",
    ),
    "the same to roll": (vehicle(gear__inertia_x=60.0), "gear.inertia_x = 60 kg m2"),
    "frame and wheels heavier to turn than the gear": (
        vehicle(primary__two_stage=True, gear__inertia_z=600.0, primary__frame_inertia_z=539.0),
        "the wheels and the frame, more than 603 kg m2",
    ),
    "bounds between whole numbers": (lambda _: pso.Dimension("L", 4.5, 40.2, "integer"), "4.5..40.2, whole numbers"),
    "a seed three times": (task("seeds = [", "seeds = [7, 7, 7, "), "seeds has 7 3 times, once is needed"),
    "a run twice": (task('runs = ["T1"', 'runs = ["T1", "T1"'), "runs has 'T1' 2 times"),
    "a track of one row": (
        toml("[dot]\nsegments = [{ length_m = 0.1 }]\n", lambda path: lay_first(path)),
        "track dot: is 0.1 m long, at least 0.5 m",
    ),
    "a channel twice": (rails(ROUGH.replace("gauge_m", "gauge_m,lateral_m") + GOOD), "lateral_m is there 2 times"),
    "irregularities of foreign bytes": (rails(b"p_m,\xff\n1,2\n"), "mine.csv: cannot be read as CSV"),
    "measured elsewhere": (
        rails(ROUGH + "".join(f"{12000 + p},0,0,0,0\n" for p in range(20)), length=10.0),
        "p_m goes from 12000 to 12019 m, the run needs 0 to 10 m; `chainage` shifts it",
    ),
    "a chainage that is a text": (rails(ROUGH + GOOD, chainage="km 12"), "chainage is 'km 12', a number in m"),
    "a chainage without file": (
        lambda _: rough.rough_track(WAY, chainage=3.0),
        "chainage is 3.0, but there is no file",
    ),
    "decimal commas between points": (
        rails(ROUGH + '0,0,0,0,0\n1,"0,5",0,0,0\n'),
        "'0,5', a finite number is needed (d",
    ),
    "decimal commas between commas": (
        line("chainage_m,radius_m\n0,0,0\n12,5,0\n20,5,0\n"),
        "more fields than the head",
    ),
    "semicolons": (line("chainage_m;radius_m\n0;0\n"), "separated by ';', commas and decimal points"),
    "a radius in kilometres": (line("chainage_m,radius_m\n0,0\n9,1.5\n"), "row 3, radius_m = 1.5, at least 50 m"),
    "a cant in millimetres": (line("chainage_m,radius_m,cant_m\n0,0,0\n9,500,120\n"), "cant_m = 120, up to 0.3 m"),
    "a curvature of degrees": (line("chainage_m,curvature_1pm\n0,0\n9,2\n"), "curvature_1pm = 2, up to 0.02 1/m"),
    "no curve": (line("chainage_m,cant_m\n0,0\n9,0\n"), "neither of ['curvature_1pm', 'radius_m']"),
    "two curves": (line("chainage_m,radius_m,curvature_1pm\n0,0,0\n9,0,0\n"), "one of them is needed"),
    "two cants": (line("chainage_m,radius_m,cant_m,cant_mm\n0,0,0,0\n9,0,0,0\n"), "one of them is needed"),
    "a chainage twice": (line("chainage_m,radius_m\n0,0\n9,0\n9,500\n"), "row 4, chainage_m does not increase"),
    "no points": (points_of("part,lateral_mm\n"), "pair.csv: column height_mm is missing"),
    "points of an axle": (
        points_of("part,lateral_mm,height_mm\naxle,0,0\n"),
        "part is ['axle'], ['wheel', 'rail'] are",
    ),
    "three points": (points_of(POINTS + "wheel,0,0\n" * 3), "pair.csv: wheel has 3 points, at least 50 are needed"),
    "points in other units": (points_of(POINTS.replace("mm", "m") + wheel(1.0)), "reaches to 60 m, up to 0.2 m"),
    "points to and fro": (points_of(POINTS + wheel(1.0) + wheel(1.0)), "wheel: lateral_mm does not go one way"),
    "a wheel without flange": (
        points_of(POINTS + wheel(0.5)),
        "from -30.0 to 30.0 mm, -42 to 30 mm of its tape circle",
    ),
    "a gap in a wheel": (points_of(POINTS + wheel(1.0, missing=10)), "wheel has a gap of 3.0 mm, up to 2 mm"),
    "a point that is a text": (points_of(POINTS + wheel(1.0) + "wheel,61,high\n"), "that is no finite number"),
    "a flat rail": (points_of(POINTS + wheel(1.0).replace("wheel", "rail")), "rail reaches 0.0 mm below its top"),
    "a pair that there is not": (vehicle(contact__profile="round"), "contact.profile is 'round', allowed are 'cone'"),
    "a CSV of points that there is not": (
        lambda _: contact.contact_table("nowhere.csv", load_vehicle()),
        "nowhere.csv: cannot be read as CSV",
    ),
    "a quality of foreign bytes": (quality(b"own = '\xe9'"), "irregularities.toml: cannot be read as TOML"),
    "no quality": (quality(""), "irregularities.toml: is empty"),
    "an unknown confidence": (
        quality("own = { level_mm = 1, alignment_mm = 1, confidence = 7 }"),
        "[own]: confidence is 7, allowed are 'VV'",
    ),
    "a shadowed spectrum": (
        quality("erri_low = { level_mm = 1, alignment_mm = 1, confidence = 'A' }"),
        "[erri_low] has the name of a spectrum of ERRI B176",
    ),
    "a quality of a text": (quality("own = { level_mm = '1', alignment_mm = 1, confidence = 'A' }"), "level_mm is '1'"),
}


def lay_first(path):
    from railrepro.track.table import build_table

    return [build_table(alignment) for alignment in alignments(path).values()]


@pytest.mark.parametrize("what", REFUSED)
def test_refused_in_one_sentence(what, tmp_path):
    call, sentence = REFUSED[what]
    with pytest.raises(InputError) as refused:
        call(tmp_path)
    said = str(refused.value)
    assert any(part in said for part in sentence.split("|")) and len(said.splitlines()) == 1, said


def rough_of(**channels):
    return lambda _: irregularity.check(irregularity.irregularities(WAY).assign(**channels))


WARNED = {
    "a body in tonnes": (
        vehicle(body__mass=26.0),
        "body.mass = 26 is unusual, 2000 to 200000 kg are usual: is it in kg?",
    ),
    "a body of a kilogram": (vehicle(body__mass=1.0), "body.mass = 1 is unusual"),
    "a gear of a kilogram": (vehicle(gear__mass=1.0), "gear.mass = 1 is unusual"),
    "a spring of a newton": (vehicle(suspension__k_z=1.0), "suspension.k_z = 1 is unusual"),
    "a spring in kN/m": (vehicle(suspension__k_y=92.5), "is it in N/m?"),
    "a torque in kN m": (vehicle(drive__torque_limit=4.0), "drive.torque_limit = 4 is unusual"),
    "a power in kW": (vehicle(drive__power_limit=450.0), "is it in W?"),
    "a load in kN": (vehicle(contact__nominal_load=78.48), "is it in N?"),
    "a gyroscope in degrees": (
        lambda _: load_loop(**{"gyro.noise": 0.2}),
        "gyro.noise = 0.2 is unusual, 1e-05 to 0.1 rad/s",
    ),
    "a quality in metres": (
        quality("own = { level_mm = 0.00125, alignment_mm = 1, confidence = 'A' }"),
        "own.level_mm = 0.00125 is unusual, 0.05 to 20 mm are usual",
    ),
    "an amplitude in metres": (
        lambda _: scenario(set_point={"kind": "sine", "amplitude_mm": 0.003, "period_m": 50, "start_m": 0}),
        "set_point.amplitude_mm = 0.003 is unusual, 0.05 to 20 mm",
    ),
    "a cross level of 45 mm": (rough_of(crosslevel_rad=0.03), "crosslevel_rad of 0.03 is unusual, up to 0.025 rad"),
    "a level of 80 mm": (rough_of(vertical_m=0.08), "vertical_m of 0.08 is unusual, up to 0.05 m"),
    "a measured cross level of 45 mm": (
        rails(ROUGH + GOOD.replace("7,0,0,0", "7,0,0,0.03")),
        "mine.csv: crosslevel_rad of 0.03 is unusual",
    ),
    "a car beyond its track": (
        lambda _: at_the_end().step(exchanges=3),
        "beyond the end of its track, 1500 m, at t = ",
    ),
}


def at_the_end():
    car = SteppedCar("T5", 100.0)
    for name in ("body.s", "front.s", "rear.s"):
        car.state[car.model.states.index(name)] += car.route.length
    return car


@pytest.mark.parametrize("what", WARNED)
def test_warned_of_in_one_sentence(what, tmp_path):
    call, sentence = WARNED[what]
    with pytest.warns(UserWarning) as said:
        call(tmp_path)
    said = [str(warning.message) for warning in said]
    assert len(said) == 1 and sentence in said[0] and len(said[0].splitlines()) == 1, said


def test_nothing_that_the_project_holds_is_unusual():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_vehicle(), load_loop(), load_scenarios(), irregularity.track_quality(), tuning.load_task()


ARGUMENTS = {
    "no samples": (["robustness", "--samples", "0"], "argument --samples: '0' is no whole number from 1 to 4096"),
    "samples in words": (["robustness", "--samples", "many"], "'many' is no whole number"),
    "a bare number": (["robustness", "robustness", "0"], "study '0' is not known"),
    "too much for margins": (["margins", "now"], "unrecognized arguments: now"),
    "too much for order": (["order", "--quick"], "unrecognized arguments: --quick"),
    "too much for the report": (["report", "please"], "unrecognized arguments: please"),
    "an abbreviation": (["report", "--acc"], "unrecognized arguments: --acc"),
    "two sizes": (["matching", "small", "committed"], "unrecognized arguments: committed"),
    "a size that there is not": (["matching", "huge"], "sizes ['committed', 'small'], found 'huge'"),
    "a setting that there is not": (["probe", "fair"], "setting 'fair' is not known"),
    "a negative seed": (["score", "ndi", "--seed", "-1"], "is no whole number|expected one argument"),
    "no command": ([], "the following arguments are required: COMMAND"),
    "a command that there is not": (["train"], "invalid choice: 'train'"),
    "no command of the chain": (["chain"], "the following arguments are required: COMMAND"),
    "no notebook": (["chain", "run"], "the following arguments are required: name"),
}


@pytest.mark.parametrize("what", ARGUMENTS)
def test_wrong_arguments_are_told_in_one_sentence_before_anything_starts(what, capsys):
    arguments, sentence = ARGUMENTS[what]
    try:
        code = command.main(arguments)
    except SystemExit as ended:
        code = ended.code
    said = capsys.readouterr().err
    assert code in (1, 2) and any(part in said for part in sentence.split("|")), said
    assert len(said.splitlines()) == 1 and said.startswith("error: "), said


COMMANDS = ["tune", "probe", "robustness", "matching", "margins", "order", "bench", "second-opinion", "report",
            "article", "answers", "score", "leaderboard", "film", "chain"]  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_help_starts_nothing(name, monkeypatch, capsys):
    monkeypatch.setattr(command.importlib, "import_module", lambda module: pytest.fail(f"{module} is imported"))
    with pytest.raises(SystemExit) as ended:
        command.main([name, "--help"])
    assert ended.value.code == 0 and "usage: python -m railrepro" in capsys.readouterr().out


@pytest.mark.parametrize("group", [(), ("chain",)])
def test_every_command_leads_to_a_function(group):
    import importlib

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
            files.emptied(folder)
    assert (mine / "chapter.tex").read_text() == "years of work"
    for _ in range(2):
        files.emptied(made)
        assert [file.name for file in made.iterdir()] == [files.MARK]
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
    table = line(text)(tmp_path).table
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


gymnasium_rows = {
    "options": (lambda env: env.reset(options={"speed": 3}), "options are {'speed': 3}, there are none"),
    "states before the start": (lambda env: env.states, "reset() is needed before there are states"),
    **{
        f"the action {action!r}": (lambda env, action=action: stepped(env, action), "two numbers from -1 to 1")
        for action in ("ab", {}, [1j, 0], [True, False], [[1], [2, 3]], [None, 0])
    },
}


def stepped(env, action):
    env._exchange, env.duration = types.SimpleNamespace(ended=False, time=0.0), 1.0
    return env.step(action)


@pytest.mark.parametrize("what", gymnasium_rows)
def test_the_environment_answers_in_one_sentence(what):
    pytest.importorskip("gymnasium")
    from railrepro.evidence.env.guidance import GuidanceEnv

    call, sentence = gymnasium_rows[what]
    env = GuidanceEnv.__new__(GuidanceEnv)
    env._exchange = None
    with pytest.raises(InputError) as refused:
        call(env)
    assert sentence in str(refused.value), refused.value
