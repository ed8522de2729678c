"""The guide's page on adding, done to the letter in a copy of the checkout: everything works and stays tuned."""

import re
import shutil

import pytest
from program import python

from railrepro import paths
from railrepro.evidence.runs import tuning
from railrepro.vehicle.parameters import load_vehicle

TRACK = """
[own]  # a remark
design_speed_kmh = 100
unbalanced_acceleration_mps2 = 0.2
radius_m = -600
straight_m = 20
clothoid_m = 100
arc_m = 80
"""
SCENARIO = """
[own]
track = "own"
speed_kmh = 100
end_m = 60

[own_csv]
track = "data/own.csv"
speed_kmh = 100
end_m = 60
"""
QUALITY = '\nown = { level_mm = 1.1, alignment_mm = 0.8, confidence = "A" }\n'
CLAIM = """
[C99]
section = "own"
statement = "Four tracks are in Table I"
kind = "statement"
unit = "-"
above = 3.5
below = 4.5
reason = "a count"
evidence = "data/results/table1.csv"
notebook = "01_tracks"
"""
PREDICATE = '    "C99": lambda e: float(len(e.table("table1"))),\n'
CONTROLLER = (
    'CONTROLLERS["own"] = Controller(lambda settings: settings, lambda p: StateFeedback(**p), False, "own gear")\n'
)
DRIVE = """
import numpy as np
from railrepro.control.registry import SHOWN
from railrepro.data import InputError
from railrepro.evidence.report import claims
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.evidence.claims import statements
from railrepro.evidence.runs import swarm, tuning
from railrepro.evidence.runs.executor import executor
from railrepro.evidence.runs.experiment import Experiment
from railrepro.track.irregularity import irregularities
from railrepro.vehicle.parameters import load_vehicle
from dataclasses import replace
from pathlib import Path

if __name__ == "__main__":
    for name in ("own", "own_csv"):
        scenario, rough = load_scenario(name), irregularities(np.arange(60.0), "own")
        assert not simulate.run(scenario, tuning.tuned("ndi"), irregularities=rough).failed
    assert "C99" in statements.load() and claims.evaluate().set_index("id").verdict["C99"] == "reproduced"
    for name in SHOWN:
        tuning.load(name)
    try:
        tuning.load("own")
    except InputError as error:
        assert "make tune" in str(error)
    task = tuning.load_task()
    run = Experiment(scenario, "own")
    small = replace(task, runs={"own": run}, budget=task.budget | {"particles": 1, "iterations": 1, "seeds": [1]})
    with executor() as pool:
        tuning.save(swarm.tune("own", small, pool, quiet=True), Path("build/tuned"))
    vehicle = Path("data/vehicle.toml").read_text().replace("value = 0.46", "value = 0.45")
    Path("build/own.toml").write_text(vehicle)
    assert load_vehicle("build/own.toml") != load_vehicle()
"""


@pytest.fixture
def copy(tmp_path):
    """What a clone holds, without the figures."""
    for name in ("railrepro", "data", "notebooks"):
        shutil.copytree(paths.ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(paths.ROOT / "figures", tmp_path / "figures", ignore=shutil.ignore_patterns("*.csv"))
    (tmp_path / "build").mkdir()
    return tmp_path


def add(file, text):
    file.write_text(file.read_text() + text)


def insert(file, before, text):
    assert file.read_text().count(before) == 1
    file.write_text(file.read_text().replace(before, text + before))


def run(folder, program):
    done = python(program, folder=folder, PYTHONPATH=str(folder), RAILREPRO_CFLAGS="-O0", RAILREPRO_WORKERS="1")
    assert done.returncode == 0, done.stderr[-2000:]


def test_what_is_added_works_and_leaves_the_tuned_sets_valid(copy):
    page = (paths.NOTEBOOKS / "book/adding.md").read_text()
    *_, example, slower = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (copy / "railrepro/control/own.py").write_text(example[example.index("class") : example.index("scenario =")])
    registry = copy / "railrepro/control/registry.py"
    insert(registry, "from railrepro.control.problem", "from railrepro.control.own import StateFeedback\n")
    insert(registry, "INVERSIONS = ", CONTROLLER)
    add(copy / "data/tuning.toml", '\n[controller.own]\npole = [10, 40, "log"]\n')
    add(copy / "data/tracks.toml", TRACK)
    shutil.copy(copy / "data/tracks/T1.csv", copy / "data/own.csv")
    add(copy / "data/scenarios.toml", SCENARIO)
    add(copy / "data/irregularities.toml", QUALITY)
    add(copy / "data/claims.toml", CLAIM)
    insert(copy / "railrepro/evidence/claims/statements.py", '    "C44": _similar_times', PREDICATE)
    (copy / "drive.py").write_text(DRIVE)
    run(copy, "drive.py")
    (copy / "example.py").write_text(example + "assert not run.failed\n" + slower + "assert not run.failed\n")
    run(copy, "example.py")


@pytest.fixture
def origin(tmp_path, monkeypatch):
    """Origin of NDI's tuned set when one file reads differently."""
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))

    def changed(file, old, new):
        text = (paths.ROOT / file).read_text()
        assert old in text
        (tmp_path / "data").mkdir(exist_ok=True)
        (tmp_path / file).write_text(text.replace(old, new, 1))
        return tuning.origin("ndi", tuning.load_task(setting="loop"), load_vehicle())

    return changed


LEAVES = [
    ("data/tuning.toml", "end_m = 280", "end_m = 280.0  # a remark"),
    ("data/scenarios.toml", 'paper = "Fig. 6"', 'paper = "elsewhere"'),
    ("data/vehicle.toml", "[adhesion.wet]", "[adhesion.damp]"),
    ("data/irregularities.toml", "en_C_300 = { level_mm = 0.85", "en_C_300 = { level_mm = 0.86"),
    ("data/tuning.toml", "ndi = { pole = 30.0", "ndi = { pole = 31.0"),
]
CHANGES = [
    ("data/tracks.toml", "radius_m = 4250", "radius_m = 4251"),
    ("data/scenarios.toml", "period_start_m = 60", "period_start_m = 61"),
    ("data/tuning.toml", "end_m = 280", "end_m = 281"),
    ("data/tuning.toml", "pole = [3, 200,", "pole = [3, 201,"),
    ("data/tuning.toml", "weight = 0.25", "weight = 0.26"),
    ("data/tuning.toml", '"drive.lag" = 0.0075', '"drive.lag" = 0.0076'),
    ("data/irregularities.toml", "en_B_300 = { level_mm = 0.55", "en_B_300 = { level_mm = 0.56"),
    ("data/sensors.toml", "value = 0.0002", "value = 0.0003"),
    ("data/vehicle.toml", 'symbol = "r_0", value = 0.46', 'symbol = "r_0", value = 0.461'),
]


@pytest.mark.parametrize(("edit", "valid"), [*((edit, True) for edit in LEAVES), *((edit, False) for edit in CHANGES)])
def test_a_tuned_set_is_valid_until_what_its_cost_reads_changes(edit, valid, origin):
    file, old, new = edit
    assert (origin(file, old, new) == origin(file, "", "")) == valid
