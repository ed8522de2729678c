"""A second derivation of the control model: Lagrange multipliers and automatic derivatives instead of projection.

Shares no code with `railrepro.model.derivation`; paper, eqs. (13) and (16).
"""

from functools import lru_cache

import casadi as ca
import numpy as np


@lru_cache
def _residuals(m, mx, jx, jz, jw, jd, r0, b, delta, ksz, kdz, ksx, kdx, g) -> ca.Function:
    """Residual pieces of the unreduced system: mass matrix, rest, constraint matrix and its rate term."""
    q, qd = ca.SX.sym("q", 5), ca.SX.sym("qd", 5)  # x, psi, y, wheel angles right and left (about y)
    tau, track = ca.SX.sym("tau", 2), ca.SX.sym("track", 9)
    kappa, phi0, dphi, psi_cb, kappa_cb, m_cb = track[1], track[2], track[3], track[6], track[7], track[8]
    psi_tr, phi_tr = track[0] + kappa * q[0], phi0 + dphi * q[0]
    relative, slope = q[1] - psi_tr, ca.tan(delta)
    gamma = slope / (b / 2 - r0 * slope)
    roll = phi_tr - gamma * q[2]
    z = delta * b / 2 * (1 / ca.cos(relative) - 1) - gamma * q[2] ** 2 - r0
    roll_rate, z_rate = ca.jtimes(roll, q, qd), ca.jtimes(z, q, qd)
    kinetic = (mx + m_cb / 2) * qd[0] ** 2 + m * (qd[2] ** 2 + z_rate**2) + jz * qd[1] ** 2 + jx * roll_rate**2
    for wheel in (3, 4):
        turn = ca.vertcat(roll_rate, qd[wheel] + qd[1] * ca.sin(roll), qd[1] * ca.cos(roll))
        kinetic += ca.dot(turn**2, ca.vertcat(jd, jw, jd))
    kinetic /= 2
    potential = (ksz * (q[1] - psi_cb) ** 2 + ksx * (gamma * q[2]) ** 2) / 2 - m * g * z
    damping = (kdz * (qd[1] - kappa_cb * qd[0]) ** 2 + kdx * (gamma * qd[2]) ** 2) / 2
    right, left = r0 + slope * q[2], r0 - slope * q[2]
    pull = ca.vertcat(tau[0] / right + tau[1] / left, (b / 2 + q[2]) * tau[1] / left - (b / 2 - q[2]) * tau[0] / right)
    momentum = ca.gradient(kinetic, qd)
    mass = ca.jacobian(momentum, qd)
    rest = ca.jtimes(momentum, q, qd) - ca.gradient(kinetic - potential, q) + ca.gradient(damping, qd)
    rest -= ca.vertcat(pull, 0, 0, 0)
    constraint = ca.vertcat(
        qd[2] - qd[0] * ca.sin(relative),
        qd[3] * right + qd[0] - (b / 2 - q[2]) * qd[1],
        qd[4] * left + qd[0] + (b / 2 + q[2]) * qd[1],
    )
    jacobian = ca.jacobian(constraint, qd)
    return ca.Function("unreduced", [q, qd, tau, track], [mass, rest, jacobian, ca.jtimes(constraint, q, qd)])


def accelerations(state, torque, theta, parameters) -> np.ndarray:
    """xddot (m/s2) and psiddot (rad/s2) with three multipliers; arguments as of the control model, (6,), (2,), (9,)."""
    b, radius, slope = parameters[7], parameters[6], np.tan(parameters[8])
    _, psi, v, psid, y, relative = state
    spins = -(v - (b / 2 - y) * psid) / (radius + slope * y), -(v + (b / 2 + y) * psid) / (radius - slope * y)
    q, qd = np.array([0.0, psi, y, 0.0, 0.0]), np.array([v, psid, v * np.sin(relative), *spins])
    mass, rest, jacobian, drift = (np.array(part) for part in _residuals(*parameters)(q, qd, torque, theta))
    system = np.block([[mass, jacobian.T], [jacobian, np.zeros((3, 3))]])
    return np.linalg.solve(system, -np.concatenate([rest, drift]).ravel())[:2]
