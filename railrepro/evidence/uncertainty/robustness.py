"""Heavy grids and samples behind the notebooks: stability over speed, friction and tuning; robustness of the verdicts.

`python -m railrepro robustness [stability] [robustness]` writes data/results/stability_map.csv,
robustness_samples.csv and robustness_claims.csv. Every finished run is in the store, so an interrupted study goes on
where it was. Serves the question what the paper's unpublished parameters decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
from scipy import stats

from railrepro import paths, schema
from railrepro.control.registry import CONTROLLERS, OURS, PAPER_TRIO, with_r_times
from railrepro.control.slip import SlipSettings
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.probe import PARTS, ProbeSetup, probe
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.executor import executor, ordered_map
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.runs.swarm import driven, run_cost
from railrepro.files import write
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import sample_ranges

SAMPLES, REPLICATES, SEED = 8, 4, 2026
"""Samples per scrambled sequence, sequences, seed of the first."""
TUNING, JUDGING = 1, 101
"""Seeds of the noise, in the setting `loop`."""
SCENARIOS = ("curve_entry_T3", "sine_tracking", "braking", "adhesion_loss")
"""What the studies drive, in variations."""


def rows(task: Callable, arguments: Sequence, title: str, quiet: bool = False) -> list[dict]:
    """Rows of a study, on the executor; runs of an interrupted one are in the store."""
    with executor() as pool:
        return ordered_map(pool, task, arguments, title, quiet, stored=True)


def _row(experiment: Experiment) -> dict:
    names = ("rmse_y", "largest_error", "effort_du", "largest_slip", "utilisation", "failed", "failed_at_m")
    row, _ = experiment()
    return {**experiment.label, **{name: _plain(row.get(name)) for name in names}}


def _plain(value):
    return None if value is None else bool(value) if isinstance(value, bool | np.bool_) else float(value)


def stability(
    speeds_kmh=(100, 200, 300, 400), sets=("dry", "wet", "poor", "very_poor"), factors=(0.1, 1, 10, 100),
    periods_ms=(5, 10, 20), poles=(10, 20, 30, 45, 70), quiet: bool = False,
) -> pd.DataFrame:  # fmt: skip
    """Whether the car stays on the rail: speed, adhesion set, R and sampling time of NMPC, pole of NDI, ours with the
    paper's adhesion law and with slip control; rolling and at the adhesion maximum.

    Returns
    -------
    DataFrame
        speed_kmh, adhesion, drive, controller, r_factor, period_ms, pole, rmse_y, …, failed, failed_at_m.
    """
    tuned = tuning.load("nmpc")["parameters"]
    experiments = []
    for speed, name, drive in product(speeds_kmh, sets, ("rolling", "at the maximum")):
        force = 0.0 if drive == "rolling" else 30.0
        scenario = load_scenario("adhesion_loss").but(
            speed_kmh=float(speed), good=name, poor=name, force_kN=((0.0, force),), end_m=4.5 * speed / 3.6
        )
        label = {"speed_kmh": speed, "adhesion": name, "drive": drive}
        for factor, period in product(factors, periods_ms):
            parameters = with_r_times(tuned, factor) | {"period_ms": period}
            own = label | {"controller": "nmpc", "r_factor": factor, "period_ms": period}
            experiments.append(Experiment(scenario, "nmpc", own, parameters, CONTROLLERS["nmpc"].quick))
        for pole in poles:
            parameters = {"pole": pole, "frequency": pole, "damping": 1.0}
            experiments.append(Experiment(scenario, "ndi", label | {"controller": "ndi", "pole": pole}, parameters))
        for slip in (None, SlipSettings()):
            own = label | {"controller": OURS if slip is None else f"{OURS}_slip"}
            experiments.append(Experiment(scenario, OURS, own, tuning.load(OURS)["parameters"], adhesion=slip))
    return pd.DataFrame(rows(_row, experiments, "stability", quiet))


@dataclass(frozen=True)
class Sample:
    """One draw of what the paper does not publish, in some setting.

    Attributes
    ----------
    number, replicate : int
        Place in the sequence, and which scrambling of it.
    setting, variant : str
        Settings of comparison; control model, "corrected" or "printed".
    vehicle : tuple
        (dotted key, value) pairs.
    profile, good : str
        Profile of the wheels, adhesion set of a good rail.
    amplitude_mm, period_start_m, period_end_m, clothoid_factor : float
        See `World`.
    """

    number: int
    replicate: int
    setting: str
    variant: str
    vehicle: tuple[tuple[str, float], ...]
    profile: str
    good: str
    amplitude_mm: float
    period_start_m: float
    period_end_m: float
    clothoid_factor: float


def draw(
    count: int = SAMPLES, replicates: int = REPLICATES, seed: int = SEED, settings: Sequence[str] = tuning.SETTINGS,
    variant: str = "corrected",
) -> list[Sample]:  # fmt: skip
    """Quasi-random samples over the ranges of vehicle.toml and the open choices of experiments.

    Each replicate is a Sobol sequence with a scrambling of its own: their spread tells how sure a share is.
    """
    ranges = {k: v for k, v in sample_ranges().items() if not k.startswith("adhesion.")}
    extra = ("profile", "good", "amplitude_mm", "period_start_m", "period_end_m", "clothoid_factor")
    samples = []
    for replicate in range(replicates):
        points = stats.qmc.Sobol(len(ranges) + len(extra), seed=seed + replicate).random(count)
        for number, point in enumerate(points):
            vehicle = tuple((k, lo + u * (hi - lo)) for u, (k, (lo, hi)) in zip(point, ranges.items(), strict=False))
            u = dict(zip(extra, point[len(ranges) :], strict=True))
            own = (
                "cone" if u["profile"] < 0.5 else "s1002",
                "dry" if u["good"] < 0.5 else "wet",
                1.0 + 4.0 * u["amplitude_mm"],
                100.0 + 100.0 * u["period_start_m"],
                30.0 + 50.0 * u["period_end_m"],
                0.6 + 0.9 * u["clothoid_factor"],
            )
            samples += [Sample(number, replicate, each, variant, vehicle, *own) for each in settings]
    return samples


def evaluate(sample: Sample) -> dict:
    """A small retuning of each controller on its setting, then the probe with other seeds of the noise; values in SI.

    Returns
    -------
    dict
        The sample's number, replicate, setting, variant and profile, and "scenario/controller/metric" -> value.
    """
    world = ProbeSetup(
        {}, dict(sample.vehicle), sample.profile, sample.good, sample.variant, sample.amplitude_mm,
        sample.period_start_m, sample.period_end_m, sample.clothoid_factor,
    )  # fmt: skip
    tuned = {name: _retuned(world, name, sample.setting) for name in PAPER_TRIO}
    judged = replace(world, parameters=tuned, sensors=_sensors(sample.setting, JUDGING))
    labels = {name: getattr(sample, name) for name in LABELS}
    values = probe(judged, PARTS, speeds=(80, 240, 400))
    return labels | {"/".join(key): _plain(value) for *key, value in values}


LABELS = ("number", "replicate", "setting", "variant", "profile")


def _sensors(setting: str, seed: int) -> dict:
    return {"seed": seed} if setting == tuning.LOOP else {}


def _retuned(world: ProbeSetup, name: str, setting: str) -> dict:
    """The best of three scales of a controller's tuned set, by the cost of tuning; designed sets stay as they are."""
    task, base = tuning.load_task(setting=setting), tuning.load(name, setting)["parameters"]
    if name in task.designed:
        return base
    runs = [run for run in task.runs if run.name in ("T3", "sine", "poor")]
    preview = CONTROLLERS[name].preview
    best, chosen = np.inf, base
    for scale in (0.1, 1.0, 10.0) if preview else (0.7, 1.0, 1.4):
        parameters = base | {key: base[key] * scale for key in (("r",) if preview else ("pole", "frequency"))}
        aware = replace(world, parameters={name: parameters}, sensors=_sensors(setting, TUNING))
        driven_runs = [aware.experiment(run.scenario, name).measured(driven)[0] for run in runs]
        cost = sum(run_cost(parts, task.cost) for parts in driven_runs)
        best, chosen = (cost, parameters) if cost < best else (best, chosen)
    return chosen


def evidence(row: dict) -> statements.Evidence:
    """What a row of robustness_samples.csv tells."""
    metrics = {}
    for name, value in row.items():
        key = tuple(name.split("/"))
        if len(key) == 3 and value is not None and not (isinstance(value, float) and np.isnan(value)):
            metrics[key] = float(value)
    return statements.Evidence(metrics)


def holds(table: pd.DataFrame) -> pd.DataFrame:
    """Whether each statement holds in each sample, by the rule of the report; a failed run is no missing one.

    Returns
    -------
    DataFrame
        Columns of `LABELS`, one column of True and False per statement that the samples can answer.
    """
    known = {i: statement for i, statement in statements.load().items() if statement.kind == "statement"}
    rows = []
    for row in table.to_dict("records"):
        found, seen = {}, evidence(row)
        for identity, statement in known.items():
            try:
                found[identity] = statement.judge(statements.find(identity, seen)) == statements.REPRODUCED
            except statements.MissingEvidence:
                continue
        rows.append({name: row[name] for name in LABELS} | found)
    return pd.DataFrame(rows)


def shares(table: pd.DataFrame | None) -> pd.DataFrame:
    """Share of the samples in which each statement holds, in each setting, with a 95 % interval from the replicates.

    Returns
    -------
    DataFrame
        id, setting, share, low, high, samples; cone, s1002, printed: shares by profile and with the printed model.
    """
    columns = ["id", "setting", "share", "low", "high", "samples", "cone", "s1002", "printed"]
    if table is None or not set(LABELS) <= set(table):
        return pd.DataFrame(columns=columns)
    judged = holds(table)
    rows = []
    for identity in [name for name in judged if name not in LABELS]:
        answered = judged.dropna(subset=[identity])
        for setting, own in answered.groupby("setting", sort=False):
            main, printed = (own[own["variant"] == v][identity].astype(float) for v in ("corrected", "printed"))
            if main.empty:
                continue
            chosen = own.loc[main.index]
            by = main.groupby(chosen["replicate"]).mean()
            profile = main.groupby(chosen["profile"]).mean()
            low, high = _interval(by.to_numpy())
            row = {
                "id": identity,
                "setting": setting,
                "share": by.mean(),
                "low": low,
                "high": high,
                "samples": len(main),
            }
            row |= {name: profile.get(name, np.nan) for name in ("cone", "s1002")}
            rows.append(row | {"printed": printed.mean() if len(printed) else np.nan})
    return pd.DataFrame(rows, columns=columns)


def _interval(replicates: np.ndarray) -> tuple[float, float]:
    """95 % interval of the mean of replicates (Student), within 0 and 1; nan for a single one."""
    if len(replicates) < 2:
        return float("nan"), float("nan")
    half = stats.t.ppf(0.975, len(replicates) - 1) * replicates.std(ddof=1) / np.sqrt(len(replicates))
    return max(replicates.mean() - half, 0.0), min(replicates.mean() + half, 1.0)


def verdicts(table: pd.DataFrame, samples: Sequence[Sample]) -> pd.DataFrame:
    """`shares`, and the parameters that decide each statement by rank correlation over the samples."""
    found, judged = shares(table), holds(table)
    own = [
        {k: v for k, v in vars(s).items() if k not in (*LABELS, "vehicle")} | {"profile": s.profile} for s in samples
    ]
    factors = pd.DataFrame([dict(s.vehicle) | o for s, o in zip(samples, own, strict=True)])
    factors = factors.apply(lambda column: pd.factorize(column, sort=True)[0] if column.dtype == object else column)
    deciding = []
    for row in found.itertuples():
        chosen = (
            judged[(judged["setting"] == row.setting) & (judged["variant"] == "corrected")][row.id]
            .dropna()
            .astype(float)
        )
        deciding.append(_deciding(factors.loc[chosen.index], chosen))
    return found.assign(decided_by=deciding)


def _deciding(factors: pd.DataFrame, held: pd.Series, most: int = 3, chance: float = 0.05) -> str:
    """Parameters by rank correlation with whether a statement holds, strongest first, each less what those before it
    explain; only where chance among all parameters gives as much in less than one of twenty studies."""
    columns, y = factors.rank(), held.rank()
    columns, y = columns - columns.mean(), y - y.mean()
    found: list[str] = []
    while len(found) < most and float(y @ y) > 1e-9 * len(y):
        columns = columns.loc[:, (columns**2).sum() > 1e-9 * len(y)]
        r = (columns.T @ y) / np.sqrt((columns**2).sum() * float(y @ y))
        name = str(r.abs().idxmax())
        value, freedom = float(np.clip(r[name], -1, 1)), len(y) - 2 - len(found)
        t = abs(value) * np.sqrt(freedom / max(1 - value**2, 1e-12))
        if 2 * stats.t.sf(t, freedom) * len(r) > chance:
            break
        found.append(f"{name} {value:+.2f}")
        chosen = columns[name] / np.sqrt((columns[name] ** 2).sum())
        columns, y = columns - np.outer(chosen, chosen @ columns), y - chosen * (chosen @ y)
    return ", ".join(found)


def robustness(
    count: int = SAMPLES, replicates: int = REPLICATES, quiet: bool = False
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Samples and shares of the robustness study; besides, one replicate with the printed model in setting `equal`."""
    for what, number in (("samples", count), ("replicates", replicates)):
        schema.require(what, number, schema.between(1, 4096), whole=True)
    samples = draw(count, replicates)
    samples += draw(count, 1, settings=(tuning.EQUAL,), variant="printed")
    table = pd.DataFrame(rows(evaluate, samples, "robustness", quiet))
    return table, verdicts(table, samples)


def main(studies: Sequence[str] = (), samples: int | None = None) -> None:
    """Run the named studies, or all, and write their tables; `samples` (default `SAMPLES`) of the robustness study."""
    unknown = set(studies) - {"stability", "robustness"}
    if unknown:
        raise InputError(f"study {min(unknown)!r} is not known; there are stability and robustness")
    if "stability" in studies or not studies:
        write(paths.product("data/results/stability_map.csv"), stability().to_csv(index=False, float_format="%.6g"))
    if "robustness" in studies or not studies:
        table, found = robustness(SAMPLES if samples is None else samples)
        write(paths.product("data/results/robustness_samples.csv"), table.to_csv(index=False, float_format="%.6g"))
        write(paths.product("data/results/robustness_claims.csv"), found.to_csv(index=False, float_format="%.4g"))
        print(found.to_string(index=False))
