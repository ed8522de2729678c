"""The overview: every verdict is drawn where it belongs, statements by short names."""

import pandas as pd
from matplotlib import pyplot as plt

from railrepro.evidence.report import overview

CLAIMS = pd.DataFrame(
    [("C03", "statement", "paper", "reproduced"), ("C03", "statement", "loop", "not reproduced"),
     ("C13", "statement", None, "partly"), ("C06", "statement", "loop", "tie"),
     ("C12", "statement", "paper", "fragile"), ("C43", "calibrated", None, "not testable")],
    columns=["id", "kind", "setting", "judged"],
)  # fmt: skip


def test_verdicts_stand_in_the_row_of_the_statement_and_the_column_of_the_setting():
    figure = overview.verdicts(CLAIMS)
    axes = figure.axes[0]
    drawn = {tuple(float(v[0]) for v in line.get_data()): line.get_marker() for line in axes.lines}
    assert drawn == {(0, 0): "o", (2, 0): "x", (3, 1): "o", (2, 2): "$=$", (0, 3): "o"}
    assert [label.get_text() for label in axes.get_yticklabels()] == list(
        overview.short_names()[["C03", "C13", "C06", "C12"]]
    )
    shown = [text.get_text() for text in figure.legends[0].texts]
    assert shown == ["reproduced", "fragile", "partly", "tie", "not reproduced"]
    hollow = [line.get_ydata()[0] for line in axes.lines if line.get_markerfacecolor() == "white"]
    assert hollow == [3]
    plt.close(figure)
