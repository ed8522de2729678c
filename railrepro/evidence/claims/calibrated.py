"""The calibrated car: a documented car, its controllers and experiments, on which the paper's statements hold together.

data/paper_like.toml lists every choice that was made for it: nominal, changed to, range in the literature, source, the
statements that it was chosen for. It shows that such a car exists and what it takes; it makes no verdict "reproduced",
its results stand in a column of their own. `python -m railrepro calibrated` writes data/results:
paper_like.csv (what holds, and by how much), paper_like_conflicts.csv (statements on Fig. 9 over its shortest wave) and
paper_like_perturbed.csv (all changed numbers off by one and by three percent).

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
from railrepro.evidence.runs.executor import ordered_map

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

    Attributes:
        nominal, value (number, text or list): Values of the uncalibrated car at the setting `paper`, and of the
            calibrated car, in `unit`.
        unit: str
        range (list of two numbers, or "free"): Range in the literature in `unit`; "free" where none was found or the
            paper leaves the value open.
        source (str): Source of the range.
        statements (tuple of str): Ids of the paper's statements that the value was chosen for.
        why (str): How the value acts on these statements.
    """

    nominal: Any
    value: Any
    unit: str
    range: Annotated[list[data.Number], Field(min_length=2, max_length=2)] | Literal["free"]
    source: str
    statements: tuple[str, ...]
    why: str


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


def cars() -> dict[str, ProbeSetup]:
    """Setups of the probe: "calibrated", and "uncalibrated" (nominal car, tuned controllers of the setting `paper`)."""
    return {"calibrated": setup(_values(load())), "uncalibrated": setup({})}


def judged(world: ProbeSetup, parts: Iterable[str] = PARTS) -> pd.DataFrame:
    """Judge a car with its controllers (`world`) by the paper's statements that the runs of `parts` (`PARTS`) decide.

    A row per statement: statement (id), value and its limits above, below (unit of the statement), margin (relative
    distance from the nearer limit, absolute from a limit of zero; positive inside), holds (whether it is reproduced).
    """
    found, rows = statements.findings(Evidence({(s, c, m): v for s, c, m, v in probe(world, parts)})), []
    for identity, rule in statements.load().items():
        if identity not in found:
            continue
        value = found[identity].value
        margins = [
            sign * (value / limit - 1 if limit else value)
            for sign, limit in ((1, rule.above), (-1, rule.below))
            if limit is not None
        ]
        holds = rule.judge(found[identity]) == REPRODUCED
        rows.append((identity, value, rule.above, rule.below, min(margins), holds))
    return pd.DataFrame(rows, columns=["statement", "value", "above", "below", "margin", "holds"])


def perturbed(choices: Mapping[str, Choice], size: float, draw: int) -> dict[str, Any]:
    """Values of all choices by name, every number other than nominal times 1 + size u with u uniform in [-1, 1].

    `choices` are from `load`, `draw` is the seed of u. k_a and k_s of poor rail stay at most 1.
    """
    rng, values = np.random.default_rng([SEED, draw]), _values(choices)
    for name, choice in choices.items():
        if data.is_number(choice.value) and choice.value != choice.nominal:
            values[name] = min(choice.value * (1 + size * rng.uniform(-1, 1)), _LARGEST.get(name, np.inf))
    return values


def conflict(wave: float) -> pd.DataFrame:
    """Judge the calibrated car with `wave` (m) as shortest wave in Fig. 9: columns of `judged`, and wave_m (m)."""
    return judged(setup(_values(load()) | {WAVE: wave}), ["brake"]).assign(wave_m=wave)


def main(draws: int | None = None) -> None:
    """Judge the calibrated car and `draws` perturbations of each size (default `DRAWS`), write the tables, print sums.

    Columns of paper_like.csv: see `judged`; of paper_like_conflicts.csv: see `conflict`; of paper_like_perturbed.csv:
    size (relative), draw (number), holds (number of statements that hold), falls (ids of those that no longer do).
    """
    choices = load()
    moves = [(size, draw) for size in SIZES for draw in range(DRAWS if draws is None else draws)]
    cases = [_values(choices), *(perturbed(choices, size, draw) for size, draw in moves)]
    judgements = ordered_map(lambda case: judged(setup(case)), cases, "calibrated car")
    conflicts = pd.concat(ordered_map(conflict, WAVES, "conflicts"))
    kept, *held = (set(found.loc[found["holds"], "statement"]) for found in judgements)
    rows = [(*move, len(each), " ".join(sorted(kept - each))) for move, each in zip(moves, held, strict=True)]
    moved = pd.DataFrame(rows, columns=["size", "draw", "holds", "falls"])
    for name, table in (("", judgements[0]), ("_conflicts", conflicts), ("_perturbed", moved)):
        write(paths.product(f"data/results/paper_like{name}.csv"), table.to_csv(index=False, float_format="%.6g"))
    print(f"{len(kept)} of {len(judgements[0])} hold; over perturbations")
    print(moved.groupby("size")["holds"].agg(["min", "mean"]))
