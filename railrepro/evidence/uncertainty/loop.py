"""Closed loop with sensors, over seeds that tuning has not seen: LQG with preview, rivals, and the bound of `limit`.
Kinds of runs in loop_table.csv: `loop`, the runs of tuning with other seeds; `stressed`, the stress of tuning; `held
out`, conditions that tuning never sees; `irregular`, rails of two classes from 80 to 400 km/h. Errors count from the
set point at the true position of a running gear."""

from collections.abc import Sequence
from itertools import product

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import CONTROLLERS, LOOP, OURS
from railrepro.data import write
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.uncertainty import limit
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies import store
from railrepro.studies.executor import ordered_map
from railrepro.studies.experiment import Experiment
from railrepro.vehicle.parameters import load_vehicle

SEEDS = tuple(range(201, 225))  # of noise and biases; tuning and the chapters use others
FEW = SEEDS[:3]  # seeds of the runs on irregular rails, which also draw the rails
COMPARED = (OURS, "ndi_feedforward", "ndi_integral", "nmpc_observer")  # LQG, and each other that is best in any row
_STILL = 1.0, 0.1  # Walks of force and moment so slow that sensors alone limit the error (N/s^0.5, N m/s^0.5)
_CLASSES = {80: "80", 160: "160", 280: "300", 400: "300"}  # speed (km/h) -> speed class of its rails
_STRESS = {"plant": {"drive.lag": 0.0075}, "sensors": {"inverter.delay": 0.002, "inverter.gain": 1.2}}
_FAST, _CURVE, _POOR = "sine_tracking", "curve_entry_T3", "adhesion_loss"
_PATCH = ((0.0, 0.0), (200.0, 0.0), (201.0, 1.0), (300.0, 1.0), (301.0, 0.0))


def experiments() -> list[Experiment]:
    """List the runs with sensors of data/results/loop_table.csv. Labels: kind, "loop" (as in tuning), "stressed" (late
    and strong torques), "held out" (what tuning never sees) or "irregular" (rails of classes A and B, four speeds);
    case, what is driven, as "curve_entry_T3" or "wheels 1.5 % smaller". Each runs with LQG and its rivals (`row`)."""
    ends = {"curve_entry_T1": 50.0, "curve_entry_T2": 200.0, _CURVE: 280.0, "curve_entry_T4": 330.0, _FAST: 250.0}
    runs = [run for name, end in ends.items() for run in row("loop", name, name, {"end_m": end})]
    short, sine, curve = {"end_m": 500.0}, {"end_m": 250.0}, {"end_m": 280.0}
    straight = {"set_point": {"kind": "none"}, "speed_kmh": 280.0, "end_m": 250.0}
    runs += row("loop", "straight, 280 km/h", _FAST, straight)
    runs += row("loop", "T3 irregular", _CURVE, curve, irregular={"spectrum": "en_B_300", "seed": 3})
    runs += row("loop", "poor rail", _POOR, short) + row("stressed", "poor rail", _POOR, short, **_STRESS)
    runs += row("stressed", "sine_tracking", _FAST, sine, **_STRESS)
    left = {"end_m": 450.0, "poor_share": (), "poor_share_left": ((0, 1),)}
    runs += row("held out", "left rail poor only", _POOR, left)
    patch = short | {"good": "poor", "poor": "very_poor", "poor_share": _PATCH}
    runs += row("held out", "patch of very poor rail", _POOR, patch)
    vehicle = load_vehicle()
    for factor in (0.8, 1.2):
        stiff = {"contact.shear_modulus": factor * vehicle.contact.shear_modulus}
        runs += row("held out", f"creep times {factor:g}", _CURVE, curve, plant=stiff)
    runs += row("held out", "braking on wet rail", _CURVE, curve | {"good": "wet", "force_kN": ((0.0, -17.0),)})
    small = {"wheel.radius": 0.985 * vehicle.wheel.radius}
    runs += row("held out", "wheels 1.5 % smaller", _FAST, sine, plant=small)
    for factor in (0.9, 1.1):
        heavy = {"body.mass": factor * vehicle.body.mass}
        runs += row("held out", f"body mass times {factor:g}", _CURVE, curve, plant=heavy)
    for quality, (speed, speeds) in product("AB", _CLASSES.items()):
        rails, at = {"spectrum": f"en_{quality}_{speeds}"}, sine | {"speed_kmh": float(speed)}
        runs += row("irregular", f"{quality}, {speed} km/h", _FAST, at, irregular=rails)
    return runs


def row(kind: str, case: str, scenario: str, change: dict, **more) -> list[Experiment]:
    """Make the runs of one case of loop_table.csv: each controller of `COMPARED` (LQG with preview and its rivals) with
    each of `SEEDS` of the sensors; with the kind "irregular" three seeds, which also draw the rails. `kind` and `case`
    label the runs, `scenario` is a name, `change` are new values of its fields, `more` other fields of `Experiment`."""
    driven, runs = load_scenario(scenario).but(**change), []
    more |= {"label": {"kind": kind, "case": case}, "setting": LOOP}
    for name, seed in product(COMPARED, FEW if kind == "irregular" else SEEDS):
        seeded = {"sensors": {"seed": seed} | more.get("sensors", {})}
        if kind == "irregular":
            seeded["irregular"] = more["irregular"] | {"seed": seed}
        runs.append(Experiment(driven, name, options=CONTROLLERS[name].quick, **more | seeded))
    return runs


def limit_of(run: Experiment) -> dict:
    """Compute lower bounds (mm) of the RMS error y - y* that the sensors allow on the nominal car for a torque of 115 N
    m RMS above 5 Hz (`limit.limit`). Returns a dict: limit_mm, with y* at the true track coordinate, and
    limit_at_believed_place_mm, with y* at the measured one; {} unless the rails are ideal and dry and the label "kind"
    of the `run` is "loop" (same conditions as in tuning)."""
    scenario, loop = run.scenario, load_loop()
    if run.label["kind"] != "loop" or run.irregular or scenario.poor_share:
        return {}
    slope = scenario.route().reference_at(np.arange(0.0, scenario.end_m, 0.5))[1]
    bound = limit.limit(load_vehicle(), loop, scenario.speed, _STILL)
    return {"limit_mm": 1e3 * limit.at_true_position(bound, slope, loop), "limit_at_believed_place_mm": 1e3 * bound}


def followed(run: simulate.Run, _experiment: Experiment) -> store.Entry:
    """Measure a run: a dict with error_mm and rear_mm, RMS of displacement from the actual rails less set point of
    front and rear running gear (mm), activity_Nm, RMS of the front differential torque above 5 Hz (N m), and failed,
    also if a flange was reached; the others are NaN then."""
    if run.failed or metrics.reaches_flange(run.series):
        return dict.fromkeys(("error_mm", "rear_mm", "activity_Nm"), float("nan")) | {"failed": True}, None
    front, rear = (1e3 * metrics.followed_rmse(run.series, gear) for gear in simulate.GEARS)
    return {"error_mm": front, "rear_mm": rear, "activity_Nm": metrics.activity(run.series), "failed": False}, None


def table(runs: Sequence[Experiment]) -> pd.DataFrame:
    """Simulate `runs` in parallel and summarise them over the seeds of the sensors: one row per kind, case and
    controller. Columns: kind of conditions ("loop", as in tuning, "stressed", "held out", "irregular"); case, what is
    driven, as "curve_entry_T3"; controller; seeds, number of runs; failed, number of failed runs. Over the seeds that
    did not fail: error_mm and rear_mm, root mean squares of the errors of front and rear running gear (mm); spread_mm,
    standard deviation of error_mm over the seeds; activity_Nm, mean RMS of the front differential torque above 5 Hz (N
    m). limit_mm and limit_at_believed_place_mm, lower bounds of the error (mm) from `limit_of`, or NaN."""

    def driven(run: Experiment) -> dict:
        return run.label | {"controller": run.controller} | run.measured(followed)[0]

    def rms(values: pd.Series) -> float:
        return float(np.sqrt(np.mean(np.square(values.dropna()))))

    rows = pd.DataFrame(ordered_map(driven, runs, "loop"))
    measured = rows.groupby(["kind", "case", "controller"], sort=False).agg(
        seeds=("failed", "size"),
        failed=("failed", "sum"),
        error_mm=("error_mm", rms),
        spread_mm=("error_mm", "std"),
        rear_mm=("rear_mm", rms),
        activity_Nm=("activity_Nm", "mean"),
    )
    first = {tuple(run.label.values()): run for run in reversed(runs)}
    limits = pd.DataFrame([run.label | limit_of(run) for run in first.values()])
    return measured.reset_index().merge(limits, how="left", on=["kind", "case"])


def main() -> None:
    """Command `loop`: compare controllers with sensors over seeds that tuning has not seen, and with the lower bound of
    the error; writes data/results/loop_table.csv, a row per condition, driven case and controller (`table`)."""
    text = table(experiments()).to_csv(index=False, float_format="%.4g")
    write(paths.product("data/results/loop_table.csv"), text)
