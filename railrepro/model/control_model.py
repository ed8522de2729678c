"""The control-oriented model as CasADi functions, continuous and discretised. Source: eqs. (7) and (18) to (20)."""

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
    """States of a running gear in the control model: track coordinate x, heading psi_Ax, speed xdot, yaw rate
    psidot_Ax, lateral displacement y_TrAx and yaw angle psi_TrAx against the track. Source: eq. (18) of the paper."""

    x: Annotated[Scalar, "m", "track coordinate"]
    psi_Ax: Annotated[Scalar, "rad", "heading"]
    xdot: Annotated[Scalar, "m/s", "speed along the track"]
    psidot_Ax: Annotated[Scalar, "rad/s", "yaw rate"]
    y_TrAx: Annotated[Scalar, "m", "lateral displacement from the track"]
    psi_TrAx: Annotated[Scalar, "rad", "yaw angle against the track"]


STATES = names(States)
X, PSI_AX, XDOT, PSIDOT_AX, Y, PSI_TRAX = range(len(STATES))
INPUTS = ("tau_ri", "tau_le")
"""Motor torques of the right and the left wheel (N m), positive in traction."""
TAU_RI, TAU_LE = range(len(INPUTS))
THETA = ("psi_Tr", "dpsi_dp", "phi_Tr", "dphi_dp", "eps_Tr", "deps_dp", "psi_CB", "dpsi_dp_CB", "m_CB")
"""Track at the position of the gear: heading (rad), superelevation angle (rad) and gradient (rad), each followed by its
derivative along the track (rad/m). Then heading of the car body (rad), its derivative (rad/m), body mass (kg)."""
PSI_TR, DPSI_DP, PHI_TR, DPHI_DP, EPS_TR, DEPS_DP, PSI_CB, DPSI_DP_CB, M_CB = range(len(THETA))
_TABLEAU = {
    "euler": ((0.0,), (1.0,)),
    "midpoint": ((0.0, 0.5), (0.0, 1.0)),
    "rk4": ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)),
}
"""Explicit Runge-Kutta methods, each stage from the slope of the stage before: fractions of the step, and weights."""
METHODS = tuple(_TABLEAU)


def control_model(variant: str = "corrected") -> ca.Function:
    """Make the model of one running gear: a CasADi function (x[6], u[2], theta[9], par[14]) -> dx/dt[6], in SI units. x
    are its `STATES`, u the motor torques of the right and the left wheel, theta the track at the gear (`THETA`), and
    par the numbers `model.parameters.PARAMETERS`. `variant` is "corrected", "printed" (all errata of the paper) or a
    list of the errata to keep, such as "D1" or "D1,D3", from `parameters.DISCREPANCIES`. InputError for another."""
    return _rhs(tuple(sorted(kept_as_printed(variant) - {"D4"})))


def kept_as_printed(variant: str) -> frozenset[str]:
    """Errata of the paper, such as "D1", that a model `variant` keeps, see `control_model`; InputError if unknown."""
    if variant in ("corrected", "printed"):
        return frozenset(DISCREPANCIES if variant == "printed" else ())
    kept = frozenset(name.strip() for name in variant.split(","))
    if not kept.issubset(DISCREPANCIES):
        known = f"there are corrected, printed and lists of {list(DISCREPANCIES)}"
        raise InputError(f"model variant {variant!r} is not known; {known}")
    return kept


def parameter_vector(vehicle: Vehicle) -> np.ndarray:
    """Parameters of the control model for a vehicle, shape (14,), in the order of `parameters.PARAMETERS` (SI)."""
    suspension, wheel, gear = vehicle.suspension, vehicle.wheel, vehicle.gear
    wheels = 2 * wheel.diametral_inertia  # which the model adds to J_x and J_z
    values = [gear.mass, gear.mass, gear.inertia_x - wheels, gear.inertia_z - wheels]
    values += [wheel.spin_inertia, wheel.diametral_inertia, wheel.radius, gear.contact_base]
    values += [wheel.cone_angle, suspension.yaw_stiffness, suspension.yaw_damping]
    return np.array([*values, suspension.roll_stiffness, suspension.roll_damping, vehicle.gravity])


@stored
def _rhs(discrepancies: tuple[str, ...]) -> ca.Function:
    """The `control_model` with these errata. SymPy is imported only where the function is not stored yet."""
    import sympy as sp

    from railrepro.model import derivation as d

    entries = {"x": STATES, "u": INPUTS, "theta": THETA, "par": PARAMETERS}
    inputs = [ca.SX.sym(name, len(of)) for name, of in entries.items()]
    (_, psi, xdot, psidot, y, psi_r), torque, theta, par = map(ca.vertsplit, inputs)
    symbols = [d.psi, d.xd, d.psid, d.y, *d.torques, *d.theta, *d.parameters]
    # The yaw angle against the track is a state of its own; this heading of the track is consistent with it.
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
    """Make one time step of a `control_model` with constant inputs and track, as a CasADi function. Source: eq. (7). It
    maps (x[6], u[2], theta[9], par[14], step T (s)) to the state after T and its sparse Jacobians by x (6, 6) and by u
    (6, 2), in SI units. `method` is "euler" (as in the paper), "midpoint" or "rk4"; InputError for another."""
    if method not in METHODS:
        raise InputError(f"discretisation {method!r} is not known; there are {METHODS}")
    x, u, theta, par = model.sx_in()
    period, rate = ca.SX.sym("T"), model(x, u, theta, par)
    linearised = [rate, ca.jacobian(rate, x), ca.jacobian(rate, u)]
    rates = ca.Function("rates", [x, u, theta, par], linearised, {"cse": True})
    x_next, by_x, by_u = x, ca.SX.eye(6), ca.SX(6, 2)
    slope, slope_x, slope_u = ca.SX(6, 1), ca.SX(6, 6), ca.SX(6, 2)
    for fraction, weight in zip(*_TABLEAU[method], strict=True):
        at = x + fraction * period * slope
        along_x, along_u = ca.SX.eye(6) + fraction * period * slope_x, fraction * period * slope_u
        slope, a, b = rates(at, u, theta, par)
        slope_x, slope_u = ca.mtimes(a, along_x), b + ca.mtimes(a, along_u)
        x_next = x_next + weight * period * slope
        by_x, by_u = by_x + weight * period * slope_x, by_u + weight * period * slope_u
    inputs, labels = [x, u, theta, par, period], (["x", "u", "theta", "par", "T"], ["x_next", "by_x", "by_u"])
    return ca.Function("control_step", inputs, [x_next, by_x, by_u], *labels, {"cse": True})
