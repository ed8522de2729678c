"""Creep forces and moment: published adhesion maxima, Kalker's limit, bounds, symmetry, half spaces."""

from dataclasses import astuple

import casadi as ca
import creep_errors
import numpy as np
import pytest

from railrepro.contact import creep
from railrepro.vehicle.parameters import load_vehicle

A, B = 6.28e-3, 7.02e-3  # the ellipse of the published maxima
LOAD, SHEAR = 78.5e3, 8.2e10
KALKER = creep.kalker_coefficients(A / B)
PEAKS = {
    "dry": ((40, 0.441, 0.031), (160, 0.366, 0.015), (400, 0.307, 0.0088)),
    "wet": ((40, 0.245, 0.084), (400, 0.174, 0.026)),
    "poor": ((40, 0.130, 0.059), (160, 0.114, 0.030), (400, 0.099, 0.019)),
    "very_poor": ((40, 0.072, 0.043), (400, 0.058, 0.014)),
}


def on_wheel(creepage, k_a=1.0, k_s=1.0):
    """Force along and across (N) and moment (N m) at creepages (-, -, 1/m) with a friction of 0.4."""
    arguments = (*creepage, LOAD, A, B, *KALKER, SHEAR, k_a, k_s, 0.4, 1.0, 0.0, 0.0)
    return np.array(creep.polach(*arguments), dtype=float)


@pytest.mark.parametrize(("name", "peaks"), PEAKS.items())
def test_adhesion_maxima(name, peaks):
    law = load_vehicle().adhesion[name]
    for speed, adhesion, slip in peaks:
        found = creep.adhesion_maximum(law, speed / 3.6, LOAD, A, B, KALKER, SHEAR)
        assert found == pytest.approx((adhesion, slip), rel=0.04)


def test_coefficients_are_those_of_the_table_and_c33_has_the_limits_of_slender_ellipses():
    assert np.ravel(creep.kalker_coefficients(1.0, 0.25)) == pytest.approx([4.12, 3.67, 1.47, 1.19], rel=1e-12)
    # Limits: pi^2 b/(16 (1 - nu) a) for small a/b; pi/4 for large a/b without Poisson's effect.
    for poisson in (0.0, 0.25):
        slender = np.pi**2 / 16 / (1 - poisson) / 0.1
        assert creep.kalker_coefficients(0.1, poisson)[3] == pytest.approx(slender, rel=0.05)
    assert creep.kalker_coefficients(10.0, 0.0)[3] == pytest.approx(np.pi / 4, rel=0.02)


def test_small_creepage_follows_kalker():
    unit, root = SHEAR * A * B, np.sqrt(A * B)
    along, across, spin = (on_wheel(creepage) for creepage in ((1e-6, 0, 0), (0, 1e-6, 0), (0, 0, 1e-4)))
    assert along == pytest.approx([-unit * KALKER[0] * 1e-6, 0.0, 0.0], rel=0.01, abs=1e-9)
    assert on_wheel((1e-6, 0, 0), 0.5, 0.3) == pytest.approx(0.4 * along, rel=0.01)
    assert across[1:] == pytest.approx(unit * 1e-6 * np.array([-KALKER[1], root * KALKER[2]]), rel=0.01)
    assert spin[1:] == pytest.approx(-unit * root * 1e-4 * np.array([KALKER[2], root * KALKER[3]]), rel=0.01)


LIMITS = {
    0.0: (0.022, 0.007, 0.03, 0.03),
    0.02: (0.025, 0.016, 0.05, 0.03),
    0.08: (0.042, 0.06, 0.09, 0.1),
    0.2: (0.072, 0.15, 0.24, 0.26),
}  # for each spin of `creep_errors`: mean errors of force and moment, largest errors


@pytest.mark.parametrize("ratio", creep_errors.RATIOS)
@pytest.mark.parametrize("spin", creep_errors.SPINS)
def test_force_and_moment_agree_with_half_spaces(ratio, spin):
    """Errors over friction (and the size of the patch)."""
    found = creep_errors.errors(ratio, spin)
    assert (np.ravel([found.mean(axis=0), found.max(axis=0)]) < LIMITS[spin]).all()


@pytest.mark.parametrize(("k_a", "k_s"), [(1.0, 1.0), (0.5, 1.0), (1.0, 0.4)])
def test_forces_are_bounded_never_drive_and_mirror_as_their_creepage_does(k_a, k_s):
    for creepage in np.random.default_rng(0).normal(0, (3e-3, 3e-3, 0.4), (100, 3)):
        found = on_wheel(creepage, k_a, k_s)
        assert np.hypot(*found[:2]) <= 0.4 * LOAD * 1.0001 and found @ creepage < 0
        for sides in ([-1, -1, -1], [1, -1, -1]):
            assert on_wheel(creepage * sides, k_a, k_s) == pytest.approx(found * sides)


def test_values_and_derivatives_stay_finite_at_rest_and_without_load():
    symbols = ca.SX.sym("s", 4)
    law = astuple(load_vehicle().adhesion["dry"])
    found = ca.vertcat(*creep.polach(*ca.vertsplit(symbols), A, B, *KALKER, SHEAR, *law, 0.0))
    both = ca.Function("f", [symbols], [found, ca.jacobian(found, symbols)])
    for state in ([0, 0, 0, 0], [0, 0, 0, LOAD], [0.1, 0, 0, 0], [0, 0, 0.5, LOAD], [1e-3, 0, 0.1, 1e-3]):
        assert all(np.isfinite(np.array(value)).all() for value in both(state))
