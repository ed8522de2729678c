"""Equal figures have equal bytes, and changed curves are found."""

import pandas as pd
import pytest

from railrepro import figures
from railrepro.evidence.chain import chain, compare


@pytest.mark.parametrize(("shift", "outcome"), [(0.0, "same"), (1e-6, "within tolerance"), (0.01, "different")])
def test_equal_figures_have_equal_bytes_and_a_moved_curve_is_found(tmp_path, monkeypatch, shift, outcome):
    for folder, moved in (("old", 0.0), ("new", shift)):
        monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path / folder))
        fig, axis = figures.new_figure()
        curve = pd.DataFrame({"x": [0.0, 1.0], "y": [0.2 + moved, 0.7 + moved]})
        axis.plot(curve["x"], curve["y"], **figures.LOOKS["nmpc"].line)
        axis.set(ylim=(0, 1))
        figures.save_figure(fig, "fig99_test", curve)
    pairs = [[tmp_path / folder / f"figures/fig99_test.{kind}" for folder in ("old", "new")] for kind in ("csv", "png")]
    table, image = (compare.compare(old, new, chain.load().verify) for old, new in pairs)
    assert (table["outcome"] == outcome).sum() == (4 if outcome == "same" else 2)
    assert image["outcome"].item() in ({"same", outcome} if outcome == "within tolerance" else {outcome})
    assert shift or all(old.read_bytes() == new.read_bytes() for old, new in pairs)


def test_a_clipped_panel_states_its_extreme_values():
    _, (low, high) = figures.new_figure(2, 1)
    low.plot([0, 1], [0.0, 3.0])
    high.plot([0, 1], [-7.0, 40.0])
    high.axvline(99.0)
    figures.clip([low, high], -5.0, 5.0)
    assert not low.texts and [text.get_text() for text in high.texts] == ["up to 40, down to −7"]
    assert low.get_ylim() == high.get_ylim() == (-5.0, 5.0)
