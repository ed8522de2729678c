# ruff: noqa: F401 (names for the calls of the table)
"""What the calls of inputs.toml are made of: things that are right, and ways to spoil one of them."""

from pathlib import Path

import numpy as np

from railrepro import NDI, SteppedCar, lay, load_scenario, load_track, load_vehicle, paths, simulate
from railrepro.contact.table import ContactTable, contact_table
from railrepro.control.registry import guidance
from railrepro.evidence.claims import statements
from railrepro.evidence.report import figures, flips
from railrepro.evidence.runs import preview, pso, tuning
from railrepro.track.alignment import alignments
from railrepro.track.irregularity import irregularities
from railrepro.track.rough import rough_track
from railrepro.track.route import COLUMNS, Route
from railrepro.track.table import build_table

nan, inf = np.nan, np.inf
WAY = np.arange(0.0, 100.0, 0.5)
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
    return lambda vehicle, route, gear: (front, rear)[gear](vehicle, route, gear)


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


def edited(name, old, new, read):
    """Read a file of the project with a passage replaced."""
    text = (paths.ROOT / "data" / name).read_text()
    assert old in text, "the row is out of date"
    return file(text.replace(old, new, 1), read, name)


def line(text):
    return file(text, load_track)
