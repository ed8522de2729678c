"""Control model: second derivation, energy, symmetry, limits, discrepancies, discretisation."""

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

from railrepro.model.control_model import control_model, discretise, kept_as_printed, parameter_vector
from railrepro.model.parameters import PARAMETERS
from railrepro.vehicle.parameters import load_vehicle

V = load_vehicle()
PAR = parameter_vector(V)
LEVEL = [0.0] * 8 + [V.body.mass]


@lru_cache
def _residuals(m, mx, jx, jz, jw, jd, r0, b, delta, ksz, kdz, ksx, kdx, g):
    """Unreduced system by a second derivation, which shares no code with the library: mass matrix, rest, constraint
    matrix and its rate term. Source: eqs. (13) and (16)."""
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


def by_multipliers(state, torque, theta, parameters):
    """xddot (m/s2) and psiddot (rad/s2) with three multipliers; arguments as of the control model, (6,), (2,), (9,)."""
    b, radius, slope = parameters[7], parameters[6], np.tan(parameters[8])
    _, psi, v, psid, y, relative = state
    spins = -(v - (b / 2 - y) * psid) / (radius + slope * y), -(v + (b / 2 + y) * psid) / (radius - slope * y)
    q, qd = np.array([0.0, psi, y, 0.0, 0.0]), np.array([v, psid, v * np.sin(relative), *spins])
    mass, rest, jacobian, drift = (np.array(part) for part in _residuals(*parameters)(q, qd, torque, theta))
    system = np.block([[mass, jacobian.T], [jacobian, np.zeros((3, 3))]])
    return np.linalg.solve(system, -np.concatenate([rest, drift]).ravel())[:2]


def random_case(generator):
    psi_r, rate, y, phi, dphi, kappa = generator.normal(0, [0.01, 0.1, 4e-3, 0.08, 2e-4, 1e-3])
    x = np.array([0, 0.2 + psi_r, generator.uniform(2, 110), rate, y, psi_r])
    return x, generator.normal(0, 2000, 2), np.array([0.2, kappa, phi, dphi, 0, 0, 0.19, 1e-4, V.body.mass])


def test_projection_and_multipliers_give_the_same_accelerations():
    generator = np.random.default_rng(1)
    for _ in range(20):
        case = random_case(generator)
        ours, other = control_model()(*case, PAR).nonzeros()[2:4], by_multipliers(*case, PAR)
        assert np.allclose(ours, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_the_printed_substitution_pushes_a_yawed_gear_away():
    """By more than 10 MN m/rad at 280 km/h, where springs and conicity pull it back."""
    yawed = [0, 1e-3, 280 / 3.6, 0, 0, 1e-3]
    corrected, printed = (control_model(of)(yawed, [0, 0], LEVEL, PAR)[3] for of in ("corrected", "D1"))
    assert corrected < 0 and V.effective_yaw_inertia * printed > 1e-3 * 10e6


@pytest.mark.parametrize(("method", "order"), [("euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_discretisations_converge_with_their_orders_and_know_their_derivatives(method, order):
    def after(method, steps, yawed=0.0, u=(-500, 500)):
        x = 0, 1e-3, 60.0, 5e-3, 1e-3, 1e-3 + yawed
        step = discretise(control_model(), method)
        for _ in range(steps):
            x, *by = step(x, u, LEVEL, PAR, 0.2 / steps)
        return np.array(x).ravel(), by

    exact = after("rk4", 2000)[0]
    coarse, fine = (abs(after(method, n)[0] - exact)[4] for n in (20, 40))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.35)
    at, (by_x, by_u) = after(method, 1)
    turned, driven = after(method, 1, yawed=1e-6), after(method, 1, u=(-500, 501))
    assert (turned[0] - at) / 1e-6 == pytest.approx(np.array(by_x)[:, 5], rel=1e-3, abs=1e-6)
    assert driven[0] - at == pytest.approx(np.array(by_u)[:, 1], rel=1e-3, abs=1e-9)


def test_a_variant_names_what_it_keeps_as_printed():
    """D4 belongs to the forecast: a variant may name it, the model does not know it."""
    assert kept_as_printed("corrected") == frozenset()
    assert kept_as_printed("printed") == {"D1", "D2", "D3", "D4", "D7"}
    assert kept_as_printed("D4, D1") == {"D1", "D4"}
    case = random_case(np.random.default_rng(2))
    found = {of: control_model(of)(*case, PAR).nonzeros() for of in ("corrected", "D4", "D3", "D3,D4", "D7", "printed")}
    assert found["D4"] == found["corrected"] != found["D3"] == found["D3,D4"] != found["D7"] != found["printed"]


def test_parameters_of_the_model_by_hand():
    """Residual inertias are without both wheels, 1500 and 2000 less 2 x 32 kg m2; two springs and a bar in roll."""
    expected = {"m": 3000.0, "m_x": 3000.0, "J_x": 1436.0, "J_z": 1936.0, "J_Wy": 60.0, "J_Wz": 32.0, "r_0": 0.46}
    expected |= {"b": 1.5, "delta_0": 0.025, "k_sz": 60e3, "k_dz": 10e3, "g": 9.81}
    expected |= {"k_sx": 2 * 256_500.0 + 1e6, "k_dx": 2 * 16_500.0 + 10e3}
    assert dict(zip(PARAMETERS, PAR, strict=True)) == pytest.approx(expected)
