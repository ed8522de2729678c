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
BOUNDS = '\n[controller.own]\npole = [10, 40, "log"]\n'
CONTROLLER = (
    'CONTROLLERS["own"] = Controller(lambda settings: settings, lambda p: StateFeedback(**p), False, "own gear")\n'
)
DRIVE = """
import numpy as np
from railrepro.control.registry import SHOWN
from railrepro.data import InputError
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.evidence.runs import swarm, tuning
from railrepro.evidence.runs.executor import executor
from railrepro.evidence.runs.experiment import Experiment
from railrepro.track.irregularity import irregularities
from dataclasses import replace
from pathlib import Path

if __name__ == "__main__":
    for name in ("own", "own_csv"):
        scenario, rough = load_scenario(name), irregularities(np.arange(60.0), "own")
        assert not simulate.run(scenario, tuning.tuned("ndi"), irregularities=rough).failed
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
"""


@pytest.fixture
def copy(tmp_path):
    """What a run needs of a clone."""
    for name in ("railrepro", "data"):
        shutil.copytree(paths.ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "build").mkdir()
    return tmp_path


def insert(file, text, before=""):
    """Add text to a file, before a passage that it has once or at its end."""
    old = file.read_text()
    assert not before or old.count(before) == 1
    file.write_text(old.replace(before, text + before) if before else old + text)


def run(folder, program, text):
    (folder / program).write_text(text)
    done = python(program, folder=folder, PYTHONPATH=str(folder), RAILREPRO_CFLAGS="-O0", RAILREPRO_WORKERS="1")
    assert done.returncode == 0, done.stderr[-2000:]


def test_what_is_added_works_and_leaves_the_tuned_sets_valid(copy):
    page = (paths.NOTEBOOKS / "book/adding.md").read_text()
    *_, example, slower = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (copy / "railrepro/control/own.py").write_text(example[example.index("class") : example.index("scenario =")])
    registry = copy / "railrepro/control/registry.py"
    insert(registry, "from railrepro.control.own import StateFeedback\n", "from railrepro.control.problem")
    insert(registry, CONTROLLER, "INVERSIONS = ")
    shutil.copy(copy / "data/tracks/T1.csv", copy / "data/own.csv")
    added = {"tracks": TRACK, "scenarios": SCENARIO, "irregularities": QUALITY, "tuning": BOUNDS}
    for name, text in added.items():
        insert(copy / f"data/{name}.toml", text)
    run(copy, "drive.py", DRIVE)
    run(copy, "example.py", example + "assert not run.failed\n" + slower + "assert not run.failed\n")


@pytest.mark.parametrize(
    ("file", "old", "new", "valid"),
    [
        ("data/tuning.toml", "end_m = 280", "end_m = 280.0  # a remark", True),
        ("data/vehicle.toml", "[adhesion.wet]", "[adhesion.damp]", True),
        ("data/irregularities.toml", "en_C_300 = { level_mm = 0.85", "en_C_300 = { level_mm = 0.86", True),
        ("data/tuning.toml", "ndi = { pole = 30.0", "ndi = { pole = 31.0", True),
        ("data/tracks.toml", "radius_m = 4250", "radius_m = 4251", False),
        ("data/scenarios.toml", "period_start_m = 60", "period_start_m = 61", False),
        ("data/tuning.toml", "pole = [3, 200,", "pole = [3, 201,", False),
        ("data/tuning.toml", '"drive.lag" = 0.0075', '"drive.lag" = 0.0076', False),
        ("data/irregularities.toml", "en_B_300 = { level_mm = 0.55", "en_B_300 = { level_mm = 0.56", False),
        ("data/sensors.toml", "value = 0.0002", "value = 0.0003", False),
        ("data/vehicle.toml", 'symbol = "r_0", value = 0.46', 'symbol = "r_0", value = 0.461', False),
    ],
)
def test_a_tuned_set_is_valid_until_what_its_cost_reads_changes(file, old, new, valid, tmp_path, monkeypatch):
    def origin():
        return tuning.origin("ndi", tuning.load_task(setting="loop"), load_vehicle())

    before, text = origin(), (paths.ROOT / file).read_text()
    assert old in text
    (tmp_path / "data").mkdir()
    (tmp_path / file).write_text(text.replace(old, new, 1))
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    assert (origin() == before) == valid
