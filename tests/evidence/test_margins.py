"""Measured sensitivity against a linearised loop, margins of curves made by hand, and the longest delay."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from railrepro.car.component import SteppedCar
from railrepro.control.ndi import NDI
from railrepro.control.registry import tuned
from railrepro.evidence.uncertainty import margins
from railrepro.tuning import margin
from railrepro.vehicle.parameters import load_vehicle

SPEED = 300.0
CONE = load_vehicle(**{"contact.profile": "cone"})  # linear, and it stays on the centre line without guidance


def test_sensitivity_is_that_of_the_loop_with_the_linear_car():
    """Torque -gain psi' of the front gear over a disturbance of both gears; the car is sampled at 1 kHz."""
    gain, turn = 6e4, {"le": 1.0, "ri": -1.0}
    found = margin.sensitivity(SimpleNamespace(torque=lambda q: -gain * q.yaw_rate), SPEED, vehicle=CONE)
    car = SteppedCar("T5", SPEED / 3.6, CONE)
    car.step([0.0] * 4, steps=300)
    model = car.linearise()
    b = np.stack([sum(turn[s] * model.b[f"{gear}_{s}"].to_numpy() for s in turn) for gear in ("front", "rear")], axis=1)
    c = model.c.loc[["front.psidot_Ax", "rear.psidot_Ax"]].to_numpy()
    a, b, *_ = signal.cont2discrete((model.a.to_numpy(), b, c, np.zeros((2, 2))), 1e-3)
    for frequency, value in zip(margin.FREQUENCIES, found, strict=True):
        plant = c @ np.linalg.solve(np.exp(2j * np.pi * frequency * 1e-3) * np.eye(len(a)) - a, b)
        assert value == pytest.approx(np.linalg.solve(np.eye(2) + gain * plant, np.ones(2))[0], abs=0.01)
    assert np.abs(found - 1).max() > 0.3


def test_a_narrow_resonance_between_two_coarse_frequencies_is_seen():
    """Poles that a swarm once found: with lines at 5 and 6 Hz and none between, their margin seemed to be 0.65."""
    hidden = {"pole": 150.0, "frequency": 35.1, "damping": 0.074}
    assert margin.peaks("ndi_feedforward", hidden, 200.0)["disk_margin"] < 0.35


def test_an_unstable_loop_has_no_sensitivity():
    assert margin.sensitivity(NDI(150.0, 150.0), 400.0) is None


def test_slow_controllers_are_disturbed_at_the_same_point_of_the_loop():
    found = margin.sensitivity(tuned("nmpc", {"solver": "rti"}), SPEED)
    assert 1.0 < np.abs(found).max() < 4.0 and abs(found[0]) < 0.7  # slow disturbances are reduced


def test_the_margin_of_a_curve_made_by_hand():
    sensitivity = 1 / (1 + np.array([-0.5, 1j, 3.0]))
    assert margin.disk_margin(sensitivity) == pytest.approx(1 / 1.5)  # the gain may double: (2 + a) / (2 - a) = 2


@pytest.mark.parametrize(("setting", "perfect"), [("paper", True), ("loop", False)])
@pytest.mark.parametrize(("breaks_at", "expected"), [(6.5e-3, 6e-3), (1.0, 15e-3), (-1.0, np.nan)])
def test_the_longest_tolerated_delay(setting, perfect, breaks_at, expected, monkeypatch):
    def measured(run, _):
        assert run.sensors.get("perfect", False) == perfect and run.scenario.name == "adhesion_loss"
        return {"failed": run.sensors["inverter.delay"] > breaks_at}, None

    monkeypatch.setattr(margins.Experiment, "measured", measured)
    assert margins.delay_margin(setting, "ndi") == pytest.approx(expected, nan_ok=True)
