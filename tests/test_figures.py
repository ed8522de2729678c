"""Figures come out byte-identical."""

import pandas as pd

from railrepro import figures


def test_equal_figures_give_equal_bytes(tmp_path, monkeypatch):
    contents = []
    for i in range(2):
        monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path / str(i)))
        fig, axis = figures.new_figure()
        axis.plot([0, 1], [0, 1], **figures.CONTROLLER_STYLE["nmpc"])
        figures.save_figure(fig, "fig99_test", pd.DataFrame({"x": [0.0, 1.0]}))
        files = sorted((tmp_path / str(i) / "figures").iterdir())
        contents.append([file.read_bytes() for file in files])
    assert len(contents[0]) == 4
    assert contents[0] == contents[1]
