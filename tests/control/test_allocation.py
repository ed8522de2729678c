"""Integration rule: the paper's minimum and maximum, the whole differential torque, and the older fixed shares."""

import casadi as ca
import pytest

from railrepro.control.allocation import allocate

_INPUTS = [ca.SX.sym(name) for name in ("u_d", "du", "tau_max", "fixed_share")]
FUNCTION = ca.Function("allocate", _INPUTS, list(allocate(*_INPUTS)))


@pytest.mark.parametrize(
    ("u_d", "du", "long", "kept", "fixed_share"),
    [
        (1000.0, -500.0, 1000.0, -500.0, 0.0),
        (3600.0, 500.0, 3500.0, 500.0, 0.0),
        (3600.0, -500.0, 3500.0, -500.0, 0.0),
        (-3600.0, -500.0, -3500.0, -500.0, 0.0),
        (-1000.0, 500.0, -1000.0, 500.0, 0.0),
        (0.0, 500.0, 0.0, 500.0, 0.0),
        (9000.0, 4000.0, 0.0, 4000.0, 0.0),
        (1000.0, 5000.0, 0.0, 4000.0, 0.0),
        (-1000.0, -5000.0, 0.0, -4000.0, 0.0),
        (4000.0, 100.0, 3000.0, 100.0, 0.25),  # fixed shares do not lend to each other
        (-4000.0, 100.0, -3000.0, 100.0, 0.25),
        (2000.0, 1500.0, 2000.0, 1000.0, 0.25),
        (2000.0, -1500.0, 2000.0, -1000.0, 0.25),
    ],
)
def test_the_longitudinal_torque_takes_what_the_differential_torque_leaves(u_d, du, long, kept, fixed_share):
    found = [float(value) for value in FUNCTION(u_d, du, 4000.0, fixed_share)]
    assert found == pytest.approx([long + kept, long - kept, long, kept])
