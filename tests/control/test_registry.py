"""Names of controllers and set-ups: one home, known to figures, tables and studies."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from railrepro.control import registry
from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.ndi import NDI
from railrepro.evidence.report import figures


def test_every_controller_has_a_colour_a_line_and_a_marker_of_its_own():
    looks = [figures.LOOKS[name] for name in registry.SHOWN]
    assert len({look.color for look in looks}) == len({look.marker for look in looks}) == len(looks)
    assert len({look.label for look in looks}) == len(looks)
    for one, other in combinations(looks, 2):  # in grey: another line, or clearly darker
        lightness = [np.dot(to_rgb(look.color), (0.299, 0.587, 0.114)) for look in (one, other)]
        assert one.linestyle != other.linestyle or abs(lightness[0] - lightness[1]) > 0.25, (one.label, other.label)


def test_emphasis_multiplies_the_weight_of_the_torque_only():
    tuned = {"r": 2.0, "q_terminal": 3.0}
    assert registry.with_r_times(tuned, 10.0) == {"r": 20.0, "q_terminal": 3.0}
    assert registry.r_times(0.01) == "R x 0.01"
    assert registry.r_times(10.0, "NMPC") == "NMPC, R x 10"


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
    assert (nmpc.controller, nmpc.options, nmpc.settings.steps, nmpc.settings.period) == (
        NMPC,
        (("solver", "rti"),),
        7,
        8e-3,
    )
    for name, options in (("ltv_mpc", ()), ("ltv_mpc_printed", (("printed", True),))):
        linear = registry.guidance(name, TUNED)
        assert (linear.controller, linear.options) == (LTVMPC, options)
    poles = {"pole": 20.0, "frequency": 25.0, "damping": 0.8}
    assert registry.guidance("ndi", poles) == NDI(**poles)
    assert registry.guidance("ndi_feedforward", poles) == NDI(**poles, derivatives=3)
    assert registry.guidance("ndi_integral", poles | {"integral": 0.3}) == NDI(**poles, integral=0.3, derivatives=3)
    assert registry.guidance("ndi", poles, pole=9.0).pole == 9.0
