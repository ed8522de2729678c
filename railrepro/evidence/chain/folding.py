"""Code cells of a notebook: which of them a reader may skip, and a cell without its checks."""

from __future__ import annotations

import ast
import re

FOLDED = "hide-input"
"""Tag of cells that the book folds: they draw, say sentences, or only check."""
_DRAWS = re.compile(
    r"\bsentences\(\)|\bplt\.\w|\bsave_figure\(|\.(?:plot|semilog[xy]|loglog|scatter|subplots|set_[xy]label)\("
)


def _checks(node: ast.stmt) -> bool:
    """Whether a statement only asserts, below a condition or a loop for instance."""
    parts = [*getattr(node, "body", ()), *getattr(node, "orelse", ())]
    return isinstance(node, ast.Assert) or (isinstance(node, ast.If | ast.For) and all(map(_checks, parts)))


def _body(source: str) -> list[ast.stmt]:
    try:
        return ast.parse(source).body
    except SyntaxError:
        return []


def is_folded(source: str) -> bool:
    """Whether a code cell draws, says sentences, or has nothing but asserts."""
    body = _body(source)
    return bool(_DRAWS.search(source)) or (bool(body) and all(map(_checks, body)))


def only_imports(source: str) -> bool:
    """Whether a code cell does nothing but import."""
    body = _body(source)
    return bool(body) and all(isinstance(node, ast.Import | ast.ImportFrom) for node in body)


def split(source: str) -> tuple[str, str]:
    """Code of a cell without its asserts, and these."""
    lines = source.split("\n")
    checks: list[str] = []
    for node in reversed([node for node in _body(source) if _checks(node)]):
        checks[:0] = lines[node.lineno - 1 : node.end_lineno]
        del lines[node.lineno - 1 : node.end_lineno]
    return "\n".join(lines).strip("\n"), "\n".join(checks)
