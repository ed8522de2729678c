"""REPLICATION.md from the measured claims: verdicts, how sure they are, discrepancy register; nothing typed by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths

_MARK = {"reproduced": "✓", "partly": "◐", "not reproduced": "✗", "not testable": "–"}
_ORDER = tuple(_MARK)


def _number(value: float, unit: str = "") -> str:
    return "" if value is None or not np.isfinite(value) else f"{value:.4g}{'' if unit in ('', '-') else ' ' + unit}"


def _optional(name: str) -> pd.DataFrame | None:
    file = paths.source(f"data/results/{name}.csv")
    return pd.read_csv(file) if file.exists() else None


def _table(rows: list[list[str]], heads: list[str]) -> list[str]:
    return [
        "| " + " | ".join(heads) + " |",
        "|" + "---|" * len(heads),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]


def _evidence(claim: dict, data: str) -> str:
    """Links from a claim to its figure, the notebook cell that makes it and the tables that were judged."""
    evidence, notebook, links = claim["evidence"], claim["notebook"], []
    if evidence.startswith("fig"):
        links.append(f"[{evidence}](figures/{evidence}.png)")
    if notebook:
        cell = _cell(notebook, Path(evidence).name)
        title, anchor = (f", cell {cell}", f"#cell-id={cell}") if cell else ("", "")
        links.append(f"[{notebook}{title}](notebooks/{notebook}.ipynb{anchor})")
    tables = dict.fromkeys([*data.split(), *([evidence] if "/" in evidence else [])])
    return ", ".join([*links, *(f"[{Path(table).name}]({table})" for table in tables)])


def _cell(notebook: str, product: str) -> str:
    """Id of the code cell that writes a product; empty when none names it."""
    cells = json.loads((paths.NOTEBOOKS / f"{notebook}.ipynb").read_text())["cells"]
    named = [cell["id"] for cell in cells if cell["cell_type"] == "code" and product in "".join(cell["source"])]
    return named[-1] if named else ""


def render(table: pd.DataFrame, claims: dict[str, dict]) -> str:
    """The report as Markdown.

    Parameters
    ----------
    table : DataFrame
        See `railrepro.report.claims.evaluate`.
    claims : dict
        See `railrepro.report.claims.load_claims`.

    Returns
    -------
    str
    """
    counts = table["verdict"].value_counts()
    robustness = _optional("robustness_claims")
    lines = ["# Replication report", ""]
    lines += ["Written by `make report` from `data/results`; do not edit. Statements are in our words.", ""]
    lines += [", ".join(f"{counts.get(v, 0)} {v}" for v in _ORDER) + f", of {len(table)} statements.", ""]
    for verdict in _ORDER:
        chosen = table[table["verdict"] == verdict]
        if chosen.empty:
            continue
        lines += [f"## {verdict.capitalize()}", ""]
        rows = [
            [
                row.id,
                f"{_MARK[verdict]} {row.statement}",
                _number(row.paper_value, row.unit),
                _number(row.measured_value, row.unit),
                claims[row.id]["reason"],
                _evidence(claims[row.id], row.data),
            ]
            for row in chosen.itertuples()
        ]
        lines += [*_table(rows, ["id", "statement", "paper", "here", "how it is judged", "evidence"]), ""]
    if robustness is not None:
        lines += _how_sure(robustness, table)
    lines += _register()
    lines += [
        "## Disbelieve a verdict?",
        "",
        "Follow the evidence to its notebook, change its parameters cell (or `data/*.toml`) and run it: `make lab`, or "
        "`make figures` and `make report`. The function that judges a claim has its id in "
        "`railrepro/report/claims.py`.",
        "",
        "## Same numbers elsewhere",
        "",
        "On one machine with the locked packages tables and figures are bit-identical. Another processor rounds "
        "differently; `make verify` reruns everything and compares within the tolerance of `notebooks/chain.toml`.",
    ]
    return "\n".join(lines) + "\n"


def _how_sure(robustness: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    known = table.set_index("id")["statement"]
    rows = [
        [
            row.id,
            known.get(row.id, ""),
            f"{100 * row.share:.0f} %",
            f"{100 * row.low:.0f} to {100 * row.high:.0f} %",
            str(row.samples),
            row.decided_by if isinstance(row.decided_by, str) else "",
        ]
        for row in robustness.itertuples()
    ]
    heads = ["id", "statement", "holds in", "95 % interval", "samples", "decided by (rank correlation)"]
    text = (
        "The paper publishes almost no vehicle data. `make study` draws the unpublished parameters over the ranges in "
        "`data/vehicle.toml` and asks again; controllers are tuned again for each sample from a small common set."
    )
    return ["## How sure", "", text, "", *_table(rows, heads), ""]


def _register() -> list[str]:
    register, effects = pd.read_csv(paths.source("data/discrepancies.csv")), _optional("discrepancy_effects")
    rows = []
    for row in register.itertuples():
        shown = "no run depends on it"
        if effects is not None and (effects["id"] == row.id).any():
            own = effects[effects["id"] == row.id]
            lost = own[own["failed"].fillna(False).astype(bool)]["scenario"].tolist()
            kept = own[~own["failed"].fillna(False).astype(bool)]
            parts = []
            if len(kept):
                worst = kept.loc[kept["rmse_change"].abs().idxmax()]
                effort = kept.loc[kept["effort_change"].abs().idxmax()]
                parts.append(f"RMSE {100 * worst['rmse_change']:+.1f} % ({worst['scenario']})")
                parts.append(f"torque {100 * effort['effort_change']:+.1f} % ({effort['scenario']})")
            if lost:
                parts.append("leaves the rail on " + ", ".join(lost))
            shown = "; ".join(parts)
        rows.append([row.id, row.printed, row.wrong_or_open, row.decision, shown])
    heads = ["", "printed", "wrong or open", "decision", "largest effect of the printed form on NMPC (D6: LTV-MPC)"]
    return ["## Discrepancy register", "", *_table(rows, heads), "", "![effects](figures/fig22_discrepancies.png)", ""]
