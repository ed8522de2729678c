"""REPLICATION.md: the page of data/replication_page.md with its numbers and tables filled in; nothing typed by hand."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.report.evidence import Nominal
from railrepro.report.reasons import UNKNOWN, filled, quantity
from railrepro.studies import statements, tuning
from railrepro.studies.statements import MissingEvidence

_MARK = {"reproduced": "✓", "partly": "◐", "not reproduced": "✗", "not testable": "–"}
_NAMES = {"nmpc": "NMPC", "ltv_mpc_printed": "LTV-MPC (printed)", "ndi": "NDI"}
_SECTIONS = (
    "Introduction", "Test Tracks", "Nonlinear Model Predictive Control", "Adhesion Control",
    "Evaluation of Lateral Control", "Evaluation of Longitudinal Control", "Evaluation of Integrated Control",
    "Discussion", "Conclusion",
)  # fmt: skip


def render(table: pd.DataFrame, nominal: Nominal) -> str:
    """The report as Markdown.

    Parameters
    ----------
    table : DataFrame
        See `railrepro.report.claims.evaluate`.
    nominal : Nominal
        Where numbers in the prose come from.

    Returns
    -------
    str
    """
    page = paths.source("data/replication_page.md").read_text(encoding="utf-8")
    blocks: dict[str, Callable[[], list[str]]] = {
        "counts": lambda: _counts(table),
        "headline": lambda: _headline(nominal),
        "tied": lambda: _tied(table),
        "numbers": lambda: _numbers(nominal),
        "questions": lambda: _questions(nominal),
        "statements": lambda: _statements(table, nominal),
        "matching": lambda: _matching(nominal),
        "robustness": lambda: _how_sure(nominal),
        "errata": lambda: _register(nominal),
        "rules": lambda: _rules(table),
    }
    lines = []
    for line in page.splitlines():
        block = re.fullmatch(r"\[\[(\w+)\]\]", line)
        lines += blocks[block[1]]() if block else [filled(line, nominal)]
    return "\n".join(lines) + "\n"


def _rows(rows: list[list[str]], heads: list[str]) -> list[str]:
    return [
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows),
    ]


def _number(value: float, unit: str = "") -> str:
    if np.isinf(value):
        return "infinite"
    return "" if not np.isfinite(value) else f"{value:.3g}{'' if unit in ('', '-') else ' ' + unit}"


def _overall(table: pd.DataFrame) -> dict[str, str]:
    from railrepro.report.claims import verdicts

    return verdicts(table)


def _counts(table: pd.DataFrame) -> list[str]:
    from railrepro.report.claims import NO_VERDICT

    found = pd.Series(_overall(table))
    judged = found[found != NO_VERDICT]
    kinds = judged.str.replace(r" on terms .*", " on some terms only", regex=True).value_counts()
    order = ["reproduced", "reproduced on some terms only", "fragile", "partly", "not reproduced", "not testable"]
    parts = [f"{kinds[kind]} {kind}" for kind in order if kind in kinds]
    other = f" {len(found) - len(judged)} numbers of the paper set choices of ours and get no verdict."
    return ["**" + ", ".join(parts) + f", of {len(judged)} statements.**" + other]


def _cell(nominal: Nominal, terms: str, scenario: str, controller: str, metric: str, unit: str) -> str:
    try:
        return quantity(nominal.evidence(terms)(scenario, controller, metric), unit)
    except MissingEvidence:
        return UNKNOWN


def _headline(nominal: Nominal) -> list[str]:
    """The paper's headline results and ours, on the three terms."""
    ranking = "NMPC < LTV-MPC < NDI"
    results = [
        ("RMSE of y in the curve entry on T3, 280 km/h (Fig. 6)", ranking, "curve_entry_T3", "rmse_y", "mm"),
        ("RMSE of y of the sine on T5, 400 km/h (Fig. 7)", ranking, "sine_tracking 400", "rmse_y", "mm"),
        ("RMSE of y on poor rail, 400 km/h (Fig. 8), R as tuned", "oscillation", "adhesion_loss", "rmse_y", "mm"),
        ("RMSE of y while braking, 160 km/h (Fig. 9), R as tuned", "NMPC < NDI", "braking", "rmse_y", "mm"),
        ("stopping distance (Fig. 9), R as tuned", "NMPC < NDI", "braking", "stopping_distance", "m"),
    ]  # fmt: skip
    rows = []
    for what, paper, scenario, metric, unit in results:
        own = []
        for terms in tuning.TERMS:
            found = {name: _cell(nominal, terms, scenario, name, metric, "") for name in PAPER_TRIO}
            if unit == "mm":
                found = {name: _in_mm(nominal, terms, scenario, name, metric) for name in PAPER_TRIO}
            known = [value for value in found.values() if value != UNKNOWN]
            own.append(" / ".join(found.values()) if known else UNKNOWN)
        rows.append([f"{what} ({unit})", paper, *own])
    note = "Ours as NMPC / LTV-MPC as printed / NDI."
    return [*_rows(rows, ["result", "paper", *(f"`{terms}`" for terms in tuning.TERMS)]), "", note]


def _in_mm(nominal: Nominal, terms: str, scenario: str, controller: str, metric: str) -> str:
    return _cell(nominal, terms, scenario, controller, metric, "mm").removesuffix(" mm")


def _tied(table: pd.DataFrame) -> list[str]:
    """Where the paper's orders hold, from the verdicts themselves."""
    found = _overall(table)
    orders = {"C05": "MPC before NDI on T3", "C16": "the ranking on T1 to T4", "C20": "MPC before NDI over speed"}
    return ["Orders: " + "; ".join(f"{what} ({i}): {found[i]}" for i, what in orders.items()) + "."]


def _numbers(nominal: Nominal) -> list[str]:
    table = pd.read_csv(paths.source("data/paper_numbers.csv"), dtype=str)
    rows = [
        [row.what, f"{row.paper} {row.unit}".removesuffix(" -"), row.role, filled(row.here, nominal), _file(row.where)]
        for row in table.itertuples()
    ]
    return _rows(rows, ["number", "paper", "role", "here", "table"])


def _file(name: str) -> str:
    return f"[{Path(name).name}]({name})"


def _questions(nominal: Nominal) -> list[str]:
    """Unpublished numbers, by how much knowing them would narrow the region in which the statements hold together."""
    general = [
        "Poles (or gains) of the NDI, its sampling, and whether it has integral action or set-point rates.",
        "Weights, period and horizon that the swarm found, and the tracks, speeds and rails of its cost.",
        "R and Q of Fig. 8; torque limit and both settings of R in Fig. 9.",
        "Whether the LTV model keeps its affine term, and the heading at which T1 to T4 lie.",
    ]
    found = nominal.results.optional("matching_questions")
    asked = [] if found is None else [f"{row.what}: {row.sentence}" for row in found.head(5).itertuples()]
    return [f"{i}. {text}" for i, text in enumerate([*asked, *general], 1)]


def _evidence(statement: statements.Statement, data: str) -> str:
    """Links from a statement to its figure, the notebook cell that makes it and the tables that were judged."""
    links, name = [], statement.evidence
    if name.startswith("fig"):
        links.append(f"[{name}](figures/{name}.png)")
    cell = _source(statement.notebook, Path(name).name) if name else ""
    title, anchor = (f", cell {cell}", f"#cell-id={cell}") if cell else ("", "")
    links.append(f"[{statement.notebook}{title}](notebooks/{statement.notebook}.ipynb{anchor})")
    tables = dict.fromkeys([*data.split(), *([name] if "/" in name else [])])
    return ", ".join([*links, *map(_file, tables)])


def _source(notebook: str, product: str) -> str:
    """Id of the code cell that writes a product; empty when none names it."""
    cells = json.loads((paths.NOTEBOOKS / f"{notebook}.ipynb").read_text(encoding="utf-8"))["cells"]
    named = [cell["id"] for cell in cells if cell["cell_type"] == "code" and product in "".join(cell["source"])]
    return named[-1] if named else ""


def _statements(table: pd.DataFrame, nominal: Nominal) -> list[str]:
    known, overall, lines = statements.load(), _overall(table), []
    for section in _SECTIONS:
        here = table[table["paper_ref"].str.startswith(section)]
        if here.empty:
            continue
        lines += [f"### {section}", ""]
        rows, reasons = [], []
        for identity, own in here.groupby("id", sort=False):
            statement, data = known[str(identity)], " ".join(own["data"])
            shown = [_shown(row) for row in own.itertuples()]
            rule = f"{_rule(statement)}: {statement.reason}"
            rows.append(
                [
                    str(identity), statement.statement, "<br>".join(shown), f"**{overall[str(identity)]}**", rule,
                    _evidence(statement, data),
                ]
            )  # fmt: skip
            reasons += _reasons(str(identity), statement, own, nominal)
        lines += [*_rows(rows, ["id", "statement", "found", "verdict", "holds when", "evidence"]), "", *reasons]
    return lines


def _shown(row) -> str:
    """Value and verdict on some terms, with its share."""
    if row.kind == "calibrated":
        return ""
    terms, share = f"`{row.terms}` " if row.terms else "", ""
    if np.isfinite(row.share):
        around = f" ({100 * row.share_low:.0f} to {100 * row.share_high:.0f})" if np.isfinite(row.share_low) else ""
        share = f", in {100 * row.share:.0f} %{around}"
    return f"{terms}{_MARK[row.verdict]} {_number(row.measured_value, row.unit)}{share}"


def _rule(statement: statements.Statement) -> str:
    parts = [f"above {statement.above:g}"] if statement.above is not None else []
    parts += [f"below {statement.below:g}"] if statement.below is not None else []
    return " and ".join(parts) or "no rule"


def _reasons(identity: str, statement: statements.Statement, own: pd.DataFrame, nominal: Nominal) -> list[str]:
    """Why a statement is not reproduced and what would have to be true; nothing for one that is."""
    if (own["verdict"] == "reproduced").all():
        return []
    words = dict.fromkeys(word for word in own["why"] if word)
    if len(words) > 1:
        shown = [
            f"`{row.terms}`: {row.why}"
            for row in own.itertuples()
            if row.why and row.why != filled(statement.why, nominal)
        ]
        common = filled(statement.why, nominal)
        words = dict.fromkeys([*([common] if common in words else []), *shown])
    if not words:
        return []
    lines = [f"- **{identity}**, why: {' '.join(words)}"]
    if statement.holds_if:
        lines.append(f"  Would hold if {filled(statement.holds_if, nominal)}")
    return [*lines, ""]


def _matching(nominal: Nominal) -> list[str]:
    """What the history matching found; what to run when it was not run yet."""
    waves = nominal.results.optional("matching_waves")
    if waves is None:
        return ["Not run yet: `python -m railrepro.studies.matching` (part of `make study`)."]
    last = waves.iloc[-1]
    lines = [
        f"Of the prior (vehicle data, poles, weights, sampling, delay, profile and experiments over their ranges) "
        f"{quantity(last['surviving_share'], '%')} survive {len(waves)} waves and {int(waves['points'].sum())} probes: "
        f"there no statement is implausible. At best {int(last['most_statements'])} of {int(last['statements'])} "
        f"statements hold in one probe.",
        "",
        "Tables: "
        + ", ".join(_file(f"data/results/matching_{n}.csv") for n in ("waves", "region", "best", "questions")),
        "",
    ]
    conflicts = nominal.results.optional("matching_conflicts")
    if conflicts is not None and len(conflicts):
        rows = [[row.statements, f"{row.probes}"] for row in conflicts.itertuples()]
        lines += ["Smallest sets of statements that no probe has together:", ""]
        lines += [*_rows(rows, ["statements", "probes in which all others of the set hold"]), ""]
    return lines


def _how_sure(nominal: Nominal) -> list[str]:
    text = (
        "The paper publishes almost no vehicle data. `make study` draws the unpublished parameters and choices over "
        "their ranges, tunes each controller again from a small common set, and asks the same predicates; a failed run "
        "counts as a failure. Intervals come from scrambled replicates of the sequence. The printed control model is a "
        "study of its own on equal terms."
    )
    found = nominal.results.optional("robustness_claims")
    if found is None or "terms" not in found:
        return [text, "", "Not run yet with these predicates."]
    known = statements.load()
    rows = [
        [
            str(row.id),
            known[str(row.id)].statement if row.id in known else "",
            str(row.terms),
            quantity(row.share, "%"),
            f"{quantity(row.low, '%')} to {quantity(row.high, '%')}",
            f"{quantity(row.cone, '%')} / {quantity(row.s1002, '%')}",
            quantity(row.printed, "%"),
            row.decided_by if isinstance(row.decided_by, str) else "",
        ]
        for row in found.itertuples()
    ]
    heads = [
        "id",
        "statement",
        "terms",
        "holds in",
        "95 % interval",
        "cone / S1002",
        "printed",
        "decided by (rank correlation)",
    ]
    return [text, "", *_rows(rows, heads)]


def _register(nominal: Nominal) -> list[str]:
    register, effects = (
        pd.read_csv(paths.source("data/discrepancies.csv")),
        nominal.results.optional("discrepancy_effects"),
    )
    rows = []
    for row in register.itertuples():
        own = pd.DataFrame() if effects is None else effects[effects["id"] == row.id]
        rows.append([str(row.id), row.printed, row.wrong_or_open, row.decision, _effect(own)])
    heads = ["", "printed", "wrong or open", "decision", "largest effect of the printed form on NMPC (D6: LTV-MPC)"]
    return [*_rows(rows, heads), "", "![effects](figures/fig22_discrepancies.png)"]


def _effect(own: pd.DataFrame) -> str:
    if own.empty:
        return "no run depends on it"
    failed = own["failed"].fillna(False).astype(bool)
    kept, parts = own[~failed], []
    if len(kept):
        worst = kept.loc[kept["rmse_change"].abs().idxmax()]
        effort = kept.loc[kept["effort_change"].abs().idxmax()]
        parts.append(f"RMSE {100 * worst['rmse_change']:+.1f} % ({worst['scenario']})")
        parts.append(f"torque {100 * effort['effort_change']:+.1f} % ({effort['scenario']})")
    if failed.any():
        parts.append("leaves the rail on " + ", ".join(own[failed]["scenario"]))
    return "; ".join(parts)


def _rules(table: pd.DataFrame) -> list[str]:
    """Rules that were changed, with the verdict under the old rule when it was replaced and under the new one today."""
    found = _overall(table)
    log = pd.read_csv(paths.source("data/rule_changes.csv"), dtype=str)
    rows = [[r.id, r.old, r.old_verdict, r.new, found.get(r.id, "none"), r.why] for r in log.itertuples()]
    return _rows(rows, ["id", "old rule", "verdict then", "new rule", "verdict now", "why"])
