"""Figures of merit of a run: tracking error, delay, effort, stopping distance, adhesion utilisation.

Serves the paper's section Multi-Body Simulation Results.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import signal


def lateral_error(series: pd.DataFrame, gear: str = "front") -> np.ndarray:
    """y_TrAx - y* (m), shape (n,)."""
    return (series[f"{gear}.y"] - series[f"{gear}.y_ref"]).to_numpy()


def rmse(series: pd.DataFrame, gear: str = "front") -> float:
    """Root mean squared lateral error (m). Source: paper, section Evaluation of Lateral Control."""
    return float(np.sqrt(np.mean(lateral_error(series, gear) ** 2)))


def delay(series: pd.DataFrame, gear: str = "front", longest: float = 60.0, step: float = 0.1) -> float:
    """Distance by which y trails y* (m): the lag of the largest cross-correlation of the detrended signals.

    Parameters
    ----------
    series : DataFrame
        Series of a run.
    gear : str
    longest : float
        Largest lag considered, both directions (m).
    step : float
        Resolution of the lag (m).

    Returns
    -------
    float
        Positive when y comes after y* (m); nan when the set point does not move.
    """
    p = series[f"{gear}.p"].to_numpy()
    grid = np.arange(p[0], p[-1], step)
    y, reference = (signal.detrend(np.interp(grid, p, series[f"{gear}.{name}"])) for name in ("y", "y_ref"))
    if np.ptp(reference) < 1e-9:
        return float("nan")
    lags = signal.correlation_lags(grid.size, grid.size) * step
    near = np.abs(lags) <= longest
    # Unbiased: each lag has its own number of overlapping samples.
    overlap = grid.size - np.abs(lags[near]) / step
    correlation = signal.correlate(y, reference)[near] / overlap
    return float(lags[near][np.argmax(correlation)])


def effort(series: pd.DataFrame, gear: str = "front") -> float:
    """Root mean squared differential torque (N m)."""
    return float(np.sqrt(np.mean(series[f"{gear}.du"].to_numpy() ** 2)))


def saturated_share(series: pd.DataFrame, limit: float, gear: str = "front") -> float:
    """Share of time in which a motor of the gear works at its torque limit (-)."""
    torque = np.maximum(
        np.abs(series[f"{gear}.tau_long"] + series[f"{gear}.du"]),
        np.abs(series[f"{gear}.tau_long"] - series[f"{gear}.du"]),
    )
    return float(np.mean(torque >= 0.999 * limit))


def stopping_distance(series: pd.DataFrame) -> float:
    """Way of the front gear from the first to the last row (m)."""
    return float(series["front.p"].iloc[-1] - series["front.p"].iloc[0])


def summary(series: pd.DataFrame, torque_limit: float) -> dict[str, tuple[float, str]]:
    """Metrics of a lateral run: name -> (value, unit)."""
    error = lateral_error(series)
    return {
        "rmse_y": (rmse(series), "m"),
        "rmse_y_rear": (rmse(series, "rear"), "m"),
        "mean_error_last_third": (float(np.mean(error[-len(error) // 3 :])), "m"),
        "largest_error": (float(np.abs(error).max()), "m"),
        "delay": (delay(series), "m"),
        "effort_du": (effort(series), "N m"),
        "largest_du": (float(series["front.du"].abs().max()), "N m"),
        "saturated_share": (saturated_share(series, torque_limit), "-"),
    }
