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
from railrepro.evidence.score.picture import leaderboard
from railrepro.evidence.score.suite import JUDGED_ON, draws

LEADERBOARD = "data/results/leaderboard.csv"
_STYLE = (
    "body{font:15px/1.5 sans-serif;max-width:62em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}"
    ".bar{display:inline-block;height:.7em;background:#0072B2}.bad{color:#B3261E;text-align:left}"
    "tr.own{background:#FFF6D6}img{max-width:100%}"
)
_CASE = {
    "points": 1.0,
    "error": 1e3,
    "limit": 1e3,
    "effort_du": 1.0,
    "activity_du": 1.0,
    "utilisation": 100.0,
    "y_over_q": 1.0,
}
_HEADS = (
    "case",
    "points",
    "",
    "error (mm)",
    "limit (mm)",
    "torque (N m)",
    "above 5 Hz (N m)",
    "adhesion used (%)",
    "Y/Q (-)",
    "",
)


def html(name: str, table: pd.DataFrame, long: pd.DataFrame, draw: str, ranked: bool = False) -> str:
    """The page.

    Parameters
    ----------
    name : str
        Of the controller.
    table, long : DataFrame
        See `card.judged` and `card.tidy`.
    draw : str
        Which draw it is, in words.
    ranked : bool
        Whether it takes its place among the others.
    """
    whole = long[long["scenario"] == card.ALL].pivot_table(index="metric", columns="setting", values="value")
    settings_here = [setting for setting in JUDGED_ON if setting in whole]
    lines = [
        [words + (f" ({unit})" if unit != "-" else ""), *(_number(factor * whole.loc[key, t]) for t in settings_here)]
        for key, (words, factor, unit) in card.CARD.items()
        if key in whole.index
    ]
    body = [f"<h1>{escape(name)}: {whole.loc['score', card.ALL]:.1f} of 100</h1>"]
    body += [f"<p>Draw {escape(draw)}. Points of a case: {escape(card.FORMULA)}; {escape(card.SYMBOLS)}. The score is "]
    body += ["the mean over cases and settings; the runs with more delay and lag are one case.</p>"]
    body += [_table(("", *settings_here), lines), *(_standing(name, long) if ranked else ())]
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
    file, published = paths.source(LEADERBOARD), draws().published
    if not file.exists():
        return []
    others = pd.read_csv(file)
    cards = pd.concat([others[others["controller"] != name], long])
    heads = ("ranked", "spread", "published", *JUDGED_ON, "failures")
    table = card.ranking(cards, published)
    lines = [[str(k), *(_number(row.get(key, np.nan)) for key in heads)] for k, row in table.iterrows()]
    drawn = _image(leaderboard(cards, own=name))
    return ["<h2>Among the others</h2>", _table(("controller", *heads), lines, own=name), drawn]


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


_QUANTITIES = {"y_m": ("y (mm)", 1e3), "error": ("error (mm)", 1e3), "du_Nm": ("torque (N m)", 1.0)}
_QUANTITIES |= {"adhesion": ("adhesion used (%)", 100.0)}


def _picture(table: pd.DataFrame) -> str:
    """Position and set point, error, torque and adhesion of both gears in every case that was driven."""
    driven = table[table["series"].notna()] if "series" in table else table[:0]
    if driven.empty:
        return ""
    names = list(dict.fromkeys(driven["scenario"]))
    figure, axes = figures.new_figure(len(names), len(_QUANTITIES), height=1.2, width=2.9, squeeze=False)
    for name, panels in zip(names, axes, strict=True):
        panels[0].set_title(name)
        for setting, color in zip(JUDGED_ON, (figures.BLUE, figures.RED), strict=True):
            for _, row in driven[(driven["scenario"] == name) & (driven["setting"] == setting)].iterrows():
                for gear, style in zip(row["series"], ("-", "--"), strict=True):
                    _draw(panels, row["series"][gear], color=color, linestyle=style, label=f"{gear}, {setting}")
                if np.isfinite(row["limit"]):
                    panels[1].axhline(1e3 * row["limit"], color=color, linestyle=":", label=f"limit (RMS), {setting}")
        for panel, (label, _) in zip(panels, _QUANTITIES.values(), strict=True):
            panel.set_ylabel(label)
    for panel in axes[-1]:
        panel.set_xlabel("track coordinate (m)")
    axes[0, 0].legend(fontsize=5)
    axes[0, 1].legend(fontsize=5)
    return "<h2>Runs</h2>" + _image(figure)


def _draw(panels, series: dict[str, list], **look) -> None:
    """One gear of a run into the panels of a case."""
    values = {name: np.array(column) for name, column in series.items()}
    values["error"] = values["y_ref_m"] - values["y_m"]
    if not panels[0].lines:
        panels[0].plot(values["p_m"], 1e3 * values["y_ref_m"], **figures.CONTROLLER_STYLE["set point"], zorder=3)
    for panel, (name, (_, factor)) in zip(panels, _QUANTITIES.items(), strict=True):
        panel.plot(values["p_m"], factor * values[name], linewidth=0.8, **look)


def _image(figure) -> str:
    """A figure within the page."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    plt.close(figure)
    return f'<img alt="" src="data:image/png;base64,{base64.b64encode(stream.getvalue()).decode()}">'
