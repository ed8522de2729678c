"""The book: every notebook has its place, and pages link what they should."""

import json
import re
import shutil

import pytest

from railrepro import paths
from railrepro.evidence.chain import book, chain

TEXT = "from\n\n$$a = b \\tag{8}$$\n\n$$\\begin{align}a\\end{align}$$\n\nand `02_contact`, `99_none`"
CELLS = [
    {"cell_type": "markdown", "source": TEXT},
    {"cell_type": "code", "id": "c07", "source": 'figures.save_figure(fig, "fig10_tracks", table)',
     "outputs": [{"data": {"image/png": "AA=="}}, {"data": {"text/plain": "1"}}]},
    {"cell_type": "code", "id": "c08", "source": "a", "outputs": []},
]  # fmt: skip


def test_a_chapter_shows_formulas_links_figures_source_and_tables():
    notebook = chain.Notebook("01_one", "one", writes=("data/results/table1.csv",), figures=("fig10_tracks",))
    text, place, drawn, figure, _, plain, files = book.chapter(notebook, {"cells": CELLS})["cells"]
    assert text["source"].endswith("and [`02_contact`](02_contact.ipynb), `99_none`")
    assert "\n\\begin{equation*}\na = b \\tag{8}\n\\end{equation*}\n" in text["source"]
    assert "\n\\begin{align*}a\\end{align*}\n" in text["source"]
    assert place["source"] == "(01_one-c07)=" and ":name: fig10_tracks" in figure["source"]
    assert drawn["outputs"] == CELLS[1]["outputs"][1:] and drawn["metadata"] == {"tags": ["hide-input"]}
    assert plain == CELLS[2]
    assert "source/01_one.ipynb" in files["source"] and "data/results/table1.csv" in files["source"]


def test_the_report_leads_to_cells_of_the_book():
    text = "| C08 | ✓ | [06, cell c20](notebooks/06_curve_entry.ipynb#cell-id=c20) |"
    assert book.report(text) == "| C08 | ✓ | [06, cell c20](#06_curve_entry-c20) |"


def test_chapters_are_numbered_and_in_the_order_of_the_chain(monkeypatch, tmp_path):
    places = re.findall(r"^notebooks/(\w+)$", (paths.NOTEBOOKS / "book/index.md").read_text(), re.MULTILINE)
    assert places == list(chain.chain())
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    (tmp_path / "notebooks").mkdir()
    for title in ("Beyond the paper: tracks", "Tracks"):
        content = {"cells": [{"cell_type": "markdown", "source": [f"# {title}\n", "text"]}]}
        (tmp_path / "notebooks/01_tracks.ipynb").write_text(json.dumps(content))
        assert book.executed(chain.chain()["01_tracks"])["cells"][0]["source"] == "# 01 Tracks\ntext"


@pytest.mark.slow
def test_the_whole_book_is_made_without_a_warning_and_without_a_network(monkeypatch, tmp_path):
    pytest.importorskip("sphinx", reason="the packages of the book are installed by `make html`")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    (tmp_path / "notebooks").mkdir()
    for notebook in chain.chain().values():
        shutil.copy(notebook.path, tmp_path / "notebooks")
    folder = book.html().parent
    pages = {file.relative_to(folder).as_posix(): file.read_text() for file in folder.rglob("*.html")}
    loads = r"<(?:script|img|iframe|source|object)[^>]*?\s(?:src|data)=\"(?:https?:)?//"
    loads += r"|<link[^>]*?href=\"(?:https?:)?//"
    assert [name for name, text in pages.items() if re.search(loads, text)] == []
    linked = {identity for text in pages.values() for identity in re.findall(r"REPLICATION\.html#(C\d\d)", text)}
    assert linked and linked <= set(re.findall(r'id="(C\d\d)"', pages["REPLICATION.html"]))
