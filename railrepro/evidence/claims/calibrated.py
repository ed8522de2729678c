"""The calibrated car: a documented car, its controllers and experiments, on which the paper's statements hold together.

data/paper_like.toml lists every choice that was made for it. It shows that such a car exists and what it takes; it
makes no verdict "reproduced", its results stand in a column of their own. `python -m railrepro calibrated` writes the
tables paper_like.csv, paper_like_undone.csv, paper_like_conflicts.csv and paper_like_perturbed.csv. Serves the paper's
section Multi-Body Simulation Results.
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
from railrepro.studies.executor import ordered_map

PARTS = ("curve", "sine", "loss", "brake")
"""What Figs. 6 to 9 show, see `probe.PARTS`."""
SIZES, DRAWS, SEED = (0.01, 0.03), 10, 2026
"""Largest relative perturbations, draws of each, seed of the first."""
R_FACTORS = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Factors on the one R of NMPC (-), which some statements want small and others large."""
_LARGEST = {"adhesion.poor.k_a": 1.0, "adhesion.poor.k_s": 1.0}


@data.table
class Choice:
    """One choice made for the calibrated car: a parameter with its value, an entry of data/paper_like.toml.

    Attributes:
        nominal (number, text or list): Value in `unit` of the uncalibrated car in the setting `paper`.
        value (number, text or list): Value in `unit` of the calibrated car.
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
    range: Annotated[list[data.Plain], Field(min_length=2, max_length=2)] | Literal["free"]
    source: str
    statements: tuple[str, ...]
    why: str

    def __post_init__(self) -> None:
        within = self.range == "free" or all(
            data.is_number(value) and self.range[0] <= value <= self.range[1] for value in (self.nominal, self.value)
        )
        if not within:
            needed = '"free" or [low, high] around both is needed'
            raise ValueError(f"goes from {self.nominal!r} to {self.value!r} with range {self.range}, {needed}")


def load(path: Path | str | None = None) -> dict[str, Choice]:
    """Choices for the calibrated car in a TOML file (default data/paper_like.toml), by name; InputError if wrong."""
    file = data.location(path, paths.source("data/paper_like.toml"))
    choices, known = data.build(dict[str, Choice], data.read(file), file.name), statements.load()
    for name, choice in choices.items():
        if unknown := sorted(set(choice.statements) - set(known)):
            raise InputError(f"{file.name}: {name}.statements has {unknown[0]!r}, which is no id of claims.toml")
    try:
        setup({name: choice.nominal for name, choice in choices.items()}).checked()
        setup(_values(choices)).checked()
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None
    return choices


def _values(choices: Mapping[str, Choice]) -> dict[str, Any]:
    """Value of each choice by its name."""
    return {name: choice.value for name, choice in choices.items()}


def cars() -> dict[str, ProbeSetup]:
    """Name -> `ProbeSetup` of two cars: "calibrated", and "uncalibrated" (nominal, tuned controllers of `paper`)."""
    return {"calibrated": setup(_values(load())), "uncalibrated": setup({})}


def judged(world: ProbeSetup, parts: Iterable[str] = PARTS) -> pd.DataFrame:
    """Judge the paper's statements on a car with its controllers (`world`): one row per statement.

    `parts` are names of groups of runs (`PARTS`); statements that need other runs have no row. Columns: statement (id);
    value; above and below, its limits (NaN for none); margin, distance of the value from the nearer limit over this
    limit (absolute for a limit of zero), positive inside; holds, whether the statement is reproduced.
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
    """Values of all `choices` (from `load`) by name, perturbed at random.

    Every number that differs from nominal is multiplied by 1 + `size` u with u uniform in [-1, 1]; `draw` seeds u.
    Other values stay as they are. k_a and k_s of poor rail stay at most 1.
    """
    rng, values = np.random.default_rng([SEED, draw]), _values(choices)
    for name, choice in choices.items():
        if data.is_number(choice.value) and choice.value != choice.nominal:
            values[name] = min(choice.value * (1 + size * rng.uniform(-1, 1)), _LARGEST.get(name, np.inf))
    return values


def conflict(factor: float) -> pd.DataFrame:
    """Table of `judged` for the calibrated car with R of NMPC times `factor` in all figures, with a column r_factor."""
    values = _values(load())
    r = setup(values).parameters["nmpc"]["r"]
    return judged(setup(values | {"nmpc:r": factor * r})).assign(r_factor=factor)


def undone(name: str) -> pd.DataFrame:
    """Table of `judged` for the calibrated car on which the choice `name` has its nominal value."""
    choices = load()
    return judged(setup(_values(choices) | {name: choices[name].nominal})).assign(choice=name)


def main() -> None:
    """Command `calibrated`: judge the calibrated car, cars without one choice and perturbed ones; write four tables to
    data/results.

    paper_like.csv has the columns of `judged`, paper_like_undone.csv those of `undone`, paper_like_conflicts.csv those
    of `conflict`. paper_like_perturbed.csv has a row per size in `SIZES` and draw: size (relative), draw (seed), holds
    (number of statements that hold), falls (ids of those that hold only without perturbation).
    """
    choices = load()
    moves = [(size, draw) for size in SIZES for draw in range(DRAWS)]
    cases = [_values(choices), *(perturbed(choices, size, draw) for size, draw in moves)]
    judgements = ordered_map(lambda case: judged(setup(case)), cases, "calibrated car")
    without = pd.concat(ordered_map(undone, [*choices], "one choice undone"))
    conflicts = pd.concat(ordered_map(conflict, R_FACTORS, "conflicts"))
    kept, *held = (set(found.loc[found["holds"], "statement"]) for found in judgements)
    rows = [(*move, len(each), " ".join(sorted(kept - each))) for move, each in zip(moves, held, strict=True)]
    moved = pd.DataFrame(rows, columns=["size", "draw", "holds", "falls"])
    tables = {"": judgements[0], "_undone": without, "_conflicts": conflicts, "_perturbed": moved}
    for name, table in tables.items():
        write(paths.product(f"data/results/paper_like{name}.csv"), table.to_csv(index=False, float_format="%.6g"))
    print(f"{len(kept)} of {len(judgements[0])} hold; over perturbations")
    print(moved.groupby("size")["holds"].agg(["min", "mean"]))
