"""Figures of merit of a run: tracking error, delay, effort, stopping distance, adhesion utilisation. Serves the paper's
section Multi-Body Simulation Results."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
import scipy

from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.creep import adhesion_maximum
from railrepro.contact.table import middle_patch
from railrepro.data import InputError, require
from railrepro.quantities import GEARS, WHEELS
from railrepro.simulation.scenarios import Scenario
from railrepro.vehicle.parameters import Vehicle

FLANGE_ANGLE = np.radians(30)
"""Contact angle above which a wheel counts as touching with its flange (rad); the tread of S1002 stays far below it."""
FLANGEWAY = 7e-3
"""Displacement of a gear from the middle of the rails above which its flanges count as touching (m); S1002 does at 6 to
8 mm."""
ACTIVITY = 5.0
"""Cut-off frequency of `activity` (Hz). Above it no set point acts: a sweep of 40 m at 400 km/h has 2.8 Hz."""


class Part:
    """Columns of one part of the car in the series of a run, as attributes of shape (n,).

    `Part(series, "front").y_ref` is the column `front.y_ref` of `series` (`simulate.Run.series`). A part is a gear, a
    wheel or a floor point. InputError for a column that is missing or not numeric.
    """

    def __init__(self, series: pd.DataFrame, of: str):
        require("metrics: series", series, pd.DataFrame)
        self._series, self._of = series, of

    def __getattr__(self, name: str) -> np.ndarray:
        series, column = self._series, f"{self._of}.{name}"
        values = series[column].to_numpy() if column in series else np.array([])
        if values.ndim != 1 or not values.size or values.dtype.kind not in "iuf":
            raise InputError(f"metrics: {column!r} is no column of numbers here, the series of a run is needed")
        return values


_OF_GEAR = {
    **{"p": "p_m", "v": "v_mps", "y_ref": "y_ref_m", "y": "y_m", "psi_Ax": "psi_ax_rad", "psi_TrAx": "psi_trax_rad"},
    **{"du": "du_Nm", "u_d": "u_d_Nm", "tau_long": "tau_long_Nm", "f_star": "f_star", "segment": "segment"},
    **{"creep_angle": "creep_rad", "ri.tau": "tau_ri_Nm", "ri.adhesion": "fx_ri", "ri.sx": "sx_ri"},
    **{"le.tau": "tau_le_Nm", "le.adhesion": "fx_le", "le.sx": "sx_le", "error": "error_m"},
}
"""Quantities of `gear_series`, and their names with units in the tables of data/ and figures/."""


def column(gear: str, quantity: str) -> str:
    """Column of a series: "front.y" for the quantity "y" of a gear, "front_ri.tau" for "ri.tau" of its right wheel."""
    part, dot, name = quantity.partition(".")
    return f"{gear}_{part}.{name}" if dot else f"{gear}.{part}"


FILE_COLUMNS = {column("front", quantity): name for quantity, name in _OF_GEAR.items()}
"""Column of a series of the front running gear -> its name, with the unit, in the tables of figures/."""


def gear_series(series: pd.DataFrame, gear: str = "front", stride: int = 1) -> pd.DataFrame:
    """Every `stride`-th row of the series of a run (`simulate.Run.series`) with the quantities of one running gear.

    The columns keep their names. They are t_s (s) and, for the front gear (SI): front.p, front.v along the track;
    front.y and its set point front.y_ref; yaw front.psi_Ax (absolute) and front.psi_TrAx (against the track); torques
    front.du, front.u_d, front.tau_long; adhesion set point front.f_star; front.segment of the adhesion law; torque,
    adhesion and slip of each wheel, as front_ri.tau, front_ri.adhesion, front_ri.sx. Two are added: front.creep_angle
    between heading and motion (rad), and the lateral error front.error = y - y_ref (m).
    """
    rows = series.iloc[::stride]
    creepage = Part(rows, f"{gear}_ri").nu_y + Part(rows, f"{gear}_le").nu_y
    added = {"creep_angle": -creepage / 2, "error": lateral_error(rows, gear)}
    found = {"t_s": rows["t_s"]}
    for quantity in _OF_GEAR:
        name = column(gear, quantity)
        found[name] = added[quantity] if quantity in added else rows[name]
    return pd.DataFrame(found)


def lateral_error(series: pd.DataFrame, gear: str = "front") -> np.ndarray:
    """Lateral error y - y* of a gear in each row of a run (m): displacement from the ideal track minus set point.
    `series` is `simulate.Run.series`, `gear` is "front" or "rear"."""
    return Part(series, gear).y - Part(series, gear).y_ref


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def rmse(series: pd.DataFrame, gear: str = "front") -> float:
    """Root mean square of the `lateral_error` over a run (m). Source: paper, section Evaluation of Lateral Control."""
    return _rms(lateral_error(series, gear))


def followed_rmse(series: pd.DataFrame, gear: str = "front") -> float:
    """Root mean square over a run of the displacement of a gear from the irregular rails minus its set point (m)."""
    return _rms(lateral_error(series, gear) - Part(series, gear).rail_y)


def on_flange(series: pd.DataFrame) -> np.ndarray:
    """Whether a wheel touches its rail with the flange, for each row of a run: bool, shape (n,).

    It counts if the contact angle of any wheel exceeds 30 degrees, or a gear is more than 7 mm from the middle of the
    rails; cones have no flange, so only the second applies to them.
    """
    gears = [Part(series, gear) for gear in GEARS]
    aside = np.max([np.abs(gear.y - gear.rail_y) for gear in gears], axis=0) > FLANGEWAY
    angles = [np.abs(Part(series, wheel).angle) for wheel in WHEELS]
    return aside | (np.array(angles) > FLANGE_ANGLE).any(axis=0)


def reaches_flange(series: pd.DataFrame) -> bool:
    """Whether a wheel touches its rail with the flange in any row of a run, see `on_flange`."""
    return bool(on_flange(series).any())


def delay(series: pd.DataFrame, gear: str = "front") -> float:
    """Distance along the track by which the lateral displacement y of a gear trails its set point y* (m).

    Both signals are detrended by a straight line and put on a grid of 0.1 m. The result is the lag within +-60 m with
    the largest mean product of both, positive when y comes after y*. nan when y* is constant or the car does not move.
    """
    of_gear, step = Part(series, gear), 0.1
    p = of_gear.p
    grid = np.arange(p[0], p[-1], step)
    if grid.size < 2:
        return float("nan")
    y, reference = (_detrended(np.interp(grid, p, values)) for values in (of_gear.y, of_gear.y_ref))
    if np.ptp(reference) < 1e-9:
        return float("nan")
    most = min(600, grid.size // 2)
    lags = np.arange(-most, most + 1)
    products = (
        y[max(lag, 0) : grid.size + min(lag, 0)] * reference[max(-lag, 0) : grid.size - max(lag, 0)]
        for lag in lags.tolist()
    )
    correlation = [product.sum() / product.size for product in products]  # each lag has its own number of samples
    return float(step * lags[np.argmax(correlation)])


def _detrended(values: np.ndarray) -> np.ndarray:
    """Values less their straight line of least squares."""
    abscissa = np.linspace(-1, 1, values.size)
    return values - np.polyval(np.polyfit(abscissa, values, 1), abscissa)


def effort(series: pd.DataFrame, gear: str = "front") -> float:
    """Root mean square of the differential torque of a gear over a run (N m)."""
    return _rms(Part(series, gear).du)


def activity(series: pd.DataFrame, gear: str = "front") -> float:
    """Root mean square of the components above 5 Hz of a gear's differential torque (N m): noise or a limit cycle. The
    high-pass is a Butterworth of fourth order, run forwards and backwards. `series` needs a row per ms."""
    du = Part(series, gear).du
    return _rms(scipy.signal.sosfiltfilt(_high_pass(), du, padlen=min(100, du.size - 1)))


@cache
def _high_pass() -> np.ndarray:
    """Sections of the filter of `activity`."""
    return scipy.signal.butter(4, ACTIVITY, "highpass", fs=1 / CONTROL_PERIOD, output="sos")


def stopping_distance(series: pd.DataFrame) -> float:
    """Distance of the front gear from the first to the last row of a run (m), also if the car does not stop."""
    return float(Part(series, "front").p[-1] - Part(series, "front").p[0])


def summary(series: pd.DataFrame) -> dict[str, tuple[float, str]]:
    """Lateral metrics of a run as a dict: name -> (value, unit). All are for the front gear, except rmse_y_rear.

    - rmse_y, rmse_y_rear, followed_rmse_y, delay (m): see `rmse`, `followed_rmse` and `delay`.
    - effort_du, activity_du (N m): see `effort` and `activity`.
    - rail_rmse_y (m): root mean square of the displacement from the irregular rails.
    - mean_error_last_third (m): mean of y - y* over the last third of the rows.
    - largest_error (m): largest |y - y*|.
    """
    error, front = lateral_error(series), Part(series, "front")
    return {
        "rmse_y": (_rms(error), "m"),
        "rmse_y_rear": (rmse(series, "rear"), "m"),
        "followed_rmse_y": (followed_rmse(series), "m"),
        "rail_rmse_y": (_rms(front.y - front.rail_y), "m"),
        "mean_error_last_third": (float(np.mean(error[-len(error) // 3 :])), "m"),
        "largest_error": (float(np.abs(error).max()), "m"),
        "delay": (delay(series), "m"),
        "effort_du": (effort(series), "N m"),
        "activity_du": (activity(series), "N m"),
    }


def adhesion_limit(speed: np.ndarray, share: np.ndarray, scenario: Scenario, vehicle: Vehicle) -> np.ndarray:
    """Largest longitudinal adhesion that the rail allows (force over nominal wheel load, -), in the shape of `share`.

    It is used for evaluation only; no controller knows it.

    Args:
        speed (ndarray, shape (n,)): Speed (m/s).
        share (ndarray, shape (…, n)): Share of the poor adhesion set, 0 to 1. The limit is linear in it.
        scenario (Scenario): Names of the good and the poor adhesion set.
        vehicle (Vehicle): Adhesion sets, wheel load and contact patch.
    """
    require("metrics: scenario", scenario, Scenario)
    require("metrics: vehicle", vehicle, Vehicle)
    patch = (vehicle.wheel_load, *middle_patch(vehicle), vehicle.contact.shear_modulus)
    grid = np.linspace(max(speed.min(), 1.0), max(speed.max(), 1.1), 12)
    good, poor = (
        np.interp(speed, grid, [adhesion_maximum(vehicle.adhesion[name], v, *patch)[0] for v in grid])
        for name in (scenario.good, scenario.poor)
    )
    return good + share * (poor - good)


def longitudinal(series: pd.DataFrame, scenario: Scenario, vehicle: Vehicle) -> dict[str, tuple[float, str]]:
    """Metrics of traction and braking as a dict: name -> (value, unit).

    - stopping_distance (m): of the front gear, see the function of this name.
    - largest_slip (-): largest |s_x| of all wheels, nan without any row that counts.
    - utilisation (-), only with a force demand: adhesion of the front gear over `adhesion_limit`, mean over the rows in
      which the demand exceeds that limit; nan without such rows.

    Rows count for slip and utilisation where the front gear is faster than 2 m/s.
    """
    require("metrics: scenario", scenario, Scenario)
    front = Part(series, "front")
    p, v = front.p, front.v
    moving = v > 2.0
    slip = np.abs([Part(series, wheel).sx[moving] for wheel in WHEELS])
    values = {
        "stopping_distance": (stopping_distance(series), "m"),
        "largest_slip": (float(slip.max()) if slip.size else float("nan"), "-"),
    }
    if scenario.force_kN:
        shares = [np.interp(p, *np.transpose(points)) for points in scenario.poor_shares]
        limit = adhesion_limit(v, np.array(shares), scenario, vehicle).mean(axis=0)
        f = (Part(series, "front_le").adhesion + Part(series, "front_ri").adhesion) / 2
        f_star = front.f_star
        beyond = (np.abs(f_star) > limit) & moving
        used = float(np.mean(np.sign(f_star[beyond]) * f[beyond] / limit[beyond])) if beyond.any() else float("nan")
        values["utilisation"] = (used, "-")
    return values
