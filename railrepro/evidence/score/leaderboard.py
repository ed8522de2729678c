"""`python -m railrepro leaderboard [controller …]` scores all controllers, those of examples/ too.

Writes data/results/leaderboard.csv, the sums of the card of each draw, and the table of PAGE. Named controllers are
entered beside those that are there. A finished controller is in the store, so that an interrupted run goes on where it
was; a change of library, data or file begins anew.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import SHOWN
from railrepro.data import InputError, write
from railrepro.evidence.runs import store, tuning
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import NOTHING, Entry, entry
from railrepro.evidence.score.run import check, score

BEGIN, END = "<!-- leaderboard -->", "<!-- end of leaderboard -->"
LEADERBOARD = "data/results/leaderboard.csv"
PAGE = "notebooks/book/benchmark.md"
"""Page with the table, and its lines between which the table stands."""
_COLUMNS = {
    **{"ranked": ("ranked", 1.0), "spread": ("spread", 1.0), "published": ("published", 1.0)},
    **{setting: (setting, 1.0) for setting in suite.JUDGED_ON},
    **{"margins": ("margins", 1.0), "failures": ("cases failed", 1.0)},
    **{
        "error": ("error (mm), loop", 1e3),
        "limit": ("limit (mm), loop", 1e3),
        "effort_du": ("torque (N m), loop", 1.0),
    },
}
"""Columns of the table: words and factor from SI."""
_READ = ("irregularities", "scenarios", "score", "sensors", "tracks", "tuning", "vehicle")
"""Data that a score depends on, besides the tuned sets."""


def entries() -> list[Entry]:
    """All registered controllers, none at all, and the files of examples/."""
    files = sorted((paths.ROOT / "examples").glob("*.py"))
    return [*(entry(name) for name in (*SHOWN, NOTHING)), *(entry(str(file)) for file in files)]


def table(chosen: list[Entry], names: tuple[str, ...] | None = None) -> pd.DataFrame:
    """Score cards of some controllers below each other, from the store where they are finished."""
    return pd.concat([_scored(each, names) for each in chosen], ignore_index=True)


def _scored(each: Entry, names: tuple[str, ...] | None) -> pd.DataFrame:
    """Sums of the score cards of a controller."""
    seeds = (suite.draws().published, *suite.draws().ranked)

    def compute() -> store.Entry:
        check(each)
        rows = score(each, seeds, names)
        cards = [card.tidy(draw, seed) for seed, draw in rows.groupby("seed", sort=False)]
        found = pd.concat(cards)
        found = found[found["scenario"] == card.ALL]
        return {"csv": found.to_csv(index=False, float_format="%.6g")}, None

    data = [paths.source(f"data/{name}.toml").read_text() for name in _READ]
    data += [file.read_text() for file in sorted((paths.ROOT / tuning.TUNED).rglob("*.json"))]
    own = Path(each.file).read_text() if each.file else ""
    row, _ = store.entry(store.key(__name__, "score", each.name, own, data, seeds, names), compute)
    return pd.read_csv(io.StringIO(row["csv"]))


def markdown(found: pd.DataFrame) -> str:
    """The ranking as a table of Markdown."""
    lines = [("controller", *(words for words, _ in _COLUMNS.values()))]
    lines.append(("---",) * len(lines[0]))
    for name, row in card.ranking(found, suite.draws().published).iterrows():
        values = [factor * row.get(key, np.nan) for key, (_, factor) in _COLUMNS.items()]
        lines.append((f"`{name}`", *map(_number, values)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _number(value: float) -> str:
    """Three digits, more of a large number, a dash for none."""
    return "–" if np.isnan(value) else f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


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
    print(card.ranking(found, suite.draws().published).round(1).to_string())
