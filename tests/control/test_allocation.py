"""Integration rule: the paper's minimum and maximum, the whole differential torque, and the older fixed shares."""

import casadi as ca
import pytest
from hypothesis import given
from hypothesis import strategies as st

from railrepro.control.allocation import allocate

_INPUTS = [ca.SX.sym(name) for name in ("u_d", "du", "tau_max", "fixed_share")]
FUNCTION = ca.Function("allocate", _INPUTS, list(allocate(*_INPUTS)))
TORQUES = st.floats(-9000.0, 9000.0)


@given(u_d=TORQUES, du=TORQUES, share=st.just(0.0) | st.floats(0.01, 0.99))
def test_the_longitudinal_torque_takes_what_the_differential_torque_leaves(u_d, du, share):
    """Fixed shares do not lend to each other."""
    left, right, along, kept = (float(value) for value in FUNCTION(u_d, du, 4000.0, share))
    most = 4000.0 * share if share else 4000.0
    assert kept == pytest.approx(min(max(du, -most), most))
    rest = 4000.0 - (most if share else abs(kept))
    assert along == pytest.approx(min(max(u_d, -rest), rest), abs=1e-9)
    assert (left, right) == pytest.approx((along + kept, along - kept))
