"""From the rows of all cases to points, a score and a card with units.

The cost of a case is

    J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1)

e: RMS lateral error (with sensors from the rails where they lie), T: RMS differential torque, A: its part above 5 Hz,
u: adhesion used of what there is, where the demand exceeds it (else 1), s: the larger of Y/Q over 0.8 and of the track
shifting force over its limit; e, T, A of the front gear. With q = 1 / (1 + J), points are

    100 (q - q_0) / (q_l - q_0), between 0 and 100,

q_0 of a car without guidance in the same case (0 where that derails), q_l of the limit (`limit`). A case that
fails has no points. The runs with more delay and lag count as one case, with the mean of their points, which falls
steadily before anything derails. The score is the mean over cases, and then over settings.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro.evidence.runs.tuning import LOOP
from railrepro.evidence.score.suite import MARGINS
from railrepro.simulation.ride import Y_OVER_Q_LIMIT

COST = "J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1)"
FORMULA = f"100 (q - q_0) / (q_l - q_0), q = 1 / (1 + J), {COST}"
SYMBOLS = (
    "e: RMS lateral error; T: RMS differential torque; A: its part above 5 Hz; u: adhesion used where the demand "
    "exceeds it (else 1); s: the larger of Y/Q over 0.8 and of the track shifting force over its limit; q_0: without "
    "guidance; q_l: at the limit"
)
ALL = "all"
"""Scenario of the rows that sum up."""
ROW_UNITS = {
    **{"points": "-", "error": "m", "limit": "m", "effort_du": "N m", "activity_du": "N m", "utilisation": "-"},
    **{"stopping_distance": "m", "y_over_q": "-", "sum_y_over_limit": "-", "wheel_unloading": "-", "comfort": "-"},
    "failed_at_m": "m",
}
CARD = {
    **{"score": ("score of 100", 1.0, "-"), "margins": ("points with more delay and lag", 1.0, "-")},
    **{"failures": ("cases failed", 1.0, "-"), "cases": ("cases", 1.0, "-")},
    **{"error": ("lateral error, RMS, mean", 1e3, "mm"), "limit": ("its limit, mean", 1e3, "mm")},
    "effort_du": ("differential torque, RMS, mean", 1.0, "N m"),
    **{"activity_du": ("part above 5 Hz, RMS, mean", 1.0, "N m"), "utilisation": ("adhesion used, mean", 100.0, "%")},
    "stopping_distance": ("stopping distance with a poor patch", 1.0, "m"),
    **{"y_over_q": ("Y/Q, largest (limit 0.8)", 1.0, "-")},
    "sum_y_over_limit": ("track shifting force over its limit, largest", 1.0, "-"),
    "wheel_unloading": ("wheel unloading, largest", 1.0, "-"),
    "comfort": ("mean comfort N_MV, mean", 1.0, "-"),
}
"""Lines of the card: metric -> words, factor from SI, unit on the card."""
_MEANS = ("error", "limit", "effort_du", "activity_du", "utilisation", "stopping_distance", "comfort")
_LARGEST = ("y_over_q", "sum_y_over_limit", "wheel_unloading")


def cost(row: dict) -> float:
    """J of a row that did not fail; inf when a quantity is missing."""
    unused = 1 - min(row["utilisation"], 1.0) if np.isfinite(row.get("utilisation", np.nan)) else 0.0
    unsafe = max(row["y_over_q"] / Y_OVER_Q_LIMIT, row["sum_y_over_limit"])
    value = error(row) / 1e-3 + row["effort_du"] / 4e3 + max(0.0, row["activity_du"] / 500 - 1)
    value += 2 * unused + 10 * max(0.0, unsafe - 1)
    return float(value) if np.isfinite(value) else float("inf")


def points(row: dict) -> float:
    """Points of a row with its anchors `nothing` and `best` (J), 0 to 100; see the module."""
    if row["failure"]:
        return 0.0
    q, nothing, best = (1 / (1 + value) for value in (cost(row), row["nothing"], row["best"]))
    return float(np.clip(100 * (q - nothing) / (best - nothing), 0.0, 100.0)) if best > nothing else 0.0


def error(row: dict) -> float:
    """RMS lateral error of the front gear (m)."""
    return row.get("followed_rmse_y" if row["setting"] == LOOP else "rmse_y", float("nan"))


def judged(rows: list[dict]) -> pd.DataFrame:
    """Rows of `trial.Trial` with their error and points; each has `nothing`, `best` and `limit`, see `limit`."""
    table = pd.DataFrame([row | {"error": error(row)} for row in rows])
    table["points"] = [points(row) for row in table.to_dict("records")]
    return table


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
    groups = rows.groupby("group")["points"].mean()
    found = {"score": float(groups.mean())}
    if MARGINS in groups:
        found["margins"] = float(groups[MARGINS])
    rows = rows[rows["group"] != MARGINS]
    found |= {"failures": float((rows["failure"] != "").sum()), "cases": float(len(groups))}
    for names, reduce in ((_MEANS, np.mean), (_LARGEST, np.max)):
        for name in names:
            values = rows[name].dropna().astype(float) if name in rows else []
            if len(values):
                found[name] = float(reduce(values))
    return found


def ranking(cards: pd.DataFrame, published: int) -> pd.DataFrame:
    """Cards of several controllers and draws, the best ranked draw first.

    Returns
    -------
    DataFrame
        By controller: `ranked` (mean over all draws but the published one), `spread` (their standard deviation, nan for
        one draw), `published`; of the ranked draws, or the published one where there is no other, a column per setting,
        and `margins`, `failures`, and `error`, `limit` (m), `effort_du` (N m) of the setting `loop`.
    """
    whole = cards[cards["scenario"] == ALL]
    found = {}
    for name, rows in whole.groupby("controller", sort=False):
        total = rows[(rows["setting"] == ALL) & (rows["metric"] == "score")].set_index("seed")["value"]
        ranked = total.drop(published, errors="ignore")
        chosen = rows[rows["seed"].isin(ranked.index)] if len(ranked) else rows
        mean = chosen.groupby(["metric", "setting"])["value"].mean()
        row = {"ranked": ranked.mean(), "spread": ranked.std(), "published": total.get(published, np.nan)}
        row |= {
            setting: mean.get(("score", setting), np.nan) for setting in chosen["setting"].unique() if setting != ALL
        }
        row["margins"] = chosen[chosen["metric"] == "margins"]["value"].mean()
        row["failures"] = chosen[chosen["metric"] == "failures"].groupby("seed")["value"].sum().mean()
        row |= {key: mean.get((key, LOOP), np.nan) for key in ("error", "limit", "effort_du")}
        found[name] = row
    table = pd.DataFrame(found).T.rename_axis("controller")
    order = table["ranked"].fillna(table["published"]).sort_values(ascending=False, kind="stable").index
    return table.loc[order]


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
