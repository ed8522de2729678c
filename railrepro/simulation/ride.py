"""Ride and safety of a run in the quantities of vehicle acceptance: rail forces, flange contact, wear, comfort.

Functions work on arrays of shape (n,) over a run (SI, forces on the rail): `p` is the track coordinate (m), `rate` the
samples per second (Hz). The source of a number stands with it: *read* in a public document that quotes the standard,
*recalled* from the standard, which was not at hand. Forces are low-passed forwards and backwards, so that peaks keep
their position on the track. Comfort weightings run forwards only, as the standards give one transfer function.
"""

from __future__ import annotations

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
"""Length of a sliding mean and distance of the next one (m). Source: EN 14363 and UIC 518 (read)."""
Y_OVER_Q_LIMIT = 0.8
"""Largest sliding mean of Y/Q (-). Source: EN 14363 (recalled; Nadal's limit for a flange of 70 degrees)."""
COMFORT_BLOCK, BLOCK_STEP = 5.0, 0.5
"""Length of a block of mean comfort and distance of the next one (s). Source: EN 12299 (read)."""
# Transition frequency (Hz), upward step f5 (Hz), Q5, f6 (Hz), Q6, and gain above the step.
WEIGHTINGS = {"Wd": (2.0, None, 1.0), "Wb": (16.0, (2.5, 0.8, 4.0, 0.8), 1.024)}
"""Frequency weightings: Wd of ISO 2631-1, Wb of EN 12299 (ISO 2631-4 and BS 6841 have another curve of that name).
Source: Wd: ISO 8041 (read in the manuals of two vibration meters); Wb: EN 12299:2009 (read in open software, agrees
with what is recalled of UIC 513)."""
_BAND = (0.4, 100.0)
_LEAST_LOAD = 1e3
"""Divisor of Y/Q where Q is smaller (N), so that a wheel that lifts gives no infinity."""
_OUTWARDS = {"le": -1, "ri": 1}
"""Sign of a force to the right that pushes the rail of a side outwards."""


def ride_summary(series: pd.DataFrame, vehicle: Vehicle) -> dict[str, tuple[float, str]]:
    """Figures of ride and safety of a run as a dict: name -> (value, unit). InputError if a column is missing.

    - sum_y_over_limit (-): largest track shifting force of a gear over Prud'homme's limit.
    - y_over_q (-): largest mean of Y/Q over 2 m, of all wheels. A run shorter than 2 m raises InputError.
    - wheel_unloading (-): largest loss of wheel load over the load at rest, dQ/Q0, of all wheels.
    - flange_contacts (1/km): sum over the wheels.
    - t_gamma, creep_work (N): see the function `creep_work`.
    - n_mv_floor_front, n_mv_floor_centre, n_mv_floor_rear (-): `mean_comfort` at each point of `FLOOR`.

    Args:
        series (DataFrame): `simulate.Run.series`, of which these columns are read: t_s; p and phi of both gears; N, Fx,
            Fy, nu_x, nu_y, M_spin, spin, angle of each wheel; ax, ay, az of each point of `FLOOR`. Columns have names
            such as `front.p`, `front_le.N`, `floor_centre.az`.
        vehicle (Vehicle): The simulated car (`plant_vehicle` of the run).
    """
    t = series["t_s"].to_numpy()
    rate = (t.size - 1) / (t[-1] - t[0])
    found = _force_figures(series, vehicle.wheel_load, rate)
    found |= {name: (work, "N") for name, work in creep_work(series).items()}
    for point in FLOOR:
        of_point = Part(series, point)
        found[f"n_mv_{point}"] = mean_comfort(of_point.ax, of_point.ay, of_point.az, rate), "-"
    return found


def _force_figures(series: pd.DataFrame, wheel_load: float, rate: float) -> dict[str, tuple[float, str]]:
    """Largest rail forces of a run, and flange contacts. Y/Q is the quotient of both low-passed forces, then its means
    over 2 m; Prud'homme's limit is 10 kN + 2 Q0 / 3. Source: EN 14363 and UIC 518 (read; Prud'homme's limit
    recalled)."""
    shifting, ratios, unloading, contacts = [], [], [], 0.0
    for gear in GEARS:
        p, phi, lateral = Part(series, gear).p, Part(series, gear).phi, []
        for side in SIDES:
            wheel = Part(series, f"{gear}_{side}")
            y, q = rail_forces(wheel.N, wheel.Fy, wheel.angle, side, phi)
            low = low_pass(q, rate)
            outwards = low_pass(_OUTWARDS[side] * y, rate)
            ratios.append(sliding_mean(outwards / np.maximum(low, _LEAST_LOAD), p).max())
            unloading.append((1 - low / wheel_load).max())  # dQ/Q0, filtered as EN 14363 has it (read)
            contacts += flange_contacts(wheel.angle, p)
            lateral.append(y)
        # EN 14363 and UIC 518 evaluate percentiles over many sections; of one short run the largest value is taken
        shifting.append(np.abs(sliding_mean(low_pass(sum(lateral), rate), p)).max() / 1e3)
    limit = (10e3 + 2 * wheel_load / 3) / 1e3
    return {
        "sum_y_over_limit": (float(max(shifting)) / limit, "-"),
        "y_over_q": (float(max(ratios)), "-"),
        "wheel_unloading": (float(max(unloading)), "-"),
        "flange_contacts": (contacts, "1/km"),
    }


def rail_forces(normal, creep, angle, side: str, roll=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Lateral force Y and vertical force Q of a wheel on its rail (N), in axes of the track.

    Args:
        normal (array_like, shape (n,)): Normal force (N), output `N` of the car.
        creep (array_like, shape (n,)): Lateral creep force on the wheel, positive to the right (N), output `Fy`.
        angle (array_like, shape (n,)): Contact angle against the axle, positive towards the flange (rad).
        side (str): "le" or "ri".
        roll (array_like, optional): Roll of the axle against the track (rad). With 0 the forces are in axes of the
            axle; 1 mrad changes the sum of Y of a gear that carries 16 t by 0.16 kN.

    Returns:
        y, q (ndarray, shape (n,)): Y, positive to the right on both rails, and Q, positive downwards (N).
    """
    tilt = _OUTWARDS[side] * np.asarray(angle, dtype=float) - roll
    y = np.multiply(normal, np.sin(tilt)) - np.multiply(creep, np.cos(tilt))
    q = np.multiply(normal, np.cos(tilt)) + np.multiply(creep, np.sin(tilt))
    return y, q


def low_pass(values, rate: float) -> np.ndarray:
    """Low-pass without phase shift. `rate` is the sampling rate (Hz); shape (n,) and unit stay.

    Butterworth of second order, forwards and backwards: in all -3 dB at 20 Hz, with 24 dB per octave beyond. Source: EN
    14363 (cut-off read, slope of 24 dB per octave recalled).
    """
    single = FORCE_CUTOFF / (np.sqrt(2) - 1) ** 0.25
    return scipy.signal.sosfiltfilt(scipy.signal.butter(2, single, fs=rate, output="sos"), values)


def sliding_mean(values, p) -> np.ndarray:
    """Means over windows of the track coordinate, shape (windows,). A window is 2 m long and starts every 0.5 m.
    `values` and the track coordinate `p` (m) have the shape (n,). InputError if the run is shorter than 2 m."""
    p = np.maximum.accumulate(np.asarray(p, dtype=float))  # a car that has come to a stand rolls back a little
    room = p[-1] - p[0] - WINDOW
    if room < 0:
        raise InputError(f"a sliding mean over {WINDOW:g} m needs a longer run than the {p[-1] - p[0]:.3g} m found")
    starts = p[0] + WINDOW_STEP * np.arange(int(room / WINDOW_STEP + 1e-9) + 1)
    total = scipy.integrate.cumulative_trapezoid(values, p, initial=0)
    return (np.interp(starts + WINDOW, p, total) - np.interp(starts, p, total)) / WINDOW


def flange_contacts(angle, p) -> float:
    """Number of flange contacts of a wheel per distance (1/km): stretches with a contact angle above 30 degrees.

    `angle` (rad) and track coordinate `p` (m) have the shape (n,). Stretches less than 1 m apart count as one contact.
    """
    p = np.asarray(p, dtype=float)
    edges = np.diff((np.abs(angle) > FLANGE_ANGLE).astype(int), prepend=0, append=0)
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    separate = np.count_nonzero(p[starts[1:]] - p[ends[:-1]] >= 1.0)
    return float(1e3 * (separate + (starts.size > 0)) / (p[-1] - p[0]))


def creep_work(series: pd.DataFrame) -> dict[str, float]:
    """Energy lost to creep per metre (N, that is J/m), mean over the distance and the four wheels, as a dict.

    Key "t_gamma" is the wear number, without spin. Key "creep_work" includes the spin moment, which does a good part of
    the work where the contact is inclined, as on S1002. `series` is as in `ride_summary`. Source: Elkins and Eickhoff
    1982 (recalled).
    """
    lost: dict[str, list[float]] = {"t_gamma": [], "creep_work": []}
    for name, (gear, _) in GEAR_AND_SIDE.items():
        wheel, lengths = Part(series, name), np.gradient(Part(series, gear).p)
        slid = wheel.Fx * wheel.nu_x + wheel.Fy * wheel.nu_y
        lost["t_gamma"].append(float(np.average(-slid, weights=lengths)))
        lost["creep_work"].append(float(np.average(-(slid + wheel.M_spin * wheel.spin), weights=lengths)))
    return {name: float(np.mean(values)) for name, values in lost.items()}


def weighting_filter(name: str, rate: float) -> np.ndarray:
    """Digital filter of the frequency weighting "Wd" or "Wb" at a sampling `rate` (Hz), as second-order sections.

    The result is an array for `scipy.signal.sosfilt`: shape (3, 6) for "Wd"; (4, 6) for "Wb", which also has an upward
    step. Band limits of 0.4 and 100 Hz (Butterworth, second order), transition from acceleration to velocity, and
    upward step go through the bilinear transform without pre-warping. At 1 kHz the weights are within 0.2 % of the
    analogue ones up to 20 Hz and within 4 % up to 80 Hz. Source: ISO 2631-1, annex A (read in the manual of a vibration
    meter).
    """
    transition, step, gain = WEIGHTINGS[name]
    low, high = (_quadratic(f, 1 / np.sqrt(2)) for f in _BAND)
    factors: list[tuple] = [([low[0], 0, 0], low), ([1], high)]
    factors.append(([gain / (2 * np.pi * transition), gain], _quadratic(transition, 0.63)))
    if step is not None:
        f5, q5, f6, q6 = step
        factors.append(((f5 / f6) ** 2 * _quadratic(f5, q5), _quadratic(f6, q6)))
    return np.array([np.concatenate(scipy.signal.bilinear(*factor, fs=rate)) for factor in factors])


def _quadratic(frequency: float, quality: float) -> np.ndarray:
    """Coefficients of (s/w)^2 + s/(Q w) + 1."""
    w = 2 * np.pi * frequency
    return np.array([1 / w**2, 1 / (quality * w), 1.0])


def mean_comfort(along, across, vertical, rate: float) -> float:
    """Mean comfort N_MV at a floor point (-); nan for a run shorter than 5 s.

    Below 1.5 is very comfortable, 1.5 to 2.5 comfortable, from 4.5 on very uncomfortable. Each acceleration is weighted
    (Wd, Wd, Wb). Root mean squares are taken over blocks of 5 s, which start every 0.5 s. The 95th percentile of these
    values is a number per direction. N_MV is 6 times the root of the sum of its three squares. The standard asks for 60
    blocks (5 minutes): with fewer, compare controllers only. Source: EN 12299:2009, mean comfort, standard method
    (formula read in open software; scale recalled).

    Args:
        along, across, vertical (array_like, shape (n,)): Accelerations in the three directions (m/s2).
        rate (float): Sampling rate (Hz).
    """
    directions = ((along, "Wd"), (across, "Wd"), (vertical, "Wb"))
    blocks = [_block_rms(np.asarray(values, dtype=float), name, rate) for values, name in directions]
    return float(6 * np.linalg.norm(np.percentile(blocks, 95, axis=1))) if blocks[0].size else float("nan")


def _block_rms(values: np.ndarray, name: str, rate: float) -> np.ndarray:
    """Root mean squares of a weighted acceleration over blocks of 5 s, shape (blocks,), empty below 5 s. The filter
    starts settled at the first sample, so that gravity or steady cant deficiency makes no transient."""
    sections = weighting_filter(name, rate)
    weighted, _ = scipy.signal.sosfilt(sections, values, zi=scipy.signal.sosfilt_zi(sections) * values[0])
    block, step = round(COMFORT_BLOCK * rate), round(BLOCK_STEP * rate)
    total = np.concatenate([[0.0], np.cumsum(np.square(weighted))])
    starts = np.arange(0, len(weighted) - block + 1, step)
    return np.sqrt((total[starts + block] - total[starts]) / block)
