"""Figures of all verdicts: statement by setting of comparison, and statement by poles of NDI."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from railrepro import paths
from railrepro.evidence.claims.statements import NOT, PARTLY, REPRODUCED, TIE, UNTESTABLE
from railrepro.evidence.report import figures
from railrepro.evidence.report.claims import FRAGILE
from railrepro.evidence.runs import tuning

_DOT = {"linestyle": "", "markersize": 4.5}
_MARKS = {
    REPRODUCED: {"marker": "o", "markerfacecolor": figures.BLUE, "markeredgecolor": figures.BLUE},
    FRAGILE: {"marker": "o", "markerfacecolor": "white", "markeredgecolor": figures.BLUE},
    PARTLY: {"marker": "o", "fillstyle": "left", "markerfacecoloralt": "white", "color": figures.BLUE},
    TIE: {"marker": "$=$", "markeredgecolor": figures.BLACK, "markerfacecolor": figures.BLACK, "markeredgewidth": 0.3},
    NOT: {"marker": "x", "markeredgecolor": figures.RED, "markeredgewidth": 1.2},
    UNTESTABLE: {"marker": "_", "markeredgecolor": "0.5"},
}


def short_names() -> pd.Series:
    """Short name of each statement of data/claims.toml, indexed by its id (data/statement_names.csv)."""
    return pd.read_csv(paths.source("data/statement_names.csv")).set_index("id")["short"]


def over_poles(table: pd.DataFrame) -> Figure:
    """Draw verdicts by statement and NDI's triple pole; columns id, poles (rad/s or text), verdict (`claims.ORDER`)."""
    figure, axes = _marks(table["id"], table["poles"].astype(str), table["verdict"], 0.16, 0.9)
    poles = table["poles"].astype(str).unique()
    axes.set_xticks(range(len(poles)), [pole.replace("swarm", "\nswarm") for pole in poles])
    axes.set_xlabel("triple pole of NDI (rad/s)")
    return figure


def verdicts(claims: pd.DataFrame) -> Figure:
    """Draw the verdict on each statement by setting of comparison, with a column for those independent of the setting.

    `claims` has columns id, kind, setting, judged, as data/results/claims.csv.
    """
    judged = claims[claims["kind"] == "statement"].fillna({"setting": ""})
    figure, axes = _marks(judged["id"], judged["setting"], judged["judged"], 0.13, 0.7, [*tuning.SETTINGS, ""])
    axes.set_xticks(range(4), [*tuning.SETTINGS, "independent\nof setting"])
    axes.xaxis.tick_top()
    axes.set_xlim(-0.5, 3.5)
    axes.tick_params(length=0)
    return figure


def _marks(
    ids: pd.Series, columns: pd.Series, judged: pd.Series, height: float, around: float, order: Sequence[str] = ()
) -> tuple[Figure, Axes]:
    """Mark each verdict in the row of its statement; height of a row and of what is around them (in)."""
    rows, order = list(ids.unique()), list(order or columns.unique())
    figure, axes = figures.new_figure(height=height * len(rows) + around)
    for identity, column, verdict in zip(ids, columns, judged, strict=True):
        axes.plot(order.index(column), rows.index(identity), **_DOT | _MARKS[verdict])
    axes.set_yticks(
        range(len(rows)), short_names().reindex(rows).fillna(dict(zip(rows, rows, strict=True))), fontsize=6.5
    )
    axes.set_ylim(len(rows) - 0.4, -0.6)
    shown = [Line2D([], [], label=name, **_DOT | look) for name, look in _MARKS.items() if name in set(judged)]
    figure.legend(handles=shown, ncols=5, loc="outside lower center", handletextpad=0.2, columnspacing=1.0)
    return figure, axes
