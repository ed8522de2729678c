"""Figures of one style (data/style.toml), whose files are byte-identical when their content is."""

import io
from collections.abc import Iterable, Mapping, Sequence
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

WIDTH = 3.5
"""Width of a figure (in)."""
HALF = 1.9
"""Width of each of two columns of axes (in). Labels of 7 pt are then 9 pixels high on a telephone."""
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, RED, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
_DPI = 250


@files.table
class Look:
    """Label, colour, line and marker of a controller in all figures: an entry of data/style.toml, for Matplotlib."""

    label: str
    color: str
    linestyle: files.Free
    marker: str
    linewidth: Annotated[files.Number, files.above(0.0, 10.0, "pt")] = 1.0

    @property
    def line(self) -> dict:
        """Keyword arguments of Matplotlib's `Axes.plot` for a line: colour, style, width and label."""
        style = self.linestyle if isinstance(self.linestyle, str) else (self.linestyle[0], tuple(self.linestyle[1]))
        return {"color": self.color, "linestyle": style, "linewidth": self.linewidth, "label": self.label}


_content = files.read(paths.source("data/style.toml"))
_SETTINGS = paths.Entries({"matplotlib": _content.pop("matplotlib")}, "data/style.toml")
LOOKS = paths.Entries(files.build(dict[str, Look], _content, "style.toml"), "data/style.toml")
"""Name of a controller, or "set point" -> its `Look`."""
SETTING_MARKERS = {"paper": "o", "loop": "^"}
"""Setting of comparison -> marker, in figures whose colours distinguish controllers."""


def new_figure(rows: int = 1, columns: int = 1, height: float = 1.5, width: float = WIDTH, **options):
    """Return (figure, axes) of `plt.subplots`, which takes `options`. Row height and column width are in inches."""
    mpl.rcParams.update(_SETTINGS["matplotlib"])
    figure, axes = plt.subplots(rows, columns, figsize=(width * columns, height * rows), **options)
    plt.close(figure)  # or a notebook would show it twice
    return figure, axes


def handles(axes: Iterable[Axes]) -> dict[str, Artist]:
    """Collect the labelled curves of several axes for one common legend: label -> artist."""
    return {label: handle for axis in axes for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}


def points(name: str, **options) -> dict:
    """Keyword arguments of `Axes.plot` for markers without a line: the look of controller `name`, then `options`."""
    look = LOOKS[name]
    dot = {"color": look.color, "marker": look.marker, "markersize": 7.0 if look.marker == "*" else 4.5}
    return dot | {"linestyle": "", "label": look.label} | options


def figure_number(name: str) -> str:
    """Number of a figure, "6" of "fig06_curve_entry" (paper), "6.1" of "fig0601_preview", one more of chapter 06."""
    digits = name.removeprefix("fig").split("_")[0]
    return ".".join(str(int(digits[i : i + 2])) for i in range(0, len(digits), 2))


def save_figure(figure: Figure, name: str, data: pd.DataFrame) -> None:
    """Write a figure to figures/NAME.png and its plotted data, whose columns have their unit in the name, to
    figures/NAME.csv. Several panels get letters a, b, …. In a notebook the figure is shown."""
    from IPython import get_ipython  # not installed with the library
    from IPython.display import display

    _letter(figure)
    _fix_layout(figure)
    picture = io.BytesIO()
    figure.savefig(picture, dpi=_DPI)
    # 64 colours need a quarter of the bytes. White stays white.
    reduced = Image.open(picture).convert("RGB").quantize(64, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    reduced.putpalette([255 if level > 250 else level for level in reduced.getpalette() or []])
    reduced.save(paths.product(f"figures/{name}.png"), optimize=True, dpi=(_DPI, _DPI))
    data.to_csv(paths.product(f"figures/{name}.csv"), index=False, float_format="%.9g")
    if get_ipython() is not None:
        display(figure)


def _letter(figure: Figure) -> None:
    """Write letters a, b, … above the upper left corners of several panels."""
    panels = [axis for axis in figure.axes if axis.get_visible() and axis.axison and axis.get_label() != "<colorbar>"]
    look = {"fontsize": 8, "fontweight": "bold", "ha": "right", "va": "bottom"}
    for letter, axis in zip(ascii_lowercase, panels if len(panels) > 1 else (), strict=False):
        axis.annotate(letter, (0, 1), (-3, 4), xycoords="axes fraction", textcoords="offset points", **look)


def _fix_layout(figure: Figure) -> None:
    """Compute the layout and round the positions of the axes, as their last digits depend on the processor."""
    dpi, figure.dpi = figure.dpi, _DPI
    figure.draw_without_rendering()
    figure.dpi = dpi
    figure.set_layout_engine("none")
    for axis in figure.axes:
        for which, original in (("original", True), ("active", False)):
            axis.set_position([round(edge, 9) for edge in axis.get_position(original).bounds], which)


def clip(axes: Iterable[Axes], low: float, high: float) -> None:
    """Limit the ordinate of each of `axes` to low … high; write the extremes of its curves beyond that above it."""
    for axis in axes:
        lines = [line for line in axis.lines if line.get_transform() == axis.transData]
        values = np.concatenate([np.asarray(line.get_ydata(), float) for line in lines])
        axis.set_ylim(low, high)
        beyond = {"up to": (values.max(), values.max() > high), "down to": (values.min(), values.min() < low)}
        notes = [f"{word} {value:.2g}" for word, (value, outside) in beyond.items() if outside]
        look = {"xycoords": "axes fraction", "fontsize": 6.5, "ha": "right", "va": "bottom", "color": "0.2"}
        if notes:
            axis.annotate(", ".join(notes).replace("-", "\N{MINUS SIGN}"), (1.0, 1.02), **look)


def mark(axes: Sequence[Axes], names: Mapping[float, str]) -> None:
    """Draw dotted vertical lines at the abscissas in `names` in all `axes`, and write the names in the first."""
    look = {"fontsize": 7, "color": "0.3", "rotation": 90, "va": "bottom", "textcoords": "offset points"}
    look |= {"bbox": {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}}
    for x, name in names.items():
        for axis in axes:
            axis.axvline(x, color="0.4", linestyle=":", linewidth=0.7, zorder=0)
        axes[0].annotate(name, (x, 0.0), (2, 3), xycoords=("data", "axes fraction"), **look)
