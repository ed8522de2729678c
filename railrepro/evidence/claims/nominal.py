"""Evidence on the nominal case: the stored probes of each setting, as `statements.Evidence`.

What predicates read comes from nominal_metrics.csv (`python -m railrepro probe`), the same runs as in the studies; what
the prose says of other controllers from settings_metrics.csv (notebook 10_settings).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.evidence.claims.statements import Evidence
from railrepro.evidence.runs import tuning

Key = tuple[str, str, str]
_SHARED = ("settings_metrics", "nominal_metrics")
"""Tables for all settings; the later one counts."""


def result(name: str) -> pd.DataFrame | None:
    """Table of data/results by its name without ending, such as "nominal_metrics"; None if there is no such file."""
    file = paths.source(f"data/results/{name}.csv")
    return pd.read_csv(file) if file.exists() else None


class Nominal:
    """Metrics of the nominal car from the tables of data/results, by setting of comparison.

    Parameters
    ----------
    results : callable, optional
        Reads a table of data/results: name without ending -> DataFrame, or None if there is no such file.
    """

    def __init__(self, results: Callable[[str], pd.DataFrame | None] = result):
        self.results = cache(results)
        tables = {name: self.results(name) for name in _SHARED}
        self._shared = {name: _normal(table) for name, table in tables.items() if table is not None}
        self._known: dict[str, Evidence] = {}
        self._table_of: dict[tuple[str, Key], str] = {}

    def settings(self) -> list[str]:
        """Settings of comparison for which the tables have metrics, in the order of `tuning.SETTINGS`."""
        known = {setting for table in self._shared.values() for setting in table["setting"]}
        return [setting for setting in tuning.SETTINGS if setting in known]

    def evidence(self, setting: str) -> Evidence:
        """Metrics and tables of a setting of comparison; for "" no metrics, but tables without a column `setting`."""
        if setting not in self._known:
            metrics: dict[Key, float] = {}
            spread: dict[Key, float] = {}
            for name, table in self._shared.items():
                rows = table[table["setting"] == setting]
                found = best_swarms(rows, setting)
                metrics |= found
                spread |= seeds_spread(rows)
                self._table_of |= {(setting, key): name for key in found}
            self._known[setting] = Evidence(metrics, spread, self.results, setting)
        return self._known[setting]

    def table_of(self, setting: str, scenario: str, controller: str, metric: str) -> str:
        """Name of the table of data/results with a metric of a run; without one, that with its `failed`, or else ""."""
        self.evidence(setting)
        failed = self._table_of.get((setting, (scenario, controller, "failed")), "")
        return self._table_of.get((setting, (scenario, controller, metric)), failed)

    def on_calibrated_car(self) -> dict[str, str]:
        """Statement id -> "yes" if the statement holds on the calibrated car, else "no"; {} without paper_like.csv."""
        found = self.results("paper_like")
        return {} if found is None else {row.statement: "yes" if row.holds else "no" for row in found.itertuples()}


def _normal(table: pd.DataFrame) -> pd.DataFrame:
    """A table of metrics with one name per speed, and `failed` in place of the place where a run derailed."""
    table = table.assign(scenario=table["scenario"].replace("sine_tracking", "sine_tracking 400"))
    lost = table[table["metric"] == "failed_at_m"].assign(metric="failed", value=1.0)
    return pd.concat([table[table["metric"] != "failed_at_m"], lost], ignore_index=True)


def best_swarms(rows: pd.DataFrame, setting: str) -> dict[Key, float]:
    """(scenario, controller, metric) -> value (SI) with each controller's best swarm, mean over the seeds of the noise.

    `rows` has the columns scenario, controller, metric, value, swarm: ranks by cost, with 0 the best, or seeds, with
    `best_seed` the best. `failed` is 1 where a run with any seed of the noise failed.
    """
    found: dict[Key, float] = {}
    for name, own in rows.groupby("controller", sort=False):
        swarms = list(own["swarm"].unique())
        swarm = 0 if 0 in swarms else best_seed(str(name), setting, swarms)
        chosen = own[own["swarm"] == swarm].groupby(["scenario", "metric"], sort=False)["value"]
        found |= {(s, str(name), m): v for (s, m), v in chosen.mean().items()}
        found |= {(s, str(name), m): v for (s, m), v in chosen.max().items() if m == "failed"}
    return found


def best_seed(controller: str, setting: str, seeds: Sequence) -> int:
    """Seed of the swarm of lowest cost in the tuning of a controller for a setting; seeds[0] if not in `seeds`."""
    swarms = sorted(tuning.load(controller, setting).get("swarms", []), key=lambda swarm: swarm["cost"])
    return next((swarm["seed"] for swarm in swarms[:1] if swarm["seed"] in seeds), int(seeds[0]))


def seeds_spread(rows: pd.DataFrame) -> dict[Key, float]:
    """(scenario, controller, metric) -> ln(largest / smallest absolute value) over the seeds of swarms and noise.

    For the metrics rmse_y and stopping_distance; `rows` has the columns scenario, controller, metric, value (SI). The
    result is inf for rmse_y where a run failed, and 0 where a value is 0 or not finite.
    """
    found: dict[Key, float] = {}
    lost = {(r.scenario, r.controller) for r in rows.itertuples() if r.metric == "failed" and r.value > 0}
    sized = rows[rows["metric"].isin(["rmse_y", "stopping_distance"])]
    for (scenario, name, metric), values in sized.groupby(["scenario", "controller", "metric"])["value"]:
        low, high = values.abs().min(), values.abs().max()
        known = low > 0 and np.isfinite(high)
        found[scenario, name, metric] = float(np.log(high / low)) if known else 0.0
    return found | {(s, c, "rmse_y"): float("inf") for s, c in lost}
