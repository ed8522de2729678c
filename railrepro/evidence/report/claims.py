"""Verdicts on the paper's statements, in each setting of comparison; REPLICATION.md is rendered from them.

`data/claims.toml` holds the statements and rules, `railrepro.evidence.claims.statements` one predicate each.
`python -m railrepro report` writes data/results/claims.csv and REPLICATION.md. A verdict that differs
from the stored one is reported, and a test fails.
"""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.statements import (
    NOT,
    PARTLY,
    REPRODUCED,
    UNTESTABLE,
    Finding,
    MissingEvidence,
    Statement,
)
from railrepro.evidence.report.evidence import Nominal
from railrepro.evidence.report.reasons import filled
from railrepro.evidence.runs import tuning
from railrepro.evidence.uncertainty.robustness import shares
from railrepro.files import write

MAJORITY = 0.5
"""Share of the samples in which a reproduced statement must hold."""
FRAGILE, NO_VERDICT = "fragile", "no verdict"


def evaluate(nominal: Nominal | None = None) -> pd.DataFrame:
    """Verdicts, one row per statement and setting (contract of data/results/claims.csv).

    `setting` is empty for statements that no tuned set enters; `verdict` counts the nominal case and, where samples of
    the robustness study tell, the share of them in which the statement holds.
    """
    nominal = nominal or Nominal()
    robust = shares(nominal.results.optional("robustness_samples")).set_index(["id", "setting"])
    return pd.DataFrame(
        _row(identity, statement, setting, nominal, robust)
        for identity, statement in statements.load().items()
        for setting in judged_on(identity, statement, nominal)
    )


def judged_on(identity: str, statement: Statement, nominal: Nominal) -> list[str]:
    """Settings whose evidence can tell; [""] for what does not depend on the setting."""
    if statement.kind == "calibrated":
        return [""]
    found = []
    for setting in nominal.settings():
        try:
            statements.find(identity, nominal.evidence(setting, tables=False))
            found.append(setting)
        except MissingEvidence:
            continue
    return found or [""]


def _row(identity: str, statement: Statement, setting: str, nominal: Nominal, robust: pd.DataFrame) -> dict:
    share = robust.loc[(identity, setting)] if (identity, setting) in robust.index else None
    finding, used = _found(identity, statement, setting, nominal)
    verdict = UNTESTABLE if finding is None else statement.judge(finding)
    fragile = verdict == REPRODUCED and share is not None and share["share"] <= MAJORITY
    return {
        "id": identity,
        "paper_ref": statement.section,
        "statement": statement.statement,
        "kind": statement.kind,
        "setting": setting,
        "paper_value": np.nan if statement.paper is None else statement.paper,
        "measured_value": np.nan if finding is None else finding.value,
        "unit": statement.unit,
        "verdict": PARTLY if fragile else verdict,
        "share": np.nan if share is None else share["share"],
        "share_low": np.nan if share is None else share["low"],
        "share_high": np.nan if share is None else share["high"],
        "why": _why(statement, finding, verdict, share if fragile else None, nominal),
        "evidence": statement.evidence,
        "nominal": verdict,
        "data": " ".join(used),
    }


def _found(identity: str, statement: Statement, setting: str, nominal: Nominal) -> tuple[Finding | None, list[str]]:
    """What the predicate finds in some setting and in which tables; None when nothing can tell."""
    if statement.kind == "calibrated":
        return None, []
    try:
        return nominal.traced(lambda: statements.find(identity, nominal.evidence(setting or tuning.EQUAL, not setting)))
    except MissingEvidence:
        return None, []


def _why(statement: Statement, finding: Finding | None, verdict: str, share, nominal: Nominal) -> str:
    """Why a statement is not, or not fully, reproduced."""
    if statement.kind == "calibrated":
        return "A choice of ours was made so that it holds: " + statement.reason + "."
    if finding is None:
        return "The tables do not have it yet; `make study` writes them."
    words = [f"Fragile: holds in {100 * share['share']:.0f} % of the samples."] if share is not None else []
    words += ["A tie: seeds differ as much."] if statement.tied(finding) else []
    words += [filled(statement.why, nominal)] if verdict in (NOT, PARTLY) or share is not None else []
    return " ".join(filter(None, words))


def overall(rows: pd.DataFrame) -> str:
    """The verdict on a statement over all its settings, by rule; calibrated choices have none.

    Reproduced when it is in every setting; reproduced in setting … when in some; fragile when the nominal case holds
    somewhere but no share of samples is above one half; else partly, not reproduced or not testable.
    """
    if set(rows["kind"]) == {"calibrated"}:
        return NO_VERDICT
    verdicts = set(rows["verdict"])
    if verdicts == {REPRODUCED}:
        return REPRODUCED
    if REPRODUCED in verdicts:
        return "reproduced in setting " + ", ".join(rows.loc[rows["verdict"] == REPRODUCED, "setting"])
    if REPRODUCED in set(rows["nominal"]):
        return FRAGILE
    return next(verdict for verdict in (PARTLY, NOT, UNTESTABLE) if verdict in verdicts)


def verdicts(table: pd.DataFrame) -> dict[str, str]:
    """Overall verdict by id, in the order of data/claims.toml."""
    return {str(identity): overall(rows) for identity, rows in table.groupby("id", sort=False)}


def changed(table: pd.DataFrame) -> list[str]:
    """Sentences on verdicts that differ from the stored ones."""
    known = statements.load()
    return [
        f"{identity}: now {verdict!r}, stored {known[identity].verdict!r} ({known[identity].statement})"
        for identity, verdict in verdicts(table).items()
        if verdict != known[identity].verdict
    ]


def main(accept: bool = False) -> int:
    """Evaluate the claims and write claims.csv and REPLICATION.md; `accept` stores the new verdicts."""
    from railrepro.evidence.report.text import render

    nominal = Nominal()
    table = evaluate(nominal)
    if accept:
        _store(verdicts(table))
    contract = table.drop(columns=["nominal", "data"])
    write(paths.product("data/results/claims.csv"), contract.to_csv(index=False, float_format="%.4g"))
    write(paths.product("REPLICATION.md"), render(table, nominal))
    print(pd.Series(verdicts(table)).value_counts().to_string())
    differences = changed(table)
    if differences:
        advice = "store them with --accept if that is right"
        print("\n  ".join(["verdicts changed:", *differences]), advice, sep="\n", file=sys.stderr)
    return int(bool(differences))


def _store(found: dict[str, str]) -> None:
    """Write the verdicts into data/claims.toml, keeping everything else as it is."""
    file = paths.ROOT / "data/claims.toml"
    lines, identity = [], ""
    for line in file.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            identity = line.strip("[]")
        if line.startswith("verdict ="):
            continue
        lines.append(line)
        if line.startswith("section ="):
            lines.append(f'verdict = "{found[identity]}"')
    write(file, "\n".join(lines) + "\n")
