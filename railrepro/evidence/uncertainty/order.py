"""Sensitivity of the controller ranking: NMPC against inversions on T3 while one thing after the other is changed.

`python -m railrepro order` writes data/results/order_turns.csv, one row per run. Every finished run is in the store, so
an interrupted study goes on where it was. Serves the paper's Fig. 6.
"""

from __future__ import annotations

from dataclasses import replace

from railrepro import paths
from railrepro.control import registry
from railrepro.data import write
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.experiment import Experiment, run_all
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.alignment import Alignment, alignments, superelevation_angle
from railrepro.vehicle.parameters import load_vehicle

SCENARIO = "curve_entry_T3"
CONTROLLERS = ("nmpc", "ndi", "ndi_integral")
"""NMPC and NDI of the paper, and the best controller without preview."""
SETTINGS = ("paper", "equal")
SEEDS = (101, 102, 103)
"""Seeds of the sensor noise; tuning used others."""
_GROUPS = ("lateral", "gyro", "wheel_speed", "speed", "position")
_COLUMNS = ("axis", "value", "unit", "setting", "controller", "seed")
_COLUMNS += ("rmse_mm", "drift_mm", "effort_Nm", "failed", "ended")


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
    "bandwidth": ("over the tuned", (1 / 3, 0.5, 2 / 3, 1.0, 1.5, 2.0, 3.0, 4.0)),
    "unbalanced acceleration": ("m/s2", (0.0, 0.15, 0.3, 0.4333, 0.65, 0.85, 1.0)),
    "creep stiffness": ("over ours", (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 12.0)),
    "car": ("-", tuple(CAR)),
    "delay": ("ms", (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0)),
    "noise": ("over the sensors'", (0.0, 0.25, 0.5, 1.0, 2.0)),
}
"""What is changed -> unit and values; everything else is nominal. The bandwidth is that of the inversions. Delay and
noise come behind the filter of the realistic loop: their zero is the choice "S1002, filter"."""


def changed(axis: str, value) -> dict:
    """Fields of `Experiment` (dict) that set an axis, a key of `AXES`, to a value in its unit; {} for "bandwidth"."""
    if axis == "unbalanced acceleration":
        return {"alignment": canted(alignments()["T3"], value)}
    if axis == "creep stiffness":
        return {"plant": {"contact.shear_modulus": value * load_vehicle().contact.shear_modulus}}
    if axis == "car":
        return dict(CAR[value])
    if axis == "delay":
        return {"sensors": {"perfect": True, "inverter.delay": 1e-3 * value}}
    return _noisy(value) if axis == "noise" else {}


def experiments(axis: str, value, setting: str, controller: str) -> list[Experiment]:
    """Runs of a controller, tuned in a setting, on T3 with one axis (key of `AXES`) at a value in the unit given there.

    One run, or one per seed of `SEEDS` where there is noise.
    """
    more, parameters = changed(axis, value), tuning.load(controller, setting)["parameters"]
    if axis == "bandwidth":
        parameters = parameters | {name: value * parameters[name] for name in {"pole", "frequency"} & set(parameters)}
    label = {"axis": axis, "value": value, "unit": AXES[axis][0], "setting": setting, "controller": controller}
    sensors, scenario = more.pop("sensors", {}), load_scenario(SCENARIO)
    found = []
    for seed in SEEDS if "seed" in sensors else (0,):
        noise = sensors | ({"seed": seed} if "seed" in sensors else {})
        quick = registry.CONTROLLERS[controller].quick
        found.append(Experiment(scenario, controller, label | {"seed": seed}, parameters, quick, sensors=noise, **more))
    return found


def canted(track: Alignment, acceleration: float) -> Alignment:
    """Copy of a curve entry (straight, clothoid, arc) canted for an unbalanced acceleration (m/s2) at design speed."""
    start, ramp, arc = track.segments
    angle = superelevation_angle(track.design_speed, 1 / arc.kappa[0], acceleration)
    return replace(track, segments=(start, replace(ramp, phi=(0.0, angle)), replace(arc, phi=(angle, angle))))


def main() -> None:
    """Run all axes, values, settings and controllers, and write data/results/order_turns.csv."""
    cases = [
        (axis, value, setting, name)
        for axis, (_, values) in AXES.items()
        for setting in SETTINGS
        for name in (CONTROLLERS[1:] if axis == "bandwidth" else CONTROLLERS)
        for value in values
    ]
    table, _ = run_all([run for case in cases for run in experiments(*case)], "where the order turns")
    table = table.rename(columns={"effort_du": "effort_Nm"})
    table = table.assign(rmse_mm=1e3 * table["rmse_y"], drift_mm=1e3 * table["mean_error_last_third"])
    text = table[[*_COLUMNS]].to_csv(index=False, float_format="%.6g")
    write(paths.product("data/results/order_turns.csv"), text)
