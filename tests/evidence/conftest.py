"""A checkout with one small notebook."""

import os

import pytest
from chapters import CELLS, write_notebook

from railrepro import paths


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """A checkout with one small notebook."""
    for folder in ("notebooks", "data", "build"):
        (tmp_path / folder).mkdir()
    os.symlink(paths.ROOT / "railrepro", tmp_path / "railrepro")
    (tmp_path / "environment.lock").write_text("")
    for name in ("ROOT", "DATA", "FIGURES", "NOTEBOOKS", "BUILD"):
        monkeypatch.setattr(paths, name, tmp_path if name == "ROOT" else tmp_path / name.lower())
    text = '[[notebook]]\nname = "01_tiny"\ntitle = "tiny"\nwrites = ["data/results/out.csv"]\n'
    (tmp_path / "notebooks" / "chain.toml").write_text(text)
    write_notebook(tmp_path / "notebooks", CELLS)
    return tmp_path
