"""Verdicts on the paper's statements, in each setting of comparison; REPLICATION.md is rendered from them.

`data/claims.toml` has the rules, `railrepro.evidence.claims.statements` a predicate for each, data/results/claims.csv
the accepted verdicts, `data/theses.toml` why a statement fails. The headline verdict is that in the setting `paper` on
the uncalibrated car; that on the calibrated car has a column of its own.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import NOT, PARTLY, REPRODUCED, TIE, UNTESTABLE, Finding
from railrepro.evidence.runs import tuning
from railrepro.evidence.uncertainty.robustness import shares

FILE = "data/results/claims.csv"
HEADLINE = tuning.PAPER
"""Setting of comparison whose verdict is the headline verdict."""
FRAGILE, NO_VERDICT = "fragile", "no verdict"
ORDER = (REPRODUCED, FRAGILE, PARTLY, TIE, NOT, UNTESTABLE)
"""Verdicts, the best first."""
_CONTRACT = {FRAGILE: PARTLY, TIE: NOT}
"""Verdicts that the column `verdict` of claims.csv has no word for; `judged` has them all."""


def evaluate(nominal: Nominal | None = None) -> pd.DataFrame:
    """Verdicts from the stored metrics (default `Nominal()`), one row per statement and setting of comparison.

    Columns id, paper_ref, statement, kind, setting ("" if it depends on no tuned controller), paper_value and
    measured_value (in `unit`), judged (one of `ORDER`), verdict (the same, but fragile is "partly" and tie "not
    reproduced"), share of sampled cars on which it holds (-) with 95 % limits share_low and share_high, evidence
    (figure or table), data (path of the table judged), calibrated (whether it holds on the calibrated car: "yes",
    "no", or "" where not judged).
    """
    nominal = nominal or Nominal()
    robust = shares(nominal.results("robustness_samples")).set_index(["id", "setting"])
    calibrated = nominal.on_calibrated_car()
    found = {setting: statements.findings(nominal.evidence(setting)) for setting in (*nominal.settings(), "")}
    rows = []
    for identity, statement in statements.load().items():
        for setting in [one for one in nominal.settings() if identity in found[one]] or [""]:
            share = robust.loc[(identity, setting)] if (identity, setting) in robust.index else None
            row = _row(identity, statement, setting, found[setting].get(identity), share)
            rows.append(row | {"calibrated": calibrated.get(identity, "")})
    return pd.DataFrame(rows)


def graded(verdict: str, share: pd.Series | None) -> str:
    """Return a verdict, lowered from "reproduced" to "fragile" when most sampled cars do not clearly confirm it.

    `share` is the row of `robustness.shares` for the statement: fragile is a lower 95 % limit ("low") of 0.5 or less.
    Without samples (None) the verdict stays.
    """
    return FRAGILE if verdict == REPRODUCED and share is not None and share["low"] <= 0.5 else verdict


def _row(
    identity: str, statement: statements.Statement, setting: str, finding: Finding | None, share: pd.Series | None
) -> dict:
    judged = UNTESTABLE if finding is None else graded(statement.judge(finding), share)
    return {
        "id": identity,
        "paper_ref": statement.section,
        "statement": statement.statement,
        "kind": statement.kind,
        "setting": setting,
        "paper_value": np.nan if statement.paper is None else statement.paper,
        "measured_value": np.nan if finding is None else finding.value,
        "unit": statement.unit,
        "verdict": _CONTRACT.get(judged, judged),
        **{f"share{end}": np.nan if share is None else share[end[1:] or "share"] for end in ("", "_low", "_high")},
        "evidence": statement.evidence,
        "judged": judged,
        "data": "" if finding is None else table_file(statements.TABLES[identity]),
    }


def table_file(name: str) -> str:
    """Return the path of a table of data/results by its name, as "table1"; a path (with a slash) is returned as is."""
    return name if "/" in name else f"data/results/{name}.csv"


def headline(rows: pd.DataFrame) -> str:
    """Headline verdict of one statement from its rows of `evaluate`: that in `paper`, or that without a setting.

    `NO_VERDICT` for an entry that is no statement, `UNTESTABLE` where neither row is there.
    """
    if set(rows["kind"]) != {"statement"}:
        return NO_VERDICT
    counts = rows[rows["setting"].isin(("", HEADLINE))]["judged"]
    return str(counts.iloc[0]) if len(counts) else UNTESTABLE


def verdicts(table: pd.DataFrame) -> dict[str, str]:
    """Statement id -> headline verdict, from a table of `evaluate`, in the order of data/claims.toml."""
    return {str(identity): headline(rows) for identity, rows in table.groupby("id", sort=False)}


def counted(table: pd.DataFrame) -> str:
    """Two sentences with the number of each headline verdict, of statements with and without a setting (`evaluate`)."""
    found, parts = verdicts(table), []
    judged = table[table["kind"] == "statement"]
    for needed, where in (
        (judged["setting"] != "", "are compared in the setting `paper`"),
        (judged["setting"] == "", "do not depend on the setting"),
    ):
        ids = [str(identity) for identity in judged[needed]["id"].unique()]
        kinds = {verdict: sum(found[i] == verdict for i in ids) for verdict in ORDER}
        said = ", ".join(f"{number} {verdict}" for verdict, number in kinds.items() if number)
        parts.append(f"{len(ids)} statements {where}: {said}.")
    return " ".join(parts)


def changed(table: pd.DataFrame) -> list[str]:
    """One line of text per verdict of a table of `evaluate` that differs from data/results/claims.csv."""
    stored = pd.read_csv(paths.source(FILE), dtype=str, keep_default_na=False)
    before, now = (one.set_index(["id", "setting"])["judged"] for one in (stored, table))
    both = pd.DataFrame({"before": before, "now": now}).fillna("nothing")
    differs = both[both["before"] != both["now"]]
    return [f"{row.Index[0]}, setting {row.Index[1]!r}: now {row.now!r}, stored {row.before!r}"
            for row in differs.itertuples()]  # fmt: skip
