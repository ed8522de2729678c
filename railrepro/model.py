"""The control-oriented model as CasADi functions, continuous and discretised.

State x, psi_Ax, xdot, psidot_Ax, y_TrAx, psi_TrAx; inputs tau_ri, tau_le (traction-positive, N m); theta holds the
track at the present position. Serves the paper's eqs. (discr_state_space1) and (eqn.parameters).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
import sympy as sp

from railrepro import derivation
from railrepro.errors import InputError
from railrepro.parameters import Vehicle

STATES = ("x", "psi_Ax", "xdot", "psidot_Ax", "y_TrAx", "psi_TrAx")
THETA = ("psi_Tr", "dpsi_dp", "phi_Tr", "dphi_dp", "eps_Tr", "deps_dp", "psi_CB", "dpsi_dp_CB", "m_CB")
METHODS = ("euler", "midpoint", "rk4")
_VARIANTS = {"corrected": (), "printed": tuple(derivation.DISCREPANCIES)}


@dataclass(frozen=True)
class ControlModel:
    """The model with its variant.

    Attributes
    ----------
    rhs : casadi.Function
        (x[6], u[2] = [tau_ri, tau_le], theta[9], par) -> dx/dt[6], SI.
    discrepancies : frozenset of str
        What is kept as printed.
    """

    rhs: ca.Function
    discrepancies: frozenset[str]

    parameters = derivation.PARAMETERS

    @staticmethod
    def parameter_vector(vehicle: Vehicle) -> np.ndarray:
        """Values of `parameters` for a vehicle (SI), shape (14,)."""
        suspension, wheel = vehicle.suspension, vehicle.wheel
        values = (
            vehicle.gear.mass,
            vehicle.gear.mass,
            vehicle.residual_roll_inertia,
            vehicle.residual_yaw_inertia,
        )
        values += (wheel.spin_inertia, wheel.diametral_inertia, wheel.radius, vehicle.gear.contact_base)
        values += (wheel.cone_angle, suspension.yaw_stiffness, suspension.yaw_damping)
        return np.array([*values, suspension.roll_stiffness, suspension.roll_damping, vehicle.gravity])


def control_model(variant: str = "corrected", discrepancies: Iterable[str] | None = None) -> ControlModel:
    """The control-oriented model.

    Parameters
    ----------
    variant : str
        "corrected" or "printed".
    discrepancies : iterable of str, optional
        Instead of a variant: which entries of `derivation.DISCREPANCIES` to keep as printed.

    Returns
    -------
    ControlModel
    """
    if variant not in _VARIANTS:
        raise InputError(f"model variant {variant!r} is not known; there are {sorted(_VARIANTS)}")
    kept = frozenset(_VARIANTS[variant] if discrepancies is None else discrepancies)
    if kept - set(derivation.DISCREPANCIES):
        raise InputError(
            f"discrepancies {sorted(kept)} are not all known; there are {sorted(derivation.DISCREPANCIES)}"
        )
    return _control_model(kept)


@lru_cache
def _control_model(discrepancies: frozenset[str]) -> ControlModel:
    equations = derivation.equations(discrepancies)
    state = [ca.SX.sym(name) for name in STATES]
    torque = [ca.SX.sym("tau_ri"), ca.SX.sym("tau_le")]
    theta = [ca.SX.sym(name) for name in THETA]
    par = [ca.SX.sym(name) for name in derivation.PARAMETERS]
    _, psi, xdot, psidot, y, psi_r = state
    d = derivation
    symbols = [d.psi, d.xd, d.psid, d.y, *d.torques, *d.theta, *d.parameters]
    # The relative yaw angle is a state of its own; the track angle that fits it keeps both consistent.
    track = [psi - psi_r, *theta[1:]]
    entries = [*equations.mass, *equations.rest]
    functions = {"sin": ca.sin, "cos": ca.cos, "tan": ca.tan, "sqrt": ca.sqrt}
    evaluate = sp.lambdify(symbols, entries, modules=[functions], cse=True)
    m11, m12, m21, m22, h1, h2 = evaluate(psi, xdot, psidot, y, *torque, *track, *par)
    determinant = m11 * m22 - m12 * m21
    xddot = (m12 * h2 - m22 * h1) / determinant
    psiddot = (m21 * h1 - m11 * h2) / determinant
    rates = (xdot, psidot, xddot, psiddot, xdot * ca.sin(psi_r), psidot - theta[1] * xdot)
    inputs = [ca.vertcat(*group) for group in (state, torque, theta, par)]
    rhs = ca.Function("control_model", inputs, [ca.vertcat(*rates)], ["x", "u", "theta", "par"], ["dx"], {"cse": True})
    return ControlModel(rhs, discrepancies)


def discretise(model: ControlModel, method: str = "euler") -> ca.Function:
    """One step of the model with inputs and track held.

    Parameters
    ----------
    model : ControlModel
    method : str
        "euler" (the paper), "midpoint" or "rk4".

    Returns
    -------
    casadi.Function
        (x[6], u[2], theta[9], par, T) -> x after T (s).

    Source: eq. (discr_state_space1).
    """
    if method not in METHODS:
        raise InputError(f"discretisation {method!r} is not known; there are {METHODS}")
    x, u, theta = ca.SX.sym("x", 6), ca.SX.sym("u", 2), ca.SX.sym("theta", len(THETA))
    par, period = ca.SX.sym("par", len(derivation.PARAMETERS)), ca.SX.sym("T")
    k1 = model.rhs(x, u, theta, par)
    if method == "euler":
        x_next = x + period * k1
    elif method == "midpoint":
        x_next = x + period * model.rhs(x + period / 2 * k1, u, theta, par)
    else:
        k2 = model.rhs(x + period / 2 * k1, u, theta, par)
        k3 = model.rhs(x + period / 2 * k2, u, theta, par)
        k4 = model.rhs(x + period * k3, u, theta, par)
        x_next = x + period / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    inputs = [x, u, theta, par, period]
    return ca.Function("control_step", inputs, [x_next], ["x", "u", "theta", "par", "T"], ["x_next"], {"cse": True})
