"""The report: REPLICATION.md, figures/README.md, codecheck.yml and the results in README.md, from templates in data/.
data/theses.toml has sentences with the conditions under which they are true. A number in them is an expression such as
`{{ q('paper', 'braking', 'ndi', 'stopping_distance', 'm') }}`, shown as a link to its table. Expressions may use the
public members of `Page` and the names that its constructor adds."""

import re
import sys
from typing import Annotated, Literal

import jinja2
import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.control.registry import PAPER, parameters
from railrepro.data import write
from railrepro.evidence.claims import calibrated, statements
from railrepro.evidence.claims.nominal import METRICS, Nominal
from railrepro.evidence.claims.setup import COLUMNS
from railrepro.evidence.report import claims, flips
from railrepro.figures import figure_number
from railrepro.simulation.scenarios import load_scenario
from railrepro.tuning import sets
from railrepro.tuning.task import load_task

MARKS = {"reproduced": "✓", "fragile": "✓?", "partly": "◐", "tie": "=", "not reproduced": "✗", "not testable": "–"}
"""Verdict, the best first -> its mark."""
BEGIN, END = "<!-- written by `make report` from data/readme.md.j2 -->\n", "<!-- end of what is written -->\n"
"""Lines of README.md between which its results are written."""
UNKNOWN = "n/a"
_LINK = re.compile(r"\[([^]]+)\]\(([^)]+)\)")


@data.table
class Thesis:
    """Sentence of the report with the conditions under which it is true, one table of data/theses.toml. `says` is the
    text, with Jinja expressions. It is shown if all Jinja conditions of `true` hold. `role` is its use: "summary";
    "why", why the statements with the ids `of` fail; "holds_if", when they would hold; "readme", "readme_limits"."""

    says: str
    true: Annotated[tuple[str, ...], data.NOT_EMPTY]
    role: Literal["summary", "why", "holds_if", "readme", "readme_limits"]
    of: tuple[str, ...] = ()


def theses() -> dict[str, Thesis]:
    """Read the conclusions of the report from data/theses.toml in the order of the file: name -> `Thesis`, a sentence
    with the conditions on results under which it is true."""
    return data.build(dict[str, Thesis], data.read(paths.source("data/theses.toml")), "theses.toml")


def main() -> int:
    """Command `report`: judge the statements; write claims.csv, REPLICATION.md, figures/README.md, codecheck.yml and
    the results in README.md. Returns 1 when a sentence of data/theses.toml is not true, else 0."""
    nominal = Nominal()
    page = Page(claims.evaluate(nominal), nominal)
    write(paths.product(claims.FILE), page.contract().to_csv(index=False, float_format="%.4g"))
    write(paths.product("REPLICATION.md"), page.replication())
    write(paths.product("figures/README.md"), page.render("gallery.md.j2"))
    write(paths.product("codecheck.yml"), page.render("codecheck.yml.j2"))
    write(paths.product("README.md"), page.readme(paths.source("README.md").read_text(encoding="utf-8")))
    print(page.judged.groupby(["setting", "judged"], sort=False).size().to_string())
    refuted = page.refuted()
    for name, conditions in refuted.items():
        print(f"data/theses.toml: {name} is not true: {'; '.join(conditions)}", file=sys.stderr)
    return int(bool(refuted))


class Page:
    """Functions and values for the Jinja templates of the report: REPLICATION.md, figures/README.md, README.md.
    `judged` are verdicts on the paper's statements from `claims.evaluate`, `nominal` metrics of runs of the nominal car
    from data/results. In all methods `identity` is the id of a statement in data/claims.toml, as "C05", and `setting`
    says how controllers were tuned and run: "paper" (exact measurements), "swarm" (the same, but poles of NDI by
    particle swarm) or "loop" (sensors)."""

    def __init__(self, judged: pd.DataFrame, nominal: Nominal):
        self.judged, self.nominal = judged, nominal
        self.rules = statements.load()
        self.verdicts = {identity: claims.headline(rows) for identity, rows in judged.groupby("id", sort=False)}
        self.statements = {identity: one for identity, one in self.verdicts.items() if one != claims.NO_VERDICT}
        self.calibrated_car = nominal.on_calibrated_car()
        spaces = dict.fromkeys(("trim_blocks", "lstrip_blocks", "keep_trailing_newline"), True)
        loader = jinja2.FileSystemLoader(paths.DATA)
        self._jinja = jinja2.Environment(undefined=jinja2.StrictUndefined, loader=loader, **spaces)
        self._jinja.filters |= {"linked": linked, "number": number}
        self._jinja.globals |= {name: getattr(self, name) for name in dir(self) if not name.startswith("_")}
        on_calibrated = judged.set_index("id")["calibrated"].map({"yes": "✓", "no": "✗", "": ""}).to_dict()
        mark = {identity: MARKS.get(verdict) for identity, verdict in self.verdicts.items()}
        self._jinja.globals |= {"mark": mark, "marks": MARKS, "calibrated": on_calibrated, "settings": COLUMNS}
        self._jinja.globals |= {"task": load_task(), "choices": calibrated.load(), "csv": csv}
        self._jinja.globals["horizons"] = data.read(paths.source("data/short_horizons.toml"))["search"]
        self._jinja.globals |= {"tuned": parameters, "load": sets.load, "scenario": load_scenario}

    def replication(self) -> str:
        """Return the text of REPLICATION.md in Markdown, the report with the verdict on each statement of the paper."""
        text = self.render("replication.md.j2", questions=flips.load().values())
        return "## ".join(_linked_once(section) for section in text.split("## "))

    def render(self, template: str, **more) -> str:
        """Return the text made from a template, a file name in data/. It may use the notebooks (`chapters`), the
        tolerances of products of a rerun (`verify`), captions of figures, and `more`."""
        chain, captions = (data.read(paths.NOTEBOOKS / name) for name in ("chain.toml", "book/captions.toml"))
        more |= {"chapters": chain["notebook"], "verify": chain["verify"]}
        more |= {"captions": captions, "number": figure_number}
        return self._jinja.get_template(template).render(more)

    def readme(self, text: str) -> str:
        """Return `text`, the present README.md, with new results between the lines `BEGIN` and `END`."""
        head, rest = text.split(BEGIN)
        _, tail = rest.split(END)
        return head + BEGIN + self._jinja.get_template("readme.md.j2").render() + END + tail

    def contract(self) -> pd.DataFrame:
        """Table of claims.csv: `judged` without its column data, but with a column why: for a statement with data that
        is not "reproduced", the sentences of data/theses.toml with the role "why" that name it; else ""."""
        reasons, table = self.sentences("why"), self.judged.drop(columns="data")
        why = pd.Series([" ".join(says for of, says in reasons if identity in of) for identity in table["id"]])
        fails = (self.judged["judged"] != statements.REPRODUCED) & (self.judged["data"] != "")
        table.insert(list(table).index("evidence"), "why", why.str.replace(_LINK, r"\1", regex=True).where(fails, ""))
        return table

    def text(self, text: str) -> str:
        """Return a text, as a sentence of data/theses.toml, with its Jinja expressions replaced by their values."""
        return self._jinja.from_string(text).render()

    def true(self, condition: str) -> bool:
        """Whether a Jinja condition, such as one of data/theses.toml, holds; False when the results lack a value."""
        try:
            return bool(self._jinja.compile_expression(condition, undefined_to_none=False)())
        except statements.MissingEvidence:
            return False

    def refuted(self) -> dict[str, list[str]]:
        """Sentences of data/theses.toml that are not true: name -> list of the conditions that do not hold."""
        wrong = {name: [c for c in thesis.true if not self.true(c)] for name, thesis in theses().items()}
        return {name: conditions for name, conditions in wrong.items() if conditions}

    def sentences(self, role: str) -> list[tuple[list[str], str]]:
        """True sentences with a `role` of `Thesis` as pairs (ids, text). `ids` are the statements that the sentence
        explains and that are not reproduced."""
        true = [thesis for thesis in theses().values() if thesis.role == role and all(map(self.true, thesis.true))]
        failing = [i for i, verdict in self.statements.items() if verdict != statements.REPRODUCED]
        return [([i for i in thesis.of if i in failing], self.text(thesis.says)) for thesis in true]

    def e(self, setting: str, scenario: str, controller: str, metric: str) -> float:
        """Metric (SI) of a controller in a scenario, mean over sensor seeds in data/results/nominal_metrics.csv; of a
        failed run inf or NaN (`statements.Evidence`)."""
        return self.nominal.evidence(setting)(scenario, controller, metric)

    def q(self, setting: str, scenario: str, controller: str, metric: str, unit: str = "") -> str:
        """Metric of a controller in a scenario as Markdown link "[value unit](data/results/nominal_metrics.csv)" as
        from `quantity`: `unit` is "", "mm", "%" or the SI unit."""
        return linked(self.e(setting, scenario, controller, metric), METRICS, unit)

    def sudden(self, metric: str, controller: str) -> list[float]:
        """Metric (SI) of a controller with exact measurements in four runs with sudden loss of adhesion: on both rails
        in traction, both in braking, left rail in traction, left rail in braking."""
        return [self.e(PAPER, case, controller, metric) for case in statements.SUDDEN]

    def find(self, identity: str, setting: str) -> statements.Finding:
        """Measured value of a statement, from data/results; MissingEvidence when metrics are missing. `setting` may
        also be "", for a statement that depends on no tuned controller."""
        return statements.find(identity, self.nominal.evidence(setting))

    def holds(self, identity: str, setting: str) -> bool:
        """Whether a statement is reproduced. `setting` may also be "" (no tuned controller), or "calibrated" for the
        car that was fitted to the statements."""
        if setting == "calibrated":
            return self.calibrated_car.get(identity) == "yes"
        return self.rules[identity].judge(self.find(identity, setting)) == statements.REPRODUCED

    def table(self, name: str) -> pd.DataFrame:
        """Read data/results/NAME.csv; MissingEvidence when there is no such file."""
        table = self.nominal.results(name)
        if table is None:
            raise statements.MissingEvidence(name)
        return table

    def cell(self, name: str, column: str, **where):
        """Value in `column` of the only row of data/results/NAME.csv that has the values `where`, as setting="paper",
        in the columns of these names. MissingEvidence without such a file, or unless there is exactly one such row."""
        table = self.table(name)
        rows = table.loc[np.logical_and.reduce([table[key] == value for key, value in where.items()]), column]
        if len(rows) != 1:
            raise statements.MissingEvidence(f"{name}: {len(rows)} rows with {where}")
        return rows.iloc[0]

    def tuned_value(self, controller: str, setting: str, metric: str = "rmse_y") -> float:
        """A `metric` (m) on track T3 with the parameters of the tuning run of least cost, from settings_metrics.csv."""
        seed = min(sets.load(controller, setting)["swarms"], key=lambda swarm: swarm["cost"])["seed"]
        where = {"scenario": "curve_entry_T3", "setting": setting, "controller": controller, "swarm": seed}
        return self.cell("settings_metrics", "value", metric=metric, **where)

    def time(self, solver: str, column: str = "median_ms") -> float:
        """Time of a `solver` ("ltv_mpc", or one of NMPC such as "gauss_newton") for one optimal control problem (ms):
        median over scenarios of a `column` of solve_times.csv. The problems are those recorded with weights tuned for
        exact measurements; scenarios whose name contains "bounds" (active bounds) are left out."""
        return float(statements.usual_times(self.nominal.evidence(PAPER), solver, column).median())

    def value(self, identity: str) -> str:
        """Value of a statement (with exact measurements, if it is on controllers) as link "[value unit](table)"."""
        headline = self.judged["setting"].isin(("", claims.HEADLINE))
        row = self.judged[(self.judged["id"] == identity) & headline].iloc[-1]
        return linked(number(row["measured_value"], row["unit"]), row["data"])


def csv(relative: str) -> pd.DataFrame:
    """Read a CSV file by its path in the repository, with all cells as text and empty ones as ""."""
    return pd.read_csv(paths.source(relative), dtype=str).fillna("")


def quantity(value: float, unit: str = "") -> str:
    """Text of an SI value and its `unit`: "mm" and "%" convert the value, any other unit, such as "m", is only added.
    It has three significant digits below 100, else one decimal, without ".0"; "derailed" for inf, "n/a" for NaN."""
    if not np.isfinite(value):
        return UNKNOWN if np.isnan(value) else "derailed"
    shown = {"mm": 1e3, "%": 100.0}.get(unit, 1.0) * value
    return (f"{shown:.3g}" if abs(shown) < 100 else f"{shown:.1f}".removesuffix(".0")) + (f" {unit}" if unit else "")


def linked(value: float | str, table: str, unit: str = "") -> str:
    """Markdown link "[value](path of table)"; `value` is a text, or an SI number that `quantity` shows in `unit`.
    `table` is a name in data/results or a path; without it, or for a `value` NaN, the text has no link."""
    shown = value if isinstance(value, str) else quantity(float(value), unit)
    path = table if "/" in table else f"data/results/{table}.csv"
    return f"[{shown}]({path})" if table and shown != UNKNOWN else shown


def _linked_once(section: str) -> str:
    """Replace all but the first link to each file by their text."""
    first = {link[2]: link.start() for link in reversed([*_LINK.finditer(section)])}
    return _LINK.sub(lambda link: link[0] if link.start() == first[link[2]] else link[1], section)


def number(value: float, unit: str = "") -> str:
    """Text of the value of a statement with unit: three significant digits, four within 0.01 of 1 (as "1.23e+03",
    unlike `quantity`); "a run failed" if it is infinite, "no value" for NaN."""
    if np.isnan(value):
        return "no value"
    shown = f"{value:.4g}" if abs(value - 1) < 0.01 else f"{value:.3g}"
    return "a run failed" if np.isinf(value) else f"{shown}{'' if unit in ('', '-') else ' ' + unit}"
