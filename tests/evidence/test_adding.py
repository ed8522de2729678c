"""The steps of the guide's page on adding, in a copy of the checkout."""

import re
import shutil

from program import python

from railrepro import paths

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
CONTROLLER = 'CONTROLLERS["own"] = Controller(lambda settings: settings, lambda p: StateFeedback(**p), False)\n'
DRIVE = """
import numpy as np
from railrepro.control.registry import tuned
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies.experiment import Experiment
from railrepro.track.irregularity import irregularities
from railrepro.tuning import sets
from railrepro.tuning.task import load_task
from railrepro.tuning.tune import tune
from dataclasses import replace
from pathlib import Path

if __name__ == "__main__":
    for name in ("own", "own_csv"):
        scenario, rough = load_scenario(name), irregularities(np.arange(60.0), "own")
        assert not simulate.run(scenario, tuned("ndi"), irregularities=rough).failed
    task = load_task()
    run = Experiment(scenario, "own")
    small = replace(task, runs={"own": run}, budget=task.budget | {"particles": 1, "iterations": 1, "seeds": [1]})
    sets.save(tune("own", small, quiet=True), Path("build/tuned"))
"""


def insert(file, text, before=""):
    """Insert text in a file before a passage that occurs once, or at the end."""
    old = file.read_text()
    assert not before or old.count(before) == 1
    file.write_text(old.replace(before, text + before) if before else old + text)


def test_the_steps_of_the_guide_work(copy):
    page = (paths.NOTEBOOKS / "book/adding.md").read_text()
    *_, example, _ = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    law = example[example.index("class") : example.index("scenario =")]
    (copy / "railrepro/control/own.py").write_text("import casadi as ca\n\n\n" + law)
    registry = copy / "railrepro/control/registry.py"
    insert(registry, "from railrepro.control.own import StateFeedback\n", "from railrepro.control.problem")
    insert(registry, CONTROLLER, "INVERSIONS = ")
    shutil.copy(copy / "data/tracks/T1.csv", copy / "data/own.csv")
    added = {"tracks": TRACK, "scenarios": SCENARIO, "irregularities": QUALITY, "tuning": BOUNDS}
    for name, text in added.items():
        insert(copy / f"data/{name}.toml", text)
    (copy / "drive.py").write_text(DRIVE)
    done = python("drive.py", folder=copy, PYTHONPATH=str(copy), RAILREPRO_CFLAGS="-O0", RAILREPRO_WORKERS="1")
    assert done.returncode == 0, done.stderr[-2000:]
