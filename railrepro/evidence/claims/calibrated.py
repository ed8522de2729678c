"""The calibrated car: a documented car, its controllers and experiments, on which the paper's statements hold together.

data/paper_like.toml lists every choice that was made for it: nominal, changed to, range in the literature, source, the
statements that it was chosen for. It shows that such a car exists and what it takes; it makes no verdict "reproduced",
its results stand in a column of their own. `python -m railrepro calibrated [--draws N]` writes data/results:
paper_like.csv (what holds, and by how much), paper_like_alone.csv (which statements fall when a choice is put back
alone), paper_like_conflicts.csv (what no value of a choice fulfils together) and paper_like_perturbed.csv (all changed
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
    """One entry of data/paper_like.toml.

    Attributes
    ----------
    nominal, value : number, text or list
        Of the uncalibrated car at the setting `paper`, and of the calibrated one.
    unit : str
    range : list of two numbers, or "free"
        What the literature gives; "free" where nothing was found or the paper leaves it open.
    source : str
        Of the range.
    statements : tuple of str
        The statements that it was chosen for.
    why : str
        How it acts on them.
    instead : number, text or list, optional
        What is put back in `alone` when the nominal value is the same.
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
        """Whether a number differs from the nominal one."""
        return data.is_number(self.value) and self.value != self.nominal


def load(path: Path | str | None = None) -> dict[str, Choice]:
    """The choices by name (default data/paper_like.toml); InputError with one sentence on wrong entries."""
    file = data.location(path, paths.source("data/paper_like.toml"))
    choices = data.build(dict[str, Choice], data.read(file), file.name)
    try:
        setup({name: choice.value for name, choice in choices.items()}).car()
    except (InputError, TypeError) as error:
        raise InputError(f"{file.name}: {error}") from None
    return choices


def table(*names: str) -> pd.DataFrame:
    """Some choices as a chapter shows them."""
    rows = {
        name: [str(choice.nominal), str(choice.value), choice.unit, str(choice.range), ", ".join(choice.statements)]
        for name, choice in load().items()
        if name in names
    }
    columns = ["uncalibrated", "calibrated", "unit", "literature", "chosen for"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns)


def cars() -> dict[str, ProbeSetup]:
    """Both cars on which the paper's figures are drawn, by name; the uncalibrated one with the sets of `paper`."""
    return {"calibrated": paper_like(), "uncalibrated": setup({})}


def paper_like(**instead: Any) -> ProbeSetup:
    """The calibrated car, with other values for some of its choices."""
    return setup({name: choice.value for name, choice in load().items()} | instead)


MATCHED = (
    *("C04", "C05", "C06", "C07", "C08", "C42", "C09", "C10", "C11", "C12", "C17", "C18", "C19", "C20"),
    *("C21", "C50", "C23", "C24", "C28", "C49", "C30", "C46", "C31", "C32"),
)
"""The statements about Figs. 6 to 9 that a probe can decide."""


def judged(world: ProbeSetup, parts: Iterable[str] = PARTS) -> pd.DataFrame:
    """Judge a car by the statements `MATCHED`: one row per statement for which these parts of the probe suffice.

    Columns statement, value, above, below, margin (to the nearer limit over that limit, to a limit of zero itself;
    positive inside), holds.
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
    """Each choice put back alone: name, what it is put back to, and the values of all choices then."""
    values = {name: choice.value for name, choice in choices.items()}
    put_back = {name: c.nominal if c.instead is None else c.instead for name, c in choices.items()}
    return [(name, back, values | {name: back}) for name, back in put_back.items() if back != values[name]]


def conflict(wave: float) -> pd.DataFrame:
    """Judge the calibrated car in Fig. 9 with another shortest wave (m): columns of `judged`, and wave_m."""
    return judged(paper_like(**{WAVE: wave}), ["brake"]).assign(wave_m=wave)


def perturbed(choices: Mapping[str, Choice], size: float, draw: int) -> dict[str, Any]:
    """Values of the choices with every changed number off by at most a relative size, drawn evenly."""
    rng = np.random.default_rng([SEED, draw])
    values = {name: choice.value for name, choice in choices.items()}
    moved = {name: values[name] * (1 + size * rng.uniform(-1, 1)) for name, choice in choices.items() if choice.changed}
    return values | {name: min(value, _LARGEST.get(name, np.inf)) for name, value in moved.items()}


def tables(draws: int = DRAWS, quiet: bool = False) -> dict[str, pd.DataFrame]:
    """Tables by the end of their names.

    '': see `judged`; _alone: choice, put_back, holds (number), falls (statements); _conflicts: see `conflict`;
    _perturbed: size, draw, holds, falls.
    """
    choices = load()
    values, one_back = {name: choice.value for name, choice in choices.items()}, alone(choices)
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
    """Judge the calibrated car, put its choices back one by one, perturb them, and write the tables."""
    found = tables(DRAWS if draws is None else draws)
    for name, table in found.items():
        write(paths.product(f"data/results/paper_like{name}.csv"), table.to_csv(index=False, float_format="%.6g"))
    print(found["_alone"].to_string(index=False))
    kept = found["_perturbed"].groupby("size")["holds"].agg(["min", "mean"])
    print(f"{found['']['holds'].sum()} of {len(found[''])} hold; over perturbations\n{kept}")
