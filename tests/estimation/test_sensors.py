"""Sensors and delay lines by themselves: noise, bias, resolution, latency."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from railrepro.estimation import sensors
from railrepro.estimation.sensors import LONGEST, SIGNALS, Latency, Readings, SensorMemory, Signals, load_loop
from railrepro.quantities import pack, symbols

LOOP = load_loop()
EXACT = LOOP.perfect()
TRUTH = {"y_ahead": 2e-3, "y_behind": 1e-3, "psidot_Ax": 0.02, "w_le": 100.0, "w_ri": 99.0, "v": 45.0, "p": 300.0}


def readings(cycles, loop, seed=0, gear=0, move=lambda k, name: TRUTH[name]):
    """Readings of a gear over some cycles, shape (cycles, signals); `move` maps tick and signal to its value."""
    ticks, (truth_, truth), (memory_, memory) = ca.SX.sym("ticks"), symbols(Signals, "t"), symbols(SensorMemory, "m")
    read, lines = sensors.sense(truth, ticks, gear, Readings(loop, seed).gains(gear), memory)
    following = SensorMemory(**lines, tau_le=memory.tau_le, tau_ri=memory.tau_ri)
    outputs = [ca.vertcat(*pack(values)) for values in (read, following)]
    step = ca.Function("step", [truth_, ticks, memory_], outputs)
    rows, state = np.empty((cycles, len(SIGNALS))), np.zeros(memory_.numel())
    for k in range(cycles):
        row, state = step([move(k, name) for name in SIGNALS], k, state)
        rows[k] = np.array(row).ravel()
    return rows


def test_noise_has_the_stated_size_and_a_bias_stays():
    loop = load_loop(**{"lateral.resolution": 0.0, "gyro.resolution": 0.0})
    rows = readings(6000, loop, seed=4)
    spread = dict(zip(SIGNALS, rows.std(axis=0), strict=True))
    stated = {"y_ahead": 2e-4, "y_behind": 2e-4, "psidot_Ax": 4e-3, "w_le": 0.05, "w_ri": 0.05, "v": 0.02, "p": 0.0}
    assert spread == pytest.approx(stated, rel=0.04, abs=1e-9)
    gains = Readings(loop, 4).gains(0)
    largest = {"y_ahead": 2e-4, "y_behind": 2e-4, "psidot_Ax": 1e-3, "p": 1.0}
    for i, (name, value) in enumerate(TRUTH.items()):
        bias, spread = getattr(gains, name).bias, stated[name] / np.sqrt(6000)
        assert abs(bias) <= largest.get(name, 0)
        assert rows[:, i].mean() - value == pytest.approx(bias, abs=4 * spread + 1e-9)
    assert gains.y_ahead.bias != 0 and gains.p.bias != 0


def test_runs_and_gears_draw_their_own_noise():
    cases = (1, 0), (2, 0), (1, 1)
    one, *others = (readings(50, LOOP, *case) for case in cases)
    assert np.array_equal(one, readings(50, LOOP, *cases[0]))
    biases = [Readings(LOOP, seed).gains(gear).y_ahead.bias for seed, gear in cases]
    assert np.abs(np.diff([*biases, biases[0]])).min() > 1e-6
    for other in others:
        assert np.abs(np.corrcoef(one[:, 3], other[:, 3])[0, 1]) < 0.4


def test_noise_is_white_and_signals_are_independent():
    ticks, seed = ca.SX.sym("ticks"), ca.SX.sym("seed")
    noise = ca.Function("noise", [seed, ticks], [ca.vertcat(*(sensors.gaussian(seed, c, ticks) for c in range(14)))])
    values = np.array(noise.map(8000)(ca.DM.ones(1, 8000), np.arange(8000)[None, :])).T
    assert values.mean(axis=0) == pytest.approx(0.0, abs=0.04)
    assert values.std(axis=0) == pytest.approx(1.0, abs=0.03)
    assert np.abs(np.corrcoef(values.T) - np.eye(14)).max() < 0.05
    for lag in (1, 2, 3, 7, 100):
        assert np.abs(np.mean(values[lag:] * values[:-lag], axis=0)).max() < 0.05


def test_noise_has_the_same_bits_everywhere():
    """Sums of whole numbers over 8192 and a square root: exact but for the last factor."""
    value = float(ca.Function("n", [], [sensors.gaussian(3.0, 5, ca.SX(123456.0))])()["o0"])
    whole = value / np.sqrt(3.0) * 8192
    assert whole == pytest.approx(round(whole), abs=1e-9)
    assert round(whole) == -51


@pytest.mark.parametrize(("true", "read"), [(1.4e-3, 1e-3), (1.6e-3, 2e-3), (-0.4e-3, 0.0), (-0.6e-3, -1e-3)])
def test_a_reading_is_the_nearest_step_of_its_resolution(true, read):
    loop = replace(EXACT, lateral=replace(EXACT.lateral, resolution=1e-3))
    assert readings(1, loop, move=lambda k, name: true)[0, :2] == pytest.approx(read, abs=1e-12)


@pytest.mark.parametrize(("age", "expected"), [(3e-3, 17.0), (2.5e-3, 17.5), (0.0, 20.0), (20e-3, 0.0)])
def test_all_readings_but_the_position_are_delayed(age, expected):
    found = readings(21, replace(EXACT, latency=Latency(age, 0.0)), move=lambda k, name: float(k))[-1]
    assert found[:-1] == pytest.approx(expected, rel=1e-15)
    assert found[SIGNALS.index("p")] == 20.0


def test_the_filter_does_not_know_the_errors_of_the_inverter():
    stressed = load_loop(**{"inverter.delay": 2e-3, "inverter.gain": 1.2})
    line = [float(k) for k in range(LONGEST + 1)]
    for loop, delay in ((stressed, 2), (stressed.perfect(), 0)):
        gain = Readings(loop).gains(0)
        assert gain.command == delay and float(sensors.received_torque(line, gain)) == pytest.approx(1.2 * (delay + 2))
