"""Overview of the verdicts as a figure: statement by setting of comparison."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd
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
    """Name of each statement of data/claims.toml in a few words, by id (data/statement_names.csv)."""
    return pd.read_csv(paths.source("data/statement_names.csv")).set_index("id")["short"]


def named(identities: Iterable[str]) -> list[str]:
    """Short names of statements; the id of one that has none."""
    names = short_names()
    return [str(names.get(identity, identity)) for identity in identities]


def over_poles(table: pd.DataFrame) -> Figure:
    """Verdicts on statements over the poles of NDI, from poles, id, verdict of data/results/pole_verdicts.csv."""
    rows, columns = (list(dict.fromkeys(table[name].astype(str))) for name in ("id", "poles"))
    figure, axes = figures.new_figure(height=0.16 * len(rows) + 0.9)
    for row in table.itertuples():
        axes.plot(columns.index(str(row.poles)), rows.index(row.id), **_DOT | _MARKS[row.verdict])
    axes.set_yticks(range(len(rows)), named(rows), fontsize=6.5)
    axes.set_xticks(range(len(columns)), [column.replace("swarm", "\nswarm") for column in columns])
    axes.set(xlabel="triple pole of NDI (rad/s)", ylim=(len(rows) - 0.4, -0.6))
    _legend(figure, set(table["verdict"]))
    return figure


def verdicts(claims: pd.DataFrame) -> Figure:
    """Verdict on each statement by setting; what no tuned controller enters has one verdict in a column of its own.

    From id, kind, setting, judged of data/results/claims.csv.
    """
    judged = claims[claims["kind"] == "statement"].assign(setting=claims["setting"].fillna(""))
    columns = [*tuning.SETTINGS, ""]
    rows = list(dict.fromkeys(judged["id"]))
    figure, axes = figures.new_figure(height=0.13 * len(rows) + 0.7)
    for (identity, setting), group in judged.groupby(["id", "setting"], sort=False):
        axes.plot(columns.index(setting), rows.index(identity), **_DOT | _MARKS[group["judged"].iloc[0]])
    axes.set_yticks(range(len(rows)), named(rows), fontsize=6.5)
    axes.set_xticks(range(len(columns)), [*tuning.SETTINGS, "independent\nof setting"])
    axes.xaxis.tick_top()
    axes.set(xlim=(-0.5, len(columns) - 0.5), ylim=(len(rows) - 0.4, -0.6))
    axes.tick_params(length=0)
    _legend(figure, set(judged["judged"]))
    return figure


def _legend(figure: Figure, used: set[str]) -> None:
    """Legend of the verdicts that are shown."""
    handles = [Line2D([], [], label=name, **_DOT | look) for name, look in _MARKS.items() if name in used]
    figure.legend(handles=handles, ncols=5, loc="outside lower center", handletextpad=0.2, columnspacing=1.0)
