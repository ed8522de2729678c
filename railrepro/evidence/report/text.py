"""REPLICATION.md: the page of data/replication_page.md with its numbers and tables filled in; nothing typed by hand."""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.report import claims, flips, theses
from railrepro.evidence.report.reasons import filled, link
from railrepro.evidence.runs import tuning
from railrepro.files import write

MARKS = {"reproduced": "✓", "fragile": "✓?", "partly": "◐", "tie": "=", "not reproduced": "✗", "not testable": "–"}
PROBES = "data/results/nominal_metrics.csv"
"""Metrics on which statements that depend on the setting are judged."""
FAVOURS, KNOWN = {"paper": "+", "against": "-", "neither": "0"}, {"old": "", "both": "*"}
"""Marks of a change of a rule: whom it favours, and whether the new verdict was known, too."""
CALIBRATED = {"yes": "✓", "no": "✗", "": ""}


def main(accept: bool = False) -> int:
    """Evaluate the claims and write claims.csv and REPLICATION.md; `accept` stores the new verdicts."""
    nominal = Nominal()
    table = claims.evaluate(nominal)
    if accept:
        claims.store(table)
    contract = table.drop(columns=["data"])
    write(paths.product("data/results/claims.csv"), contract.to_csv(index=False, float_format="%.4g"))
    write(paths.product("REPLICATION.md"), render(table, nominal))
    print(claims.counted(table))
    problems = claims.changed(table)
    problems += [f"{name}: not true: {'; '.join(wrong)}" for name, wrong in theses.refuted(nominal).items()]
    if problems:
        advice = (
            "store verdicts with --accept if they are right, rewrite sentences of data/theses.toml that are not true"
        )
        print("\n  ".join(["changed:", *problems]), advice, sep="\n", file=sys.stderr)
    return int(bool(problems))


def render(table: pd.DataFrame, nominal: Nominal) -> str:
    """The report as Markdown, of a table of `claims.evaluate`."""
    blocks: dict[str, Callable[[], list[str]]] = {
        "counts": lambda: [f"**{claims.counted(table)}** {without(table)}"],
        "summary": lambda: [" ".join(theses.summary(nominal))],
        "numbers": lambda: _numbers(nominal),
        "questions": questions,
        "statements": lambda: _statements(table),
        "reasons": lambda: _reasons(table, nominal),
        "robustness": lambda: [robust(nominal)],
        "errata": lambda: _register(nominal),
        "rules": lambda: _rules(table),
        "elsewhere": _elsewhere,
    }
    marks = marks_of(table)

    def fill(line: str) -> str:
        line = re.sub(r"\{(C\d\d(?: calibrated| value)?)\}", lambda m: marks.get(m[1], m[0]), line)
        return filled(line, nominal, linked=True)

    return page("data/replication_page.md", blocks, fill)


def marks_of(table: pd.DataFrame) -> dict[str, str]:
    """Headline mark of each statement by "C05", its value by "C05 value", the calibrated car by "C05 calibrated"."""
    found = {identity: MARKS.get(verdict, verdict) for identity, verdict in claims.verdicts(table).items()}
    for row in table[table["setting"].isin(("", claims.HEADLINE))].itertuples():
        found[f"{row.id} value"] = link(_number(row.measured_value, row.unit), row.data.split())
    held = table.drop_duplicates("id").set_index("id")["calibrated"]
    return found | {f"{identity} calibrated": CALIBRATED[value] for identity, value in held.items()}


def page(relative: str, blocks: Mapping[str, Callable[[], list[str]]], fill: Callable[[str], str]) -> str:
    """A page with its blocks, lines like [[counts]], and the placeholders of its prose filled in.

    Raises
    ------
    InputError
        With file and line, when there is no such block or number.
    """
    file, lines = paths.source(relative), []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        block = re.fullmatch(r"\[\[(\w+)\]\]", line)
        if block and block[1] not in blocks:
            raise InputError(f"{file.name} line {number}: {line} is no block; there are {', '.join(sorted(blocks))}")
        try:
            lines += blocks[block[1]]() if block else [fill(line)]
        except InputError as error:
            raise InputError(f"{file.name} line {number}: {error}") from error
    return "\n".join(lines) + "\n"


def rows_of(rows: list[list[str]], heads: list[str]) -> list[str]:
    """A table in Markdown."""
    return [
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows),
    ]


def _number(value: float, unit: str = "") -> str:
    if np.isnan(value):
        return "no value"
    shown = f"{value:.4g}" if abs(value - 1) < 0.01 else f"{value:.3g}"
    return "a run failed" if np.isinf(value) else f"{shown}{'' if unit in ('', '-') else ' ' + unit}"


def without(table: pd.DataFrame) -> str:
    """How many entries have no verdict."""
    number = sum(verdict == claims.NO_VERDICT for verdict in claims.verdicts(table).values())
    return f"{number} sentences get no verdict: a choice of ours was set by them, or they are motivation or arithmetic."


def _numbers(nominal: Nominal) -> list[str]:
    """Results of the paper that are numbers beside ours; its numbers that are inputs here are linked."""
    table = pd.read_csv(paths.source("data/paper_numbers.csv"), dtype=str)
    rows = [
        [row.what, f"{row.paper} {row.unit}".removesuffix(" -"), filled(row.here, nominal, linked=True)]
        for row in table[table["role"] == "result"].itertuples()
    ]
    inputs = f"Inputs taken from the paper are in {file_link('data/paper_numbers.csv')}."
    return [*rows_of(rows, ["number", "paper", "here"]), "", inputs]


def file_link(name: str) -> str:
    """A link to a file of the checkout, under its bare name."""
    return f"[{Path(name).name}]({name})"


def questions() -> list[str]:
    """Open questions to the authors, in the order of their effect on the verdicts."""
    return [f"{i}. {question.asks}" for i, question in enumerate(flips.load().values(), 1)]


def _evidence(statement: statements.Statement, data: str) -> str:
    """Links from a statement to its figure, the notebook cell that makes it and the tables that were judged."""
    name = statement.evidence
    links = [f"[{name[:5]}](figures/{name}.png)"] if name.startswith("fig") else []
    cell = _source(statement.notebook, Path(name).name) if name else ""
    anchor = f"#cell-id={cell}" if cell else ""
    links.append(f"[{statement.notebook[:2]}](notebooks/{statement.notebook}.ipynb{anchor})")
    tables = dict.fromkeys([*data.split(), *([name] if "/" in name else [])])
    tables.pop(PROBES, None)  # named once above the table
    return ", ".join([*links, *map(file_link, tables)])


def _source(notebook: str, product: str) -> str:
    """Id of the code cell that writes a product; empty when none names it."""
    cells = json.loads((paths.NOTEBOOKS / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    named = [cell["id"] for cell in cells if cell["cell_type"] == "code" and product in "".join(cell["source"])]
    return named[-1] if named else ""


def _statements(table: pd.DataFrame) -> list[str]:
    """One row per statement, one column per setting."""
    known, rows = statements.load(), []
    for identity, own in table.groupby("id", sort=False):
        statement = known[str(identity)]
        cells = {row.setting: shown(row) for row in own.itertuples()}
        if statement.kind == "statement":
            three = [cells.get(setting, "") for setting in tuning.SETTINGS]
            three = [cells[""], "", ""] if "" in cells else three
        else:
            three = [f"no verdict ({statement.kind})", "", ""]
        calibrated = CALIBRATED[own["calibrated"].iloc[0]]
        data = " ".join(dict.fromkeys(" ".join(own["data"]).split()))
        rows.append(
            [str(identity), statement.statement, *three, calibrated, _rule(statement), _evidence(statement, data)]
        )
    settings = [f"`{setting}`" for setting in tuning.SETTINGS]
    heads = ["id", "statement", *settings, "calibrated", "holds", "figure, chapter, table"]
    return rows_of(rows, heads)


def shown(row) -> str:
    """Mark and value in some setting, with the share of samples in which it holds and its interval."""
    around = f"; {100 * row.share:.0f} [{100 * row.share_low:.0f}, {100 * row.share_high:.0f}]"
    return f"{MARKS[row.judged]} {_number(row.measured_value, row.unit)}{around if np.isfinite(row.share) else ''}"


def _rule(statement: statements.Statement) -> str:
    parts = [f"above {statement.above:g}"] if statement.above is not None else []
    parts += [f"below {statement.below:g}"] if statement.below is not None else []
    return ", ".join(parts)


def unsettled(table: pd.DataFrame) -> list[str]:
    """Statements whose headline verdict is not reproduced."""
    settled = (statements.REPRODUCED, claims.NO_VERDICT)
    return [identity for identity, verdict in claims.verdicts(table).items() if verdict not in settled]


def explained(table: pd.DataFrame, nominal: Nominal, role: str) -> list[tuple[list[str], str]]:
    """Statements that are not reproduced, and what explains them; each sentence once."""
    found, open_ones = [], unsettled(table)
    for thesis in theses.load().values():
        of = [identity for identity in thesis.of if identity in open_ones]
        if of and thesis.role == role and all(theses.holds(condition, nominal) for condition in thesis.true):
            found.append((of, filled(thesis.says, nominal, linked=True)))
    return found


def _reasons(table: pd.DataFrame, nominal: Nominal) -> list[str]:
    """Why statements are not reproduced on `paper`, and when they would hold."""
    lines = [f"- {', '.join(of)}: {says}" for of, says in explained(table, nominal, "why")]
    conditions = [f"- {', '.join(of)} would hold if {says}" for of, says in explained(table, nominal, "holds_if")]
    return [*lines, *conditions]


def robust(nominal: Nominal) -> str:
    """Result of the robustness study; the command to run when it does not have the form of these rules."""
    found, samples = (nominal.results.optional(f"robustness_{name}") for name in ("claims", "samples"))
    answered = claims.shares(samples)
    if found is None or answered.empty:
        return "There are no shares: the robustness study (`make study`) has not run with these rules and this car yet."
    found = found.merge(answered[["id", "setting"]])
    decided = found[found["decided_by"].notna() & (found["decided_by"] != "")]
    counts, causes, table = [], [], "data/results/robustness_claims.csv"
    for setting in tuning.SETTINGS:
        own = found[found["setting"] == setting]
        if own.empty:
            causes.append(f"`{setting}` is not sampled yet.")
            continue
        counts.append(f"{link(f'{(own.share > 0.5).sum()} of {len(own)}', [table])} on `{setting}`")
        alike = decided[decided["setting"] == setting].groupby("decided_by", sort=False)["id"].agg(", ".join)
        named = "; ".join(f"{parameter} for {ids}" for parameter, ids in alike.items())
        causes += [f"Decisive on `{setting}`: {named}."] if named else []
    size = link(str(int(found["samples"].max())), [table])
    asked = [identity for identity, rule in statements.load().items() if rule.kind == "statement"]
    unsampled = ", ".join(identity for identity in asked if identity not in set(answered["id"]))
    return (
        f"Cars and experiments were drawn {size} times from the ranges of the unpublished parameters, with controllers "
        f"tuned again. Statements that hold in more than half of the samples: {', '.join(counts)}. {' '.join(causes)} "
        f"What is decisive is confirmed by a run with this change alone. Not sampled, so never fragile: {unsampled}."
    )


def _register(nominal: Nominal) -> list[str]:
    register, effects = (
        pd.read_csv(paths.source("data/discrepancies.csv")),
        nominal.results.optional("discrepancy_effects"),
    )
    rows = []
    for row in register.itertuples():
        own = pd.DataFrame() if effects is None else effects[effects["id"] == row.id]
        rows.append([str(row.id), row.printed, row.wrong_or_open, row.decision, _effect(own)])
    effects_link = file_link("data/results/discrepancy_effects.csv")
    heads = ["", "printed", "wrong or open", "decision", "largest effect of the printed form on NMPC (D6: LTV-MPC)"]
    return [*rows_of(rows, heads), "", f"Effects: {effects_link}, [fig22](figures/fig22_discrepancies.png)."]


def _effect(own: pd.DataFrame) -> str:
    if own.empty:
        return "no run depends on it"
    lost = own["lost"].fillna(False).astype(bool)
    stored, parts = own[~lost], []
    if len(stored):
        worst = stored.loc[stored["rmse_change"].abs().idxmax()]
        effort = stored.loc[stored["effort_change"].abs().idxmax()]
        parts.append(f"RMSE {100 * worst['rmse_change']:+.1f} % ({worst['scenario']})")
        parts.append(f"torque {100 * effort['effort_change']:+.1f} % ({effort['scenario']})")
    if lost.any():
        parts.append("derails or triples the error on " + ", ".join(own[lost]["scenario"]))
    return "; ".join(parts)


def _elsewhere() -> list[str]:
    """Tolerances of results between computers."""
    file = "notebooks/chain.toml"
    tolerance = tomllib.loads(paths.source(file).read_text(encoding="utf-8"))["verify"]
    return [
        "On one machine with the locked packages tables and figures are bit-identical. Another processor or "
        "mathematical library rounds differently; `make verify` reruns everything and compares. Numbers may differ "
        f"by {tolerance['relative']:g} of the largest value of their column or metric, images by "
        f"{tolerance['image_rms']:g} of 255 grey levels in the root mean square. Some rows amplify rounding and may "
        f"differ by more; `{file}` lists them with the reasons, `notebooks/book/reproducibility.md` the computers "
        "and compilers that were tried."
    ]


def _mark(verdict: str) -> str:
    """The mark of a verdict, with what follows it, as a setting."""
    known = next((name for name in sorted(MARKS, key=len, reverse=True) if verdict.startswith(name)), "")
    return MARKS[known] + verdict.removeprefix(known) if known else verdict


def _rules(table: pd.DataFrame) -> list[str]:
    """Rules that were changed, with the verdict under the old rule when it was replaced and under the new one today."""
    found = claims.verdicts(table)
    log = pd.read_csv(paths.source("data/rule_changes.csv"), dtype=str)
    last = log.drop_duplicates("id", keep="last")
    rows = [
        [r.id, r.old, _mark(r.old_verdict), r.new, _mark(found.get(r.id, "none")), FAVOURS[r.favours] + KNOWN[r.known],
         r.why]
        for r in last.itertuples()
    ]  # fmt: skip
    heads = ["id", "old rule", "then", "new rule", "now", "favours", "why"]
    paper = (log["favours"] == "paper").sum()
    said = (
        f"{len(log)} changes, each made when the verdict under the old rule was known, where marked * also that under "
        f"the new one. {paper} favour the paper (+), {(log['favours'] == 'against').sum()} go against it (-). The "
        f"table shows the last change of each rule, {file_link('data/rule_changes.csv')} all."
    )
    return [said, "", *rows_of(rows, heads)]
