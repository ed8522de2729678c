"""All cases of one controller on the executor."""

from __future__ import annotations

import pandas as pd

from railrepro.errors import InputError
from railrepro.evidence.runs.executor import executor, ordered_map
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import Entry
from railrepro.evidence.score.trial import Trial, call
from railrepro.schema import between, require
from railrepro.simulation.scenarios import load_scenario

FIRST_LOOK = 30.0
"""Way that tells whether a controller works at all (m)."""


def score(
    entry: Entry, seed: int = suite.SEED, names: tuple[str, ...] | None = None, quiet: bool = False
) -> pd.DataFrame:
    """Judged rows of the suite.

    Parameters
    ----------
    entry : Entry
    seed : int
        See `suite.cases`.
    names : tuple of str, optional
        Runs of a small suite, without margins; default all.
    quiet : bool
        No progress bar.

    Returns
    -------
    DataFrame
        See `card.judged`. When a first look at the controller fails for another reason than leaving the rail, that is
        the failure of all cases, none of which is driven.
    """
    require("seed", seed, between(0, 2**31), whole=True)
    cases = suite.cases(seed, names)
    if not cases:
        raise InputError(f"score: there is no run of the names {names}")
    look = suite.Case("first_look", suite.EQUAL, load_scenario("curve_entry_T3").but(end_m=FIRST_LOOK))
    trials = [Trial(entry, case, seed) for case in (*cases, *(suite.JUDGED_ON if names is None else ()))]
    with executor() as pool:
        (first,) = ordered_map(pool, call, [Trial(entry, look, seed)], "first look", quiet)
        if "way" in first:
            rows = ordered_map(pool, call, trials, f"score {entry.name}", quiet)
        else:
            rows = [trial.head() | {"failure": first["failure"]} for trial in trials]
    return card.judged(rows)
