"""Verdicts on the paper's statements with controllers tuned and run in three ways ("settings"). data/claims.toml has
the rules, `railrepro.evidence.claims.statements` a function for each, data/results/claims.csv the accepted verdicts,
data/theses.toml the reasons why a statement fails."""

import numpy as np
import pandas as pd

from railrepro.control.registry import PAPER
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.uncertainty.robustness import shares

FILE = "data/results/claims.csv"
HEADLINE = PAPER
"""Setting whose verdicts the report shows first: "paper", exact measurements."""
FRAGILE, NO_VERDICT = "fragile", "no verdict"
_CONTRACT = {FRAGILE: statements.PARTLY, statements.TIE: statements.NOT}
"""Verdicts of the column `judged` that the column `verdict` of claims.csv does not have -> the ones it has."""


def evaluate(nominal: Nominal) -> pd.DataFrame:
    """Judge all statements by the metrics `nominal` of runs of the nominal car: one row per statement and setting,
    which is how controllers were tuned and run. A statement is fragile when it is reproduced, but the lower 95 % limit
    of its share of sampled cars (unpublished parameters drawn at random) is at most 0.5. It is a tie when its value is
    nearer to the limit of its rule than the scatter between tuning runs. Columns:

    - id, paper_ref (section), statement (text), kind, unit, evidence (figure or table): from data/claims.toml;
    - setting: "paper" (exact measurements), "swarm" (the same, but poles of NDI by particle swarm) or "loop" (sensors);
      "" for a statement on no tuned controller, or without metrics;
    - paper_value, measured_value: in `unit`, NaN where there is none; data: path of the table that was judged;
    - judged: "reproduced", "fragile", "partly", "tie", "not reproduced" or "not testable"; verdict: the same, but
      "partly" for fragile and "not reproduced" for a tie;
    - share, share_low, share_high: share of sampled cars on which it holds (-), with its 95 % limits;
    - calibrated: whether it holds on the car fitted to the statements: "yes", "no", or "" where that was not judged.
    """
    robust = shares(nominal.results("robustness_samples")).set_index(["id", "setting"])
    calibrated = nominal.on_calibrated_car()
    findings = {setting: statements.findings(nominal.evidence(setting)) for setting in (*nominal.settings(), "")}
    rows = []
    for identity, rule in statements.load().items():
        for setting in [one for one in nominal.settings() if identity in findings[one]] or [""]:
            finding = findings[setting].get(identity)
            sampled = robust.reindex([(identity, setting)]).iloc[0]
            judged = statements.UNTESTABLE if finding is None else rule.judge(finding)
            if judged == statements.REPRODUCED and sampled["low"] <= 0.5:
                judged = FRAGILE
            row = {"id": identity, "paper_ref": rule.section, "statement": rule.statement, "kind": rule.kind}
            row |= {"setting": setting, "paper_value": np.nan if rule.paper is None else rule.paper}
            row |= {"measured_value": np.nan if finding is None else finding.value, "unit": rule.unit}
            row |= {"verdict": _CONTRACT.get(judged, judged), "share": sampled["share"]}
            row |= {"share_low": sampled["low"], "share_high": sampled["high"], "evidence": rule.evidence}
            table = "" if finding is None else f"data/results/{statements.TABLES[identity]}.csv"
            rows.append(row | {"judged": judged, "data": table, "calibrated": calibrated.get(identity, "")})
    return pd.DataFrame(rows)


def headline(rows: pd.DataFrame) -> str:
    """Pick the verdict on one statement that the report shows first. `rows` are its rows of the table of `evaluate`,
    one per setting. Returns the verdict (column judged) of the row with setting "paper" (exact measurements) or "";
    "not testable" if there is none; "no verdict" if its kind is not "statement", as for a motivation of the paper."""
    if set(rows["kind"]) != {"statement"}:
        return NO_VERDICT
    counts = rows[rows["setting"].isin(("", HEADLINE))]["judged"]
    return str(counts.iloc[0]) if len(counts) else statements.UNTESTABLE
