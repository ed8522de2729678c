"""`python -m railrepro leaderboard [controller …]` scores all controllers, those of examples/ too.

Writes data/results/leaderboard.csv, without times, which depend on the machine, and the table of PAGE. Named
controllers are entered beside those that are there. A finished controller is in the store, so that an interrupted run
goes on where it was; a change of library, data or file begins anew.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import REGISTERED
from railrepro.errors import InputError
from railrepro.evidence.runs import sources, store, tuning
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import Entry, entry
from railrepro.evidence.score.page import LEADERBOARD
from railrepro.evidence.score.run import score
from railrepro.files import write

BEGIN, END = "<!-- leaderboard -->", "<!-- end of leaderboard -->"
PAGE = "notebooks/book/benchmark.md"
"""Page with the table, and its lines between which the table stands."""
_TOLD = {"error": ("error (mm)", 1e3), "effort_du": ("torque (N m)", 1.0), "delay_survived": ("delay (ms)", 1e3)}
"""Columns of the table, of the setting `loop`."""


def entries() -> list[Entry]:
    """All registered controllers, and the files of examples/."""
    files = sorted((paths.ROOT / "examples").glob("*.py"))
    return [*(entry(name) for name in REGISTERED), *(entry(str(file)) for file in files)]


def table(chosen: list[Entry], names: tuple[str, ...] | None = None) -> pd.DataFrame:
    """Score cards of some controllers below each other, from the store where they are finished."""
    return pd.concat([_scored(each, names) for each in chosen], ignore_index=True)


def _scored(each: Entry, names: tuple[str, ...] | None) -> pd.DataFrame:
    """Score card of a controller without times, which depend on the machine."""

    def compute() -> store.Entry:
        found = card.tidy(score(each, suite.SEED, names), suite.SEED)
        rows = found[~found["metric"].str.startswith("sample")]
        return {"csv": rows.to_csv(index=False, float_format="%.6g")}, None

    data = [file.read_text() for file in sorted((paths.ROOT / "data").glob("*.toml"))]
    data += [file.read_text() for file in sorted((paths.ROOT / tuning.TUNED).rglob("*.json"))]
    own = Path(each.file).read_text() if each.file else ""
    reached = sources.closure(["import railrepro.evidence.score.run"])
    row, _ = store.entry(store.key("score", each.name, own, data, reached, suite.SEED, names), compute)
    return pd.read_csv(io.StringIO(row["csv"]))


def markdown(found: pd.DataFrame) -> str:
    """The ranking as a table of Markdown."""
    whole = found[(found["scenario"] == card.ALL) & (found["setting"] == suite.LOOP)]
    loop = whole.pivot_table(index="controller", columns="metric", values="value")
    shown = (f"{words}, loop" for words, _ in _TOLD.values())
    heads = ("controller", "score", *suite.JUDGED_ON, "cases failed", *shown)
    lines = [heads, ("---",) * len(heads)]
    for name, row in card.ranking(found).iterrows():
        scores = [f"{row[key]:.1f}" for key in (card.ALL, *suite.JUDGED_ON)]
        values = [factor * loop[key].get(name, np.nan) if key in loop else np.nan for key, (_, factor) in _TOLD.items()]
        more = ["–" if np.isnan(value) else f"{value:.3g}" for value in values]
        lines.append((f"`{name}`", *scores, str(int(row["failures"])), *more))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def in_page(text: str, found: pd.DataFrame) -> str:
    """Text of the page with the table of a ranking.

    Raises
    ------
    InputError
        When the lines between which it stands are not there.
    """
    before, begin, rest = text.partition(f"{BEGIN}\n")
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise InputError(f"{PAGE}: the lines {BEGIN} and {END}, between which the leaderboard stands, are missing")
    return f"{before}{begin}{markdown(found)}\n{end}{after}"


def main(names: list[str]) -> None:
    """Score those named, or all, and write the tables."""
    found, file = table([entry(name) for name in names] or entries()), paths.source(LEADERBOARD)
    if names and file.exists():
        others = pd.read_csv(file)
        found = pd.concat([others[~others["controller"].isin(found["controller"])], found], ignore_index=True)
    page = paths.source(PAGE)
    text = in_page(page.read_text(encoding="utf-8"), found)
    write(paths.product(LEADERBOARD), found.to_csv(index=False, float_format="%.6g"))
    write(paths.product(PAGE), text)
    print(card.ranking(found).round(1).to_string())
