"""Forecast of position, speed, set point and track over the horizon of the predictive controllers.

Serves eq. (des_states) of the paper; the base torque accelerates with both wheels and the spin inertia (D4 corrected)
unless the printed forecast is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.track import route
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

BELIEVED = ("acceleration_per_torque", "partner", "m_CB")
"""What the forecast needs of the vehicle: 1/(kg m), signed distance to the other gear (m), body mass (kg)."""


@dataclass(frozen=True)
class Forecast:
    """What lies ahead of one running gear.

    Attributes
    ----------
    x_d : ndarray, shape (L + 1, 6)
        Desired states x, psi_Ax, xdot, psidot_Ax, y_TrAx, psi_TrAx (SI).
    theta : ndarray, shape (L + 1, 9)
        Track parameters of the control model at the forecast positions.
    """

    x_d: np.ndarray
    theta: np.ndarray


def believed(vehicle: Vehicle, gear: int, printed: bool = False) -> np.ndarray:
    """Values of `BELIEVED` for a gear (0 front, 1 rear); `printed` keeps D4, one wheel and the opposite sign."""
    if printed:
        gain = -1 / (vehicle.wheel.radius * vehicle.longitudinal_mass)
    else:
        gain = 2 / (vehicle.wheel.radius * vehicle.effective_longitudinal_mass)
    return np.array([gain, (-1, 1)[gear] * vehicle.body.gear_spacing, vehicle.body.mass])


def _motion(x_hat: ca.SX, u_d: ca.SX, t: ca.SX, gain: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Position (m) and speed (m/s) after t (s) with the base torque held, until standstill."""
    acceleration = u_d * gain
    driven = ca.if_else(acceleration < 0, ca.fmin(t, ca.fmax(x_hat[2], 0) / ca.fmax(-acceleration, 1e-12)), t)
    return x_hat[0] + (x_hat[2] + acceleration * driven / 2) * driven, x_hat[2] + acceleration * driven


@lru_cache
def functions() -> tuple[ca.Function, ca.Function]:
    """Forecast of one stage at t (s) from now.

    Returns
    -------
    place : casadi.Function
        (x_hat[6], u_d, t, believed) -> track coordinates of this and of the other gear (m).
    stage : casadi.Function
        (x_hat[6], u_d, t, believed, cell here, cell there) -> x_d[6], theta[9]; cells are rows of a `Route`.

    Source: eqs. (des_states) and (track_dep_variables).
    """
    x_hat, u_d, t, vehicle = ca.SX.sym("x_hat", 6), ca.SX.sym("u_d"), ca.SX.sym("t"), ca.SX.sym("v", len(BELIEVED))
    cells = [ca.SX.sym(name, len(route.COLUMNS)) for name in ("here", "there")]
    gain, partner, mass = ca.vertsplit(vehicle)
    position, speed = _motion(x_hat, u_d, t, gain)
    inputs = [x_hat, u_d, t, vehicle]
    place = ca.Function("preview_place", inputs, [ca.vertcat(position, position + partner)])
    here, there = (dict(zip(route.COLUMNS, ca.vertsplit(cell), strict=True)) for cell in cells)
    y_ref, slope, bend = route.reference_in(here, position)
    track, other = route.track_in(here, position), route.track_in(there, position + partner)
    theta = ca.vertcat(*track, (track[0] + other[0]) / 2, (track[1] + other[1]) / 2, mass)
    yaw, yaw_rate = slope + track[0], (bend + track[1]) * speed
    x_d = ca.vertcat(position, yaw, speed, yaw_rate, y_ref, slope)
    return place, ca.Function("preview_stage", [*inputs, *cells], [x_d, theta], {"cse": True})


def forecast(way: Route, here: np.ndarray, x_hat: np.ndarray, u_d: float, period: float, steps: int) -> Forecast:
    """Desired states and track parameters over the horizon.

    Parameters
    ----------
    way : Route
    here : ndarray
        What is believed of the vehicle, see `believed`.
    x_hat : ndarray, shape (6,)
        Measured state.
    u_d : float
        Base torque per wheel, traction-positive (N m).
    period, steps : float, int
        Time step T (s) and number of steps L.

    Returns
    -------
    Forecast
    """
    place, stage = functions()
    t = period * np.arange(steps + 1)[None, :]
    wide = [np.tile(np.reshape(value, (-1, 1)), steps + 1) for value in (x_hat, u_d)]
    arguments = [*wide, t, np.tile(here[:, None], steps + 1)]
    places = np.array(place(*arguments))
    x_d, theta = stage(*arguments, *(way.rows_at(p).T for p in places))
    return Forecast(np.array(x_d).T, np.array(theta).T)
