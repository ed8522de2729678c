"""Figures and table of controllers on irregular rails, with and without preview of the irregularities.

Serves the paper's outlook on known track irregularities.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import signal

from railrepro.evidence.report import figures
from railrepro.simulation import ride
from railrepro.track import irregularity
from railrepro.track.rough import rough_track
from railrepro.track.route import CELL

_LOOKS = {"none": ("0.65", "without preview"), "exact": ("0.2", "with preview")}
_CHANNELS = {
    "vertical": ("level", figures.BLUE),
    "lateral": ("alignment", figures.ORANGE),
    "gauge": ("gauge", figures.BLACK),
}
_UNITS = {
    **dict.fromkeys(("rmse_y", "rail_rmse_y"), "m"),
    "effort_du": "N m",
    "failed_at_m": "m",
    **dict.fromkeys(("sum_y_over_limit", "y_over_q", "wheel_unloading"), "-"),
    "flange_contacts": "1/km",
    **dict.fromkeys(("t_gamma", "creep_work"), "N"),
    **{f"n_mv_{point}": "-" for point in ride.FLOOR},
    **{f"a_wd_lateral_{point}": "m/s2" for point in ride.FLOOR},
    **{f"a_wk_vertical_{point}": "m/s2" for point in ride.FLOOR},
    "motor_energy_net": "kWh",
}


def metrics(rows: pd.DataFrame, rough_cars: Sequence[str]) -> pd.DataFrame:
    """Long table of ride metrics from `rows`, one per run: the labels of the run, and metric, value (in `unit`), unit.

    Labels are scenario, track, car, controller, preview, seed. Of cars in `rough_cars`, which strike their flanges,
    there is only the track shifting force over its limit (-), to two digits.
    """
    keys = ["scenario", "track", "car", "controller", "preview", "seed"]
    found = rows[[*keys, *_UNITS]].melt(id_vars=keys, var_name="metric").dropna()
    wild = found["car"].isin(rough_cars)
    found["value"] = found["value"].mask(wild, found["value"].map(lambda value: float(f"{value:.2g}")))
    found = found[~wild | (found["metric"] == "sum_y_over_limit")]
    return found.assign(unit=found["metric"].map(_UNITS))


def draw(
    spectrum: str, seed: int, rough: Mapping, faults: Mapping[str, float], one: pd.DataFrame, table: pd.DataFrame,
    names: Sequence[str], end_m: float,
) -> Figure:  # fmt: skip
    """Draw irregular rails, their spectra, path and distance from them of one controller, RMSE of all controllers (mm).

    `spectrum` and `seed` are those of the rails (`irregularities`) whose spectra are drawn, `rough` the arguments of
    `rough_track` for the rails along the way, `faults` the coordinates of their single faults by name (m). `one` is the
    series of one controller (columns preview, p_m, y_m), `table` has a row per run (controller, preview, rail_rmse_y in
    m), `names` are the controllers to show, `end_m` is the length of the track (m).
    """
    fig, axes = figures.new_figure(5, 1, height=1.6, gridspec_kw={"height_ratios": [1, 1, 1.2, 1, 1.5]})
    p = np.arange(0.0, end_m, CELL)
    track = rough_track(p, **rough)
    _draw_rails(axes[0], axes[1], spectrum, seed, p, track)
    _draw_path(axes[2], axes[3], one, p, 1e3 * track["lateral_m"])
    _draw_bars(axes[4], table, names)
    axes[0].set(xlim=(0.25 * end_m, 0.9 * end_m), ylabel="deviation (mm)", ylim=(-4, 8))
    axes[2].set(xlim=(0.48 * end_m, 0.76 * end_m), ylim=(-3, 5.5), ylabel="y (mm)")
    axes[3].set(xlim=(0.25 * end_m, 0.9 * end_m), ylabel="y less rails (mm)")
    for name, place in faults.items():
        axes[0].annotate(name, (place, 6.2), (2, 0), textcoords="offset points", fontsize=7)
    for axis in (axes[0], axes[2], axes[3]):
        axis.set_xlabel("track coordinate (m)", labelpad=1)
        for place in faults.values():
            axis.axvline(place, color="0.5", linestyle="--", linewidth=0.7, zorder=0)
    axes[1].legend(*(entry[-1:] for entry in axes[1].get_legend_handles_labels()), loc="lower left")
    for axis in (axes[0], axes[2], axes[4]):
        place = {"loc": "lower right", "bbox_to_anchor": (1.02, 0.97)}
        axis.legend(ncols=3, handlelength=1.2, columnspacing=0.8, **place)
    return fig


def _draw_rails(axis: Axes, spectral: Axes, spectrum: str, seed: int, p: np.ndarray, track: pd.DataFrame) -> None:
    """Channels along the way, and spectra of 8 km against their formulas."""
    frame = irregularity.irregularities(np.arange(0.0, 8000.0, 0.5), spectrum, seed=seed)
    for channel, (label, color) in _CHANNELS.items():
        column = irregularity.CHANNELS[channel]
        axis.plot(p, 1e3 * track[column], color=color, linewidth=0.7, label=label)
        f, density = signal.welch(frame[column].to_numpy(), 2.0, nperseg=2048)
        f, density = f[(f > 0.011) & (f < 0.33)], density[(f > 0.011) & (f < 0.33)]
        formula = 2 * np.pi * irregularity.irregularity_spectrum(spectrum, channel, 2 * np.pi * f)
        spectral.loglog(f, 1e6 * density, color=color, linewidth=0.6)
        spectral.loglog(f, 1e6 * formula, color="0.4", linewidth=0.9, linestyle=":", label="formula")
    spectral.set(xlabel="wavenumber (1/m)", ylabel="density (mm$^2$ m)")


def _draw_path(path: Axes, distance: Axes, one: pd.DataFrame, p: np.ndarray, lateral_mm: pd.Series) -> None:
    path.plot(p, lateral_mm, color=figures.ORANGE, linewidth=1.2, linestyle="--", label="rails")
    for kind, (color, label) in _LOOKS.items():
        rows = one[one["preview"] == kind]
        path.plot(rows["p_m"], 1e3 * rows["y_m"], color=color, linewidth=0.9, label=label)
        away = 1e3 * rows["y_m"] - np.interp(rows["p_m"], p, lateral_mm)
        distance.plot(rows["p_m"], away, color=color, linewidth=0.7)


def _draw_bars(axis: Axes, table: pd.DataFrame, names: Sequence[str]) -> None:
    """RMSE against the rails: mean (bar) and range (line) over the realisations."""
    place = np.arange(len(names))
    for shift, (kind, (color, label)) in zip((-0.2, 0.2), _LOOKS.items(), strict=True):
        group = table[table["preview"] == kind].groupby("controller")["rail_rmse_y"]
        values = 1e3 * group.agg(["mean", "min", "max"]).loc[list(names)]
        axis.barh(place + shift, values["mean"], 0.38, color=color, label=label)
        lines = axis.plot(values[["min", "max"]].T, [place + shift] * 2, color=figures.RED, linewidth=1.2)
    lines[0].set_label("range")
    axis.set_yticks(place, [figures.LOOKS[name].label for name in names])
    axis.invert_yaxis()
    axis.set_xlabel("RMSE against the rails (mm)")


def draw_knowledge(
    mean_of: pd.DataFrame, without: pd.DataFrame, names: Sequence[str], localisation_m: Sequence[float]
) -> Figure:
    """Draw the RMSE against the rails over the localisation error of the preview, and comfort number over that RMSE.

    `mean_of` has columns controller, error ("2 m", "half way", "line smooth over 10 m"), rail_rmse_y (m) and
    n_mv_floor_front (-); `without` has these two metrics, index controller, columns (metric, preview = "none");
    `names` are the controllers to draw, `localisation_m` the localisation errors (m).
    """
    fig, (axis, cost) = figures.new_figure(2, 1, height=2.1)
    places, none = [f"{error:g} m" for error in localisation_m], without.xs("none", axis=1, level="preview").loc[names]
    for name in names:
        look, rows = figures.LOOKS[name].line, mean_of[mean_of["controller"] == name].set_index("error")
        label, nothing = look["label"], none.loc[name]
        axis.plot(localisation_m, 1e3 * rows.loc[places, "rail_rmse_y"], **look)
        cost.plot(
            1e3 * rows["rail_rmse_y"], rows["n_mv_floor_front"], **figures.points(name, label=f"{label}, preview")
        )
        hollow = figures.points(name, markerfacecolor="white", label=f"{label}, no preview")
        cost.plot(1e3 * nothing["rail_rmse_y"], nothing["n_mv_floor_front"], **hollow)
    named = {"exact": places[0], "half way": "half way", "smooth": "line smooth over 10 m"}
    rows = mean_of[mean_of["controller"] == names[0]].set_index("error")
    for (text, error), apart in zip(named.items(), ((-24, -2), (5, -2), (-12, -10)), strict=True):
        where = 1e3 * rows.loc[error, "rail_rmse_y"], rows.loc[error, "n_mv_floor_front"]
        look = {"textcoords": "offset points", "fontsize": 7, "color": figures.LOOKS[names[0]].color}
        cost.annotate(text, where, apart, **look)
    distance = 1e3 * none["rail_rmse_y"]
    axis.axhspan(distance.min(), distance.max(), color="0.8", zorder=0)
    middle = float(np.mean(axis.get_xlim()))
    axis.annotate("without preview", (middle, distance.min()), (0, -9), fontsize=7, textcoords="offset points")
    axis.set(xlabel="error of the position on the track (m)", ylabel="RMSE against the rails (mm)", ylim=(0, None))
    axis.legend(loc="lower right")
    cost.legend(loc="upper right", handletextpad=0.2)
    cost.set(xlabel="RMSE against the rails (mm)", ylabel="comfort number $N_{MV}$ (-)")
    return fig
