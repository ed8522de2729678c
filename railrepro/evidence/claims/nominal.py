"""Evidence on the nominal car: the stored metrics of its runs (nominal_metrics.csv) as `statements.Evidence`."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.evidence.claims.setup import COLUMNS, setting_of
from railrepro.evidence.claims.statements import Evidence, Key

METRICS = "nominal_metrics"  # table of data/results with the metrics of all settings


def result(name: str) -> pd.DataFrame | None:
    """Read a table of data/results by its name without ending, as "nominal_metrics"; None if there is no such file."""
    file = paths.source(f"data/results/{name}.csv")
    return pd.read_csv(file) if file.exists() else None


class Nominal:
    """Stored metrics of the nominal car. Settings say how its controllers were tuned and run: "paper" (exact
    measurements), "loop" (sensors), "swarm" (as "paper", but poles of nonlinear dynamic inversion by particle swarm).
    `results` is a function like `result`, which reads a table of data/results."""

    def __init__(self, results: Callable[[str], pd.DataFrame | None] = result):
        self.results = cache(results)
        self._evidence: dict[str, Evidence] = {}
        metrics = self.results(METRICS)
        self._rows = {} if metrics is None else dict(list(metrics.groupby("setting")))

    def settings(self) -> list[str]:
        """List the settings of `Nominal` that have stored metrics, in the order "paper", "swarm", "loop"."""
        return [column for column in COLUMNS if column in self._rows]

    def evidence(self, setting: str) -> Evidence:
        """Return metrics and tables of runs with a `setting`: "paper" (exact measurements), "swarm" (the same, but
        poles of NDI by particle swarm; tables as in "paper") or "loop" (sensors); for "" only tables without one."""
        if setting not in self._evidence:
            rows = self._rows.get(setting)
            known = ({}, {}) if rows is None else (tuned_metrics(rows), seeds_spread(rows))
            self._evidence[setting] = Evidence(*known, self.results, setting_of(setting))
        return self._evidence[setting]

    def on_calibrated_car(self) -> dict[str, str]:
        """Map ids to "yes" if they hold on the car fitted to the statements, else "no"; {} without paper_like.csv."""
        judged = self.results("paper_like")
        return {} if judged is None else {row.statement: "yes" if row.holds else "no" for row in judged.itertuples()}


def tuned_metrics(rows: pd.DataFrame) -> dict[Key, float]:
    """Average metrics over the seeds of the sensor noise: (scenario, controller, metric) -> value (SI). `rows` of
    nominal_metrics.csv are of one setting, as "loop" (sensors); rows with swarm other than 0 (other tuning runs) are
    left out. The metric `failed` is not averaged: it is 1 if any run failed."""
    values = rows[rows["swarm"] == 0].groupby(["scenario", "controller", "metric"], sort=False)["value"]
    return values.mean().to_dict() | {key: value for key, value in values.max().items() if key[2] == "failed"}


def seeds_spread(rows: pd.DataFrame) -> dict[Key, float]:
    """Compute how metrics scatter over tuning and noise seeds: (scenario, controller, metric) -> ln(largest / smallest
    |value|). `rows` of nominal_metrics.csv are of one setting, as "loop" (sensors). Only rmse_y and stopping_distance
    have a scatter; it is inf for rmse_y if a run failed, and 0 if a value is 0 or not finite."""
    sized = rows[rows["metric"].isin(["rmse_y", "stopping_distance"])]
    extremes = sized["value"].abs().groupby([sized[name] for name in ("scenario", "controller", "metric")])
    spread: dict[Key, float] = {}
    for key, (low, high) in extremes.agg(["min", "max"]).iterrows():
        spread[key] = float(np.log(high / low)) if low > 0 and np.isfinite(high) else 0.0
    failed = rows[(rows["metric"] == "failed") & (rows["value"] > 0)]
    return spread | {(row.scenario, row.controller, "rmse_y"): float("inf") for row in failed.itertuples()}
