"""The report: REPLICATION.md, the gallery and the results in README.md, Jinja templates of data/ that are filled in.

data/replication.md.j2 is the whole report, data/gallery.md.j2 the page figures/README.md, data/readme.md.j2 what stands
in README.md between its two marks. data/theses.toml has sentences with the conditions under which they are true.
A number in them is an expression with a filter that shows it as a link to its table, such as
`{{ e('paper', 'braking', 'ndi', 'stopping_distance') | linked('nominal_metrics', 'm') }}`, in short
`{{ q('paper', 'braking', 'ndi', 'stopping_distance', 'm') }}`. An expression may call the public methods of `Page`.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from pathlib import Path
from typing import Annotated, Literal

import jinja2
import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.car.equations import BODIES, WHEELS
from railrepro.car.kinematics import COORDINATES
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
"""Lines of README.md around what the report writes."""
UNKNOWN = "n/a"
_LINK = re.compile(r"\[([^]]+)\]\(([^)]+)\)")


@data.table
class Thesis:
    """Entry of data/theses.toml: a sentence, and the conditions that must all be true for it to be said."""

    says: str
    true: Annotated[tuple[str, ...], data.NOT_EMPTY]
    role: Literal["summary", "why", "holds_if", "readme"]
    of: tuple[str, ...] = ()


def theses() -> dict[str, Thesis]:
    """Read all sentences by name, in their order."""
    return data.build(dict[str, Thesis], data.read(paths.source("data/theses.toml")), "theses.toml")


def main(accept: bool = False) -> int:
    """Judge the statements, write claims.csv, REPLICATION.md, figures/README.md and the results in README.md.

    Returns
    -------
    int
        1 when a sentence is not true, or a verdict differs from that in claims.csv: then nothing is written without
        `accept`. Else 0.
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
    """What the templates show.

    Parameters
    ----------
    judged : DataFrame
        Verdicts, a table of `claims.evaluate`.
    nominal : Nominal
        The nominal case in all settings.
    """

    def __init__(self, judged: pd.DataFrame, nominal: Nominal):
        self.judged, self.nominal = judged, nominal
        self.rules, self.verdicts = statements.load(), claims.verdicts(judged)
        self.settings, self.choices = tuning.SETTINGS, calibrated.load()
        self._jinja = jinja2.Environment(
            undefined=jinja2.StrictUndefined,
            loader=jinja2.FileSystemLoader(paths.DATA),
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        self._jinja.filters["linked"] = linked
        self._jinja.globals |= {name: getattr(self, name) for name in dir(self) if not name.startswith("_")}

    def replication(self) -> str:
        """Render REPLICATION.md."""
        text = self._render(
            "replication.md.j2",
            counted=claims.counted(self.judged),
            questions=flips.load().values(),
            verify=_notebooks("chain.toml")["verify"],
        )
        return "## ".join(_linked_once(section) for section in text.split("## "))

    def gallery(self) -> str:
        """Render figures/README.md: the figures of each chapter with their captions."""
        chapters, captions = _notebooks("chain.toml")["notebook"], _notebooks("book/captions.toml")
        return self._render("gallery.md.j2", chapters=chapters, captions=captions)

    def readme(self, text: str) -> str:
        """Put the results into the text of README.md; ValueError when the marks around them are missing."""
        head, rest = text.split(BEGIN)
        _, tail = rest.split(END)
        kinds = {verdict: list(self.statements.values()).count(verdict) for verdict in claims.ORDER}
        return head + BEGIN + self._render("readme.md.j2", kinds=kinds) + END + tail

    def contract(self) -> pd.DataFrame:
        """The verdicts with the reason why a statement fails, as data/results/claims.csv has them."""
        why = [
            "" if row.judged == REPRODUCED or not row.data else _LINK.sub(r"\1", self.reasons(row.id))
            for row in self.judged.itertuples()
        ]
        table = self.judged.drop(columns="data")
        table.insert(list(table).index("evidence"), "why", why)
        return table

    def _render(self, name: str, **more) -> str:
        return self._jinja.get_template(name).render(**more)

    def text(self, text: str) -> str:
        """Fill in a template that is handed over."""
        return self._jinja.from_string(text).render()

    def true(self, condition: str) -> bool:
        """Evaluate a condition; False when the results do not have what it asks for."""
        try:
            return bool(self._jinja.compile_expression(condition, undefined_to_none=False)())
        except MissingEvidence:
            return False

    def refuted(self) -> dict[str, list[str]]:
        """Find the sentences that the tables refute: name -> conditions that are not true."""
        found = {name: [c for c in thesis.true if not self.true(c)] for name, thesis in theses().items()}
        return {name: wrong for name, wrong in found.items() if wrong}

    def sentences(self, role: str) -> list[tuple[tuple[str, ...], str]]:
        """Fill in the true sentences of a role: the statements that each explains, and its text."""
        said = [thesis for thesis in theses().values() if thesis.role == role and all(map(self.true, thesis.true))]
        return [(thesis.of, self.text(thesis.says)) for thesis in said]

    def reasons(self, identity: str) -> str:
        """Say why a statement fails."""
        return " ".join(says for of, says in self.sentences("why") if identity in of)

    def explained(self, role: str) -> list[tuple[list[str], str]]:
        """List the sentences of a role with the statements that each explains, of those that are not reproduced."""
        still = [i for i, verdict in self.statements.items() if verdict != REPRODUCED]
        found = [([i for i in of if i in still], says) for of, says in self.sentences(role)]
        return [(of, says) for of, says in found if of]

    def e(self, setting: str, scenario: str, controller: str, metric: str) -> float:
        """Look up a metric in a setting."""
        return self._evidence(setting)(scenario, controller, metric)

    def q(self, setting: str, scenario: str, controller: str, metric: str, unit: str = "") -> str:
        """Show a metric in a setting as a link to its table."""
        value = self.e(setting, scenario, controller, metric)
        return linked(value, self.nominal.table_of(setting, scenario, controller, metric), unit)

    def find(self, identity: str, setting: str) -> Finding:
        """Evaluate the predicate of a statement in a setting."""
        return statements.find(identity, self._evidence(setting))

    def _evidence(self, setting: str) -> statements.Evidence:
        if setting not in ("", *tuning.SETTINGS):
            raise InputError(f"{setting!r} is no setting; there are {', '.join(tuning.SETTINGS)}")
        return self.nominal.evidence(setting)

    def holds(self, identity: str, setting: str) -> bool:
        """Tell whether a statement holds in a setting, or on the car `calibrated`."""
        if setting == "calibrated":
            return self.nominal.on_calibrated_car().get(identity) == "yes"
        return self.rules[identity].judge(self.find(identity, setting)) == REPRODUCED

    def table(self, name: str) -> pd.DataFrame:
        """Read a table of data/results; MissingEvidence when it is not made yet."""
        found = self.nominal.results.optional(name)
        if found is None:
            raise MissingEvidence(name)
        return found

    def cell(self, name: str, column: str, **where):
        """Look up the cell in a column of a table, in the only row with the given values."""
        table = self.table(name)
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

    @property
    def statements(self) -> dict[str, str]:
        """Headline verdicts of what gets one, by id."""
        return {identity: verdict for identity, verdict in self.verdicts.items() if verdict != claims.NO_VERDICT}

    def runs(self, figure: str) -> dict[str, list[tuple[float, float]]]:
        """Measure the runs of a figure in setting `paper` by car: RMSE (mm), length (m), at the highest speed."""
        table = self.nominal.results.figure(figure).query("setting == 'paper'")
        if "speed_kmh" in table:
            table = table[table["speed_kmh"] == table["speed_kmh"].max()]
        found: dict[str, list[tuple[float, float]]] = {}
        keys = [key for key in ("car", "controller", "case") if key in table]
        for (car, *_), rows in table.groupby(keys, sort=False):
            if "rmse_mm" in rows:
                run = rows["rmse_mm"].iloc[0], np.nan
            else:
                run = 1e3 * ((rows["y_m"] - rows["y_ref_m"]) ** 2).mean() ** 0.5, rows["p_m"].iloc[-1]
            found.setdefault(str(car), []).append(run)
        return found

    def outcome(self, identities: list[str]) -> str:
        """Sum up statements: yes where all hold, no where none does, else partly; a fragile one holds."""
        held = [self.verdicts[identity] in (REPRODUCED, claims.FRAGILE) for identity in identities]
        return "yes" if all(held) else "partly" if any(held) else "no"

    def mark(self, identity: str) -> str:
        """Show the headline verdict of a statement as a mark."""
        return MARKS[self.verdicts[identity]]

    def value(self, identity: str) -> str:
        """Show the headline value of a statement as a link to its table."""
        own = self.judged[(self.judged["id"] == identity) & self.judged["setting"].isin(("", claims.HEADLINE))]
        row = own.iloc[-1]
        return linked(_number(row["measured_value"], row["unit"]), row["data"])

    def calibrated(self, identity: str) -> str:
        """Show as a mark whether a statement holds on the calibrated car."""
        return CALIBRATED[self.judged.loc[self.judged["id"] == identity, "calibrated"].iloc[0]]

    def cells(self, identity: str) -> list[str]:
        """Show mark, value and share of samples in each setting; in the first where a statement needs none."""
        if self.rules[identity].kind != "statement":
            return [f"no verdict ({self.rules[identity].kind})", "", ""]
        own = self.judged[self.judged["id"] == identity]
        shown = {row.setting: _cell(row) for row in own.itertuples()}
        return [shown[""], "", ""] if "" in shown else [shown.get(setting, "") for setting in tuning.SETTINGS]

    def limits(self, identity: str) -> str:
        """Write the limits of a rule in words."""
        pairs = (("above", self.rules[identity].above), ("below", self.rules[identity].below))
        return ", ".join(f"{word} {limit:g}" for word, limit in pairs if limit is not None)

    def evidence(self, identity: str) -> str:
        """Link a statement to its figure, the notebook cell that makes it and the table that was judged."""
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

    def robust(self) -> dict:
        """Sum up the robustness study."""
        answered = claims.shares(self.table("robustness_samples"))
        found = self.table("robustness_claims").merge(answered[["id", "setting"]]).fillna({"decided_by": ""})
        counts, causes = [], []
        for setting in tuning.SETTINGS:
            own = found[found["setting"] == setting]
            if own.empty:
                causes.append(f"`{setting}` is not sampled yet.")
                continue
            share = linked(f"{(own.share > 0.5).sum()} of {len(own)}", "robustness_claims")
            counts.append(f"{share} on `{setting}`")
            alike = own[own["decided_by"] != ""].groupby("decided_by", sort=False)["id"].agg(", ".join)
            named = "; ".join(f"{parameter} for {ids}" for parameter, ids in alike.items())
            causes += [f"Decisive on `{setting}`: {named}."] if named else []
        asked = [identity for identity, rule in self.rules.items() if rule.kind == "statement"]
        unsampled = [identity for identity in asked if identity not in set(answered["id"])]
        size = linked(str(int(found["samples"].max())), "robustness_claims")
        return {"size": size, "counts": counts, "causes": causes, "unsampled": unsampled}

    def effect(self, identity: str) -> str:
        """Describe the largest effect of the printed form of an erratum on NMPC."""
        effects = self.table("discrepancy_effects")
        own = effects[effects["id"] == identity]
        if own.empty:
            return "no run depends on it"
        lost, parts = own["lost"].fillna(False).astype(bool), []
        for words, column in (("RMSE", "rmse_change"), ("torque", "effort_change")) if (~lost).any() else ():
            worst = own.loc[own.loc[~lost, column].abs().idxmax()]
            parts.append(f"{words} {100 * worst[column]:+.1f} % ({worst['scenario']})")
        if lost.any():
            parts.append("derails or triples the error on " + ", ".join(own[lost]["scenario"]))
        return "; ".join(parts)

    def as_mark(self, verdict: str) -> str:
        """Show a verdict as a mark, with what follows it, as a setting."""
        known = max((name for name in MARKS if verdict.startswith(name)), key=len, default="")
        return MARKS[known] + verdict.removeprefix(known) if known else verdict


def quantity(value: float, unit: str = "") -> str:
    """Write a number (SI) with three digits in a unit; "derailed" for an infinite one."""
    if np.isinf(value):
        return "derailed"
    if np.isnan(value):
        return UNKNOWN
    shown = {"mm": 1e3, "%": 100.0}.get(unit, 1.0) * value
    return (f"{shown:.3g}" if abs(shown) < 100 else f"{shown:.1f}".removesuffix(".0")) + (f" {unit}" if unit else "")


def linked(value: float | str, table: str, unit: str = "") -> str:
    """Show a number with three digits, or text as it is, as a Markdown link to its table; bare where there is none."""
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
    """Write mark and value in a setting, with the share of samples in which it holds and its interval."""
    around = f"; {100 * row.share:.0f} [{100 * row.share_low:.0f}, {100 * row.share_high:.0f}]"
    return f"{MARKS[row.judged]} {_number(row.measured_value, row.unit)}{around if np.isfinite(row.share) else ''}"


def _source(notebook: str, product: str) -> str:
    """Find the id of the code cell that writes a product; empty when none names it."""
    cells = json.loads((paths.NOTEBOOKS / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    named = [cell["id"] for cell in cells if cell["cell_type"] == "code" and product in "".join(cell["source"])]
    return named[-1] if named else ""
