"""The leaderboard as a figure."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from railrepro.evidence.report import figures
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import NOTHING


def leaderboard(table: pd.DataFrame, own: str = "") -> Figure:
    """Scores of all controllers on both settings of the benchmark, best mean first.

    Parameters
    ----------
    table : DataFrame
        data/results/leaderboard.csv.
    own : str
        A controller that is no example.
    """
    ranked = card.ranking(table, suite.draws().published)
    place = np.arange(len(ranked))
    figure, axes = figures.new_figure(height=0.2 * len(ranked) + 0.8)
    axes.barh(place, ranked["ranked"].fillna(ranked["published"]), 0.6, color="0.85", label="score (mean)")
    for setting, face in (("equal", "white"), ("loop", "black")):
        look = {"marker": figures.SETTING_MARKERS[setting], "markerfacecolor": face, "markeredgecolor": "black"}
        axes.plot(ranked[setting], place, linestyle="", markersize=4.5, label=f"setting {setting}", **look)
    labels = {name: look.label for name, look in figures.LOOKS.items()} | {NOTHING: "no control", own: own}
    axes.set_yticks(place, [labels.get(name, f"{name} (example)") for name in ranked.index])
    axes.invert_yaxis()
    axes.set(xlabel="points of 100", xlim=(0, max(60.0, 1.05 * ranked[["equal", "loop"]].max().max())))
    figure.legend(ncols=3, loc="outside upper center", handletextpad=0.4, columnspacing=1.2)
    return figure
