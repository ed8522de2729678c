"""How far the car agrees with the second opinion on it, as a figure of data/results/second_opinion.csv.

Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure

from railrepro.evidence.report import figures

AGREEMENT = 0.01
"""Difference relative to the largest value of a signal that counts as agreement (-)."""


def draw(table: pd.DataFrame) -> Figure:
    """Relative differences of data/results/second_opinion.csv by case and quantity, hollow at the car's usual step
    of 1 ms, filled at the short step.
    """
    figure, axes = figures.new_figure(height=3.0)
    cases, colors = (
        list(table["case"].unique()),
        (figures.BLUE, figures.SKY, figures.GREEN, figures.PURPLE, figures.RED, figures.BLACK),
    )
    for (quantity, rows), color, marker in zip(table.groupby("quantity", sort=False), colors, "osvD^x", strict=False):
        place = rows["case"].map(cases.index)
        usual = rows["car_step_ms"].astype(float) == 1
        for chosen, face, label in ((usual, "none", None), (~usual, color, quantity)):
            look = {"markersize": 4, "markeredgewidth": 0.7, "color": color, "markerfacecolor": face}
            axes.plot(rows["relative"][chosen], place[chosen], marker, **look, label=label)
    axes.axvline(AGREEMENT, color=figures.BLACK, linestyle=":", linewidth=0.8, label=f"agreement, {AGREEMENT:.0%}")
    short = table["car_step_ms"].astype(float).min()
    for face, step in (("0.3", short), ("none", 1)):
        look = {"color": "0.3", "markerfacecolor": face, "markersize": 4, "markeredgewidth": 0.7}
        axes.plot([], [], "o", **look, label=f"car at steps of {step:g} ms")
    axes.set(xscale="log", xlabel="largest difference / largest value (-)", yticks=range(len(cases)), yticklabels=cases)
    axes.invert_yaxis()
    figure.legend(loc="outside lower center", ncols=2)
    return figure
