"""A controller of one's own in a chapter: its class is tuned by a swarm and scored, without a file.

Other processes cannot read a class of a notebook, so its runs are made in this one. A file with the same class is
scored by `python -m railrepro score`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import pandas as pd

from railrepro.evidence.runs import pso, swarm, tuning
from railrepro.evidence.score import card, run, suite
from railrepro.evidence.score.entry import Entry, entry, register

Gains = Mapping[str, float]


def cost(own: type, setting: str, runs: Sequence[str]) -> Callable[..., float]:
    """The cost that all controllers of the project are tuned with, of a class with `plan`.

    Parameters
    ----------
    own : type
        Made as (vehicle, route, gear) with its gains by name.
    setting : str
        Of comparison; in `loop` with sensors.
    runs : sequence of str
        Names of data/tuning.toml; unknown ones are left out.

    Returns
    -------
    callable
        (gains, limit) -> cost, see `swarm.Evaluation`.
    """
    name = register(f"own {own.__name__}", partial(_guidance, own))
    task = tuning.load_task(setting=setting)
    evaluation = swarm.Evaluation(name, replace(task, runs=tuple(each for each in task.runs if each.name in runs)))
    return lambda gains, limit=float("inf"): evaluation(dict(gains), limit)[0]


def _guidance(own: type, settings: Gains) -> partial:
    """Bound to its class, which shows that no run of it may be stored."""
    return partial(own, **settings)


def tune(
    own: type, setting: str, runs: Sequence[str], start: Gains, decades: float, particles: int, iterations: int
) -> pso.Outcome:
    """Gains that a swarm finds in logarithms around a start, at which its first particle begins; see `cost`.

    Parameters
    ----------
    own, setting, runs
        See `cost`.
    start : mapping
        Gains by name, above 0.
    decades : float
        How far a gain may go to either side.
    particles, iterations : int
    """
    evaluate, reach = cost(own, setting, runs), 10.0**decades
    bounds = [pso.Dimension(name, value / reach, value * reach, "log") for name, value in start.items()]

    def costs(sets: list[dict], limits: list[float]) -> list[float]:
        return [evaluate(gains, limit) for gains, limit in zip(sets, limits, strict=True)]

    return pso.minimise(costs, bounds, particles, iterations, seed=1, start=dict(start))


def points(controllers: Mapping[str, type | str], names: Sequence[str], seed: int | None = None) -> pd.DataFrame:
    """Points of 100 per setting and run of the benchmark, a column per controller.

    Parameters
    ----------
    controllers : mapping
        Heading -> class whose `tuned` has gains per setting, or key of `registry.CONTROLLERS`.
    names : sequence of str
        Runs of the suite.
    seed : int, optional
        Of the draw; default the published one.
    """
    seed = suite.draws().published if seed is None else seed
    found = {}
    for heading, one in controllers.items():
        if isinstance(one, str):
            rows = run.score(entry(one), seed, tuple(names), quiet=True)
        else:
            cases = suite.cases(seed, tuple(names))
            of = Entry(heading)
            rows = card.judged([run.drive(of, case, one) | run.anchors(case) for case in cases])
        found[heading] = rows.set_index(["setting", "scenario"])["points"]
    return pd.DataFrame(found)
