"""Names of controllers and set-ups: one home, known to figures, tables and studies."""

import pytest

from railrepro.control import registry
from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.ndi import NDI


def test_emphasis_multiplies_the_weight_of_the_torque_only():
    tuned = {"r": 2.0, "q_terminal": 3.0}
    assert registry.with_r_times(tuned, 10.0) == {"r": 20.0, "q_terminal": 3.0}


TUNED = {"q_psi_TrAx": 3.0, "q_psidot_Ax": 0.2, "r": 1e-11, "q_terminal": 5.0, "period_ms": 8.0, "horizon_s": 0.3}


def test_tuning_parameters_become_weights_period_and_horizon():
    settings = registry.mpc_settings(TUNED)
    assert settings.q_diag == (0.0, 0.0, 0.0, 0.2, 1.0, 3.0)
    assert (settings.r, settings.q_terminal, settings.period) == (1e-11, 5.0, pytest.approx(8e-3))
    assert settings.steps == 38
    assert TUNED["period_ms"] == 8.0


@pytest.mark.parametrize(("horizon", "steps"), [(0.01, 5), (0.039, 5), (0.049, 6), (0.796, 100), (0.81, 100)])
def test_the_horizon_has_five_to_a_hundred_steps(horizon, steps):
    assert registry.mpc_settings(TUNED | {"horizon_s": horizon}).steps == steps


def test_guidance_of_each_method():
    nmpc = registry.guidance("nmpc", TUNED, {"solver": "rti"}, steps=7)
    assert (nmpc.controller, nmpc.options) == (NMPC, (("solver", "rti"),))
    assert (nmpc.settings.steps, nmpc.settings.period) == (7, 8e-3)
    for name, options in (("ltv_mpc", ()), ("ltv_mpc_printed", (("printed", True),))):
        linear = registry.guidance(name, TUNED)
        assert (linear.controller, linear.options) == (LTVMPC, options)
    poles = {"pole": 20.0, "frequency": 25.0, "damping": 0.8}
    assert registry.guidance("ndi", poles) == NDI(**poles)
    assert registry.guidance("ndi_feedforward", poles) == NDI(**poles, derivatives=3)
    assert registry.guidance("ndi_integral", poles | {"integral": 0.3}) == NDI(**poles, integral=0.3, derivatives=3)
    assert registry.guidance("ndi", poles, pole=9.0).pole == 9.0
