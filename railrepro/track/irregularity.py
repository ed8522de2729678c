"""Track irregularities: their spectrum and random realisations of it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro.errors import InputError

_IRREGULARITIES = {
    "erri_low": (2.119e-7, 4.032e-7),
    "erri_high": (6.125e-7, 10.80e-7),
}
_WAVE = {"c": 0.8246, "r": 0.0206, "s": 0.4380}
_HALF_BASE = 0.75


def irregularity_spectrum(spectrum: str, channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """One-sided power spectral density of an irregularity channel.

    Parameters
    ----------
    spectrum : str
        "erri_low" or "erri_high".
    channel : str
        "lateral", "vertical" (m^2/(rad/m)) or "crosslevel" (rad^2/(rad/m)).
    wavenumber : ndarray
        Angular wavenumber (rad/m).

    Returns
    -------
    ndarray

    Source: ERRI B176.
    """
    if spectrum not in _IRREGULARITIES:
        raise InputError(f"spectrum {spectrum!r} is not known; there are {sorted(_IRREGULARITIES)}")
    lateral, vertical = _IRREGULARITIES[spectrum]
    w2, c2, r2, s2 = wavenumber**2, *(_WAVE[k] ** 2 for k in "crs")
    shape = c2 / ((w2 + r2) * (w2 + c2))
    if channel == "crosslevel":
        return vertical / _HALF_BASE**2 * shape * w2 / (w2 + s2)
    return {"lateral": lateral, "vertical": vertical}[channel] * shape


def irregularities(
    p: np.ndarray, spectrum: str = "erri_low", seed: int = 1, shortest: float = 3.0, longest: float = 100.0
) -> pd.DataFrame:
    """Random realisation of track irregularities, to be superposed on a route.

    Parameters
    ----------
    p : ndarray, shape (n,)
        Track coordinates (m).
    spectrum : str
    seed : int
        Each channel draws from its own generator (seed, channel).
    shortest, longest : float
        Band of wavelengths (m).

    Returns
    -------
    DataFrame
        Columns p_m, lateral_m, vertical_m, crosslevel_rad; faded in and out smoothly over 30 m.
    """
    frequency = np.linspace(1 / longest, 1 / shortest, 1200)
    step = frequency[1] - frequency[0]
    r = np.clip(np.minimum(p - p[0], p[-1] - p) / 30.0, 0, 1)
    fade = r**3 * (10 - 15 * r + 6 * r**2)
    columns = {"p_m": p}
    for i, (channel, unit) in enumerate((("lateral", "m"), ("vertical", "m"), ("crosslevel", "rad"))):
        phase = np.random.default_rng((seed, i)).uniform(0, 2 * np.pi, frequency.size)
        density = 2 * np.pi * irregularity_spectrum(spectrum, channel, 2 * np.pi * frequency)
        waves = np.cos(2 * np.pi * np.outer(p, frequency) + phase)
        columns[f"{channel}_{unit}"] = fade * (waves @ np.sqrt(2 * density * step))
    return pd.DataFrame(columns)
