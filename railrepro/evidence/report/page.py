"""The report: REPLICATION.md, the gallery and the results in README.md, templates of data/ that are filled in.

data/replication.md.j2 is the whole report, data/gallery.md.j2 the page figures/README.md, data/readme.md.j2 what stands
in README.md between its two marks.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.data import InputError, write
from railrepro.evidence.claims import calibrated, statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.report import claims, flips
from railrepro.evidence.report.prose import Prose, link
from railrepro.evidence.runs import tuning

MARKS = {"reproduced": "✓", "fragile": "✓?", "partly": "◐", "tie": "=", "not reproduced": "✗", "not testable": "–"}
CALIBRATED = {"yes": "✓", "no": "✗", "": ""}
BEGIN, END = "<!-- written by `make report` from data/readme.md.j2 -->\n", "<!-- end of what is written -->\n"
"""Lines of README.md around what the report writes."""
_PROBES = "data/results/nominal_metrics.csv"
_ROBUST = "data/results/robustness_claims.csv"


def main(accept: bool = False) -> int:
    """Judge the statements, write claims.csv, REPLICATION.md, figures/README.md and the results in README.md.

    `accept` stores new verdicts. Returns 1 when a verdict differs from the stored one or a sentence is not true.
    """
    nominal = Nominal()
    judged = claims.evaluate(nominal)
    if accept:
        claims.store(judged)
    contract = judged.drop(columns=["data"])
    page = Page(judged, nominal)
    write(paths.product("data/results/claims.csv"), contract.to_csv(index=False, float_format="%.4g"))
    write(paths.product("REPLICATION.md"), page.replication())
    write(paths.product("figures/README.md"), page.gallery())
    write(paths.product("README.md"), page.readme(paths.source("README.md").read_text(encoding="utf-8")))
    print(claims.counted(judged))
    problems = claims.changed(judged)
    problems += [f"{name}: not true: {'; '.join(wrong)}" for name, wrong in page.prose.refuted().items()]
    if problems:
        advice = (
            "store verdicts with --accept if they are right, rewrite sentences of data/theses.toml that are not true"
        )
        print("\n  ".join(["changed:", *problems]), advice, sep="\n", file=sys.stderr)
    return int(bool(problems))


class Page:
    """What the templates show of the verdicts.

    Parameters
    ----------
    judged : DataFrame
        Verdicts, a table of `claims.evaluate`.
    nominal : Nominal
        The nominal case in all settings.
    """

    def __init__(self, judged: pd.DataFrame, nominal: Nominal):
        self.judged, self.prose = judged, Prose(nominal)
        self.rules, self.verdicts = statements.load(), claims.verdicts(judged)

    def replication(self) -> str:
        """Render REPLICATION.md."""
        names = (
            "mark",
            "value",
            "calibrated",
            "explained",
            "cells",
            "limits",
            "evidence",
            "robust",
            "effect",
            "as_mark",
        )
        text = self.prose.render(
            "replication.md.j2",
            **{name: getattr(self, name) for name in names},
            text=self.prose.text,
            counted=claims.counted(self.judged),
            verdicts=self.verdicts,
            rules=self.rules,
            settings=tuning.SETTINGS,
            questions=flips.load().values(),
            verify=_notebooks("chain.toml")["verify"],
        )
        return "## ".join(_linked_once(section) for section in text.split("## "))

    def gallery(self) -> str:
        """Render figures/README.md: the figures of each chapter with their captions."""
        chapters, captions = _notebooks("chain.toml")["notebook"], _notebooks("book/captions.toml")
        return self.prose.render("gallery.md.j2", chapters=chapters, captions=captions)

    def readme(self, text: str) -> str:
        """Put the results into the text of README.md.

        Raises
        ------
        InputError
            When the marks around them are missing.
        """
        head, begin, rest = text.partition(BEGIN)
        _, end, tail = rest.partition(END)
        if not (begin and end):
            raise InputError(f"README.md: the lines {BEGIN.strip()} and {END.strip()} are needed around the results")
        kinds = {verdict: list(self.statements.values()).count(verdict) for verdict in claims.ORDER}
        names = ("runs", "outcome", "statements")
        more = {name: getattr(self, name) for name in names} | {"kinds": kinds, "choices": calibrated.load()}
        return head + begin + self.prose.render("readme.md.j2", **more) + end + tail

    @property
    def statements(self) -> dict[str, str]:
        """Headline verdicts of what gets one, by id."""
        return {identity: verdict for identity, verdict in self.verdicts.items() if verdict != claims.NO_VERDICT}

    def runs(self, figure: str) -> dict[str, list[tuple[float, float]]]:
        """Measure the runs of a figure in setting `paper` by car: RMSE (mm), length (m), at the highest speed."""
        table = self.prose.nominal.results.figure(figure).query("setting == 'paper'")
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

    def outcome(self, identities: list[str], car: str = "") -> str:
        """Sum up statements: yes where all hold, no where none does, else partly; a fragile one holds."""
        if car == "calibrated":
            held = [self.calibrated(identity) == CALIBRATED["yes"] for identity in identities]
        else:
            held = [self.verdicts[identity] in (statements.REPRODUCED, claims.FRAGILE) for identity in identities]
        return "yes" if all(held) else "partly" if any(held) else "no"

    def mark(self, identity: str) -> str:
        """Show the headline verdict of a statement as a mark."""
        return MARKS.get(self.verdicts[identity], self.verdicts[identity])

    def value(self, identity: str) -> str:
        """Show the headline value of a statement as a link to its table."""
        own = self.judged[(self.judged["id"] == identity) & self.judged["setting"].isin(("", claims.HEADLINE))]
        row = own.iloc[-1]
        return link(_number(row["measured_value"], row["unit"]), row["data"])

    def calibrated(self, identity: str) -> str:
        """Show as a mark whether a statement holds on the calibrated car."""
        return CALIBRATED[self.judged.loc[self.judged["id"] == identity, "calibrated"].iloc[0]]

    def explained(self, role: str) -> list[tuple[list[str], str]]:
        """List the sentences of a role with the statements that each explains, of those that are not reproduced."""
        still = [i for i, verdict in self.statements.items() if verdict != statements.REPRODUCED]
        found = [([i for i in of if i in still], says) for of, says in self.prose.sentences(role)]
        return [(of, says) for of, says in found if of]

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
        data = self.judged.loc[self.judged["id"] == identity, "data"]
        tables = dict.fromkeys([*data, *([rule.evidence] if "/" in rule.evidence else [])])
        # The probes are named once above the table.
        return ", ".join([*links, *(f"[{Path(t).name}]({t})" for t in tables if t not in ("", _PROBES))])

    def robust(self) -> dict | None:
        """Sum up the robustness study; None when it does not have the form of these rules."""
        results = self.prose.nominal.results
        found, answered = results.optional("robustness_claims"), claims.shares(results.optional("robustness_samples"))
        if found is None or answered.empty:
            return None
        found = found.merge(answered[["id", "setting"]]).fillna({"decided_by": ""})
        counts, causes = [], []
        for setting in tuning.SETTINGS:
            own = found[found["setting"] == setting]
            if own.empty:
                causes.append(f"`{setting}` is not sampled yet.")
                continue
            counts.append(f"{link(f'{(own.share > 0.5).sum()} of {len(own)}', _ROBUST)} on `{setting}`")
            alike = own[own["decided_by"] != ""].groupby("decided_by", sort=False)["id"].agg(", ".join)
            named = "; ".join(f"{parameter} for {ids}" for parameter, ids in alike.items())
            causes += [f"Decisive on `{setting}`: {named}."] if named else []
        asked = [identity for identity, rule in self.rules.items() if rule.kind == "statement"]
        unsampled = [identity for identity in asked if identity not in set(answered["id"])]
        size = link(str(int(found["samples"].max())), _ROBUST)
        return {"size": size, "counts": counts, "causes": causes, "unsampled": unsampled}

    def effect(self, identity: str) -> str:
        """Describe the largest effect of the printed form of an erratum on NMPC."""
        effects = self.prose.nominal.results.optional("discrepancy_effects")
        own = pd.DataFrame() if effects is None else effects[effects["id"] == identity]
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


def _linked_once(section: str) -> str:
    """Keep the first link to each file; later ones become their text."""
    seen: set[str] = set()

    def first(link: re.Match) -> str:
        known = link[2] in seen
        seen.add(link[2])
        return link[1] if known else link[0]

    return re.sub(r"\[([^]]+)\]\(([^)]+)\)", first, section)


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
