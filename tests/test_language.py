"""Words that went do not come back: each file has at most as many of them as tests/language.json allows, else none.

The allowance only falls: `python tests/test_language.py` enters what is there now where that is less. It forgets files
that are gone, and adds none.
"""

import ast
import json
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

from railrepro import paths

ALLOWED = Path(__file__).with_name("language.json")
GOES = {
    r"(?:is|are|was|be) (?:seen|told)|tells?|told": "shows, describes, information available to",
    r"nobody|everybody|somebody|whoever": "the subject that is meant",
    r"askew": "yawed",
    r"(?:left|leaves|leave) the rails?": "derailed",
    r"maximum of adhesion": "adhesion peak",
    r"share used": "adhesion utilisation",
    r"begin of the": "start of the",
    r"what is left": "non-implausible region",
    r"behind sensors": "with sensor noise, latency and state estimation",
    r"hands off": "uncontrolled",
    r"who drives|what is driven": "controllers, scenario",
    r"careful designer|designer's poles": "hand-tuned poles",
    r"road ahead": "preview",
    r"on the brink": "near instability",
    r"strangers": "unmodelled conditions",
    r"take it away": "coupling and export",
    r"words of the railway": "glossary",
    r"where the order turns": "sensitivity of the controller ranking",
    r"what would have to be true": "history matching",
    r"knows? what its wheels can carry": "adhesion-aware",
    r"(?:delay|drive) survived": "delay margin, actuator-lag margin",
    r"knobs?": "parameters",
    r"how sure|disbelieve": "robustness, checking a verdict",
    r"finite number": "NaN or Inf",
}
"""What goes, as a pattern, and what comes in its place."""
PATTERN = re.compile("|".join(rf"\b(?:{word})\b" for word in GOES), re.IGNORECASE)
_CODE = re.compile(r"^```(?!\{).*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)


def files() -> list[Path]:
    """Files with prose or messages: pages, chapters, the library; the report is written by it."""
    found = [
        *(file for file in paths.ROOT.glob("*.md") if file.name != "REPLICATION.md"),
        *paths.NOTEBOOKS.glob("*.ipynb"),
        *paths.NOTEBOOKS.glob("book/*.md"),
    ]
    return sorted([*found, *paths.ROOT.glob("railrepro/**/*.py"), *paths.ROOT.glob("data/*.toml")])


def prose(file: Path) -> str:
    """Text without code: of a notebook its Markdown, of a module docstrings, messages and comments."""
    text = "\n".join(_strings(file)) if file.suffix == ".py" else markdown(file)
    return re.sub(r"\s+", " ", _CODE.sub(" ", text))


def markdown(file: Path) -> str:
    """Text of a page or, of a notebook, its Markdown."""
    if file.suffix != ".ipynb":
        return file.read_text(encoding="utf-8")
    cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
    return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")


def _strings(file: Path) -> Iterator[str]:
    with file.open("rb") as stream:
        yield from (token.string for token in tokenize.tokenize(stream.readline) if token.type == tokenize.COMMENT)
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def found(file: Path) -> list[str]:
    """Words that went, each with what stands around it."""
    text = prose(file)
    return [text[max(0, match.start() - 30) : match.end() + 20] for match in PATTERN.finditer(text)]


def counts() -> dict[str, int]:
    """How many there are now, by file."""
    number = {file.relative_to(paths.ROOT).as_posix(): len(found(file)) for file in files()}
    return {name: count for name, count in number.items() if count}


def lowered(allowed: dict[str, int], now: dict[str, int]) -> dict[str, int]:
    """The allowance of today: nowhere more than before, and none where nothing is left."""
    return {name: min(allowed[name], now[name]) for name in sorted(allowed) if now.get(name)}


@pytest.mark.parametrize("file", files(), ids=lambda file: file.relative_to(paths.ROOT).as_posix())
def test_words_that_went_do_not_come_back(file):
    allowed = json.loads(ALLOWED.read_text()).get(file.relative_to(paths.ROOT).as_posix(), 0)
    there = found(file)
    assert len(there) <= allowed, f"{there}; what comes in their place: tests/test_language.py"


@pytest.mark.parametrize("file", [f for f in files() if f.suffix in (".md", ".ipynb")], ids=lambda file: file.stem)
def test_headings_ask_no_question(file):
    text = re.sub(r"^```.*?^```", "", markdown(file), flags=re.MULTILINE | re.DOTALL)
    assert [line for line in text.splitlines() if re.match(r"#+ .*\?$", line)] == []


def test_the_allowance_only_falls():
    before = {"a.md": 3, "b.md": 1, "gone.md": 2}
    assert lowered(before, {"a.md": 2, "b.md": 4, "new.md": 1}) == {"a.md": 2, "b.md": 1}


def test_code_is_no_prose(tmp_path):
    module, page = tmp_path / "a.py", tmp_path / "a.md"
    module.write_text('told = f"nobody {told}"  # it is told\n')
    page.write_text("`told` stays\n```\nnobody\n```\n```{glossary}\nand whoever\n```\nis told\n")
    assert [len(found(file)) for file in (module, page)] == [2, 2]


if __name__ == "__main__":
    text = json.dumps(lowered(json.loads(ALLOWED.read_text()), counts()), indent=1)
    ALLOWED.write_text(text + "\n")
