"""Code cells of a notebook that a reader may skip."""

from __future__ import annotations

import ast
import re

FOLDED = "hide-input"
"""Tag of cells that the book folds: they draw or say sentences."""
_DRAWS = re.compile(
    r"\bsentences\(\)|\bplt\.\w|\bsave_figure\(|\.(?:plot|semilog[xy]|loglog|scatter|subplots|set_[xy]label)\("
)


def is_folded(source: str) -> bool:
    """Whether a code cell draws or says sentences."""
    return bool(_DRAWS.search(source))


def only_imports(source: str) -> bool:
    """Whether a code cell does nothing but import."""
    try:
        body = ast.parse(source).body
    except SyntaxError:
        return False
    return bool(body) and all(isinstance(node, ast.Import | ast.ImportFrom) for node in body)
