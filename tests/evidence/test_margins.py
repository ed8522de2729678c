"""Measured sensitivity against a linearised loop, margins of hand-made curves, and the search for what is survived."""

import numpy as np
import pytest
from scipy import signal

from railrepro.car.component import SteppedCar
from railrepro.control.ndi import NDI
from railrepro.control.registry import guidance
from railrepro.evidence.uncertainty import margins
from railrepro.evidence.uncertainty.margins import FREQUENCIES
from railrepro.vehicle.parameters import load_vehicle

SPEED = 300.0
CONE = load_vehicle(**{"contact.profile": "cone"})  # linear, and it does not leave the middle without guidance


class RateFeedback:
    """du = -gain psi'."""

    def __init__(self, gain):
        self._gain = gain

    def gains(self):
        return {"k": self._gain}

    def torque(self, q):
        return -q.k * q.yaw_rate


def linearised(gain):
    """Torque of the front gear over a disturbance of both, from the car's linear model sampled at 1 kHz."""
    car = SteppedCar("T5", SPEED / 3.6, CONE)
    car.step([0.0] * 4, steps=300)
    model = car.linearise()
    turn = {"le": 1.0, "ri": -1.0}
    b = np.stack([sum(turn[s] * model.b[f"{gear}_{s}"].to_numpy() for s in turn) for gear in ("front", "rear")], axis=1)
    c = model.c.loc[["front.psidot_Ax", "rear.psidot_Ax"]].to_numpy()
    a, b, *_ = signal.cont2discrete((model.a.to_numpy(), b, c, np.zeros((2, 2))), 1e-3)
    found = []
    for z in np.exp(2j * np.pi * np.array(FREQUENCIES) * 1e-3):
        plant = c @ np.linalg.solve(z * np.eye(len(a)) - a, b)
        found.append(np.linalg.solve(np.eye(2) + gain * plant, np.ones(2))[0])
    return np.array(found)


@pytest.mark.parametrize("gain", [3e4, 6e4])
def test_sensitivity_is_that_of_the_linearised_loop(gain):
    found = margins.sensitivity(RateFeedback(gain), SPEED, vehicle=CONE)
    assert found == pytest.approx(linearised(gain), abs=0.01)
    assert np.abs(found - 1).max() > 0.3


def test_a_loop_that_is_unstable_has_none():
    assert margins.sensitivity(NDI(150.0, 150.0), 400.0) is None


def test_slow_controllers_are_disturbed_at_the_same_place():
    settings = {
        "q_psi_TrAx": 1.0,
        "q_psidot_Ax": 1e-3,
        "r": 1e-11,
        "q_terminal": 10.0,
        "period_ms": 10,
        "horizon_s": 0.4,
    }
    found = margins.sensitivity(guidance("nmpc", settings, {"solver": "rti"}), SPEED)
    assert 1.0 < np.abs(found).max() < 4.0
    assert abs(found[0]) < 0.7  # slow disturbances are countered


def test_margins_of_hand_made_curves():
    loop = np.array([-0.5, 1j, 3.0])
    found = 1 / (1 + loop)
    assert margins.disk_margin(found) == pytest.approx(1 / 1.5)  # the gain may double: (2 + a) / (2 - a) = 2


@pytest.mark.parametrize(("quantity", "breaks_at", "expected"), [("delay", 6.5e-3, 6e-3), ("gain", 1.55, 1.5)])
def test_the_largest_value_that_is_survived_is_found(quantity, breaks_at, expected):
    _, *searched, _ = margins.QUANTITIES[quantity]
    assert margins.survived(lambda value: value > breaks_at, *searched) == pytest.approx(expected)
    assert margins.survived(lambda value: False, *searched) == searched[1]
    assert np.isnan(margins.survived(lambda value: True, *searched))


@pytest.mark.parametrize(("setting", "perfect"), [("equal", True), ("loop", False)])
def test_what_is_worsened_reaches_the_run(setting, perfect, monkeypatch):
    driven = []
    lost = {"failed": True}, None
    monkeypatch.setattr(margins.Experiment, "measured", lambda experiment, _: driven.append(experiment) or lost)
    for quantity in margins.QUANTITIES:
        margins.largest(setting, "ndi", "poor", quantity)
    assert [one.sensors.get("perfect", False) for one in driven] == [perfect] * 3
    assert [one.scenario.name for one in driven] == ["adhesion_loss"] * 3 and driven[1].plant == {"drive.lag": 5e-3}
    assert driven[0].sensors["inverter.delay"] == 0.0 and driven[2].sensors["inverter.gain"] == 1.0
