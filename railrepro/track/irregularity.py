"""Track irregularities: spectra, random realisations, and the check of frames of irregularities. The columns of a frame
are p_m and those of `CHANNELS`: alignment of the track centre, longitudinal level, cross level, gauge."""

import math
import reprlib
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import scipy

from railrepro import data, paths

CHANNELS = {"lateral": "lateral_m", "vertical": "vertical_m", "crosslevel": "crosslevel_rad", "gauge": "gauge_m"}
"""Channel -> column of a frame, in the order of their random generators."""
LARGEST = 0.1  # largest magnitude in any channel (m, rad); beyond it the unit is wrong
_RANGES = dict.fromkeys(CHANNELS.values(), (-LARGEST, LARGEST))  # permitted values (m, rad)
_RANGES |= {"lateral_m": (-0.02, 0.02), "gauge_m": (-0.01, 0.035)}  # so that wheels stay between the rails
SHORTEST, LONGEST = 3.0, 100.0  # wavelengths of random irregularities (m)
D1 = 3.0, 25.0  # wavelengths at which EN 13848-1 assesses level and alignment (m)
_ERRI = {  # amplitudes (m rad)
    "erri_low": {"lateral": 2.119e-7, "vertical": 4.032e-7, "gauge": 5.32e-8},
    "erri_high": {"lateral": 6.125e-7, "vertical": 10.80e-7, "gauge": 1.032e-7},
}
_C, _R, _S = 0.8246, 0.0206, 0.4380  # corner wavenumbers (rad/m)
HALF_BASE = 0.75  # half the distance between the rails, to which a cross level refers (m)
SEED = data.between(0, 2**63)


@data.table
class Quality:
    """Track quality, an entry of data/irregularities.toml: standard deviations (mm) of longitudinal level and alignment
    of one rail at wavelengths of 3 to 25 m. `confidence` says where the numbers come from: VV read in the source and
    reproduced, V read, D derived, R recalled, A assumed."""

    level_mm: Annotated[data.Number, data.above(0.05, 20.0, "mm")]
    alignment_mm: Annotated[data.Number, data.above(0.05, 20.0, "mm")]
    confidence: Literal["VV", "V", "D", "R", "A"]


def irregularity_spectrum(spectrum: str, channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """One-sided power spectral density of a channel, in the shape of `wavenumber`. InputError for an unknown spectrum
    or channel. The gauge spectrum has the form of the cross-level spectrum; its amplitude is recalled from German
    high-speed spectra. Source: ERRI B176.

    `spectrum` is "erri_low", "erri_high", or an entry of data/irregularities.toml such as "en_B_300". An entry scales
    "erri_low" to its standard deviations: "vertical" and "crosslevel" by one factor, "lateral" and "gauge" by another.
    `channel` is "lateral", "vertical", "gauge" (m^2/(rad/m)) or "crosslevel" (rad^2/(rad/m)); `wavenumber` is angular
    (rad/m).
    """
    if channel not in CHANNELS:
        raise data.InputError(f"channel {channel!r} is not known; there are {[*CHANNELS]}")
    return _density(_amplitudes(spectrum), channel, wavenumber)


def _density(amplitude: dict[str, float], channel: str, wavenumber: np.ndarray) -> np.ndarray:
    """`irregularity_spectrum` of a channel with the amplitudes from `_amplitudes`."""
    w2, c2, r2, s2 = wavenumber**2, _C**2, _R**2, _S**2
    shape = c2 / ((w2 + r2) * (w2 + c2))
    if channel == "crosslevel":
        return amplitude["vertical"] / HALF_BASE**2 * shape * w2 / (w2 + s2)
    if channel == "gauge":
        return amplitude["gauge"] * shape * w2 / (w2 + s2)
    return amplitude[channel] * shape


def _amplitudes(spectrum: str) -> dict[str, float]:
    """Amplitudes of the channels lateral, vertical and gauge in a spectrum (m rad)."""
    classes = track_quality()
    if spectrum in tuple(_ERRI):
        return _ERRI[spectrum]
    if spectrum not in tuple(classes):
        raise data.InputError(f"spectrum {spectrum!r} is not known; there are {sorted(_ERRI)} and {sorted(classes)}")
    wanted, low = classes[spectrum], _ERRI["erri_low"]
    wavenumber = np.linspace(2 * np.pi / D1[1], 2 * np.pi / D1[0], 2000)
    density = {channel: _density(low, channel, wavenumber) for channel in CHANNELS}
    level = np.trapezoid(density["vertical"] + HALF_BASE**2 * density["crosslevel"], wavenumber)
    alignment = np.trapezoid(density["lateral"] + density["gauge"] / 4, wavenumber)
    upwards, across = wanted.level_mm * 1e-3 / np.sqrt(level), wanted.alignment_mm * 1e-3 / np.sqrt(alignment)
    factors = {"lateral": across, "vertical": upwards, "gauge": across}
    return {channel: low[channel] * float(factor) ** 2 for channel, factor in factors.items()}


def track_quality() -> dict[str, Quality]:
    """Read data/irregularities.toml as a dict: class of track, such as "en_B_300" -> `Quality`, its standard
    deviations. InputError for a wrong entry or one with the name of a built-in spectrum."""
    file = paths.source("data/irregularities.toml")
    classes = data.build(dict[str, Quality], data.read(file), file.name)
    for name in _ERRI.keys() & classes.keys():
        raise data.InputError(f"{file.name}: {name} is a built-in spectrum, another name is needed")
    return classes


def irregularities(p: np.ndarray, spectrum: str = "erri_low", seed: int = 1) -> pd.DataFrame:
    """Make random irregularities for `railrepro.track.route.lay`: a frame with the columns p_m, lateral_m (right
    positive), vertical_m (down positive), crosslevel_rad (right rail down positive) and gauge_m (wider positive).

    They are a sum of cosines with random phases and wavelengths of 3 to 100 m, faded in and out over 30 m at the ends.
    The sum repeats after 4096 m, on a longer track after the next power of two. So all tracks up to 4096 m have, but
    for the fading, the same irregularities at the same p. Source: Shinozuka and Deodatis 1991, Applied Mechanics
    Reviews 44, 191. The track coordinates p (m), shape (n,), increase by steps of up to 1.5 m. `spectrum` is as in
    `irregularity_spectrum`; `seed`, 0 to 2^63, draws the phases.
    """
    data.require("irregularities: seed", seed, SEED, whole=True)
    p = coordinates("irregularities", p, SHORTEST / 2)
    period = 2.0 ** math.ceil(math.log2(max(p[-1] - p[0], 32 * LONGEST)))
    # A quintic spline through at least sixteen points per wave has an error of 1e-7 of its amplitude.
    step = 2.0 ** math.floor(math.log2(SHORTEST / 16))
    low, high = period / LONGEST, period / SHORTEST
    wave = np.arange(round(low), round(high) + 1)
    # The first and last wave represent only the part of their interval inside the band.
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
    """Raise InputError unless a frame of irregularities has an increasing p_m and, within these ranges, lateral_m
    (+-0.02), gauge_m (-0.01 to 0.035), vertical_m (+-0.1 m), crosslevel_rad (+-0.1 rad)."""
    data.require("irregularities", frame, pd.DataFrame)
    for column in sorted({"p_m", *CHANNELS.values()} - set(frame)):
        raise data.InputError(f"irregularities lack the column {column}, needed are p_m and {[*CHANNELS.values()]}")
    if not frame.columns.is_unique:
        raise data.InputError(f"irregularities have the column {frame.columns[frame.columns.duplicated()][0]!r} twice")
    p = coordinates("irregularities", frame["p_m"])
    numbers = frame[[*_RANGES]].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    require_within("irregularities", p, dict(zip(_RANGES, numbers.T, strict=True)), _RANGES)


def require_within(what: str, p: np.ndarray, columns: dict[str, np.ndarray], ranges: dict[str, tuple]) -> None:
    """Raise InputError, which names the caller `what`, unless the columns in `ranges` (name -> least, largest value)
    are within their ranges at all track coordinates p (m)."""
    for name, (low, high) in ranges.items():
        for row in np.flatnonzero(~((columns[name] >= low) & (columns[name] <= high)))[:1]:
            found = f"{name} at p = {p[row]} m is {columns[name][row]}"
            raise data.InputError(f"{what}: {found}, a number from {low:g} to {high:g} is needed (unit?)")


def coordinates(what: str, p: Any, longest: float = math.inf) -> np.ndarray:
    """Convert track coordinates to an array, shape (n,). InputError, which names the caller `what`, unless these are at
    least two finite numbers that increase by steps of at most `longest` (m)."""
    try:
        found = np.asarray(p, dtype=float)
    except (TypeError, ValueError):
        found = np.empty(0)
    steps = np.diff(found) if found.ndim == 1 else np.empty(0)
    if steps.size == 0 or not ((steps > 0) & (steps <= longest) & (steps < math.inf)).all():
        steps_allowed = f" by up to {longest:g} m" if longest < math.inf else ""
        needed = f"a list of two or more finite track coordinates (m) that increase{steps_allowed} is needed"
        raise data.InputError(f"{what}: p is {reprlib.repr(p)}, {needed}")
    return found


def smooth_step(r: np.ndarray) -> np.ndarray:
    """Smooth step (-) from 0 at r = 0 to 1 at r = 1, constant outside; two derivatives vanish at both ends."""
    r = np.clip(r, 0, 1)
    return r**3 * (10 - 15 * r + 6 * r**2)
