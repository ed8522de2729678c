"""The control-oriented model as CasADi functions, continuous and discretised. State x, psi_Ax, xdot, psidot_Ax, y_TrAx,
psi_TrAx; inputs tau_ri, tau_le (traction-positive, N m); theta holds the track at the present position. Serves the
paper's eqs. (7) and (18) to (20)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np

from railrepro.compile.codegen import stored
from railrepro.data import InputError
from railrepro.model.parameters import DISCREPANCIES, PARAMETERS
from railrepro.quantities import Scalar, names
from railrepro.vehicle.parameters import Vehicle


@dataclass(frozen=True)
class States:
    """States of the control model of one running gear. Source: eq. (18)."""

    x: Annotated[Scalar, "m", "track coordinate"]
    psi_Ax: Annotated[Scalar, "rad", "heading"]
    xdot: Annotated[Scalar, "m/s", "speed along the track"]
    psidot_Ax: Annotated[Scalar, "rad/s", "yaw rate"]
    y_TrAx: Annotated[Scalar, "m", "lateral displacement from the track"]
    psi_TrAx: Annotated[Scalar, "rad", "yaw angle against the track"]


STATES = names(States)
X, PSI_AX, XDOT, PSIDOT_AX, Y, PSI_TRAX = range(len(STATES))
INPUTS = ("tau_ri", "tau_le")
TAU_RI, TAU_LE = range(len(INPUTS))
THETA = ("psi_Tr", "dpsi_dp", "phi_Tr", "dphi_dp", "eps_Tr", "deps_dp", "psi_CB", "dpsi_dp_CB", "m_CB")
"""Heading of the track (rad) and curvature (1/m); superelevation angle and gradient (rad), each with its derivative
along the track (rad/m); heading of the car body (rad) and its derivative (1/m); mass of the car body (kg)."""
PSI_TR, DPSI_DP, PHI_TR, DPHI_DP, EPS_TR, DEPS_DP, PSI_CB, DPSI_DP_CB, M_CB = range(len(THETA))
_TABLEAU = {
    "euler": ((0.0,), (1.0,)),
    "midpoint": ((0.0, 0.5), (0.0, 1.0)),
    "rk4": ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}
"""Fractions of the step and weights of explicit rules whose stages each need the one before."""
METHODS = tuple(_TABLEAU)


def control_model(variant: str = "corrected") -> ca.Function:
    """The control-oriented model of one running gear as a CasADi function.

    It maps (x[6], u[2], theta[9], par[14]) to dx/dt[6] (SI). The orders are those of `STATES`, `INPUTS`, `THETA` and
    `model.parameters.PARAMETERS`.

    Args:
        variant (str): "corrected"; "printed" (with all errata of the paper); or the errata to keep, such as "D1" or
            "D1,D3", names in `parameters.DISCREPANCIES`. Another name raises InputError.
    """
    return _rhs(tuple(sorted(kept_as_printed(variant) - {"D4"})))


def kept_as_printed(variant: str) -> frozenset[str]:
    """Set of the names in `parameters.DISCREPANCIES` that a model variant keeps as printed, see `control_model`."""
    if variant in ("corrected", "printed"):
        return frozenset(DISCREPANCIES if variant == "printed" else ())
    kept = frozenset(name.strip() for name in variant.split(","))
    if not kept.issubset(DISCREPANCIES):
        known = f"corrected, printed and lists of {list(DISCREPANCIES)}"
        raise InputError(f"model variant {variant!r} is not known; there are {known}")
    return kept


def parameter_vector(vehicle: Vehicle) -> np.ndarray:
    """Parameters of the control model for a vehicle, in the order of `parameters.PARAMETERS` (SI), shape (14,)."""
    suspension, wheel, gear = vehicle.suspension, vehicle.wheel, vehicle.gear
    wheels = 2 * wheel.diametral_inertia  # which the model adds to J_x and J_z
    values = [gear.mass, gear.mass, gear.inertia_x - wheels, gear.inertia_z - wheels]
    values += [wheel.spin_inertia, wheel.diametral_inertia, wheel.radius, gear.contact_base]
    values += [wheel.cone_angle, suspension.yaw_stiffness, suspension.yaw_damping]
    return np.array([*values, suspension.roll_stiffness, suspension.roll_damping, vehicle.gravity])


@stored
def _rhs(discrepancies: tuple[str, ...]) -> ca.Function:
    """Rates of the model, from the symbolic derivation, which is imported only where a graph is not stored."""
    import sympy as sp

    from railrepro.model import derivation as d

    entries = {"x": STATES, "u": INPUTS, "theta": THETA, "par": PARAMETERS}
    inputs = [ca.SX.sym(name, len(of)) for name, of in entries.items()]
    (_, psi, xdot, psidot, y, psi_r), torque, theta, par = map(ca.vertsplit, inputs)
    symbols = [d.psi, d.xd, d.psid, d.y, *d.torques, *d.theta, *d.parameters]
    # The relative yaw angle is a state of its own; the track angle that fits it keeps both consistent.
    track = [psi - psi_r, *theta[1:]]
    mass, rest = d.equations(frozenset(discrepancies))
    functions = {"sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "sqrt": ca.sqrt}
    evaluate = sp.lambdify(symbols, [*mass, *rest], modules=[functions], cse=True)
    m11, m12, m21, m22, h1, h2 = evaluate(psi, xdot, psidot, y, *torque, *track, *par)
    determinant = m11 * m22 - m12 * m21
    xddot = (m12 * h2 - m22 * h1) / determinant
    psiddot = (m21 * h1 - m11 * h2) / determinant
    rates = (xdot, psidot, xddot, psiddot, xdot * ca.sin(psi_r), psidot - theta[1] * xdot)
    return ca.Function("control_model", inputs, [ca.vertcat(*rates)], list(entries), ["dx"], {"cse": True})


def discretise(model: ca.Function, method: str = "euler") -> ca.Function:
    """CasADi function of one time step of a `control_model`, with inputs and track held constant. Source: eq. (7).

    It maps (x[6], u[2], theta[9], par[14], step T (s)) to the state after T, and its Jacobians by x (6, 6) and by u (6,
    2), both sparse (SI). InputError for another method.

    Args:
        model (casadi.Function): Function from `control_model`.
        method (str): "euler" (as in the paper), "midpoint" or "rk4".
    """
    if method not in METHODS:
        raise InputError(f"discretisation {method!r} is not known; there are {METHODS}")
    x, u, theta = ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(INPUTS)), ca.SX.sym("theta", len(THETA))
    par, period = ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("T")
    rate = model(x, u, theta, par)
    jacobians = [ca.jacobian(rate, x), ca.jacobian(rate, u)]
    rates = ca.Function("rates", [x, u, theta, par], [rate, *jacobians], {"cse": True})
    x_next, by_x, by_u = x, ca.SX.eye(6), ca.SX(6, 2)
    slope: ca.SX | int = 0
    slope_x: ca.SX | int = 0
    slope_u: ca.SX | int = 0
    for fraction, weight in zip(*_TABLEAU[method], strict=True):
        at = x + fraction * period * slope
        along_x, along_u = ca.SX.eye(6) + fraction * period * slope_x, fraction * period * slope_u
        slope, a, b = rates(at, u, theta, par)
        slope_x, slope_u = ca.mtimes(a, along_x), b + (ca.mtimes(a, along_u) if fraction else 0)
        x_next = x_next + weight * period * slope
        by_x, by_u = by_x + weight * period * slope_x, by_u + weight * period * slope_u
    inputs, names = [x, u, theta, par, period], (["x", "u", "theta", "par", "T"], ["x_next", "by_x", "by_u"])
    return ca.Function("control_step", inputs, [x_next, by_x, by_u], *names, {"cse": True})
