"""Sentences of a chapter as output, with the condition under which each is true.

A chapter says what its runs show, with their numbers. With the committed values a false sentence fails the chain; where
a reader changed values it is marked, and the chapter goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

MARK = "does not hold with these values"
"""Stands before a false sentence."""
_KEY = "railrepro_false"
"""Metadata of an output, under which its false sentences stand for the chain."""


class Sentences(list):
    """Pairs of a sentence and whether it holds."""

    def __call__(self, text: str, *holds: object) -> None:
        """Say a sentence that is true when all conditions hold; one on an empty array does not."""
        conditions = [np.asarray(one, bool) for one in holds]
        self.append((text, bool(conditions) and all(one.size and one.all() for one in conditions)))


@contextmanager
def sentences() -> Iterator[Sentences]:
    """Collect the sentences of a block and show them as a list, false ones marked.

    Values that a reader changed may leave a row out that a sentence needs: the block ends there, with a mark.
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
    """False sentences of an executed notebook, from its cells."""
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    return [text for output in outputs for text in output.get("metadata", {}).get(_KEY, [])]
