"""The book in build/html: executed notebooks, the pages of notebooks/book and the report, made by Sphinx."""

from __future__ import annotations

import json
import re
import shutil
import sys
import tomllib
from pathlib import Path

from railrepro import paths
from railrepro.data import InputError, write
from railrepro.evidence.chain.chain import Notebook, chain, figures, why_stale

_DISPLAY = re.compile(r"^\$\$\n?(.*?)\n?\$\$$", re.DOTALL | re.MULTILINE)
_CHAPTER = re.compile(r"`(\d\d_\w+)`")
_SAVED = re.compile(r"save_figure\([^\n]*?[\"'](fig\d\d_\w+)[\"']")
_FOLDED = re.compile(
    r"\bsentences\(\)|\bplt\.\w|\bsave_figure\(|\.(?:plot|semilog[xy]|loglog|scatter|subplots|set_[xy]label)\("
)
"""What is in code cells that are folded: they draw or say sentences."""


def html() -> Path:
    """Make the book in build/html from the executed notebooks; returns the path of its first page.

    Notebooks that were never executed are run first; stale ones are shown as last executed and listed on stderr.
    InputError when a notebook fails, Sphinx warns or its packages are missing.
    """
    absent = [notebook.name for notebook in chain().values() if not notebook.executed.exists()]
    if absent and figures(absent):
        raise InputError("the book needs every notebook executed, see the lines above")
    stale = [notebook.name for notebook in chain().values() if why_stale(notebook)]
    if stale:
        print(f"the book shows earlier runs of {', '.join(stale)}; `make figures` renews them", file=sys.stderr)
    source = _source(paths.BUILD / "book")
    folder = paths.BUILD / "html"
    try:
        from sphinx.cmd.build import build_main
    except ImportError as error:
        raise InputError("the book needs the packages of the group `book`; `make html` installs them") from error
    shutil.rmtree(folder, ignore_errors=True)
    settings = paths.NOTEBOOKS / "book"
    if build_main(["-q", "-W", "--keep-going", "-b", "html", "-c", str(settings), str(source), str(folder)]):
        raise InputError("the book is not complete, see the lines above")
    shutil.rmtree(folder / ".doctrees", ignore_errors=True)
    return folder / "index.html"


def _source(folder: Path) -> Path:
    """Write the source of the book; returns its folder."""
    notebooks = chain()
    contents = {name: executed(notebook) for name, notebook in notebooks.items()}
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(paths.NOTEBOOKS / "book", folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("data", "figures", "railrepro"):
        (folder / name).symlink_to(paths.ROOT / name)
    (folder / "source").symlink_to(paths.NOTEBOOKS)
    for name, content in contents.items():
        write(folder / "notebooks" / f"{name}.ipynb", json.dumps(chapter(notebooks[name], content)))
    write(folder / "REPLICATION.md", report((paths.ROOT / "REPLICATION.md").read_text(encoding="utf-8")))
    return folder


def executed(notebook: Notebook) -> dict:
    """Content of an executed notebook as in its JSON file, sources as single strings, chapter number in the title."""
    content = json.loads(notebook.executed.read_text(encoding="utf-8"))
    for cell in content["cells"]:
        cell["source"] = "".join(cell["source"])
    first = content["cells"][0]
    title = re.compile(r"^# (?:\[Re\] |Beyond the paper: )?(.)")
    first["source"] = title.sub(lambda m: f"# {notebook.name[:2]} {m[1].upper()}", first["source"])
    return content


def chapter(notebook: Notebook, content: dict) -> dict:
    """Content of a page of the book from that of `executed`: links to chapters, captions, links to files at the end."""
    cells: list[dict] = []
    for i, cell in enumerate(content["cells"]):
        if cell["cell_type"] == "markdown":
            text = _DISPLAY.sub(lambda match: _display(match[1]), cell["source"])
            cells.append(cell | {"source": _CHAPTER.sub(_linked, text)})
            continue
        cells.append(_markdown(f"({notebook.name}-{cell['id']})=", f"target-{i}"))
        cells += _with_figures(cell)
    files = [f"source/{notebook.name}.ipynb", *notebook.writes]
    cells.append(
        _markdown(f"## Source and tables\n\n{', '.join(map(_download, files))}; data of figures above.", "files")
    )
    return content | {"cells": cells}


def _markdown(text: str, identity: str) -> dict:
    return {"cell_type": "markdown", "id": identity, "metadata": {}, "source": text}


def _display(formula: str) -> str:
    """A displayed formula as an environment without numbers by Sphinx: it carries those of the paper."""
    if formula.lstrip().startswith(("\\begin{align}", "\\begin{gather}")):
        return "\n" + re.sub(r"\{(align|gather)\}", r"{\1*}", formula) + "\n"
    return f"\n\\begin{{equation*}}\n{formula}\n\\end{{equation*}}\n"


def _linked(chapter: re.Match) -> str:
    """The name of a chapter as a link to its page."""
    return f"[{chapter[0]}]({chapter[1]}.ipynb)" if chapter[1] in chain() else chapter[0]


def _with_figures(cell: dict) -> list[dict]:
    """A code cell; in place of images of figures that it saves the files with captions."""
    saved = _SAVED.findall(cell["source"])
    stored = [output for output in cell.get("outputs", []) if not (saved and _is_figure(output))]
    folded = {"metadata": {"tags": ["hide-input"]}} if _FOLDED.search(cell["source"]) else {}
    return [cell | {"outputs": stored} | folded, *(_markdown(_figure(name), name) for name in saved)]


def _is_figure(output: dict) -> bool:
    return {"image/png", "text/latex"} & set(output.get("data", {})) == {"image/png"}


def captions() -> dict[str, str]:
    """Name of a figure, as "fig06_curve_entry" -> its caption (notebooks/book/captions.toml)."""
    return tomllib.loads((paths.NOTEBOOKS / "book" / "captions.toml").read_text(encoding="utf-8"))


def _figure(name: str) -> str:
    """A saved figure as a numbered one, with its data."""
    caption = captions()[name]
    head = f"```{{figure}} ../figures/{name}.png\n:name: {name}\n:alt: {caption}\n\n"
    return f"{head}**Figure {int(name[3:5])}.** {caption} ({_download(f'figures/{name}.csv')})\n```"


def _download(path: str) -> str:
    return f"{{download}}`{Path(path).name} <../{path}>`"


def report(text: str) -> str:
    """Text of REPLICATION.md with its links to notebook cells changed to links to pages of the book."""
    return re.sub(r"\(notebooks/(\w+)\.ipynb#cell-id=(\w+)\)", r"(#\1-\2)", text)
