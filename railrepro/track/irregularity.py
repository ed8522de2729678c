"""Track irregularities: spectra, random realisations, the rails of a track centre.

A frame of irregularities has the coordinate p_m and four channels of the track centre, signs as in the car: alignment
(`lateral_m`, right positive), longitudinal level (`vertical_m`, down positive), cross level as an angle
(`crosslevel_rad`, right rail down positive) and gauge (`gauge_m`, wider than nominal positive).
"""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import scipy

from railrepro import data, paths
from railrepro.data import InputError, Number, above, between, require

CHANNELS = {"lateral": "lateral_m", "vertical": "vertical_m", "crosslevel": "crosslevel_rad", "gauge": "gauge_m"}
"""Channels in the order of their random generators, with their columns."""
LARGEST = 0.1
"""Largest number of any channel; beyond it the unit is wrong."""
_RANGES = {column: (-LARGEST, LARGEST) for column in CHANNELS.values()}
_RANGES |= {"lateral_m": (-0.02, 0.02), "gauge_m": (-0.01, 0.035)}
"""What is allowed in a frame, of lateral position and gauge what the flangeway takes (m)."""
SHORTEST, LONGEST = 3.0, 100.0
"""Wavelengths of random irregularities (m)."""
D1 = 3.0, 25.0
"""Wavelengths (m) in which EN 13848-1 judges level and alignment."""

_ERRI = {
    "erri_low": {"lateral": 2.119e-7, "vertical": 4.032e-7, "gauge": 5.32e-8},
    "erri_high": {"lateral": 6.125e-7, "vertical": 10.80e-7, "gauge": 1.032e-7},
}
"""Amplitudes (m rad)."""
_C, _R, _S = 0.8246, 0.0206, 0.4380
"""Corner wavenumbers (rad/m)."""
HALF_BASE = 0.75
"""Half the distance of the rails to which a cross level refers (m)."""
SEED = between(0, 2**63)
"""Seeds of random irregularities."""


@data.table
class Quality:
    """Track quality, an entry of data/irregularities.toml.

    Attributes:
        level_mm, alignment_mm (float): Standard deviation of longitudinal level and of alignment of one rail at
            wavelengths of 3 to 25 m (mm).
        confidence (str): Trust in both numbers: VV reproduced, V read, D derived, R recalled, A assumed.
    """

    level_mm: Annotated[Number, above(0.05, 20.0, "mm")]
    alignment_mm: Annotated[Number, above(0.05, 20.0, "mm")]
    confidence: Literal["VV", "V", "D", "R", "A"]


def irregularity_spectrum(spectrum: str, channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """One-sided power spectral density of one channel of irregularities, in the shape of `wavenumber`. InputError for
    an unknown spectrum or channel.

    The gauge spectrum has the form of the cross-level spectrum. Its amplitude is recalled from German high-speed
    spectra (confidence R). Source: ERRI B176.

    Args:
        spectrum (str): "erri_low", "erri_high", or an entry of data/irregularities.toml such as "en_B_300". An entry
            scales "erri_low" to the standard deviations of its `Quality`: "vertical" and "crosslevel" by one factor,
            "lateral" and "gauge" by another.
        channel (str): "lateral", "vertical", "gauge" (m^2/(rad/m)) or "crosslevel" (rad^2/(rad/m)).
        wavenumber (ndarray): Angular wavenumber (rad/m).
    """
    if channel not in CHANNELS:
        raise InputError(f"channel {channel!r} is not known; there are {[*CHANNELS]}")
    return _density(_amplitudes(spectrum), channel, wavenumber)


def _density(amplitude: dict[str, float], channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """Spectrum of a channel, see `irregularity_spectrum`."""
    w2, c2, r2, s2 = wavenumber**2, _C**2, _R**2, _S**2
    shape = c2 / ((w2 + r2) * (w2 + c2))
    if channel == "crosslevel":
        return amplitude["vertical"] / HALF_BASE**2 * shape * w2 / (w2 + s2)
    if channel == "gauge":
        return amplitude["gauge"] * shape * w2 / (w2 + s2)
    return amplitude[channel] * shape


def _amplitudes(spectrum: str) -> dict[str, float]:
    """Amplitudes of lateral, vertical and gauge (m rad)."""
    classes = track_quality()
    if spectrum in tuple(_ERRI):
        return _ERRI[spectrum]
    if spectrum not in tuple(classes):
        raise InputError(f"spectrum {spectrum!r} is not known; there are {sorted(_ERRI)} and {sorted(classes)}")
    wanted, low = classes[spectrum], _ERRI["erri_low"]
    wavenumber = np.linspace(2 * np.pi / D1[1], 2 * np.pi / D1[0], 2000)
    density = {channel: _density(low, channel, wavenumber) for channel in CHANNELS}
    level = np.trapezoid(density["vertical"] + HALF_BASE**2 * density["crosslevel"], wavenumber)
    alignment = np.trapezoid(density["lateral"] + density["gauge"] / 4, wavenumber)
    upwards, across = wanted.level_mm * 1e-3 / np.sqrt(level), wanted.alignment_mm * 1e-3 / np.sqrt(alignment)
    factors = {"lateral": across, "vertical": upwards, "gauge": across}
    return {channel: low[channel] * float(factor) ** 2 for channel, factor in factors.items()}


def track_quality() -> dict[str, Quality]:
    """The `Quality` entries of data/irregularities.toml, as a dict by name. InputError for a wrong entry, and for one
    with the name of a built-in spectrum."""
    file = paths.source("data/irregularities.toml")
    classes = data.build(dict[str, Quality], data.read(file), file.name)
    for name in _ERRI:
        if name in classes:
            raise InputError(f"{file.name}: {name} is a built-in spectrum, another name is needed")
    return classes


def irregularities(p: np.ndarray, spectrum: str = "erri_low", seed: int = 1) -> pd.DataFrame:
    """Random irregularities of the rails as a frame for `railrepro.track.route.lay`.

    They are a sum of cosines with random phases and wavelengths of 3 to 100 m, faded in and out over 30 m at the ends.
    The sum repeats after 4096 m (a longer track: the next power of two), so shorter tracks have the same rails at the
    same p. Source: Shinozuka and Deodatis 1991, Applied Mechanics Reviews 44, 191 (spectral representation by FFT).

    Args:
        p (ndarray, shape (n,)): Track coordinates (m), increasing by steps of up to 1.5 m.
        spectrum (str): See `irregularity_spectrum`.
        seed (int): Seed of the random phases, from 0 up to 2^63. Each channel has its own generator.

    Returns:
        DataFrame: Columns p_m, lateral_m (right positive), vertical_m (down positive), crosslevel_rad (right rail down
            positive), gauge_m (wider positive).
    """
    require("irregularities: seed", seed, SEED, whole=True)
    p = coordinates("irregularities", p, SHORTEST / 2)
    period = 2.0 ** math.ceil(math.log2(max(p[-1] - p[0], 32 * LONGEST)))
    # The quintic spline through sixteen points or more in the shortest wave errs by 1e-7 of it.
    step = 2.0 ** math.floor(math.log2(SHORTEST / 16))
    low, high = period / LONGEST, period / SHORTEST
    wave = np.arange(round(low), round(high) + 1)
    # Waves at the ends of the band stand for the part of their interval that lies inside it.
    width = (np.clip(wave + 0.5, low, high) - np.clip(wave - 0.5, low, high)) / period
    fade, amplitude = smooth_step(np.minimum(p - p[0], p[-1] - p) / 30.0), _amplitudes(spectrum)
    columns = {"p_m": p}
    for i, (channel, column) in enumerate(CHANNELS.items()):
        density = 2 * np.pi * _density(amplitude, channel, 2 * np.pi * wave / period)
        phase = np.random.default_rng((seed, i)).uniform(0, 2 * np.pi, wave.size)
        coefficients = np.zeros(int(period / step) // 2 + 1, dtype=complex)
        coefficients[wave] = np.sqrt(2 * density * width) * np.exp(1j * phase) / 2
        values = np.fft.irfft(coefficients, norm="forward")
        columns[column] = fade * scipy.ndimage.map_coordinates(values, [p / step], order=5, mode="grid-wrap")
    return pd.DataFrame(columns)


def check(frame: pd.DataFrame) -> None:
    """Raise InputError unless a frame of irregularities is valid: columns p_m and those of `CHANNELS`, p_m increasing.

    Permitted are lateral_m of +-0.02 m, gauge_m of -0.01 to 0.035 m, vertical_m of +-0.1 m, crosslevel_rad of +-0.1
    rad.
    """
    require("irregularities", frame, pd.DataFrame)
    missing = sorted({"p_m", *CHANNELS.values()} - set(frame))
    if missing:
        raise InputError(f"irregularities lack the column {missing[0]}, needed are p_m and {list(CHANNELS.values())}")
    if not frame.columns.is_unique:
        raise InputError(f"irregularities have the column {frame.columns[frame.columns.duplicated()][0]!r} twice")
    p = coordinates("irregularities", frame["p_m"])
    for column, (low, high) in _RANGES.items():
        values = pd.to_numeric(frame[column], errors="coerce").astype(float)
        inside = values.between(low, high).to_numpy()
        if not inside.all():
            row = int(np.argmin(inside))
            found = f"{column} = {values.iloc[row]:g} at p = {p[row]:g} m"
            raise InputError(f"irregularities: {found}, {low:g} to {high:g} is allowed (unit?)")


def coordinates(what: str, p: Any, longest: float = math.inf) -> np.ndarray:
    """Track coordinates as an array, shape (n,). InputError, which begins with `what`, unless they are two or more and
    increase by steps up to `longest` (m)."""
    try:
        found = np.asarray(p, dtype=float)
    except (TypeError, ValueError):
        found = np.empty(0)
    steps = np.diff(found) if found.ndim == 1 else np.empty(0)
    if steps.size == 0 or not ((steps > 0) & (steps <= longest) & (steps < math.inf)).all():
        steps_allowed = f" by up to {longest:g} m" if longest < math.inf else ""
        needed = f"a list of two or more finite track coordinates (m) that increase{steps_allowed} is needed"
        raise InputError(f"{what}: p is {reprlib.repr(p)}, {needed}")
    return found


def smooth_step(r: np.ndarray) -> np.ndarray:
    """Smooth step (-) from 0 (r <= 0) to 1 (r >= 1), in the shape of r; two derivatives are 0 at both ends."""
    r = np.clip(r, 0, 1)
    return r**3 * (10 - 15 * r + 6 * r**2)
