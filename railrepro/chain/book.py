"""The executed notebooks and the report as an HTML book."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from nbconvert import HTMLExporter
from nbconvert.filters import markdown2html

from railrepro import paths
from railrepro.chain.graph import chain
from railrepro.errors import InputError
from railrepro.files import write, written


def html() -> Path:
    """Executed notebooks as an HTML book in build/html; returns its index. InputError when one is missing."""
    folder = paths.BUILD / "html"
    exporter = HTMLExporter()
    items = []
    for notebook in chain():
        source = paths.BUILD / "notebooks" / f"{notebook.name}.ipynb"
        try:
            body, _ = exporter.from_filename(str(source))
        except (OSError, ValueError) as error:
            raise InputError(f"{source}: there is no executed notebook; `make figures` makes it") from error
        back = '<p style="margin:1em 4em"><a href="index.html">all notebooks</a></p>'
        write(folder / f"{notebook.name}.html", body.replace("<main>", back + "<main>", 1))
        items.append(f'<li><a href="{notebook.name}.html">{notebook.name[:2]} {notebook.title}</a></li>')
    report = paths.ROOT / "REPLICATION.md"
    link = ""
    if report.exists():
        _page(folder / "REPLICATION.html", "Replication report", _report_html(report.read_text(), folder))
        link = '<p><a href="REPLICATION.html">Replication report: every claim with its verdict</a></p>'
    index = folder / "index.html"
    _page(index, "railrepro", f"<h1>railrepro: the notebooks</h1>{link}<ol>{''.join(items)}</ol>")
    return index


def _page(path: Path, title: str, body: str) -> None:
    style = (
        "<style>body{font:16px/1.6 serif;max-width:70em;margin:3em auto;padding:0 1em}"
        "td,th{padding:.2em .6em;border-bottom:1px solid #ccc;text-align:left;vertical-align:top}"
        "img{max-width:100%}</style>"
    )
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>{style}'
    write(path, f"{head}{body}</html>\n")


def _report_html(text: str, folder: Path) -> str:
    """The report with its links turned to pages of the book and to copies of the figures and tables."""
    body = markdown2html(text)
    for target, cell in sorted(set(re.findall(r'(?:href|src)="([^"#:]+)(#[^"]*)?"', body))):
        source = paths.ROOT / target
        if target.startswith("notebooks/"):
            body = body.replace(f'"{target}{cell}"', f'"{source.stem}.html{cell}"')
        elif source.is_file():
            with written():
                (folder / target).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, folder / target)
    return body
