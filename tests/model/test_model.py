"""Control model: second derivation, energy, symmetry, limits, discrepancies, discretisation."""

import numpy as np
import pytest

from railrepro.data import InputError
from railrepro.model import derivation, linearised, multipliers
from railrepro.model.control_model import control_model, discretise, kept_as_printed
from railrepro.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


@pytest.fixture(scope="module")
def corrected(vehicle):
    found = control_model()
    return lambda x, u, theta: np.array(found.rhs(x, u, theta, found.parameter_vector(vehicle))).ravel()


def random_case(generator, vehicle):
    psi_r = generator.normal(0, 0.01)
    x = np.array(
        [
            0,
            0.2 + psi_r,
            generator.uniform(2, 110),
            generator.normal(0, 0.1),
            generator.normal(0, 4e-3),
            psi_r,
        ]
    )
    phi, dphi = generator.normal(0, 0.08), generator.normal(0, 2e-4)
    theta = np.array([0.2, generator.normal(0, 1e-3), phi, dphi, 0, 0, 0.19, 1e-4, vehicle.body.mass])
    return x, generator.normal(0, 2000, 2), theta


def test_projection_and_multipliers_give_the_same_accelerations(vehicle, corrected):
    generator = np.random.default_rng(1)
    for _ in range(20):
        case = random_case(generator, vehicle)
        ours, other = corrected(*case)[2:4], multipliers.accelerations(*case, vehicle)
        assert np.allclose(ours, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_mirror_symmetry(vehicle, corrected):
    x, u, theta = random_case(np.random.default_rng(2), vehicle)
    odd, signs = np.array([1, -1, 1, -1, -1, -1]), np.array([-1, -1, -1, -1, 1, 1, -1, -1, 1])
    assert np.allclose(corrected(odd * x, u[::-1], signs * theta), odd * corrected(x, u, theta), rtol=1e-12, atol=1e-12)


def test_equal_torques_accelerate_the_effective_mass(vehicle, corrected):
    x, theta = np.array([0, 0, 50.0, 0, 0, 0]), np.zeros(9)
    theta[8] = vehicle.body.mass
    expected = 2 * 1000 / vehicle.wheel.radius / vehicle.effective_longitudinal_mass
    assert corrected(x, [1000, 1000], theta)[2] == pytest.approx(expected, rel=1e-9)


def test_more_torque_on_the_left_turns_to_the_right(vehicle, corrected):
    x, theta = np.array([0, 0, 50.0, 0, 0, 0]), np.zeros(9)
    theta[8] = vehicle.body.mass
    yaw = corrected(x, [-100, 100], theta)[3]
    moment = vehicle.gear.contact_base / vehicle.wheel.radius * 100
    assert yaw == pytest.approx(moment / vehicle.effective_yaw_inertia, rel=1e-9)


def test_power_of_the_torques_becomes_energy_and_dissipation(vehicle):
    """Along a straight level track d(E_T + E_V)/dt must equal motor power less damper power."""
    import casadi as ca
    import sympy as sp

    d = derivation
    level = {
        d.psi_Tr: 0,
        d.kappa: 0,
        d.phi_Tr: 0,
        d.dphi: 0,
        d.psi_CB: 0,
        d.kappa_CB: 0,
        d.m_CB: vehicle.body.mass,
    }
    found = control_model()
    numbers = dict(zip(d.parameters, found.parameter_vector(vehicle), strict=True))
    kinematics = d.constraints(frozenset())
    energy = (
        (d.kinetic_energy(frozenset()) + d.potential_energy(frozenset()))
        .subs(kinematics.rates)
        .subs(level)
        .subs(numbers)
    )
    damping = 2 * d.dissipation(frozenset()).subs(kinematics.rates).subs(level).subs(numbers)
    symbols = [d.psi, d.y, d.xd, d.psid]
    values = sp.lambdify(symbols, [*(sp.diff(energy, s) for s in symbols), damping])
    psi, y, v, psid = 0.004, 0.003, 60.0, 0.05
    x, u = np.array([0, psi, v, psid, y, psi]), np.array([-300.0, 900.0])
    theta = np.zeros(9)
    theta[8] = vehicle.body.mass
    dx = np.array(found.rhs(x, u, theta, found.parameter_vector(vehicle))).ravel()
    slopes = np.array(values(psi, y, v, psid))
    change = slopes[:4] @ np.array([psid, v * np.sin(psi), dx[2], dx[3]])
    slope = np.tan(vehicle.wheel.cone_angle)
    half, r0 = vehicle.gear.contact_base / 2, vehicle.wheel.radius
    spin_ri = (v - (half - y) * psid) / (r0 + slope * y)
    spin_le = (v + (half + y) * psid) / (r0 - slope * y)
    power = u[0] * spin_ri + u[1] * spin_le
    assert change + slopes[4] == pytest.approx(power, rel=1e-9)
    assert isinstance(found.rhs, ca.Function)


def test_spurious_yaw_stiffness_of_the_printed_substitution(vehicle):
    numbers = dict(zip(derivation.parameters, control_model().parameter_vector(vehicle), strict=True))
    speed = {"v": 280 / 3.6, derivation.m_CB: vehicle.body.mass}
    straight, printed = (linearised.yaw_equation(frozenset(kept))["psi"] for kept in ((), ("D1",)))
    assert float(straight.subs(numbers).subs(speed)) < 0
    assert float(printed.subs(numbers).subs(speed)) > 10e6


def test_discretisations_converge_with_their_orders(vehicle):
    found = control_model()
    par = found.parameter_vector(vehicle)
    x, theta = np.array([0, 1e-3, 60.0, 5e-3, 1e-3, 1e-3]), np.zeros(9)
    theta[8] = vehicle.body.mass

    def after(method, steps):
        step, state = discretise(found, method), x
        for _ in range(steps):
            state = np.array(step(state, [-500, 500], theta, par, 0.2 / steps)).ravel()
        return state[4]

    exact = after("rk4", 2000)
    for method, order in (("euler", 1), ("midpoint", 2), ("rk4", 4)):
        coarse, fine = (abs(after(method, n) - exact) for n in (20, 40))
        assert np.log2(coarse / fine) == pytest.approx(order, abs=0.35)


def test_a_variant_names_what_it_keeps_as_printed():
    """D4 belongs to the forecast: a variant may name it, the model does not know it."""
    assert kept_as_printed("corrected") == control_model().discrepancies == frozenset()
    assert kept_as_printed("printed") == {"D1", "D2", "D3", "D4", "D7"}
    assert control_model("printed").discrepancies == {"D1", "D2", "D3", "D7"}
    assert kept_as_printed("D4, D1") == {"D1", "D4"}
    assert control_model("D4").discrepancies == frozenset()
    assert control_model(discrepancies=["D3", "D4"]).discrepancies == {"D3"}


def test_parameters_of_the_model_by_hand():
    """Residual inertias are without both wheels, 1500 and 2000 less 2 x 32 kg m2; two springs and a bar in roll."""
    found = dict(zip(control_model().parameters, control_model().parameter_vector(load_vehicle()), strict=True))
    expected = {"m": 3000.0, "m_x": 3000.0, "J_x": 1436.0, "J_z": 1936.0, "J_Wy": 60.0, "J_Wz": 32.0, "r_0": 0.46}
    expected |= {"b": 1.5, "delta_0": 0.025, "k_sz": 60e3, "k_dz": 10e3, "g": 9.81}
    expected |= {"k_sx": 2 * 256_500.0 + 1e6, "k_dx": 2 * 16_500.0 + 10e3}
    assert found == pytest.approx(expected)


def test_unknown_names_are_refused():
    with pytest.raises(InputError, match="variant"):
        control_model("improved")
    with pytest.raises(InputError, match="D9"):
        control_model(discrepancies=["D9"])
    with pytest.raises(InputError, match="discretisation"):
        discretise(control_model(), "heun")
