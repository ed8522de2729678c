"""Symbolic derivation of the control-oriented model, as printed in the paper and corrected.

Unreduced coordinates are path x, yaw psi, lateral displacement y and the two wheel angles. Rolling and the lateral
kinematics are non-holonomic constraints on their rates. Jourdain's principle projects the unreduced equations on the
two free rates (corrected); inserting the constraints into the energies before applying Lagrange is what the paper
prints (discrepancy D1). Serves the paper's section Control-Oriented Model.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import sympy as sp

from railrepro.model.parameters import PARAMETERS

m, m_x, J_x, J_z, J_Wy, J_Wz, r_0, b, delta_0, k_sz, k_dz, k_sx, k_dx, g = parameters = sp.symbols(
    " ".join(PARAMETERS), positive=True
)
x, psi, y, th_ri, th_le = coordinates = sp.symbols("x psi y theta_ri theta_le")
xd, psid, yd, thd_ri, thd_le = rates = sp.symbols(r"\dot{x} \dot{psi} \dot{y} \dot{theta}_ri \dot{theta}_le")
xdd, psidd = accelerations = sp.symbols(r"\ddot{x} \ddot{psi}")
psi_Tr, kappa, phi_Tr, dphi, eps_Tr, deps, psi_CB, kappa_CB, m_CB = theta = sp.symbols(
    "psi_Tr kappa phi_Tr phi_Tr' epsilon_Tr epsilon_Tr' psi_CB kappa_CB m_CB"
)
tau_ri, tau_le = torques = sp.symbols("tau_ri tau_le")
LATEX = {psid: r"\dot{\psi}", psidd: r"\ddot{\psi}", dphi: r"\phi_{Tr}'", deps: r"\epsilon_{Tr}'"} | {
    thd_ri: r"\dot{\theta}_{ri}",
    thd_le: r"\dot{\theta}_{le}",
}
"""TeX of symbols whose names are no TeX: `sympy.init_printing(symbol_names=LATEX)`."""

psi_r = psi - psi_Tr
gamma = sp.tan(delta_0) / (b / 2 - r_0 * sp.tan(delta_0))
roll = -gamma * y + phi_Tr
height = delta_0 * b / 2 * (1 / sp.cos(psi_r) - 1) - gamma * y**2 - r_0
radius = {"ri": r_0 + sp.tan(delta_0) * y, "le": r_0 - sp.tan(delta_0) * y}
arm = {"ri": b / 2 - y, "le": b / 2 + y}

_TRACK = {psi_Tr: kappa, phi_Tr: dphi}


def along_track(expression: sp.Expr) -> sp.Expr:
    """Derivative of an expression by the path x (per m), track angles included, whose slopes count as constant."""
    return sum((sp.diff(expression, angle) * slope for angle, slope in _TRACK.items()), sp.diff(expression, x))


def time_derivative(expression: sp.Expr, rate_of_rates: dict) -> sp.Expr:
    """Total time derivative of an expression in coordinates and rates; `rate_of_rates`: {rate symbol: acceleration}."""
    total = along_track(expression) * xd
    for coordinate, rate in zip(coordinates[1:], rates[1:], strict=True):
        total += sp.diff(expression, coordinate) * rate
    return total + sum(sp.diff(expression, rate) * change for rate, change in rate_of_rates.items())


def constraints(discrepancies: frozenset[str]) -> dict[sp.Symbol, sp.Expr]:
    """Rates of y (m/s) and both wheel angles (rad/s) by symbol, as expressions in the rates of x and psi.

    From lateral kinematics and ideal rolling; `discrepancies` as of `equations`. Source: eqs. (9) and (12).
    """
    turning = psid + kappa * xd if "D3" in discrepancies else psid
    spin_ri = -(xd - arm["ri"] * turning) / radius["ri"]
    spin_le = -(xd + arm["le"] * turning) / radius["le"]
    return {yd: xd * sp.sin(psi_r), thd_ri: spin_ri, thd_le: spin_le}


def wheel_rotation(spin: sp.Expr) -> sp.Matrix:
    """Absolute angular velocity (3, 1) of a wheel in roll, axle and yaw axis (rad/s), from its spin (rad/s)."""
    roll_rate = -gamma * yd + dphi * xd
    return sp.Matrix([roll_rate, spin + psid * sp.sin(roll), psid * sp.cos(roll)])


def kinetic_energy(discrepancies: frozenset[str]) -> sp.Expr:
    """Kinetic energy (J) in unreduced rates; `discrepancies` as of `equations`. Source: eq. (13a)."""
    height_rate = sp.diff(height, psi) * (psid - kappa * xd) + sp.diff(height, y) * yd
    roll_rate = -gamma * yd + dphi * xd
    inertia = sp.diag(J_Wz, J_Wy, J_Wz)
    w_ri, w_le = wheel_rotation(thd_ri), wheel_rotation(thd_le)
    if "D2" in discrepancies:
        wheels = ((w_ri + w_le).T * inertia * (w_ri + w_le))[0]
    else:
        wheels = (w_ri.T * inertia * w_ri)[0] + (w_le.T * inertia * w_le)[0]
    carried = (m_x + m_CB / 2) * xd**2 + m * (yd**2 + height_rate**2)
    return (carried + J_z * psid**2 + J_x * roll_rate**2 + wheels) / 2


def potential_energy(discrepancies: frozenset[str]) -> sp.Expr:
    """Potential energy (J) of both springs and weight; `discrepancies` as of `equations`. Source: eq. (13b)."""
    deflection = roll if "D7" in discrepancies else roll - phi_Tr
    return (k_sz * (psi - psi_CB) ** 2 + k_sx * deflection**2) / 2 - m * g * height


def dissipation(discrepancies: frozenset[str]) -> sp.Expr:
    """Half the power (W) of yaw and roll damper; `discrepancies` as of `equations`. Source: eq. (13c)."""
    roll_rate = -gamma * yd + (dphi * xd if "D7" in discrepancies else 0)
    return (k_dz * (psid - kappa_CB * xd) ** 2 + k_dx * roll_rate**2) / 2


def generalised_forces() -> tuple[sp.Expr, sp.Expr]:
    """Force along x (N), moment about z (N m) of traction-positive torques. Source: eq. (17), opposite torque sign."""
    pull = {"ri": tau_ri / radius["ri"], "le": tau_le / radius["le"]}
    return pull["ri"] + pull["le"], arm["le"] * pull["le"] - arm["ri"] * pull["ri"]


@dataclass(frozen=True)
class Equations:
    """Equations of motion M a + h = 0 in the accelerations a = (xdd, psidd): `mass` M (2, 2), `rest` h (2, 1)."""

    mass: sp.Matrix
    rest: sp.Matrix


@lru_cache
def equations(discrepancies: frozenset[str] = frozenset()) -> Equations:
    """Derive the equations of motion with discrepancies such as "D1" kept as printed; none: corrected model."""
    dependent = constraints(discrepancies)
    t, v, d = (f(discrepancies) for f in (kinetic_energy, potential_energy, dissipation))
    free = {xd: xdd, psid: psidd}
    changes = free | {rate: time_derivative(e, free).subs(yd, dependent[yd]) for rate, e in dependent.items()}
    forces = generalised_forces()
    if "D1" in discrepancies:
        t, d = t.subs(dependent), d.subs(dependent)
        derivatives = (along_track, lambda e: sp.diff(e, psi))
        residual = [
            time_derivative(sp.diff(t, rate), free) - partial(t) + partial(v) + sp.diff(d, rate) - force
            for rate, partial, force in zip((xd, psid), derivatives, forces, strict=True)
        ]
    else:
        residual = [-force for force in forces]
        for coordinate, rate in zip(coordinates, rates, strict=True):
            by_t, by_v = (along_track(e) if coordinate == x else sp.diff(e, coordinate) for e in (t, v))
            inertia = time_derivative(sp.diff(t, rate), changes) - by_t
            equation = inertia + by_v + sp.diff(d, rate)
            velocity = dependent.get(rate, rate)
            for i, own in enumerate((xd, psid)):
                residual[i] += equation * sp.diff(velocity, own)
    residual = sp.Matrix(residual).subs(dependent)
    mass = residual.jacobian(sp.Matrix(accelerations))
    return Equations(mass, residual.subs({xdd: 0, psidd: 0}))


@lru_cache
def yaw_equation(discrepancies: frozenset[str] = frozenset()) -> dict[str, sp.Expr]:
    """Coefficients of the yaw equation, linearised about straight centred running at speed v, as SymPy expressions.

    Returns
    -------
    dict
        inertia * psidd = sum of coefficient * quantity, with the keys "inertia" (kg m2) and, for the quantities,
        "torque" (differential torque; -), "psi" (N m/rad), "psid" (N m s/rad), "y" (N), "roll rate" (N m s/rad).
    """
    found, v = equations(discrepancies), sp.Symbol("v")
    small = (psi, psid, y, yd, psi_Tr, kappa, phi_Tr, dphi, psi_CB, kappa_CB, *torques)
    straight = dict.fromkeys(small, 0) | {xd: v}

    def slope(quantity: sp.Symbol) -> sp.Expr:
        return sp.expand(-sp.diff(found.rest[1], quantity).subs(straight))

    return {
        "inertia": sp.expand(found.mass[1, 1].subs(straight)),
        "torque": slope(tau_le) - slope(tau_ri),
        "psi": slope(psi),
        "psid": slope(psid),
        "y": slope(y),
        "roll rate": sp.expand(slope(dphi) / v),
    }
