"""The book: every notebook has its place, pages show formulas, links and captions."""

import json
import re

from railrepro import paths
from railrepro.evidence.chain import book, chain

TEXT = "# [Re] Tracks\n\n$$a = b \\tag{8}$$\n\n$$\\begin{align}a\\end{align}$$\n\nand `02_contact`"
CELLS = [
    {"cell_type": "markdown", "source": [TEXT]},
    {"cell_type": "code", "metadata": {}, "source": ['figures.save_figure(fig, "fig0101_tracks", t)'], "outputs": []},
]


def test_a_chapter_shows_number_formulas_links_and_captions(monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "notebooks/01_tracks.ipynb").write_text(json.dumps({"cells": CELLS}))
    text, drawn, caption = book.chapter(chain.chain()["01_tracks"])["cells"]
    assert text["source"].startswith("# 01 Tracks\n")
    assert text["source"].endswith("and [`02_contact`](02_contact.ipynb)")
    assert "\n\\begin{equation*}\na = b \\tag{8}\n\\end{equation*}\n" in text["source"]
    assert "\n\\begin{align*}a\\end{align*}\n" in text["source"]
    assert drawn["source"] == CELLS[1]["source"] and caption["source"].startswith("**Figure 1.1.** ")
    assert drawn["metadata"]["mystnb"]["image"]["alt"] in caption["source"]  # what a screen reader reads


def test_every_chapter_has_its_place_and_every_figure_its_caption():
    places = re.findall(r"^notebooks/(\w+)$", (paths.NOTEBOOKS / "book/index.md").read_text(), re.MULTILINE)
    assert places == list(chain.chain())
    drawn = {figure for notebook in chain.chain().values() for figure in notebook.figures}
    assert drawn == set(re.findall(r"^(fig\w+) = ", (paths.NOTEBOOKS / "book/captions.toml").read_text(), re.MULTILINE))
