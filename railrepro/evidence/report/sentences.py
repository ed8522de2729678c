"""Sentences of a notebook about its runs, each with the condition under which it is true; a cell shows them as one
paragraph. With the committed inputs a false one makes the run fail; with other values it is marked as false."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

MARK = "does not hold with these values"
"""Text before a false sentence in the output."""
_KEY = "railrepro_false"  # Key of the false sentences in the metadata of an output
_checked: list[bool] = []  # whether they held, all sentences of this session


class Sentences(list):
    """Sentences of a notebook about its runs: pairs (text, whether it holds); calling the list appends a pair."""

    def __call__(self, text: str, *holds: object) -> None:
        """Append `text`. It holds if there are conditions `holds` (bool or bool array), all true and none empty."""
        conditions = [np.asarray(one, bool) for one in holds]
        self.append((text, bool(conditions) and all(one.size and one.all() for one in conditions)))


@contextmanager
def sentences() -> Iterator[Sentences]:
    """Collect sentences in a notebook cell (`with sentences() as says: says("…", holds)`) and display them at its end
    as one paragraph; those that do not hold are marked in words. A LookupError, ValueError or ArithmeticError, as from
    a missing value, ends the block; a last, false sentence then names the error."""
    from IPython.display import display  # not needed outside of notebooks

    said = Sentences()
    try:
        yield said
    except (LookupError, ValueError, ArithmeticError) as error:
        said.append((f"sentences from here on need values that are missing ({type(error).__name__}: {error})", False))
    false = [text for text, true in said if not true]
    _checked.extend(true for _, true in said)
    marked = " ".join(text if true else f"<mark>**{MARK}:** {text}</mark>" for text, true in said)
    plain = " ".join(text if true else f"[{MARK}: {text}]" for text, true in said)
    display({"text/markdown": marked, "text/plain": plain}, raw=True, metadata={_KEY: false} if false else {})


def checked() -> None:
    """Display, at the end of a chapter, how many sentences this session has checked and how many of them are false."""
    from IPython.display import Markdown, display  # not needed outside of notebooks

    text = f"Sentences about results checked so far: {len(_checked)}. False: {_checked.count(False) or 'none'}."
    display(Markdown(f"<small>{text}</small>"))


def false_in(cells: list[dict]) -> list[str]:
    """Texts that `sentences` marked as not holding, from the `cells` (nbformat dicts) of an executed notebook."""
    outputs = [output for cell in cells for output in cell.get("outputs", [])]
    return [text for output in outputs for text in output.get("metadata", {}).get(_KEY, [])]
