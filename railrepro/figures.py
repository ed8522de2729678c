"""One look for all figures (data/style.toml), and files that come out byte-identical."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from string import ascii_lowercase
from typing import Annotated

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from railrepro import data as files
from railrepro import paths
from railrepro.data import Number, above
from railrepro.paths import Entries

WIDTH = 3.5
"""Width of a figure (in)."""
HALF = 1.9
"""Width of each of two columns of axes (in): labels of 7 pt are then 9 pixels high on a telephone."""
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    *("#000000", "#E69F00", "#56B4E9", "#009E73"),
    *("#F0E442", "#0072B2", "#D55E00", "#CC79A7"),
)
_DPI = 250
_FILE, _MATPLOTLIB = "data/style.toml", "matplotlib"


@files.table
class Look:
    """Look of a controller in every figure (data/style.toml): label of the legend, and properties of Matplotlib."""

    label: str
    color: str
    linestyle: files.Free
    marker: str
    linewidth: Annotated[Number, above(0.0, 10.0, "pt")] = 1.0

    @property
    def line(self) -> dict:
        """Keyword arguments for `Axes.plot` that draw a line: color, linestyle, linewidth (pt), label."""
        style = self.linestyle if isinstance(self.linestyle, str) else (self.linestyle[0], tuple(self.linestyle[1]))
        return {"color": self.color, "linestyle": style, "linewidth": self.linewidth, "label": self.label}


_content = files.read(paths.source(_FILE))
_SETTINGS = Entries({_MATPLOTLIB: _content.pop(_MATPLOTLIB)}, _FILE)
LOOKS = Entries(files.build(dict[str, Look], _content, "style.toml"), _FILE)
"""Controller, or "set point", -> `Look`."""
SETTING_MARKERS = {"paper": "o", "loop": "^"}
"""Setting of comparison -> marker, in figures whose colours tell controllers apart."""


def new_figure(rows: int = 1, columns: int = 1, height: float = 1.5, width: float = WIDTH, **options):
    """Pair (figure, axes) of `plt.subplots` (takes `options`) in a common style; row height, column width (in)."""
    mpl.rcParams.update(_SETTINGS[_MATPLOTLIB])
    figure, axes = plt.subplots(rows, columns, figsize=(width * columns, height * rows), **options)
    plt.close(figure)  # a notebook would show it at the end of the cell that begins it
    return figure, axes


def handles(axes: Iterable[Axes]) -> dict[str, Artist]:
    """Legend entries of several axes for a common legend: label -> artist, each label once."""
    return {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}


def points(name: str, **options) -> dict:
    """Keyword arguments for `Axes.plot`: markers without a line in the look `name` (key of `LOOKS`), and `options`."""
    look = LOOKS[name]
    dot = {"color": look.color, "marker": look.marker, "markersize": 7.0 if look.marker == "*" else 4.5}
    return dot | {"linestyle": "", "label": look.label} | options


def save_figure(figure: Figure, name: str, data: pd.DataFrame) -> None:
    """Write a figure to figures/NAME.png and its plotted `data` to figures/NAME.csv; a notebook also shows it.

    `name` is of the form figNN_name; columns of `data` have their unit in the name. Several panels get letters. Equal
    content gives equal bytes.
    """
    from IPython import get_ipython  # the library does without it
    from IPython.display import display

    _letter(figure)
    _fix_layout(figure)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=_DPI)
    # 64 colours take a quarter of the bytes; white stays white.
    reduced = Image.open(picture).convert("RGB").quantize(64, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.putpalette([255 if level > 250 else level for level in reduced.getpalette() or []])
    reduced.save(paths.product(f"figures/{name}.png"), optimize=True, dpi=(_DPI, _DPI))
    data.to_csv(paths.product(f"figures/{name}.csv"), index=False, float_format="%.9g")
    if get_ipython() is not None:
        display(figure)


def _letter(figure: Figure) -> None:
    """Letters a, b, … above the upper left corner of the panels, when there are several."""
    panels = [axis for axis in figure.axes if axis.get_visible() and axis.axison and axis.get_label() != "<colorbar>"]
    look = {"fontsize": 8, "fontweight": "bold", "ha": "right", "va": "bottom"}
    for letter, axis in zip(ascii_lowercase, panels if len(panels) > 1 else (), strict=False):
        axis.annotate(letter, (0, 1), (-3, 4), xycoords="axes fraction", textcoords="offset points", **look)


def _fix_layout(figure: Figure) -> None:
    """Lay a figure out once and round where its axes are: the last digits of a place depend on the processor."""
    dpi, figure.dpi = figure.dpi, _DPI
    figure.draw_without_rendering()
    figure.dpi = dpi
    figure.set_layout_engine("none")
    for axis in figure.axes:
        for which, original in (("original", True), ("active", False)):
            axis.set_position([round(edge, 9) for edge in axis.get_position(original).bounds], which)


def clip(axes: Iterable[Axes], low: float, high: float) -> None:
    """Limit the ordinate of each of `axes` to low ... high; if curves go beyond, a text there has the extreme value."""
    for axis in axes:
        lines = [line for line in axis.lines if line.get_transform() == axis.transData]
        values = np.concatenate([np.asarray(line.get_ydata(), float) for line in lines])
        axis.set_ylim(low, high)
        look = {"xycoords": "axes fraction", "fontsize": 6, "ha": "right", "color": "0.2"}
        look |= {"bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5}}
        if values.max() > high:
            axis.annotate(f"up to {values.max():.2g}", (1.0, 1.0), va="top", **look)
        if values.min() < low:
            axis.annotate(f"down to {values.min():.2g}", (1.0, 0.0), va="bottom", **look)


def mark(axes: Iterable[Axes], places: Mapping[float, str]) -> None:
    """Draw dotted vertical lines at `places` (abscissa -> name) in all `axes`; the names stand in the first of them."""
    for i, axis in enumerate(axes):
        for x, name in places.items():
            axis.axvline(x, color="0.4", linestyle=":", linewidth=0.7, zorder=0)
            if i == 0:
                place = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
                box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
                look = {"fontsize": 7, "color": "0.3", "rotation": 90, "va": "bottom", "bbox": box}
                axis.annotate(name, (x, 0.0), (2, 3), **place, **look)
