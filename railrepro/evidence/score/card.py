"""From the rows of all cases to points, a score and a card with units.

Points of a case: 100 / (1 + J) with

    J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1)

e: RMS lateral error (behind sensors from the rails where they lie), T: RMS differential torque, A: its part above 5 Hz,
u: adhesion used of what there is, where the demand exceeds it (else 1), s: the larger of Y/Q over 0.8 and of the track
shifting force over its limit. A case that fails has no points. The margins are one more case of 50 min(1, d / 10 ms) +
50 min(1, l / 50 ms), d the delay and l the lag of the drive with which no run left the rail. The score is the mean over
cases, and then over settings. Times are shown and do not count, as they depend on the machine. Those of a slower
controller are the least of three drives at each sample (`trial.DRIVES`), so that the longest is one that the
controller needs.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro.evidence.runs.ride import Y_OVER_Q_LIMIT
from railrepro.evidence.runs.tuning import LOOP

FORMULA = "100 / (1 + J), J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1)"
ALL = "all"
"""Scenario of the rows that sum up."""
ROW_UNITS = {
    **{"points": "-", "error": "m", "effort_du": "N m", "activity_du": "N m", "utilisation": "-"},
    **{"stopping_distance": "m", "y_over_q": "-", "sum_y_over_limit": "-", "wheel_unloading": "-", "comfort": "-"},
    **{"delay_survived": "s", "lag_survived": "s", "sample_median": "s", "sample_p99": "s", "sample_max": "s"},
    **{"failed_at_m": "m"},
}
CARD = {
    **{"score": ("score of 100", 1.0, "-"), "failures": ("cases failed", 1.0, "-"), "cases": ("cases", 1.0, "-")},
    **{"error": ("lateral error, RMS, mean", 1e3, "mm"), "effort_du": ("differential torque, RMS, mean", 1.0, "N m")},
    **{"activity_du": ("part above 5 Hz, RMS, mean", 1.0, "N m"), "utilisation": ("adhesion used, mean", 100.0, "%")},
    "stopping_distance": ("stopping distance with a poor patch", 1.0, "m"),
    **{"y_over_q": ("Y/Q, largest (limit 0.8)", 1.0, "-")},
    "sum_y_over_limit": ("track shifting force over its limit, largest", 1.0, "-"),
    "wheel_unloading": ("wheel unloading, largest", 1.0, "-"),
    "comfort": ("mean comfort N_MV, mean", 1.0, "-"),
    **{
        "delay_survived": ("further delay survived", 1e3, "ms"),
        "lag_survived": ("lag of the drive survived", 1e3, "ms"),
    },
    "sample_median": ("time per sample, median", 1e6, "us"),
    "sample_p99": ("time per sample, 99 % below", 1e6, "us"),
    "sample_max": ("time per sample, longest", 1e6, "us"),
}
"""Lines of the card: metric -> words, factor from SI, unit on the card."""
_MEANS = ("error", "effort_du", "activity_du", "utilisation", "stopping_distance", "comfort", "sample_median")
_LARGEST = ("y_over_q", "sum_y_over_limit", "wheel_unloading", "sample_p99", "sample_max")
_SMALLEST = ("delay_survived", "lag_survived")


def points(row: dict) -> float:
    """Points of a case, 0 to 100; see the module."""
    if row["failure"]:
        return 0.0
    if row["scenario"] == "margins":
        return 50 * min(1.0, row["delay_survived"] / 10e-3) + 50 * min(1.0, row["lag_survived"] / 50e-3)
    unused = 1 - min(row["utilisation"], 1.0) if np.isfinite(row.get("utilisation", np.nan)) else 0.0
    unsafe = max(row["y_over_q"] / Y_OVER_Q_LIMIT, row["sum_y_over_limit"])
    cost = row["error"] / 1e-3 + row["effort_du"] / 4e3 + max(0.0, row["activity_du"] / 500 - 1)
    cost += 2 * unused + 10 * max(0.0, unsafe - 1)
    return float(100 / (1 + cost)) if np.isfinite(cost) else 0.0


def judged(rows: list[dict]) -> pd.DataFrame:
    """Rows of `trial.Trial` with their error and points."""
    table = pd.DataFrame([row | {"error": _error(row)} for row in rows])
    table["points"] = [points(row) for row in table.to_dict("records")]
    return table


def _error(row: dict) -> float:
    """RMS lateral error of the front gear (m)."""
    return row.get("followed_rmse_y" if row["setting"] == LOOP else "rmse_y", float("nan"))


def tidy(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    """Score card: scenario, controller, metric, value, unit, setting, seed; scenario `ALL` sums up."""
    controller, keys = table["controller"].iloc[0], ["scenario", "controller", "setting"]
    present = [name for name in ROW_UNITS if name in table]
    long = table.melt(keys, present, "metric").dropna(subset="value")
    long["unit"] = long["metric"].map(ROW_UNITS)
    sums = [
        {"setting": setting, "metric": name, "value": value}
        for setting, rows in table.groupby("setting", sort=False)
        for name, value in _sums(rows).items()
    ]
    scores = [row["value"] for row in sums if row["metric"] == "score"]
    sums.append({"setting": ALL, "metric": "score", "value": float(np.mean(scores))})
    whole = pd.DataFrame(sums).assign(scenario=ALL, controller=controller)
    whole["unit"] = whole["metric"].map(ROW_UNITS).fillna("-")
    columns = ["scenario", "controller", "metric", "value", "unit", "setting"]
    return pd.concat([whole[columns], long[columns]], ignore_index=True).assign(seed=seed)


def _sums(rows: pd.DataFrame) -> dict[str, float]:
    """Values of the card of one setting."""
    found = {
        "score": float(rows["points"].mean()),
        "failures": float((rows["failure"] != "").sum()),
        "cases": float(len(rows)),
    }
    for names, reduce in ((_MEANS, np.mean), (_LARGEST, np.max), (_SMALLEST, np.min)):
        for name in names:
            values = rows[name].dropna().astype(float) if name in rows else []
            if len(values):
                found[name] = float(reduce(values))
    return found


def ranking(scores: pd.DataFrame) -> pd.DataFrame:
    """Scores of several controllers, the best first: a row per controller, score over all and per setting."""
    chosen = scores[(scores["scenario"] == ALL) & (scores["metric"] == "score")]
    wide = chosen.pivot_table(index="controller", columns="setting", values="value")
    failures = (
        scores[(scores["scenario"] == ALL) & (scores["metric"] == "failures")].groupby("controller")["value"].sum()
    )
    return wide.assign(failures=failures.astype(int)).sort_values(ALL, ascending=False, kind="stable")


def text(long: pd.DataFrame) -> str:
    """The card as lines for a terminal, a column per setting."""
    whole = long[long["scenario"] == ALL].pivot_table(index="metric", columns="setting", values="value")
    setting = [name for name in whole.columns if name != ALL]
    lines = [f"{'':48s}" + "".join(f"{name:>12s}" for name in setting)]
    for name, (words, factor, unit) in CARD.items():
        if name in whole.index:
            values = "".join(f"{'-' if np.isnan(v) else f'{factor * v:.4g}':>12s}" for v in whole.loc[name, setting])
            lines.append(f"{words + (f' ({unit})' if unit != '-' else ''):48s}{values}")
    return "\n".join([*lines, f"score over both settings: {whole.loc['score', ALL]:.1f} of 100"])
