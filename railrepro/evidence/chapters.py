"""What chapters of the book use besides the facade: sentences with conditions, figures, source code, calibrated car."""

import ast
import inspect
import textwrap
from collections.abc import Callable

from railrepro import figures
from railrepro.evidence.claims import calibrated
from railrepro.evidence.report.sentences import checked, sentences

__all__ = ["calibrated", "checked", "figures", "sentences", "source"]


def source(*of: Callable) -> None:
    """Display the source code of functions or classes of the library, without docstrings, in a notebook."""
    from IPython.display import Markdown, display  # not needed outside of notebooks

    for each in of:
        lines = textwrap.dedent(inspect.getsource(each)).splitlines()
        left_out: set[int] = set()
        for node in ast.walk(ast.parse("\n".join(lines))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node) is not None:
                left_out |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
        code = "\n".join(line for number, line in enumerate(lines, 1) if number not in left_out)
        display(Markdown(f"`{each.__module__}.{each.__qualname__}`\n\n```python\n{code}\n```"))
