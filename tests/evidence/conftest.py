"""A checkout with one small notebook."""

import pytest
from chapters import CELLS, write_notebook

from railrepro import paths


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """A checkout with one small notebook."""
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    for name in ("data", "figures", "notebooks", "build"):
        (tmp_path / name).mkdir()
        monkeypatch.setattr(paths, name.upper(), tmp_path / name)
    text = '[[notebook]]\nname = "01_tiny"\ntitle = "tiny"\nwrites = ["data/results/out.csv"]\n'
    (tmp_path / "notebooks" / "chain.toml").write_text(text)
    write_notebook(tmp_path / "notebooks", CELLS)
    return tmp_path
