"""Controllers in the settings of comparison: errors of all tuned sets, stability margins, changes of the ranking."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from railrepro import paths
from railrepro.control.ndi import NDI
from railrepro.control.registry import CONTROLLERS, LOOP
from railrepro.evidence.claims.nominal import seeds_spread
from railrepro.evidence.report import figures
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.uncertainty import order
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


def draw_ranking(runs: pd.DataFrame) -> Figure:
    """Draw the errors (mm) of all controllers in all settings, a panel per case; `runs` is a table of `judged`."""
    error, lost = errors(runs)
    names = list(error.columns)
    faces = {"paper": ("0.35", "white"), "equal": ("0.55", "0.55"), "loop": ("black", "black")}
    figure, axes = figures.new_figure(4, 2, height=1.5, width=1.75, sharex=True, sharey=True, squeeze=False)
    for axis, case in zip(axes.ravel(), dict.fromkeys(runs["case"]), strict=False):
        for shift, (setting, mark) in enumerate(figures.SETTING_MARKERS.items()):
            color, face = faces[setting]
            rows = runs[(runs["case"] == case) & (runs["setting"] == setting)].groupby("controller")["error_mm"]
            place, value = np.arange(len(names)) + 0.25 * (shift - 1), error.loc[(case, setting)]
            axis.hlines(place, rows.min().reindex(names), rows.max().reindex(names), color=color, linewidth=1)
            axis.plot(value, place, mark, color=color, markerfacecolor=face, markersize=3, label=f"setting {setting}")
            axis.plot(value.where(lost.loc[(case, setting)]), place, "x", color=color, markersize=6)
        axis.set_title(CASES[case][0], fontsize=8)
    first = axes[0, 0]
    first.set(xscale="log", xlim=(2e-3, 40), xticks=[1e-2, 1e-1, 1, 10])
    first.set_yticks(range(len(names)), [figures.LOOKS[name].label for name in names])
    first.invert_yaxis()
    for axis in axes[-1]:
        axis.set_xlabel("RMSE of y (mm)")
    first.plot([], [], "x", color="0.35", markersize=3, label="guidance lost")
    first.plot([], [], color="0.35", linewidth=1, label="all swarms and random seeds")
    figure.legend(*first.get_legend_handles_labels(), ncols=3, loc="outside upper center", columnspacing=1.0)
    return figure


def margins() -> tuple[pd.DataFrame, pd.DataFrame]:
    """Read the stability margins of data/results: two tables with index (setting, controller).

    The first has the disk margin (-), a column per speed (km/h); the second the largest extra delay of the
    torque (ms), drive lag (ms) and torque over command (-) without flange contact, with columns ("delay (ms)",
    "lag (ms)" or "gain"; "dry" or "poor").
    """
    found = pd.read_csv(paths.source("data/results/margins.csv"))
    found["largest"] *= np.where(found["unit"] == "s", 1e3, 1.0)
    survived = found.pivot(index=["setting", "controller"], columns=["quantity", "rail"], values="largest")
    sensitivity = pd.read_csv(paths.source("data/results/sensitivity.csv"))
    disk = sensitivity.pivot(index=["setting", "controller"], columns="speed_kmh", values="disk_margin")
    return disk, survived.rename(columns={"delay": "delay (ms)", "lag": "lag (ms)"})


def draw_margins(error: pd.DataFrame) -> tuple[Figure, pd.DataFrame]:
    """Draw RMSE of y on T3 over the smallest disk margin (-) and over the delay margin on poor rail (ms).

    `error` has these RMSE (mm): index setting, a column per controller. Also returns the points as a table: setting,
    controller, error_mm, disk_margin (-), delay_poor_ms.
    """
    disk, survived = margins()
    late = survived["delay (ms)", "poor"]
    front = pd.DataFrame([
        (*pair, error.loc[pair], disk.loc[pair].min(), late[pair]) for pair in late.index if pair[1] in error
    ], columns=["setting", "controller", "error_mm", "disk_margin", "delay_poor_ms"])  # fmt: skip
    size = {"height": 2.2, "width": figures.WIDTH / 3, "sharey": True, "sharex": "row"}
    figure, axes = figures.new_figure(2, 3, **size)
    for column, setting in zip(axes.T, figures.SETTING_MARKERS, strict=True):
        column[0].set_title(f"setting {setting}", fontsize=8)
        for row in front[front["setting"] == setting].itertuples():
            look = figures.points(row.controller, zorder=3 if row.controller == "nmpc" else 2, clip_on=False)
            for axis, margin in zip(column, (row.disk_margin, row.delay_poor_ms), strict=True):
                axis.plot(margin, row.error_mm, **look)
    for row, label in zip(axes, ("disk margin (-)", "delay margin, poor rail (ms)"), strict=True):
        row[0].set(ylabel="RMSE of y, T3 (mm)", yscale="log")
        row[1].set_xlabel(label)
    handles = figures.handles(axes[0])
    labels = [figures.LOOKS[name].label for name in error.columns if figures.LOOKS[name].label in handles]
    figure.legend([handles[label] for label in labels], labels, ncols=2, loc="outside upper center", handletextpad=0.2)
    return figure, front


def order_ratios(shaking: float) -> pd.DataFrame:
    """RMSE of y of NMPC over that of each inversion, for all changes of the study `uncertainty.order`.

    Columns ratio (-), axis (key of `order.AXES`), setting, against (the inversion), place (abscissa: the changed value
    in its unit; bandwidth in rad/s; of "car" the number of the choice), other_left_rail (the inversion derailed),
    shaking (the RMS torque of NMPC or of the inversion is above the argument `shaking`, N m).
    """
    table = pd.read_csv(paths.source("data/results/order_turns.csv"))
    of = table.groupby(["axis", "setting", "value", "controller"], sort=False)
    runs = of[["rmse_mm", "effort_Nm"]].agg(lambda values: values.mean(skipna=False))
    error, effort = (runs[name].unstack("controller") for name in runs)
    parts = []
    for axis, setting, other in product(order.AXES, order.SETTINGS, order.CONTROLLERS[1:]):
        at, torque = error.loc[axis, setting], effort.loc[axis, setting]
        if axis == "bandwidth":  # of the inversion alone: NMPC is as it was
            at = at.assign(nmpc=error.loc[("car", setting, "S1002"), "nmpc"])
            torque = torque.assign(nmpc=effort.loc[("car", setting, "S1002"), "nmpc"])
        places = [list(order.CAR).index(v) for v in at.index] if axis == "car" else at.index.astype(float)
        if axis == "bandwidth":
            places = places * NDI(**tuning.load(other, setting)["parameters"]).gains()["k0"] ** (1 / 3)
        row = {"ratio": (at["nmpc"] / at[other]).values, "axis": axis, "setting": setting, "against": other}
        row |= {"place": places, "other_left_rail": at[other].isna().values}
        row |= {"shaking": (torque[["nmpc", other]] > shaking).any(axis=1).values}
        parts.append(pd.DataFrame(row).sort_values("place", kind="stable"))
    return pd.concat(parts, ignore_index=True)


def tie(metrics: pd.DataFrame) -> float:
    """Largest ratio (-) of the RMSE of y on T3 between swarms of one controller; controllers closer than this tie.

    `metrics` is a table of the function `metrics`; settings and controllers are those of `uncertainty.order`.
    """
    logs = [
        seeds_spread(metrics[metrics["setting"] == setting]).get((order.SCENARIO, name, "rmse_y"), 0.0)
        for setting, name in product(order.SETTINGS, order.CONTROLLERS)
    ]
    return float(np.exp(max(logs)))


_PANELS = {
    "bandwidth": ("bandwidth of the inversion (rad/s)", "log", (20, 45)),
    "unbalanced acceleration": ("unbalanced acceleration (m/s²)", "linear", 0.4333),
    "creep stiffness": ("creep stiffness / that of the car (-)", "log", (0.7, 1.6)),
    "car": ("wheel profile and state estimation", "linear", (-0.3, 1.3)),
    "delay": ("torque delay, with estimation (ms)", "linear", (0, 1)),
    "noise": ("noise / nominal, with estimation (-)", "linear", 0.0),
}
"""Axis of the study -> label, scale, value (or assumed range) of the paper."""


def draw_order(ratios: pd.DataFrame, band: float) -> Figure:
    """Draw the ratios (-) of `order_ratios`, a panel per axis of the study.

    Markers are hollow where a controller oscillates (`shaking`), crosses where NDI derailed; ratios from 1 / band to
    band are a tie (`band` (-) as from `tie`).
    """
    figure, axes = figures.new_figure(2, 3, height=2.15, width=7 / 3, sharey=True)
    for axis, name in zip(axes.flat, _PANELS, strict=True):
        _order_panel(axis, name, ratios[ratios["axis"] == name], band)
    axes[1, 0].set_xticks(range(len(order.CAR)), [text.replace(", ", ",\n") for text in order.CAR])
    for axis in axes[:, 0]:
        axis.set_ylabel("RMSE, NMPC / NDI (-)")
    entries = figures.handles((axes[0, 1], axes[0, 0]))
    for mark, face, text in (("o", "white", "NMPC or NDI oscillates"), ("x", "0.3", "NDI derailed, setting equal")):
        entries[text] = axes[0, 0].plot([], [], mark, color="0.3", markerfacecolor=face, markersize=4)[0]
    figure.legend(entries.values(), entries.keys(), ncols=3, loc="outside upper center", columnspacing=1.2)
    return figure


def _order_panel(axis: Axes, name: str, rows: pd.DataFrame, band: float) -> None:
    label, scale, paper = _PANELS[name]
    axis.axhspan(1 / band, band, color="0.88", label="tie (spread of the swarms)")
    axis.axhline(1, color="0.4", linewidth=0.6)
    if isinstance(paper, float):
        axis.axvline(paper, linewidth=1.5, color=figures.GREEN, label="value printed in the paper")
    else:
        axis.axvspan(*paper, alpha=0.18, linewidth=0, color=figures.GREEN, label="range assumed for the paper")
    for (setting, other), run in rows.groupby(["setting", "against"], sort=False):
        color, line = figures.LOOKS[other].color, {"paper": "-", "equal": "--"}[setting]
        mark = figures.SETTING_MARKERS[setting]
        axis.plot(run["place"], run["ratio"], line, color=color, linewidth=1.0)
        for shaking, face in ((False, color), (True, "white")):
            some = run[run["shaking"] == shaking]
            axis.plot(some["place"], some["ratio"], mark, color=color, markerfacecolor=face, markersize=3.5)
        derailed = run["place"][run["other_left_rail"]]
        axis.plot(derailed, np.full(len(derailed), 0.07), "x", color="0.3", markersize=4.5)
        named = f"{figures.LOOKS[other].label}; setting {setting}"
        axis.plot([], [], line + mark, color=color, markersize=3.5, label=named)
    axis.set(xlabel=label, xscale=scale, yscale="log", ylim=(0.05, 25))
    if scale == "log":
        low, high = axis.get_xlim()
        ticks = [tick for tick in (0.25, 0.5, 1, 2, 4, 10, 20, 50, 100) if low < tick < high]
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.set_xticks([], minor=True)
