"""Figures come out byte-identical, and changed curves are found."""

import pandas as pd
import pytest

from railrepro.evidence.chain import chain, compare
from railrepro.evidence.report import figures, overview


@pytest.mark.parametrize(("shift", "outcome"), [(0.0, "same"), (1e-6, "within tolerance"), (0.01, "different")])
def test_equal_figures_give_equal_bytes_and_a_moved_curve_is_found(tmp_path, monkeypatch, shift, outcome):
    for folder, moved in (("old", 0.0), ("new", shift)):
        monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path / folder))
        fig, axis = figures.new_figure()
        axis.plot([0, 1], [0.2 + moved, 0.7 + moved], **figures.LOOKS["nmpc"].line)
        axis.set(ylim=(0, 1))
        figures.save_figure(fig, "fig99_test", pd.DataFrame({"x": [0.0, 1.0], "y": [0.2 + moved, 0.7 + moved]}))
    pairs = [[tmp_path / folder / f"figures/fig99_test.{kind}" for folder in ("old", "new")] for kind in ("csv", "png")]
    table, image = (compare.compare(old, new, chain.tolerance()) for old, new in pairs)
    assert (table["outcome"] == outcome).sum() == (4 if outcome == "same" else 2)
    assert image["outcome"].item() in ({"same", outcome} if outcome == "within tolerance" else {outcome})
    assert shift or all(old.read_bytes() == new.read_bytes() for old, new in pairs)


def test_a_chapter_depends_on_the_looks_that_it_takes(tmp_path, monkeypatch):
    monkeypatch.setenv("RAILREPRO_READS", str(tmp_path / "log"))
    figures.new_figure()
    assert figures.LOOKS["ndi"].color == "#D55E00" and figures.points("nmpc")["marker"] == "o"
    taken = {f"data/style.toml\t{name}" for name in ("matplotlib", "ndi", "nmpc")}
    assert set((tmp_path / "log").read_text().splitlines()) == taken


def test_what_a_panel_cuts_off_is_written_on_it():
    _, (low, high) = figures.new_figure(2, 1)
    low.plot([0, 1], [0.0, 3.0])
    high.plot([0, 1], [-7.0, 40.0])
    high.axvline(99.0)
    figures.clip([low, high], -5.0, 5.0)
    assert [text.get_text() for text in low.texts] == []
    assert [text.get_text() for text in high.texts] == ["up to 40", "down to -7"]
    assert low.get_ylim() == high.get_ylim() == (-5.0, 5.0)


def test_verdicts_stand_in_the_row_of_the_statement_and_the_column_of_the_setting():
    rows = [("C03", "paper", "reproduced"), ("C03", "loop", "not reproduced"), ("C13", None, "partly")]
    claims = pd.DataFrame([*rows, ("C12", "paper", "fragile")], columns=["id", "setting", "judged"])
    axes = overview.verdicts(claims.assign(kind="statement")).axes[0]
    drawn = {tuple(line.get_xydata()[0]): line.get_marker() for line in axes.lines}
    assert drawn == {(0, 0): "o", (2, 0): "x", (3, 1): "o", (0, 2): "o"}
    hollow = [line.get_ydata()[0] for line in axes.lines if line.get_markerfacecolor() == "white"]
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert hollow == [2] and names == list(overview.short_names()[["C03", "C13", "C12"]])
