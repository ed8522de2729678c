"""`python -m railrepro.score.leaderboard [controller …]` scores the registered controllers and those of examples/.

Writes data/results/leaderboard.csv, without times, which depend on the machine.
"""

from __future__ import annotations

import sys

import pandas as pd

from railrepro import paths
from railrepro.control.registry import REGISTERED
from railrepro.errors import told
from railrepro.files import write
from railrepro.score import card, suite
from railrepro.score.entry import Entry, entry
from railrepro.score.page import LEADERBOARD
from railrepro.score.run import score


def entries() -> list[Entry]:
    """All registered controllers, and the files of examples/."""
    files = sorted((paths.ROOT / "examples").glob("*.py"))
    return [*(entry(name) for name in REGISTERED), *(entry(str(file)) for file in files)]


def table(chosen: list[Entry], names: tuple[str, ...] | None = None) -> pd.DataFrame:
    """Score cards of some controllers below each other."""
    cards = [card.tidy(score(each, suite.SEED, names), suite.SEED) for each in chosen]
    whole = pd.concat(cards, ignore_index=True)
    return whole[~whole["metric"].str.startswith("sample")].reset_index(drop=True)


def main(names: list[str]) -> None:
    """Score those named, or all, and write the table."""
    found = table([entry(name) for name in names] or entries())
    write(paths.product(LEADERBOARD), found.to_csv(index=False, float_format="%.6g"))
    print(card.ranking(found).round(1).to_string())


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
