"""The paper's statements as predicates: one function and one rule per statement, for report, studies and tests.

A function here turns evidence into a number; data/claims.toml says between which limits the statement holds, and why.
Evidence is a table of metrics by scenario, controller and metric, from any source, so that the nominal results
and a sample of the robustness study are judged alike.

Serves the paper's section Multi-Body Simulation Results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.control.registry import EMPHASIS, PAPER_TRIO
from railrepro.data import InputError

REPRODUCED, PARTLY, TIE, NOT, UNTESTABLE = "reproduced", "partly", "tie", "not reproduced", "not testable"
NOTHING = "nothing"
"""Name under which evidence has what y = 0 gives."""
SOFT = f"nmpc, R x {EMPHASIS:g}"
"""NMPC with a larger R in Fig. 8."""
SOFTEST, BETWEEN = "nmpc, second R", "nmpc, R between"
"""NMPC in the second setting of Fig. 9, and with an R between both."""
FIXED, GUIDES_AS_WELL = "nmpc, fixed share", 1.1
"""NMPC with the smallest fixed allocation whose error is at most so many times that of the variable one."""
REGULAR = {name: f"{name}, regular operation" for name in ("nmpc", SOFT)}
"""Names under which evidence has how the longitudinal law does below the maximum, whatever comes after, by R."""
NO_LAW = {name: f"{name}, no slip control" for name in ("nmpc", SOFT)}
"""Names of the runs without slip control, by R."""
SUDDEN = ("both rails, traction", "both rails, braking", "left rail, traction", "left rail, braking")
"""Sudden losses of adhesion."""
UNINFORMED = "nmpc, base torque unknown"
RAILS, PREVIEW = "irregular straight", "nmpc, preview"
"""The irregular rails, and NMPC that knows them."""
MPC, NDI = PAPER_TRIO[:2], PAPER_TRIO[2]
T3, LOSS, BRAKE = "curve_entry_T3", "adhesion_loss", "braking"
CASES = (T3, f"{T3} on T5", "sine of 1000 m 160", "sine of 1000 m 400")
CONES, NO_CREEP = "nmpc on cones", "nmpc, nearly rolling"
"""Runs that show the effect of cones and of creep, and names of NMPC on such a car."""
CURVES = tuple(f"curve_entry_T{i}" for i in (1, 2, 3, 4))
DRIFT = "mean_error_last_third"
_WORST_IS_INFINITE = ("rmse_y", "largest_error", "delay", "stopping_distance", "largest_slip")


class MissingEvidence(KeyError):
    """What a predicate asks for is not among the evidence."""


@dataclass(frozen=True)
class Finding:
    """What a predicate finds.

    Attributes
    ----------
    value : float
        What is compared with the limits; nan never holds.
    weaker : float or None
        The same of the easier part of what is compared, see `Statement.judge`.
    tie : float
        Logarithm of the ratio between seeds; a value as near to a limit as that is a tie.
    """

    value: float
    weaker: float | None = None
    tie: float = 0.0


@dataclass(frozen=True)
class Evidence:
    """Metrics of runs, and tables for what no run of its own can show.

    Attributes
    ----------
    metrics : mapping
        (scenario, controller, metric) -> value (SI); `failed` is 1 where a run derailed.
    spread : mapping
        The same keys -> logarithm of largest over smallest value among the seeds of swarm and noise.
    tables : callable or None
        Name of a table of data/results -> DataFrame, or None when it is not made yet; None when there are none.
    setting : str
        Setting of comparison that all of it comes from; empty where no controller takes part.
    """

    metrics: Mapping[tuple[str, str, str], float]
    spread: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    tables: Callable[[str], pd.DataFrame | None] | None = None
    setting: str = ""

    def __call__(self, scenario: str, controller: str, metric: str) -> float:
        """A metric; of a failed run infinity where less is better, else nan."""
        if self.metrics.get((scenario, controller, "failed"), 0.0) > 0 and metric != "failed":
            return float("inf") if metric in _WORST_IS_INFINITE else float("nan")
        try:
            return float(self.metrics[scenario, controller, metric])
        except KeyError:
            raise MissingEvidence(f"{scenario}, {controller}, {metric}") from None

    def table(self, name: str) -> pd.DataFrame:
        """A table of data/results: its rows of the own setting, or one without settings where there is none."""
        table = self.tables(name) if self.tables else None
        if table is None:
            raise MissingEvidence(name)
        own = table[table["setting"] == self.setting] if "setting" in table else table
        if ("setting" in table) != bool(self.setting) or own.empty:
            raise MissingEvidence(f"{name}, {self.setting or 'no setting'}")
        return own

    def ratio(self, scenario: str, first: str, second: str, metric: str = "rmse_y") -> float:
        """A metric of one controller over that of another; not a number where the other failed."""
        other = self(scenario, second, metric)
        return self(scenario, first, metric) / other if np.isfinite(other) else float("nan")

    def tie(self, scenario: str, controllers: Iterable[str], metric: str = "rmse_y") -> float:
        """Largest spread between seeds among some controllers; zero when no seeds are known."""
        return max(self.spread.get((scenario, name, metric), 0.0) for name in controllers)

    def ahead(self, scenario: str, first: str, second: str) -> bool:
        """Whether one controller is more accurate than another, which did not fail, by more than seeds differ."""
        return self.ratio(scenario, first, second) * np.exp(self.tie(scenario, (first, second))) < 1

    def speeds(self) -> list[int]:
        """Speeds of the sine on the straight (km/h) that NMPC has driven, rising."""
        found = {s for s, name, metric in self.metrics if name == "nmpc" and s.startswith("sine_tracking ")}
        speeds = sorted(int(scenario.rpartition(" ")[2]) for scenario in found)
        if len(speeds) < 2:
            raise MissingEvidence("sine_tracking at two speeds")
        return speeds


@data.table
class Statement:
    """Entry of data/claims.toml, see its head."""

    section: str
    statement: str
    kind: Literal["statement", "calibrated", "motivation", "arithmetic"]
    unit: str
    reason: str
    notebook: str
    evidence: str = ""
    control: str = ""
    above: data.Plain | None = None
    below: data.Plain | None = None
    partly_above: data.Plain | None = None
    partly_below: data.Plain | None = None
    paper: data.Plain | None = None

    def __post_init__(self):
        file = f"figures/{self.evidence}.png" if self.evidence.startswith("fig") else self.evidence
        if not paths.source(file).exists():
            raise ValueError(f"has the evidence {self.evidence!r}, which does not exist")
        if self.kind == "statement" and self.above is None and self.below is None:
            raise ValueError("has neither above nor below; a statement needs a limit")

    @property
    def controls(self) -> list[str]:
        """Names of its negative controls."""
        return self.control.split("; ") if self.control else []

    def judge(self, finding: Finding) -> str:
        """The verdict on a finding: partly where the weaker form of the statement holds.

        That is the easier part of what it compares (`Finding.weaker`), or all of it within the wider limits
        `partly_above` and `partly_below`; a statement without either has no weaker form.
        """
        if _within(finding.value, self.above, self.below, finding.tie):
            return REPRODUCED
        if finding.tie > 0 and _within(finding.value, self.above, self.below, -finding.tie):
            return TIE  # as near to a limit as seeds differ
        wider = self.partly_above is not None or self.partly_below is not None
        limits = (self.partly_above, self.partly_below) if wider else (self.above, self.below)
        value = finding.value if finding.weaker is None else finding.weaker
        return PARTLY if _within(value, *limits, finding.tie) else NOT


def _within(value: float, above: float | None, below: float | None, tie: float) -> bool:
    """Whether a value lies between limits, both drawn in by a factor of exp(tie)."""
    factor = np.exp(np.clip(tie, -700.0, 700.0))
    return bool((above is None or value > above * factor) and (below is None or value * factor < below))


def load(path: Path | str | None = None) -> dict[str, Statement]:
    """Statements of a TOML file (default data/claims.toml) by id; InputError with one sentence on wrong entries."""
    file = data.location(path, paths.source("data/claims.toml"))
    found = data.build(dict[str, Statement], data.read(file), file.name)
    for identity, statement in found.items():
        if identity not in VALUES and statement.kind == "statement":
            raise InputError(f"{file.name}: [{identity}] has no function in railrepro/evidence/claims/statements.py")
    return found


def find(identity: str, evidence: Evidence) -> Finding:
    """What the predicate of a statement finds; MissingEvidence when the evidence does not suffice."""
    found = VALUES[identity](evidence)
    return found if isinstance(found, Finding) else Finding(float(found))


def findings(evidence: Evidence) -> dict[str, Finding]:
    """What the predicates find for which the evidence suffices, by id."""
    found = {}
    for identity in VALUES:
        with suppress(MissingEvidence):
            found[identity] = find(identity, evidence)
    return found


def _worst(values: list[float], tie: float = 0.0) -> Finding:
    """The largest of what is compared; weaker is the smallest."""
    return Finding(max(values), min(values), tie)


def _fraction(conditions: Iterable[bool]) -> float:
    return float(np.mean(list(conditions)))


def _table_one(e: Evidence) -> float:
    """Deviation from Table I with the one width of the track that fits best (m)."""
    table = e.table("table1")
    sine = np.sin(np.radians(table["phi_deg"]))
    widths = np.linspace(1.4, 1.6, 2001)
    return min(float(np.abs(width * sine - table["printed_m"]).max()) for width in widths)


def _effort_on_t1(e: Evidence) -> float:
    others = max(e(f"curve_entry_T{i}", "nmpc", "effort_du") for i in (2, 3, 4))
    return e("curve_entry_T1", "nmpc", "effort_du") / others


def _all_follow(e: Evidence) -> float:
    """The worse of set point and path: error over that of y = 0, yaw against the track over the track's heading."""
    point = max(e(T3, name, "rmse_y") for name in PAPER_TRIO) / e(T3, NOTHING, "rmse_y")
    return max(point, *(e(T3, name, "path_error") for name in PAPER_TRIO))


def _same_torque_later(e: Evidence) -> float:
    if not np.isfinite([e(T3, name, "rmse_y") for name in ("nmpc", NDI)]).all():
        return float("nan")
    return e(T3, NDI, "torque_later") if e(T3, NDI, "torque_alike") > 0.8 else float("nan")


def _gyroscope(e: Evidence) -> float:
    shares = [e(T3, name, "gyroscopic_share") for name in PAPER_TRIO]
    return max(shares, key=lambda share: abs(share - 1) if np.isfinite(share) else np.inf)


def usual_times(e: Evidence, solver: str, column: str) -> pd.Series:
    """A column of solve_times.csv by scenario, without those with tightened bounds."""
    times = e.table("solve_times").query("solver == @solver")
    return times[~times["scenario"].str.contains("bounds")].set_index("scenario")[column]


def _feasible(e: Evidence) -> Finding:
    worst = e.table("solve_times").query("solver == 'ltv_mpc'")["max_ms"].max()
    return Finding(worst, usual_times(e, "ltv_mpc", "max_ms").max())


def _ranked(e: Evidence, scenario: str) -> bool:
    return e.ahead(scenario, *MPC) and e.ahead(scenario, MPC[1], NDI)


def _both_lead(e: Evidence, scenario: str) -> bool:
    return all(e.ahead(scenario, name, NDI) for name in MPC)


def _sines(e: Evidence) -> list[str]:
    return [f"sine_tracking {speed}" for speed in e.speeds()]


def _nmpc_leads(e: Evidence) -> float:
    return _fraction(e.ahead(scenario, "nmpc", NDI) for scenario in _sines(e))


def _slower_is_better(e: Evidence) -> float:
    """Smallest rank correlation of error and speed; not a number when a run failed."""
    errors = pd.DataFrame({name: [e(s, name, "rmse_y") for s in _sines(e)] for name in PAPER_TRIO})
    if not np.isfinite(errors.to_numpy()).all():
        return float("nan")
    place = np.arange(len(errors))
    return min(np.corrcoef(errors[name].rank(), place)[0, 1] if np.ptp(errors[name]) > 0 else 0.0 for name in errors)


def _ndi_grows_most(e: Evidence) -> Finding:
    """Slope of the error of NDI over speed against the steeper one of both MPC."""
    slopes = [np.polyfit(e.speeds(), [e(s, name, "rmse_y") for s in _sines(e)], 1)[0] for name in PAPER_TRIO]
    steepest = max(slopes[0], slopes[1])
    ratio = slopes[2] / steepest if steepest > 0 else float("inf") if slopes[2] > 0 else float("nan")
    return Finding(ratio if np.isfinite(slopes[:2]).all() else float("nan"), tie=e.tie(_sines(e)[-1], PAPER_TRIO))


def _due_to_the_law(e: Evidence, metric: str, smaller: bool) -> Finding:
    """A metric of NMPC in Fig. 8 as tuned, weaker with R x 10; nan unless it is worse by a tenth without the law."""

    def counts(name: str) -> float:
        own, without = e(LOSS, name, metric), e(LOSS, NO_LAW[name], metric)
        worse = not np.isfinite(without) or (own < 0.9 * without if smaller else without < 0.9 * own)
        return own if worse else float("nan")

    return Finding(*map(counts, NO_LAW))


def _no_macro_slip(e: Evidence) -> Finding:
    found, limit = _due_to_the_law(e, "largest_slip", True), e(LOSS, NOTHING, "slip_at_maximum")
    return Finding(found.value / limit, found.weaker / limit)


def _both_directions(e: Evidence) -> float:
    slips = [[e(case, name, "largest_slip") for name in (SOFT, NO_LAW[SOFT])] for case in SUDDEN]
    return _fraction(with_law < 0.5 * without for with_law, without in slips)


def _step_bound(e: Evidence) -> float:
    """Smallest step over its bound with which the adhesion follows the set point."""
    table = e.table("adhesion_law").sort_values("p2_over_bound", kind="stable")
    follows = table["rms_error"] < 1.5 * table["rms_error"].min()
    return float(table.loc[follows, "p2_over_bound"].min())


def _stable_on_poor_rail(e: Evidence) -> Finding:
    """Slope of y over the set point where the oscillation does not grow; else not a number."""

    def bounded(name: str) -> float:
        return e(LOSS, name, "set_point_gain") if e(LOSS, name, "error_growth") < BOUNDED else float("nan")

    return Finding(bounded("nmpc"), bounded(SOFT))


BOUNDED = 1.5
"""Growth of the error from one half of the way to the other below which an oscillation is bounded."""


def _poor_is_harder(e: Evidence) -> Finding:
    """Error as a share of that of y = 0, on poor rail over dry rail, at 400 km/h, the least of NMPC and NDI.

    A controller that reaches the flanges on poor rail is left out: these hold the car, whatever the rail is.
    """
    dry = "sine_tracking 400"
    free = [name for name in ("nmpc", NDI) if e(LOSS, name, "flange") == 0]
    ratios = [e.ratio(LOSS, name, NOTHING) / e.ratio(dry, name, NOTHING) for name in free]
    return Finding(min(ratios, default=float("nan")), tie=max(e.tie(dry, free), e.tie(LOSS, free)) if free else 0.0)


def _front(e: Evidence, kind: str) -> list[tuple[float, float]]:
    """(stopping distance, error) of a sweep while braking, in the order of its factor or pole."""
    factors = sorted(
        float(metric.partition(" ")[2]) for s, n, metric in e.metrics if (s, n) == (BRAKE, kind) and "rmse_y " in metric
    )
    if len(factors) < 2:
        raise MissingEvidence(f"{BRAKE}, sweep of {kind}")
    return [tuple(e(BRAKE, kind, f"{name} {f:g}") for name in ("stopping_distance", "rmse_y")) for f in factors]


def _saved(runs: list[tuple[float, float]]) -> float:
    """Share of the stopping distance that the last of three rising R saves against the first.

    Not a number where a run failed, the error does not rise by a hundredth, or the one between does not lie between.
    """
    (way, error), between, (last, largest) = runs
    ordered = last < between[0] < way and error < between[1] < largest
    return 1 - last / way if ordered and np.isfinite([way, largest]).all() and largest > 1.01 * error else float("nan")


def _trade_off(e: Evidence) -> Finding:
    """What the second setting of R saves beyond the scatter of neighbouring R.

    Weaker is the most that any pair of the sweep within a factor of ten saves.
    """
    pair = [(e(BRAKE, n, "stopping_distance"), e(BRAKE, n, "rmse_y")) for n in ("nmpc", BETWEEN, SOFTEST)]
    sweep, scatter = _front(e, "sweep of R"), e(BRAKE, "nmpc", "stopping_distance_spread")
    others = [_saved(sweep[i : i + 3]) - scatter for i in range(len(sweep) - 2)]
    return Finding(_saved(pair) - scatter, max((o for o in others if np.isfinite(o)), default=None))


def _traded(runs: list[tuple[float, float]]) -> float:
    """Share of the steps of a sweep at which the distance falls and the error rises, begun at its more accurate end."""
    ordered = runs if runs[0][1] <= runs[-1][1] else runs[::-1]
    return float(np.mean([after[0] < before[0] and after[1] > before[1] for before, after in pairwise(ordered)]))


def _against_ndi(e: Evidence, metric: str) -> Finding:
    """Ratios of both settings of R to NDI; a lead within what neighbouring R or poles differ by is a tie."""
    ratios = [e.ratio(BRAKE, name, NDI, metric) for name in ("nmpc", SOFTEST)]
    near = (e(BRAKE, name, f"{metric}_spread") for name in ("nmpc", NDI))
    return Finding(max(ratios), min(ratios), max(e.tie(BRAKE, ("nmpc", NDI), metric), *near))


def _variable_allocation(e: Evidence) -> float:
    """Share of the distance saved against the smallest fixed share that guides as accurately (within a tenth)."""
    fixed = e(BRAKE, FIXED, "stopping_distance")
    return 1 - e(BRAKE, "nmpc", "stopping_distance") / fixed if np.isfinite(fixed) else float("nan")


def _cones(e: Evidence) -> Finding:
    """Largest change of the error from cones to S1002, over the acceptable one: a fifth, a tenth of the amplitude."""
    found = []
    for case in CASES:
        own, cones = (e(case, name, "rmse_y") for name in ("nmpc", CONES))
        change = abs(own - cones)
        found.append(min(change / cones / 0.2, change / (0.1 * AMPLITUDE)))
    return Finding(max(found), found[CASES.index(T3)])


AMPLITUDE = 3e-3
"""Amplitude of the set points of Figs. 6 and 7 (m)."""


def _rolling(e: Evidence) -> float:
    """Largest error of NMPC over that of y = 0, in the curve entries and on the sines."""
    scenarios = [*CURVES, *_sines(e)]
    return max(e(scenario, "nmpc", "rmse_y") / e(scenario, NOTHING, "rmse_y") for scenario in scenarios)


def _similar_times(e: Evidence) -> float:
    times = usual_times(e, "ipopt", "median_ms")
    tracks = times[times.index.str.startswith(("curve", "sine"))]
    return tracks.max() / tracks.min()


VALUES: dict[str, Callable[[Evidence], Finding | float]] = {
    "C01": _table_one,
    "C03": _effort_on_t1,
    "C04": _all_follow,
    "C05": lambda e: _worst([e.ratio(T3, name, NDI) for name in MPC], e.tie(T3, PAPER_TRIO)),
    "C06": lambda e: _worst([e.ratio(T3, "nmpc", other) for other in PAPER_TRIO[1:]], e.tie(T3, PAPER_TRIO)),
    "C07": lambda e: Finding(e(T3, MPC[1], "rmse_y") / e(T3, "nmpc", "rmse_y"), tie=e.tie(T3, MPC)),
    # delay as a share of the shortest wavelength
    "C08": lambda e: _worst([abs(e(T3, name, "delay")) / e(T3, NOTHING, "shortest_wave") for name in MPC]),
    "C09": _same_torque_later,
    "C10": _gyroscope,
    "C11": lambda e: abs(e(T3, "nmpc", DRIFT)) / e(T3, NOTHING, "largest_error"),
    "C12": lambda e: e(T3, "nmpc", "error_at_crests"),
    "C13": lambda e: abs(e(T3, NO_CREEP, DRIFT) / e(T3, "nmpc", DRIFT)),
    "C14": lambda e: (
        usual_times(e, "gauss_newton", "median_ms").median() / usual_times(e, "ltv_mpc", "median_ms").median()
    ),
    "C15": _feasible,
    "C16": lambda e: _fraction(_ranked(e, curve) for curve in CURVES),
    "C17": lambda e: Finding(_fraction(_ranked(e, scenario) for scenario in _sines(e)), _nmpc_leads(e)),
    "C18": _slower_is_better,
    "C19": _ndi_grows_most,
    "C20": lambda e: Finding(_fraction(_both_lead(e, scenario) for scenario in _sines(e)), _nmpc_leads(e)),
    "C21": lambda e: Finding(*(e(LOSS, name, "regular_end_deviation") for name in REGULAR.values())),
    "C23": _no_macro_slip,
    "C24": lambda e: _due_to_the_law(e, "recovered_share", False),
    "C50": lambda e: _due_to_the_law(e, "utilisation_late", False),
    "C25": _both_directions,
    "C26": lambda e: _fraction(e.table("adhesion_map").query("map == 'friction'")["utilisation"] > 0.75),
    "C27": _step_bound,
    "C28": _stable_on_poor_rail,
    "C49": _poor_is_harder,
    "C30": _trade_off,
    # of the steps of a sweep the share that trades accuracy for distance, of NMPC's R less that of NDI's poles
    "C46": lambda e: _traded(_front(e, "sweep of R")) - _traded(_front(e, "sweep of poles")),
    "C31": lambda e: _against_ndi(e, "rmse_y"),
    "C32": lambda e: _against_ndi(e, "stopping_distance"),
    "C34": _variable_allocation,
    "C35": _cones,
    "C36": _rolling,
    "C37": lambda e: e(BRAKE, UNINFORMED, "rmse_y") / e(BRAKE, "nmpc", "rmse_y"),
    "C39": lambda e: e.ratio(RAILS, PREVIEW, "nmpc", "rail_rmse_y"),
    "C41": lambda e: _worst(
        [e.ratio(RAILS, PREVIEW, "nmpc", metric) for metric in ("sum_y_over_limit", "n_mv_floor_front")]
    ),
    "C42": lambda e: _worst([abs(e.ratio(T3, name, NDI, "delay")) for name in MPC]),
    "C44": _similar_times,
}
"""Predicates by id."""
TABLES = dict.fromkeys(VALUES, "nominal_metrics") | {
    **{"C01": "table1", "C26": "adhesion_map", "C27": "adhesion_law"},
    **dict.fromkeys(("C14", "C15", "C44"), "solve_times"),
}
"""Table of data/results that each predicate reads, by id; none reads two."""
