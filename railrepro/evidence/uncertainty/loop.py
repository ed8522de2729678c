"""The closed loop with sensors over unseen seeds: our controller, rivals, and the limit of `uncertainty.limit`.

`python -m railrepro loop` writes data/results/loop_table.csv; runs that were made before are in the store. Kinds:
`loop` are the runs of tuning with other seeds, `stressed` has what tuning's stressed run has, `held out` is what tuning
never sees, `irregular` are rails of two classes from 80 to 400 km/h, whose draw goes with the seed. Errors count from
the set point at the true place.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import CONTROLLERS, OURS
from railrepro.data import write
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.runs import store, tuning
from railrepro.evidence.runs.executor import executor, ordered_map
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.uncertainty import limit
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

SEEDS = tuple(range(201, 225))
"""Draws of noise and biases; tuning and the chapters use others."""
FEW = SEEDS[:4]
"""Those of the kinds that tuning never sees."""
COMPARED = (OURS, "ndi_feedforward", "ndi_integral", "nmpc_observer")
"""Ours, and those of the others that lead any row."""
_STILL = 1.0, 0.1
"""Walks of force and moment so slow that sensors alone limit the error (N/s^0.5, N m/s^0.5)."""
_CLASSES = {80: "80", 160: "160", 280: "300", 400: "300"}
"""Speed (km/h) and class of speed of its rails."""


@dataclass(frozen=True)
class Case:
    """A row of the table.

    Attributes
    ----------
    kind, name, scenario : str
    change : dict
        Fields of the scenario that differ.
    more : dict
        Further arguments of `Experiment`.
    rolls : bool
        Whether wheels roll on ideal rails, so that the limit applies.
    """

    kind: str
    name: str
    scenario: str
    change: dict
    more: dict = field(default_factory=dict)
    rolls: bool = False

    def experiment(self, controller: str, seed: int) -> Experiment:
        """One run of a tuned set."""
        quick = CONTROLLERS[controller].quick if controller in CONTROLLERS else {}
        more = dict(self.more)
        if self.kind == "irregular":
            more["irregular"] = more["irregular"] | {"seed": seed}
        sensed = {"seed": seed} | more.get("sensors", {})
        scenario = load_scenario(self.scenario).but(**self.change)
        return Experiment(
            scenario, controller, options=quick, setting=tuning.LOOP, **more | {"sensors": sensed}
        )  # fmt: skip


_STRESS = {"plant": {"drive.lag": 0.0075}, "sensors": {"inverter.delay": 0.002, "inverter.gain": 1.2}}
_ROUGH = {"irregular": {"spectrum": "en_B_300", "seed": 3}}
_FAST, _CURVE, _POOR = "sine_tracking", "curve_entry_T3", "adhesion_loss"
_PATCH = ((0.0, 0.0), (200.0, 0.0), (201.0, 1.0), (300.0, 1.0), (301.0, 0.0))


def cases() -> list[Case]:
    """Rows of the table."""
    ends = {"curve_entry_T1": 50.0, "curve_entry_T2": 200.0, _CURVE: 280.0, "curve_entry_T4": 330.0, _FAST: 250.0}
    rows = [Case("loop", name, name, {"end_m": end}, {}, True) for name, end in ends.items()]
    short, sine, curve = {"end_m": 500.0}, {"end_m": 250.0}, {"end_m": 280.0}
    straight = {"set_point": {"kind": "none"}, "speed_kmh": 280.0, "end_m": 250.0}
    rows.append(Case("loop", "straight, 280 km/h", _FAST, straight, {}, True))
    rows.append(Case("loop", "T3 irregular", _CURVE, curve, _ROUGH))
    rows += [Case("loop", "poor rail", _POOR, short), Case("stressed", "poor rail", _POOR, short, _STRESS)]
    rows.append(Case("stressed", "sine_tracking", _FAST, sine, _STRESS))

    def held_out(name: str, scenario: str, change: dict, **more) -> None:
        rows.append(Case("held out", name, scenario, change, more))

    held_out("left rail poor only", _POOR, {"end_m": 450.0, "poor_share": (), "poor_share_left": ((0, 1),)})
    held_out("patch of very poor rail", _POOR, short | {"good": "poor", "poor": "very_poor", "poor_share": _PATCH})
    for factor in (0.8, 1.2):
        stiff = {"contact.shear_modulus": factor * load_vehicle().contact.shear_modulus}
        held_out(f"creep times {factor:g}", _CURVE, curve, plant=stiff)
    held_out("braking on wet rail", _CURVE, curve | {"good": "wet", "force_kN": ((0.0, -17.0),)})
    held_out("wheels 1.5 % smaller", _FAST, sine, plant={"wheel.radius": 0.985 * load_vehicle().wheel.radius})
    for factor in (0.9, 1.1):
        held_out(f"body mass times {factor:g}", _CURVE, curve, plant={"body.mass": factor * load_vehicle().body.mass})
    lost = {f"{group}.dropout": 0.05 for group in ("lateral", "gyro", "wheel_speed", "speed")}
    held_out("readings lost, 5 %", _FAST, sine, sensors=lost)
    for quality, (speed, speeds) in product("AB", _CLASSES.items()):
        rails = {"irregular": {"spectrum": f"en_{quality}_{speeds}"}}
        rows.append(Case("irregular", f"{quality}, {speed} km/h", _FAST, sine | {"speed_kmh": float(speed)}, rails))
    return rows


def limit_of(case: Case) -> dict:
    """Error that sensors alone leave a case (mm), and that at the believed place."""
    scenario, loop = load_scenario(case.scenario).but(**case.change), load_loop()
    slope = scenario.route().reference_at(np.arange(0.0, scenario.end_m, 0.5))[1]
    believed = limit.limit(load_vehicle(), loop, scenario.speed, _STILL).error
    return {"limit_mm": 1e3 * limit.with_place(believed, slope, loop), "limit_at_believed_place_mm": 1e3 * believed}


def followed(run: simulate.Run, _experiment: Experiment) -> store.Entry:
    """Errors against the rails where they lie (mm), torque above 5 Hz (N m), and whether the flanges were reached."""
    failed = run.failed or metrics.reaches_flange(run.series)
    errors = {} if failed else {g: 1e3 * metrics.followed_rmse(run.series, g) for g in simulate.GEARS}
    activity = float("nan") if failed else metrics.activity(run.series)
    row = {"error_mm": errors.get("front", float("nan")), "rear_mm": errors.get("rear", float("nan"))}
    return row | {"activity_Nm": activity, "failed": failed}, None


def _rms(values: pd.Series) -> float:
    return float(np.sqrt(np.mean(np.square(values.dropna()))))


def table(rows: list[Case], pool) -> pd.DataFrame:
    """One row per case and controller: RMS and standard deviation over the seeds of the error (mm), runs that failed.

    Both are over the runs that kept off the flanges; `failed` counts the others.
    """
    tasks = [(case, name, seed) for case in rows for name in COMPARED for seed in seeds(case)]

    def driven(task: tuple[Case, str, int]) -> dict:
        case, name, seed = task
        head = {"kind": case.kind, "case": case.name, "controller": name}
        return head | case.experiment(name, seed).measured(followed)[0]

    found = pd.DataFrame(ordered_map(pool, driven, tasks, "loop"))
    grouped = found.groupby(["kind", "case", "controller"], sort=False)
    columns = {"seeds": ("failed", "size"), "failed": ("failed", "sum"), "error_mm": ("error_mm", _rms)}
    columns |= {
        "spread_mm": ("error_mm", "std"),
        "rear_mm": ("rear_mm", _rms),
        "activity_Nm": ("activity_Nm", "mean"),
    }
    return grouped.agg(**columns).reset_index()


def seeds(case: Case) -> tuple[int, ...]:
    """Seeds of a case."""
    return {"held out": FEW, "irregular": FEW[:3]}.get(case.kind, SEEDS)


def standing(measured: pd.DataFrame) -> pd.DataFrame:
    """Ours beside the best other, one row per kind and case, those that are not led first.

    Parameters
    ----------
    measured : DataFrame
        data/results/loop_table.csv.

    Returns
    -------
    DataFrame
        ours_mm, other_mm, other, spread_mm (larger standard deviation of both), limit_mm, over_limit
        (-), lost (runs of ours that reached the flanges), other_lost, and standing: `behind`, `tied` within the spread,
        or `ahead`. Who loses fewer runs is ahead; the best other is the one that loses fewest.
    """
    names, ours = ["kind", "case"], measured["controller"] == OURS
    own = measured[ours].set_index(names)
    other = measured[~ours].sort_values(["failed", "error_mm"]).groupby(names, sort=False).first().reindex(own.index)
    rows = pd.DataFrame({"ours_mm": own["error_mm"], "other_mm": other["error_mm"], "other": other["controller"]})
    rows["spread_mm"] = np.fmax(own["spread_mm"], other["spread_mm"])
    rows["limit_mm"], rows["over_limit"] = own["limit_mm"], own["error_mm"] / own["limit_mm"]
    rows["lost"], rows["other_lost"] = own["failed"], other["failed"]
    more, worse = rows["lost"] - rows["other_lost"], (rows["ours_mm"] - rows["other_mm"]).fillna(0.0)
    level = np.where(more != 0, np.sign(more), np.sign(worse) * (worse.abs() > rows["spread_mm"]))
    rows["standing"] = pd.Series(level, rows.index).map({1: "behind", 0: "tied", -1: "ahead"})
    order = np.lexsort([-(rows["ours_mm"] / rows["other_mm"]), -level])
    return rows.iloc[order]


def main() -> None:
    """Measure all rows and write the table."""
    rows = cases()
    with executor() as pool:
        measured = table(rows, pool)
    limits = pd.DataFrame([{"kind": c.kind, "case": c.name, **limit_of(c)} for c in rows if c.rolls])
    text = measured.merge(limits, how="left", on=["kind", "case"]).to_csv(index=False, float_format="%.4g")
    write(paths.product("data/results/loop_table.csv"), text)
