"""Effect of each error in the paper's printed equations (D1 to D10) in closed loop, with the others corrected."""

from collections.abc import Sequence
from itertools import product

import pandas as pd

from railrepro.control.registry import parameters
from railrepro.simulation.scenarios import Scenario
from railrepro.studies.experiment import Experiment, run_all

_COLUMNS = dict.fromkeys(("scenario", "controller", "variant", "warnings"), str) | {"rmse_y": float, "effort_du": float}
_TRIPLED = 2  # Relative change of the RMSE above which a run counts as lost


def model_variants(scenarios: Sequence[Scenario], variants: Sequence[str]) -> pd.DataFrame:
    """Simulate NMPC with each of `variants` as its prediction model, and always also with the printed torque limit
    (erratum D10: it leaves no torque to steer). A variant is "corrected", or "printed" (all printed errors stay in the
    model), or those that stay, as "D1" or "D1,D3". Returns one row of metrics per run (`run_all`) with the columns
    scenario, variant ("D10" for the printed limit) and flange (whether a wheel touched its flange or lifted)."""
    changed = {variant: {"variant": variant} for variant in variants} | {"D10": {"yielding": False}}
    tried = [*product(scenarios, variants), *product(scenarios, ["D10"])]
    runs = [Experiment(s, "nmpc", {"variant": v}, options={"solver": "rti"}, changes=changed[v]) for s, v in tried]
    return _table(runs, "discrepancies")


def linearisations(scenarios: Sequence[Scenario]) -> pd.DataFrame:
    """Simulate NMPC, LTV-MPC with the corrected linearisation and LTV-MPC with the printed one (erratum D6: without its
    affine term), all with the weights tuned here for NMPC with exact measurements. Returns one row per run: scenario,
    controller, flange (whether a wheel touched its flange or lifted) and metrics."""
    weights, controllers = parameters("nmpc"), ("nmpc", "ltv_mpc", "ltv_mpc_printed")
    runs = [Experiment(s, name, parameters=weights) for s, name in product(scenarios, controllers)]
    return _table(runs, "LTV against NMPC")


def _table(experiments: list[Experiment], title: str) -> pd.DataFrame:
    """Table of `run_all` with the column flange; without experiments it has columns but no row."""
    table, _ = run_all(experiments, title)
    table = table if experiments else pd.DataFrame(columns=list(_COLUMNS)).astype(_COLUMNS)
    return table.assign(flange=table["warnings"].str.contains("flange|lifts").astype(bool))


def effects(variants: pd.DataFrame, linear: pd.DataFrame) -> pd.DataFrame:
    """Effect of each erratum, an error in the paper's equations, in each scenario: one row per pair, from tables of
    `model_variants` (NMPC) and `linearisations` (D6, LTV-MPC). Columns: id of the erratum, as "D1" (or variant);
    scenario; rmse_y and rmse_y_corrected, RMSE of y with the printed and with the corrected equation (m); rmse_change
    and effort_change, RMSE of y and RMS torque with the printed equation over those with the corrected one, minus 1
    (-); lost: with the printed equation flanges are reached, or the RMSE is above three times rmse_y_corrected. rmse_y
    and both changes are NaN in a lost row; if the RMSE more than doubles, they have two digits, as rounding grows in
    such runs. D8 (superelevation from the tangent of the angle) has changes of 0, as no run depends on it, else NaN."""
    is_corrected, controller = variants["variant"] == "corrected", linear["controller"]
    pairs = [(variants[~is_corrected].assign(id=variants["variant"]), variants[is_corrected])]
    pairs += [(linear[controller == "ltv_mpc_printed"].assign(id="D6"), linear[controller == "ltv_mpc"])]
    values, suffixes = ["scenario", "rmse_y", "effort_du"], ("", "_corrected")
    merged = [printed.merge(corrected[values], on="scenario", suffixes=suffixes) for printed, corrected in pairs]
    effect = pd.concat(merged, ignore_index=True)
    for change, metric in (("rmse_change", "rmse_y"), ("effort_change", "effort_du")):
        effect[change] = effect[metric] / effect[f"{metric}_corrected"] - 1
    more = effect["rmse_change"].abs() > 1
    effect["lost"] = effect["flange"] | (effect["rmse_change"] > _TRIPLED)
    for name in ("rmse_y", "rmse_change", "effort_change"):
        effect[name] = effect[name].mask(more, effect[name].map(lambda value: float(f"{value:.2g}")))
        effect[name] = effect[name].mask(effect["lost"])
    d8 = pd.DataFrame({"id": "D8", "scenario": ["T1", "T2", "T3", "T4"], "rmse_change": 0.0, "effort_change": 0.0})
    columns = ["id", "scenario", "rmse_y", "rmse_y_corrected", "rmse_change", "effort_change", "lost"]
    result = pd.concat([effect[columns], d8], ignore_index=True)
    return result.round({"rmse_change": 8, "effort_change": 8})  # smaller changes are rounding
