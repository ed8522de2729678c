"""A film as one HTML page that needs neither a server nor a network: numbers as JSON, a canvas, plain JavaScript."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro.evidence.film.scene import AHEAD, BEHIND, Comparison

DECIMALS = {"p_m": 2, "v_kmh": 1, "tau_Nm": 0, "du_Nm": 0, "adhesion_percent": 1, "t_s": 3}
"""Decimals of a quantity, by the end of a column's name; all others have three."""
_TEMPLATE = Path(__file__).with_name("page.html")


def content(film: Comparison) -> dict:
    """What the page draws: title, t_s, scales, way, and per shot its columns; rounded to `DECIMALS`."""
    shots = [
        {"controller": shot.controller, "label": shot.label, "color": shot.color, "told": shot.summary}
        | {"columns": _columns(shot.table.drop(columns="t_s"))}
        for shot in film.shots
    ]
    seen = {"ahead_m": AHEAD, "behind_m": BEHIND, "still": film.still()}
    times = _columns(pd.DataFrame({"t_s": film.times}))["t_s"]
    scales = {name: round(value, 3) for name, value in film.scales.items()}
    return {"title": film.title, "t_s": times, "scales": scales, "way": _columns(film.way), "shots": shots} | seen


def html(film: Comparison) -> str:
    """The page."""
    numbers = json.dumps(content(film), separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    page = _TEMPLATE.read_text(encoding="utf-8")
    return page.replace("{{title}}", escape(film.title)).replace("{{film}}", numbers)


def frame(film: Comparison, height: int = 900) -> str:
    """The page inside another one, a notebook's output or a chapter of the book; `height` in pixels."""
    look = f"width:100%;height:{height}px;border:0"
    inner = f'title="film: {escape(film.title)}" style="{look}" srcdoc="{escape(html(film))}"'
    return f"<div><iframe {inner}></iframe></div>"


def _columns(table: pd.DataFrame) -> dict[str, list]:
    """Columns as lists of short numbers; whole numbers without a point."""
    found = {}
    for name in table:
        decimals = DECIMALS.get(str(name).rpartition(".")[2], 3)
        values = np.round(table[name].to_numpy(), decimals) + 0.0
        found[str(name)] = [int(value) if value == int(value) else value for value in values.tolist()]
    return found
