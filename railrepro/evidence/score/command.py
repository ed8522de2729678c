"""`python -m railrepro score path/to/mine.py` (or a registered name): suite, score cards and pages."""

from __future__ import annotations

from railrepro import paths
from railrepro.control import lateral
from railrepro.errors import InputError
from railrepro.evidence.score import card, page, run, suite
from railrepro.evidence.score.entry import entry
from railrepro.files import write


def main(controller: str | None = None, seed: int | None = None, small: bool = False, describe: bool = False) -> None:
    """Score one controller and print its cards: the published and the ranked draws, or that of a seed.

    `small` takes the quick runs of the published draw only, and no margins; `describe` prints what a law may use.
    """
    if describe:
        print(description())
        return
    if controller is None:
        raise InputError("score: a Python file with one controller class, or a registered name, is needed")
    chosen, published = entry(controller), suite.draws().published
    print(f"checking controller {chosen.name}", flush=True)
    run.check(chosen)
    seeds = (published, *(() if small else suite.ranked_seeds(chosen))) if seed is None else (seed,)
    table = run.score(chosen, seeds, suite.QUICK if small else None)
    cards = {draw: card.tidy(rows, draw) for draw, rows in table.groupby("seed", sort=False)}
    for draw, long in cards.items():
        words = "published" if draw == published else "ranked" if seed is None else "of your choice"
        rows, folder, stem = table[table["seed"] == draw], paths.BUILD / "score", f"{chosen.name}-{draw}"
        write(folder / f"{stem}.csv", long.to_csv(index=False, float_format="%.6g"))
        text = page.html(chosen.name, rows, long, f"{words}, seed {draw}", ranked=words == "ranked")
        write(folder / f"{stem}.html", text)
        print(f"\ndraw {words}, seed {draw}")
        for _, row in rows[rows["failure"] != ""].iterrows():
            print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
        print(card.text(long))
        print(f"written: {folder / stem}.csv and .html")


def description() -> str:
    """Names that `torque` of a law of the 1 kHz exchange may use, with unit and meaning."""
    short = {full: name for name, full in lateral.SHORT.items()}
    lines = [
        "A law is one class with torque(self, q); q has these quantities as attributes, for example q.y. It returns",
        "the differential torque (N m, positive steers right) as an expression of CasADi. With `memory`, a tuple of",
        "names of its own that q has, too, it returns (torque, next value of each by name). See examples/.",
        "",
    ]
    for title, names in (("running gear", lateral.GEAR), ("track here", lateral.ROAD), ("vehicle", lateral.MODEL)):
        lines.append(title)
        for name, (unit, meaning) in names.items():
            shown = f"{name}, {short[name]}" if name in short else name
            lines.append(f"  {shown:22s}{unit:12s}{meaning}")
    return "\n".join(lines)
