"""Verdicts on the paper's statements, computed from data/results; REPLICATION.md is rendered from them.

`data/claims.toml` holds the statements, one function here per id measures. `python -m railrepro.report.claims` writes
data/results/claims.csv and REPLICATION.md. A verdict that differs from the stored one is reported, and a test fails.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import casadi as ca
import numpy as np
import pandas as pd
import sympy as sp

from railrepro import paths, schema
from railrepro.control.allocation import allocate
from railrepro.control.registry import COMPARED, EMPHASIS, PAPER_TRIO, PREDICTIVE, TRIO, r_times
from railrepro.errors import InputError, told
from railrepro.files import write

REPRODUCED, PARTLY, NOT, UNTESTABLE = "reproduced", "partly", "not reproduced", "not testable"
VERDICTS = (REPRODUCED, PARTLY, NOT, UNTESTABLE)
_FIG08 = r_times(EMPHASIS, "NMPC")
MEASURES: dict[str, Callable] = {}


@dataclass(frozen=True)
class Measured:
    """A measured value and what follows from it."""

    value: float
    verdict: str


class Results:
    """Tables of data/results; `used` lists those that were asked for."""

    def __init__(self):
        self.used: list[str] = []

    def __getitem__(self, name: str) -> pd.DataFrame:
        file = paths.source(f"data/results/{name}.csv")
        self.used += [] if name in self.used else [name]
        if not file.exists():
            raise InputError(f"{file.name}: is missing; `make figures` makes it")
        return pd.read_csv(file)

    @cached_property
    def curve(self) -> pd.DataFrame:
        """Metrics of the curve entry, controllers in rows."""
        return self["curve_entry_metrics"].pivot(index="controller", columns="metric", values="value")

    @cached_property
    def sine(self) -> pd.DataFrame:
        """RMSE of sine tracking on T5 (m), speeds in rows, controllers in columns."""
        table = self["sine_metrics"].query("metric == 'rmse_y' and scenario == 'sine_tracking'")
        return table.pivot(index="speed_kmh", columns="controller", values="value")

    @cached_property
    def curves_sine(self) -> pd.DataFrame:
        """RMSE of the sine on T1 to T4 (m), scenarios in rows."""
        table = self["sine_metrics"].query("metric == 'rmse_y' and scenario != 'sine_tracking'")
        return table.pivot(index="scenario", columns="controller", values="value")

    @cached_property
    def fig06(self) -> dict[str, pd.DataFrame]:
        """Series of the curve entry by controller."""
        return dict(list(self["fig06_curve_entry"].groupby("controller")))

    @cached_property
    def fig08(self) -> pd.DataFrame:
        """Metrics of Fig. 8, cases in rows."""
        return self["adhesion_metrics"].query("experiment == 'fig08'").set_index("case")

    @cached_property
    def front(self) -> pd.DataFrame:
        """Stopped runs of the braking front."""
        return self["braking_front"].query("stopped")


def measure(identity: str) -> Callable:
    """Register the function of a claim."""

    def register(function):
        MEASURES[identity] = function
        return function

    return register


def _yes(value: float, holds: bool, partly: bool = False) -> Measured:
    return Measured(float(value), REPRODUCED if holds else PARTLY if partly else NOT)


@measure("C01")
def _table_one(r: Results, claim: dict) -> Measured:
    table = r["table1"]
    worst = (table["b_sin_phi_m"] - table["printed_m"]).abs().max()
    return _yes(worst, worst <= claim["tolerance"])


@measure("C02")
def _tangent(r: Results, claim: dict) -> Measured:
    table = r["table1"]
    worst = (table["b_tan_phi_m"] - table["printed_m"]).abs().max()
    return _yes(worst, worst <= claim["tolerance"])


@measure("C03")
def _effort_on_t1(r: Results, claim: dict) -> Measured:
    table = r["sine_metrics"].query("metric == 'effort_du' and controller == 'nmpc' and scenario != 'sine_tracking'")
    effort = table.set_index("scenario")["value"]
    ratio = effort["curve_entry_T1"] / effort.drop("curve_entry_T1").max()
    return _yes(ratio, ratio > claim["tolerance"])


@measure("C04")
def _all_follow(r: Results, claim: dict) -> Measured:
    worst = 1e3 * r.curve.loc[list(COMPARED), "largest_error"].max()
    return _yes(worst, worst < claim["tolerance"])


@measure("C05")
def _mpc_beats_ndi(r: Results, claim: dict) -> Measured:
    rmse = r.curve["rmse_y"]
    ratio = rmse[["nmpc", "ltv_mpc_printed"]].max() / rmse["ndi"]
    return _yes(ratio, ratio < claim["tolerance"], rmse["nmpc"] < claim["tolerance"] * rmse["ndi"])


@measure("C06")
def _nmpc_is_best(r: Results, claim: dict) -> Measured:
    rmse = r.curve["rmse_y"]
    ratio = rmse["nmpc"] / rmse[["ltv_mpc_printed", "ndi"]].min()
    return _yes(ratio, ratio < claim["tolerance"], rmse["nmpc"] < 1.02 * rmse[["ltv_mpc_printed", "ndi"]].min())


@measure("C07")
def _ltv_slightly_worse(r: Results, claim: dict) -> Measured:
    rmse = r["ltv_gap"].query("scenario == 'curve_entry_T3'").set_index("kind")["rmse_y"]
    ratio = rmse["ltv printed"] / rmse["nmpc"]
    return _yes(ratio, 1.02 < ratio < claim["tolerance"], ratio > 1.02)


@measure("C08")
def _no_delay(r: Results, claim: dict) -> Measured:
    worst = r.curve.loc[list(PREDICTIVE), "delay"].abs().max()
    return _yes(worst, worst < claim["tolerance"], worst < r.curve.loc["ndi", "delay"] / 2)


@measure("C09")
def _same_torque_later(r: Results, claim: dict) -> Measured:
    series = [r.fig06[name] for name in ("nmpc", "ndi")]
    grid = np.arange(60.0, 590.0, 0.25)
    mpc, ndi = (np.interp(grid, s["p_m"], s["du_Nm"]) for s in series)
    shifts = np.arange(-60, 161)
    pairs = [(ndi[60 + k : 60 + k + 1800], mpc[60:1860]) for k in shifts]
    correlation = np.array([np.corrcoef(*pair)[0, 1] for pair in pairs])
    best = int(np.argmax(correlation))
    later = 0.25 * shifts[best]
    return _yes(later, correlation[best] > claim["tolerance"] and later > 0, later > 0)


@measure("C10")
def _gyroscope(r: Results, claim: dict) -> Measured:
    expected = _gyroscopic_torque()
    ratios = []
    for name in TRIO:
        rows = r.fig06[name]
        step = rows[rows["p_m"].between(60, 300)]["du_Nm"].mean() - rows[rows["p_m"] < 20]["du_Nm"].mean()
        ratios.append(step / expected)
    worst = max(ratios, key=lambda ratio: abs(ratio - 1))
    return _yes(worst, abs(worst - 1) < claim["tolerance"], min(ratios) > 0)


def _gyroscopic_torque() -> float:
    """Differential torque that balances the rolling axle on the cant ramp of T3 at 280 km/h (N m)."""
    from railrepro.track.table import load_track
    from railrepro.vehicle.parameters import load_vehicle

    vehicle, track = load_vehicle(), load_track("T3")
    dphi = track.interpolate(200.0)[3, 0]
    speed, wheel = track.design_speed, vehicle.wheel
    moment = -2 * wheel.spin_inertia * speed / wheel.radius * dphi * speed
    return moment * wheel.radius / vehicle.gear.contact_base


@measure("C11")
def _drift(r: Results, claim: dict) -> Measured:
    drift = 1e3 * r.curve.loc["nmpc", "mean_error_last_third"]
    return _yes(drift, abs(drift) > claim["tolerance"])


@measure("C12")
def _large_values(r: Results, claim: dict) -> Measured:
    rows = r.fig06["nmpc"]
    error, large = rows["y_m"] - rows["y_ref_m"], rows["y_ref_m"].abs() > 2.5e-3
    ratio = np.sqrt((error[large] ** 2).mean() / (error[~large & (rows["y_ref_m"].abs() > 1e-4)] ** 2).mean())
    return _yes(ratio, ratio > claim["tolerance"])


@measure("C13")
def _drift_from_creep(r: Results, claim: dict) -> Measured:
    table = r["sine_causes"].query("case == 'T3, 280 km/h'").set_index("cause")["mean_error_last_third"]
    ratio = abs(table["no creep"] / table["as tuned"])
    return _yes(ratio, ratio < claim["tolerance"])


@measure("C14")
def _ratio_of_times(r: Results, claim: dict) -> Measured:
    times = r["solve_times"]
    median = times[~times["scenario"].str.contains("bounds")].groupby("solver")["median_ms"].median()
    ratio = median["gauss_newton"] / median["ltv_mpc"]
    return _yes(ratio, abs(np.log(ratio / claim["paper"])) < np.log(2), ratio > 1)


@measure("C15")
def _feasible(r: Results, claim: dict) -> Measured:
    times = r["solve_times"].query("solver == 'gauss_newton'")
    usual = times[~times["scenario"].str.contains("bounds")]["max_ms"].max()
    return _yes(times["max_ms"].max(), times["max_ms"].max() < claim["tolerance"], usual < claim["tolerance"])


def _ranked(table: pd.DataFrame) -> pd.Series:
    """Where NMPC < printed LTV-MPC < NDI; a run that failed counts as worst."""
    rmse = table[list(PAPER_TRIO)].fillna(np.inf)
    return (rmse["nmpc"] < rmse["ltv_mpc_printed"]) & (rmse["ltv_mpc_printed"] < rmse["ndi"])


@measure("C16")
def _ranking_on_curves(r: Results, claim: dict) -> Measured:
    share = _ranked(r.curves_sine).mean()
    return _yes(share, share >= claim["tolerance"], share > 0)


@measure("C17")
def _ranking_on_sine(r: Results, claim: dict) -> Measured:
    share = _ranked(r.sine).mean()
    better = (r.sine["nmpc"] < r.sine["ndi"]).mean()
    return _yes(share, share >= claim["tolerance"], better >= 0.9)


@measure("C18")
def _slower_is_better(r: Results, claim: dict) -> Measured:
    ranks = r.sine[list(PAPER_TRIO)].rank()
    place = pd.Series(r.sine.index, index=r.sine.index).rank()
    worst = min(np.corrcoef(ranks[name], place)[0, 1] for name in ranks)
    return _yes(worst, worst > claim["tolerance"], worst > 0)


def _slopes(r: Results) -> pd.Series:
    return pd.Series({name: np.polyfit(r.sine.index, r.sine[name], 1)[0] for name in r.sine})


@measure("C19")
def _ndi_grows_most(r: Results, claim: dict) -> Measured:
    slopes = _slopes(r)
    ratio = slopes["ndi"] / slopes[["nmpc", "ltv_mpc_printed"]].max()
    return _yes(ratio, ratio > claim["tolerance"])


@measure("C20")
def _wide_range(r: Results, claim: dict) -> Measured:
    share = (r.sine["nmpc"] < r.sine["ndi"]).mean()
    return _yes(share, share >= claim["tolerance"], share >= 0.5)


@measure("C21")
def _regular(r: Results, claim: dict) -> Measured:
    rows = r["fig08_adhesion_loss"].query(f"case == '{_FIG08}' and 80 < p_m < 125")
    deviation = ((rows["fx_ri"] + rows["fx_le"]) / 2 - rows["f_star"]).abs().mean()
    return _yes(deviation, deviation < claim["tolerance"])


@measure("C22")
def _reaches_maximum(r: Results, claim: dict) -> Measured:
    reached = r.fig08.loc[_FIG08, "reached_m"]
    return _yes(reached, abs(reached / claim["paper"] - 1) < claim["tolerance"], np.isfinite(reached))


@measure("C23")
def _no_macro_slip(r: Results, claim: dict) -> Measured:
    slip = r.fig08.loc[_FIG08, "largest_slip"]
    return _yes(slip, slip < claim["tolerance"])


@measure("C24")
def _approached_again(r: Results, claim: dict) -> Measured:
    rows = r["fig08_adhesion_loss"].query(f"case == '{_FIG08}' and p_m > 250")
    limit = rows[["fx_ri", "fx_le"]].max(axis=1).rolling(5).mean().quantile(0.99)
    share = ((rows["fx_ri"] + rows["fx_le"]) / 2).mean() / limit
    returned = (rows["segment"] == 3).any() and (rows["segment"] == 1).any()
    return _yes(share, share > claim["tolerance"] and returned, returned)


@measure("C25")
def _both_directions(r: Results, claim: dict) -> Measured:
    table = r["adhesion_metrics"].query("experiment == 'sudden'")
    slip = table.pivot(index=["place", "drive"], columns="slip_control", values="largest_slip")
    slip.columns = [str(name) for name in slip.columns]
    share = (slip["True"] < 0.5 * slip["False"]).mean()
    return _yes(share, share >= claim["tolerance"], share >= 0.5)


@measure("C26")
def _no_knowledge(r: Results, claim: dict) -> Measured:
    table = r["adhesion_map"].query("map == 'friction'")
    share = (table["utilisation"] > 0.75).mean()
    return _yes(share, share >= claim["tolerance"], share >= 0.5)


@measure("C27")
def _step_bound(r: Results, claim: dict) -> Measured:
    table = r["adhesion_law"].sort_values("p2_over_bound")
    follows = table["rms_error"] < 1.5 * table["rms_error"].min()
    first = table.loc[follows, "p2_over_bound"].min()
    return _yes(first, follows.iloc[-1] and first < 1.5, follows.iloc[-1])


@measure("C28")
def _stable_on_poor_rail(r: Results, claim: dict) -> Measured:
    row = r.fig08.loc[_FIG08]
    worst = 1e3 * row["largest_error"]
    return _yes(worst, not row["failed"] and worst < claim["tolerance"], not row["failed"])


@measure("C29")
def _rule_holds(r: Results, claim: dict) -> Measured:
    limit, generator = 4000.0, np.random.default_rng(0)
    u_d, du = ca.SX.sym("u_d"), ca.SX.sym("du")
    rule = ca.Function("rule", [u_d, du], list(allocate(u_d, du, limit)))
    worst = 0.0
    for base, steer in generator.uniform(-9e3, 9e3, (2000, 2)):
        le, ri, _, kept = map(float, rule(base, steer))
        worst = max(worst, abs(le) - limit, abs(ri) - limit, abs(kept - np.clip(steer, -limit, limit)))
    return _yes(max(worst, 0.0), worst < claim["tolerance"])


def _sweep(r: Results) -> pd.DataFrame:
    return r.front.query("kind == 'nmpc'").sort_values("factor")


@measure("C30")
def _trade_off(r: Results, claim: dict) -> Measured:
    def holds(sweep: pd.DataFrame) -> bool:
        place = np.arange(len(sweep))
        distance, error = (np.corrcoef(sweep[name].rank(), place)[0, 1] for name in ("stopping_distance", "rmse_y"))
        return distance < -0.7 and error > 0.7

    sweep = _sweep(r)
    saved = sweep["stopping_distance"].max() - sweep["stopping_distance"].min()
    return _yes(saved, holds(sweep) and saved > claim["tolerance"], holds(sweep[sweep["factor"] >= 1]))


def _against_ndi(r: Results, metric: str, sign: int) -> pd.Series:
    tuned = r.front.query("kind == 'tuned'")
    pair = tuned[tuned["controller"] == "nmpc"][metric].to_numpy()
    ndi = tuned[tuned["controller"] == "ndi"][metric].to_numpy()
    return pair / ndi if sign else pair - ndi


@measure("C31")
def _both_more_accurate(r: Results, claim: dict) -> Measured:
    ratios = _against_ndi(r, "rmse_y", 1)
    return _yes(ratios.max(), ratios.max() < claim["tolerance"], ratios.min() < claim["tolerance"])


@measure("C32")
def _both_stop_earlier(r: Results, claim: dict) -> Measured:
    differences = _against_ndi(r, "stopping_distance", 0)
    return _yes(differences.max(), differences.max() < claim["tolerance"], differences.min() < claim["tolerance"])


@measure("C33")
def _stops_within(r: Results, claim: dict) -> Measured:
    distance = _sweep(r)["stopping_distance"].min()
    return _yes(distance, distance < (1 + claim["tolerance"]) * claim["paper"])


@measure("C34")
def _variable_allocation(r: Results, claim: dict) -> Measured:
    fixed = r.front.query("kind == 'fixed'")["stopping_distance"]
    variable = r.front.query("kind == 'tuned' and controller == 'nmpc'")["stopping_distance"].min()
    gains = 1 - variable / fixed
    nearest = gains.iloc[(gains - claim["paper"]).abs().argmin()]
    return _yes(nearest, abs(nearest - claim["paper"]) < 0.02, gains.max() > 0)


@measure("C35")
def _cones(r: Results, claim: dict) -> Measured:
    table = r["sine_causes"].pivot(index="case", columns="cause", values="rmse_y")
    changes = (table["S1002 profiles"] / table["as tuned"] - 1).abs()
    rough = _on_rough_track(r, "rmse_y")
    changes["irregular track"] = abs(rough["S1002"]["exact"] / rough["cone"]["exact"] - 1)
    in_curve = changes["T3, 280 km/h"] < claim["tolerance"]
    return _yes(changes.max(), changes.max() < claim["tolerance"], in_curve)


@measure("C36")
def _rolling(r: Results, claim: dict) -> Measured:
    table = r["sine_causes"].query("case == 'T3, 280 km/h'").set_index("cause")["rmse_y"]
    share = 1 - table["no creep"] / table["as tuned"]
    return _yes(share, share < claim["tolerance"], share < 0.5)


@measure("C37")
def _base_torque_helps(r: Results, claim: dict) -> Measured:
    table = r["braking_dependence"].query("factor == 1 and amplitude_mm == 3 and wavelength == 1.0")
    informed, blind = (table[table["limit_Nm"] == limit]["rmse_y"].iloc[0] for limit in (4000.0, 0.0))
    ratio = blind / informed
    return _yes(ratio, ratio > 1.01, ratio > claim["tolerance"])


@measure("C38")
def _printed_signs(r: Results, claim: dict) -> Measured:
    nu, c, f, g, p2, sign = sp.symbols("nu c f g p_2 sgn")
    slip_rate = f + g * p2 * sign
    second, third = -nu * c * slip_rate, nu * c * slip_rate  # as printed, with df_x/ds_x = c
    return _yes(float("nan"), sp.simplify(second - third) == 0)


def _on_rough_track(r: Results, metric: str) -> pd.DataFrame:
    """A metric of NMPC on the irregular straight, mean over the realisations: preview in rows, cars in columns."""
    rows = r["ride_metrics"].query("controller == 'nmpc' and track == 'straight' and metric == @metric")
    return rows.pivot_table(index="preview", columns="car", values="value", aggfunc="mean")


@measure("C39")
def _known_irregularities(r: Results, claim: dict) -> Measured:
    error = _on_rough_track(r, "rail_rmse_y")["cone"]
    ratio = error["exact"] / error["none"]
    return _yes(ratio, ratio < claim["tolerance"], ratio < 1)


@measure("C40")
def _transfer(r: Results, claim: dict) -> Measured:
    return Measured(float("nan"), UNTESTABLE)


@measure("C41")
def _safety_and_comfort(r: Results, claim: dict) -> Measured:
    figures = [_on_rough_track(r, metric)["cone"] for metric in ("sum_y_over_limit", "n_mv_floor_front")]
    safety, comfort = (figure["exact"] / figure["none"] for figure in figures)
    better = [ratio < claim["tolerance"] for ratio in (safety, comfort)]
    return _yes(max(safety, comfort), all(better), any(better))


@schema.table
class Claim:
    """Entry of data/claims.toml, see its head."""

    section: str
    statement: str
    kind: Literal["value", "ratio", "ordering", "trend", "behaviour", "assumption"]
    unit: str
    tolerance: schema.Plain
    reason: str
    evidence: str
    notebook: str
    paper: schema.Plain | None = None
    verdict: Literal[VERDICTS] | None = None

    def __post_init__(self):
        file = f"figures/{self.evidence}.png" if self.evidence.startswith("fig") else self.evidence
        if not paths.source(file).exists():
            raise ValueError(f"has the evidence {self.evidence!r}, which does not exist")


def load_claims(path: Path | str | None = None) -> dict[str, dict]:
    """Claims of a TOML file (default data/claims.toml) by id; InputError with one sentence on wrong entries."""
    file = Path(path) if path else paths.source("data/claims.toml")
    claims = schema.read(file)
    schema.build(dict[str, Claim], claims, file.name)
    for identity in claims:
        if identity not in MEASURES:
            raise InputError(f"{file.name}: [{identity}] has no function in railrepro/report/claims.py")
    return claims


def evaluate() -> pd.DataFrame:
    """Table of all claims with measured values and verdicts (contract of data/results/claims.csv)."""
    rows = []
    for identity, claim in load_claims().items():
        results = Results()
        measured = MEASURES[identity](results, claim)
        rows.append(
            {
                "id": identity,
                "paper_ref": claim["section"],
                "statement": claim["statement"],
                "kind": claim["kind"],
                "paper_value": claim.get("paper", np.nan),
                "measured_value": measured.value,
                "unit": claim["unit"],
                "verdict": measured.verdict,
                "evidence": claim["evidence"],
                "data": " ".join(f"data/results/{name}.csv" for name in results.used),
            }
        )
    return pd.DataFrame(rows)


def changed(table: pd.DataFrame) -> list[str]:
    """Sentences on verdicts that differ from the stored ones."""
    claims = load_claims()
    return [
        f"{row.id}: now {row.verdict!r}, stored {claims[row.id].get('verdict')!r} ({row.statement})"
        for row in table.itertuples()
        if row.verdict != claims[row.id].get("verdict")
    ]


def main(arguments: list[str]) -> int:
    """Evaluate the claims and write claims.csv and REPLICATION.md; `--accept` stores the new verdicts."""
    from railrepro.report.text import render

    table = evaluate()
    if "--accept" in arguments:
        _store(table)
    write(paths.product("data/results/claims.csv"), table.to_csv(index=False, float_format="%.4g"))
    write(paths.product("REPLICATION.md"), render(table, load_claims()))
    print(table["verdict"].value_counts().to_string())
    differences = changed(table)
    if differences:
        advice = "store them with --accept if that is right"
        print("\n  ".join(["verdicts changed:", *differences]), advice, sep="\n", file=sys.stderr)
    return int(bool(differences))


def _store(table: pd.DataFrame) -> None:
    """Write the verdicts into data/claims.toml, keeping everything else as it is."""
    file = paths.ROOT / "data/claims.toml"
    verdicts, lines, identity = table.set_index("id")["verdict"], [], None
    for line in file.read_text().splitlines():
        if line.startswith("["):
            identity = line.strip("[]")
        if line.startswith("verdict ="):
            continue
        lines.append(line)
        if line.startswith("section ="):
            lines.append(f'verdict = "{verdicts[identity]}"')
    write(file, "\n".join(lines) + "\n")


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
