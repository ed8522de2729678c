"""The calibrated car: car, controllers and experiments chosen such that the paper's statements hold together.
data/paper_like.toml documents every choice. The car shows which choices it takes; no verdict follows from it, its
results have a column of their own. Serves the paper's section Multi-Body Simulation Results."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from railrepro import data, paths
from railrepro.control.registry import PAPER
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.probe import probe
from railrepro.evidence.claims.setup import ProbeSetup, setup
from railrepro.evidence.claims.statements import REPRODUCED, Evidence
from railrepro.studies.executor import ordered_map

PARTS = ("curve", "sine", "loss", "brake")
"""Groups of runs that Figs. 6 to 9 show: curve entry, sine at five speeds, loss of adhesion, braking."""
SIZES, DRAWS, SEED = (0.01, 0.03), 10, 2026
"""Largest relative perturbations; number of draws of each; seed, together with the number of the draw."""
R_FACTORS = (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Factors on the weight R of NMPC (-), for which statements conflict."""


@data.table
class Choice:
    """Value of one parameter of the calibrated car, which was fitted to the paper's statements; one table of
    data/paper_like.toml. `nominal` is the value of the uncalibrated car, `value` that of the calibrated car, a number,
    text or list in `unit`. `range` is the range in the literature, two numbers in `unit`, and `source` its source;
    "free" means that none was found or that the paper leaves the value open. The value was chosen for the `statements`
    (ids); `why` says how it acts on them. InputError if `nominal` or `value` is outside of `range`."""

    nominal: Any
    value: Any
    unit: str
    range: Annotated[list[data.Plain], Field(min_length=2, max_length=2)] | Literal["free"]
    source: Annotated[str, data.NOT_EMPTY]
    statements: tuple[str, ...]
    why: Annotated[str, data.NOT_EMPTY]

    def __post_init__(self) -> None:
        if self.range == "free":
            return
        low, high = self.range
        if not all(data.is_number(value) and low <= value <= high for value in (self.nominal, self.value)):
            needed = '"free" or [low, high] around both is needed'
            raise ValueError(f"goes from {self.nominal!r} to {self.value!r} with range {self.range}, {needed}")


def load(path: Path | str | None = None) -> dict[str, Choice]:
    """Read a TOML file of choices (default data/paper_like.toml): parameter of the calibrated car -> `Choice`, its
    value fitted to the paper's statements, with nominal value, range and reason. InputError for a wrong file, field or
    statement id, or if car, controllers or scenarios refuse the nominal or the fitted values."""
    file = data.location(path, paths.source("data/paper_like.toml"))
    choices, known = data.build(dict[str, Choice], data.read(file), file.name), statements.load()
    for name, choice in choices.items():
        if unknown := sorted(set(choice.statements) - set(known)):
            raise data.InputError(f"{file.name}: {name}.statements has {unknown[0]!r}, which is no id of claims.toml")
    try:
        setup({name: choice.nominal for name, choice in choices.items()}).checked()
        setup(_values(choices)).checked()
    except data.InputError as error:
        raise data.InputError(f"{file.name}: {error}") from None
    return choices


def _values(choices: Mapping[str, Choice]) -> dict[str, Any]:
    return {name: choice.value for name, choice in choices.items()}


def cars() -> dict[str, ProbeSetup]:
    """Make the setups of two cars with their controllers: "calibrated" with the values of data/paper_like.toml, which
    were fitted to the paper's statements, and "uncalibrated" with nominal values."""
    return {"calibrated": setup(_values(load())), "uncalibrated": setup({})}


def judged(world: ProbeSetup, parts: Iterable[str] = PARTS) -> pd.DataFrame:
    """Judge the paper's statements on a car with its controllers (`world`): one row per statement. Controllers that
    differ by less than the scatter between tuning seeds are tied, and the statement does not hold. `parts` names groups
    of runs of `probe`, as "sine"; statements that need other runs or tables have no row. Columns: statement (id);
    value; above and below, its lower and upper limit (NaN for none); margin, distance to the nearer limit over this
    limit (not divided for a limit of 0), negative outside; holds, whether the statement is reproduced."""
    found, rows = statements.findings(Evidence(probe(world, parts), Nominal().evidence(PAPER).spread)), []
    for identity, rule in statements.load().items():
        if identity not in found:
            continue
        value = found[identity].value
        limits = [(sign, limit) for sign, limit in ((1, rule.above), (-1, rule.below)) if limit is not None]
        margins = [sign * (value / limit - 1 if limit else value) for sign, limit in limits]
        rows.append((identity, value, rule.above, rule.below, min(margins), rule.judge(found[identity]) == REPRODUCED))
    return pd.DataFrame(rows, columns=["statement", "value", "above", "below", "margin", "holds"])


def perturbed(choices: Mapping[str, Choice], size: float, draw: int) -> dict[str, Any]:
    """Change fitted parameters (`choices`) at random; returns name -> value. Fitted numbers that differ from their
    nominal value are multiplied by 1 + `size` u, each with its own u, uniform in [-1, 1], which depends on `draw` only.
    Other values stay; k_a and k_s of poor rail stay at most 1."""
    rng, values = np.random.default_rng([SEED, draw]), _values(choices)
    for name, choice in choices.items():
        if data.is_number(choice.value) and choice.value != choice.nominal:
            largest = 1.0 if name.startswith("adhesion.poor.k_") else np.inf
            values[name] = min(choice.value * (1 + size * rng.uniform(-1, 1)), largest)
    return values


def conflict(factor: float) -> pd.DataFrame:
    """Judge the calibrated car with the weight R of NMPC times `factor`: a table of `judged` with a column r_factor.
    Calls with several factors show which statements need an R that others forbid."""
    values = _values(load())
    r = setup(values).parameters["nmpc"]["r"]
    return judged(setup(values | {"nmpc:r": factor * r})).assign(r_factor=factor)


def undone(name: str) -> pd.DataFrame:
    """Judge the calibrated car with one fitted parameter, `name`, set back to its nominal value: a table of `judged`
    with a column choice (this name). Statements that no longer hold in it depend on this parameter."""
    choices = load()
    return judged(setup(_values(choices) | {name: choices[name].nominal})).assign(choice=name)


def main() -> None:
    """Command `calibrated`: judge the paper's statements on the car that was fitted to them (data/paper_like.toml).
    Writes four tables to data/results. paper_like.csv has a row per statement (columns of `judged`).
    paper_like_undone.csv has these rows for each fitted parameter (column choice) alone back at its nominal value;
    paper_like_conflicts.csv for each factor on the weight R of NMPC (column r_factor, 0.5 to 8).
    paper_like_perturbed.csv has a row per random change of all fitted parameters: size (largest relative change), draw
    (seed), holds (number of statements that hold), falls (ids of the statements that hold with the fitted values, but
    not with the changed ones)."""
    choices = load()
    moves = [(size, draw) for size in SIZES for draw in range(DRAWS)]
    cases = [_values(choices), *(perturbed(choices, size, draw) for size, draw in moves)]
    judgements = ordered_map(lambda case: judged(setup(case)), cases, "calibrated car")
    without = pd.concat(ordered_map(undone, [*choices], "one choice undone"))
    conflicts = pd.concat(ordered_map(conflict, R_FACTORS, "conflicts"))
    nominal, *held = (set(table.loc[table["holds"], "statement"]) for table in judgements)
    rows = [(*move, len(each), " ".join(sorted(nominal - each))) for move, each in zip(moves, held, strict=True)]
    moved = pd.DataFrame(rows, columns=["size", "draw", "holds", "falls"])
    tables = {"": judgements[0], "_undone": without, "_conflicts": conflicts, "_perturbed": moved}
    for name, table in tables.items():
        data.write(paths.product(f"data/results/paper_like{name}.csv"), table.to_csv(index=False, float_format="%.6g"))
    print(f"{len(nominal)} of {len(judgements[0])} hold; over perturbations")
    print(moved.groupby("size")["holds"].agg(["min", "mean"]))
