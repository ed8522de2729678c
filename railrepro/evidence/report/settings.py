"""Runs of all tuned controllers with exact measurements ("paper") and with sensors ("loop"), and their metrics."""

from collections.abc import Mapping, Sequence
from itertools import product

import pandas as pd

from railrepro.control.registry import BY_SWARM, CONTROLLERS, INVERSIONS, LOOP, SETTINGS
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies.experiment import Experiment
from railrepro.tuning import sets

CASES: dict[str, tuple[str, str, float, dict]] = {
    "curve_entry_T1": ("T1, 40 km/h", "curve_entry_T1", 80, {}),
    "curve_entry_T2": ("T2, 160 km/h", "curve_entry_T2", 400, {}),
    "curve_entry_T3": ("T3, 280 km/h", "curve_entry_T3", 600, {}),
    "curve_entry_T4": ("T4, 400 km/h", "curve_entry_T4", 700, {}),
    "sine_tracking": ("sine, 400 km/h", "sine_tracking", 300, {}),
    "T3_irregular": ("T3, irregular rails", "curve_entry_T3", 500, {"irregular": {"spectrum": "en_B_300", "seed": 3}}),
    "adhesion_loss": ("poor rail, 400 km/h", "adhesion_loss", 1000, {}),
    "adhesion_loss_stressed": ("poor rail, stressed", "adhesion_loss", 1000, {"plant": {"drive.lag": 7.5e-3}}),
}
"""Case (a scenario under one condition) -> title, scenario, length of the run (m), fields of `Experiment`."""
_UNITS = {"rmse_y": "m", "followed_rmse_y": "m", "delay": "m", "effort_du": "N m", "activity_du": "N m"}
_UNITS |= {"largest_error": "m", "utilisation": "-", "failed_at_m": "m"}


def experiments(
    names: Sequence[str], cases: Sequence[str], noise_seeds: Sequence[int], swarms: int | None, scale: float,
    stress: Mapping[str, float],
) -> list[Experiment]:  # fmt: skip
    """List the runs that compare the tuned controllers with perfect measurements ("paper") and with sensors ("loop").
    `names` are controllers. `cases` are keys of `CASES`, such as "curve_entry_T3": a scenario up to a coordinate.
    NDI controllers with poles by a swarm (`BY_SWARM`) run in "paper" only. A controller was tuned several times,
    by one swarm per seed. It runs with the sets of the `swarms` tunings of lowest cost (None: all). In "loop" the set
    of lowest cost runs with all `noise_seeds` of the sensors, other sets with the first. `scale` is a factor on the
    length of runs (-). `stress` changes data/sensors.toml in cases that end with "stressed": {"inverter.gain": 1.2}."""
    runs = []
    pairs = [pair for pair in product(SETTINGS, names) if pair[0] != LOOP or pair[1] not in BY_SWARM]
    for setting, name in pairs:
        tuned = sets.load(name, setting)
        designed = [{"seed": 0, "parameters": tuned["parameters"], "cost": 0.0}]
        ranked = sorted(tuned.get("swarms", designed), key=lambda swarm: swarm["cost"])[:swarms]
        for rank, swarm in enumerate(ranked):
            seeds = noise_seeds[: None if rank == 0 else 1] if setting == LOOP else [0]
            for case, seed in product(cases, seeds):
                _, scenario, end, more = CASES[case]
                stressed = dict(stress) if case.endswith("stressed") else {}
                sensors = {"seed": seed} if setting == LOOP else {"perfect": True} if stressed else {}
                label = {"case": case, "setting": setting, "swarm": swarm["seed"], "best": rank == 0, "seed": seed}
                short, quick = load_scenario(scenario).but(end_m=scale * end), CONTROLLERS[name].quick
                around = {**more, "sensors": sensors | stressed}
                runs.append(Experiment(short, name, label, swarm["parameters"], quick, **around))
    return runs


def metrics(table: pd.DataFrame) -> pd.DataFrame:
    """Make the table of settings_metrics.csv, one row per run and metric, from the `table` that `run_all` returns for
    `experiments`, one row per run. Columns: scenario (the key of `CASES`), controller, metric, value (in `unit`), unit,
    setting ("paper": exact measurements, "loop": sensors), swarm (seed of tuning), seed (sensors). NaN has no row."""
    keys = ["scenario", "controller", "setting", "swarm", "seed"]
    wide = table.drop(columns="scenario").rename(columns={"case": "scenario"}).reindex(columns=[*keys, *_UNITS])
    tidy = wide.melt(keys, var_name="metric").dropna().assign(unit=lambda rows: rows["metric"].map(_UNITS))
    return tidy[["scenario", "controller", "metric", "value", "unit", "setting", "swarm", "seed"]]


def errors(table: pd.DataFrame) -> pd.DataFrame:
    """Return the `table` of `run_all` for `experiments`, which tells by its column best whether the parameters are
    those of lowest cost, with more columns: error_mm, RMS error of y (mm), with sensors on irregular rails from the
    rails; lost, whether a wheel touched its flange or lifted. Its column controller gets the names of `by_swarm`."""
    rough = (table["setting"] == LOOP) & (table["case"] == "T3_irregular")
    error_mm = 1e3 * table["rmse_y"].mask(rough, table["followed_rmse_y"])
    lost = table["failed"].astype(bool) | (table["warnings"] != "")
    return table.assign(error_mm=error_mm, lost=lost, controller=by_swarm(table))


def by_swarm(table: pd.DataFrame) -> pd.Series:
    """Return the column controller of a table with a column setting: in "loop", where a swarm found the poles of every
    inversion, "ndi" becomes "ndi_swarm"."""
    found = (table["setting"] == LOOP) & table["controller"].isin(INVERSIONS)
    return table["controller"].mask(found, table["controller"] + "_swarm")
