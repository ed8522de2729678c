"""Numbers and sentences of the report: Jinja templates and expressions that are evaluated on the results.

A number in a template is an expression with a filter that shows it as a link to its table, such as
`{{ e('paper', 'braking', 'ndi', 'stopping_distance') | linked('nominal_metrics', 'm') }}`, in short
`{{ q('paper', 'braking', 'ndi', 'stopping_distance', 'm') }}`. A template may call the methods that
`CALLABLE` names. data/theses.toml has sentences with the conditions under which they are true.
"""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Literal

import jinja2
import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.car.equations import BODIES, WHEELS
from railrepro.car.kinematics import COORDINATES
from railrepro.data import InputError
from railrepro.evidence.claims import calibrated, statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import REPRODUCED, Evidence, Finding, MissingEvidence
from railrepro.evidence.runs import tuning
from railrepro.evidence.uncertainty.robustness import LABELS, holds
from railrepro.simulation.scenarios import load_scenario

FILE = "data/theses.toml"
UNKNOWN = "n/a"
CALLABLE = (
    *("e", "q", "find", "holds", "table", "cell", "csv", "printed", "sentences"),
    *("tuned", "swarm_cost", "choice", "seeds", "set_point", "freedoms", "time"),
    *("share_of_third", "pole_that_follows", "forecast_shift"),
)
"""Methods of `Prose` that templates and conditions may call."""


@data.table
class Thesis:
    """Entry of data/theses.toml: a sentence, and the conditions that must all be true for it to be said."""

    says: str
    true: Annotated[tuple[str, ...], data.NOT_EMPTY]
    role: Literal["summary", "why", "holds_if", "readme"]
    of: tuple[str, ...] = ()


def load() -> dict[str, Thesis]:
    """Read all sentences by name, in their order."""
    file = paths.source(FILE)
    found = data.build(dict[str, Thesis], data.read(file), file.name)
    known = statements.load()
    for name, thesis in found.items():
        for identity in thesis.of:
            if identity not in known:
                raise InputError(f"{file.name}: [{name}] explains {identity}, which claims.toml does not have")
    return found


def quantity(value: float, unit: str = "") -> str:
    """Write a number (SI) with three digits in a unit; "derailed" for an infinite one."""
    if np.isinf(value):
        return "derailed"
    if np.isnan(value):
        return UNKNOWN
    shown = {"mm": 1e3, "%": 100.0}.get(unit, 1.0) * value
    return (f"{shown:.3g}" if abs(shown) < 100 else f"{shown:.1f}".removesuffix(".0")) + (f" {unit}" if unit else "")


def link(shown: str, file: str) -> str:
    """Write a number as a Markdown link to the file that it comes from; bare where there is none."""
    return f"[{shown}]({file})" if file and shown != UNKNOWN else shown


def table_file(name: str) -> str:
    """Return the path of a table of data/results; what is a path already stays."""
    return name if "/" in name else f"data/results/{name}.csv"


class Prose:
    """Templates and conditions on the results.

    Parameters
    ----------
    nominal : Nominal
        The nominal case in all settings.
    linked : bool
        Whether numbers are links to their tables.
    """

    def __init__(self, nominal: Nominal, linked: bool = True):
        self.nominal, self._linked = nominal, linked
        self._jinja = jinja2.Environment(
            undefined=jinja2.StrictUndefined,
            loader=jinja2.FunctionLoader(_source),
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        self._jinja.filters["linked"] = self.linked
        self._jinja.globals |= {name: getattr(self, name) for name in CALLABLE}

    def render(self, name: str, **more) -> str:
        """Fill in a template of data/.

        Raises
        ------
        InputError
            With file and line, when it cannot be read or asks for what is not there.
        """
        return self._filled(name, lambda: self._jinja.get_template(name), more)

    def text(self, text: str, **more) -> str:
        """Fill in a template that is handed over."""
        return self._filled(text, lambda: self._jinja.from_string(text), more)

    def _filled(self, name: str, template, more: Mapping) -> str:
        try:
            return template().render(**more)
        except jinja2.TemplateSyntaxError as error:
            raise InputError(f"{name} line {error.lineno}: {error.message}") from error
        except (InputError, jinja2.UndefinedError, LookupError, TypeError) as error:
            frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename in (name, "<template>")]
            line = f" line {frames[-1].lineno}" if frames else ""
            raise InputError(f"{name}{line}: {error}") from error

    def true(self, condition: str) -> bool:
        """Evaluate a condition; False when the results do not have what it asks for, InputError on a wrong one."""
        try:
            return bool(self._jinja.compile_expression(condition, undefined_to_none=False)())
        except MissingEvidence:
            return False
        except (jinja2.TemplateError, LookupError, TypeError) as error:
            raise InputError(f"{condition!r} cannot be evaluated: {error}") from error

    def refuted(self) -> dict[str, list[str]]:
        """Find the sentences that the tables refute: name -> conditions that are not true."""
        found = {name: [c for c in thesis.true if not self.true(c)] for name, thesis in load().items()}
        return {name: wrong for name, wrong in found.items() if wrong}

    def sentences(self, role: str) -> list[tuple[tuple[str, ...], str]]:
        """Fill in the true sentences of a role: the statements that each explains, and its text."""
        return [
            (thesis.of, self.text(thesis.says))
            for thesis in load().values()
            if thesis.role == role and all(self.true(condition) for condition in thesis.true)
        ]

    def reasons(self, identity: str) -> str:
        """Say why a statement fails."""
        return " ".join(says for of, says in self.sentences("why") if identity in of)

    def linked(self, value: float | str, table: str, unit: str = "") -> str:
        """Show a number with three digits, or text as it is, as a link to its table."""
        shown = value if isinstance(value, str) else quantity(float(value), unit)
        return link(shown, table_file(table)) if self._linked else shown

    def e(self, setting: str, scenario: str, controller: str, metric: str) -> float:
        """Look up a metric in a setting."""
        return self._evidence(setting)(scenario, controller, metric)

    def q(self, setting: str, scenario: str, controller: str, metric: str, unit: str = "") -> str:
        """Show a metric in a setting as a link to its table."""
        value = self.e(setting, scenario, controller, metric)
        return self.linked(value, self.nominal.table_of(setting, scenario, controller, metric), unit)

    def find(self, identity: str, setting: str) -> Finding:
        """Evaluate the predicate of a statement in a setting."""
        return statements.find(identity, self._evidence(setting))

    def _evidence(self, setting: str) -> Evidence:
        if setting not in ("", *tuning.SETTINGS):
            raise InputError(f"{setting!r} is no setting; there are {', '.join(tuning.SETTINGS)}")
        return self.nominal.evidence(setting)

    def holds(self, identity: str, setting: str) -> bool:
        """Tell whether a statement holds in a setting, or on the car `calibrated`."""
        if setting == "calibrated":
            return self.nominal.on_calibrated_car().get(identity) == "yes"
        return statements.load()[identity].judge(self.find(identity, setting)) == REPRODUCED

    def table(self, name: str) -> pd.DataFrame:
        """Read a table of data/results; MissingEvidence when it is not made yet."""
        found = self.nominal.results.optional(name)
        if found is None:
            raise MissingEvidence(name)
        return found

    def cell(self, name: str, column: str, **where):
        """Look up the cell in a column of a table, in the only row with the given values."""
        table = self.table(name)
        if not {column, *where} <= set(table):
            raise MissingEvidence(f"{name}: {column}")
        rows = table.loc[np.logical_and.reduce([table[key] == value for key, value in where.items()]), column]
        if len(rows) != 1:
            raise MissingEvidence(f"{name}: {len(rows)} rows with {where}")
        return rows.iloc[0]

    def csv(self, relative: str) -> pd.DataFrame:
        """Read a table of the checkout as text."""
        return pd.read_csv(paths.source(relative), dtype=str).fillna("")

    def tuned(self, controller: str, setting: str = tuning.PAPER) -> dict:
        """Look up the tuned parameters of a controller."""
        return tuning.load(controller, setting)["parameters"]

    def swarm_cost(self, controller: str) -> float:
        """Look up the cost of what the swarm of a controller found on `paper`."""
        return tuning.load(controller, tuning.PAPER, searched=True)["cost"]

    def choice(self, name: str) -> float:
        """Look up a choice of the calibrated car."""
        return calibrated.load()[name].value

    def seeds(self) -> int:
        """Count the swarms of each tuned set."""
        return len(tuning.load_task().budget["seeds"])

    def freedoms(self) -> int:
        """Count the degrees of freedom of the car: those of the bodies, and one per wheel."""
        return len(BODIES) * len(COORDINATES) // 2 + len(WHEELS)

    def set_point(self, scenario: str) -> str:
        """Describe amplitude and wavelengths of a scenario's set point."""
        point = load_scenario(scenario).set_point
        waves = [f"{value:g}" for key, value in point.items() if key.startswith("period")]
        return f"{point['amplitude_mm']:g} mm, {' to '.join(waves)} m"

    def printed(self, what: str) -> str:
        """Show a number that the paper prints, with its unit."""
        row = self.csv("data/paper_numbers.csv").set_index("what").loc[what]
        return self.linked(f"{row['paper']} {row['unit']}".removesuffix(" -"), "data/paper_numbers.csv")

    def time(self, solver: str, column: str = "median_ms") -> float:
        """Median over the scenarios of a column of solve_times.csv, with NMPC of the setting `paper`."""
        return float(statements.usual_times(self.nominal.evidence(tuning.PAPER), solver, column).median())

    def pole_that_follows(self) -> float:
        """Triple pole from which NDI on T3 stays below 0.71 of the error of y = 0 (rad/s)."""
        poles = self.table("ndi_poles").sort_values("pole_radps", kind="stable")
        limit = 0.71e3 * self.e(tuning.PAPER, statements.T3, statements.NOTHING, "rmse_y")
        if poles["rmse_mm"].iloc[-1] > limit or poles["rmse_mm"].iloc[0] < limit:
            raise MissingEvidence("pole of NDI that follows")
        return float(np.interp(-limit, -poles["rmse_mm"], poles["pole_radps"]))

    def forecast_shift(self) -> float:
        """Displacement of the forecast over the horizon of NMPC by the mean braking of Fig. 9 (cm)."""
        way = self.e(tuning.PAPER, statements.BRAKE, "nmpc", "stopping_distance")
        return 100 * load_scenario("braking").speed ** 2 / (2 * way) * self.tuned("nmpc")["horizon_s"] ** 2 / 2

    def share_of_third(self, identity: str, parameter: str, largest: bool = False) -> float:
        """Share (%) of a third of the samples, with the smallest values of a parameter or the largest, that hold."""
        if not {identity, parameter} <= set(self._sampled):
            raise MissingEvidence(f"samples of {identity} and {parameter}")
        place = self._sampled[parameter].rank(pct=True)
        chosen = place > 2 / 3 if largest else place <= 1 / 3
        return 100 * float(self._sampled.loc[chosen, identity].astype(float).mean())

    @cached_property
    def _sampled(self) -> pd.DataFrame:
        """Which statement holds in which sample of the setting `paper`, with the values drawn."""
        table = self.table("robustness_samples")
        if not set(LABELS) <= set(table):
            raise MissingEvidence("robustness")
        table = table[table["setting"] == tuning.PAPER].reset_index(drop=True)
        return holds(table).join(table[[name for name in table if "/" not in name and name not in LABELS]])


def _source(name: str) -> tuple[str, str, None]:
    """Text of a template of data/, with the name that tracebacks shall have."""
    return paths.source(f"data/{name}").read_text(encoding="utf-8"), name, None
