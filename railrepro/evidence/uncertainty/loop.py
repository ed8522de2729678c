"""The closed loop with sensors over unseen seeds: our controller, rivals, and the limit of `uncertainty.limit`.

`python -m railrepro loop` writes data/results/loop_table.csv; runs that were made before are in the store. Kinds:
`loop` are the runs of tuning with other seeds, `stressed` has what tuning's stressed run has, `held out` is what tuning
never sees. Errors count from the set point at the true place.
"""

from __future__ import annotations

from dataclasses import dataclass, field

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
from railrepro.own.creep_gains import CreepSettings
from railrepro.own.creep_model import STATES, UNKNOWN, creep_at
from railrepro.own.creep_mpc import CreepGuide
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

SEEDS = tuple(range(201, 213))
"""Draws of noise and biases; tuning and the chapters use others."""
FEW = SEEDS[:4]
"""Those of the kinds that tuning never sees."""
COMPARED = (OURS, "ndi_feedforward", "ndi_integral", "nmpc_observer")
"""Ours, and those of the others that lead any row."""
_LAG, _SETTLED = 0.1, 0.3
"""Time over which a walk is measured, and start of a run that is left out (s)."""


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
        sensed = {"seed": seed} | self.more.get("sensors", {})
        scenario = load_scenario(self.scenario).but(**self.change)
        return Experiment(
            scenario, controller, options=quick, setting=tuning.LOOP, **self.more | {"sensors": sensed}
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
    return rows


class Recorder(CreepGuide):
    """Ours, which keeps the disturbances that its filter finds, one row (N, N m) per sample."""

    def __init__(self, vehicle: Vehicle, route: Route, gear: int, settings: CreepSettings):
        super().__init__(vehicle, route, gear, settings, creep_at(vehicle, "dry", 20.0))
        self.found: list[np.ndarray] = []

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """See `CreepGuide.plan`."""
        torque = super().plan(x_hat, u_d)
        self.found.append(self.state[len(STATES) : len(STATES) + len(UNKNOWN)].copy())
        return torque


def walks(case: Case) -> tuple[float, float]:
    """How fast lateral force and yaw moment wander in a run with perfect measurements (N/s^0.5, N m/s^0.5).

    They are what the filter of our controller finds beyond its model, with walks wide enough to follow at once: root
    mean square of their change over `_LAG` over the root of it, front gear.
    """
    settings = CreepSettings(change=0.02, force_rate=3e6, moment_rate=5e3, y_noise=1e-6, psi_noise=1e-6, r_noise=1e-5)

    def recorded(vehicle: Vehicle, route: Route, gear: int) -> Recorder:
        return Recorder(vehicle, route, gear, settings)

    run = simulate.run(load_scenario(case.scenario).but(**case.change), recorded)
    period = settings.period
    found, lag = np.array(run.controllers[0].found)[round(_SETTLED / period) :], round(_LAG / period)
    force, moment = np.sqrt(np.mean((found[lag:] - found[:-lag]) ** 2, axis=0) / _LAG)
    return float(force), float(moment)


def limit_of(case: Case) -> dict:
    """Limit of a case (mm), that at the believed place, its range with half and twice the walks, and the walks."""
    scenario, vehicle, loop = load_scenario(case.scenario).but(**case.change), load_vehicle(), load_loop()
    slope = scenario.route().reference_at(np.arange(0.0, scenario.end_m, 0.5))[1]
    force, moment = walks(case)
    row = {"force_walk": force, "moment_walk": moment}
    for name, factor in (("limit", 1.0), ("limit_low", 0.5), ("limit_high", 2.0)):
        believed = limit.limit(vehicle, loop, scenario.speed, (factor * force, factor * moment)).error
        row[f"{name}_mm"] = 1e3 * limit.with_place(believed, slope, loop)
        if name == "limit":
            row["limit_at_believed_place_mm"] = 1e3 * believed
    return row


def followed(run: simulate.Run, _experiment: Experiment) -> store.Entry:
    """Errors against the rails where they lie (mm), torque above 5 Hz (N m), and whether the flanges were reached."""
    failed = run.failed or metrics.reaches_flange(run.series)
    errors = {} if failed else {g: 1e3 * metrics.followed_rmse(run.series, g) for g in simulate.GEARS}
    activity = float("nan") if failed else metrics.activity(run.series)
    row = {"error_mm": errors.get("front", float("nan")), "rear_mm": errors.get("rear", float("nan"))}
    return row | {"activity_Nm": activity, "failed": failed}, None


def table(rows: list[Case], pool) -> pd.DataFrame:
    """One row per case and controller: mean and standard deviation over the seeds of the error (mm), runs that failed.

    Means are over the runs that kept off the flanges; `failed` counts the others.
    """
    tasks = [(case, name, seed) for case in rows for name in COMPARED for seed in seeds(case)]

    def driven(task: tuple[Case, str, int]) -> dict:
        case, name, seed = task
        head = {"kind": case.kind, "case": case.name, "controller": name}
        return head | case.experiment(name, seed).measured(followed)[0]

    found = pd.DataFrame(ordered_map(pool, driven, tasks, "loop"))
    grouped = found.groupby(["kind", "case", "controller"], sort=False)
    columns = {"seeds": ("failed", "size"), "failed": ("failed", "sum"), "error_mm": ("error_mm", "mean")}
    columns |= {
        "spread_mm": ("error_mm", "std"),
        "rear_mm": ("rear_mm", "mean"),
        "activity_Nm": ("activity_Nm", "mean"),
    }
    return grouped.agg(**columns).reset_index()


def seeds(case: Case) -> tuple[int, ...]:
    """Seeds of a case."""
    return FEW if case.kind == "held out" else SEEDS


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
