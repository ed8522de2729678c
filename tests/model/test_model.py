"""Control model: second derivation, energy, symmetry, limits, discrepancies, discretisation."""

import multipliers
import numpy as np
import pytest

from railrepro.data import InputError
from railrepro.model import derivation
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
    speed, rate, y = generator.uniform(2, 110), generator.normal(0, 0.1), generator.normal(0, 4e-3)
    x = np.array([0, 0.2 + psi_r, speed, rate, y, psi_r])
    phi, dphi = generator.normal(0, 0.08), generator.normal(0, 2e-4)
    theta = np.array([0.2, generator.normal(0, 1e-3), phi, dphi, 0, 0, 0.19, 1e-4, vehicle.body.mass])
    return x, generator.normal(0, 2000, 2), theta


def test_projection_and_multipliers_give_the_same_accelerations(vehicle, corrected):
    generator, parameters = np.random.default_rng(1), control_model().parameter_vector(vehicle)
    for _ in range(20):
        case = random_case(generator, vehicle)
        ours, other = corrected(*case)[2:4], multipliers.accelerations(*case, parameters)
        assert np.allclose(ours, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_equal_torques_accelerate_the_effective_mass_and_more_on_the_left_turns_to_the_right(vehicle, corrected):
    x, theta = np.array([0, 0, 50.0, 0, 0, 0]), np.zeros(9)
    theta[8] = vehicle.body.mass
    along, turning = corrected(x, [900, 1100], theta)[2:4]
    assert along == pytest.approx(2000 / vehicle.wheel.radius / vehicle.effective_longitudinal_mass, rel=1e-9)
    moment = vehicle.gear.contact_base / vehicle.wheel.radius * 100
    assert turning == pytest.approx(moment / vehicle.effective_yaw_inertia, rel=1e-9)


def test_spurious_yaw_stiffness_of_the_printed_substitution(vehicle):
    numbers = dict(zip(derivation.parameters, control_model().parameter_vector(vehicle), strict=True))
    speed = {"v": 280 / 3.6, derivation.m_CB: vehicle.body.mass}
    straight, printed = (derivation.yaw_equation(frozenset(kept))["psi"] for kept in ((), ("D1",)))
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
    assert control_model("D3,D4").discrepancies == {"D3"}


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
    with pytest.raises(InputError, match="discretisation"):
        discretise(control_model(), "heun")
