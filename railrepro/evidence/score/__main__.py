"""`python -m railrepro.evidence.score path/to/mine.py` (or a registered name): suite, score card and page."""

from __future__ import annotations

import argparse
import sys

from railrepro import paths
from railrepro.errors import told
from railrepro.evidence.score import card, page, suite
from railrepro.evidence.score.entry import entry
from railrepro.evidence.score.run import score
from railrepro.files import write


def main(arguments: list[str]) -> None:
    """Score one controller and tell the card."""
    parser = argparse.ArgumentParser(
        "python -m railrepro.evidence.score", description="Scores a controller on the open suite."
    )
    parser.add_argument("controller", help="a Python file with one controller class, or a registered name")
    parser.add_argument("--seed", type=int, default=suite.SEED, help=f"another draw, default {suite.SEED}")
    parser.add_argument("--small", action="store_true", help=f"only {', '.join(suite.QUICK)}, and no margins")
    given = parser.parse_args(arguments)
    chosen = entry(given.controller)
    table = score(chosen, given.seed, suite.QUICK if given.small else None)
    long = card.tidy(table, given.seed)
    folder = paths.BUILD / "score"
    write(folder / f"{chosen.name}.csv", long.to_csv(index=False, float_format="%.6g"))
    write(folder / f"{chosen.name}.html", page.html(chosen.name, table, long, given.seed))
    for _, row in table[table["failure"] != ""].iterrows():
        print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
    print(card.text(long))
    print(f"written: {folder / chosen.name}.csv and .html")


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
