"""Evidence on the nominal case: the stored probes of each setting, as `statements.Evidence`.

What predicates read comes from nominal_metrics.csv (`python -m railrepro probe`), the same runs as in the studies; what
the prose says of other controllers from settings_metrics.csv (notebook 14_settings).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.errors import InputError
from railrepro.evidence.claims.statements import Evidence
from railrepro.evidence.runs import tuning

Key = tuple[str, str, str]
Found = TypeVar("Found")
_SHARED = ("settings_metrics", "nominal_metrics")
"""Tables for all settings; the later one counts."""


class Results:
    """Tables of data/results; `used` lists the files that were asked for, relative to the checkout."""

    def __init__(self) -> None:
        self.used: set[str] = set()

    def __call__(self, name: str) -> pd.DataFrame:
        """A table, or InputError when it is missing."""
        file = self.file(f"data/results/{name}.csv")
        return _read(file, file.stat().st_mtime_ns).copy()

    def file(self, relative: str) -> Path:
        """A file that numbers come from, or InputError when it is missing."""
        file = paths.source(relative)
        if not file.exists():
            raise InputError(f"{file.name}: is missing; `make figures` makes it")
        self.used |= {relative}
        return file

    def optional(self, name: str) -> pd.DataFrame | None:
        """A table, or None when it is missing."""
        return self(name) if paths.source(f"data/results/{name}.csv").exists() else None


@lru_cache(maxsize=64)
def _read(file: Path, _changed: int) -> pd.DataFrame:
    return pd.read_csv(file)


class Asked(dict):
    """Metrics in some setting that remember in `asked` which of them were asked for, and where a run had failed."""

    def __init__(self, metrics: Mapping[Key, float], setting: str, asked: set[tuple[str, Key]]):
        super().__init__(metrics)
        self._setting, self._asked = setting, asked

    def __getitem__(self, key: Key) -> float:
        value = super().__getitem__(key)
        self._asked.add((self._setting, key))
        return value

    def get(self, key: Key, default=None):
        """A metric; that a run had failed is the answer, that it had not is none."""
        value = super().get(key, default)
        if key in self and value:
            self._asked.add((self._setting, key))
        return value


class Nominal:
    """The nominal case in all settings.

    Parameters
    ----------
    results : Results, optional
        Where tables come from.
    """

    def __init__(self, results: Results | None = None):
        self.results = results or Results()
        self._asked: set[tuple[str, Key]] = set()
        self._known: dict[str, tuple[dict[Key, float], dict[Key, float]]] = {}

    @cached_property
    def _shared(self) -> dict[str, pd.DataFrame]:
        tables = {name: self.results.optional(name) for name in _SHARED}
        return {name: _normal(table) for name, table in tables.items() if table is not None}

    def settings(self) -> list[str]:
        """Settings in which there is evidence."""
        known = {setting for table in self._shared.values() for setting in table["setting"]}
        return [setting for setting in tuning.SETTINGS if setting in known]

    def evidence(self, setting: str) -> Evidence:
        """Evidence in a setting, its metrics `Asked`; without a setting only tables that no controller enters."""
        if setting not in self._known:
            metrics: dict[Key, float] = {}
            spread: dict[Key, float] = {}
            for table in self._shared.values():
                rows = table[table["setting"] == setting]
                metrics |= best(rows, setting)
                spread |= seeds_spread(rows)
            self._known[setting] = metrics, spread
        metrics, spread = self._known[setting]
        return Evidence(Asked(metrics, setting, self._asked), spread, self.results, setting)

    def traced(self, found: Callable[[], Found]) -> tuple[Found, list[str]]:
        """What a function finds, and the files that it comes from, relative to the checkout."""
        for setting in self.settings():
            self.evidence(setting)  # so that what making it reads does not count
        self._asked.clear()
        self.results.used.clear()
        value = found()
        metrics = {file for setting, key in self._asked for file in self._source(setting, *key)}
        return value, sorted(metrics | self.results.used)

    def _source(self, setting: str, scenario: str, controller: str, metric: str) -> list[str]:
        """The file that a metric comes from."""
        for name, table in reversed(self._shared.items()):
            rows = table[(table["setting"] == setting) & (table["scenario"] == scenario)]
            if ((rows["controller"] == controller) & (rows["metric"] == metric)).any():
                return [f"data/results/{name}.csv"]
        return []


def _normal(table: pd.DataFrame) -> pd.DataFrame:
    """A table of metrics with one name per speed, and `failed` in place of the place where a run derailed."""
    table = table.assign(scenario=table["scenario"].replace("sine_tracking", "sine_tracking 400"))
    lost = table[table["metric"] == "failed_at_m"].assign(metric="failed", value=1.0)
    return pd.concat([table[table["metric"] != "failed_at_m"], lost], ignore_index=True)


def best(rows: pd.DataFrame, setting: str) -> dict[Key, float]:
    """Metrics of each controller's best swarm, mean over the seeds of the noise; a run that failed makes all fail."""
    found: dict[Key, float] = {}
    for name, own in rows.groupby("controller", sort=False):
        swarm = (
            own["swarm"].min() if (own["swarm"] == 0).any() else best_seed(str(name), setting, own["swarm"].unique())
        )
        chosen = own[own["swarm"] == swarm].groupby(["scenario", "metric"], sort=False)["value"]
        found |= {(s, str(name), m): v for (s, m), v in chosen.mean().items()}
        found |= {(s, str(name), m): v for (s, m), v in chosen.max().items() if m == "failed"}
    return found


def best_seed(controller: str, setting: str, seeds: Iterable) -> int:
    """Seed of the best swarm of a tuned set; the first of those given when there is no set."""
    file = paths.source(f"{tuning.TUNED}/{setting}/{controller}.json")
    if file.exists():
        swarms = json.loads(file.read_text(encoding="utf-8"))["swarms"]
        seed = min(swarms, key=lambda swarm: swarm["cost"])["seed"]
        if seed in list(seeds):
            return int(seed)
    return int(next(iter(seeds)))


def seeds_spread(rows: pd.DataFrame) -> dict[Key, float]:
    """Logarithm of largest over smallest size of each metric among all swarms and seeds; infinite when one failed."""
    found: dict[Key, float] = {}
    lost = {(r.scenario, r.controller) for r in rows.itertuples() if r.metric == "failed" and r.value > 0}
    sized = rows[rows["metric"].isin(["rmse_y", "stopping_distance"])]
    for (scenario, name, metric), values in sized.groupby(["scenario", "controller", "metric"])["value"]:
        low, high = values.abs().min(), values.abs().max()
        known = low > 0 and np.isfinite(high)
        found[scenario, name, metric] = float(np.log(high / low)) if known else 0.0
    return found | {(s, c, "rmse_y"): float("inf") for s, c in lost}
