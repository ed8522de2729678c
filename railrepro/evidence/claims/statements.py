"""The paper's statements as predicates: one function and one rule per statement, for report, studies and tests.

The function computes a number from `Evidence`, which holds metrics from any source; the rule in data/claims.toml has
the limits between which the statement holds. Serves the paper's section Multi-Body Simulation Results.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.registry import EMPHASIS, PAPER_TRIO
from railrepro.data import InputError

REPRODUCED, PARTLY, TIE, NOT, UNTESTABLE = "reproduced", "partly", "tie", "not reproduced", "not testable"
NOTHING, SOFT = "nothing", f"nmpc, R x {EMPHASIS:g}"
"""Names in place of a controller: a running gear that stays at y = 0; NMPC with R times `EMPHASIS` in Fig. 8."""
SOFTEST, BETWEEN = "nmpc, second R", "nmpc, R between"
"""Names of NMPC with the second, larger R of Fig. 9, and with an R between the first and the second."""
FIXED, UNINFORMED, GUIDES_AS_WELL = "nmpc, fixed share", "nmpc, base torque unknown", 1.1
"""NMPC with the least fixed share of torque whose error is at most 1.1 times that with a variable one; without u_d."""
REGULAR = {name: f"{name}, regular operation" for name in ("nmpc", SOFT)}
"""Name of NMPC -> name that has its metric `regular_deviation` of Fig. 8, also if the run fails later."""
NO_LAW = {name: f"{name}, no slip control" for name in ("nmpc", SOFT)}
"""Name of NMPC -> name of the same run without slip control."""
SUDDEN = ("both rails, traction", "both rails, braking", "left rail, traction", "left rail, braking")
"""Names of the scenarios with a sudden loss of adhesion: on which rail, and whether the motors pull or brake."""
RAILS, PREVIEW = "irregular straight", "nmpc, preview"
"""Names of the scenario on irregular rails, and of NMPC that previews them."""
MPC, NDI = PAPER_TRIO[:2], PAPER_TRIO[2]
RATES, SHORT = "ndi, rates", "nmpc, horizon of 0.06 s"
"""NDI that knows the rates of the set point where it is, but nothing ahead; NMPC with hardly any preview."""
LAGS_MS = (2.0, 7.5, 10.0)
"""Lags of the drive over their range in data/vehicle.toml (ms); controllers are tuned for its nominal 5 ms."""
T3, LOSS, BRAKE, FASTEST = "curve_entry_T3", "adhesion_loss", "braking", "sine_tracking 400"
CASES = (T3, f"{T3} on T5", "sine of 1000 m 160", "sine of 1000 m 400")
CONES, NO_CREEP, AS_MODELLED = "nmpc on cones", "nmpc, nearly rolling", "nmpc on cones, nearly rolling"
"""Names of NMPC on a car with conical wheels, with nearly no creep, and with the two together; scenarios: `CASES`."""
CENTRED, CURVES = "nmpc, y* = 0", tuple(f"curve_entry_T{i}" for i in (1, 2, 3, 4))
"""Name of NMPC in the curve entries with the set point y* = 0, and names of these."""
DRIFT = "mean_error_last_third"
SAMPLING_MS, REGULAR_DEVIATION, BOUNDED, AMPLITUDE = 5.0, 0.1, 1.5, 3e-3
"""Sampling time that C15 asks for (ms), those of tuned controllers are 4 to 6 ms; deviation of the adhesion from its
set point up to which operation is regular (-); ratio of the RMS error of the second to the first half of the way below
which an oscillation is bounded (-); amplitude of the set points of Figs. 6 and 7 (m)."""
_WORST_IS_INFINITE = ("rmse_y", "largest_error", "delay", "stopping_distance", "largest_slip")


class MissingEvidence(KeyError):
    """Exception: a metric or table that a predicate needs is missing."""


@dataclass(frozen=True)
class Finding:
    """Result of the predicate of a statement, which `Statement.judge` compares with the limits of the statement.

    Attributes:
        value (float): Number to be compared, in `Statement.unit`; with NaN the statement does not hold.
        weaker (float or None): `value` for the weaker form of the statement; None if it has no weaker form.
        tie (float): Scatter, ln(largest / smallest value between seeds); within a factor exp(tie) of a limit is a tie.
    """

    value: float
    weaker: float | None = None
    tie: float = 0.0


@dataclass(frozen=True)
class Evidence:
    """Metrics of runs and tables of results, from which the predicates judge the statements.

    Attributes:
        metrics (mapping): (scenario, controller, metric) -> value (SI); `failed` is 1 where a run failed.
        spread (mapping): (scenario, controller, metric) -> scatter between seeds, ln(largest / smallest value).
        tables (callable or None): Name of a table of data/results -> its DataFrame, or None if it is missing.
        setting (str): Setting of comparison (`registry.SETTINGS`) of metrics and tables; "" for tables without one.
    """

    metrics: Mapping[tuple[str, str, str], float]
    spread: Mapping[tuple[str, str, str], float] = field(default_factory=dict)
    tables: Callable[[str], pd.DataFrame | None] | None = None
    setting: str = ""

    def __call__(self, scenario: str, controller: str, metric: str) -> float:
        """Value of a metric (SI); for a failed run inf if less is better, else NaN; MissingEvidence if not stored."""
        if self.metrics.get((scenario, controller, "failed"), 0.0) > 0 and metric != "failed":
            return float("inf") if metric in _WORST_IS_INFINITE else float("nan")
        try:
            return float(self.metrics[scenario, controller, metric])
        except KeyError:
            raise MissingEvidence(f"{scenario}, {controller}, {metric}") from None

    def table(self, name: str) -> pd.DataFrame:
        """Rows of a table of data/results in `setting`; MissingEvidence when there is no such table or row.

        With the setting "" only tables without a column `setting` are found.
        """
        table = self.tables(name) if self.tables else None
        if table is None:
            raise MissingEvidence(name)
        own = table[table["setting"] == self.setting] if "setting" in table else table
        if ("setting" in table) != bool(self.setting) or own.empty:
            raise MissingEvidence(f"{name}, {self.setting or 'no setting'}")
        return own

    def ratio(self, scenario: str, first: str, second: str, metric: str = "rmse_y") -> float:
        """Metric of the controller `first` over metric of `second` in a scenario (-); NaN if the second failed."""
        other = self(scenario, second, metric)
        return self(scenario, first, metric) / other if np.isfinite(other) else float("nan")

    def tie(self, scenario: str, controllers: Iterable[str], metric: str = "rmse_y") -> float:
        """Largest scatter between seeds (`spread`) of a metric among `controllers`; 0 where none is stored."""
        return max(self.spread.get((scenario, name, metric), 0.0) for name in controllers)

    def ahead(self, scenario: str, first: str, second: str) -> bool:
        """Whether RMSE of y of `first` times exp(`tie`) is below RMSE of y of `second`; False if a run failed."""
        return self.ratio(scenario, first, second) * np.exp(self.tie(scenario, (first, second))) < 1

    def sines(self) -> dict[int, str]:
        """Scenarios of Fig. 7 that NMPC drove: speed (km/h, ascending) -> name; MissingEvidence for fewer than two."""
        found = {s for s, name, _ in self.metrics if name == "nmpc" and s.startswith("sine_tracking ")}
        if len(found) < 2:
            raise MissingEvidence("sine_tracking at two speeds")
        return dict(sorted((int(scenario.split()[1]), scenario) for scenario in found))


@data.table
class Statement:
    """Statement of the paper with the rule by which it is judged, an entry of data/claims.toml.

    A value (in `unit`) between `above` and `below` reproduces it, one between `partly_above` and `partly_below` does so
    partly. None is no limit; `reason` says why the limits are so. `statement` is what `section` of the paper claims,
    `paper` the number printed there. `evidence` is a figure, as "fig06_curve_entry", or the path of a table, made by
    `notebook`. `control` names tests with wrong inputs that must refute the claim, joined by "; ". ValueError when the
    evidence does not exist, or when kind is "statement" and both `above` and `below` are None.
    """

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
        for low, high in ((self.above, self.below), (self.partly_above, self.partly_below)):
            if low is not None and high is not None and not low < high:
                raise ValueError(f"holds above {low} and below {high}, a lower limit below the upper one is needed")

    def judge(self, finding: Finding) -> str:
        """Verdict on a finding: `REPRODUCED`, `TIE`, `PARTLY` or `NOT`, the first that applies.

        `REPRODUCED`: `value` is between `above` and `below` by more than a factor exp(tie). `TIE`: it is within this
        factor of a limit. `PARTLY`: the weaker form of the statement holds, `Finding.weaker` (else `value`) is between
        `partly_above` and `partly_below` (without both: `above` and `below`).
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
    """Statements of a TOML file (default data/claims.toml): id, as "C05" -> `Statement`; InputError if wrong."""
    file = data.location(path, paths.source("data/claims.toml"))
    found = data.build(dict[str, Statement], data.read(file), file.name)
    for identity, statement in found.items():
        if identity not in VALUES and statement.kind == "statement":
            raise InputError(f"{file.name}: [{identity}] has no function in railrepro/evidence/claims/statements.py")
    return found


def find(identity: str, evidence: Evidence) -> Finding:
    """Compute the finding of a statement by its id, as "C05"; MissingEvidence when a metric or table is missing."""
    found = VALUES[identity](evidence)
    return found if isinstance(found, Finding) else Finding(float(found))


def findings(evidence: Evidence) -> dict[str, Finding]:
    """Findings of all statements for which `evidence` has the metrics and tables: id -> `Finding`."""
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


def _all_follow(e: Evidence) -> float:
    """The worse of set point and path: error over that of y = 0, yaw against the track over the track's heading."""
    point = max(e(T3, name, "rmse_y") for name in PAPER_TRIO) / e(T3, NOTHING, "rmse_y")
    return max(point, *(e(T3, name, "path_error") for name in PAPER_TRIO))


def _least(values: list[float]) -> Finding:
    """The smallest of what is compared, not a number where one of them is none; weaker is the largest."""
    return Finding(float(np.min(values)), float(np.fmax.reduce(values)))


def _same_torque_later(e: Evidence, name: str) -> float:
    """Shift of the torque of NDI against that of another controller over the shortest wave; nan when shapes differ."""
    if not np.isfinite([e(T3, each, "rmse_y") for each in (name, NDI)]).all():
        return float("nan")
    later = e(T3, name, "ndi_later") / e(T3, NOTHING, "shortest_wave")
    return later if e(T3, name, "ndi_alike") > 0.71 else float("nan")


def _less_delay(e: Evidence) -> float:
    """Delay of NDI less the larger of both MPC over the shortest wave."""
    own, rival = (max(abs(e(T3, name, "delay")) for name in names) for names in (MPC, [NDI]))
    return (rival - own) / e(T3, NOTHING, "shortest_wave") if np.isfinite(rival) else float("nan")


def _because_of_preview(e: Evidence) -> Finding:
    """Share of the delay between NDI and NMPC that returns without preview; nan where there is no such delay."""
    own, rival, rates, short = (abs(e(T3, name, "delay")) for name in ("nmpc", NDI, RATES, SHORT))
    if not rival - own > 0.1 * e(T3, NOTHING, "shortest_wave"):
        return Finding(float("nan"))
    return _least([(rates - own) / (rival - own), (short - own) / (rival - own)])


def _robust(e: Evidence) -> float:
    """Largest error of both MPC with another lag of the drive over that with the nominal one, in curve and sine."""
    found = [
        e(f"lag {lag:g} ms, {scenario}", name, "rmse_y") / e(scenario, name, "rmse_y")
        for scenario in (T3, FASTEST)
        for lag in LAGS_MS
        for name in MPC
    ]
    return float(np.max(found))


def _drift_from_model(e: Evidence) -> Finding:
    """Drift on a car as modelled over that on the real one, weaker with cones or rolling alone; nan without a drift."""
    drift = {name: abs(e(T3, name, DRIFT)) for name in ("nmpc", AS_MODELLED, CONES, NO_CREEP)}
    if not drift["nmpc"] > 0.1 * e(T3, NOTHING, "largest_error"):
        return Finding(float("nan"))
    whole, *parts = (drift[name] / drift["nmpc"] for name in (AS_MODELLED, CONES, NO_CREEP))
    return Finding(whole, min(parts))


def _gyroscope(e: Evidence) -> float:
    shares = [e(T3, name, "gyroscopic_share") for name in PAPER_TRIO]
    return max(shares, key=lambda share: abs(share - 1) if np.isfinite(share) else np.inf)


def usual_times(e: Evidence, solver: str, column: str) -> pd.Series:
    """`column` of table solve_times, as "median_ms", for a solver: Series by scenario, without active bounds."""
    times = e.table("solve_times").query("solver == @solver")
    return times[~times["scenario"].str.contains("bounds")].set_index("scenario")[column]


def _feasible(e: Evidence) -> Finding:
    worst = e.table("solve_times").query("solver == 'ltv_mpc'")["max_ms"].max()
    return Finding(worst / SAMPLING_MS, usual_times(e, "ltv_mpc", "max_ms").max() / SAMPLING_MS)


def _ranked(e: Evidence, scenarios: Iterable[str]) -> float:
    """Share of scenarios with the order of the paper: NMPC, LTV-MPC, NDI."""
    return _fraction(e.ahead(each, *MPC) and e.ahead(each, MPC[1], NDI) for each in scenarios)


def _lead_over_ndi(e: Evidence, names: Sequence[str]) -> float:
    """Share of the speeds of the sine at which all these controllers are ahead of NDI."""
    return _fraction(all(e.ahead(each, name, NDI) for name in names) for each in e.sines().values())


def _slower_is_better(e: Evidence) -> float:
    """Smallest rank correlation of error and speed; not a number when a run failed."""
    errors = pd.DataFrame({name: [e(s, name, "rmse_y") for s in e.sines().values()] for name in PAPER_TRIO})
    if not np.isfinite(errors.to_numpy()).all():
        return float("nan")
    place = np.arange(len(errors))
    return min(np.corrcoef(errors[name].rank(), place)[0, 1] if np.ptp(errors[name]) > 0 else 0.0 for name in errors)


def _ndi_grows_most(e: Evidence) -> Finding:
    """Slope of the error of NDI over speed against the steeper one of both MPC."""
    sines = e.sines()
    slopes = [np.polyfit([*sines], [e(s, name, "rmse_y") for s in sines.values()], 1)[0] for name in PAPER_TRIO]
    steepest = max(slopes[0], slopes[1])
    ratio = slopes[2] / steepest if steepest > 0 else float("inf") if slopes[2] > 0 else float("nan")
    tie = e.tie([*sines.values()][-1], PAPER_TRIO)
    return Finding(ratio if np.isfinite(slopes[:2]).all() else float("nan"), tie=tie)


def _soft_too(value: Callable[[Evidence, str], float]) -> Callable[[Evidence], Finding]:
    """Predicate on NMPC in Fig. 8 from a function of evidence and its name; weaker with R x 10."""
    return lambda e: Finding(*(value(e, name) for name in NO_LAW))


def _regular(e: Evidence) -> Finding:
    """Deviation in regular operation of NMPC as tuned; weaker is the smaller one of that with R x 10 and it."""
    found = [e(LOSS, name, "regular_deviation") for name in REGULAR.values()]
    return Finding(found[0], min(found))


def _no_excessive_slip(e: Evidence, name: str) -> float:
    """Largest slip over what is excessive; nan unless the law halves it."""
    own, without = (e(LOSS, each, "largest_slip") for each in (name, NO_LAW[name]))
    return own / e(LOSS, NOTHING, "excessive_slip") if own < 0.5 * without else float("nan")


def _share_due_to_the_law(e: Evidence, name: str, part: str, whole: str) -> float:
    """A count over another; nan where there is nothing to count, or it is not smaller by a tenth without the law."""
    own, without = (e(LOSS, each, part) / (e(LOSS, each, whole) or np.nan) for each in (name, NO_LAW[name]))
    return own if not np.isfinite(without) or without < 0.9 * own else float("nan")


def _one_law(e: Evidence, case: str) -> bool:
    """Whether operation is regular before a sudden loss, and the law halves slip and loss of utilisation in it."""
    names = "nmpc", NO_LAW["nmpc"]
    slip, free_slip = (e(case, name, "largest_slip") for name in names)
    lost, free_lost = (1 - e(case, name, "utilisation") for name in names)
    regular = e(case, "nmpc", "regular_deviation") < REGULAR_DEVIATION
    return regular and slip < 0.5 * free_slip and lost < 0.5 * free_lost


def _without_knowledge(e: Evidence) -> float:
    """Share of the fields of the map in which the law halves the loss of utilisation."""
    table = e.table("adhesion_map").set_index(["map", "x", "y"])["utilisation"]
    return _fraction(1 - table["friction"] < 0.5 * (1 - table["no slip control"]))


def _step_bound(e: Evidence) -> float:
    """Share of the steps above the bound of the proof with which the deviation stays within the law's corridor."""
    return _fraction(e.table("adhesion_law").query("p2_over_bound > 1")["rms_error"] < AdhesionSettings().corridor)


def _stable_on_poor_rail(e: Evidence, name: str) -> float:
    """Slope of y over the set point where the oscillation does not grow and follows; else not a number."""
    stable = e(LOSS, name, "error_growth") < BOUNDED and e.ratio(LOSS, name, NOTHING) < 1
    return e(LOSS, name, "set_point_gain") if stable else float("nan")


def _poor_is_harder(e: Evidence) -> Finding:
    """Error over that of y = 0, poor over dry rail at 400 km/h, least of NMPC and NDI; inf where flanges hold."""
    dry = "sine_tracking 400"
    free = [name for name in ("nmpc", NDI) if e(LOSS, name, "flange") == 0]
    ratios = [e.ratio(LOSS, name, NOTHING) / e.ratio(dry, name, NOTHING) for name in free]
    return Finding(min(ratios, default=float("inf")), tie=max(e.tie(dry, free), e.tie(LOSS, free)) if free else 0.0)


def _front(e: Evidence, kind: str) -> list[tuple[float, float]]:
    """(stopping distance, error) of a sweep while braking, in the order of its factor or pole."""
    factors = sorted(
        float(metric.partition(" ")[2]) for s, n, metric in e.metrics if (s, n) == (BRAKE, kind) and "rmse_y " in metric
    )
    if len(factors) < 2:
        raise MissingEvidence(f"{BRAKE}, sweep of {kind}")
    return [tuple(e(BRAKE, kind, f"{name} {f:g}") for name in ("stopping_distance", "rmse_y")) for f in factors]


def _saved(e: Evidence, runs: list[tuple[float, float]]) -> float:
    """Share of the stopping distance saved from first to third R beyond scatter; nan unless smooth and none failed."""
    (way, error), between, (last, largest) = runs
    scatter = [e(BRAKE, "nmpc", f"{metric}_spread") for metric in ("stopping_distance", "rmse_y")]
    smooth = last < between[0] < way and error < between[1] < largest and largest > error * np.exp(scatter[1])
    return 1 - last / way - scatter[0] if smooth and np.isfinite([way, largest]).all() else float("nan")


def _trade_off(e: Evidence) -> Finding:
    """What the second setting of R saves; weaker is the most that any pair of the sweep within a factor of ten does."""
    pair = [(e(BRAKE, n, "stopping_distance"), e(BRAKE, n, "rmse_y")) for n in ("nmpc", BETWEEN, SOFTEST)]
    sweep = _front(e, "sweep of R")
    others = [_saved(e, sweep[i : i + 3]) for i in range(len(sweep) - 2)]
    return Finding(_saved(e, pair), max((o for o in others if np.isfinite(o)), default=None))


def _more_smoothly(e: Evidence) -> float:
    """Share of steps of R that trade 1 % error for 0.5 % distance, less that of NDI poles, where errors overlap."""
    sweeps = [_front(e, kind) for kind in ("sweep of R", "sweep of poles")]
    errors = [[error for _, error in sweep] for sweep in sweeps]
    low, high = max(map(min, errors)), min(map(max, errors))
    shares = []
    for sweep in sweeps:
        ordered = sweep if sweep[0][1] <= sweep[-1][1] else sweep[::-1]
        steps = [(a, b) for a, b in pairwise(ordered) if max(a[1], b[1]) >= low and min(a[1], b[1]) <= high]
        shares.append(np.mean([b[0] < 0.995 * a[0] and b[1] > 1.01 * a[1] for a, b in steps]) if steps else np.nan)
    return float(shares[0] - shares[1])


def _against_ndi(e: Evidence, metric: str) -> Finding:
    """Ratios of both settings of R to NDI; a lead within what neighbouring R or poles differ by is a tie."""
    ratios = [e.ratio(BRAKE, name, NDI, metric) for name in ("nmpc", SOFTEST)]
    near = (e(BRAKE, name, f"{metric}_spread") for name in ("nmpc", NDI))
    return Finding(max(ratios), min(ratios), max(e.tie(BRAKE, ("nmpc", NDI), metric), *near))


def _acceptable(e: Evidence, without: str) -> Finding:
    """Largest change of the error when a simplification becomes true, over a tenth of the amplitude."""
    found = [abs(e(case, "nmpc", "rmse_y") - e(case, without, "rmse_y")) / (0.1 * AMPLITUDE) for case in CASES]
    return Finding(max(found), found[CASES.index(T3)])


def _similar_times(e: Evidence) -> float:
    """Longest over shortest median time of a problem on the tracks, the larger ratio of NMPC and LTV-MPC."""
    ratios = []
    for solver in ("gauss_newton", "ltv_mpc"):
        times = usual_times(e, solver, "median_ms")
        tracks = times[times.index.str.startswith(("curve", "sine"))]
        ratios.append(tracks.max() / tracks.min())
    return max(ratios)


VALUES: dict[str, Callable[[Evidence], Finding | float]] = {
    "C01": _table_one,
    # effort in the middle of the track, which the curve makes
    "C03": lambda e: e(CURVES[0], CENTRED, "effort_du") / max(e(curve, CENTRED, "effort_du") for curve in CURVES[1:]),
    "C04": _all_follow,
    "C05": lambda e: _worst([e.ratio(T3, name, NDI) for name in MPC], e.tie(T3, PAPER_TRIO)),
    "C06": lambda e: _worst([e.ratio(T3, "nmpc", other) for other in PAPER_TRIO[1:]], e.tie(T3, PAPER_TRIO)),
    "C07": lambda e: Finding(e(T3, MPC[1], "rmse_y") / e(T3, "nmpc", "rmse_y"), tie=e.tie(T3, MPC)),
    # delay as a share of the shortest wavelength
    "C08": lambda e: _worst([abs(e(T3, name, "delay")) / e(T3, NOTHING, "shortest_wave") for name in MPC]),
    "C09": lambda e: _least([_same_torque_later(e, name) for name in MPC]),
    "C10": _gyroscope,
    "C11": lambda e: _least([abs(e(T3, name, DRIFT)) / e(T3, NOTHING, "largest_error") for name in MPC]),
    "C12": lambda e: _least([e(T3, name, "shortfall") / e(T3, NOTHING, "largest_error") for name in MPC]),
    "C13": _drift_from_model,
    "C14": lambda e: (
        usual_times(e, "gauss_newton", "median_ms").median() / usual_times(e, "ltv_mpc", "median_ms").median()
    ),
    "C15": _feasible,
    "C16": lambda e: _ranked(e, CURVES),
    "C17": lambda e: _ranked(e, e.sines().values()),
    "C18": _slower_is_better,
    "C19": _ndi_grows_most,
    "C20": lambda e: Finding(_lead_over_ndi(e, MPC), _lead_over_ndi(e, MPC[:1])),
    "C21": _regular,
    "C23": _soft_too(_no_excessive_slip),
    "C24": _soft_too(partial(_share_due_to_the_law, part="recovered", whole="macro_slips")),
    "C50": _soft_too(partial(_share_due_to_the_law, part="approached", whole="approaches")),
    "C25": lambda e: _fraction(_one_law(e, case) for case in SUDDEN),
    "C26": _without_knowledge,
    "C27": _step_bound,
    "C28": _soft_too(_stable_on_poor_rail),
    "C49": _poor_is_harder,
    "C30": _trade_off,
    "C46": _more_smoothly,
    "C31": lambda e: _against_ndi(e, "rmse_y"),
    "C32": lambda e: _against_ndi(e, "stopping_distance"),
    # share of the distance saved against the smallest fixed share that guides as accurately; nan where there is none
    "C34": lambda e: 1 - e.ratio(BRAKE, "nmpc", FIXED, "stopping_distance"),
    "C35": lambda e: _acceptable(e, CONES),
    "C36": lambda e: _acceptable(e, NO_CREEP),
    "C37": lambda e: Finding(e.ratio(BRAKE, UNINFORMED, "nmpc"), tie=e(BRAKE, "nmpc", "rmse_y_spread")),
    "C39": lambda e: e.ratio(RAILS, PREVIEW, "nmpc", "rail_rmse_y"),
    "C41": lambda e: _worst(
        [e.ratio(RAILS, PREVIEW, "nmpc", metric) for metric in ("sum_y_over_limit", "n_mv_floor_front")]
    ),
    "C42": _less_delay,
    "C44": _similar_times,
    "C51": _because_of_preview,
    "C52": _robust,
}
"""Statement id -> its predicate, a function of `Evidence` that returns a `Finding` or its value."""
TABLES = dict.fromkeys(VALUES, "nominal_metrics") | {
    **{"C01": "table1", "C26": "adhesion_map", "C27": "adhesion_law"},
    **dict.fromkeys(("C14", "C15", "C44"), "solve_times"),
}
"""Statement id -> name of the table of data/results that its predicate reads; none reads two."""
