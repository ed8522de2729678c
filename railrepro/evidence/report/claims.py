"""Verdicts on the paper's statements, in each setting of comparison; REPLICATION.md is rendered from them.

`data/claims.toml` has the rules, `railrepro.evidence.claims.statements` a predicate for each, data/results/claims.csv
the accepted verdicts, `data/theses.toml` why a statement fails. The headline verdict is that in the setting `paper` on
the uncalibrated car; that on the calibrated car has a column of its own.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import NOT, PARTLY, REPRODUCED, TIE, UNTESTABLE
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
    measured_value (in `unit`), judged (one of `ORDER`; fragile is reproduced with share_low of at most 0.5), verdict
    (the same, but fragile is "partly" and tie "not reproduced"), share of sampled cars on which it holds (-) with 95 %
    limits share_low and share_high, evidence (figure or table), data (path of the table judged), calibrated (whether
    it holds on the calibrated car: "yes", "no", or "" where not judged).
    """
    nominal = nominal or Nominal()
    robust = shares(nominal.results("robustness_samples")).set_index(["id", "setting"])
    calibrated = nominal.on_calibrated_car()
    found = {setting: statements.findings(nominal.evidence(setting)) for setting in (*nominal.settings(), "")}
    rows = []
    for identity, rule in statements.load().items():
        for setting in [one for one in nominal.settings() if identity in found[one]] or [""]:
            finding = found[setting].get(identity)
            sampled = robust.reindex([(identity, setting)]).iloc[0]
            judged = UNTESTABLE if finding is None else rule.judge(finding)
            if judged == REPRODUCED and sampled["low"] <= 0.5:
                judged = FRAGILE
            rows.append({
                "id": identity,
                "paper_ref": rule.section,
                "statement": rule.statement,
                "kind": rule.kind,
                "setting": setting,
                "paper_value": np.nan if rule.paper is None else rule.paper,
                "measured_value": np.nan if finding is None else finding.value,
                "unit": rule.unit,
                "verdict": _CONTRACT.get(judged, judged),
                "share": sampled["share"],
                "share_low": sampled["low"],
                "share_high": sampled["high"],
                "evidence": rule.evidence,
                "judged": judged,
                "data": "" if finding is None else f"data/results/{statements.TABLES[identity]}.csv",
                "calibrated": calibrated.get(identity, ""),
            })  # fmt: skip
    return pd.DataFrame(rows)


def headline(rows: pd.DataFrame) -> str:
    """Headline verdict of one statement from its rows of `evaluate`: that in `paper`, or that without a setting.

    `NO_VERDICT` for an entry that is no statement, `UNTESTABLE` where neither row is there.
    """
    if set(rows["kind"]) != {"statement"}:
        return NO_VERDICT
    counts = rows[rows["setting"].isin(("", HEADLINE))]["judged"]
    return str(counts.iloc[0]) if len(counts) else UNTESTABLE
