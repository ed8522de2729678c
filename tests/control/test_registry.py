"""Names of controllers: from tuning parameters to settings and guidance."""

import pytest

from railrepro.control import registry
from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.ndi import NDI

TUNED = {"q_psi_TrAx": 3.0, "q_psidot_Ax": 0.2, "r": 1e-11, "q_terminal": 5.0, "period_ms": 8.0, "horizon_s": 0.3}


def test_tuning_parameters_become_weights_period_and_horizon():
    settings = registry.mpc_settings(registry.with_r_times(TUNED, 10.0))
    assert settings.q_diag == (0.0, 0.0, 0.0, 0.2, 1.0, 3.0)
    assert (settings.r, settings.q_terminal, settings.period) == (pytest.approx(1e-10), 5.0, pytest.approx(8e-3))
    lengths = [registry.mpc_settings(TUNED | {"horizon_s": horizon}).steps for horizon in (0.01, 0.049, 0.3, 0.81)]
    assert lengths == [5, 6, 38, 100]


def test_guidance_of_each_method():
    nmpc = registry.guidance("nmpc", TUNED, {"solver": "rti"}, steps=7)
    assert (nmpc.controller, nmpc.options, nmpc.settings.steps) == (NMPC, (("solver", "rti"),), 7)
    for name, options in (("ltv_mpc", ()), ("ltv_mpc_printed", (("printed", True),))):
        linear = registry.guidance(name, TUNED)
        assert (linear.controller, linear.options) == (LTVMPC, options)
    poles = {"pole": 20.0, "frequency": 25.0, "damping": 0.8}
    assert registry.guidance("ndi", poles, frequency=9.0) == NDI(20.0, 9.0, 0.8)
    assert registry.guidance("ndi_feedforward", poles) == NDI(**poles, rates=True)
    assert registry.guidance("ndi_integral", poles | {"integral": 0.3}) == NDI(**poles, integral=0.3, rates=True)
