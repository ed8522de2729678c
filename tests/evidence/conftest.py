"""Checkouts for tests of the chain: one with a small notebook, and one to edit."""

import shutil

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


@pytest.fixture
def copy(tmp_path):
    """A checkout with a copy of library and data that can be edited."""
    for name in ("railrepro", "data"):
        shutil.copytree(paths.ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("notebooks", "build"):
        (tmp_path / name).mkdir()
    return tmp_path
