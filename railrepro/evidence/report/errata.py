"""Effect of errors in the paper's printed equations (D1 to D10) in closed loop: one as printed, the rest corrected."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from railrepro.control.registry import parameters
from railrepro.simulation.scenarios import Scenario
from railrepro.studies.experiment import Experiment, run_all

_COLUMNS = dict.fromkeys(("scenario", "controller", "variant", "warnings"), str) | {"rmse_y": float, "effort_du": float}
_TRIPLED = 2
"""Change of the error from which a run is lost."""


def model_variants(scenarios: Sequence[Scenario], variants: Sequence[str]) -> pd.DataFrame:
    """Simulate NMPC with variants of its prediction model, and with the printed torque limit (erratum D10).

    `variants` are values of `MPCSettings.variant`. Returns a row of metrics per run (`run_all`) with the columns
    scenario, variant ("D10" for the printed limit) and flange (whether a wheel touched its flange or lifted).
    """
    changed = {variant: {"variant": variant} for variant in variants} | {"D10": {"yielding": False}}
    tried = [(s, v) for s in scenarios for v in variants] + [(s, "D10") for s in scenarios]
    return _table([
        Experiment(s, "nmpc", {"variant": v}, options={"solver": "rti"}, changes=changed[v])
        for s, v in tried
    ], "discrepancies")  # fmt: skip


def linearisations(scenarios: Sequence[Scenario]) -> pd.DataFrame:
    """Simulate NMPC, LTV-MPC with the corrected linearisation and LTV-MPC with the printed one (erratum D6).

    All have the weights of NMPC in the setting `paper`. Returns a row of metrics per run (`run_all`) with the columns
    scenario, controller and flange (whether a wheel touched its flange or lifted).
    """
    weights = parameters("nmpc")
    return _table([
        Experiment(s, controller, parameters=weights)
        for s in scenarios for controller in ("nmpc", "ltv_mpc", "ltv_mpc_printed")
    ], "LTV against NMPC")  # fmt: skip


def _table(experiments: list[Experiment], title: str) -> pd.DataFrame:
    """Rows of `run_all` with the column flange; without experiments a table that has its columns but no row."""
    table, _ = run_all(experiments, title)
    table = table if experiments else pd.DataFrame(columns=list(_COLUMNS)).astype(_COLUMNS)
    return table.assign(flange=table["warnings"].str.contains("flange|lifts").astype(bool))


def effects(variants: pd.DataFrame, linear: pd.DataFrame) -> pd.DataFrame:
    """Effect of each erratum in each scenario: one row per pair.

    `variants` is a table of `model_variants`, `linear` one of `linearisations`. Columns id (of the erratum); scenario;
    rmse_y and rmse_y_corrected, RMSE of y with the printed and with the corrected equation (m); rmse_change and
    effort_change, relative change of RMSE of y and RMS torque (-); lost (bool). A run is lost if it reaches flanges or
    its RMSE is more than three times as large: changes and rmse_y are then NaN. If the RMSE more than doubles, two
    digits are kept, as rounding grows in such runs. The changes of D8 are 0, because no run depends on it.
    """
    is_corrected, controller = variants["variant"] == "corrected", linear["controller"]
    found = pd.concat([
        _changes(variants[~is_corrected].assign(id=variants["variant"]), variants[is_corrected]),
        _changes(linear[controller == "ltv_mpc_printed"].assign(id="D6"), linear[controller == "ltv_mpc"]),
    ], ignore_index=True)  # fmt: skip
    more = found["rmse_change"].abs() > 1
    found["lost"] = found["flange"] | (found["rmse_change"] > _TRIPLED)
    for name in ("rmse_y", "rmse_change", "effort_change"):
        found[name] = found[name].mask(more, found[name].map(lambda value: float(f"{value:.2g}")))
        found[name] = found[name].mask(found["lost"])
    d8 = pd.DataFrame({"id": "D8", "scenario": ["T1", "T2", "T3", "T4"], "rmse_change": 0.0, "effort_change": 0.0})
    columns = ["id", "scenario", "rmse_y", "rmse_y_corrected", "rmse_change", "effort_change", "lost"]
    result = pd.concat([found[columns], d8], ignore_index=True)
    return result.round({"rmse_change": 8, "effort_change": 8})  # less is rounding


def _changes(found: pd.DataFrame, reference: pd.DataFrame) -> pd.DataFrame:
    pair = found.merge(reference[["scenario", "rmse_y", "effort_du"]], on="scenario", suffixes=("", "_corrected"))
    for name, column in (("rmse_change", "rmse_y"), ("effort_change", "effort_du")):
        pair[name] = pair[column] / pair[f"{column}_corrected"] - 1
    return pair
