"""The bound of the lateral error with sensors: against an independent closed loop, and better sensors."""

import numpy as np
import pytest
from scipy import linalg

from railrepro.estimation.sensors import load_loop
from railrepro.evidence.uncertainty import limit as bound
from railrepro.vehicle.parameters import load_vehicle

V, LOOP = load_vehicle(), load_loop()
WALKS = (1000.0, 50.0)


def loop_of(of, wanted):
    """Variances of the displacement, of the error of its estimate and of the change of torque under a feedback.
    Estimates and their errors (the torques have none) are one linear system, in the units of `of`."""
    n, m = len(of.a), bound.TORQUE
    p = np.zeros((n, n))
    p[:m, :m] = linalg.solve_discrete_are(of.a[:m, :m].T, of.c[:, :m].T, of.q[:m, :m], np.eye(3))
    gain = p @ of.c.T @ np.linalg.inv(of.c @ p @ of.c.T + np.eye(3))
    seen = gain @ of.c
    noise = np.vstack([seen[:, :m], (np.eye(n) - seen)[:m, :m]])
    whole = np.hstack([np.zeros((n + m, n)), noise @ of.a[:m, :m]])
    whole[:n, :n] = of.a - np.outer(of.b, wanted)
    read = np.vstack([gain, -gain[:m]])
    found = linalg.solve_discrete_lyapunov(whole, noise @ of.q[:m, :m] @ noise.T + read @ read.T)
    y, error = bound.Y, n + bound.Y
    return found[y, y] + found[error, error] + 2 * found[y, error], found[error, error], wanted @ found[:n, :n] @ wanted


def test_a_loop_has_the_stated_error_and_no_other_feedback_is_better():
    of, weight = bound.system(V, LOOP, 280 / 3.6, WALKS), 3e-6
    stated, known, torque = bound.at_weight(of, weight)
    wanted = bound.feedback(of, weight)
    costs = []
    for factor in (0.98, 1.0, 1.02):
        error, of_filter, change = loop_of(of, factor * wanted)
        costs.append(error + weight * change)
        if factor == 1.0:
            found = of.units[bound.Y] * np.sqrt([error, of_filter])
            assert [stated, known] == pytest.approx(found, rel=1e-4)
    assert costs[1] < min(costs[0], costs[2])
    assert bound.limit(V, LOOP, 280 / 3.6, WALKS, activity=torque) == pytest.approx(stated, rel=1e-3)


def test_better_sensors_give_a_smaller_bound():
    speed = 400 / 3.6
    usual = bound.limit(V, LOOP, speed, WALKS)
    for better in ({"lateral.noise": 1e-4}, {"gyro.noise": 2e-3}, {"latency.command": 1e-3}, {"lateral.bias": 1e-4}):
        assert bound.limit(V, load_loop(**better), speed, WALKS) < 0.995 * usual
    assert bound.limit(V, LOOP, speed, (200.0, 10.0)) < 0.8 * usual
    assert bound.limit(V, LOOP, speed, WALKS, activity=500.0) < 0.95 * usual


def test_the_bias_of_the_planes_stays_and_the_bias_of_the_position_adds_the_slope_of_the_set_point():
    """A bias of both planes is indistinguishable from a displacement: 0.2 mm, drawn uniformly, mean of two planes."""
    biased, free = (bound.system(V, load_loop(**{"lateral.bias": bias}), 11.0, WALKS) for bias in (2e-4, 0.0))
    assert bound.at_weight(biased, 1e-6)[1] > 0.95 * 0.2e-3 / np.sqrt(6)
    assert bound.at_weight(free, 1e-6)[1] < 0.03e-3
    assert bound.at_true_position(0.0, np.array([1e-4, -1e-4]), LOOP) == pytest.approx(1e-4 / np.sqrt(3))
    assert bound.at_true_position(3e-5, np.zeros(4), LOOP) == pytest.approx(3e-5)
