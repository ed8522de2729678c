"""Statements of the paper, a function and a rule for each, used by report, studies and tests. The function computes a
number from `Evidence`. The rule in data/claims.toml has the limits between which the statement holds, and the reason
for them. Serves the paper's section Multi-Body Simulation Results."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise, product
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.registry import EMPHASIS, PAPER_TRIO
from railrepro.data import InputError

REPRODUCED, PARTLY, TIE, NOT, UNTESTABLE = "reproduced", "partly", "tie", "not reproduced", "not testable"
MPC, NDI = PAPER_TRIO[:2], PAPER_TRIO[2]

# Scenarios
T3, LOSS, BRAKE, RAILS = "curve_entry_T3", "adhesion_loss", "braking", "irregular straight"
CURVES = tuple(f"curve_entry_T{i}" for i in (1, 2, 3, 4))
SINES = {speed: f"sine_tracking {speed}" for speed in (80, 160, 240, 320, 400)}  # by speed (km/h)
FASTEST = SINES[400]
CASES = (T3, f"{T3} on T5", "sine of 1000 m 160", "sine of 1000 m 400")  # of C35 and C36
SUDDEN = ("both rails, traction", "both rails, braking", "left rail, traction", "left rail, braking")
LAGS_MS = (2.0, 7.5, 10.0)  # lags of the drive over their range in data/vehicle.toml; controllers are tuned for 5 ms

# Names that metrics have in place of a controller's
NOTHING = "nothing"  # a running gear that stays at y = 0
CENTRED = "nmpc, y* = 0"
RATES = "ndi, rates"  # NDI that knows the rates of the set point at its own position, but nothing ahead
SHORT = "nmpc, horizon of 0.06 s"  # hardly any preview
HELD = "nmpc, set point held"  # NMPC whose forecast keeps the present set point
CONES, NO_CREEP, AS_MODELLED = "nmpc on cones", "nmpc, nearly rolling", "nmpc on cones, nearly rolling"  # cars of NMPC
SOFT = f"nmpc, R x {EMPHASIS:g}"  # in Fig. 8
REGULAR = {name: f"{name}, regular operation" for name in ("nmpc", SOFT)}  # has a value also if the run fails later
NO_LAW = {name: f"{name}, no slip control" for name in ("nmpc", SOFT)}
SOFTEST, BETWEEN = "nmpc, second R", "nmpc, R between"  # in Fig. 9: the larger R, and one between it and the first
UNINFORMED = "nmpc, base torque unknown"
FIXED = "nmpc, fixed share"  # least fixed share of the torque for guidance that guides as well as a variable one
PREVIEW = "nmpc, preview"  # of the irregular rails

Key = tuple[str, str, str]  # scenario, controller, metric
DRIFT = "mean_error_last_third"
REGULAR_DEVIATION = 0.1  # relative deviation of the adhesion from its set point up to which operation is regular
BOUNDED = 1.5  # an oscillation is bounded if its RMS error grows by less than this factor over half of the distance
GUIDES_AS_WELL = 1.1  # ratio of errors up to which guidance is as good
_WORST_IS_INFINITE = ("rmse_y", "largest_error", "delay", "stopping_distance", "largest_slip")


class MissingEvidence(KeyError):
    """A metric or table that the function of a statement needs is missing."""


@dataclass(frozen=True)
class Finding:
    """Measured value of a statement, which `Statement.judge` compares with its limits: the number `value` in
    `Statement.unit` (NaN never holds) and `weaker`, the value for the weaker form of the statement, if it has one.
    `tie` is ln(largest / smallest) between seeds: a `value` within the factor exp(tie) of a limit is a tie."""

    value: float
    weaker: float | None = None
    tie: float = 0.0


@dataclass(frozen=True)
class Evidence:
    """Metrics of runs and tables of results from which the statements are judged. `metrics` maps (scenario, controller,
    metric) to values (SI); the metric `failed` of a failed run is 1. `spread` maps the same keys to the scatter between
    seeds, ln(largest / smallest). `tables` returns a table of data/results by its name, None if it is missing.
    `setting` is "paper" (exact measurements), "loop" (sensors), or "" (no tuned controller)."""

    metrics: Mapping[Key, float]
    spread: Mapping[Key, float] = field(default_factory=dict)
    tables: Callable[[str], pd.DataFrame | None] | None = None
    setting: str = ""

    def __call__(self, scenario: str, controller: str, metric: str) -> float:
        """Return a metric (SI); of a failed run inf for rmse_y, largest_error, delay, stopping_distance and
        largest_slip, NaN for others, even if known. MissingEvidence if it is unknown."""
        if self.metrics.get((scenario, controller, "failed"), 0.0) > 0 and metric != "failed":
            return float("inf") if metric in _WORST_IS_INFINITE else float("nan")
        if (scenario, controller, metric) not in self.metrics:
            raise MissingEvidence(f"{scenario}, {controller}, {metric}")
        return float(self.metrics[scenario, controller, metric])

    def table(self, name: str) -> pd.DataFrame:
        """Return the rows of a table of data/results that have this `setting`, "paper" (exact measurements) or "loop"
        (sensors); with "" all rows of a table without a column `setting`. MissingEvidence if there are none."""
        table = self.tables(name) if self.tables else None
        if table is not None and ("setting" in table) == bool(self.setting):
            rows = table[table["setting"] == self.setting] if self.setting else table
            if not rows.empty:
                return rows
        raise MissingEvidence(f"{name}, {self.setting or 'no setting'}")

    def ratio(self, scenario: str, first: str, second: str, metric: str = "rmse_y") -> float:
        """Divide a metric of controller `first` by that of `second` (-); NaN if that of `second` is not finite."""
        other = self(scenario, second, metric)
        return self(scenario, first, metric) / other if np.isfinite(other) else float("nan")

    def tie(self, scenario: str, controllers: Iterable[str], metric: str = "rmse_y") -> float:
        """Return the largest scatter of a metric between seeds (`spread`, a logarithm) of `controllers`; 0 if none."""
        return max((self.spread.get((scenario, name, metric), 0.0) for name in controllers), default=0.0)

    def ahead(self, scenario: str, first: str, second: str) -> bool:
        """Whether the RMS error rmse_y of `first` is smaller than that of `second` by more than their scatter between
        seeds, the factor exp(`tie`); False if a run failed."""
        return self.ratio(scenario, first, second) * np.exp(self.tie(scenario, (first, second))) < 1


@data.table
class Statement:
    """Statement of the paper with the rule that judges it, one table of data/claims.toml. Only the `kind` "statement"
    gets a verdict. Others are "calibrated" (a number of the paper that set a choice of ours), "motivation" (no result
    of the paper) and "arithmetic" (true of any data). A value (in `unit`) between `above` and `below` reproduces the
    statement, a value between `partly_above` and `partly_below` does so partly. None is no limit. `measured` names the
    value in a few words, `reason` explains the limits. `statement` is what `section` of the paper claims, `paper` the
    number printed there. `evidence` is a figure, as "fig06_curve_entry", or the path of a table; `notebook` makes it.
    `control` names false results that the rule must refuse in a test, joined by "; ", such as "one controller thrice":
    LTV-MPC and NDI have the results of NMPC. InputError if the evidence does not exist, or for a statement without a
    limit."""

    section: str
    statement: str
    kind: Literal["statement", "calibrated", "motivation", "arithmetic"]
    unit: str
    reason: str
    notebook: str
    measured: str = ""
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
        """Return the first verdict that applies. "reproduced": `finding.value` is between `above` and `below` by more
        than a factor exp(tie). "tie": it is within this factor of a limit. "partly": `finding.weaker` (`value` if None)
        is by this factor between `partly_above` and `partly_below` (without both, of `above` and `below`). Else "not
        reproduced"."""
        limits = self.above, self.below
        if _within(finding.value, *limits, finding.tie):
            return REPRODUCED
        if finding.tie > 0 and _within(finding.value, *limits, -finding.tie):
            return TIE
        if self.partly_above is not None or self.partly_below is not None:
            limits = self.partly_above, self.partly_below
        value = finding.value if finding.weaker is None else finding.weaker
        return PARTLY if _within(value, *limits, finding.tie) else NOT


def _within(value: float, above: float | None, below: float | None, tie: float) -> bool:
    """Whether a value lies between limits by more than a factor of exp(tie)."""
    factor = np.exp(np.clip(tie, -700.0, 700.0))
    return bool((above is None or value > above * factor) and (below is None or value * factor < below))


def load(path: Path | str | None = None) -> dict[str, Statement]:
    """Read a TOML file of statements (default data/claims.toml): id, as "C05" -> `Statement`; InputError if wrong."""
    file = data.location(path, paths.source("data/claims.toml"))
    known = data.build(dict[str, Statement], data.read(file), file.name)
    for identity, statement in known.items():
        if identity not in VALUES and statement.kind == "statement":
            raise InputError(f"{file.name}: [{identity}] has no function in railrepro/evidence/claims/statements.py")
    return known


def find(identity: str, evidence: Evidence) -> Finding:
    """Compute the value of a statement by its id, as "C05"; MissingEvidence if a metric or table is missing."""
    value = VALUES[identity](evidence)
    return value if isinstance(value, Finding) else Finding(float(value))


def findings(evidence: Evidence) -> dict[str, Finding]:
    """Compute the measured values of all statements for which `evidence` suffices: id -> `Finding`."""
    found = {}
    for identity in VALUES:
        with suppress(MissingEvidence):
            found[identity] = find(identity, evidence)
    return found


def _worst(values: list[float], tie: float = 0.0) -> Finding:
    """Make a finding of the largest of `values`; weaker is the smallest."""
    return Finding(max(values), min(values), tie)


def _least(values: list[float]) -> Finding:
    """Make a finding of the smallest of `values`, NaN if one is NaN; weaker is the largest."""
    return Finding(float(np.min(values)), float(np.fmax.reduce(values)))


def _fraction(conditions: Iterable[bool]) -> float:
    return float(np.mean(list(conditions)))


def _table_one(e: Evidence) -> float:
    """Compute the largest deviation from the heights of Table I (m) with the track width that fits best."""
    table = e.table("table1")
    sine = np.sin(np.radians(table["phi_deg"]))
    widths = np.linspace(1.4, 1.6, 2001)
    return min(float(np.abs(width * sine - table["printed_m"]).max()) for width in widths)


def _all_follow(e: Evidence) -> float:
    """Compute the worst error over that of y = 0, or the worst `path_error` of the probe if that is larger."""
    point = max(e(T3, name, "rmse_y") for name in PAPER_TRIO) / e(T3, NOTHING, "rmse_y")
    return max(point, *(e(T3, name, "path_error") for name in PAPER_TRIO))


def _same_torque_later(e: Evidence, name: str) -> float:
    """Divide the lag of the torque of NDI behind a controller by the shortest wave; NaN if their shapes differ."""
    if not np.isfinite([e(T3, each, "rmse_y") for each in (name, NDI)]).all():
        return float("nan")
    later = e(T3, name, "ndi_later") / e(T3, NOTHING, "shortest_wave")
    return later if e(T3, name, "ndi_alike") > 0.71 else float("nan")


def _less_delay(e: Evidence) -> float:
    """Subtract the larger delay of both MPC from that of NDI, over the shortest wave; NaN if NDI failed."""
    mpc, ndi = max(abs(e(T3, name, "delay")) for name in MPC), abs(e(T3, NDI, "delay"))
    return (ndi - mpc) / e(T3, NOTHING, "shortest_wave") if np.isfinite(ndi) else float("nan")


def _because_of_preview(e: Evidence) -> Finding:
    """Compute the fraction of the lead of NMPC over NDI that is lost without preview; NaN if there is no lead."""
    nmpc, ndi, *unforeseen = (abs(e(T3, name, "delay")) for name in ("nmpc", NDI, RATES, SHORT, HELD))
    if not ndi - nmpc > 0.1 * e(T3, NOTHING, "shortest_wave"):
        return Finding(float("nan"))
    return _least([(delay - nmpc) / (ndi - nmpc) for delay in unforeseen])


def _robust(e: Evidence) -> float:
    """Compute the largest ratio of errors of both MPC with another lag of the drive and with the nominal one."""
    ratios = [
        e(f"lag {lag:g} ms, {scenario}", name, "rmse_y") / e(scenario, name, "rmse_y")
        for scenario, lag, name in product((T3, FASTEST), LAGS_MS, MPC)
    ]
    return float(np.max(ratios))


def _drift_from_model(e: Evidence) -> Finding:
    """Divide the steady error on a car as modelled by the real one (NaN if small); weaker with one cause alone."""
    drift = {name: abs(e(T3, name, DRIFT)) for name in ("nmpc", AS_MODELLED, CONES, NO_CREEP)}
    if not drift["nmpc"] > 0.1 * e(T3, NOTHING, "largest_error"):
        return Finding(float("nan"))
    whole, *parts = (drift[name] / drift["nmpc"] for name in (AS_MODELLED, CONES, NO_CREEP))
    return Finding(whole, min(parts))


def _gyroscope(e: Evidence) -> float:
    """Find the controller whose balanced fraction of the gyroscopic moment is farthest from 1: this fraction."""
    shares = [e(T3, name, "gyroscopic_share") for name in PAPER_TRIO]
    return max(shares, key=lambda share: abs(share - 1) if np.isfinite(share) else np.inf)


def usual_times(e: Evidence, solver: str, column: str = "median_ms") -> pd.Series:
    """A `column` of table solve_times for a solver: Series by scenario, without problems in which bounds are active."""
    times = e.table("solve_times").query("solver == @solver")
    return times[~times["scenario"].str.contains("bounds")].set_index("scenario")[column]


def _feasible(e: Evidence) -> Finding:
    """Divide the longest time of an LTV problem by a sampling time of 5 ms; weaker without active bounds."""
    worst = e.table("solve_times").query("solver == 'ltv_mpc'")["max_ms"].max()
    return Finding(worst / 5.0, usual_times(e, "ltv_mpc", "max_ms").max() / 5.0)


def _ranked(e: Evidence, scenarios: Iterable[str], *pairs: tuple[str, str]) -> float:
    """Count in which fraction of the scenarios the first controller of every pair is ahead of the second."""
    return _fraction(all(e.ahead(scenario, *pair) for pair in pairs) for scenario in scenarios)


def _slower_is_better(e: Evidence) -> float:
    """Find the smallest rank correlation of error and speed among the controllers; NaN if a run failed."""
    errors = pd.DataFrame({name: [e(sine, name, "rmse_y") for sine in SINES.values()] for name in PAPER_TRIO})
    if not np.isfinite(errors.to_numpy()).all():
        return float("nan")
    order = np.arange(len(errors))
    return min(np.corrcoef(errors[name].rank(), order)[0, 1] if np.ptp(errors[name]) > 0 else 0.0 for name in errors)


def _ndi_grows_most(e: Evidence) -> Finding:
    """Divide the slope of the error of NDI over speed by the steeper slope of both MPC."""
    slopes = [np.polyfit([*SINES], [e(s, name, "rmse_y") for s in SINES.values()], 1)[0] for name in PAPER_TRIO]
    steepest = max(slopes[0], slopes[1])
    ratio = slopes[2] / steepest if steepest > 0 else float("inf") if slopes[2] > 0 else float("nan")
    return Finding(ratio if np.isfinite(slopes[:2]).all() else float("nan"), tie=e.tie(FASTEST, PAPER_TRIO))


def _soft_too(value: Callable[[Evidence, str], float]) -> Callable[[Evidence], Finding]:
    """Make a predicate on NMPC as tuned in Fig. 8, weaker with R x 10, from a function of evidence and name."""
    return lambda e: Finding(*(value(e, name) for name in NO_LAW))


def _regular(e: Evidence) -> Finding:
    """Take the deviation of NMPC as tuned in regular operation; weaker is the smaller one of it and R x 10."""
    deviations = [e(LOSS, name, "regular_deviation") for name in REGULAR.values()]
    return Finding(deviations[0], min(deviations))


def _no_excessive_slip(e: Evidence, name: str) -> float:
    """Divide the largest slip by the excessive slip; NaN unless slip control halves it."""
    slip, without = (e(LOSS, each, "largest_slip") for each in (name, NO_LAW[name]))
    return slip / e(LOSS, NOTHING, "excessive_slip") if slip < 0.5 * without else float("nan")


def _ratio_due_to_law(e: Evidence, name: str, part: str, whole: str) -> float:
    """Divide two counts; NaN if `whole` is 0, or unless the ratio is smaller by a tenth without slip control."""
    ratio, without = (e(LOSS, each, part) / (e(LOSS, each, whole) or np.nan) for each in (name, NO_LAW[name]))
    return ratio if not np.isfinite(without) or without < 0.9 * ratio else float("nan")


def _one_law(e: Evidence, case: str) -> bool:
    """Whether operation is regular before a sudden loss, and slip control halves the slip and the lost utilisation."""
    names = "nmpc", NO_LAW["nmpc"]
    slip, free_slip = (e(case, name, "largest_slip") for name in names)
    lost, free_lost = (1 - e(case, name, "utilisation") for name in names)
    regular = e(case, "nmpc", "regular_deviation") < REGULAR_DEVIATION
    return regular and slip < 0.5 * free_slip and lost < 0.5 * free_lost


def _without_knowledge(e: Evidence) -> float:
    """Count in which fraction of the fields of the map slip control halves the lost utilisation."""
    table = e.table("adhesion_map").set_index(["map", "x", "y"])["utilisation"]
    return _fraction(1 - table["friction"] < 0.5 * (1 - table["no slip control"]))


def _step_bound(e: Evidence) -> float:
    """Count which fraction of the steps above the bound of the proof stays within the corridor of the law."""
    return _fraction(e.table("adhesion_law").query("p2_over_bound > 1")["rms_error"] < AdhesionSettings().corridor)


def _stable_on_poor_rail(e: Evidence, name: str) -> float:
    """Take the slope of y over the set point; NaN if the oscillation grows or the error exceeds that of y = 0."""
    stable = e(LOSS, name, "error_growth") < BOUNDED and e.ratio(LOSS, name, NOTHING) < 1
    return e(LOSS, name, "set_point_gain") if stable else float("nan")


def _poor_is_harder(e: Evidence) -> Finding:
    """Find the smallest ratio of errors (over y = 0) on poor and dry rail among controllers off the flange."""
    free = [name for name in ("nmpc", NDI) if e(LOSS, name, "flange") == 0]
    ratios = [e.ratio(LOSS, name, NOTHING) / e.ratio(FASTEST, name, NOTHING) for name in free]
    return Finding(min(ratios, default=float("inf")), tie=max(e.tie(FASTEST, free), e.tie(LOSS, free)))


def _front(e: Evidence, kind: str) -> list[tuple[float, float]]:
    """List the pairs (stopping distance, error) of a sweep in Fig. 9, ordered by factor or pole."""
    factors = sorted(
        float(metric.partition(" ")[2]) for s, n, metric in e.metrics if (s, n) == (BRAKE, kind) and "rmse_y " in metric
    )
    if len(factors) < 2:
        raise MissingEvidence(f"{BRAKE}, {kind}")
    return [tuple(e(BRAKE, kind, f"{name} {f:g}") for name in ("stopping_distance", "rmse_y")) for f in factors]


def _saved(e: Evidence, runs: list[tuple[float, float]]) -> float:
    """Compute the fraction of stopping distance saved from first to third R, less scatter; NaN unless smooth."""
    (distance, error), between, (shortest, largest) = runs
    scatter = [e(BRAKE, "nmpc", f"{metric}_spread") for metric in ("stopping_distance", "rmse_y")]
    smooth = shortest < between[0] < distance and error < between[1] < largest and largest > error * np.exp(scatter[1])
    return 1 - shortest / distance - scatter[0] if smooth and np.isfinite([distance, largest]).all() else float("nan")


def _trade_off(e: Evidence) -> Finding:
    """Compute the fraction saved by the second R; weaker is the largest of any pair within a factor of ten."""
    pair = [(e(BRAKE, n, "stopping_distance"), e(BRAKE, n, "rmse_y")) for n in ("nmpc", BETWEEN, SOFTEST)]
    sweep = _front(e, "sweep of R")
    others = [_saved(e, sweep[i : i + 3]) for i in range(len(sweep) - 2)]
    return Finding(_saved(e, pair), max((o for o in others if np.isfinite(o)), default=None))


def _more_smoothly(e: Evidence) -> float:
    """Count how many steps of R trade 1 % error for 0.5 % distance, less those of the poles of NDI (fractions)."""
    sweeps = [_front(e, kind) for kind in ("sweep of R", "sweep of poles")]
    errors = [[error for _, error in sweep] for sweep in sweeps]
    low, high = max(map(min, errors)), min(map(max, errors))  # where the errors overlap
    shares = []
    for sweep in sweeps:
        ordered = sweep if sweep[0][1] <= sweep[-1][1] else sweep[::-1]
        steps = [(a, b) for a, b in pairwise(ordered) if max(a[1], b[1]) >= low and min(a[1], b[1]) <= high]
        shares.append(np.mean([b[0] < 0.995 * a[0] and b[1] > 1.01 * a[1] for a, b in steps]) if steps else np.nan)
    return float(shares[0] - shares[1])


def _against_ndi(e: Evidence, metric: str) -> Finding:
    """Compare NMPC with both R to NDI: largest ratio, weaker the smallest; neighbours count for the tie."""
    ratios = [e.ratio(BRAKE, name, NDI, metric) for name in ("nmpc", SOFTEST)]
    near = (e(BRAKE, name, f"{metric}_spread") for name in ("nmpc", NDI))
    return Finding(max(ratios), min(ratios), max(e.tie(BRAKE, ("nmpc", NDI), metric), *near))


def _acceptable(e: Evidence, without: str) -> Finding:
    """Find the largest change of the error, over a tenth of the amplitude, by a simplification; weaker on T3."""
    changes = [abs(e(case, "nmpc", "rmse_y") - e(case, without, "rmse_y")) / (0.1 * 3e-3) for case in CASES]
    return Finding(max(changes), changes[CASES.index(T3)])


def _similar_times(e: Evidence) -> float:
    """Divide the longest by the shortest median solve time of the tracks: larger ratio of NMPC and LTV-MPC."""
    tracks = [usual_times(e, solver).filter(regex="^(curve|sine)") for solver in ("gauss_newton", "ltv_mpc")]
    return max(times.max() / times.min() for times in tracks)


VALUES: dict[str, Callable[[Evidence], Finding | float]] = {
    "C01": _table_one,
    # effort on the centre line, which the curve causes
    "C03": lambda e: e(CURVES[0], CENTRED, "effort_du") / max(e(curve, CENTRED, "effort_du") for curve in CURVES[1:]),
    "C04": _all_follow,
    "C05": lambda e: _worst([e.ratio(T3, name, NDI) for name in MPC], e.tie(T3, PAPER_TRIO)),
    "C06": lambda e: _worst([e.ratio(T3, "nmpc", other) for other in PAPER_TRIO[1:]], e.tie(T3, PAPER_TRIO)),
    "C07": lambda e: Finding(e(T3, MPC[1], "rmse_y") / e(T3, "nmpc", "rmse_y"), tie=e.tie(T3, MPC)),
    # delay over the shortest wavelength
    "C08": lambda e: _worst([abs(e(T3, name, "delay")) / e(T3, NOTHING, "shortest_wave") for name in MPC]),
    "C09": lambda e: _least([_same_torque_later(e, name) for name in MPC]),
    "C10": _gyroscope,
    "C11": lambda e: _least([abs(e(T3, name, DRIFT)) / e(T3, NOTHING, "largest_error") for name in MPC]),
    "C12": lambda e: _least([e(T3, name, "shortfall") / e(T3, NOTHING, "largest_error") for name in MPC]),
    "C13": _drift_from_model,
    "C14": lambda e: usual_times(e, "gauss_newton").median() / usual_times(e, "ltv_mpc").median(),
    "C15": _feasible,
    "C16": lambda e: _ranked(e, CURVES, *pairwise(PAPER_TRIO)),
    "C17": lambda e: _ranked(e, SINES.values(), *pairwise(PAPER_TRIO)),
    "C18": _slower_is_better,
    "C19": _ndi_grows_most,
    "C20": lambda e: Finding(*(_ranked(e, SINES.values(), *product(names, [NDI])) for names in (MPC, MPC[:1]))),
    "C21": _regular,
    "C23": _soft_too(_no_excessive_slip),
    "C24": _soft_too(partial(_ratio_due_to_law, part="recovered", whole="macro_slips")),
    "C50": _soft_too(partial(_ratio_due_to_law, part="approached", whole="approaches")),
    "C25": lambda e: _fraction(_one_law(e, case) for case in SUDDEN),
    "C26": _without_knowledge,
    "C27": _step_bound,
    "C28": _soft_too(_stable_on_poor_rail),
    "C49": _poor_is_harder,
    "C30": _trade_off,
    "C46": _more_smoothly,
    "C31": lambda e: _against_ndi(e, "rmse_y"),
    "C32": lambda e: _against_ndi(e, "stopping_distance"),
    # fraction of the distance saved against the smallest fixed share that guides as well; NaN if there is none
    "C34": lambda e: 1 - e.ratio(BRAKE, "nmpc", FIXED, "stopping_distance"),
    "C35": lambda e: _acceptable(e, CONES),
    "C36": lambda e: _acceptable(e, NO_CREEP),
    "C37": lambda e: Finding(e.ratio(BRAKE, UNINFORMED, "nmpc"), tie=e(BRAKE, "nmpc", "rmse_y_spread")),
    "C39": lambda e: e.ratio(RAILS, PREVIEW, "nmpc", "rail_rmse_y"),
    "C41": lambda e: _worst([e.ratio(RAILS, PREVIEW, "nmpc", m) for m in ("sum_y_over_limit", "n_mv_floor_front")]),
    "C42": _less_delay,
    "C44": _similar_times,
    "C51": _because_of_preview,
    "C52": _robust,
}
"""Statement id -> function of `Evidence` that returns its `Finding`, or only the value of it."""
TABLES = dict.fromkeys(VALUES, "nominal_metrics") | {
    **{"C01": "table1", "C26": "adhesion_map", "C27": "adhesion_law"},
    **dict.fromkeys(("C14", "C15", "C44"), "solve_times"),
}
"""Statement id -> name of the only table of data/results from which it is judged."""
