"""Controllers in the settings of comparison: errors of all tuned sets, stability margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import pandas as pd

from railrepro.control.registry import CONTROLLERS, LOOP
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation.scenarios import load_scenario

CASES: dict[str, tuple[str, str, float, dict]] = {
    "curve_entry_T1": ("T1, 40 km/h", "curve_entry_T1", 80, {}),
    "curve_entry_T2": ("T2, 160 km/h", "curve_entry_T2", 400, {}),
    "curve_entry_T3": ("T3, 280 km/h", "curve_entry_T3", 600, {}),
    "curve_entry_T4": ("T4, 400 km/h", "curve_entry_T4", 700, {}),
    "sine_tracking": ("sine, 400 km/h", "sine_tracking", 600, {}),
    "T3_irregular": ("T3, irregular rails", "curve_entry_T3", 500, {"irregular": {"spectrum": "en_B_300", "seed": 3}}),
    "adhesion_loss": ("poor rail, 400 km/h", "adhesion_loss", 700, {}),
    "adhesion_loss_stressed": ("poor rail, stressed", "adhesion_loss", 700, {"plant": {"drive.lag": 7.5e-3}}),
}
"""Name of a case -> title, scenario, length of the run (m), further fields of `Experiment`."""
_UNITS = {
    **{"rmse_y": "m", "followed_rmse_y": "m", "effort_du": "N m", "activity_du": "N m"},
    **{"largest_error": "m", "utilisation": "-", "failed_at_m": "m"},
}


def experiments(
    names: Sequence[str], cases: Sequence[str], noise_seeds: Sequence[int], swarms: int | None, scale: float,
    stress: Mapping[str, float],
) -> list[Experiment]:  # fmt: skip
    """Experiments of all tuned sets in all settings: the best set with all noise seeds, sets of other swarms with one.

    `names` are controllers, `cases` keys of `CASES`, `noise_seeds` those of the sensors in the setting `loop`, `swarms`
    the number of swarms per controller (None for all), `scale` a factor on the length of the runs (-), `stress` changes
    of data/sensors.toml in the cases "…stressed", as {"inverter.gain": 1.2}.
    """
    found = []
    for setting, name in product(tuning.SETTINGS, names):
        tuned = tuning.load(name, setting)
        designed = [{"seed": 0, "parameters": tuned["parameters"], "cost": 0.0}]
        ranked = sorted(tuned.get("swarms", designed), key=lambda swarm: swarm["cost"])[:swarms]
        for rank, swarm in enumerate(ranked):
            seeds = noise_seeds[: None if rank == 0 else 1] if setting == LOOP else [0]
            for case, seed in product(cases, seeds):
                _, scenario, end, more = CASES[case]
                stressed = stress if case.endswith("stressed") else {}
                sensors = {"seed": seed} if setting == LOOP else {"perfect": True} if stressed else {}
                label = {"case": case, "setting": setting, "swarm": swarm["seed"], "seed": seed}
                way = load_scenario(scenario).but(end_m=scale * end)
                quick = CONTROLLERS[name].quick
                more = more | {"sensors": sensors | dict(stressed)}
                found.append(Experiment(way, name, label, swarm["parameters"], quick, **more))
    return found


def metrics(table: pd.DataFrame) -> pd.DataFrame:
    """Table of data/results/settings_metrics.csv from one row per run of `experiments`: a row per run and metric.

    Columns scenario (the case), controller, metric, value (in `unit`), unit, setting, swarm and seed.
    """
    keys = ["scenario", "controller", "setting", "swarm", "seed"]
    wide = table.drop(columns="scenario").rename(columns={"case": "scenario"}).reindex(columns=[*keys, *_UNITS])
    tidy = wide.melt(keys, var_name="metric").dropna()
    tidy = tidy.assign(unit=tidy["metric"].map(_UNITS))
    return tidy[["scenario", "controller", "metric", "value", "unit", "setting", "swarm", "seed"]]


def judged(table: pd.DataFrame) -> pd.DataFrame:
    """Add columns to `table`, one row per run of `experiments`: error_mm (RMSE of y, mm), lost and best (booleans).

    A run is lost if it failed or has a warning, best if its tuned set is that of the best swarm. On irregular rails
    with sensors the error counts from the rails, because sensors measure from them.
    """
    sensed_rough = (table["setting"] == LOOP) & (table["case"] == "T3_irregular")
    return table.assign(
        error_mm=1e3 * table["rmse_y"].mask(sensed_rough, table["followed_rmse_y"]),
        lost=table["failed"].astype(bool) | (table["warnings"] != ""),
        best=table["swarm"] == table.groupby(["setting", "controller"])["swarm"].transform("first"),
    )


def errors(runs: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Two tables from one of `judged`, of the best sets, with index (case, setting) and a column per controller.

    The first has the mean RMSE of y over the noise seeds (mm), the second whether guidance was lost with any of them.
    """
    best = runs[runs["best"]].groupby(["case", "setting", "controller"], sort=False)
    names = list(dict.fromkeys(runs["controller"]))
    error = best["error_mm"].apply(lambda e: e.mean(skipna=False)).unstack("controller")[names]
    return error, best["lost"].any().unstack("controller")[names]
