"""An exploration: cars, weights and experiments for which the paper's statements hold together.

The paper's results are observations of a car that is not published. History matching by waves: runs over a
space-filling design, an emulator per statement with its error, points ruled out where a statement is implausible, the
next runs in the region that remains; then an evolution strategy from the closest run. It is no proof of absence: the
calibrated car (data/paper_like.toml) was found by hand. `python -m railrepro matching [small]` writes
data/results/matching_*.csv with the closest run; every finished run is in the store, so an interrupted
matching goes on where it was.

Source: Craig, Goldstein, Seheult and Smith 1997; Vernon, Goldstein and Bower 2010 (implausibility, waves).
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from math import comb

import numpy as np
import pandas as pd
from scipy import special, stats

from railrepro import paths, schema
from railrepro.control.registry import PAPER_TRIO
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.probe import ProbeSetup, probe
from railrepro.evidence.claims.statements import Finding, MissingEvidence, Statement
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.pso import Dimension
from railrepro.evidence.uncertainty import cma, emulator
from railrepro.evidence.uncertainty.robustness import evidence, ties
from railrepro.evidence.uncertainty.robustness import rows as rows_of
from railrepro.files import write
from railrepro.vehicle.parameters import load_vehicle

TUNED_IN = ("paper", tuning.EQUAL)
"""Settings whose tuned sets are varied: which of them is one of the choices, as the paper does not say what its swarm
drove. Every point is driven as the paper compared, with exact states."""
SEARCHED = (
    Dimension("tuned in setting (paper, equal)", 0, 1, "integer"),
    Dimension("R of the MPC, over the tuned", 1e-2, 1e2, "log"),
    Dimension("R of LTV-MPC, over that of the MPC", 1.0, 30.0, "log"),
    Dimension("R of Fig. 8, over that of Fig. 6", 1.0, 300.0, "log"),
    Dimension("R of Fig. 9, over that of Fig. 6", 1.0, 300.0, "log"),
    Dimension("second R of Fig. 9, over the first", 2.0, 10.0, "log"),
    Dimension("triple pole of NDI (rad/s)", 10, 120, "log"),
    Dimension("delay of the drive (s)", 0.0, 5e-3),
    Dimension("amplitude of the sweep (mm)", 1.5, 4.5),
    Dimension("shortest wave of the sweep (m)", 30, 100),
    Dimension("shortest wave of the braking sweep (m)", 15, 80),
    Dimension("profile (cone, S1002)", 0, 1, "integer"),
    Dimension("adhesion.dry.k_s", 0.2, 1.0),
    Dimension("adhesion.poor.k_a", 0.1, 1.0),
    Dimension("adhesion.poor.k_s", 0.05, 1.0),
    Dimension("adhesion.poor.mu0", 0.1, 0.18),
    Dimension("drive.torque_limit", 3000.0, 5000.0),
)
"""What is matched: what turns a statement when it is put back on the calibrated car, and what the tuning drove."""
CHOICES = (
    *(d for d in SEARCHED if not d.name.startswith(("adhesion", "drive"))),
    Dimension("weight of psi, over the tuned", 1e-1, 1e1, "log"),
    Dimension("terminal weight, over the tuned", 1e-1, 1e1, "log"),
    Dimension("sampling of the MPC (ms)", 4, 40, "integer"),
    Dimension("horizon (s)", 0.1, 1.0, "log"),
    Dimension("damping of NDI", 0.5, 1.5),
    Dimension("longest wave of the sweep (m)", 100, 200),
    Dimension("clothoid over ours", 0.6, 1.5),
    Dimension("rail (dry, wet)", 0, 1, "integer"),
)
"""What `world` knows besides the keys of the vehicle; the latter ones turn hardly anything and stay nominal."""
SIZES = {"committed": (3, 48, 10), "small": (2, 16, 2)}
"""Waves, runs per wave, generations of the evolution strategy."""
PARTS = ("curve", "sine", "loss", "brake")
CUT = 3.0
"""Implausibility beyond which a point is ruled out (three standard deviations, Pukelsheim 1994)."""
DISCREPANCY = 0.1
"""What a limit may be off by, because the plant is not the paper's (logarithm, or units of the value)."""
STEPS = {"C17": 0.2, "C18": 0.1, "C20": 0.2, "C24": 0.1, "C46": 0.2}
"""Steps of margins that move in steps (shares of five speeds, of poles, of entries): they may be off by one more."""
CLIP = 2.0
"""Largest margin that is distinguished; a run that failed has this one, negative."""
CANDIDATES = 2**14
SHOWN = 500
"""Points of the region that are kept for figures, at most."""
LEAST = 1e-3
"""Least share of the prior that is to remain; else one more statement is allowed to be implausible."""


def margin(statement: Statement, finding: Finding) -> float:
    """How far a value is inside the limits of a statement: positive where it holds, at most `CLIP` in size.

    Logarithm of the ratio to a positive limit, difference to another.
    """
    found = []
    for limit, sign in ((statement.below, -1.0), (statement.above, 1.0)):
        if limit is None:
            continue
        if np.isnan(finding.value):
            return -CLIP
        ratio = limit > 0 and finding.value > 0
        inside = np.log(finding.value / limit) if ratio else finding.value - limit
        found.append(sign * inside)
    return float(np.clip(min(found), -CLIP, CLIP))


Values = tuple[tuple[str, float], ...]
"""Parameters of a run by name."""


@dataclass(frozen=True)
class Problem:
    """What is matched.

    Attributes
    ----------
    dimensions : tuple of Dimension
        The prior: uniform in each (in the logarithm, where its scale says so).
    run : callable
        List of `Values` -> margin by statement (`margin`) of each, in order. What a run cannot decide, though others
        can, counts as missed by far.
    """

    dimensions: tuple[Dimension, ...]
    run: Callable[[list[Values]], list[dict[str, float]]]

    def values(self, point: Sequence[float]) -> Values:
        """Parameters at a point of the unit cube."""
        return tuple((d.name, d.value(float(u))) for d, u in zip(self.dimensions, point, strict=True))

    def encoded(self, points: np.ndarray) -> np.ndarray:
        """Points as the emulator sees them: a choice of two is 0 or 1."""
        return np.where([choice(d) for d in self.dimensions], np.round(points), points)


def choice(dimension: Dimension) -> bool:
    """Whether a dimension is a choice of two."""
    return dimension.scale == "integer" and dimension.high - dimension.low == 1


def names_of_choice(name: str) -> list[str]:
    """Names of both values, which end the name of a choice: of "rail (dry, wet)" dry and wet; else 0 and 1."""
    found = name.rpartition("(")[2].rstrip(")").split(", ")
    return found if len(found) == 2 else ["0", "1"]


@dataclass(frozen=True)
class Matched:
    """What a matching found.

    Attributes
    ----------
    points : ndarray, shape (n, d)
        All that were run, in the unit cube, wave by wave.
    margins : DataFrame, shape (n, statements)
    waves : DataFrame
        One row per wave: points, surviving share, statements allowed to be implausible, error of the emulators, which
        statements are implausible in most of the remaining region.
    survivors : ndarray, shape (m, d)
        Points of the prior that are not ruled out.
    emulators : dict
        Statement -> Emulator.
    """

    points: np.ndarray
    margins: pd.DataFrame
    waves: pd.DataFrame
    survivors: np.ndarray
    emulators: dict[str, emulator.Emulator]


def implausibility(emulators: Mapping[str, emulator.Emulator], x: np.ndarray) -> np.ndarray:
    """How many standard deviations a point is outside each statement, shape (m, statements); 0 where it may hold."""
    found = []
    for name, emulate in emulators.items():
        mean, deviation = emulate(x)
        found.append(np.maximum(-mean, 0) / np.sqrt(deviation**2 + DISCREPANCY**2 + STEPS.get(name, 0.0) ** 2))
    return np.array(found).T


def survives(implausible: np.ndarray, allowed: int) -> np.ndarray:
    """Points with no more than `allowed` implausible statements."""
    return (implausible > CUT).sum(axis=1) <= allowed


def match(
    problem: Problem, waves: int, count: int, generations: int = 0, seed: int = 2027, candidates: int = CANDIDATES
) -> Matched:
    """Match by waves, then search from the closest run.

    Parameters
    ----------
    problem : Problem
    waves, count : int
        Number of waves, runs in each.
    generations, seed : int
        Of the evolution strategy, whose runs are a last row of `waves`; of the draws.
    candidates : int
        Points of the prior on which the region is measured.
    """
    size = len(problem.dimensions)
    prior = stats.qmc.Sobol(size, seed=seed).random(candidates)
    chosen = stats.qmc.Sobol(size, seed=seed + 1).random(count)
    generator = np.random.default_rng(seed)
    points, rows, table, allowed = np.empty((0, size)), [], [], 0
    emulators: dict[str, emulator.Emulator] = {}
    for wave in range(1, waves + 1):
        points = np.vstack([points, chosen])
        rows += problem.run([problem.values(point) for point in chosen])
        margins = pd.DataFrame(rows).fillna(-CLIP)
        unseen = _held_out(emulators, problem.encoded(chosen), margins.iloc[-len(chosen) :])
        x = problem.encoded(points)
        emulators = {name: emulator.fit(x, margins[name].to_numpy()) for name in margins}
        implausible = implausibility(emulators, problem.encoded(prior))
        while survives(implausible, allowed).mean() < LEAST and allowed < len(emulators):
            allowed += 1
        alive = survives(implausible, allowed)
        left, mostly = prior[alive], (implausible[alive] > CUT).mean(axis=0) > 0.5
        row = {"wave": wave, "stage": "wave", "surviving_share": len(left) / len(prior), "allowed": allowed}
        row |= {"emulator_error": float(np.median([e.error for e in emulators.values()])), "held_out": unseen}
        table.append(row | _counted(margins, len(chosen)) | {"given_up": " ".join(margins.columns[mostly])})
        chosen = _within(problem, emulators, allowed, left, count, generator)
    if generations:
        points, rows = _search(problem, points, rows, generations, seed)
        number, margins = len(points) - table[-1]["points"] * waves, pd.DataFrame(rows).fillna(-CLIP)
        table.append(table[-1] | {"wave": waves + 1, "stage": "search", **_counted(margins, number)})
    return Matched(points, margins, pd.DataFrame(table), left, emulators)


def _counted(margins: pd.DataFrame, number: int) -> dict:
    most = int((margins > 0).sum(axis=1).max())
    return {"points": number, "most_statements": most, "statements": margins.shape[1]}


def _held_out(emulators: Mapping[str, emulator.Emulator], x: np.ndarray, margins: pd.DataFrame) -> float:
    """Median over statements of the error of predicting runs that came after, over their spread; nan for none."""
    errors = []
    for name, emulate in emulators.items():
        seen = margins[name].to_numpy()
        if seen.std() > 0:
            errors.append(np.sqrt(np.mean((emulate(x)[0] - seen) ** 2)) / seen.std())
    return float(np.median(errors)) if errors else float("nan")


def _search(problem: Problem, points: np.ndarray, rows: list, generations: int, seed: int) -> tuple[np.ndarray, list]:
    """Points and rows with those of an evolution strategy from the closest run."""
    made: list = []

    def cost(asked: np.ndarray) -> np.ndarray:
        made.extend(problem.run([problem.values(point) for point in asked]))
        return missed(pd.DataFrame([*rows, *made]).fillna(-CLIP)).to_numpy()[-len(asked) :]

    start = points[missed(pd.DataFrame(rows).fillna(-CLIP)).to_numpy().argmin()]
    more, _ = cma.minimise(cost, start, generations, seed=seed)
    return np.vstack([points, more]), rows + made


def _within(problem, emulators, allowed: int, kept_points: np.ndarray, count: int, generator) -> np.ndarray:
    """Points for the next wave: survivors, moved a little so that few survivors give many points."""
    found = np.empty((0, kept_points.shape[1]))
    for _ in range(50):
        chosen = kept_points[generator.integers(len(kept_points), size=4 * count)]
        moved = chosen + generator.normal(0, 0.1, chosen.shape)
        moved = cma.reflected(moved)
        alive = survives(implausibility(emulators, problem.encoded(moved)), allowed)
        found = np.vstack([found, moved[alive]])
        if len(found) >= count:
            return found[:count]
    return np.vstack([found, kept_points[generator.integers(len(kept_points), size=count)]])[:count]


def region(problem: Problem, matched: Matched) -> pd.DataFrame:
    """Projection of the region on each dimension, and how informative its value would be.

    Columns: what, prior_low, prior_high, low, median, high (5, 50, 95 % of the survivors), second (share of them with
    the second of two choices), narrowing (share of the prior that is lost: 1 - exp(-information), which is 1 - width
    for a range), reduction (share of the variance of how many statements hold which goes when it is known).
    """
    x = problem.encoded(matched.survivors)
    expected = np.zeros(len(x))
    for emulate in matched.emulators.values():
        mean, deviation = emulate(x)
        expected += stats.norm.cdf(mean / deviation)
    rows = []
    for i, dimension in enumerate(problem.dimensions):
        column, of_two = matched.survivors[:, i], choice(dimension)
        low, middle, high = np.quantile(column, (0.05, 0.5, 0.95))
        rows.append(
            {
                "what": dimension.name,
                "prior_low": dimension.low,
                "prior_high": dimension.high,
                **{k: dimension.value(float(u)) for k, u in (("low", low), ("median", middle), ("high", high))},
                "second": float(x[:, i].mean()) if of_two else np.nan,
                "narrowing": _narrowing(column, 2 if of_two else 10),
                "reduction": _explained(column, expected),
            }
        )
    return pd.DataFrame(rows).sort_values("reduction", ascending=False, kind="stable", ignore_index=True)


def _narrowing(x: np.ndarray, bins: int) -> float:
    """Share of a uniform prior that is lost: 1 - exp(-information gained), less what chance gives."""
    share = np.histogram(x, bins, (0, 1))[0] / len(x)
    information = float(special.entr(share).sum() * -1 + np.log(bins)) - (bins - 1) / (2 * len(x))
    return float(1 - np.exp(-max(information, 0.0)))


def _explained(x: np.ndarray, y: np.ndarray, bins: int = 10) -> float:
    """Share of the variance of y that the mean over bins of x explains, less what chance does."""
    total = y.var()
    if total <= 0 or len(y) < 5 * bins:
        return 0.0
    place = np.minimum((x * bins).astype(int), bins - 1)
    groups = pd.Series(y).groupby(place)
    between = float((groups.size() * (groups.mean() - y.mean()) ** 2).sum()) / len(y)
    return max(0.0, between / total - (groups.ngroups - 1) / len(y))


def conflicts(held: pd.DataFrame, largest: int = 3, chance: float = 0.05) -> pd.DataFrame:
    """Smallest sets of statements that no run has together, though some would if statements were independent.

    Parameters
    ----------
    held : DataFrame of bool, shape (runs, statements)
    largest : int
        Size of a set, at most.
    chance : float
        Most probable number of sets of a size that are found although independence explains them.

    Returns
    -------
    DataFrame
        statements, size, expected (runs that would have the set by chance), probes (runs that have all but one of it).
    """
    share, rows, known = held.mean(), [], []
    for size in range(1, min(largest, held.shape[1]) + 1):
        least = np.log(comb(held.shape[1], size) / chance)
        for chosen in itertools.combinations(held.columns, size):
            if any(set(old) <= set(chosen) for old in known) or held[list(chosen)].all(axis=1).any():
                continue
            expected = len(held) * float(np.prod(share[list(chosen)])) if size > 1 else float(len(held))
            if expected < least:
                continue
            known.append(chosen)
            nearly = int((held[list(chosen)].sum(axis=1) == size - 1).sum())
            rows.append({"statements": " ".join(chosen), "size": size, "expected": expected, "probes": nearly})
    return pd.DataFrame(rows, columns=["statements", "size", "expected", "probes"])


def dimensions() -> tuple[Dimension, ...]:
    """What is matched, see `SEARCHED`."""
    return SEARCHED


def world(values: Mapping[str, float]) -> ProbeSetup:
    """The car, controllers and experiments of a point; what is not named stays nominal."""
    known = {d.name for d in CHOICES}
    v = {key: value for key, value in dict(values).items() if key in known}
    vehicle = {key: value for key, value in dict(values).items() if key not in known}
    tuned_on = TUNED_IN[round(v.get("tuned in setting (paper, equal)", 0))]
    parameters = {name: dict(tuning.load(name, tuned_on)["parameters"]) for name in PAPER_TRIO}
    factors = {"r": "R of the MPC, over the tuned", "q_psi_TrAx": "weight of psi, over the tuned"}
    factors |= {"q_terminal": "terminal weight, over the tuned"}
    for name in PAPER_TRIO[:2]:
        for key, factor in factors.items():
            parameters[name][key] *= v.get(factor, 1.0)
        given = {"period_ms": v.get("sampling of the MPC (ms)"), "horizon_s": v.get("horizon (s)")}
        parameters[name] |= {key: value for key, value in given.items() if value is not None}
    parameters[PAPER_TRIO[1]]["r"] *= v.get("R of LTV-MPC, over that of the MPC", 1.0)
    pole = v.get("triple pole of NDI (rad/s)")
    own = {"pole": pole, "frequency": pole, "damping": v.get("damping of NDI")}
    parameters["ndi"] |= {key: value for key, value in own.items() if value is not None}
    delay = v.get("delay of the drive (s)", 0.0)
    if delay:
        # of the motor alone, a lag: with sensors an estimator would come along, and no delay would not be its limit
        vehicle["drive.lag"] = vehicle.get("drive.lag", load_vehicle().drive.lag) + delay
    profile, rail = v.get("profile (cone, S1002)"), v.get("rail (dry, wet)")
    fields = {name: v[key] for name, key in _FIELDS.items() if key in v}
    fields |= {} if profile is None else {"profile": ("cone", "s1002")[round(profile)]}
    fields |= {} if rail is None else {"good": ("dry", "wet")[round(rail)]}
    sweep = v.get("shortest wave of the braking sweep (m)")
    return ProbeSetup(parameters, vehicle, brake_sweep={} if sweep is None else {"period_end_m": sweep}, **fields)


_FIELDS = {
    "amplitude_mm": "amplitude of the sweep (mm)",
    "period_start_m": "longest wave of the sweep (m)",
    "period_end_m": "shortest wave of the sweep (m)",
    "clothoid_factor": "clothoid over ours",
    "r_loss": "R of Fig. 8, over that of Fig. 6",
    "r_brake": "R of Fig. 9, over that of Fig. 6",
    "r_second": "second R of Fig. 9, over the first",
}


@dataclass(frozen=True)
class ProbeTask:
    """Runs of the car at some values (see `probe`), as "scenario/controller/metric" -> value; picklable."""

    parts: tuple[str, ...] = PARTS

    def __call__(self, values: Values) -> dict[str, float]:
        return {"/".join(key): float(value) for *key, value in probe(world(dict(values)), self.parts)}


def margins(row: dict, judged: Mapping[str, Statement]) -> dict[str, float]:
    """Margins of the statements that a row of metrics can answer; ties are those of the nominal case."""
    seen, found = evidence(row, ties(["paper"])["paper"]), {}
    for identity, rule in judged.items():
        try:
            found[identity] = margin(rule, statements.find(identity, seen))
        except MissingEvidence:
            continue
    return found


def rules() -> dict[str, Statement]:
    """The statements of the paper with their limits."""
    return {i: statement for i, statement in statements.load().items() if statement.kind == "statement"}


@schema.table
class Closest:
    """The closest run: values by dimension, statements that hold there."""

    values: dict[str, schema.Plain]
    holds: tuple[str, ...]
    fails: tuple[str, ...]


def closest() -> ProbeSetup:
    """Car, controllers and experiments that come closest to the paper's statements, see `best`."""
    file = paths.source("data/results/matching_closest.json")
    if not file.exists():
        raise InputError(f"{file.name}: is missing; `python -m railrepro matching` makes it")
    return world(schema.build(Closest, schema.read(file), file.name).values)


def missed(margins: pd.DataFrame) -> pd.Series:
    """Sum of the squares of the margins that each run misses: how close it comes to all statements."""
    return (margins.clip(upper=0) ** 2).sum(axis=1).rename("missed")


def best(problem: Problem, matched: Matched) -> dict:
    """The closest run: least sum of the squares of the margins that are missed.

    How many statements hold is no measure: where all controllers are worse than none, one that is worst of all fulfils
    every order.
    """
    row = int(missed(matched.margins).to_numpy().argmin())
    told_apart = matched.margins.iloc[row] > 0
    names = list(matched.margins.columns)
    return asdict(
        Closest(
            dict(problem.values(matched.points[row])),
            tuple(name for name in names if told_apart[name]),
            tuple(name for name in names if not told_apart[name]),
        )
    )


def switched(run: Callable[[list[Values]], list[dict[str, float]]]) -> pd.DataFrame:
    """The nominal car with choices of two thrown by hand: a look at what the emulators say that needs none of them.

    One column per choice, missed (sum of the squares of the missed margins), and the margins.
    """
    choices = [d for d in SEARCHED if choice(d)]
    places = [
        {d.name: value for d, value in zip(choices, values, strict=True)}
        for values in itertools.product((0, 1), repeat=len(choices))
    ]
    found = pd.DataFrame(run([tuple(place.items()) for place in places])).fillna(-CLIP)
    return pd.concat([pd.DataFrame(places), missed(found), found], axis=1)


def tables(problem: Problem, matched: Matched) -> dict[str, pd.DataFrame]:
    """Tables by name: waves, region, conflicts, best (margins of all runs with their points), survivors."""
    values, left = (
        pd.DataFrame([dict(problem.values(point)) for point in points])
        for points in (matched.points, np.random.default_rng(0).permutation(matched.survivors)[:SHOWN])
    )
    return {
        "waves": matched.waves,
        "region": region(problem, matched),
        "conflicts": conflicts(matched.margins > 0),
        "best": pd.concat([matched.margins, values], axis=1),
        "survivors": left,
    }


def main(size: str = "committed") -> None:
    """Match at a size and write the tables and the closest run."""
    if size not in SIZES:
        raise InputError(f"matching takes one of the sizes {sorted(SIZES)}, found {size!r}")
    waves, count, generations = SIZES[size]
    judged = rules()

    def run(points: list[Values]) -> list[dict[str, float]]:
        rows = rows_of(ProbeTask(), points, "matching")
        return [margins(row, judged) for row in rows]

    problem = Problem(dimensions(), run)
    matched = match(problem, waves, count, generations)
    for name, table in (tables(problem, matched) | {"switched": switched(run)}).items():
        write(paths.product(f"data/results/matching_{name}.csv"), table.to_csv(index=False, float_format="%.4g"))
    write(paths.product("data/results/matching_closest.json"), json.dumps(best(problem, matched), indent=2) + "\n")
    print(matched.waves.to_string(index=False))
