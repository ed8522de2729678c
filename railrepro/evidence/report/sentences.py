"""Sentences that a notebook says about its runs, each with the condition under which it is true.

A cell shows its sentences as one paragraph. With the committed inputs a false sentence makes the run fail; with other
values it is only marked as false.
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
    """List of pairs (text of a statement on results, bool: whether it holds); calling the list appends a pair."""

    def __call__(self, text: str, *holds: object) -> None:
        """Append `text`; it holds if there are conditions `holds` (bool or not empty bool array), all of them true."""
        conditions = [np.asarray(one, bool) for one in holds]
        self.append((text, bool(conditions) and all(one.size and one.all() for one in conditions)))


@contextmanager
def sentences() -> Iterator[Sentences]:
    """Context manager: collect sentences (`with sentences() as says: says("…", holds)`) and display them at its end.

    They become one paragraph with their number below it; those that do not hold are marked with `MARK`. A LookupError,
    ValueError or ArithmeticError in the block, as from a missing value, ends the block; a last sentence that does not
    hold then names the error.
    """
    from IPython.display import display  # the library does without it

    said = Sentences()
    try:
        yield said
    except (LookupError, ValueError, ArithmeticError) as error:
        said.append((f"sentences from here on need values that are missing ({type(error).__name__}: {error})", False))
    false = [text for text, true in said if not true]
    count = f"{len(said)} sentence{'s' if len(said) > 1 else ''} checked against the results"
    count += f", {len(false)} of them false" if false else ""
    marked = " ".join(text if true else f"<mark>**{MARK}:** {text}</mark>" for text, true in said)
    plain = " ".join(text if true else f"[{MARK}: {text}]" for text, true in said)
    shown = {"text/markdown": f"{marked}\n\n<small>{count}.</small>", "text/plain": f"{plain}\n({count}.)"}
    display(shown, raw=True, metadata={_KEY: false} if false else {})


def false_in(cells: list[dict]) -> list[str]:
    """Texts that `sentences` marked as not holding, from the `cells` (nbformat dicts) of an executed notebook."""
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    return [text for output in outputs for text in output.get("metadata", {}).get(_KEY, [])]
