"""Forecast of position, speed, set point and track over the horizon of the predictive controllers.

Serves eq. (34) of the paper; the base torque accelerates with both wheels and the spin inertia (D4 corrected)
unless the printed forecast is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from railrepro.compile.codegen import stored
from railrepro.model.control_model import STATES, THETA, XDOT, X
from railrepro.track.route import COLUMNS, reference_in, track_in
from railrepro.vehicle.parameters import Vehicle

NOMINAL = ("acceleration_per_torque", "partner", "m_CB")
"""Vehicle data of the forecast: acceleration per base torque (1/(kg m)), signed distance to the other gear (m), body
mass (kg)."""


@dataclass(frozen=True)
class Forecast:
    """Desired states and track parameters of one running gear at the L + 1 points of a horizon."""

    x_d: np.ndarray
    """Desired states x, psi_Ax, xdot, psidot_Ax, y_TrAx, psi_TrAx, shape (L + 1, 6), SI."""
    theta: np.ndarray
    """Track parameters `control_model.THETA` at the forecast positions, shape (L + 1, 9), SI."""


def nominal_values(vehicle: Vehicle, gear: int, printed: bool = False) -> np.ndarray:
    """Vehicle data `NOMINAL` of the forecast for a gear (0 front, 1 rear), shape (3,): 1/(kg m), m, kg.

    `printed` keeps D4: the base torque of one wheel accelerates, with the opposite sign and without spin inertia.
    """
    if printed:
        gain = -1 / (vehicle.wheel.radius * vehicle.longitudinal_mass)
    else:
        gain = 2 / (vehicle.wheel.radius * vehicle.effective_longitudinal_mass)
    return np.array([gain, (-1, 1)[gear] * vehicle.body.gear_spacing, vehicle.body.mass])


def _motion(x_hat: ca.SX, u_d: ca.SX, t: ca.SX, gain: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Position (m) and speed (m/s) after t (s) with the base torque held, until standstill."""
    position, speed, acceleration = x_hat[X], x_hat[XDOT], u_d * gain
    driven = ca.if_else(acceleration < 0, ca.fmin(t, ca.fmax(speed, 0) / ca.fmax(-acceleration, 1e-12)), t)
    return position + (speed + acceleration * driven / 2) * driven, speed + acceleration * driven


@stored
def functions() -> tuple[ca.Function, ca.Function]:
    """CasADi functions of the forecast of one stage, t (s) ahead; SI.

    Returns
    -------
    position : casadi.Function
        (state x_hat[6], base torque u_d, t, nominal[3] of `NOMINAL`) -> track coordinates [this gear, other gear] (m).
    stage : casadi.Function
        (x_hat[6], u_d, t, nominal, here, there) -> x_d[6], theta[9] as `Forecast`; here and there: rows of
        `Route.cells` at these two coordinates.

    Source: eqs. (34) and (14), (15).
    """
    x_hat, u_d, t = ca.SX.sym("x_hat", len(STATES)), ca.SX.sym("u_d"), ca.SX.sym("t")
    vehicle = ca.SX.sym("nominal", len(NOMINAL))
    cells = [ca.SX.sym(name, len(COLUMNS)) for name in ("here", "there")]
    gain, partner, mass = ca.vertsplit(vehicle)
    position, speed = _motion(x_hat, u_d, t, gain)
    inputs = [x_hat, u_d, t, vehicle]
    positions = ca.Function("preview_position", inputs, [ca.vertcat(position, position + partner)])
    here, there = (dict(zip(COLUMNS, ca.vertsplit(cell), strict=True)) for cell in cells)
    y_ref, slope, bend = reference_in(here, position)
    psi, kappa, phi, dphi, eps, deps = track_in(here, position)
    psi_there, kappa_there, *_ = track_in(there, position + partner)
    theta = {"psi_Tr": psi, "dpsi_dp": kappa, "phi_Tr": phi, "dphi_dp": dphi, "eps_Tr": eps, "deps_dp": deps}
    theta |= {"psi_CB": (psi + psi_there) / 2, "dpsi_dp_CB": (kappa + kappa_there) / 2, "m_CB": mass}
    x_d = {"x": position, "psi_Ax": slope + psi, "xdot": speed, "psidot_Ax": (bend + kappa) * speed}
    x_d |= {"y_TrAx": y_ref, "psi_TrAx": slope}
    results = [ca.vertcat(*(x_d[name] for name in STATES)), ca.vertcat(*(theta[name] for name in THETA))]
    return positions, ca.Function("preview_stage", [*inputs, *cells], results, {"cse": True})
