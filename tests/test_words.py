"""Prose is plain technical English: words that went do not come back, headings are no aphorisms."""

import re

import pytest

from railrepro import paths
from railrepro.evidence.chain import graph
from railrepro.evidence.chain.manifest import cells

GONE = (
    *("What is seen", "is told", "are told", "was told", "nobody", "everybody", "whoever", "left the rail"),
    *("leaves the rail", "stands askew"),
    *("rolling askew", "maximum of adhesion", "careful designer", "designer's poles"),
    *("on the brink", "what is left", "road ahead", "Take it away", "Words of the railway", "Hands off", "knob"),
    *("share used", "begin of the"),
)  # fmt: skip


def texts():
    """Prose by name: README, contributing, the users' guide and the chapters."""
    files = [paths.ROOT / "README.md", paths.ROOT / "CONTRIBUTING.md", *sorted((paths.NOTEBOOKS / "book").glob("*.md"))]
    found = {file.name: file.read_text() for file in files}
    for notebook in graph.chain():
        prose = [cell["source"] for cell in cells(notebook) if cell["cell_type"] == "markdown"]
        found[notebook.name] = "\n\n".join(prose)
    return found


TEXTS = texts()


@pytest.mark.parametrize("name", TEXTS)
def test_words_that_went_do_not_come_back(name):
    pattern = re.compile("|".join(rf"\b{re.escape(word)}" for word in GONE), re.IGNORECASE)
    assert [TEXTS[name][max(0, m.start() - 40) : m.end() + 20] for m in pattern.finditer(TEXTS[name])] == []


@pytest.mark.parametrize("name", TEXTS)
def test_headings_ask_no_question(name):
    prose = re.sub(r"^```.*?^```", "", TEXTS[name], flags=re.MULTILINE | re.DOTALL)
    assert [line for line in prose.splitlines() if re.match(r"#+ .*\?$", line)] == []
