"""The non-implausible region of history matching, in pairs of directions: parameters consistent with the paper."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from zlib import crc32

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from railrepro.errors import InputError
from railrepro.evidence.report import figures
from railrepro.evidence.runs.pso import Dimension
from railrepro.evidence.uncertainty.matching import choice, names_of_choice
from railrepro.vehicle.parameters import describe

_BINS = 10


def draw(
    survivors: pd.DataFrame, region: pd.DataFrame, dimensions: Sequence[Dimension],
    marked: Mapping[str, Mapping[str, float]] | None = None, count: int = 5,
) -> tuple[Figure, pd.DataFrame]:  # fmt: skip
    """Pairs of the narrowest directions; each panel spans the whole prior, points are non-implausible.

    The diagonal shows the density of the non-implausible points over that of the prior (dashed).

    Parameters
    ----------
    survivors : DataFrame
        data/results/matching_survivors.csv: one column per dimension.
    region : DataFrame
        data/results/matching_region.csv: what, narrowing.
    dimensions : sequence of Dimension
        The prior, `railrepro.evidence.uncertainty.matching.dimensions()`.
    marked : mapping, optional
        Name -> values by dimension of a point to be marked, such as the best run; at most three.
    count : int
        How many directions.

    Returns
    -------
    Figure, DataFrame
        The figure, and the plotted points.

    Raises
    ------
    InputError
        When the region is empty, or a table has another dimension.
    """
    prior = {dimension.name: dimension for dimension in dimensions}
    names = [str(name) for name in region.sort_values("narrowing", ascending=False, kind="stable")["what"].head(count)]
    missing = [name for name in names if name not in prior or name not in survivors]
    if missing or survivors.empty:
        raise InputError(
            f"the region has the direction {missing[0]!r}, which prior or survivors do not have"
            if missing
            else "the non-implausible region is empty, there is nothing to draw"
        )
    figure, axes = figures.new_figure(len(names), len(names), height=1.25, width=1.3, squeeze=False)
    for i, row in enumerate(names):
        for j, column in enumerate(names):
            axis = axes[i, j]
            if j > i:
                axis.set_visible(False)
            elif i == j:
                _density(axis, survivors[row], prior[row])
            else:
                _pair(axis, survivors, prior[column], prior[row], marked or {})
            axis.set_xlabel(_label(prior[column]) if i == len(names) - 1 else "")
            axis.set_ylabel("density (-)" if i == j else _label(prior[row]) if j == 0 else "")
            axis.tick_params(labelbottom=i == len(names) - 1, labelleft=j == 0 and i > 0)
    _legend(figure, axes)
    return figure, survivors[names]


def _legend(figure: Figure, axes: np.ndarray) -> None:
    """One entry for each thing drawn, in the empty corner."""
    panels = (axes[0, 0], axes[1, 0]) if len(axes) > 1 else (axes[0, 0],)
    entries = [axis.get_legend_handles_labels() for axis in panels]
    handles, labels = ([item for entry in entries for item in entry[i]] for i in (0, 1))
    figure.legend(handles, labels, loc="upper right")


def _label(dimension: Dimension) -> str:
    """Name of a direction in short lines; the names of a choice stand at the axis."""
    name = dimension.name.rpartition(" (")[0] if _choices(dimension) else dimension.name
    words = (name or dimension.name).replace(".", ": ").replace("_", " ")
    return textwrap.fill(words if _choices(dimension) or "(" in words else f"{words} ({_unit(dimension)})", 18)


def _unit(dimension: Dimension) -> str:
    """Unit of a parameter of the car; ratios have none."""
    entries = describe().set_index("key")["unit"]
    return str(entries.get(dimension.name, "-"))


def _pair(axis: Axes, survivors: pd.DataFrame, x: Dimension, y: Dimension, marked: Mapping[str, Mapping]) -> None:
    look = {"markersize": 1.8, "markeredgewidth": 0, "alpha": 0.5, "color": figures.BLUE, "label": "non-implausible"}
    axis.plot(_spread(survivors, x), _spread(survivors, y), "o", **look)
    for (name, point), marker in zip(marked.items(), "*Ds", strict=False):
        if x.name in point and y.name in point:
            look = {"color": figures.BLACK, "markersize": 7, "markeredgecolor": "white", "markeredgewidth": 0.5}
            axis.plot(point[x.name], point[y.name], marker, label=name, clip_on=False, **look)
    _span(axis, x, "x")
    _span(axis, y, "y")


def _choices(dimension: Dimension) -> list[str]:
    """Names of a choice of two; nothing for a range."""
    return names_of_choice(dimension.name) if choice(dimension) else []


def _spread(survivors: pd.DataFrame, dimension: Dimension) -> np.ndarray:
    """Values; those of a choice lie side by side, not on top of each other."""
    values = survivors[dimension.name].to_numpy(dtype=float)
    generator = np.random.default_rng(crc32(dimension.name.encode()))
    return values + generator.uniform(-0.3, 0.3, len(values)) if _choices(dimension) else values


def _density(axis: Axes, values: pd.Series, dimension: Dimension) -> None:
    """Density over that of the prior, which is uniform in the dimension's own scale."""
    scaled = np.log if dimension.scale == "log" else np.asarray
    low, high, bins = dimension.low, dimension.high, _BINS
    if _choices(dimension):
        low, high, bins = low - 0.5, high + 0.5, 2
    edges = np.linspace(scaled(low), scaled(high), bins + 1)
    share = np.histogram(scaled(values), edges)[0] * bins / len(values)
    shown = np.exp(edges) if dimension.scale == "log" else edges
    axis.stairs(share, shown, fill=True, color=figures.SKY, label="density relative to the prior")
    axis.axhline(1.0, color=figures.BLACK, linestyle="--", linewidth=0.7, label="the prior")
    axis.set_ylim(0, max(2.0, 1.1 * share.max()))
    axis.yaxis.tick_right()
    axis.yaxis.set_label_position("right")
    axis.tick_params(labelright=True)
    _span(axis, dimension, "x")


def _span(axis: Axes, dimension: Dimension, of: str) -> None:
    """Scale and limits of an axis: the whole prior; names at the places of a choice."""
    names = _choices(dimension)
    margin = 0.5 if names else 0.0
    axis.set(
        **{f"{of}scale": "log" if dimension.scale == "log" else "linear"},
        **{f"{of}lim": (dimension.low - margin, dimension.high + margin)},
    )
    if names:
        axis.set(**{f"{of}ticks": [dimension.low, dimension.high], f"{of}ticklabels": names})
