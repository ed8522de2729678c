"""What code a piece of Python can reach: the content of results and products that depend on it.

The content of a module is its syntax without docstrings and comments, and that of the C sources that it names; imports
are followed within this package.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

from railrepro import FACADE, paths

PACKAGE = Path(paths.__file__).resolve().parent
_NAME = PACKAGE.name
_OTHER_SOURCE = re.compile(r"""["']([\w{}\[\]]+\.(?:c|h|html))["']""")
_DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED):
            node.body = [
                part for part in node.body if not (isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant))
            ]
    return tree


@lru_cache(maxsize=4096)
def parsed(text: str) -> tuple[str, frozenset[str]]:
    """Content of a piece of Python in hexadecimal, and the names of modules of this package that it imports.

    What is no valid Python has its text as content and imports nothing: it will fail when it runs.
    """
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):
        return hashlib.sha256(text.encode(errors="replace")).hexdigest(), frozenset()
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = {alias.name for alias in node.names}
            ours = any(name.partition(".")[0] == _NAME for name in names)
            found |= names | ({f"{_NAME}.{name}" for name in FACADE} if ours else set())  # any may follow
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    content = hashlib.sha256(ast.dump(_without_docstrings(tree)).encode()).hexdigest()
    homes = {home for name, home in FACADE.items() if {f"{_NAME}.{name}", f"{_NAME}.*"} & found}
    found |= homes | {home.rpartition(".")[0] for home in homes}
    return content, frozenset(name for name in found if name.partition(".")[0] == _NAME)


def _file(module: str, package: Path) -> Path | None:
    base = package.parent.joinpath(*module.split("."))
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.is_file()), None)


def _other_sources(text: str, package: Path) -> set[Path]:
    """Files besides Python that a module names; what is filled in is any text."""
    patterns = [re.sub(r"\{[^}]*\}", "*", name) for name in _OTHER_SOURCE.findall(text)]
    return {file for pattern in patterns for file in package.rglob(pattern)}


def closure(texts: Iterable[str], package: Path = PACKAGE) -> dict[str, str]:
    """Content of all modules that pieces of Python can reach, by their path from the package's parent.

    Parameters
    ----------
    texts : iterable of str
        Python source.
    package : Path
        Folder of this package.

    Returns
    -------
    dict
        Path -> SHA-256 in hexadecimal: of the syntax of a module, of the bytes of a C source.
    """
    found: dict[str, str] = {}
    pending = [module for text in texts for module in parsed(text)[1]]
    while pending:
        file = _file(pending.pop(), package)
        if file is None or (name := str(file.relative_to(package.parent))) in found:
            continue
        text = file.read_text(encoding="utf-8", errors="replace")
        found[name], imported = parsed(text)
        pending += imported
        for source in _other_sources(text, package):
            found[str(source.relative_to(package.parent))] = hashlib.sha256(source.read_bytes()).hexdigest()
    return found
