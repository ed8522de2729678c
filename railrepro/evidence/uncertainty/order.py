"""Sensitivity of the controller ranking: NMPC against inversions on T3 while one thing after the other is changed.

`python -m railrepro order` writes data/results/order_turns.csv, one row per run. Every finished run is in the store, so
an interrupted study goes on where it was. Serves the paper's Fig. 6.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import pandas as pd

from railrepro import paths
from railrepro.control import registry
from railrepro.data import InputError, write
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.executor import executor, ordered_map
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.alignment import Alignment, alignments, superelevation_angle
from railrepro.vehicle.parameters import load_vehicle

SCENARIO = "curve_entry_T3"
CONTROLLERS = ("nmpc", "ndi", "ndi_integral")
"""The paper's two, and the strongest without preview."""
SETTINGS = ("paper", "equal")
SEEDS = (101, 102, 103)
"""Of the noise; tuning used others."""
_GROUPS = ("lateral", "gyro", "wheel_speed", "speed", "position")


@dataclass(frozen=True)
class Axis:
    """One thing that is changed.

    Attributes
    ----------
    unit : str
    values : tuple
        Numbers, or names of choices.
    change : callable
        Value -> changed arguments of `Experiment`.
    controllers : tuple of str
        Whom it concerns.
    """

    unit: str
    values: tuple
    change: Callable[[float | str], dict] = field(default=lambda value: {})
    controllers: tuple[str, ...] = CONTROLLERS


def _noisy(factor: float) -> dict:
    """Sensors of the loop with a multiple of their noise, no bias and no latency, and the filter."""
    loop = load_loop()
    noise = {f"{group}.noise": factor * getattr(loop, group).noise for group in _GROUPS}
    quiet = {f"{group}.bias": 0.0 for group in _GROUPS} | {"latency.measurement": 0.0, "latency.command": 0.0}
    return {"sensors": noise | quiet | {"seed": 0}}


CAR = {
    "S1002": {},
    "cone": {"plant": {"contact.profile": "cone"}},
    "S1002, filter": {"sensors": {"perfect": True}},
    "S1002, loop": {"sensors": {"seed": 0}},
}
"""Profiles of the wheels; and what stands between the car and its controllers: nothing, the filter of the realistic
loop with exact readings, all of that loop."""
AXES = {
    "bandwidth": Axis("over the tuned", (1 / 3, 0.5, 2 / 3, 1.0, 1.5, 2.0, 3.0, 4.0), controllers=CONTROLLERS[1:]),
    "unbalanced acceleration": Axis("m/s2", (0.0, 0.15, 0.3, 0.4333, 0.65, 0.85, 1.0)),
    "creep stiffness": Axis(
        "over ours",
        (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0),
        lambda value: {"plant": {"contact.shear_modulus": value * load_vehicle().contact.shear_modulus}},
    ),
    "car": Axis("-", tuple(CAR), CAR.__getitem__),
    "delay": Axis(
        "ms",
        (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0),
        lambda value: {"sensors": {"perfect": True, "inverter.delay": 1e-3 * value}},
    ),
    "noise": Axis("over the sensors'", (0.0, 0.25, 0.5, 1.0, 2.0), _noisy),
}
"""Everything is nominal but the axis. Delay and noise come behind the filter of the realistic loop: their zero is the
choice "S1002, filter"."""


def experiment(
    axis: str, value: float | str, setting: str, controller: str, seed: int = 0, scenario: str = SCENARIO
) -> Experiment:
    """The run of a tuned set with an axis (key of `AXES`) at some value; `seed` is of the noise, if there is any."""
    changed, parameters = dict(AXES[axis].change(value)), tuning.load(controller, setting)["parameters"]
    if noisy(changed):
        changed["sensors"] = changed["sensors"] | {"seed": seed}
    if axis == "bandwidth":
        parameters = parameters | {name: value * parameters[name] for name in {"pole", "frequency"} & set(parameters)}
    driven = load_scenario(scenario)
    if axis == "unbalanced acceleration":
        changed["alignment"] = canted(alignments()[driven.track], value)
    quick = registry.CONTROLLERS[controller].quick
    return Experiment(driven, controller, parameters=parameters, options=quick, **changed)


def row(axis: str, value: float | str, setting: str, controller: str, seed: int = 0, scenario: str = SCENARIO) -> dict:
    """Numbers of a run, see `experiment`; of one that derailed only how it ended."""
    found, _ = experiment(axis, value, setting, controller, seed, scenario)()
    own = {"axis": axis, "value": value, "unit": AXES[axis].unit, "setting": setting}
    own |= {"controller": controller, "seed": seed}
    numbers = {"rmse_mm": 1e3 * found["rmse_y"], "drift_mm": 1e3 * found["mean_error_last_third"]}
    numbers |= {"effort_Nm": float(found["effort_du"])}
    return own | ({} if found["failed"] else numbers) | {"failed": bool(found["failed"]), "ended": found["ended"]}


def noisy(changed: dict) -> bool:
    """Whether changed arguments of `Experiment` bring noise, of which several realisations are driven."""
    return "seed" in changed.get("sensors", {})


def canted(track: Alignment, acceleration: float) -> Alignment:
    """A curve entry with the cant that leaves an unbalanced acceleration (m/s2) at its design speed."""
    if track.design_speed is None:
        raise InputError(f"track {track.name}: has no design speed, so no cant follows from an acceleration")
    start, ramp, arc = track.segments
    angle = superelevation_angle(track.design_speed, 1 / arc.kappa[0], acceleration)
    return replace(track, segments=(start, replace(ramp, phi=(0.0, angle)), replace(arc, phi=(angle, angle))))


def cases(axes: Sequence[str] = tuple(AXES), settings: Sequence[str] = SETTINGS) -> list[tuple]:
    """All runs of some axes, as arguments of `row`."""
    return [
        (axis, value, setting, name, seed)
        for axis in axes
        for setting in settings
        for name in AXES[axis].controllers
        for value in AXES[axis].values
        for seed in (SEEDS if noisy(AXES[axis].change(value)) else (0,))
    ]


def main() -> None:
    """Drive all of them and write the table."""
    with executor() as pool:
        rows = ordered_map(pool, lambda case: row(*case), cases(), "where the order turns")
    write(paths.product("data/results/order_turns.csv"), pd.DataFrame(rows).to_csv(index=False, float_format="%.6g"))
