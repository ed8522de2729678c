"""All cases of one controller on the executor."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import pandas as pd

from railrepro.data import InputError, between, require
from railrepro.evidence.runs.executor import executor, ordered_map, work
from railrepro.evidence.score import card, limit, suite
from railrepro.evidence.score.entry import Entry
from railrepro.evidence.score.trial import Trial, call
from railrepro.simulation.scenarios import load_scenario

FIRST_LOOK = 30.0
"""Distance that shows whether a controller works at all (m)."""


def check(entry: Entry) -> None:
    """Drive a controller through some metres in both settings, in this process.

    Raises
    ------
    InputError
        When it fails for another reason than derailment.
    """
    scenario = load_scenario("curve_entry_T3").but(end_m=FIRST_LOOK)
    for setting in suite.JUDGED_ON:
        sensors = {"seed": suite.draws().published} if setting == suite.LOOP else {}
        row = Trial(entry, suite.Case("check", setting, scenario, sensors=sensors))()
        if "way" not in row:
            raise InputError(row["failure"])


def score(
    entry: Entry, seeds: int | Sequence[int], names: tuple[str, ...] | None = None, quiet: bool = False
) -> pd.DataFrame:
    """Judged rows of the suite, for one or several draws.

    Parameters
    ----------
    entry : Entry
    seeds : int or sequence of int
        See `suite.cases`; a case that two draws have in common is driven once.
    names : tuple of str, optional
        Runs of a small suite, without margins; default all.
    quiet : bool
        No progress bar.

    Returns
    -------
    DataFrame
        See `card.judged`, with the column `seed`.
    """
    draws = (seeds,) if isinstance(seeds, int) else tuple(seeds)
    for seed in draws:
        require("seed", seed, between(0, 2**31), whole=True)
    wanted = [(seed, case) for seed in draws for case in suite.cases(seed, names)]
    if not wanted:
        raise InputError(f"score: there is no run of the names {names}")
    different: list[suite.Case] = []
    for _, case in wanted:
        if case not in different:
            different.append(case)
    trials = [Trial(entry, case) for case in different]
    with executor() as pool:
        ends = ordered_map(pool, limit.anchors, different, "limits", quiet)
        rows = ordered_map(pool, partial(work, call), trials, f"score {entry.name}", quiet)
    places = [different.index(case) for _, case in wanted]
    found = [rows[k] | ends[k] | {"seed": seed} for k, (seed, _) in zip(places, wanted, strict=True)]
    return card.judged(found)
