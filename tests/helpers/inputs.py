# ruff: noqa: F401 (names for the calls of the table)
"""What the calls of inputs.toml are made of: things that are right, and ways to spoil one of them."""

import re
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro import (
    LTVMPC,
    NDI,
    NMPC,
    Export,
    LqgPreview,
    Readings,
    SteppedCar,
    compare,
    figures,
    lay,
    load_loop,
    load_scenario,
    load_track,
    load_vehicle,
    paths,
    simulate,
)
from railrepro.contact.table import ContactTable, contact_table
from railrepro.control import registry
from railrepro.control.registry import guidance, parameters
from railrepro.estimation.sensors import Latency
from railrepro.evidence.chain import chain
from railrepro.evidence.claims import calibrated, statements
from railrepro.evidence.report import flips
from railrepro.simulation import metrics
from railrepro.simulation.scenarios import Scenario, load_scenarios
from railrepro.studies import preview
from railrepro.track import route
from railrepro.track.alignment import alignments
from railrepro.track.irregularity import irregularities, irregularity_spectrum
from railrepro.track.rough import rough_track
from railrepro.track.route import COLUMNS, Route
from railrepro.track.table import build_table
from railrepro.tuning import swarm, task

nan, inf = np.nan, np.inf
WAY = np.arange(0.0, 100.0, 0.5)
T5, PLACES = load_track("T5"), np.array([0.0, 60.0, 99.0])
LINE = np.outer([3e-3, 0.0, 0.0, 0.0], np.ones(3))
FAULT = {"kind": "alignment_fault", "start": 40.0, "length": 20.0, "amplitude": 4e-3}
SWITCH = {"kind": "lateral_offset", "start": 50.0, "length": 10.0, "offset": 5e-3, "transition": 8.0}
CONES = load_vehicle(**{"contact.profile": "cone"})
"""A car whose contact table takes no time."""
STRAIGHT = lay(load_track("T5"))
CELLS, FORCE = STRAIGHT.cells, np.eye(len(COLUMNS))[COLUMNS.index("force")]
TABLE = contact_table("cone", CONES).frame


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


def drive(law=None, vehicle=CONES, irregularities=None, **changes):
    return simulate(scenario(**changes), law or NDI(), vehicle=vehicle, irregularities=irregularities)


def rough(**channels):
    return irregularities(WAY).assign(**channels)


def planner(torque, **attributes):
    """A factory of slower controllers that plan a torque."""
    controller = type("Plan", (), {"period": 0.01, "plan": lambda self, x, u: torque} | attributes)
    return lambda *_: controller()


def planning(torque, **attributes):
    return drive(planner(torque, **attributes))


def once(factory):
    """A factory that gives both gears one controller."""
    made = {}
    return lambda *of: made.setdefault("one", factory(*of))


def of_gears(front, rear):
    return lambda vehicle, way, gear: (front, rear)[gear](vehicle, way, gear)


def law(result, **attributes):
    return type("Law", (), {"torque": lambda self, q: result} | attributes)()


def put(**values):
    """Assign an array of a car."""
    car = SteppedCar(STRAIGHT, 50.0, CONES)
    for name, value in values.items():
        setattr(car, name, value)


def on(frame):
    return SteppedCar(STRAIGHT, 50.0, CONES, table=ContactTable(frame))


def file(text, read, name="mine.csv"):
    """Read a file of some text in the working folder."""
    Path(name).write_text(text)
    return read(Path(name))


def edited(name, old, new, read, folder="data"):
    """Read a file of the project with a passage replaced."""
    text = (paths.ROOT / folder / name).read_text(encoding="utf-8")
    assert old in text, "the row is out of date"
    return file(text.replace(old, new, 1), read, name)


def choice(old, new):
    return edited("paper_like.toml", old, new, calibrated.load)


def answer(question, values):
    """Read the open questions with an answer to one of them."""
    text = (paths.ROOT / "data/answers.toml").read_text(encoding="utf-8")
    return file(
        re.sub(rf"(\[{question}\].*?answer = )\[\]", rf"\g<1>{values}", text, flags=re.S), flips.load, "mine.toml"
    )


def ndi(pole):
    """Read the tuned set of NDI with another text in place of its pole."""
    text = (paths.ROOT / "data/tuned/loop/ndi.json").read_text(encoding="utf-8")
    edited = re.sub(r'"pole": [\d.]+', pole, text, count=1)
    return file(
        edited, lambda path: guidance("ndi", registry.read("ndi", "loop", path.parent)["parameters"]), "ndi.json"
    )


def line(text):
    return file(text, load_track)
