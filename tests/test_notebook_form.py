"""The form of a chapter: short cells, formulas and prose around them, a sentence behind each figure, what to try."""

import re

import pytest

from railrepro.evidence.chain import folding, graph
from railrepro.evidence.chain.manifest import cells

LINES, WIDTH = 15, 120


def faults(content):
    """One sentence per fault of a list of cells, each with cell_type, id and source."""
    found, names = [], [cell.get("id", "?") for cell in content]
    for i, cell in enumerate(content):
        rows, follower = cell["source"].split("\n"), content[i + 1] if i + 1 < len(content) else {"cell_type": "none"}
        if cell["cell_type"] != "code":
            continue
        if len(rows) > LINES:
            found.append(f"cell {names[i]} has {len(rows)} lines, {LINES} are allowed")
        tags = cell.get("metadata", {}).get("tags", [])
        if folding.is_folded(cell["source"]) != (folding.FOLDED in tags):
            found.append(f"cell {names[i]} and its tag {folding.FOLDED!r} do not agree; `make strip` sets it")
        if max(map(len, rows)) > WIDTH:
            found.append(f"cell {names[i]} has a line of {max(map(len, rows))} characters, {WIDTH} are allowed")
        if "save_figure(" in cell["source"] and follower["cell_type"] != "markdown":
            found.append(f"cell {names[i]} draws a figure and no prose follows")
    first, last = content[0]["source"], content[-1]
    if not first.startswith("# ") or "?" not in first:
        found.append("the first cell has no title or asks no question")
    found += [f"the first cell has no line {key!r}" for key in ("Reads", "Writes", "Paper items", "Run time")
              if f"| {key} |" not in first]  # fmt: skip
    prose = "\n".join(cell["source"] for cell in content if cell["cell_type"] == "markdown")
    found += [f"there is no section {name!r}" for name in ("What differs", "What to try")
              if not re.search(rf"^## {name}", prose, re.MULTILINE)]  # fmt: skip
    tried = re.findall(r"^- ", last["source"].partition("## What to try")[2], re.MULTILINE)
    if last["cell_type"] != "markdown" or not 2 <= len(tried) <= 3:
        found.append("the last cell is not what to try, two or three changes")
    return found


@pytest.mark.parametrize("name", [n.name for n in graph.chain()])
def test_a_chapter_has_the_form(name):
    assert faults(cells(graph.find(name))) == []


TITLE = "# One\n\nWhy?\n\n| | |\n|---|---|\n" + "".join(
    f"| {key} | x |\n" for key in ("Reads", "Writes", "Paper items", "Run time")
)
END = "## What differs\n\nMuch, and it is told here.\n\n## What to try\n\n- one\n- two"


def chapter(*sources, title=TITLE, end=END):
    kinds = ["markdown" if source.startswith("text") else "code" for source in sources]
    tags = {"metadata": {"tags": ["hide-input"]}}
    middle = [
        {"cell_type": k, "id": f"c{i}", "source": s} | (tags if "save_figure(" in s else {})
        for i, (k, s) in enumerate(zip(kinds, sources, strict=True))
    ]
    return [{"cell_type": "markdown", "source": title}, *middle, {"cell_type": "markdown", "source": end}]


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (chapter("x = 1"), None),
        (chapter("text", "for x in y:\n    assert x"), "cell c1 and its tag 'hide-input' do not agree"),
        (chapter("text", "ax.plot(x)\nassert x"), "cell c1 and its tag 'hide-input' do not agree"),
        (chapter("text", "z = x\nassert x"), None),
        (chapter("x\n" * 16), "cell c0 has 17 lines, 15 are allowed"),
        (chapter("x = " + "1" * 120), "cell c0 has a line of 124 characters, 120 are allowed"),
        (chapter("save_figure(fig)", "x"), "cell c0 draws a figure and no prose follows"),
        (chapter("save_figure(fig)", "text"), None),
        (chapter(title=TITLE.replace("?", ".")), "the first cell has no title or asks no question"),
        (chapter(title=TITLE.replace("Run time", "x")), "the first cell has no line 'Run time'"),
        (chapter(end=END.replace("What differs", "x")), "there is no section 'What differs'"),
        (chapter(end=END.replace("- two", "")), "the last cell is not what to try, two or three changes"),
    ],
)
def test_a_fault_of_the_form_is_told(content, fault):
    found = faults(content)
    assert not found if fault is None else len(found) == 1 and fault in found[0]


def test_asserts_are_parted_from_what_a_cell_computes():
    code = "a = 1\nassert a\nif a:\n    # because\n    assert (\n        a\n    )\nif a:\n    b = 2\n    assert b\na"
    assert folding.split(code) == (
        "a = 1\nif a:\n    b = 2\n    assert b\na",
        "assert a\nif a:\n    # because\n    assert (\n        a\n    )",
    )
