"""One look for all figures, and files that come out byte-identical.

Colours are Okabe-Ito's, fixed by meaning and doubled by line style, so that figures stay readable in grey.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import matplotlib as mpl
import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from railrepro import paths

WIDTH = 3.5
"""Width of a column (in)."""
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    *("#000000", "#E69F00", "#56B4E9", "#009E73"),
    *("#F0E442", "#0072B2", "#D55E00", "#CC79A7"),
)
_DPI = 250
BROWN = "#8C6D31"
CONTROLLER_STYLE = {
    "set point": {"color": BLACK, "linestyle": ":", "linewidth": 1.2, "label": "set point"},
    "nmpc": {"color": BLUE, "linestyle": "-", "linewidth": 1.0, "label": "NMPC"},
    "nmpc_observer": {"color": GREEN, "linestyle": "-", "linewidth": 0.8, "label": "NMPC, offset observer"},
    "ltv_mpc": {"color": ORANGE, "linestyle": "--", "linewidth": 1.0, "label": "LTV-MPC"},
    "ltv_mpc_printed": {
        "color": PURPLE,
        "linestyle": (0, (1, 1)),
        "linewidth": 1.0,
        "label": "LTV-MPC as printed",
    },
    "ndi": {"color": RED, "linestyle": "-.", "linewidth": 1.0, "label": "NDI"},
    "ndi_feedforward": {
        "color": BROWN,
        "linestyle": (0, (5, 1, 1, 1)),
        "linewidth": 1.0,
        "label": "NDI, set-point rates",
    },
    "ndi_integral": {"color": SKY, "linestyle": (0, (3, 1)), "linewidth": 1.0, "label": "NDI, rates and integral"},
    "creep_mpc": {"color": BLACK, "linestyle": "-", "linewidth": 1.2, "label": "CreepMPC (ours)"},
}
_STYLE = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 8,
    "axes.labelsize": 8,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.linewidth": 0.3,
    "grid.alpha": 0.5,
    "lines.linewidth": 1.0,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "railrepro",
    "svg.fonttype": "path",
    "pdf.compression": 9,
}


def new_figure(rows: int = 1, columns: int = 1, height: float = 1.5, width: float = WIDTH, **options):
    """Figure and axes in the common style; `height` is that of one row (in)."""
    mpl.rcParams.update(_STYLE)
    figure, axes = plt.subplots(rows, columns, figsize=(width * columns, height * rows), **options)
    plt.close(figure)  # a notebook would show it at the end of the cell that begins it
    return figure, axes


def save_figure(figure: Figure, name: str, data: pd.DataFrame) -> None:
    """Write figures/NAME as pdf, svg and png, and the plotted data as csv, and show it in a notebook.

    Equal content gives equal bytes.

    Parameters
    ----------
    figure : Figure
    name : str
        figNN_name.
    data : DataFrame
        What is plotted, tidy, units in the column names.
    """
    from IPython import get_ipython  # the library does without it
    from IPython.display import display

    metadata = {
        "pdf": {"CreationDate": None, "ModDate": None},
        "svg": {"Date": None},
        "png": {"Software": None},
    }
    _fix_layout(figure)
    for suffix, entries in metadata.items():
        figure.savefig(paths.product(f"figures/{name}.{suffix}"), dpi=_DPI, metadata=entries)
    data.to_csv(paths.product(f"figures/{name}.csv"), index=False, float_format="%.9g")
    if get_ipython() is not None:
        display(figure)


def _fix_layout(figure: Figure) -> None:
    """Lay a figure out once and round where its axes are: ids in SVG files are hashes of all digits of a place, and the
    last ones depend on the processor."""
    dpi, figure.dpi = figure.dpi, _DPI
    figure.draw_without_rendering()
    figure.dpi = dpi
    figure.set_layout_engine("none")
    for axis in figure.axes:
        for which, original in (("original", True), ("active", False)):
            axis.set_position([round(edge, 9) for edge in axis.get_position(original).bounds], which)


def mark(axes: Iterable[Axes], places: Mapping[float, str]) -> None:
    """Dotted vertical lines at coordinates through all axes, their names at the top of the first, upright."""
    for i, axis in enumerate(axes):
        for x, name in places.items():
            axis.axvline(x, color="0.4", linestyle=":", linewidth=0.7, zorder=0)
            if i == 0:
                place = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
                box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
                look = {"fontsize": 7, "color": "0.3", "rotation": 90, "va": "bottom", "bbox": box}
                axis.annotate(name, (x, 0.0), (2, 3), **place, **look)
