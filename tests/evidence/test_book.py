"""The book: every notebook has its place, pages link what they should, and no link of it leads nowhere."""

import json
import os
import re
import shutil
from pathlib import Path
from urllib.parse import unquote

import pandas as pd
import pytest

from railrepro import paths
from railrepro.data import InputError
from railrepro.evidence.chain import book, chain

LOADED = re.compile(r"<(?:script|img|iframe|source|object)[^>]*?\s(?:src|data)=\"([^\"]+)|<link[^>]*?href=\"([^\"]+)")
LINKED = re.compile(r"<a [^>]*?href=\"(?!https?:|mailto:)([^\"#]*)(?:#([^\"]*))?")


def faulty(folder):
    """Loads from a network, and links inside a folder of HTML pages that lead nowhere."""
    texts = {file: file.read_text() for file in sorted(folder.rglob("*.html"))}
    found = []
    for file, text in texts.items():
        loads = [left or right for left, right in LOADED.findall(text)]
        found += [f"{file.name} loads {load}" for load in loads if re.match(r"(https?:)?//", load)]
        for path, place in LINKED.findall(text):
            target = Path(os.path.normpath(file.parent / unquote(path))) if path else file
            missing = place and target in texts and f'id="{unquote(place)}"' not in texts[target]
            if missing or not target.is_file():
                found.append(f"{file.name} links to {path}#{place}")
    return found


TEXT = "from\n\n$$a = b \\tag{8}$$\n\n$$\\begin{align}a\\end{align}$$\n\nand `02_contact`, `99_none`"
CELLS = [
    {"cell_type": "markdown", "source": TEXT},
    {"cell_type": "code", "id": "c07", "source": 'figures.save_figure(fig, "fig10_tracks", table)',
     "outputs": [{"data": {"image/png": "AA=="}}, {"data": {"text/plain": "1"}}]},
    {"cell_type": "code", "id": "c08", "source": "a", "outputs": []},
]  # fmt: skip
CLAIMS = [("C01", "it holds", "reproduced", "paper"), ("C01", "it holds", "not reproduced", "loop")]
CLAIMS += [("C02", "so does it", "partly", "")]


def test_a_chapter_shows_formulas_links_figures_source_data_and_claims():
    notebook = chain.Notebook("01_one", "one", writes=("data/results/table1.csv",), figures=("fig10_tracks",))
    claims = pd.DataFrame(CLAIMS, columns=["id", "statement", "verdict", "setting"])
    made = book.chapter(notebook, {"cells": CELLS}, claims)["cells"]
    text, place, drawn, figure, _, plain, around = made
    assert text["source"].endswith("and [`02_contact`](02_contact.ipynb), `99_none`")
    assert "\n\\begin{equation*}\na = b \\tag{8}\n\\end{equation*}\n" in text["source"]
    assert "\n\\begin{align*}a\\end{align*}\n" in text["source"]
    assert place["source"] == "(01_one-c07)=" and ":name: fig10_tracks" in figure["source"]
    assert drawn["outputs"] == CELLS[1]["outputs"][1:] and drawn["metadata"] == {"tags": ["hide-input"]}
    assert plain == CELLS[2]
    for part in (
        *("source/01_one.ipynb", "data/results/table1.csv", 'REPLICATION.html#C01"'),
        *("| it holds | reproduced |  | not reproduced |", "| so does it | partly | partly | partly |"),
    ):
        assert part in around["source"]


def test_the_report_leads_to_cells_of_the_book():
    text = "| C08 | ✓ | [06, cell c20](notebooks/06_curve_entry.ipynb#cell-id=c20) |"
    assert book.report(text) == '| <span id="C08"></span>C08 | ✓ | [06, cell c20](#06_curve_entry-c20) |'


def test_chapters_are_numbered_and_in_the_order_of_the_chain(monkeypatch, tmp_path):
    places = re.findall(r"^notebooks/(\w+)$", (paths.NOTEBOOKS / "book/index.md").read_text(), re.MULTILINE)
    assert places == list(chain.chain())
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    (tmp_path / "notebooks").mkdir()
    for title in ("Beyond the paper: tracks", "Tracks"):
        content = {"cells": [{"cell_type": "markdown", "source": [f"# {title}\n", "text"]}]}
        (tmp_path / "notebooks/01_tracks.ipynb").write_text(json.dumps(content))
        assert book.executed(chain.chain()["01_tracks"])["cells"][0]["source"] == "# 01 Tracks\ntext"


def test_the_book_runs_only_notebooks_that_were_never_executed(monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    names = list(chain.chain())
    (tmp_path / "notebooks").mkdir()
    for name in names[1:]:
        (tmp_path / f"notebooks/{name}.ipynb").touch()
    ran = []
    monkeypatch.setattr(book, "figures", lambda absent: ran.extend(absent) or 1)
    with pytest.raises(InputError, match="needs every notebook executed"):
        book.html()
    assert ran == names[:1]


@pytest.mark.slow
def test_the_whole_book_is_made_without_a_warning_and_without_a_network(monkeypatch, tmp_path):
    pytest.importorskip("sphinx", reason="the packages of the book are installed by `make html`")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    (tmp_path / "notebooks").mkdir()
    for notebook in chain.chain().values():
        shutil.copy(notebook.path, tmp_path / "notebooks")
    assert faulty(book.html().parent) == []
