"""Sentences that a notebook prints about its runs, each with the condition under which it is true.

With the committed inputs a false sentence makes the run of the notebook fail; where a reader changed values the
sentence is marked as false, and the notebook goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

MARK = "does not hold with these values"
"""Text before a false sentence in the output."""
_KEY = "railrepro_false"
"""Key in the metadata of an output with its false sentences, which `false_in` reads."""


class Sentences(list):
    """List of (sentence, whether it holds); a call appends one."""

    def __call__(self, text: str, *holds: object) -> None:
        """Append a sentence, true when all conditions (booleans, arrays of them) hold; an empty array does not hold."""
        conditions = [np.asarray(one, bool) for one in holds]
        self.append((text, bool(conditions) and all(one.size and one.all() for one in conditions)))


@contextmanager
def sentences() -> Iterator[Sentences]:
    """Context manager: collect sentences (`with sentences() as says: says("…", holds)`) and display them as a list.

    False ones are marked. Where a table lacks a value that a sentence needs (LookupError, ValueError, ArithmeticError),
    the block ends with a false sentence that names the error.
    """
    from IPython.display import display  # the library does without it

    said = Sentences()
    try:
        yield said
    except (LookupError, ValueError, ArithmeticError) as error:
        said.append((f"sentences from here on need values that are missing ({type(error).__name__}: {error})", False))
    marked = "\n".join(f"- ✓ {text}" if true else f"- <mark>**✗ {MARK}:**</mark> {text}" for text, true in said)
    plain = "\n".join(f"✓ {text}" if true else f"✗ {MARK}: {text}" for text, true in said)
    false = [text for text, true in said if not true]
    display({"text/markdown": marked, "text/plain": plain}, raw=True, metadata={_KEY: false} if false else {})


def false_in(cells: list[dict]) -> list[str]:
    """Texts of the false sentences in the outputs of the cells of an executed notebook."""
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    return [text for output in outputs for text in output.get("metadata", {}).get(_KEY, [])]
