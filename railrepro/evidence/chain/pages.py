"""Source pages of the book: executed notebooks with their surroundings, report, notation."""

from __future__ import annotations

import csv
import json
import re
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import pandas as pd

from railrepro import paths
from railrepro.data import InputError
from railrepro.evidence.chain import folding
from railrepro.evidence.chain.chain import Notebook
from railrepro.evidence.runs.tuning import SETTINGS

_EQUATION = re.compile(r"\beqs?\. (\([^()\s]+\)(?:(?:, | and | to )\([^()\s]+\))*)")
_DISPLAY = re.compile(r"^\$\$\n?(.*?)\n?\$\$$", re.DOTALL | re.MULTILINE)
_TAG = re.compile(r"\\tag\{([^}]*)\}")
_CHAPTER = re.compile(r"`(\d\d_\w+)`")
_SAVED = re.compile(r"save_figure\([^\n]*?[\"'](fig\d\d_\w+)[\"']")


@cache
def _numbers() -> dict[str, str]:
    with (paths.NOTEBOOKS / "book" / "equations.csv").open(newline="", encoding="utf-8") as stream:
        return {row["label"]: row["number"] for row in csv.DictReader(stream)}


def numbered(text: str) -> str:
    """Text in which labels of the paper's source, after "eq.", are the numbers that its PDF shows."""

    def number(match: re.Match) -> str:
        label = match[1].removeprefix("eq.").removeprefix("eqn.")
        return _numbers().get(label, f"({match[1]})")

    return _EQUATION.sub(lambda m: m[0].replace(m[1], re.sub(r"\(([^()]+)\)", number, m[1])), text)


def tags(text: str) -> list[str]:
    """Numbers of the paper's equations that formulas in a text carry: of "3a, b" these are 3a, 3b and 3."""
    found: list[str] = []
    for tag in _TAG.findall(text):
        letters = re.findall(r"[a-z]", tag)
        number = "".join(re.findall(r"^\d+", tag))
        found += [f"{number}{letter}" for letter in letters] + [number]
    return list(dict.fromkeys(found))


def prose(content: dict) -> str:
    """Markdown of a notebook."""
    return "\n".join(cell["source"] for cell in content["cells"] if cell["cell_type"] == "markdown")


def file(notebook: Notebook) -> Path:
    """Where the executed notebook is kept."""
    return paths.BUILD / "notebooks" / f"{notebook.name}.ipynb"


def executed(notebook: Notebook) -> dict:
    """Content of an executed notebook, sources as single strings, its number in the title; InputError without one."""
    try:
        content = json.loads(file(notebook).read_text(encoding="utf-8"))
        for cell in content["cells"]:
            cell["source"] = "".join(cell["source"])
        first = content["cells"][0]
        title = re.compile(r"^# (?:\[Re\] |Beyond the paper: )?(.)")
        first["source"] = title.sub(lambda m: f"# {notebook.name[:2]} {m[1].upper()}", first["source"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{file(notebook)}: there is no executed notebook; `make figures` makes it") from error
    return content


def anchor(number: str) -> str:
    """Target of an equation of the paper."""
    return f"eq-{number}"


def chapter(notebook: Notebook, content: dict, home: dict[str, str], rows: list[dict]) -> dict:
    """A notebook as a page: equations linked, figures with captions, source, data and claims at its end.

    Parameters
    ----------
    notebook : Notebook
    content : dict
        See `executed`.
    home : dict
        Notebook that shows an equation of the paper, by number.
    rows : list of dict
        Claims that rest on it, rows of data/results/claims.csv.

    Returns
    -------
    dict
        The notebook with changed cells.
    """
    cells: list[dict] = []
    waiting = {number for number, name in home.items() if name == notebook.name}
    for i, cell in enumerate(content["cells"]):
        if cell["cell_type"] == "markdown":
            text = _DISPLAY.sub(lambda m: _display(m[1], waiting), numbered(cell["source"]))
            cells.append(cell | {"source": _linked(text, home)})
            continue
        cells.append(_markdown(f"({notebook.name}-{cell['id']})=", f"target-{i}"))
        cells += _with_figures(cell)
    cells.append(_markdown(_around(notebook, rows), "around"))
    return content | {"cells": cells}


def _markdown(text: str, identity: str) -> dict:
    return {"cell_type": "markdown", "id": identity, "metadata": {}, "source": text}


def _display(formula: str, waiting: set[str]) -> str:
    """A displayed formula as an environment of its own, with a target for each number that still waits for one."""
    targets = [f"({anchor(number)})=\n" for number in tags(formula) if number in waiting]
    waiting.difference_update(tags(formula))
    environment = "" if formula.lstrip().startswith(("\\begin{align}", "\\begin{gather}")) else "equation*"
    # Without the star Sphinx would count the formula as its own, too.
    starred = re.sub(r"\{(align|gather)\}", r"{\1*}", formula)
    body = f"\\begin{{{environment}}}\n{formula}\n\\end{{{environment}}}" if environment else starred
    return f"\n{''.join(targets)}{body}\n"


def _linked(text: str, home: dict[str, str]) -> str:
    """Mentions of the paper's equations and of chapters as links to their places in the book."""

    def link(match: re.Match) -> str:
        return f"[{match[0]}](#{anchor(match[1])})" if match[1] in home else match[0]

    text = _EQUATION.sub(lambda m: m[0].replace(m[1], re.sub(r"\(([^()]+)\)", link, m[1])), text)
    return _CHAPTER.sub(lambda m: f"[`{m[1]}`]({m[1]}.ipynb)" if _is_chapter(m[1]) else m[0], text)


@cache
def _is_chapter(name: str) -> bool:
    return (paths.NOTEBOOKS / f"{name}.ipynb").exists()


def _with_figures(cell: dict) -> list[dict]:
    """A code cell; in place of images of figures that it saves the files with captions."""
    saved = _SAVED.findall(cell["source"])
    stored = [output for output in cell.get("outputs", []) if not (saved and _is_figure(output))]
    shown = [_markdown(_figure(name), name) for name in saved]
    if folding.is_folded(cell["source"]):
        return [cell | {"outputs": stored, "metadata": {"tags": [folding.FOLDED]}}, *shown]
    if folding.only_imports(cell["source"]):
        return [cell | {"metadata": _folded("Imports")}]
    return [cell | {"outputs": stored}, *shown]


def _folded(prompt: str) -> dict:
    """Metadata of a code cell that is shown when its prompt is opened."""
    return {"tags": [folding.FOLDED], "mystnb": dict.fromkeys(("code_prompt_show", "code_prompt_hide"), prompt)}


def _is_figure(output: dict) -> bool:
    return {"image/png", "text/latex"} & set(output.get("data", {})) == {"image/png"}


@cache
def captions() -> dict[str, str]:
    """What each figure shows, from notebooks/book/captions.toml."""
    return tomllib.loads((paths.NOTEBOOKS / "book" / "captions.toml").read_text(encoding="utf-8"))


def _figure(name: str) -> str:
    """A saved figure as a numbered one, with its data."""
    caption = captions().get(name, name[6:].replace("_", " "))
    head = f"```{{figure}} ../figures/{name}.png\n:name: {name}\n:alt: {caption}\n\n"
    return f"{head}**Figure {int(name[3:5])}.** {caption} ({_download(f'figures/{name}.csv')})\n```"


def _download(path: str) -> str:
    return f"{{download}}`{Path(path).name} <../{path}>`"


def _around(notebook: Notebook, rows: list[dict]) -> str:
    """Where a chapter comes from and what rests on it."""
    reads = [path for path in notebook.reads if (paths.ROOT / path).is_file()]
    lines = ["## Source, data, claims", "", f"Notebook: {_download(f'source/{notebook.name}.ipynb')}.", ""]
    if reads:
        lines += [f"Reads: {', '.join(map(_download, reads))}.", ""]
    if notebook.writes:
        lines += [f"Writes: {', '.join(map(_download, notebook.writes))}; figures above.", ""]
    if rows:
        lines += ["Statements of the paper that rest on this chapter:", "", *_verdicts(rows)]
    else:
        lines += ["No statement of the paper rests on this chapter."]
    return "\n".join(lines)


def _verdicts(rows: list[dict]) -> list[str]:
    """One row per statement, its verdict in each setting; one that has no setting is judged once, for all."""
    lines = _head("", "statement", *(f"`{setting}`" for setting in SETTINGS))
    for (identity, statement), own in pd.DataFrame(rows).groupby(["id", "statement"], sort=False):
        known = dict(zip(own.get("setting", [""] * len(own)), own["verdict"], strict=True))
        verdicts = [str(known.get(setting, known.get("", ""))) for setting in SETTINGS]
        lines.append(f"| {_claim(str(identity))} | {statement} | {' | '.join(verdicts)} |")
    return lines


def _head(*names: str) -> list[str]:
    return [f"| {' | '.join(names)} |", "|---" * len(names) + "|"]


def _claim(identity: str) -> str:
    return f'<a href="../REPLICATION.html#{identity}">{identity}</a>'


def resting(notebook: Notebook, homes: dict[str, str], table: list[dict]) -> list[dict]:
    """Rows of claims.csv whose statement names the notebook (`homes`) or a product of it."""
    own = set(notebook.products) | set(notebook.figures)

    def rests(row: dict) -> bool:
        evidence = Path(row["evidence"])
        return homes.get(row["id"]) == notebook.name or bool(own & {str(evidence), evidence.stem})

    return [row for row in table if rests(row)]


def report(text: str) -> str:
    """REPLICATION.md with links to chapters of the book and a target for each claim."""
    text = re.sub(r"\(notebooks/(\w+)\.ipynb#cell-id=(\w+)\)", r"(#\1-\2)", text)
    return re.sub(r"^\| (C\d\d) \|", r'| <span id="\1"></span>\1 |', text, flags=re.MULTILINE)


def notation(rows: Iterable[dict]) -> str:
    """Page of the symbols; rows as in `railrepro.evidence.report.notation.table`."""
    lines = [
        "# Notation",
        "",
        "Symbols of the paper, then parameters of the car; `series`: columns of a run's table.",
        "",
    ]
    lines += _head("symbol", "meaning", "unit", "in the library", "equation")
    for row in rows:
        shown = numbered(f"eq. {row['equation']}").removeprefix("eq. ")
        cells = (row["symbol"], row["meaning"], row["unit"], f"`{row['python']}`" if row["python"] else "", shown)
        lines.append("| " + " | ".join(str(cell).replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
