"""Forecast of position, speed, set point and track over the horizon of a predictive controller. Source: eq. (34)."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from railrepro.compile.codegen import stored
from railrepro.model.control_model import STATES, XDOT, X
from railrepro.quantities import named
from railrepro.track.route import COLUMNS, reference_in, track_in
from railrepro.vehicle.parameters import Vehicle

NOMINAL = ("acceleration_per_torque", "partner", "m_CB")
"""Vehicle data of the forecast: acceleration per base torque (1/(kg m)), signed distance to the other gear (m), mass of
the car body (kg). Base torque is what both wheels of a gear have in common (N m)."""


@dataclass(frozen=True)
class Forecast:
    """What a predictive controller of one running gear expects now and L steps ahead (SI): desired states x_d, shape (L
    + 1, 6), as `control_model.STATES`, and track parameters theta, shape (L + 1, 9), as `control_model.THETA`."""

    x_d: np.ndarray
    theta: np.ndarray


def nominal_values(vehicle: Vehicle, gear: int, printed: bool = False) -> np.ndarray:
    """Vehicle data for the forecast of a gear (0 front, 1 rear), shape (3,), in the order of `NOMINAL`: acceleration of
    the car per base torque u_d, the torque common to both wheels of a gear (1/(kg m)); distance to the other gear,
    negative if that is behind (m), for the heading of the car body; mass of the car body (kg), a model parameter. By
    default both wheels accelerate the vehicle mass and their own spin inertia. With `printed` one wheel accelerates the
    mass alone, in the opposite direction (erratum D4)."""
    gain = 2 / (vehicle.wheel.radius * vehicle.effective_longitudinal_mass)
    if printed:
        gain = -1 / (vehicle.wheel.radius * vehicle.longitudinal_mass)
    return np.array([gain, (-1, 1)[gear] * vehicle.body.gear_spacing, vehicle.body.mass])


@stored
def functions() -> tuple[ca.Function, ca.Function]:
    """Make two CasADi functions of the forecast at a time t (s) ahead, in SI units. Source: eqs. (34) and (14), (15).

    The first maps (state x_hat[6]; base torque u_d of each wheel, held over t; t; nominal[3], acceleration per torque,
    distance to the other gear and body mass, as from `nominal_values`) to the track coordinates of this gear and of the
    other one [2]. The second maps (x_hat, u_d, t, nominal, here, there), with the rows of `Route.cells` at these two
    coordinates, to x_d[6] and theta[9] as in `Forecast`. Heading and curvature at the car body are means of both gears.
    """
    x_hat, u_d, t = ca.SX.sym("x_hat", len(STATES)), ca.SX.sym("u_d"), ca.SX.sym("t")
    vehicle = ca.SX.sym("nominal", len(NOMINAL))
    cells = [ca.SX.sym(name, len(COLUMNS)) for name in ("here", "there")]
    gain, partner, mass = ca.vertsplit(vehicle)
    start, acceleration = x_hat[XDOT], u_d * gain
    driven = ca.if_else(acceleration < 0, ca.fmin(t, ca.fmax(start, 0) / ca.fmax(-acceleration, 1e-12)), t)
    position, speed = x_hat[X] + (start + acceleration * driven / 2) * driven, start + acceleration * driven
    inputs = [x_hat, u_d, t, vehicle]
    positions = ca.Function("preview_position", inputs, [ca.vertcat(position, position + partner)])
    here, there = (named(COLUMNS, cell) for cell in cells)
    y_ref, slope, bend = reference_in(here, position)
    psi, kappa, *_ = track = track_in(here, position)
    psi_there, kappa_there, *_ = track_in(there, position + partner)
    x_d = ca.vertcat(position, slope + psi, speed, (bend + kappa) * speed, y_ref, slope)
    theta = ca.vertcat(*track, (psi + psi_there) / 2, (kappa + kappa_there) / 2, mass)
    return positions, ca.Function("preview_stage", [*inputs, *cells], [x_d, theta], {"cse": True})
