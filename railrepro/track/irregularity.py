"""Track irregularities: spectra, random realisations, the rails of a track centre.

A frame of irregularities has the coordinate p_m and four channels of the track centre, signs as in the car: alignment
(`lateral_m`, right positive), longitudinal level (`vertical_m`, down positive), cross level as an angle
(`crosslevel_rad`, right rail down positive) and gauge (`gauge_m`, wider than nominal positive).
"""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Literal

import numpy as np
import pandas as pd
import scipy

from railrepro import data, paths
from railrepro.data import InputError, Number, above, require

CHANNELS = {"lateral": "lateral_m", "vertical": "vertical_m", "crosslevel": "crosslevel_rad", "gauge": "gauge_m"}
"""Channels in the order of their random generators, with their columns."""
FLANGEWAY = {"lateral_m": (-0.020, 0.020), "gauge_m": (-0.010, 0.035)}
"""What wheels can follow (m); more than the flangeway takes is refused."""
BAND = 3.0, 100.0
"""Wavelengths of random irregularities (m)."""
LARGEST = 0.1
"""Largest number of any channel; beyond it the unit is wrong."""
D1 = 3.0, 25.0
"""Wavelengths (m) in which EN 13848-1 judges level and alignment."""

_ERRI = {
    "erri_low": {"lateral": 2.119e-7, "vertical": 4.032e-7, "gauge": 5.32e-8},
    "erri_high": {"lateral": 6.125e-7, "vertical": 10.80e-7, "gauge": 1.032e-7},
}
_WAVE = {"c": 0.8246, "r": 0.0206, "s": 0.4380}
HALF_BASE = 0.75
"""Half the distance of the rails to which a cross level refers (m)."""
_FADE = 30.0
_LONGEST_WAVES = 32
"""Fewest of the longest waves in a period of a realisation."""
_PER_WAVE = 16
"""Fewest points of the synthesis in the shortest wave; the quintic spline through them errs by 1e-7 of it."""


@data.table
class Quality:
    """Track quality, an entry of data/irregularities.toml.

    Standard deviations (mm) of longitudinal level and alignment of one rail at wavelengths from 3 to 25 m, and the
    confidence in both numbers, from "VV" (reproduced) to "A" (assumed).
    """

    level_mm: Annotated[Number, above(0.05, 20.0, "mm")]
    alignment_mm: Annotated[Number, above(0.05, 20.0, "mm")]
    confidence: Literal["VV", "V", "D", "R", "A"]


def irregularity_spectrum(spectrum: str, channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """One-sided power spectral density of an irregularity channel, in the shape of `wavenumber`.

    The gauge has the shape of the cross level with an amplitude of its own; its numbers are recalled from the German
    high-speed spectra that share all other numbers with ERRI B176 (confidence R).

    Parameters
    ----------
    spectrum : str
        "erri_low", "erri_high", or an entry of data/irregularities.toml such as "en_B_300": the shapes of "erri_low",
        level and cross level scaled together, alignment and gauge scaled together, so that each rail has the entry's
        standard deviation at wavelengths of 3 to 25 m.
    channel : str
        "lateral", "vertical", "gauge" (m^2/(rad/m)) or "crosslevel" (rad^2/(rad/m)).
    wavenumber : ndarray
        Angular wavenumber (rad/m).

    Source: ERRI B176.
    """
    if channel not in tuple(CHANNELS):
        raise InputError(f"channel {channel!r} is not known; there are {list(CHANNELS)}")
    amplitude = _amplitudes(spectrum)
    w2, c2, r2, s2 = wavenumber**2, *(_WAVE[k] ** 2 for k in "crs")
    shape = c2 / ((w2 + r2) * (w2 + c2))
    if channel == "crosslevel":
        return amplitude["vertical"] / HALF_BASE**2 * shape * w2 / (w2 + s2)
    if channel == "gauge":
        return amplitude["gauge"] * shape * w2 / (w2 + s2)
    return amplitude[channel] * shape


def _amplitudes(spectrum: str) -> dict[str, float]:
    """Amplitudes of lateral, vertical and gauge (m rad)."""
    if spectrum in tuple(_ERRI):
        return _ERRI[spectrum]
    classes = track_quality()
    if spectrum not in tuple(classes):
        raise InputError(f"spectrum {spectrum!r} is not known; there are {sorted(_ERRI)} and {sorted(classes)}")
    level, alignment = classes[spectrum]
    low = _ERRI["erri_low"]
    wavenumber = np.linspace(2 * np.pi / D1[1], 2 * np.pi / D1[0], 2000)
    density = {channel: irregularity_spectrum("erri_low", channel, wavenumber) for channel in CHANNELS}
    rails = density["vertical"] + HALF_BASE**2 * density["crosslevel"], density["lateral"] + density["gauge"] / 4
    upwards, across = (
        wanted / float(np.sqrt(np.trapezoid(has, wavenumber)))
        for wanted, has in zip((level, alignment), rails, strict=True)
    )
    return {
        "lateral": low["lateral"] * across**2,
        "vertical": low["vertical"] * upwards**2,
        "gauge": low["gauge"] * across**2,
    }


def track_quality() -> dict[str, tuple[float, float]]:
    """Name in data/irregularities.toml -> standard deviations of a rail's level and alignment (m), 3 to 25 m waves."""
    file = paths.source("data/irregularities.toml")
    content = data.build(dict[str, Quality], data.read(file), file.name)
    return {name: (entry.level_mm * 1e-3, entry.alignment_mm * 1e-3) for name, entry in content.items()}


def irregularities(p: np.ndarray, spectrum: str = "erri_low", seed: int = 1) -> pd.DataFrame:
    """Random realisation of track irregularities, to be superposed on a route.

    A sum of cosines with random phases at multiples of the frequency 1 / period. The period is the least power of two
    (m) that covers the track and 32 of the longest waves (100 m): 4096 m for all tracks up to this length, which thus
    have the same rails at the same p, but for the fade at their ends.

    Parameters
    ----------
    p : ndarray, shape (n,)
        Track coordinates (m), increasing by steps of up to 1.5 m, half the shortest wave.
    spectrum : str
        See `irregularity_spectrum`.
    seed : int
        Seed of the random phases; each channel has a generator of its own.

    Returns
    -------
    DataFrame
        Columns p_m, lateral_m (right positive), vertical_m (down positive), crosslevel_rad (right rail down positive),
        gauge_m (wider positive); faded in and out smoothly over 30 m.

    Source: Shinozuka and Deodatis 1991, Applied Mechanics Reviews 44, 191 (spectral representation by FFT).
    """
    p = _coordinates(p, BAND[0] / 2)
    columns = {"p_m": p}
    for i, (channel, column) in enumerate(CHANNELS.items()):
        generator = np.random.default_rng((seed, i))
        columns[column] = _realisation(p, spectrum, channel, generator)
    return faded(pd.DataFrame(columns))


def _realisation(p, spectrum: str, channel: str, generator) -> np.ndarray:
    """One channel at p, shape (n,): inverse FFT over a period, between its points a spline."""
    shortest, longest = BAND
    period = 2.0 ** math.ceil(math.log2(max(p[-1] - p[0], _LONGEST_WAVES * longest)))
    step = 2.0 ** math.floor(math.log2(shortest / _PER_WAVE))
    low, high = period / longest, period / shortest
    wave = np.arange(round(low), round(high) + 1)
    # Waves at the ends of the band stand for the part of their interval that lies inside it.
    width = (np.clip(wave + 0.5, low, high) - np.clip(wave - 0.5, low, high)) / period
    density = 2 * np.pi * irregularity_spectrum(spectrum, channel, 2 * np.pi * wave / period)
    coefficients = np.zeros(int(period / step) // 2 + 1, dtype=complex)
    phase = generator.uniform(0, 2 * np.pi, wave.size)
    coefficients[wave] = np.sqrt(2 * density * width) * np.exp(1j * phase) / 2
    values = np.fft.irfft(coefficients, norm="forward")
    return scipy.ndimage.map_coordinates(values, [p / step], order=5, mode="grid-wrap")


def check(frame: pd.DataFrame) -> None:
    """Raise InputError unless a frame has increasing p_m and all columns of `CHANNELS`, finite and within range.

    Ranges: lateral_m +-0.02 m, gauge_m -0.01 to 0.035 m, vertical_m +-0.1 m, crosslevel_rad +-0.1 rad.
    """
    require("irregularities", frame, pd.DataFrame)
    missing = sorted({"p_m", *CHANNELS.values()} - set(frame))
    if missing:
        raise InputError(f"irregularities lack the column {missing[0]}, needed are p_m and {list(CHANNELS.values())}")
    p = _coordinates(frame["p_m"], math.inf)
    for column in CHANNELS.values():
        low, high = FLANGEWAY.get(column, (-LARGEST, LARGEST))
        values = pd.to_numeric(frame[column], errors="coerce").astype(float)
        inside = values.between(low, high).to_numpy()
        if not inside.all():
            row = int(np.argmin(inside))
            found = f"{column} = {values.iloc[row]:g} at p = {p[row]:g} m"
            raise InputError(f"irregularities: {found}, {low:g} to {high:g} is allowed (unit?)")


def _coordinates(p, longest: float) -> np.ndarray:
    """Track coordinates as an array, shape (n,); InputError when they do not increase by steps up to `longest` (m)."""
    try:
        found = np.asarray(p, dtype=float)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    steps = np.diff(found) if found.ndim == 1 else np.empty(0)
    if steps.size == 0 or not ((steps > 0) & (steps <= longest) & (steps < math.inf)).all():
        needed = "a list of two or more finite track coordinates (m) that increase"
        raise InputError(f"irregularities: p is {reprlib.repr(p)}, {needed} by up to {longest:g} m is needed")
    return found


def smooth_step(r: np.ndarray) -> np.ndarray:
    """Smooth step from 0 (r <= 0) to 1 (r >= 1), first and second derivative zero at both ends; shape of r (-)."""
    r = np.clip(r, 0, 1)
    return r**3 * (10 - 15 * r + 6 * r**2)


def faded(frame: pd.DataFrame) -> pd.DataFrame:
    """Copy of a frame of irregularities that rises from zero over its first 30 m and returns to zero over its last."""
    p = frame["p_m"].to_numpy()
    fade = smooth_step(np.minimum(p - p[0], p[-1] - p) / _FADE)
    return frame.assign(**{column: fade * frame[column] for column in frame.columns.drop("p_m")})
