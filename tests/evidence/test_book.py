"""The book: every notebook has its place, pages link what they should, and no link of it leads nowhere."""

import csv
import json
import os
import re
import shutil
from pathlib import Path
from urllib.parse import unquote

import pytest

from railrepro import paths
from railrepro.data import InputError
from railrepro.evidence.chain import book, chain, pages
from railrepro.evidence.chain.chain import cells

LAST = 42
"""Number of the last equation of the PDF."""


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


def test_labels_of_the_source_become_numbers_of_the_pdf():
    assert pages.numbered("see eqs. (psi_trax) to (gen_forces) and eq. (18)") == "see eqs. (8) to (17) and eq. (18)"
    assert pages.numbered("eq. (eq.integration_rule)") == "eq. (41), (42)"


def test_every_label_that_is_used_has_a_number():
    with (paths.NOTEBOOKS / "book/equations.csv").open(newline="") as stream:
        numbers = [int(number) for row in csv.DictReader(stream) for number in re.findall(r"\((\d+)", row["number"])]
    assert numbers and max(numbers) <= LAST
    texts = [file.read_text() for file in (paths.ROOT / "railrepro").rglob("*.py")]
    texts += [pages.prose({"cells": cells(notebook)}) for notebook in chain.chain().values()]
    with paths.source("data/notation.csv").open(newline="") as stream:
        texts += [f"eq. {row['equation']}" for row in csv.DictReader(stream)]
    left = {label for text in texts for label in re.findall(r"\beqs?\. \((\w+)\)", pages.numbered(text))}
    assert {label for label in left if not label[0].isdigit()} == set()


def test_a_chapter_links_equations_and_names_source_data_and_claims():
    notebook = chain.Notebook("01_one", "one", writes=("data/results/table1.csv",), figures=("fig10_tracks",))
    image = {"output_type": "display_data", "data": {"image/png": "AA=="}, "metadata": {}}
    content = {
        "cells": [
            {
                "cell_type": "markdown",
                "source": "from eq. (8)\n\n$$a = b \\tag{8}$$\n\nand eq. (9), `02_contact`, `99_none`",
                "metadata": {},
            },
            {
                "cell_type": "code",
                "id": "c07",
                "source": 'figures.save_figure(fig, "fig10_tracks", table)',
                "metadata": {},
                "outputs": [image],
            },
        ]
    }
    rows = [{"id": "C01", "statement": "it holds", "verdict": "reproduced"}]
    made = [cell["source"] for cell in pages.chapter(notebook, content, {"8": "01_one", "9": "02_two"}, rows)["cells"]]
    assert "from eq. [(8)](#eq-8)" in made[0] and "and eq. [(9)](#eq-9)" in made[0]
    assert made[0].endswith(", [`02_contact`](02_contact.ipynb), `99_none`")
    assert "(eq-8)=\n\\begin{equation*}\na = b \\tag{8}\n\\end{equation*}" in made[0]
    assert made[1] == "(01_one-c07)=" and ":name: fig10_tracks" in made[3]
    for part in (
        "source/01_one.ipynb",
        "data/results/table1.csv",
        "it holds | reproduced | reproduced | reproduced |",
        'REPLICATION.html#C01"',
    ):
        assert part in made[-1]


def test_claims_rest_on_the_notebook_that_they_name_or_whose_product_they_judge():
    notebook = chain.Notebook("01_one", "one", writes=("data/a.csv",), figures=("fig10_tracks",))
    homes = {"C01": "01_one", "C04": "02"}
    evidence = {"C01": "data/b.csv", "C02": "figures/fig10_tracks.png", "C03": "data/a.csv", "C04": "data/b.csv"}
    table = [{"id": name, "evidence": file} for name, file in evidence.items()]
    assert [row["id"] for row in pages.resting(notebook, homes, table)] == ["C01", "C02", "C03"]


def test_the_report_leads_to_cells_of_the_book():
    text = "| C08 | ✓ | [06, cell c20](notebooks/06_curve_entry.ipynb#cell-id=c20) |"
    assert pages.report(text) == '| <span id="C08"></span>C08 | ✓ | [06, cell c20](#06_curve_entry-c20) |'


def test_chapters_are_numbered_and_in_the_order_of_the_chain(monkeypatch, tmp_path):
    places = re.findall(r"^notebooks/(\w+)$", (paths.NOTEBOOKS / "book/index.md").read_text(), re.MULTILINE)
    assert places == [notebook.name for notebook in chain.chain().values()]
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    (tmp_path / "notebooks").mkdir()
    for title in ("[Re] Tracks", "Beyond the paper: tracks", "Tracks"):
        content = {"cells": [{"cell_type": "markdown", "source": [f"# {title}\n", "text"]}]}
        (tmp_path / "notebooks/01_tracks.ipynb").write_text(json.dumps(content))
        assert pages.executed(chain.find("01_tracks"))["cells"][0]["source"] == "# 01 Tracks\ntext"


def test_every_figure_has_a_caption():
    drawn = {figure for notebook in chain.chain().values() for figure in notebook.figures}
    assert drawn - set(pages.captions()) == set(), "notebooks/book/captions.toml"


def test_a_cell_that_draws_is_folded_and_its_output_stays():
    code = {"cell_type": "code", "id": "c01", "source": "a = 1\na", "metadata": {}, "outputs": [{"x": 1}]}
    plot = {"cell_type": "code", "id": "c02", "source": "plt.plot(a)", "metadata": {}}
    made = pages.chapter(chain.Notebook("01_one", "one"), {"cells": [code, plot]}, {}, [])["cells"]
    shown = [cell for cell in made if cell["cell_type"] == "code"]
    assert [cell["source"] for cell in shown] == [code["source"], plot["source"]] and shown[0]["outputs"] == [{"x": 1}]
    assert [cell["metadata"].get("tags", []) for cell in shown] == [[], ["hide-input"]]


def test_a_statement_has_one_row_with_its_verdict_in_each_setting():
    rows = [
        {"id": "C01", "statement": "it holds", "verdict": verdict, "setting": setting}
        for setting, verdict in (("paper", "reproduced"), ("loop", "not reproduced"))
    ] + [{"id": "C02", "statement": "so does it", "verdict": "partly", "setting": ""}]
    made = pages.chapter(chain.Notebook("01_one", "one"), {"cells": []}, {}, rows)["cells"][-1]["source"]
    assert (
        "| it holds | reproduced |  | not reproduced |" in made and "| so does it | partly | partly | partly |" in made
    )


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
