"""`python -m railrepro score path/to/mine.py` (or a registered name): suite and score card."""

from __future__ import annotations

from railrepro import paths
from railrepro.control import lateral
from railrepro.data import InputError, write
from railrepro.evidence.score import card, run, suite
from railrepro.evidence.score.entry import entry


def main(controller: str | None = None, seed: int | None = None, small: bool = False, describe: bool = False) -> None:
    """Score one controller on the published draw, or on that of a seed, and print its card.

    `small` takes the quick runs only, and no margins; `describe` prints what a law may use.
    """
    if describe:
        print(description())
        return
    if controller is None:
        raise InputError("score: a Python file with one controller class, or a registered name, is needed")
    chosen, draw = entry(controller), suite.draws().published if seed is None else seed
    print(f"checking controller {chosen.name}", flush=True)
    run.check(chosen)
    table = run.score(chosen, draw, suite.QUICK if small else None)
    long, file = card.tidy(table, draw), paths.BUILD / "score" / f"{chosen.name}-{draw}.csv"
    write(file, long.to_csv(index=False, float_format="%.6g"))
    for _, row in table[table["failure"] != ""].iterrows():
        print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
    print(card.text(long))
    print(f"seed {draw}; written: {file}")


def description() -> str:
    """Names that `torque` of a law of the 1 kHz control cycle may use, with unit and meaning."""
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
