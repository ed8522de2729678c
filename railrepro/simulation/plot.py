"""Panels of runs over the track coordinate, as the chapters draw them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from railrepro import figures
from railrepro.data import InputError
from railrepro.simulation import metrics


class Panel(NamedTuple):
    """Panel of a plot: `label`; names of the quantities of a gear in it, as "y", or "ri.tau" of the right wheel, which
    comes first; `factor` from SI units to the unit of the label; `reference`, name of the set point, "" for none."""

    label: str
    columns: tuple[str, ...]
    factor: float
    reference: str = ""


PANELS = {
    "y": Panel("lateral\nposition (mm)", ("y",), 1e3, "y_ref"),
    "error": Panel("lateral\nerror (mm)", ("error",), 1e3),
    "yaw": Panel("absolute yaw\nangle (mrad)", ("psi_Ax",), 1e3),
    "heading": Panel("yaw against\ntrack (mrad)", ("psi_TrAx",), 1e3),
    "creep": Panel("creep\nangle (mrad)", ("creep_angle",), 1e3),
    "du": Panel("differential\ntorque (N m)", ("du",), 1.0),
    "torque": Panel("right motor\ntorque (N m)", ("ri.tau",), 1.0),
    "torques": Panel("motor\ntorques (kN m)", ("ri.tau", "le.tau"), 1e-3),
    "adhesion": Panel("adhesion (-)", ("ri.adhesion", "le.adhesion"), 1.0, "f_star"),
    "slip": Panel("slip (‰)", ("ri.sx", "le.sx"), -1e3),
    "speed": Panel("speed (km/h)", ("v",), 3.6),
}


def chosen(names: Sequence[str]) -> list[Panel]:
    """Look up panels in `PANELS` by name. InputError for an unknown name, or for none."""
    unknown = [name for name in names if name not in PANELS]
    if unknown or not names:
        fault = f"panel {unknown[0]!r} is not known" if unknown else "no panel is named"
        raise InputError(f"{fault}; there are {list(PANELS)}")
    return [PANELS[name] for name in names]


def draw(axes: Sequence[Axes], panels: Sequence[Panel], series: pd.DataFrame, look: Mapping, gear: str) -> None:
    """Draw one run over the track coordinate (m) into existing axes, one of `panels` in each; the left wheel is paler.
    `series` is the table from `metrics.gear_series` for `gear`, "front" or "rear"; `look` has keywords of
    `Axes.plot`."""
    p = series[metrics.column(gear, "p")]
    for axis, (_, (first, *second), factor, _) in zip(axes, panels, strict=True):
        for column in second:
            axis.plot(p, factor * series[metrics.column(gear, column)], **{**look, "alpha": 0.4, "label": None})
        axis.plot(p, factor * series[metrics.column(gear, first)], **look)


def draw_set_points(axes: Sequence[Axes], panels: Sequence[Panel], series: pd.DataFrame, gear: str) -> None:
    """Draw the set point of each of `panels` that has one, such as y* for y, into its axes. `series` is the table of
    one run from `metrics.gear_series` for `gear`; the first of `panels` belongs to the first of `axes`, and so on."""
    for axis, panel in zip(axes, panels, strict=True):
        if panel.reference:
            y = panel.factor * series[metrics.column(gear, panel.reference)]
            axis.plot(series[metrics.column(gear, "p")], y, **figures.LOOKS["set point"].line)


def name_axes(figure: Figure, axes: np.ndarray, panels: Sequence[Panel]) -> None:
    """Label `axes`, shape (rows, columns), whose first rows show one of `panels` each; add a legend to the figure."""
    for row, panel in zip(axes, panels, strict=False):
        row[0].set_ylabel(panel.label)
    for axis in axes[len(panels) - 1]:
        axis.set_xlabel("track coordinate (m)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=2, loc="outside upper center")


def figure_of(series: pd.DataFrame, names: Sequence[str], gear: str) -> Figure:
    """Draw a gear of a run, whose table is `series`, in a new figure; `names` are keys of `PANELS`, one per row."""
    panels, rows = chosen(names), metrics.gear_series(series, gear)
    figure, axes = figures.new_figure(len(panels), sharex=True, squeeze=False)
    draw(axes[:, 0], panels, rows, {"color": figures.BLUE, "label": f"{gear} running gear"}, gear)
    draw_set_points(axes[:, 0], panels, rows, gear)
    name_axes(figure, axes, panels)
    return figure
