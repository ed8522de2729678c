"""Forecast of position, speed, set point and track over the horizon of the predictive controllers.

Serves eq. (des_states) of the paper; the base torque accelerates with both wheels and the spin inertia (D4 corrected)
unless the printed forecast is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from railrepro.parameters import Vehicle
from railrepro.route import Route


@dataclass(frozen=True)
class Forecast:
    """What lies ahead of one running gear.

    Attributes
    ----------
    x_d : ndarray, shape (6, L + 1)
        Desired states x, psi_Ax, xdot, psidot_Ax, y_TrAx, psi_TrAx (SI).
    theta : ndarray, shape (9, L + 1)
        Track parameters of the control model at the forecast positions.
    """

    x_d: np.ndarray
    theta: np.ndarray


def forecast(
    route: Route,
    vehicle: Vehicle,
    x_hat: np.ndarray,
    u_d: float,
    period: float,
    steps: int,
    gear: int,
    printed: bool = False,
) -> Forecast:
    """Desired states and track parameters over the horizon.

    Parameters
    ----------
    route : Route
    vehicle : Vehicle
        What the controller believes.
    x_hat : ndarray, shape (6,)
        Measured state.
    u_d : float
        Base torque per wheel, traction-positive (N m).
    period, steps : float, int
        Time step T (s) and number of steps L.
    gear : int
        0 front, 1 rear: where the partner gear is, whose track angle makes psi_CB.
    printed : bool
        Keep discrepancy D4 (one wheel, opposite sign, no spin inertia).

    Returns
    -------
    Forecast

    Source: eqs. (des_states) and (track_dep_variables).
    """
    t = period * np.arange(steps + 1)
    if printed:
        acceleration = -u_d / (vehicle.wheel.radius * vehicle.longitudinal_mass)
    else:
        acceleration = 2 * u_d / (vehicle.wheel.radius * vehicle.effective_longitudinal_mass)
    stopping = x_hat[2] / -acceleration if acceleration < 0 else np.inf
    driven = np.minimum(t, max(stopping, 0.0))
    speed = x_hat[2] + acceleration * driven
    position = x_hat[0] + (x_hat[2] + acceleration * driven / 2) * driven
    partner = position + (-1, 1)[gear] * vehicle.body.gear_spacing
    track = route.track_at(np.concatenate([position, partner]))
    here, there = track[:, : steps + 1], track[:, steps + 1 :]
    y_ref, slope = route.reference_at(position)
    theta = np.empty((9, steps + 1))
    theta[:6] = here
    theta[6], theta[7] = (here[0] + there[0]) / 2, (here[1] + there[1]) / 2
    theta[8] = vehicle.body.mass
    slope_rate = np.gradient(slope, period) if steps else np.zeros(1)
    x_d = np.array([position, slope + here[0], speed, slope_rate + here[1] * speed, y_ref, slope])
    return Forecast(x_d, theta)
