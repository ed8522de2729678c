"""`python -m railrepro score path/to/mine.py` (or a registered name): suite, score card and page."""

from __future__ import annotations

from railrepro import paths
from railrepro.evidence.score import card, page, suite
from railrepro.evidence.score.entry import entry
from railrepro.evidence.score.run import score
from railrepro.files import write


def main(controller: str, seed: int | None = None, small: bool = False) -> None:
    """Score one controller and tell the card; `small` takes the quick runs only and no margins."""
    seed = suite.SEED if seed is None else seed
    chosen = entry(controller)
    table = score(chosen, seed, suite.QUICK if small else None)
    long = card.tidy(table, seed)
    folder = paths.BUILD / "score"
    write(folder / f"{chosen.name}.csv", long.to_csv(index=False, float_format="%.6g"))
    write(folder / f"{chosen.name}.html", page.html(chosen.name, table, long, seed))
    for _, row in table[table["failure"] != ""].iterrows():
        print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
    print(card.text(long))
    print(f"written: {folder / chosen.name}.csv and .html")
