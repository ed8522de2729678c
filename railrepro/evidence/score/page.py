"""The score card as one HTML page that needs nothing else."""

from __future__ import annotations

import base64
import io
from html import escape

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.evidence.report import figures
from railrepro.evidence.score import card
from railrepro.evidence.score.suite import JUDGED_ON

LEADERBOARD = "data/results/leaderboard.csv"
_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:62em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}"
    ".bar{display:inline-block;height:.7em;background:#0072B2}.bad{color:#B3261E;text-align:left}"
    "tr.own{background:#FFF6D6}img{max-width:100%}"
)
_CASE = {"points": 1.0, "error": 1e3, "effort_du": 1.0, "activity_du": 1.0, "utilisation": 100.0, "y_over_q": 1.0}
_HEADS = ("case", "points", "", "error (mm)", "torque (N m)", "above 5 Hz (N m)", "adhesion used (%)", "Y/Q (-)", "")


def html(name: str, table: pd.DataFrame, long: pd.DataFrame, seed: int) -> str:
    """The page.

    Parameters
    ----------
    name : str
        Of the controller.
    table, long : DataFrame
        See `card.judged` and `card.tidy`.
    seed : int
    """
    whole = long[long["scenario"] == card.ALL].pivot_table(index="metric", columns="setting", values="value")
    settings_here = [setting for setting in JUDGED_ON if setting in whole]
    lines = [
        [words + (f" ({unit})" if unit != "-" else ""), *(_number(factor * whole.loc[key, t]) for t in settings_here)]
        for key, (words, factor, unit) in card.CARD.items()
        if key in whole.index
    ]
    body = [f"<h1>{escape(name)}: {whole.loc['score', card.ALL]:.1f} of 100</h1>"]
    body += [
        f"<p>Seed {seed}. Points of a case: {escape(card.FORMULA)}; the score is the mean over cases and settings.</p>"
    ]
    body += [_table(("", *settings_here), lines), *_standing(name, long)]
    for setting, rows in table.groupby("setting", sort=False):
        body += [
            f"<h2>In the setting {setting}</h2>",
            _table(_HEADS, [_case(row) for _, row in rows.iterrows()], raw=True),
        ]
    body.append(_picture(table))
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(name)}</title><style>{_STYLE}</style>'
    return f"{head}{''.join(body)}</html>\n"


def _standing(name: str, long: pd.DataFrame) -> list[str]:
    """The controller among those of the leaderboard, where there is one."""
    file = paths.source(LEADERBOARD)
    if not file.exists():
        return []
    others = pd.read_csv(file)
    ranked = card.ranking(pd.concat([others[others["controller"] != name], long]))
    lines = [[str(k), _number(row[card.ALL]), *(_number(row[t]) for t in JUDGED_ON), str(int(row["failures"]))]
             for k, row in ranked.iterrows()]  # fmt: skip
    return ["<h2>Among the others</h2>", _table(("controller", "score", *JUDGED_ON, "failures"), lines, own=name)]


def _case(row: pd.Series) -> list[str]:
    shown = [_number(factor * row.get(key, np.nan)) for key, factor in _CASE.items()]
    bar = f'<span class="bar" style="width:{row["points"] / 10:.1f}em"></span>'
    return [row["scenario"], shown[0], bar, *shown[1:], f'<span class="bad">{escape(row["failure"])}</span>']


def _number(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.4g}"


def _table(heads, lines, own: str = "", raw: bool = False) -> str:
    top = "".join(f"<th>{escape(head)}</th>" for head in heads)
    rows = []
    for line in lines:
        cells = "".join(f"<td>{cell if raw else escape(cell)}</td>" for cell in line)
        rows.append(f"<tr{' class=own' if own and line[0] == own else ''}>{cells}</tr>")
    return f"<table><tr>{top}</tr>{''.join(rows)}</table>"


def _picture(table: pd.DataFrame) -> str:
    """Set point and displacement of every case that was driven, as an image within the page."""
    driven = table[table["series"].notna()] if "series" in table else table[:0]
    if driven.empty:
        return ""
    names = list(dict.fromkeys(driven["scenario"]))
    figure, axes = figures.new_figure(len(names), 1, height=1.0, width=7.0, squeeze=False)
    for name, (panel,) in zip(names, axes, strict=True):
        for setting, color in zip(JUDGED_ON, (figures.BLUE, figures.RED), strict=True):
            for series in driven[(driven["scenario"] == name) & (driven["setting"] == setting)]["series"]:
                p, y, y_ref = (np.array(series[key]) for key in ("p_m", "y_m", "y_ref_m"))
                panel.plot(p, 1e3 * y_ref, color=figures.BLACK, linestyle=":")
                panel.plot(p, 1e3 * y, color=color, label=setting)
        panel.set(ylabel="$y$ (mm)", title=name)
    axes[-1, 0].set_xlabel("track coordinate (m)")
    axes[0, 0].legend()
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    plt.close(figure)
    image = base64.b64encode(stream.getvalue()).decode()
    return f'<h2>Lateral position</h2><img alt="" src="data:image/png;base64,{image}">'
