"""Settings of the book; `make html` writes its source to build/book and calls Sphinx with this file."""

import os
import re
from dataclasses import is_dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import get_type_hints

from railrepro import __version__, paths

project = "railrepro"
author = "railrepro contributors"
copyright = "railrepro contributors, text and figures under CC-BY-4.0"
release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinxcontrib.bibtex",
]
exclude_patterns = ["data", "figures", "railrepro", "source", "reference/modules.rst"]
suppress_warnings = ["myst.header", "ref.python"]
bibtex_bibfiles = ["references.bib"]

# The book shows what the chain executed and runs nothing itself.
nb_execution_mode = "off"
nb_merge_streams = True
nb_code_prompt_show = "Show the code"
nb_code_prompt_hide = "Hide the code"
nb_mime_priority_overrides = [("html", "text/latex", 5)]
nb_render_markdown_format = "myst"
myst_enable_extensions = ["amsmath", "dollarmath", "deflist"]
myst_heading_anchors = 3
myst_update_mathjax = False

# Formulas without a network: one file with its own glyphs.
mathjax_path = "tex-svg-full.js"
mathjax3_config = {
    "tex": {"inlineMath": [["\\(", "\\)"], ["$", "$"]]},
    "options": {"ignoreHtmlClass": "bd-all|furo-all|page", "processHtmlClass": "math|cell_output", "enableMenu": False},
    "svg": {"fontCache": "global"},
}
_mathjax = find_spec("sphinx-mathjax-offline").submodule_search_locations[0]
html_static_path = ["book.css", str(Path(_mathjax) / "static" / "mathjax" / "tex-svg-full.js")]

html_theme = "furo"
html_search_scorer = str(Path(__file__).parent / "scorer.js")
html_title = "railrepro"
html_css_files = ["book.css"]
html_show_sphinx = False
html_copy_source = False

# Where the book is published, it says how to run it; without a repository there is no address.
if repository := os.environ.get("GITHUB_REPOSITORY"):
    _binder = f"https://mybinder.org/v2/gh/{repository}/HEAD?labpath=notebooks/00_first_run.ipynb"
    html_theme_options = {
        "announcement": f'<a href="{_binder}">Run the chapters in the browser</a>, without an installation (Binder)',
        "source_repository": f"https://github.com/{repository}",
    }

# One page of the library reference per sub-package.
apidoc_modules = [
    {
        "path": str(paths.ROOT / "railrepro"),
        "destination": "reference",
        "automodule_options": {"members"},
        "max_depth": 1,
    }
]
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_mock_imports = ["distributed"]
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Returns", "params_style")]
# Attributes as fields: one that is also a property is described once.
napoleon_use_ivar = True


def _literal(app, what, name, obj, options, lines):
    """`name` is code in docstrings, not a title, |y| a magnitude, not a substitution, **keywords are not bold."""
    text = re.sub(r"(?<![`:\w])`([^`\n<>]+)`(?![`_])", r"``\1``", "\n".join(lines))
    parts = re.split(r"(``.*?``)", text)
    text = "".join(part if part.startswith("``") else part.replace("|", r"\|") for part in parts)
    lines[:] = text.replace("(**", r"(\*\*").replace(", **", r", \*\*").split("\n")


def _fields(app, what, name, obj, options, lines):
    """Fields of a dataclass of quantities: their units and meanings stand in the annotations."""
    hints = get_type_hints(obj, include_extras=True) if what == "class" and is_dataclass(obj) else {}
    for field, hint in hints.items():
        unit, *meaning = getattr(hint, "__metadata__", [None])
        if isinstance(unit, str):
            lines.append(f":ivar {field}: {' '.join([*meaning, f'({unit})'])}")


def setup(app):
    app.connect("autodoc-process-docstring", _literal)
    app.connect("autodoc-process-docstring", _fields)
