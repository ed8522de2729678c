"""Effect of errors in the paper's printed equations (D1 to D10) in closed loop: one as printed, the rest corrected."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from railrepro.evidence.report import figures
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.experiment import Experiment, run_all
from railrepro.simulation.scenarios import Scenario
from railrepro.track.table import load_track, write_table

LINEAR = {"nmpc": "nmpc", "ltv": "ltv_mpc", "ltv printed": "ltv_mpc_printed"}
"""Kind of prediction model (nonlinear, linearised, linearised as printed) -> controller."""
_SHORT = {
    **{"D1": "order (D1)", "D2": "wheel energy (D2)", "D3": "track rate (D3)", "D4": "forecast (D4)"},
    **{"D6": "linearisation (D6)", "D7": "roll (D7)", "D10": "torque limit (D10)", "printed": "D1 to D4, D7"},
}
_TRIPLED = 2
"""Change of the error from which a run is lost."""


def _weights() -> dict:
    return tuning.load("nmpc", "equal")["parameters"]


def model_variants(scenarios: Sequence[Scenario], variants: Sequence[str]) -> pd.DataFrame:
    """Simulate NMPC with variants of its prediction model (`MPCSettings.variant`) and with the printed torque limit.

    Returns a row of metrics per run (`run_all`), with `scenario`, `variant` ("D10" for the printed limit) and `flange`
    (whether a wheel touched its flange or lifted).
    """
    changed = {variant: {"variant": variant} for variant in variants} | {"D10": {"yielding": False}}
    tried = [(s, v) for s in scenarios for v in variants] + [(s, "D10") for s in scenarios]
    table, _ = run_all([
        Experiment(s, "nmpc", {"variant": v}, options={"solver": "rti"}, changes=changed[v], setting="equal")
        for s, v in tried
    ], "discrepancies")  # fmt: skip
    return table.assign(flange=table["warnings"].str.contains("flange|lifts"))


def linearisations(scenarios: Sequence[Scenario]) -> pd.DataFrame:
    """Simulate NMPC and LTV-MPC, corrected and printed, with equal weights, by Runge-Kutta and by Euler's method.

    Returns a row of metrics per run (`run_all`), with `scenario`, `kind` (key of `LINEAR`, with ", Euler" appended for
    that method) and `flange` (whether a wheel touched its flange or lifted).
    """
    kinds = {kind: (controller, {}) for kind, controller in LINEAR.items()}
    kinds |= {f"{kind}, Euler": (controller, {"discretisation": "euler"}) for kind, controller in LINEAR.items()}
    table, _ = run_all([
        Experiment(s, controller, {"kind": kind}, parameters=_weights(), changes=change)
        for s in scenarios for kind, (controller, change) in kinds.items()
    ], "LTV against NMPC")  # fmt: skip
    return table.assign(flange=table["warnings"].str.contains("flange|lifts"))


def turned(scenario: Scenario, angles: Sequence[float]) -> pd.DataFrame:
    """RMSE of y (mm) of LTV-MPC on the track turned in plan: row per angle (rad), columns "ltv", "ltv printed"."""
    with tempfile.TemporaryDirectory() as folder:
        curves = {angle: scenario.but(track=_turned_track(scenario.track, angle, folder)) for angle in angles}
        labels = [{"turn": angle, "kind": kind} for angle in angles for kind in ("ltv", "ltv printed")]
        runs = [Experiment(curves[x["turn"]], LINEAR[x["kind"]], x, parameters=_weights()) for x in labels]
        table, _ = run_all(runs, "turned tracks")
    return table.assign(rmse=1e3 * table["rmse_y"]).pivot(index="turn", columns="kind", values="rmse")


def _turned_track(name: str, angle: float, folder: str) -> str:
    track, path = load_track(name).table.copy(), Path(folder) / f"{name}_{angle}.csv"
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    track[["x_m", "y_m"]] = track[["x_m", "y_m"]].to_numpy() @ rotation.T
    write_table(track.assign(psi_rad=track["psi_rad"] + angle), path)
    return str(path)


def heights(tracks: Sequence[str], base: float) -> pd.DataFrame:
    """Erratum D8: superelevation from sine and from tangent of the largest cant angle of each track.

    `tracks` are names, `base` is the distance of the contact points (m). Columns id, scenario (name of the track),
    sin_m, tan_m (m); no run depends on this erratum.
    """
    roll = np.array([load_track(track).table["phi_rad"].max() for track in tracks])
    return pd.DataFrame({"id": "D8", "scenario": tracks, "sin_m": base * np.sin(roll), "tan_m": base * np.tan(roll)})


def effects(variants: pd.DataFrame, linear: pd.DataFrame, d8: pd.DataFrame) -> pd.DataFrame:
    """Effect of each erratum by scenario, from the tables of `model_variants`, `linearisations` and `heights`.

    Columns id, scenario, rmse_y and rmse_y_corrected (m), rmse_change and effort_change (of RMSE of y and RMS torque,
    relative, -), lost. An RMSE that more than doubles has two digits, as such runs amplify rounding. A run at its
    flanges, or with more than three times the RMSE, is `lost` and has no numbers.
    """
    is_corrected, kind = variants["variant"] == "corrected", linear["kind"]
    parts = [
        _changes(variants[~is_corrected].assign(id=variants["variant"]), variants[is_corrected]),
        _changes(linear[kind == "ltv printed"].assign(id="D6"), linear[kind == "ltv"]),
    ]
    for found in parts:
        more = found["rmse_change"].abs() > 1
        found["lost"] = found["flange"] | (found["rmse_change"] > _TRIPLED)
        for name in ("rmse_y", "rmse_change", "effort_change"):
            found[name] = found[name].mask(more, found[name].map(lambda value: float(f"{value:.2g}")))
            found[name] = found[name].mask(found["lost"])
    unchanged = d8.assign(rmse_change=0.0, effort_change=0.0)[["id", "scenario", "rmse_change", "effort_change"]]
    columns = ["id", "scenario", "rmse_y", "rmse_y_corrected", "rmse_change", "effort_change", "lost"]
    result = pd.concat([*(part[columns] for part in parts), unchanged], ignore_index=True)
    result[["rmse_change", "effort_change"]] = result[["rmse_change", "effort_change"]].round(8)  # less is rounding
    return result


def _changes(found: pd.DataFrame, reference: pd.DataFrame) -> pd.DataFrame:
    pair = found.merge(reference[["scenario", "rmse_y", "effort_du"]], on="scenario", suffixes=("", "_corrected"))
    for name, column in (("rmse_change", "rmse_y"), ("effort_change", "effort_du")):
        pair[name] = pair[column] / pair[f"{column}_corrected"] - 1
    return pair


def by_entry(result: pd.DataFrame) -> pd.DataFrame:
    """Change of the RMSE of y (%) from `effects`: row per erratum, column per scenario; NaN where lost or not run."""
    shown = result[result["id"] != "D8"]
    return (
        100 * shown.pivot(index="id", columns="scenario", values="rmse_change")[list(dict.fromkeys(shown["scenario"]))]
    )


def draw_effects(result: pd.DataFrame) -> Figure:
    """Draw `by_entry` of a table of `effects` as a map: dark is a large change, grey lost, empty not simulated."""
    found = by_entry(result)
    wide = found.loc[[entry for entry in _SHORT if entry in found.index]]
    lost = set(result[result["lost"].fillna(False).astype(bool)].set_index(["id", "scenario"]).index)
    figure, axis = figures.new_figure(height=2.6)
    axis.imshow(np.clip(wide, -100, 100), cmap="PuOr", vmin=-100, vmax=100, aspect="auto")
    for i, entry in enumerate(wide.index):
        for j, name in enumerate(wide.columns):
            value, text, color = wide.loc[entry, name], "", "black"
            if (entry, name) in lost:
                axis.fill([j - 0.5, j + 0.5, j + 0.5, j - 0.5], [i - 0.5, i - 0.5, i + 0.5, i + 0.5], color="0.35")
                text, color = "lost", "white"
            elif not np.isnan(value):
                text, color = "0" if abs(value) < 0.5 else f"{value:+.0f}", "white" if abs(value) > 60 else "black"
            axis.text(j, i, text, ha="center", va="center", fontsize=7, color=color)
    names = [name.removeprefix("curve_entry_").split("_")[0] for name in wide.columns]
    axis.set_xticks(range(len(wide.columns)), names)
    axis.set_yticks(range(len(wide.index)), [_SHORT[entry] for entry in wide.index])
    axis.set_title("numbers: change of the RMSE of y (%)", fontsize=8)
    axis.set_xlabel("lost: at the flanges, or error above three times; empty: not run", fontsize=7)
    axis.grid(False)
    return figure
