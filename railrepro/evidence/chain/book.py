"""The book: its source in build/book, made by Sphinx into build/html."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from pathlib import Path

from railrepro import paths
from railrepro.data import InputError, write
from railrepro.evidence.chain import pages
from railrepro.evidence.chain.chain import chain, figures, find, why_stale
from railrepro.evidence.chain.files import written


def html() -> Path:
    """Make the book in build/html of the executed notebooks; returns its first page.

    Notebooks that were never executed are run first; of stale ones the last run is shown, and they are named.

    Raises
    ------
    InputError
        When a notebook fails, or Sphinx warns.
    """
    absent = [notebook.name for notebook in chain().values() if not pages.file(notebook).exists()]
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
    with written():
        shutil.rmtree(folder, ignore_errors=True)
    settings = paths.NOTEBOOKS / "book"
    if build_main(["-q", "-W", "--keep-going", "-b", "html", "-c", str(settings), str(source), str(folder)]):
        raise InputError("the book is not complete, see the lines above")
    shutil.rmtree(folder / ".doctrees", ignore_errors=True)
    return folder / "index.html"


def script(name: str) -> Path:
    """A chapter as a Python script in build/scripts, with its prose as comments; what it writes goes to build/tried.

    Parameters
    ----------
    name : str
        Name of the notebook, or its two digits.
    """
    from nbconvert import PythonExporter

    notebook = find(next((known.name for known in chain().values() if known.name[:2] == name), name))
    text, _ = PythonExporter(exclude_input_prompt=True).from_filename(str(notebook.path))
    head = f"import os\n\nos.environ.setdefault('RAILREPRO_OUTPUT', {str(paths.BUILD / 'tried' / notebook.name)!r})\n"
    file = paths.BUILD / "scripts" / f"{notebook.name}.py"
    write(file, head + text.partition("coding: utf-8")[2])
    return file


def _source(folder: Path) -> Path:
    """Write the source of the book; returns its folder."""
    from railrepro.evidence.claims import statements
    from railrepro.evidence.report import notation

    notebooks = list(chain().values())
    contents = {notebook.name: pages.executed(notebook) for notebook in notebooks}
    home: dict[str, str] = {}
    for name, content in contents.items():
        for number in pages.tags(pages.prose(content)):
            home.setdefault(number, name)
    homes = {name: statement.notebook for name, statement in statements.load().items()}
    table = _claims_table()
    with written():
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(paths.NOTEBOOKS / "book", folder, ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("data", "figures", "railrepro"):
            (folder / name).symlink_to(paths.ROOT / name)
        (folder / "source").symlink_to(paths.NOTEBOOKS)
    for notebook in notebooks:
        rows = pages.resting(notebook, homes, table)
        chapter = pages.chapter(notebook, contents[notebook.name], home, rows)
        write(folder / "notebooks" / f"{notebook.name}.ipynb", json.dumps(chapter))
    write(folder / "REPLICATION.md", pages.report((paths.ROOT / "REPLICATION.md").read_text(encoding="utf-8")))
    write(folder / "notation.md", pages.notation(notation.table().to_dict("records")))
    return folder


def _claims_table() -> list[dict]:
    file = paths.source("data/results/claims.csv")
    if not file.exists():
        return []
    with file.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))
