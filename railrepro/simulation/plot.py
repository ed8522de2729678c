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
    """Quantities of one running gear in a panel, by their names in `metrics.column`; the right wheel comes first."""

    label: str
    columns: tuple[str, ...]
    factor: float
    """Factor from SI units to the unit of the label."""
    reference: str = ""
    """Set point; "" for none."""


PANELS = {
    "y": Panel("lateral\nposition (mm)", ("y",), 1e3, "y_ref"),
    "error": Panel("lateral\nerror (mm)", ("error",), 1e3),
    "yaw": Panel("yaw\nangle (mrad)", ("psi_Ax",), 1e3),
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
    """Draw the quantities of each of `panels` over the track coordinate (m) into one of `axes`; the left wheel is
    paler. `series` is a table of `metrics.gear_series` for this `gear`; `look` has keyword arguments of `Axes.plot`."""
    p = series[metrics.column(gear, "p")]
    for axis, (_, (first, *second), factor, _) in zip(axes, panels, strict=True):
        for column in second:
            axis.plot(p, factor * series[metrics.column(gear, column)], **{**look, "alpha": 0.4, "label": None})
        axis.plot(p, factor * series[metrics.column(gear, first)], **look)


def draw_set_points(axes: Sequence[Axes], panels: Sequence[Panel], series: pd.DataFrame, gear: str) -> None:
    """Draw the set points of a run, such as y* in the panel of y, into its panels; the arguments are as in `draw`."""
    for axis, panel in zip(axes, panels, strict=True):
        if panel.reference:
            y = panel.factor * series[metrics.column(gear, panel.reference)]
            axis.plot(series[metrics.column(gear, "p")], y, **figures.LOOKS["set point"].line)


def name_axes(figure: Figure, axes: np.ndarray, panels: Sequence[Panel]) -> None:
    """Label the array `axes` (rows, columns), whose first rows show `panels`, and give the figure a legend."""
    for row, panel in zip(axes, panels, strict=False):
        row[0].set_ylabel(panel.label)
    for axis in axes[len(panels) - 1]:
        axis.set_xlabel("track coordinate (m)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=2, loc="outside upper center")


def figure_of(series: pd.DataFrame, names: Sequence[str], gear: str) -> Figure:
    """Draw `simulate.Run.series` in a new figure with a row per panel, a key of `PANELS` ("y", "error", "du", …)."""
    panels, rows = chosen(names), metrics.gear_series(series, gear)
    figure, axes = figures.new_figure(len(panels), sharex=True, squeeze=False)
    draw(axes[:, 0], panels, rows, {"color": figures.BLUE, "label": f"{gear} running gear"}, gear)
    draw_set_points(axes[:, 0], panels, rows, gear)
    name_axes(figure, axes, panels)
    return figure
