"""The report: REPLICATION.md, figures/README.md and the results in README.md, rendered from Jinja templates in data/.

data/replication.md.j2 is the whole report, data/gallery.md.j2 the page figures/README.md, data/readme.md.j2 the part of
README.md between two marks. data/theses.toml has sentences with the conditions under which they are true. A number in
them is an expression with a filter that shows it as a link to its table, such as
`{{ e('paper', 'braking', 'ndi', 'stopping_distance') | linked('nominal_metrics', 'm') }}`, in short
`{{ q('paper', 'braking', 'ndi', 'stopping_distance', 'm') }}`. Expressions may use the public members of `Page` and the
names that its constructor adds.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import jinja2
import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.car.equations import BODIES, WHEELS
from railrepro.car.kinematics import COORDINATES
from railrepro.control.registry import parameters
from railrepro.data import InputError, write
from railrepro.evidence.claims import calibrated, statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import REPRODUCED, Finding, MissingEvidence
from railrepro.evidence.report import claims, flips
from railrepro.evidence.report.claims import table_file
from railrepro.evidence.runs import tuning
from railrepro.simulation.scenarios import load_scenario

MARKS = {"reproduced": "✓", "fragile": "✓?", "partly": "◐", "tie": "=", "not reproduced": "✗", "not testable": "–"}
CALIBRATED = {"yes": "✓", "no": "✗", "": ""}
BEGIN, END = "<!-- written by `make report` from data/readme.md.j2 -->\n", "<!-- end of what is written -->\n"
"""Lines of README.md between which its results are written."""
UNKNOWN = "n/a"
FREEDOMS = len(BODIES) * len(COORDINATES) // 2 + len(WHEELS)
"""Number of degrees of freedom of the car model: those of the bodies, and one per wheel."""
_LINK = re.compile(r"\[([^]]+)\]\(([^)]+)\)")


@data.table
class Thesis:
    """Entry of data/theses.toml: a sentence (`says`), and the conditions (`true`) that must all hold to show it.

    `says` is text with Jinja expressions, each condition one expression (see `Page`). `role` is where the sentence
    stands, `of` the ids of the statements that it explains.
    """

    says: str
    true: Annotated[tuple[str, ...], data.NOT_EMPTY]
    role: Literal["summary", "why", "holds_if", "readme"]
    of: tuple[str, ...] = ()


def theses() -> dict[str, Thesis]:
    """Read data/theses.toml: name -> sentence with its conditions, in the order of the file."""
    return data.build(dict[str, Thesis], data.read(paths.source("data/theses.toml")), "theses.toml")


def main(accept: bool = False) -> int:
    """Judge the paper's statements, write claims.csv, REPLICATION.md, figures/README.md and the results in README.md.

    Where a verdict differs from claims.csv nothing is written, unless `accept`. Returns 1 in this case, and when a
    sentence of data/theses.toml is not true, else 0.
    """
    nominal = Nominal()
    judged = claims.evaluate(nominal)
    page = Page(judged, nominal)
    problems = [f"{name}: not true: {'; '.join(wrong)}" for name, wrong in page.refuted().items()]
    changed = [] if accept else claims.changed(judged)
    if not changed:
        write(paths.product(claims.FILE), page.contract().to_csv(index=False, float_format="%.4g"))
        write(paths.product("REPLICATION.md"), page.replication())
        write(paths.product("figures/README.md"), page.gallery())
        write(paths.product("README.md"), page.readme(paths.source("README.md").read_text(encoding="utf-8")))
    print(claims.counted(judged))
    if problems or changed:
        print("\n  ".join(["changed:", *changed, *problems]), file=sys.stderr)
        print("--accept writes verdicts if they are right; rewrite sentences of data/theses.toml", file=sys.stderr)
    return int(bool(problems or changed))


class Page:
    """Functions and values for the Jinja templates of the report, from verdicts and stored metrics.

    `judged` is a table of `claims.evaluate`, `nominal` has the metrics. A setting is one of comparison: "paper",
    "equal", "loop", or "" for the tables that do not depend on it; an identity is the id of a statement, as "C05".
    """

    def __init__(self, judged: pd.DataFrame, nominal: Nominal):
        self.judged, self.nominal = judged, nominal
        self.rules, self.verdicts = statements.load(), claims.verdicts(judged)
        self.statements = {identity: one for identity, one in self.verdicts.items() if one != claims.NO_VERDICT}
        self.calibrated_car = nominal.on_calibrated_car()
        self._jinja = jinja2.Environment(
            undefined=jinja2.StrictUndefined,
            loader=jinja2.FileSystemLoader(paths.DATA),
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        self._jinja.filters["linked"] = linked
        self._jinja.globals |= {name: getattr(self, name) for name in dir(self) if not name.startswith("_")}
        self._jinja.globals |= {
            "mark": {identity: MARKS.get(verdict) for identity, verdict in self.verdicts.items()},
            "calibrated": judged.set_index("id")["calibrated"].map(CALIBRATED).to_dict(),
            "settings": tuning.SETTINGS,
            "task": tuning.load_task(),
            "choices": calibrated.load(),
            "tuned": parameters,
            "swarm": partial(tuning.load, searched=True),
            "scenario": load_scenario,
            "csv": csv,
            "freedoms": FREEDOMS,
        }

    def replication(self) -> str:
        """Text of REPLICATION.md."""
        text = self._render(
            "replication.md.j2",
            counted=claims.counted(self.judged),
            questions=flips.load().values(),
            verify=_notebooks("chain.toml")["verify"],
        )
        return "## ".join(_linked_once(section) for section in text.split("## "))

    def gallery(self) -> str:
        """Text of figures/README.md: the figures of each chapter with their captions."""
        chapters, captions = _notebooks("chain.toml")["notebook"], _notebooks("book/captions.toml")
        return self._render("gallery.md.j2", chapters=chapters, captions=captions)

    def readme(self, text: str) -> str:
        """Text of README.md with its results replaced (between `BEGIN` and `END`); ValueError without these marks."""
        head, rest = text.split(BEGIN)
        _, tail = rest.split(END)
        kinds = {verdict: list(self.statements.values()).count(verdict) for verdict in claims.ORDER}
        return head + BEGIN + self._render("readme.md.j2", kinds=kinds) + END + tail

    def contract(self) -> pd.DataFrame:
        """Table of data/results/claims.csv: the verdicts, and the reason (`why`) of those not reproduced."""
        reasons, table = self.sentences("why"), self.judged.drop(columns="data")
        why = pd.Series([" ".join(says for of, says in reasons if identity in of) for identity in table["id"]])
        fails = (self.judged["judged"] != REPRODUCED) & (self.judged["data"] != "")
        table.insert(list(table).index("evidence"), "why", why.str.replace(_LINK, r"\1", regex=True).where(fails, ""))
        return table

    def _render(self, name: str, **more) -> str:
        return self._jinja.get_template(name).render(**more)

    def text(self, text: str) -> str:
        """Render a text with Jinja expressions, as `says` of a `Thesis`."""
        return self._jinja.from_string(text).render()

    def true(self, condition: str) -> bool:
        """Evaluate a Jinja condition, as one of `Thesis.true`; False when the results lack a value that it needs."""
        try:
            return bool(self._jinja.compile_expression(condition, undefined_to_none=False)())
        except MissingEvidence:
            return False

    def refuted(self) -> dict[str, list[str]]:
        """Name of each false sentence of data/theses.toml -> its conditions that are not true."""
        found = {name: [c for c in thesis.true if not self.true(c)] for name, thesis in theses().items()}
        return {name: wrong for name, wrong in found.items() if wrong}

    def sentences(self, role: str) -> list[tuple[tuple[str, ...], str]]:
        """True sentences of a role ("summary", "why", "holds_if", "readme"): list of (ids explained, rendered text)."""
        said = [thesis for thesis in theses().values() if thesis.role == role and all(map(self.true, thesis.true))]
        return [(thesis.of, self.text(thesis.says)) for thesis in said]

    def explained(self, role: str) -> list[tuple[list[str], str]]:
        """Items of `sentences` that explain statements not "reproduced" (headline verdict), with only these ids."""
        still = [i for i, verdict in self.statements.items() if verdict != REPRODUCED]
        found = [([i for i in of if i in still], says) for of, says in self.sentences(role)]
        return [(of, says) for of, says in found if of]

    def e(self, setting: str, scenario: str, controller: str, metric: str) -> float:
        """Value (SI) of a metric of a controller in a scenario and setting, see `statements.Evidence`."""
        return self._evidence(setting)(scenario, controller, metric)

    def q(self, setting: str, scenario: str, controller: str, metric: str, unit: str = "") -> str:
        """Metric `e` as text with three digits and unit (see `quantity`), as a Markdown link to its table."""
        value = self.e(setting, scenario, controller, metric)
        return linked(value, self.nominal.table_of(setting, scenario, controller, metric), unit)

    def find(self, identity: str, setting: str) -> Finding:
        """Measured value of a statement in a setting, as a `Finding`; MissingEvidence when metrics are missing."""
        return statements.find(identity, self._evidence(setting))

    def _evidence(self, setting: str) -> statements.Evidence:
        if setting not in ("", *tuning.SETTINGS):
            raise InputError(f"{setting!r} is no setting; there are {', '.join(tuning.SETTINGS)}")
        return self.nominal.evidence(setting)

    def holds(self, identity: str, setting: str) -> bool:
        """Whether a statement is reproduced in `setting`; "calibrated" as `setting` asks for the calibrated car."""
        if setting == "calibrated":
            return self.calibrated_car.get(identity) == "yes"
        return self.rules[identity].judge(self.find(identity, setting)) == REPRODUCED

    def table(self, name: str) -> pd.DataFrame:
        """Read data/results/NAME.csv; MissingEvidence when there is no such file."""
        found = self.nominal.results(name)
        if found is None:
            raise MissingEvidence(name)
        return found

    def cell(self, name: str, column: str, **where):
        """Value in `column` of data/results/NAME.csv, in the only row with the values `where`, or MissingEvidence."""
        table = self.table(name)
        rows = table.loc[np.logical_and.reduce([table[key] == value for key, value in where.items()]), column]
        if len(rows) != 1:
            raise MissingEvidence(f"{name}: {len(rows)} rows with {where}")
        return rows.iloc[0]

    def time(self, solver: str, column: str = "median_ms") -> float:
        """Computation time (ms) of a solver: median over scenarios of `column` in solve_times.csv, setting `paper`."""
        return float(statements.usual_times(self.nominal.evidence(tuning.PAPER), solver, column).median())

    def pole_that_follows(self) -> float:
        """Triple pole (rad/s, interpolated) at which NDI's RMSE of y on T3 is 0.71 times that of staying at y = 0."""
        poles = self.table("ndi_poles").sort_values("pole_radps", kind="stable")
        limit = 0.71e3 * self.e(tuning.PAPER, statements.T3, statements.NOTHING, "rmse_y")
        if poles["rmse_mm"].iloc[-1] > limit or poles["rmse_mm"].iloc[0] < limit:
            raise MissingEvidence("pole of NDI that follows")
        return float(np.interp(-limit, -poles["rmse_mm"], poles["pole_radps"]))

    def runs(self, figure: str) -> dict[str, list[tuple[float, float]]]:
        """Car -> (RMSE of y (mm), last track coordinate (m)) of each run of figures/FIGURE.csv in the setting `paper`.

        Of a figure over speed those at the highest speed, with nan for the coordinate.
        """
        table = pd.read_csv(paths.source(f"figures/{figure}.csv")).query("setting == 'paper'")
        if "rmse_mm" in table:
            fastest = table[table["speed_kmh"] == table["speed_kmh"].max()]
            return {car: [(error, np.nan) for error in rows["rmse_mm"]] for car, rows in fastest.groupby("car")}
        table["square"] = (table["y_m"] - table["y_ref_m"]) ** 2
        each = table.groupby(["car", "case" if "case" in table else "controller"], sort=False)
        error, length = 1e3 * each["square"].mean() ** 0.5, each["p_m"].last()
        return {car: list(zip(error[car], length[car], strict=True)) for car in table["car"].unique()}

    def outcome(self, identities: list[str]) -> str:
        """Sum up headline verdicts: "yes" if all statements hold (fragile ones do), "no" if none, else "partly"."""
        held = [self.verdicts[identity] in (REPRODUCED, claims.FRAGILE) for identity in identities]
        return "yes" if all(held) else "partly" if any(held) else "no"

    def value(self, identity: str) -> str:
        """Measured value of a statement behind its headline verdict, with unit, as a Markdown link to its table."""
        own = self.judged[(self.judged["id"] == identity) & self.judged["setting"].isin(("", claims.HEADLINE))]
        row = own.iloc[-1]
        return linked(_number(row["measured_value"], row["unit"]), row["data"])

    def cells(self, identity: str) -> list[str]:
        """Three texts, for the settings paper, equal and loop; "" where a statement is not judged.

        Each has the mark of the verdict, the value with unit, and the share of sampled cars on which it holds (%; in
        paper with 95 % limits). Only the first is filled for a statement that depends on no setting, and for an entry
        without verdict, where it says so.
        """
        if self.rules[identity].kind != "statement":
            return [f"no verdict ({self.rules[identity].kind})", "", ""]
        own = self.judged[self.judged["id"] == identity]
        shown = {row.setting: _cell(row) for row in own.itertuples()}
        return [shown[""], "", ""] if "" in shown else [shown.get(setting, "") for setting in tuning.SETTINGS]

    def evidence(self, identity: str) -> str:
        """Markdown links of a statement, joined by commas: figure, the notebook cell that draws it, tables judged."""
        rule = self.rules[identity]
        figure, is_figure, _ = rule.evidence.partition("_")  # fig06_curve_entry is shown as fig06
        links = [f"[{figure}](figures/{rule.evidence}.png)"] if is_figure and rule.evidence.startswith("fig") else []
        cell = _source(rule.notebook, Path(rule.evidence).name) if rule.evidence else ""
        anchor = f"#cell-id={cell}" if cell else ""
        links.append(f"[{rule.notebook[:2]}](notebooks/{rule.notebook}.ipynb{anchor})")
        judged = self.judged.loc[self.judged["id"] == identity, "data"]
        tables = dict.fromkeys([*judged, *([rule.evidence] if "/" in rule.evidence else [])])
        # The probes are named once above the table.
        named = [table for table in tables if table not in ("", table_file("nominal_metrics"))]
        return ", ".join([*links, *(f"[{Path(table).name}]({table})" for table in named)])

    def sampled(self) -> pd.DataFrame:
        """Rows of `judged` with a share in the robustness study, its number of `samples`, and `decided_by`: the sampled
        parameter that decides the verdict, or ""."""
        study = self.table("robustness_claims")[["id", "setting", "samples", "decided_by"]].fillna({"decided_by": ""})
        return self.judged.dropna(subset="share").merge(study, on=["id", "setting"])

    def effect(self, identity: str) -> str:
        """Text on the largest effect of an erratum (as "D4") when used as printed: changes of RMSE and torque (%)."""
        effects = self.table("discrepancy_effects").query("id == @identity")
        if effects.empty:
            return "no run depends on it"
        is_lost = effects["lost"].eq(True)
        lost, driven, parts = effects[is_lost], effects[~is_lost], []
        for words, column in (("RMSE", "rmse_change"), ("torque", "effort_change")) if len(driven) else ():
            worst = driven.loc[driven[column].abs().idxmax()]
            parts.append(f"{words} {100 * worst[column]:+.1f} % ({worst['scenario']})")
        if len(lost):
            parts.append("derails or triples the error on " + ", ".join(lost["scenario"]))
        return "; ".join(parts)

    def as_mark(self, verdict: str) -> str:
        """Replace the verdict at the beginning of a text by its mark (`MARKS`), as "tie (loop)" by "= (loop)"."""
        known = next((name for name in MARKS if verdict.startswith(name)), None)
        return MARKS[known] + verdict.removeprefix(known) if known else verdict


def csv(relative: str) -> pd.DataFrame:
    """Read a csv file by its path in the repository, all cells as text, empty ones as ""."""
    return pd.read_csv(paths.source(relative), dtype=str).fillna("")


def quantity(value: float, unit: str = "") -> str:
    """Text of an SI value with three digits in `unit` (SI, "mm" or "%"); "derailed" for inf, "n/a" for nan."""
    if np.isinf(value):
        return "derailed"
    if np.isnan(value):
        return UNKNOWN
    shown = {"mm": 1e3, "%": 100.0}.get(unit, 1.0) * value
    return (f"{shown:.3g}" if abs(shown) < 100 else f"{shown:.1f}".removesuffix(".0")) + (f" {unit}" if unit else "")


def linked(value: float | str, table: str, unit: str = "") -> str:
    """Markdown link with a value as text (`quantity`; a text stays as it is) to a table of data/results or a path.

    Without a table, or without a value, the bare text.
    """
    shown = value if isinstance(value, str) else quantity(float(value), unit)
    return f"[{shown}]({table_file(table)})" if table and shown != UNKNOWN else shown


def _linked_once(section: str) -> str:
    """Keep the first link to each file; later ones become their text."""
    seen: set[str] = set()

    def first(link: re.Match) -> str:
        known = link[2] in seen
        seen.add(link[2])
        return link[1] if known else link[0]

    return _LINK.sub(first, section)


def _notebooks(file: str) -> dict:
    """Read a TOML file beside the notebooks."""
    return tomllib.loads((paths.NOTEBOOKS / file).read_text(encoding="utf-8"))


def _number(value: float, unit: str = "") -> str:
    """Write the value of a statement: three digits, four near one."""
    if np.isnan(value):
        return "no value"
    shown = f"{value:.4g}" if abs(value - 1) < 0.01 else f"{value:.3g}"
    return "a run failed" if np.isinf(value) else f"{shown}{'' if unit in ('', '-') else ' ' + unit}"


def _cell(row) -> str:
    """Write mark and value in a setting, with the share of samples in which it holds, its interval for the headline."""
    found = f"{MARKS[row.judged]} {_number(row.measured_value, row.unit)}"
    if not np.isfinite(row.share):
        return found
    around = f" [{100 * row.share_low:.0f}, {100 * row.share_high:.0f}]" if row.setting == claims.HEADLINE else ""
    return f"{found}; {100 * row.share:.0f}{around}"


def _source(notebook: str, product: str) -> str:
    """Find the id of the code cell that writes a product; empty when none names it."""
    cells = json.loads((paths.NOTEBOOKS / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    named = [cell["id"] for cell in cells if cell["cell_type"] == "code" and product in "".join(cell["source"])]
    return named[-1] if named else ""
