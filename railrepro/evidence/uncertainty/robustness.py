"""Robustness of the verdicts: all statements on cars that are drawn from what the paper leaves open.

Every finished run is in the store, so an interrupted study goes on where it was.
"""

from __future__ import annotations

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

SAMPLES = {PAPER: 48, SWARM: 48, LOOP: 24}
"""Samples per column of verdicts, the first ones of one sequence; more of them resume the study."""
LONG, SEED = {PAPER: 20, SWARM: 20, LOOP: 12}, 2026
"""Number of samples that also have the long runs of `probe.ONCE`; seed of the sequence."""
TUNING, JUDGING = 1, 101
"""Seeds of the noise, in the setting `loop`."""
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
"""What the paper leaves open besides the vehicle: fields of `ProbeSetup`, choices of two, creep slopes of poor rail."""
_PROFILE, _LTV, _RATIO = OPEN[0].name, OPEN[1].name, OPEN[-1].name
_POLE_BOUNDS = 5, 80
"""Triple poles between which the rule is applied on sampled cars (rad/s)."""
LABELS = ("number", "setting", "profile", "ltv")


def prior() -> tuple[Dimension, ...]:
    """Sampled parameters with bounds: ranges of data/vehicle.toml, without wet and very poor rail, then `OPEN`."""
    known = {dimension.name for dimension in OPEN}
    unused = ("adhesion.wet.", "adhesion.very_poor.")
    ranges = {k: v for k, v in sample_ranges().items() if not k.startswith(unused) and k not in known}
    return (*(Dimension(key, *map(float, pair)) for key, pair in ranges.items()), *OPEN)


@dataclass(frozen=True)
class Sample:
    """One sampled combination of the parameters that the paper does not publish.

    Attributes:
        number (int): Index in the Sobol sequence of `draw`.
        setting (str): Column of verdicts, one of `COLUMNS`.
        values (tuple): Pairs of dimension name (see `prior`) and value in its unit; dimensions not named stay nominal.
    """

    number: int
    setting: str
    values: tuple[tuple[str, float], ...]

    def world(self, seed: int | None = None) -> ProbeSetup:
        """Car, controllers and experiments of the sample as a `ProbeSetup`; `seed` is the seed of the sensor noise."""
        v = dict(self.values)
        if _PROFILE in v:
            v["profile"] = ("cone", "s1002")[int(v.pop(_PROFILE))]
        v["ltv"] = ("ltv_mpc_printed", "ltv_mpc")[int(v.pop(_LTV, 0))]
        if _RATIO in v:
            v["adhesion.poor.k_s"] = v.pop(_RATIO) * v.get("adhesion.poor.k_a", load_vehicle().adhesion["poor"].k_a)
        return setup(v, self.setting, seed=seed)


def draw(count: int, settings: Sequence[str] = COLUMNS) -> list[Sample]:
    """Draw `count` quasi-random samples of `prior` (scrambled Sobol sequence) for each column of verdicts.

    All columns have the same values."""
    dimensions = prior()
    points = stats.qmc.Sobol(len(dimensions), seed=SEED).random(count)
    values = [tuple((d.name, d.value(float(u))) for d, u in zip(dimensions, point, strict=True)) for point in points]
    return [Sample(number, setting, value) for setting in settings for number, value in enumerate(values)]


def evaluate(sample: Sample) -> dict:
    """Retune the paper's three controllers slightly on a sampled car, then simulate `probe.probe` with another seed.

    Returns a dict. Keys: number and setting of the sample; profile ("cone", "s1002"); ltv (variant of LTV-MPC); each
    name in `Sample.values`, with its value; "scenario/controller/metric", with metrics (SI) of `probe.probe`.
    """
    world = sample.world(JUDGING)
    tuned = {name: _retuned(sample, name) for name in PAPER_TRIO}
    labels = {"number": sample.number, "setting": sample.setting}
    labels |= {"profile": world.profile, "ltv": world.ltv}
    rows = probe(replace(world, parameters=tuned), (*PARTS, *ONCE) if sample.number < LONG[sample.setting] else PARTS)
    return labels | dict(sample.values) | {"/".join(key): value for *key, value in rows}


def _retuned(sample: Sample, name: str) -> dict:
    """Tuning parameters of a controller on a sampled car, which keep the margin of the tuning task there.

    By the swarm: the best of three scales of its tuned set, by the cost of tuning; without the margin the one that
    misses it least. By the rule of poles: `fastest_pole` on this car.
    """
    task, world = load_task(setting=setting_of(sample.setting)), sample.world(TUNING)
    speeds, least, around = task.margin["speeds_kmh"], task.margin["least"], (task.sensed, world.car())
    if name in task.rule and sample.setting == PAPER:
        given = task.rule[name]
        return triple_pole(fastest_pole(name, task, given, _POLE_BOUNDS, world.car())) | given
    runs = [run for run_name, run in task.runs.items() if run_name in ("T3", "sine", "poor")]
    base, preview, costs = world.parameters[name], CONTROLLERS[name].preview, []
    for scale in (0.1, 1.0, 10.0) if preview else (0.7, 1.0, 1.4):
        scaled = base | {key: base[key] * scale for key in (("r",) if preview else ("pole", "frequency"))}
        driven_runs = [world.experiment(run.scenario, name, scaled).measured(driven)[0] for run in runs]
        costs.append((sum(run_cost(parts, task.cost) for parts in driven_runs), scale, scaled))
    found = []
    for _, _, scaled in sorted(costs, key=lambda one: one[:2]):
        found.append((margin.smallest(name, scaled, speeds, least, *around), scaled))
        if found[-1][0] >= least:
            break
    return max(found, key=lambda one: one[0])[1]


def holds(table: pd.DataFrame) -> pd.DataFrame:
    """Judge the paper's statements on each sample: one row per sample.

    `table` has the rows of `evaluate`. Columns number, setting, profile, ltv, and one per statement (its id, as "C04"):
    True where the sample reproduces it, False where not, NaN where metrics for it are missing.
    """
    known = {i: statement for i, statement in statements.load().items() if statement.kind == "statement"}
    nominal, rows = Nominal(), []
    for row in table.to_dict("records"):
        metrics = {tuple(key.split("/")): value for key, value in row.items() if key.count("/") == 2 and value == value}
        found = statements.findings(statements.Evidence(metrics, nominal.evidence(row["setting"]).spread))
        held = {name: one.judge(found[name]) == statements.REPRODUCED for name, one in known.items() if name in found}
        rows.append({name: row[name] for name in LABELS} | held)
    return pd.DataFrame(rows)


def shares(table: pd.DataFrame | None) -> pd.DataFrame:
    """Share of samples in which each statement holds (0 to 1): one row per statement and setting.

    `table` has the rows of `evaluate`; None gives no rows. Columns id (of the statement); setting; share; low and high,
    its 95 % interval (Clopper-Pearson); samples, number judged; cone and s1002, share among samples with this profile.
    """
    columns = ["id", "setting", "share", "low", "high", "samples", "cone", "s1002"]
    if table is None:
        return pd.DataFrame(columns=columns)
    judged, rows = holds(table), []
    for identity in [name for name in judged if name not in LABELS]:
        answered = judged.dropna(subset=[identity])
        for setting, own in answered.groupby("setting", sort=False):
            held = own[identity].astype(bool)
            interval = stats.binomtest(int(held.sum()), len(held)).proportion_ci(method="exact")
            profile = held.groupby(own["profile"]).mean()
            by_profile = [profile.get(name, np.nan) for name in columns[-2:]]
            rows.append((identity, setting, held.mean(), interval.low, interval.high, len(held), *by_profile))
    return pd.DataFrame(rows, columns=columns)


def decided(table: pd.DataFrame) -> pd.DataFrame:
    """Table of `shares` with a column decided_by: names of the parameters (of `prior`) on which a statement depends.

    decided_by has up to three names, joined by commas: parameters whose rank correlation with the truth of the
    statement is significant (p < 0.001, Bonferroni). `table` has rows of `evaluate` in one setting.
    """
    found, judged = shares(table), holds(table)
    factors, deciding = table[[dimension.name for dimension in prior()]], []
    for identity in found["id"]:
        held = judged[identity].dropna().astype(float)
        deciding.append(", ".join(_deciding(factors.loc[held.index], held)))
    return found.assign(decided_by=deciding)


def _deciding(factors: pd.DataFrame, held: pd.Series, most: int = 3, chance: float = 1e-3) -> list[str]:
    """At most three parameters by rank correlation with a verdict, strongest first, less what earlier ones explain."""
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
        found.append(name)
        chosen = columns[name] / np.sqrt((columns[name] ** 2).sum())
        columns, y = columns - np.outer(chosen, chosen @ columns), y - chosen * (chosen @ y)
    return found


POLES = (10, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80)
"""Triple poles of NDI on `paper` (rad/s)."""
BY_POLE = ("C04", "C05", "C17", "C20", "C31")
"""Statements that the poles of NDI may decide."""


def over_poles() -> pd.DataFrame:
    """Verdicts on the statements `BY_POLE` by triple pole of NDI (`POLES`) on the nominal car in the setting `paper`.

    One row per pole and statement. Columns poles (rad/s, as text; "swarm" for the parameters found by the swarm), id
    (of the statement), value (in the unit of the statement), verdict (text of `Statement.judge`).
    """
    spread, known = Nominal().evidence(PAPER).spread, statements.load()
    worlds = {str(pole): setup({POLE: float(pole)}) for pole in POLES}
    worlds[SWARM] = setup({}, SWARM)

    def judged(poles: str) -> list[tuple]:
        seen = probe(worlds[poles], ("curve", "sine", "brake"))
        evidence = statements.Evidence({tuple(key): value for *key, value in seen}, spread)
        found = [(identity, statements.find(identity, evidence)) for identity in BY_POLE]
        return [(poles, identity, one.value, known[identity].judge(one)) for identity, one in found]

    rows = ordered_map(judged, [*worlds], "poles of NDI")
    return pd.DataFrame([row for own in rows for row in own], columns=["poles", "id", "value", "verdict"])


def main() -> None:
    """Write pole_verdicts (`over_poles`), robustness_samples (`evaluate`), robustness_claims (`decided`) as csv."""
    write(paths.product("data/results/pole_verdicts.csv"), over_poles().to_csv(index=False, float_format="%.6g"))
    finished = []
    for setting in COLUMNS:
        drawn = draw(SAMPLES[setting], settings=(setting,))
        finished.append(pd.DataFrame(ordered_map(evaluate, drawn, f"robustness, {setting}")))
        table, found = pd.concat(finished), pd.concat([decided(each) for each in finished])
        write(paths.product("data/results/robustness_samples.csv"), table.to_csv(index=False, float_format="%.6g"))
        write(paths.product("data/results/robustness_claims.csv"), found.to_csv(index=False, float_format="%.4g"))
    print(found.to_string(index=False))
