"""The calibrated car: a documented car, its controllers and experiments, on which the paper's statements hold together.

data/paper_like.toml lists every choice that was made for it: nominal, changed to, range in the literature, source, the
statements that it was chosen for. It shows that such a car exists and what it takes; it makes no verdict "reproduced",
its results stand in a column of their own. `python -m railrepro calibrated [--draws N]` writes data/results:
paper_like.csv (what holds, and by how much), paper_like_alone.csv (which statements fall when a choice is put back
alone), paper_like_conflicts.csv (statements on Fig. 9 over its shortest wave) and paper_like_perturbed.csv (all changed
numbers off by one and by three percent).

Serves the paper's section Multi-Body Simulation Results.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from railrepro import data, paths
from railrepro.data import InputError, write
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.probe import probe
from railrepro.evidence.claims.setup import ProbeSetup, setup
from railrepro.evidence.claims.statements import REPRODUCED, Evidence
from railrepro.evidence.runs.executor import executor, ordered_map

PARTS = ("curve", "sine", "loss", "brake")
"""What Figs. 6 to 9 show, see `probe.PARTS`."""
SIZES, DRAWS, SEED = (0.01, 0.03), 20, 2026
"""Largest relative perturbations, draws of each, seed of the first."""
WAVE, WAVES = "brake_sweep:period_end_m", (10.0, 12.5, 15.0, 17.5, 20.0, 25.0, 30.0, 40.0)
"""A choice that some statements on Fig. 9 want small and another large, the shortest wave (m), and its levels."""
_LARGEST = {"adhesion.poor.k_a": 1.0, "adhesion.poor.k_s": 1.0}


@data.table
class Choice:
    """One choice made for the calibrated car: a parameter with its value, an entry of data/paper_like.toml.

    Attributes
    ----------
    nominal, value : number, text or list
        Values of the uncalibrated car at the setting `paper`, and of the calibrated car, in `unit`.
    unit : str
    range : list of two numbers, or "free"
        Range in the literature in `unit`; "free" where none was found or the paper leaves the value open.
    source : str
        Source of the range.
    statements : tuple of str
        Ids of the paper's statements that the value was chosen for.
    why : str
        How the value acts on these statements.
    instead : number, text or list, optional
        Value that `alone` puts back in place of `nominal`.
    """

    nominal: Any
    value: Any
    unit: str
    range: Annotated[list[data.Number], Field(min_length=2, max_length=2)] | Literal["free"]
    source: str
    statements: tuple[str, ...]
    why: str
    instead: Any = None

    @property
    def changed(self) -> bool:
        """Whether `value` is a number other than `nominal`."""
        return data.is_number(self.value) and self.value != self.nominal


def load(path: Path | str | None = None) -> dict[str, Choice]:
    """Choices of a TOML file (default data/paper_like.toml) by name; InputError for a wrong entry."""
    file = data.location(path, paths.source("data/paper_like.toml"))
    choices = data.build(dict[str, Choice], data.read(file), file.name)
    try:
        setup(_values(choices)).car()
    except (InputError, TypeError) as error:
        raise InputError(f"{file.name}: {error}") from None
    return choices


def _values(choices: Mapping[str, Choice]) -> dict[str, Any]:
    """Value of each choice by its name."""
    return {name: choice.value for name, choice in choices.items()}


def table(*names: str) -> pd.DataFrame:
    """Text table of choices, a row per name: uncalibrated, calibrated, unit, literature (range), chosen for (ids)."""
    rows = {
        name: [str(choice.nominal), str(choice.value), choice.unit, str(choice.range), ", ".join(choice.statements)]
        for name, choice in load().items()
        if name in names
    }
    columns = ["uncalibrated", "calibrated", "unit", "literature", "chosen for"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def cars() -> dict[str, ProbeSetup]:
    """Setups of the probe: "calibrated", and "uncalibrated" (nominal car, tuned controllers of the setting `paper`)."""
    return {"calibrated": paper_like(), "uncalibrated": setup({})}


def paper_like(**instead: Any) -> ProbeSetup:
    """Calibrated car, controllers and experiments as setup of a probe; `instead` replaces values of choices by name."""
    return setup(_values(load()) | instead)


MATCHED = (
    *("C04", "C05", "C06", "C07", "C08", "C42", "C09", "C10", "C11", "C12", "C17", "C18", "C19", "C20"),
    *("C21", "C50", "C23", "C24", "C28", "C49", "C30", "C46", "C31", "C32"),
)
"""The statements about Figs. 6 to 9 that a probe can decide."""


def judged(world: ProbeSetup, parts: Iterable[str] = PARTS) -> pd.DataFrame:
    """Judge a car with its controllers (`world`) by the paper's statements on Figs. 6 to 9, one row per statement.

    Statements are those of `MATCHED` that the runs of `parts` (see `PARTS`) decide. Columns statement (id), value and
    its limits above, below (unit of the statement), margin (relative distance from the nearer limit, absolute from a
    limit of zero; positive inside), holds (whether the statement is reproduced).
    """
    evidence = Evidence({(s, c, m): v for s, c, m, v in probe(world, parts)})
    rows, found = [], statements.findings(evidence)
    for identity, rule in statements.load().items():
        if identity not in MATCHED or identity not in found:
            continue
        finding = found[identity]
        margins = [
            sign * (finding.value / limit - 1 if limit else finding.value)
            for sign, limit in ((1, rule.above), (-1, rule.below))
            if limit is not None
        ]
        holds = rule.judge(finding) == REPRODUCED
        rows.append((identity, finding.value, rule.above, rule.below, min(margins), holds))
    return pd.DataFrame(rows, columns=["statement", "value", "above", "below", "margin", "holds"])


def alone(choices: Mapping[str, Choice]) -> list[tuple[str, Any, dict[str, Any]]]:
    """Undo one choice at a time: list of (name, value put back: `instead`, else `nominal`; all values by name)."""
    values = _values(choices)
    put_back = {name: c.nominal if c.instead is None else c.instead for name, c in choices.items()}
    return [(name, back, values | {name: back}) for name, back in put_back.items() if back != values[name]]


def conflict(wave: float) -> pd.DataFrame:
    """Judge the calibrated car with `wave` (m) as shortest wave in Fig. 9: columns of `judged`, and wave_m (m)."""
    return judged(paper_like(**{WAVE: wave}), ["brake"]).assign(wave_m=wave)


def perturbed(choices: Mapping[str, Choice], size: float, draw: int) -> dict[str, Any]:
    """Values of all choices by name, every `Choice.changed` number times 1 + size u with u uniform in [-1, 1].

    `choices` are from `load`, `draw` is the seed of u. k_a and k_s of poor rail stay at most 1.
    """
    rng = np.random.default_rng([SEED, draw])
    values = _values(choices)
    moved = {name: values[name] * (1 + size * rng.uniform(-1, 1)) for name, choice in choices.items() if choice.changed}
    return values | {name: min(value, _LARGEST.get(name, np.inf)) for name, value in moved.items()}


def tables(draws: int = DRAWS, quiet: bool = False) -> dict[str, pd.DataFrame]:
    """DataFrames for data/results/paper_like*.csv by the end of the file name; `draws` perturbations of each size.

    "": see `judged`. "_alone": choice, put_back (value), holds (number of statements that hold), falls (ids of those
    that no longer do). "_conflicts": see `conflict`. "_perturbed": size (relative), draw (number), holds, falls.
    """
    choices = load()
    values, one_back = _values(choices), alone(choices)
    moves = [(size, draw) for size in SIZES for draw in range(draws)]
    cases = [values, *(case for *_, case in one_back), *(perturbed(choices, size, draw) for size, draw in moves)]
    with executor() as pool:
        whole, *rest = ordered_map(pool, lambda case: judged(setup(case)), cases, "calibrated car", quiet)
        conflicts = ordered_map(pool, conflict, WAVES, "conflicts", quiet)
    kept = set(whole.loc[whole["holds"], "statement"])
    held = [set(found.loc[found["holds"], "statement"]) for found in rest]
    ends = [(len(each), " ".join(sorted(kept - each))) for each in held]
    labels = [*((name, str(back)) for name, back, _ in one_back), *moves]
    rows = [(*label, *end) for label, end in zip(labels, ends, strict=True)]
    return {
        "": whole,
        "_alone": pd.DataFrame(rows[: len(one_back)], columns=["choice", "put_back", "holds", "falls"]),
        "_conflicts": pd.concat(conflicts),
        "_perturbed": pd.DataFrame(rows[len(one_back) :], columns=["size", "draw", "holds", "falls"]),
    }


def main(draws: int | None = None) -> None:
    """Compute `tables` (`draws` perturbations per size, default `DRAWS`), write them to data/results, print sums."""
    found = tables(DRAWS if draws is None else draws)
    for name, table in found.items():
        write(paths.product(f"data/results/paper_like{name}.csv"), table.to_csv(index=False, float_format="%.6g"))
    print(found["_alone"].to_string(index=False))
    kept = found["_perturbed"].groupby("size")["holds"].agg(["min", "mean"])
    print(f"{found['']['holds'].sum()} of {len(found[''])} hold; over perturbations\n{kept}")
