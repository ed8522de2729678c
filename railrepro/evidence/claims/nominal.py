"""Evidence on the nominal case: the stored probes of each column of verdicts (nominal_metrics.csv), as
`statements.Evidence`."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.evidence.claims.setup import COLUMNS, setting_of
from railrepro.evidence.claims.statements import Evidence

Key = tuple[str, str, str]
METRICS = "nominal_metrics"
"""Name of the table of data/results with the metrics for all settings."""


def result(name: str) -> pd.DataFrame | None:
    """Read a table of data/results by its name without ending, as "nominal_metrics"; None if there is no such file."""
    file = paths.source(f"data/results/{name}.csv")
    return pd.read_csv(file) if file.exists() else None


class Nominal:
    """Stored metrics of the nominal car, per column of verdicts (`setup.COLUMNS`).

    `results` reads a table of data/results: its name without ending -> DataFrame, or None if there is no such file.
    """

    def __init__(self, results: Callable[[str], pd.DataFrame | None] = result):
        self.results = cache(results)
        self._evidence: dict[str, Evidence] = {}
        found = self.results(METRICS)
        self._rows = {} if found is None else dict(list(found.groupby("setting")))

    def settings(self) -> list[str]:
        """Columns of verdicts for which there are metrics, in the order of `COLUMNS`."""
        return [column for column in COLUMNS if column in self._rows]

    def evidence(self, setting: str) -> Evidence:
        """Metrics and tables of a column of verdicts; for "" the tables that depend on no setting, no metrics."""
        if setting not in self._evidence:
            rows = self._rows.get(setting)
            known = ({}, {}) if rows is None else (tuned_metrics(rows), seeds_spread(rows))
            self._evidence[setting] = Evidence(*known, self.results, setting_of(setting))
        return self._evidence[setting]

    def on_calibrated_car(self) -> dict[str, str]:
        """Statement id -> "yes" if the statement holds on the calibrated car, else "no"; {} without paper_like.csv."""
        found = self.results("paper_like")
        return {} if found is None else {row.statement: "yes" if row.holds else "no" for row in found.itertuples()}


def tuned_metrics(rows: pd.DataFrame) -> dict[Key, float]:
    """Metrics with tuned sets, mean over the seeds of the noise: (scenario, controller, metric) -> value (SI).

    `rows` are of one setting, columns scenario, controller, metric, value (SI), swarm (rank of the swarm by cost);
    only rows with swarm 0, the tuned set, count. The metric `failed` is 1 if a run with any seed failed.
    """
    values = rows[rows["swarm"] == 0].groupby(["scenario", "controller", "metric"], sort=False)["value"]
    return values.mean().to_dict() | {key: value for key, value in values.max().items() if key[2] == "failed"}


def seeds_spread(rows: pd.DataFrame) -> dict[Key, float]:
    """Scatter between the seeds of swarms and noise: (scenario, controller, metric) -> ln(largest / smallest |value|).

    `rows` are of one setting, columns scenario, controller, metric, value (SI), a row per seed. Only rmse_y and
    stopping_distance count. Where a run failed the scatter of rmse_y is inf; where a value is 0 or not finite it is 0.
    """
    found: dict[Key, float] = {}
    lost = {(r.scenario, r.controller) for r in rows.itertuples() if r.metric == "failed" and r.value > 0}
    sized = rows[rows["metric"].isin(["rmse_y", "stopping_distance"])]
    for (scenario, name, metric), values in sized.groupby(["scenario", "controller", "metric"])["value"]:
        low, high = values.abs().min(), values.abs().max()
        known = low > 0 and np.isfinite(high)
        found[scenario, name, metric] = float(np.log(high / low)) if known else 0.0
    return found | {(s, c, "rmse_y"): float("inf") for s, c in lost}
