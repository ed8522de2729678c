"""The book in build/html: executed notebooks, the pages of notebooks/book and the report, made by Sphinx."""

import json
import re
import shutil
from pathlib import Path

from railrepro import data, paths
from railrepro.evidence.chain.chain import Notebook, chain, figures
from railrepro.figures import figure_number

_DISPLAY = re.compile(r"^\$\$\n?(.*?)\n?\$\$$", re.DOTALL | re.MULTILINE)
_CHAPTER = re.compile(r"`(\d\d_\w+)`")
_SAVED = re.compile(r"save_figure\([^\"']*?[\"'](fig\d{2,4}_\w+)[\"']")


def html() -> Path:
    """Command `html`: make the book in build/html from the executed notebooks; returns the path of its first page.
    Notebooks without an executed copy are run first; stale ones are shown as last executed. InputError when a notebook
    fails, Sphinx warns or its packages are missing."""
    absent = [notebook.name for notebook in chain().values() if not notebook.executed.exists()]
    if absent and figures(absent):
        raise data.InputError("the book needs every notebook executed, see the lines above")
    source, folder = paths.BUILD / "book", paths.BUILD / "html"
    shutil.rmtree(source, ignore_errors=True)
    shutil.copytree(paths.NOTEBOOKS / "book", source, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("data", "figures", "railrepro", "REPLICATION.md"):
        (source / name).symlink_to(paths.ROOT / name)
    for notebook in chain().values():
        data.write(source / "notebooks" / f"{notebook.name}.ipynb", json.dumps(chapter(notebook)))
    try:
        from sphinx.cmd.build import build_main
    except ImportError as error:
        raise data.InputError("the book needs the packages of the group `book`; `make html` installs them") from error
    shutil.rmtree(folder, ignore_errors=True)
    if build_main(["-q", "-W", "--keep-going", "-b", "html", str(source), str(folder)]):
        raise data.InputError("the book is not complete, see the lines above")
    return folder / "index.html"


def chapter(notebook: Notebook) -> dict:
    """Make a page of the book from an executed notebook: its nbformat dict with a numbered title, links to other
    chapters and captions of figures."""
    content, captions = data.read(notebook.executed), data.read(paths.NOTEBOOKS / "book/captions.toml")
    cells: list[dict] = []
    for cell in content["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            text = _DISPLAY.sub(lambda match: _display(match[1]), text)
            cells.append(cell | {"source": _CHAPTER.sub(r"[`\1`](\1.ipynb)", text)})
            continue
        cells.append(cell)
        for shown in (output["data"] for output in cell["outputs"] if "text/markdown" in output.get("data", {})):
            shown["text/markdown"] = _CHAPTER.sub(r"[`\1`](\1.ipynb)", "".join(shown["text/markdown"]))
        for name in _SAVED.findall(text):
            cell["metadata"]["mystnb"] = {"image": {"alt": captions[name]}}
            caption = f"**Figure {figure_number(name)}.** {captions[name]} ({{download}}`data <../figures/{name}.csv>`)"
            cells.append({"cell_type": "markdown", "id": name, "metadata": {}, "source": caption})
    cells[0]["source"] = re.sub(r"^# (\[Re\] )?", f"# {notebook.name[:2]} ", cells[0]["source"])
    return content | {"cells": cells}


def _display(formula: str) -> str:
    """Displayed formula in an environment that Sphinx does not number; its tag is the number in the paper."""
    if formula.startswith("\\begin{align}"):
        return "\n" + formula.replace("{align}", "{align*}") + "\n"
    return f"\n\\begin{{equation*}}\n{formula}\n\\end{{equation*}}\n"
