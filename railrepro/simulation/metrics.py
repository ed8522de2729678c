"""Figures of merit of a run: tracking error, delay, effort, stopping distance, adhesion utilisation. `series` is always
the table `simulate.Run.series`: a row per ms, and columns such as front.y (m), as named in each docstring. `gear` is
"front" or "rear". Serves the paper's section Multi-Body Simulation Results."""

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
"""Displacement from the middle of the rails above which a gear's flanges count as touching (m); S1002: 6 to 8 mm."""
ACTIVITY = 5.0
"""Cut-off frequency of `activity` (Hz), above all set points: a sweep of 40 m at 400 km/h has 2.8 Hz."""


class Part:
    """Columns of one gear, wheel or floor point in a series, as attributes of shape (n,): `Part(series, "front").y_ref`
    is the column `front.y_ref`. InputError for a column that is missing or not numeric."""

    def __init__(self, series: pd.DataFrame, of: str):
        require("metrics: series", series, pd.DataFrame)
        self._series, self._of = series, of

    def __getattr__(self, name: str) -> np.ndarray:
        column = f"{self._of}.{name}"
        values = np.asarray(self._series.get(column, ()))
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
    """Name the column of a series: "front.y" for the quantity "y" of the front gear, "front_ri.tau" for "ri.tau"."""
    part, dot, name = quantity.partition(".")
    return f"{gear}_{part}.{name}" if dot else f"{gear}.{part}"


FILE_COLUMNS = {column("front", quantity): name for quantity, name in _OF_GEAR.items()}
"""Column of a series for the front gear -> its name with the unit in the tables of figures/."""


def gear_series(series: pd.DataFrame, gear: str = "front", stride: int = 1) -> pd.DataFrame:
    """Select every `stride`-th row of a series, with t_s (s) and the quantities of one running gear (SI). Columns for
    the front gear: front.p and front.v along the track; front.y and its set point front.y_ref; yaw angles front.psi_Ax
    (absolute), front.psi_TrAx (against the track); torques per wheel: front.du (differential, added to the left motor
    and subtracted from the right), front.u_d (base torque, which the adhesion law sets for traction or braking),
    front.tau_long (what of u_d the torque limit leaves beside du); adhesion set point front.f_star; front.segment of
    the adhesion law (1 to 3); torque, adhesion and slip of each wheel, such as front_ri.tau, front_ri.adhesion,
    front_ri.sx. Two columns are not in `series`: front.creep_angle between heading and motion (rad), and the lateral
    error front.error (m)."""
    rows = series.iloc[::stride]
    creepage = Part(rows, f"{gear}_ri").nu_y + Part(rows, f"{gear}_le").nu_y
    added = {f"{gear}.creep_angle": -creepage / 2, f"{gear}.error": lateral_error(rows, gear)}
    columns = ["t_s", *(column(gear, quantity) for quantity in _OF_GEAR)]
    return pd.DataFrame({name: added[name] if name in added else rows[name] for name in columns})


def lateral_error(series: pd.DataFrame, gear: str = "front") -> np.ndarray:
    """Compute the lateral error of a gear in each row of a run (m): y - y*, its displacement from the ideal track minus
    the set point, from the columns front.y and front.y_ref (or rear.y and rear.y_ref) of `series`."""
    return Part(series, gear).y - Part(series, gear).y_ref


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def rmse(series: pd.DataFrame, gear: str = "front") -> float:
    """Compute the root mean square over a run of y - y* (m), columns front.y and front.y_ref (or rear.…) of `series`.
    Source: paper, section Evaluation of Lateral Control."""
    return _rms(lateral_error(series, gear))


def followed_rmse(series: pd.DataFrame, gear: str = "front") -> float:
    """Compute the root mean square of a gear's displacement from the irregular rails minus its set point (m), from the
    columns front.y, front.rail_y and front.y_ref (or rear.…) of `series`."""
    return _rms(lateral_error(series, gear) - Part(series, gear).rail_y)


def on_flange(series: pd.DataFrame) -> np.ndarray:
    """Find the rows of a run in which a flange touches its rail: bool, shape (n,). A contact angle (columns such as
    front_ri.angle) exceeds 30 degrees, or a gear is over 7 mm from the middle of the rails (front.y - front.rail_y)."""
    displacement = [np.abs(Part(series, gear).y - Part(series, gear).rail_y) for gear in GEARS]
    angle = [np.abs(Part(series, wheel).angle) for wheel in WHEELS]
    return (np.max(displacement, axis=0) > FLANGEWAY) | (np.max(angle, axis=0) > FLANGE_ANGLE)


def reaches_flange(series: pd.DataFrame) -> bool:
    """Find out whether a wheel touches its rail with the flange in any row of a run, whose table is `series`."""
    return bool(on_flange(series).any())


def delay(series: pd.DataFrame, gear: str = "front") -> float:
    """Measure the distance along the track by which the displacement y of a gear trails its set point y* (m). Both,
    columns front.y and front.y_ref (or rear.…) over front.p, are detrended by a line and put on a grid of 0.1 m. The
    result is the lag within +-60 m with the largest mean product, positive when y trails y*; nan when y* is constant or
    the car stands."""
    of_gear, step = Part(series, gear), 0.1
    p = of_gear.p
    grid = np.arange(p[0], p[-1], step)
    if grid.size < 2:
        return float("nan")
    y, reference = (scipy.signal.detrend(np.interp(grid, p, values)) for values in (of_gear.y, of_gear.y_ref))
    if np.ptp(reference) < 1e-9:
        return float("nan")
    most, n = min(600, grid.size // 2), grid.size
    lags = range(-most, most + 1)
    products = (y[max(lag, 0) : n + min(lag, 0)] * reference[max(-lag, 0) : n - max(lag, 0)] for lag in lags)
    correlation = [product.sum() / product.size for product in products]  # each lag has its own number of samples
    return float(step * lags[np.argmax(correlation)])


def effort(series: pd.DataFrame, gear: str = "front") -> float:
    """Compute the root mean square over a run of a gear's differential torque (N m), column front.du or rear.du."""
    return _rms(Part(series, gear).du)


def activity(series: pd.DataFrame, gear: str = "front") -> float:
    """Compute the root mean square of a gear's differential torque (column front.du or rear.du) above 5 Hz (N m): noise
    or a limit cycle. Filter: Butterworth, fourth order, run forwards and backwards. `series` needs a row per ms."""
    du = Part(series, gear).du
    high_pass = scipy.signal.butter(4, ACTIVITY, "highpass", fs=1 / CONTROL_PERIOD, output="sos")
    return _rms(scipy.signal.sosfiltfilt(high_pass, du, padlen=min(100, du.size - 1)))


def stopping_distance(series: pd.DataFrame) -> float:
    """Measure how far the front gear travels in a run (m), from its first to its last front.p, even without a stop."""
    p = Part(series, "front").p
    return float(p[-1] - p[0])


def summary(series: pd.DataFrame) -> dict[str, tuple[float, str]]:
    """Compute the lateral metrics of a run as a dict: name -> (value, unit). rmse_y_rear is of the rear gear, all
    others are of the front gear. RMS values: rmse_y and rmse_y_rear of y - y* (m); followed_rmse_y of this error with y
    from the irregular rails (m); rail_rmse_y of y from the irregular rails (m); effort_du of the differential torque
    du, activity_du of du above 5 Hz (N m). Further: delay, distance by which y trails y* (m); largest_error, largest |y
    - y*| (m); mean_error_last_third, mean of y - y* over the last third of the rows (m)."""
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
    """Compute the largest longitudinal adhesion of the rail, force over nominal wheel load (-), shaped as `share`.
    `speed` (m/s) has the shape (n,). `share`, shape (…, n), is the share of the scenario's poor adhesion set, 0 to 1;
    the limit is linear in it. It is for evaluation only: no controller knows it."""
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
    """Compute the metrics of traction and braking as a dict: name -> (value, unit).

    - stopping_distance (m): distance that the front gear travels in the run.
    - largest_slip (-): largest |s_x| of all wheels.
    - utilisation (-), only with a force demand: mean of adhesion over `adhesion_limit`, for the front gear and the rows
      in which the demand exceeds this limit.

    Only rows in which the front gear is faster than 2 m/s count for slip and utilisation; nan without such rows.
    """
    require("metrics: scenario", scenario, Scenario)
    front = Part(series, "front")
    moving = front.v > 2.0
    slip = np.abs([Part(series, wheel).sx[moving] for wheel in WHEELS])
    values = {
        "stopping_distance": (stopping_distance(series), "m"),
        "largest_slip": (float(slip.max()) if slip.size else float("nan"), "-"),
    }
    if scenario.force_kN:
        shares = [np.interp(front.p, *np.transpose(points)) for points in scenario.poor_shares]
        limit = adhesion_limit(front.v, np.array(shares), scenario, vehicle).mean(axis=0)
        f = (Part(series, "front_le").adhesion + Part(series, "front_ri").adhesion) / 2
        beyond = (np.abs(front.f_star) > limit) & moving
        used = np.sign(front.f_star[beyond]) * f[beyond] / limit[beyond]
        values["utilisation"] = (float(np.mean(used)) if used.size else float("nan"), "-")
    return values
