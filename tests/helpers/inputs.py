# ruff: noqa: F401 (names for the calls of the table)
"""Names for the calls of inputs.toml, besides the facade: valid objects, and functions that make one of them wrong."""

import re
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro import NDI, SteppedCar, lay, load_scenario, load_track, load_vehicle, paths, simulate
from railrepro.contact.table import ContactTable, contact_table
from railrepro.control import registry
from railrepro.control.registry import guidance, parameters
from railrepro.evidence import benchmark
from railrepro.evidence.chain import chain
from railrepro.evidence.claims import calibrated, statements
from railrepro.evidence.report import flips
from railrepro.simulation import metrics
from railrepro.simulation.scenarios import Scenario, Sine, load_scenarios
from railrepro.studies import preview
from railrepro.track import route
from railrepro.track.alignment import alignments
from railrepro.track.irregularity import irregularities, irregularity_spectrum
from railrepro.track.rough import rough_track
from railrepro.track.route import COLUMNS, Route
from railrepro.tuning import swarm, task

nan, inf = np.nan, np.inf
WAY = np.arange(0.0, 100.0, 0.5)
T5, PLACES = load_track("T5"), np.array([0.0, 60.0, 99.0])
LINE = np.outer([3e-3, 0.0, 0.0, 0.0], np.ones(3))
FAULT = {"kind": "alignment_fault", "start": 40.0, "length": 20.0, "amplitude": 4e-3}
CONES = load_vehicle(**{"contact.profile": "cone"})  # its contact table is made at once
STRAIGHT = lay(T5)
CELLS, FORCE = STRAIGHT.cells, np.eye(len(COLUMNS))[COLUMNS.index("force")]
TABLE = contact_table("cone", CONES).frame


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


def drive(law=None, vehicle=CONES, irregularities=None, **changes):
    return simulate(scenario(**changes), law or NDI(), vehicle=vehicle, irregularities=irregularities)


def rough(**channels):
    return irregularities(WAY).assign(**channels)


def planning(torque, **attributes):
    """Drive with controllers that plan a torque every 10 ms."""
    controller = type("Plan", (), {"period": 0.01, "plan": lambda self, x, u: torque} | attributes)
    return drive(lambda *_: controller())


def of_gears(front, rear):
    return lambda vehicle, way, gear: (front, rear)[gear](vehicle, way, gear)


def law(result, **attributes):
    """A law with a torque, or with a function of q that gives it."""
    return type("Law", (), {"torque": lambda self, q: result(q) if callable(result) else result} | attributes)()


def searched(costs):
    return swarm.minimise(lambda *_: costs, [swarm.Dimension("a", 0.0, 1.0)], 2, 2, seed=0)


def on(frame):
    return SteppedCar(STRAIGHT, 50.0, CONES, table=ContactTable(frame))


def file(text, read, name="mine.csv"):
    """Write a text to a file in the working folder and read it."""
    Path(name).write_text(text)
    return read(Path(name))


def edited(name, old, new, read, folder="data"):
    """Read a file of the project after replacing the first `old` by `new`."""
    text = (paths.ROOT / folder / name).read_text(encoding="utf-8")
    assert old in text, "the row is out of date"
    return file(text.replace(old, new, 1), read, Path(name).name)


def choice(old, new):
    return edited("paper_like.toml", old, new, calibrated.load)


def answer(question, values):
    """Read the open questions with an answer to one of them."""
    text = (paths.ROOT / "data/answers.toml").read_text(encoding="utf-8")
    answered = re.sub(rf"(\[{question}\].*?answer = )\[\]", rf"\g<1>{values}", text, flags=re.S)
    return file(answered, flips.load, "mine.toml")


def tuned_ndi(path):
    return guidance("ndi", registry.read("ndi", "loop", path.parent)["parameters"])


def line(text):
    return file(text, load_track)
