# ruff: noqa: F401, F811 (names for the calls of the table)
"""What the calls of inputs.toml are made of: things that are right, and ways to spoil one of them."""

import inspect
from pathlib import Path

import numpy as np

from railrepro import (
    NDI,
    NMPC,
    Export,
    LqgPreview,
    SteppedCar,
    Vehicle,
    export_fmu,
    lay,
    load_scenario,
    load_track,
    load_vehicle,
    metrics,
    paths,
    simulate,
    tuned,
)
from railrepro.contact.points import read_pair
from railrepro.contact.table import contact_table
from railrepro.control.registry import guidance
from railrepro.evidence.claims import statements
from railrepro.evidence.runs import preview, pso, tuning
from railrepro.track.alignment import alignments
from railrepro.track.irregularity import irregularities
from railrepro.track.rough import rough_track
from railrepro.track.table import build_table

nan, inf = np.nan, np.inf
folder = Path()
"""Where files are written; the test sets it."""
WAY = np.arange(0.0, 100.0, 0.5)
FAULT = {"kind": "alignment_fault", "start": 40.0, "length": 20.0, "amplitude": 4e-3}
SWITCH = {"kind": "lateral_offset", "start": 50.0, "length": 10.0, "offset": 5e-3, "transition": 8.0}
SINE = {"kind": "sine", "amplitude_mm": 3, "period_m": 50, "start_m": 0}


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


OPTIONS = set(inspect.signature(simulate).parameters)
CONE = {"contact.profile": "cone"}
CONES = load_vehicle(**CONE)
"""A car whose contact table takes no time."""


def drive(law=None, **changes):
    options = {"vehicle": CONES} | {name: changes.pop(name) for name in OPTIONS & set(changes)}
    return simulate(scenario(**changes), NDI() if law is None else law, **options)


def vehicle(**changes):
    return load_vehicle(**{key.replace("__", "."): value for key, value in changes.items()})


def spoilt_car(value):
    car = SteppedCar("T5", 50.0, CONES)
    car.state[3] = value
    car.step()


def rough(**channels):
    return irregularities(WAY).assign(**channels)


def planning(torque, **attributes):
    """A run whose slower controllers plan a torque."""
    controller = type("Plan", (), {"period": 0.01, "plan": lambda self, x, u: torque} | attributes)
    return drive(lambda *_: controller())


def file(text, read, name="mine.csv"):
    """Read a file of some text, in bytes or not."""
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read(path)


def edited(name, old, new, read):
    """Read a file of the project with a passage replaced."""
    text = (paths.ROOT / "data" / name).read_text()
    assert old in text, "the row is out of date"
    return file(text.replace(old, new, 1), read, Path(name).name)


def tracks(path):
    return [build_table(each) for each in alignments(path).values()]


def line(text):
    return file(text, load_track)


def rails(text, length=19.0):
    return file(text, lambda path: rough_track([0.0, length], file=str(path)))


def points_of(text):
    return file(text, read_pair, "pair.csv")


def wheel(scale, missing=None):
    """Points of a flat wheel from -60 to 60 mm, scaled."""
    return "".join(f"wheel,{scale * 1.5 * i},{-1e-3 * abs(i)}\n" for i in range(-40, 41) if i != missing)


POINTS = "part,lateral_mm,height_mm\n"
ROUGH = "p_m,lateral_m,vertical_m,crosslevel_rad,gauge_m\n"
GOOD = "".join(f"{p},0,0,0,0\n" for p in range(20))
