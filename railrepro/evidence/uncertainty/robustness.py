"""Robustness of the verdicts: all statements on cars sampled from the ranges that the paper leaves open. Finished runs
are in the store, so an interrupted study resumes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy import stats

from railrepro import paths
from railrepro.control.registry import CONTROLLERS, LOOP, PAPER, PAPER_TRIO
from railrepro.data import write
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.probe import ONCE, PARTS, probe
from railrepro.evidence.claims.setup import COLUMNS, POLE, SWARM, ProbeSetup, setting_of, setup
from railrepro.studies.executor import ordered_map
from railrepro.tuning import margin
from railrepro.tuning.cost import driven, run_cost
from railrepro.tuning.swarm import Dimension
from railrepro.tuning.task import load_task, triple_pole
from railrepro.tuning.tune import fastest_pole
from railrepro.vehicle.parameters import load_vehicle, sample_ranges

SAMPLES = {PAPER: 48, SWARM: 48, LOOP: 24}  # per column of verdicts, the first ones of one sequence
LONG = {PAPER: 20, SWARM: 20, LOOP: 12}  # how many of them also have the long runs of `probe.ONCE`
SEED = 2026  # of the sequence
TUNING, JUDGING = 1, 101  # seeds of the noise in the setting `loop`
OPEN = (
    Dimension("profile (cone, S1002)", 0, 1, "integer"),
    Dimension("LTV-MPC (printed, with its affine term)", 0, 1, "integer"),
    Dimension("amplitude_mm", 1.0, 5.0),
    Dimension("period_start_m", 100.0, 200.0),
    Dimension("period_end_m", 30.0, 100.0),
    Dimension("clothoid_factor", 0.6, 1.5),
    Dimension("r_loss", 1.0, 300.0, "log"),
    Dimension("r_brake", 1.0, 300.0, "log"),
    Dimension("r_second", 1.5, 10.0, "log"),
    Dimension("adhesion.poor.k_a", 0.1, 1.0),
    Dimension("adhesion.poor.k_s over k_a", 0.2, 1.0),
)
"""What the paper leaves open besides the vehicle: choices of two, fields of `ProbeSetup`, creep slopes of poor rail."""
_PROFILE, _LTV, _RATIO = OPEN[0].name, OPEN[1].name, OPEN[-1].name
LABELS = ("number", "setting", "profile", "ltv")


def prior() -> tuple[Dimension, ...]:
    """List the sampled parameters with their ranges: those with a range in data/vehicle.toml, except of wet and very
    poor rail, and the choices of experiments that the paper leaves open (`OPEN`)."""
    known = {dimension.name for dimension in OPEN}
    unused = ("adhesion.wet.", "adhesion.very_poor.")
    ranges = {k: v for k, v in sample_ranges().items() if not k.startswith(unused) and k not in known}
    return (*(Dimension(key, *map(float, pair)) for key, pair in ranges.items()), *OPEN)


@dataclass(frozen=True)
class Sample:
    """One sampled combination of the parameters that the paper does not publish. `number` is its index in the Sobol
    sequence of `draw`. `setting` says how its controllers are tuned and run: "paper", with exact measurements; "swarm",
    the same, but poles of NDI by particle swarm; "loop", with sensors. `values` are pairs (name, value) of parameters
    from `prior`, as ("wheel.radius", 0.45); parameters that are not named stay nominal."""

    number: int
    setting: str
    values: tuple[tuple[str, float], ...]

    def world(self, seed: int | None = None) -> ProbeSetup:
        """Make the `ProbeSetup` of this sample: sampled car, choices of experiments and model of LTV-MPC; controllers
        as tuned for the nominal car. `seed` is of the sensor noise in the setting "loop", and ignored in others. With
        None controllers get true signals, also in "loop"."""
        v = dict(self.values)
        if _PROFILE in v:
            v["profile"] = ("cone", "s1002")[int(v.pop(_PROFILE))]
        v["ltv"] = ("ltv_mpc_printed", "ltv_mpc")[int(v.pop(_LTV, 0))]
        if _RATIO in v:
            v["adhesion.poor.k_s"] = v.pop(_RATIO) * v.get("adhesion.poor.k_a", load_vehicle().adhesion["poor"].k_a)
        return setup(v, self.setting, seed=seed)


def draw(count: int, settings: Sequence[str] = COLUMNS) -> list[Sample]:
    """Draw `count` quasi-random samples of `prior` (scrambled Sobol sequence), the same for each of `settings`, by
    default all three: "paper" (exact measurements), "swarm" (NDI's poles by particle swarm) and "loop" (sensors)."""
    dimensions = prior()
    points = stats.qmc.Sobol(len(dimensions), seed=SEED).random(count)
    values = [tuple((d.name, d.value(float(u))) for d, u in zip(dimensions, point, strict=True)) for point in points]
    return [Sample(number, setting, value) for setting in settings for number, value in enumerate(values)]


def evaluate(sample: Sample) -> dict:
    """Adjust the tuning of the paper's three controllers to a sampled car, then simulate the runs that judge the
    statements (those of `probe.ONCE` only for samples with a number below `LONG[setting]`), with another seed of the
    sensor noise than for the tuning. Returns a dict. Keys: number and setting of the sample; profile of the wheels
    ("cone", "s1002"); ltv, which stands for LTV-MPC ("ltv_mpc_printed"; "ltv_mpc", with affine term); each name in
    `Sample.values`; "scenario/controller/metric", metrics (SI) of `probe.probe`."""
    world = sample.world(JUDGING)
    world = replace(world, parameters={name: _retuned(sample, name) for name in PAPER_TRIO})
    metrics = probe(world, (*PARTS, *ONCE) if sample.number < LONG[sample.setting] else PARTS)
    profile = world.plant.get("contact.profile", "")
    labels = dict(zip(LABELS, (sample.number, sample.setting, profile, world.ltv), strict=True))
    return labels | dict(sample.values) | {"/".join(key): value for key, value in metrics.items()}


def _retuned(sample: Sample, name: str) -> dict:
    """Choose tuning parameters of a controller that keep the margin of the tuning task on a sampled car. Poles by the
    rule come from `fastest_pole`. Otherwise the tuned set is scaled in three ways; the cheapest one that keeps the
    margin counts, or the one with the largest margin."""
    task, world = load_task(setting=setting_of(sample.setting)), sample.world(TUNING)
    if name in task.rule and sample.setting == PAPER:
        given = task.rule[name]
        return triple_pole(fastest_pole(name, task, given, (5, 80), world.car())) | given
    chosen = [run for key, run in task.runs.items() if key in ("T3", "sine", "poor")]
    base, costs = world.parameters[name], []
    scales, keys = ((0.1, 1, 10), ["r"]) if CONTROLLERS[name].preview else ((0.7, 1, 1.4), ["pole", "frequency"])
    for scale in scales:
        scaled = base | {key: base[key] * scale for key in keys}
        runs = [world.experiment(run.scenario, name, scaled).measured(driven)[0] for run in chosen]
        costs.append((sum(run_cost(run, task.cost) for run in runs), scale, scaled))
    least, tried = task.margin["least"], []
    for *_, scaled in sorted(costs, key=lambda one: one[:2]):
        reached = margin.smallest(name, scaled, task.margin["speeds_kmh"], least, task.sensed, world.car())
        tried.append((reached, scaled))
        if reached >= least:
            break
    return max(tried, key=lambda one: one[0])[1]


def holds(table: pd.DataFrame) -> pd.DataFrame:
    """Judge the paper's statements on each sampled car: one row per sample. `table` has the rows of `evaluate`. Columns
    number, setting, profile, ltv (labels of the sample, from `table`), and one per statement (its id, as "C04"): True
    if the sample reproduces it, False if not, NaN if metrics for it are missing."""
    known = {i: statement for i, statement in statements.load().items() if statement.kind == "statement"}
    nominal, rows = Nominal(), []
    for row in table.to_dict("records"):
        metrics = {tuple(key.split("/")): value for key, value in row.items() if key.count("/") == 2 and value == value}
        findings = statements.findings(statements.Evidence(metrics, nominal.evidence(row["setting"]).spread))
        truth = {i: rule.judge(findings[i]) == statements.REPRODUCED for i, rule in known.items() if i in findings}
        rows.append({name: row[name] for name in LABELS} | truth)
    return pd.DataFrame(rows)


def shares(table: pd.DataFrame | None) -> pd.DataFrame:
    """Compute the share of samples in which each statement holds (0 to 1): one row per statement and setting. `table`
    has the rows of `evaluate`; None gives no rows. Columns id (of the statement); setting ("paper": exact measurements,
    "swarm": NDI's poles by swarm, "loop": sensors); share; low and high, its 95 % interval (Clopper-Pearson); samples,
    number judged; cone and s1002, share among samples with this wheel profile."""
    columns = ["id", "setting", "share", "low", "high", "samples", "cone", "s1002"]
    if table is None:
        return pd.DataFrame(columns=columns)
    judged, rows = holds(table), []
    for identity in judged.columns.drop([*LABELS]):
        for setting, samples in judged.dropna(subset=[identity]).groupby("setting", sort=False):
            truth = samples[identity].astype(bool)
            interval = stats.binomtest(int(truth.sum()), len(truth)).proportion_ci(method="exact")
            by_profile = truth.groupby(samples["profile"]).mean().reindex(["cone", "s1002"])
            rows.append((identity, setting, truth.mean(), interval.low, interval.high, len(truth), *by_profile))
    return pd.DataFrame(rows, columns=columns)


def decided(table: pd.DataFrame) -> pd.DataFrame:
    """Return the table of `shares` with a column decided_by, the sampled parameters (of `prior`) that decide on a
    statement. It has up to three names, joined by commas, whose rank correlation with "holds" over the samples is
    significant (p < 0.001, Bonferroni). `table` has rows of `evaluate` in one setting, as "loop" (sensors)."""
    result, judged = shares(table), holds(table)
    factors, names = table[[dimension.name for dimension in prior()]], []
    for identity in result["id"]:
        truth = judged[identity].dropna().astype(float)
        names.append(", ".join(_deciding(factors.loc[truth.index], truth)))
    return result.assign(decided_by=names)


def _deciding(factors: pd.DataFrame, truth: pd.Series) -> list[str]:
    """Select up to three parameters by rank correlation with what earlier ones leave unexplained of a verdict."""
    columns, y = factors.rank(), truth.rank()
    columns, y = columns - columns.mean(), y - y.mean()
    names: list[str] = []
    while len(names) < 3 and float(y @ y) > 1e-9 * len(y):
        columns = columns.loc[:, (columns**2).sum() > 1e-9 * len(y)]
        r = (columns.T @ y) / np.sqrt((columns**2).sum() * float(y @ y))
        name = str(r.abs().idxmax())
        value, freedom = float(np.clip(r[name], -1, 1)), len(y) - 2 - len(names)
        t = abs(value) * np.sqrt(freedom / max(1 - value**2, 1e-12))
        if 2 * stats.t.sf(t, freedom) * len(r) > 1e-3:
            break
        names.append(name)
        chosen = columns[name] / np.sqrt((columns[name] ** 2).sum())
        columns, y = columns - np.outer(chosen, chosen @ columns), y - chosen * (chosen @ y)
    return names


POLES = (10, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80)  # triple poles of NDI (rad/s)
BY_POLE = ("C04", "C05", "C17", "C20", "C31")  # statements that they may decide


def over_poles() -> pd.DataFrame:
    """Judge five statements (`BY_POLE`) by triple pole of NDI (`POLES`) on the nominal car with exact measurements
    (setting "paper"). One row per pole and statement. Columns poles (rad/s, as text; "swarm" for the parameters found
    by the swarm), id (of the statement), value (in the unit of the statement), verdict, as "not reproduced"."""
    spread, known = Nominal().evidence(PAPER).spread, statements.load()
    worlds = {str(pole): setup({POLE: float(pole)}) for pole in POLES} | {SWARM: setup({}, SWARM)}

    def judged(poles: str) -> list[tuple]:
        evidence = statements.Evidence(probe(worlds[poles], ("curve", "sine", "brake")), spread)
        findings = {identity: statements.find(identity, evidence) for identity in BY_POLE}
        return [(poles, identity, one.value, known[identity].judge(one)) for identity, one in findings.items()]

    rows = [row for rows in ordered_map(judged, [*worlds], "poles of NDI") for row in rows]
    return pd.DataFrame(rows, columns=["poles", "id", "value", "verdict"])


def main() -> None:
    """Command `robustness`: judge the paper's statements, as that NMPC errs less than NDI, on cars whose unprinted
    parameters are sampled (`prior`). Writes to data/results: robustness_samples.csv, a row per sample with its metrics
    (`evaluate`); robustness_claims.csv, per statement the share of samples in which it holds (`decided`);
    pole_verdicts.csv, by pole of NDI whether statements are "reproduced", … on the nominal car (`over_poles`)."""
    write(paths.product("data/results/pole_verdicts.csv"), over_poles().to_csv(index=False, float_format="%.6g"))
    finished = []
    for setting in COLUMNS:
        drawn = draw(SAMPLES[setting], settings=(setting,))
        finished.append(pd.DataFrame(ordered_map(evaluate, drawn, f"robustness, {setting}")))
        table, claims = pd.concat(finished), pd.concat([decided(each) for each in finished])
        write(paths.product("data/results/robustness_samples.csv"), table.to_csv(index=False, float_format="%.6g"))
        write(paths.product("data/results/robustness_claims.csv"), claims.to_csv(index=False, float_format="%.4g"))
    print(claims.to_string(index=False))
