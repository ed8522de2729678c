"""Ride and safety of a run in the quantities of vehicle acceptance: rail forces, flange contact, wear, comfort.
Arguments without another shape are arrays of shape (n,) over a run (SI): `p` is the track coordinate (m). `rate` is the
sampling rate (Hz). The sources say whether a number was *read* in a public document that quotes the standard, or
*recalled* from the standard, which was not at hand. Forces are low-passed forwards and backwards, so that peaks keep
their position on the track. Comfort weightings run forwards only: the standards define one transfer function."""

import numpy as np
import pandas as pd
import scipy

from railrepro.car.equations import FLOOR
from railrepro.data import InputError
from railrepro.quantities import GEAR_AND_SIDE, GEARS, SIDES
from railrepro.simulation.metrics import FLANGE_ANGLE, Part
from railrepro.vehicle.parameters import Vehicle

FORCE_CUTOFF = 20.0
"""Cut-off of rail forces (Hz). Source: EN 14363 and UIC 518 (read)."""
WINDOW, WINDOW_STEP = 2.0, 0.5
"""Length of a sliding mean and step to the next one (m). Source: EN 14363 and UIC 518 (read)."""
Y_OVER_Q_LIMIT = 0.8
"""Largest sliding mean of Y/Q (-). Source: EN 14363 (recalled; Nadal's limit for a flange of 70 degrees)."""
COMFORT_BLOCK, BLOCK_STEP = 5.0, 0.5
"""Length of a block of mean comfort and step to the next one (s). Source: EN 12299 (read)."""
WEIGHTINGS = {"Wd": (2.0, None, 1.0), "Wb": (16.0, (2.5, 0.8, 4.0, 0.8), 1.024)}
"""Frequency weightings: transition frequency (Hz); upward step f5 (Hz), Q5, f6 (Hz), Q6; gain above the step.
Source: Wd: ISO 8041 (read in the manuals of two vibration meters); Wb: EN 12299:2009 (read in open software, agrees
with what is recalled of UIC 513). ISO 2631-4 and BS 6841 have another curve Wb."""
_LEAST_LOAD = 1e3  # Least divisor of Y/Q (N), so that a wheel that lifts gives no infinity
_OUTWARDS = {"le": -1, "ri": 1}  # Sign of a force to the right that pushes the rail of a side outwards


def ride_summary(series: pd.DataFrame, vehicle: Vehicle) -> dict[str, tuple[float, str]]:
    """Compute figures of ride and safety from `simulate.Run.series` and the simulated car: name -> (value, unit).

    - sum_y_over_limit (-): largest track shifting force of a gear over Prud'homme's limit.
    - y_over_q (-): largest mean over 2 m of Y/Q, lateral over vertical force, of all wheels. InputError for a shorter
      run.
    - wheel_unloading (-): largest loss of wheel load over the load at rest, dQ/Q0, of all wheels.
    - flange_contacts (1/km): number of flange contacts per distance, sum over the wheels.
    - t_gamma, creep_work (N): energy lost to creep per metre, mean of the wheels, without and with spin (`creep_work`).
    - n_mv_floor_front, n_mv_floor_centre, n_mv_floor_rear (-): mean comfort N_MV at points of the floor
      (`mean_comfort`).
    """
    t = series["t_s"].to_numpy()
    rate = (t.size - 1) / (t[-1] - t[0])
    figures = _force_figures(series, vehicle.wheel_load, rate)
    figures |= {name: (work, "N") for name, work in creep_work(series).items()}
    for name in FLOOR:
        point = Part(series, name)
        figures[f"n_mv_{name}"] = mean_comfort(point.ax, point.ay, point.az, rate), "-"
    return figures


def _force_figures(series: pd.DataFrame, wheel_load: float, rate: float) -> dict[str, tuple[float, str]]:
    """Compute the largest rail forces, and flange contacts. The standards evaluate percentiles over many sections.
    Prud'homme's limit is 10 kN + 2 Q0 / 3 (recalled). Source: EN 14363 and UIC 518 (read)."""
    shifting, ratios, unloading, contacts = [], [], [], 0.0
    for gear in GEARS:
        p, phi, lateral = Part(series, gear).p, Part(series, gear).phi, []
        for side in SIDES:
            wheel = Part(series, f"{gear}_{side}")
            y, q = rail_forces(wheel.N, wheel.Fy, wheel.angle, side, phi)
            low = low_pass(q, rate)
            outwards = low_pass(_OUTWARDS[side] * y, rate)
            ratios.append(sliding_mean(outwards / np.maximum(low, _LEAST_LOAD), p).max())  # of filtered forces
            unloading.append((1 - low / wheel_load).max())
            contacts += flange_contacts(wheel.angle, p)
            lateral.append(y)
        shifting.append(np.abs(sliding_mean(low_pass(sum(lateral), rate), p)).max() / 1e3)
    limit = (10e3 + 2 * wheel_load / 3) / 1e3
    return {
        "sum_y_over_limit": (float(max(shifting)) / limit, "-"),
        "y_over_q": (float(max(ratios)), "-"),
        "wheel_unloading": (float(max(unloading)), "-"),
        "flange_contacts": (contacts, "1/km"),
    }


def rail_forces(normal, creep, angle, side: str, roll) -> tuple[np.ndarray, np.ndarray]:
    """Compute the forces of a wheel on its rail (N) in axes of the track: Y, to the right, and Q, downwards. `normal`
    is the normal force (N), `creep` the lateral creep force on the wheel, positive to the right (N), `angle` the
    contact angle against the axle, positive towards the flange (rad), `side` "le" or "ri", and `roll` the roll angle of
    the axle against the track (rad)."""
    tilt = _OUTWARDS[side] * np.asarray(angle, dtype=float) - roll
    y = np.multiply(normal, np.sin(tilt)) - np.multiply(creep, np.cos(tilt))
    q = np.multiply(normal, np.cos(tilt)) + np.multiply(creep, np.sin(tilt))
    return y, q


def low_pass(values, rate: float) -> np.ndarray:
    """Filter wheel-rail forces, sampled at `rate` (Hz), without phase shift: by a Butterworth filter of second order,
    forwards and backwards, in all -3 dB at 20 Hz, then 24 dB per octave. Source: EN 14363 (slope recalled)."""
    single = FORCE_CUTOFF / (np.sqrt(2) - 1) ** 0.25
    return scipy.signal.sosfiltfilt(scipy.signal.butter(2, single, fs=rate, output="sos"), values)


def sliding_mean(values, p) -> np.ndarray:
    """Average `values` at positions p (m) in windows of 2 m, one per 0.5 m. InputError if p extends less than 2 m."""
    p = np.maximum.accumulate(np.asarray(p, dtype=float))  # a car that has come to a stand rolls back a little
    last = p[-1] - p[0] - WINDOW
    if last < 0:
        raise InputError(f"a sliding mean over {WINDOW:g} m needs a longer run than the {p[-1] - p[0]:.3g} m found")
    starts = p[0] + WINDOW_STEP * np.arange(int(last / WINDOW_STEP + 1e-9) + 1)
    total = scipy.integrate.cumulative_trapezoid(values, p, initial=0)
    return (np.interp(starts + WINDOW, p, total) - np.interp(starts, p, total)) / WINDOW


def flange_contacts(angle, p) -> float:
    """Count the flange contacts of a wheel per distance (1/km): stretches of positions p (m) with a contact `angle`
    (rad) of more than 30 degrees. Stretches less than 1 m apart count as one contact."""
    p = np.asarray(p, dtype=float)
    edges = np.diff((np.abs(angle) > FLANGE_ANGLE).astype(int), prepend=0, append=0)
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    separate = np.count_nonzero(p[starts[1:]] - p[ends[:-1]] >= 1.0)
    return float(1e3 * (separate + (starts.size > 0)) / (p[-1] - p[0]))


def creep_work(series: pd.DataFrame) -> dict[str, float]:
    """Compute the energy lost to creep per metre (J/m = N), mean over distance and wheels, from creep forces and
    creepages in `simulate.Run.series`. Keys of the dict: "t_gamma", the wear number, without spin; "creep_work" with
    the spin moment, which does much of the work on an inclined contact. Source: Elkins and Eickhoff 1982 (recalled)."""
    lost = []
    for name, (gear, _) in GEAR_AND_SIDE.items():
        wheel, lengths = Part(series, name), np.gradient(Part(series, gear).p)
        slid = wheel.Fx * wheel.nu_x + wheel.Fy * wheel.nu_y
        lost.append([np.average(-work, weights=lengths) for work in (slid, slid + wheel.M_spin * wheel.spin)])
    return dict(zip(("t_gamma", "creep_work"), np.transpose(lost).mean(axis=1).tolist(), strict=True))


def weighting_filter(name: str, rate: float) -> np.ndarray:
    """Design the digital filter of the weighting "Wd" or "Wb" for a sampling rate (Hz), as second-order sections: band
    limits at 0.4 and 100 Hz (Butterworth, second order), the transition from acceleration to velocity and, for "Wb", an
    upward step, by the bilinear transform without pre-warping. At 1 kHz the weights are within 0.2 % of the analogue
    ones up to 20 Hz, and within 4 % up to 80 Hz. Source: form of ISO 2631-1, annex A (read in the manual of a vibration
    meter); the numbers of Wb are those of EN 12299, not of ISO 2631-4."""
    transition, step, gain = WEIGHTINGS[name]
    low, high = (_quadratic(f, 1 / np.sqrt(2)) for f in (0.4, 100.0))
    slope = [gain / (2 * np.pi * transition), gain]
    factors: list[tuple] = [([low[0], 0, 0], low), ([1], high), (slope, _quadratic(transition, 0.63))]
    if step is not None:
        f5, q5, f6, q6 = step
        factors.append(((f5 / f6) ** 2 * _quadratic(f5, q5), _quadratic(f6, q6)))
    return np.array([np.concatenate(scipy.signal.bilinear(*factor, fs=rate)) for factor in factors])


def _quadratic(frequency: float, quality: float) -> np.ndarray:
    """Return the coefficients of (s/w)^2 + s/(Q w) + 1."""
    w = 2 * np.pi * frequency
    return np.array([1 / w**2, 1 / (quality * w), 1.0])


def mean_comfort(along, across, vertical, rate: float) -> float:
    """Compute the mean comfort N_MV at a floor point (-); nan for a run shorter than 5 s. Below 1.5 is very
    comfortable, 1.5 to 2.5 comfortable, from 4.5 on very uncomfortable. The accelerations (m/s2) in the three
    directions are weighted by Wd, Wd and Wb. Root mean squares are taken over blocks of 5 s, which start every 0.5 s.
    N_MV is 6 times the norm of their 95th percentiles in the three directions. The standard asks for 60 blocks (5
    minutes): with fewer, compare controllers only. Source: EN 12299:2009, standard method (formula read in open
    software; scale recalled)."""
    block, step = round(COMFORT_BLOCK * rate), round(BLOCK_STEP * rate)
    starts = np.arange(0, len(vertical) - block + 1, step)
    if not starts.size:
        return float("nan")
    percentiles = []
    for values, name in ((along, "Wd"), (across, "Wd"), (vertical, "Wb")):
        sections = weighting_filter(name, rate)
        settled = scipy.signal.sosfilt_zi(sections) * values[0]  # gravity and cant deficiency make no transient
        weighted, _ = scipy.signal.sosfilt(sections, values, zi=settled)
        total = np.concatenate([[0.0], np.cumsum(np.square(weighted))])
        percentiles.append(np.percentile(np.sqrt((total[starts + block] - total[starts]) / block), 95))
    return float(6 * np.linalg.norm(percentiles))
