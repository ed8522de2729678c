"""Evidence on the nominal case: the committed tables, as `statements.Evidence` per setting of comparison.

In the setting `equal` the tables behind the figures come first; what no figure shows, and the other settings, come from
settings_metrics.csv (notebook 14_settings) and nominal_metrics.csv (`make study`).
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
from railrepro.control.registry import EMPHASIS, PAPER_TRIO, r_times
from railrepro.errors import InputError
from railrepro.evidence.claims import probe
from railrepro.evidence.claims.statements import BRAKE, LOSS, NDI, NOTHING, REGULAR, SOFT, SOFTEST, T3, Evidence
from railrepro.evidence.runs import tuning
from railrepro.simulation.scenarios import load_scenario

Key = tuple[str, str, str]
Found = TypeVar("Found")
_CASES = {"NMPC, tuned": "nmpc", r_times(EMPHASIS, "NMPC"): SOFT, "NDI": NDI, "no slip control": "no slip control"}
_SHARED = ("nominal_metrics", "settings_metrics")
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
        known = {tuning.EQUAL, *(setting for table in self._shared.values() for setting in table["setting"])}
        return [setting for setting in tuning.SETTINGS if setting in known]

    def evidence(self, setting: str, tables: bool = True) -> Evidence:
        """Evidence in some setting, its metrics `Asked`; the figures' tables hold the setting `equal`."""
        if setting not in self._known:
            metrics: dict[Key, float] = {}
            spread: dict[Key, float] = {}
            for table in self._shared.values():
                rows = table[table["setting"] == setting]
                metrics |= best(rows, setting)
                spread |= seeds_spread(rows)
            metrics |= self._figures if setting == tuning.EQUAL else {}
            self._known[setting] = idle(metrics) | metrics, spread
        metrics, spread = self._known[setting]
        return Evidence(Asked(metrics, setting, self._asked), spread, self.results if tables else None)

    def traced(self, found: Callable[[], Found]) -> tuple[Found, list[str]]:
        """What a function finds, and the files that it comes from, relative to the checkout."""
        for setting in self.settings():
            self.evidence(setting)  # so that what making it reads does not count
        self._asked.clear()
        self.results.used.clear()
        value = found()
        metrics = {file for setting, key in self._asked for file in self._source(setting, *key)}
        files = {file for file in (metrics | self.results.used) if not file.endswith("scenarios.toml")}
        return value, sorted(files or metrics | self.results.used)

    def _source(self, setting: str, scenario: str, controller: str, metric: str) -> list[str]:
        """The file that a metric comes from."""
        if controller == NOTHING and metric != "slip_at_maximum":
            return ["data/scenarios.toml"]
        if setting == tuning.EQUAL and (scenario, controller, metric) in self._figures:
            return [f"data/results/{_figure_table(scenario, metric)}.csv"]
        for name, table in reversed(self._shared.items()):
            if ((table["scenario"] == scenario) & (table["metric"] == metric)).any():
                return [f"data/results/{name}.csv"]
        return []

    @cached_property
    def _figures(self) -> dict[Key, float]:
        """Metrics behind Figs. 6 to 9."""
        curve = self.results("curve_entry_metrics")
        found = {(T3, r.controller, r.metric): r.value for r in curve.itertuples()}
        for row in self.results("sine_metrics").query("scenario == 'sine_tracking'").itertuples():
            found[f"sine_tracking {row.speed_kmh:g}", row.controller, row.metric] = row.value
        return found | self._curve_series | self._loss | self._braking

    @cached_property
    def _curve_series(self) -> dict[Key, float]:
        series = dict(list(self.results("fig06_curve_entry").groupby("controller")))
        expected = probe.gyroscopic_torque(probe.load_vehicle(), load_scenario(T3))
        found = {}
        for name in PAPER_TRIO:
            found[T3, name, "gyroscopic_share"] = probe.torque_step(series[name]) / expected
            found[T3, name, "error_at_crests"] = probe.error_at_crests(series[name])
        shift = probe.torque_shift(series["nmpc"], series[NDI])
        return found | {(T3, NDI, metric): value for metric, value in shift.items()}

    @cached_property
    def _loss(self) -> dict[Key, float]:
        table = self.results("adhesion_metrics").query("experiment == 'fig08'")
        series = dict(list(self.results("fig08_adhesion_loss").groupby("case")))
        maximum = self.results("adhesion_maximum").query("adhesion == 'poor' and speed_kmh == 400")["slip"]
        found: dict[Key, float] = {}
        for row in table.itertuples():
            if row.case not in _CASES:
                continue
            name = _CASES[row.case]
            values = {m: getattr(row, m) for m in ("rmse_y", "largest_error", "utilisation", "largest_slip")}
            values |= {"failed": float(row.failed), "recovered_share": probe.recovered_share(series[row.case])}
            found |= {(LOSS, name, metric): float(value) for metric, value in values.items()}
        found[LOSS, REGULAR, "regular_deviation"] = probe.regular_deviation(series[r_times(EMPHASIS, "NMPC")])
        if len(maximum):
            found[LOSS, NOTHING, "slip_at_maximum"] = float(maximum.iloc[0])
        return found

    @cached_property
    def _braking(self) -> dict[Key, float]:
        found: dict[Key, float] = {}
        for row in self.results("braking_front").itertuples():
            values = [("rmse_y", row.rmse_y), ("stopping_distance", row.stopping_distance)]
            values = values if row.stopped else [(metric, np.inf) for metric, _ in values]
            sweep = {"nmpc": "sweep of R", "ndi": "sweep of poles"}.get(row.kind)
            if sweep:
                found |= {(BRAKE, sweep, f"{metric} {row.factor:g}"): value for metric, value in values}
            if row.kind == "tuned":
                named = row.controller if np.isnan(row.factor) else {1.0: "nmpc", 100.0: SOFTEST}.get(row.factor)
                found |= {(BRAKE, named, metric): value for metric, value in values} if named else {}
        return found


def _figure_table(scenario: str, metric: str) -> str:
    """The table behind a figure that has a metric."""
    if metric in ("gyroscopic_share", "error_at_crests", "torque_later", "torque_alike"):
        return "fig06_curve_entry"
    if metric in ("regular_deviation", "recovered_share"):
        return "fig08_adhesion_loss"
    named = {T3: "curve_entry_metrics", LOSS: "adhesion_metrics", BRAKE: "braking_front"}
    return "adhesion_maximum" if metric == "slip_at_maximum" else named.get(scenario, "sine_metrics")


def _normal(table: pd.DataFrame) -> pd.DataFrame:
    """A table of metrics with one name per speed, and `failed` in place of where a run left the rail."""
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


def idle(metrics: Iterable[Key]) -> dict[Key, float]:
    """What y = 0 gives in each scenario among the keys that data/scenarios.toml has."""
    found: dict[Key, float] = {}
    lengths = {"curve_entry_T1": 80.0, LOSS: 700.0}
    for name in {scenario for scenario, _, _ in metrics}:
        base, _, speed = name.partition(" ")
        if base == "offset" or not base.startswith(("curve", "sine", LOSS, BRAKE)) or base.endswith("stressed"):
            continue
        scenario = load_scenario(base)
        if base in lengths:
            scenario = scenario.but(end_m=lengths[base])
        found |= {(name, NOTHING, metric): value for metric, value in probe.nothing(scenario).items()}
    return found
