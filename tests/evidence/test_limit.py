"""The bound of the lateral error behind sensors: against a simulation of the same loop, and what makes it smaller."""

import numpy as np
import pytest

from railrepro.estimation.sensors import load_loop
from railrepro.evidence.uncertainty import limit as bound
from railrepro.vehicle.parameters import load_vehicle

V, LOOP = load_vehicle(), load_loop()
WALKS = (1000.0, 50.0)


def drawn(of, gain, after, wanted, steps=2000, runs=400):
    """Displacements (m) of many runs of the system under its own filter and feedback, shape (steps, runs)."""
    generator, n = np.random.default_rng(5), of.torque
    root_q = np.zeros_like(of.a)
    root_q[:n, :n] = np.linalg.cholesky(of.q[:n, :n])
    guess, truth = np.zeros((len(of.a), runs)), np.zeros((len(of.a), runs))
    truth[:n] = np.linalg.cholesky(after[:n, :n] + 1e-15 * np.eye(n)) @ generator.normal(size=(n, runs))
    y = []
    for _ in range(steps):
        change = -wanted @ guess
        truth = of.a @ truth + np.outer(of.b, change) + root_q @ generator.normal(size=truth.shape)
        guess = of.a @ guess + np.outer(of.b, change)
        guess += gain @ (of.c @ (truth - guess) + generator.normal(size=(3, runs)))
        y.append(of.units[of.y] * truth[of.y])
    return np.array(y)


def test_a_simulated_loop_has_the_stated_error():
    """Its filter comes from iterating the recursion, not from the library's equation solver."""
    of, speed = bound.system(V, LOOP, 280 / 3.6, WALKS), 280 / 3.6
    m, p = of.torque, np.zeros_like(of.a)
    slow = np.exp(-1e-3 / bound.MEMORY) == np.diag(of.a)
    p[:m, :m] = np.diag(np.where(slow, np.diag(of.q) / (1 - np.exp(-2e-3 / bound.MEMORY)), 1.0)[:m])
    for _ in range(20_000):
        gain = p @ of.c.T @ np.linalg.inv(of.c @ p @ of.c.T + of.r)
        after = p - gain @ of.c @ p
        after = (after + after.T) / 2
        p = of.a @ after @ of.a.T + of.q
        p[m:] = p[:, m:] = 0.0
    stated = bound.limit(V, LOOP, speed, WALKS)
    y = drawn(of, gain, after, bound.feedback(of, stated.weight))
    assert y[1000:].std() == pytest.approx(stated.error, rel=0.04)
    assert stated.known == pytest.approx(of.units[of.y] * np.sqrt(after[of.y, of.y]), rel=0.02)
    assert 0.1e-3 < stated.error < 0.125e-3 and stated.activity == pytest.approx(bound.ACTIVITY, rel=1e-2)


def test_no_other_feedback_is_better():
    """Cost of the loop, error squared plus weighted change squared, under scaled feedback."""
    of = bound.system(V, LOOP, 160 / 3.6, WALKS)
    weight = bound.limit(V, LOOP, 160 / 3.6, WALKS).weight
    wanted = bound.feedback(of, weight)

    def cost(scale):
        x, total = np.linalg.cholesky(of.q + 1e-12 * np.eye(len(of.a))), 0.0
        closed = of.a - scale * np.outer(of.b, wanted)
        for _ in range(20_000):
            total += (x[of.y] ** 2).sum() + weight * ((scale * wanted @ x) ** 2).sum()
            x = closed @ x
        return total

    assert min(cost(0.8), cost(1.25)) > cost(1.0)


def test_what_is_known_better_can_be_held_better():
    speed = 400 / 3.6
    usual = bound.limit(V, LOOP, speed, WALKS)
    for better in ({"lateral.noise": 1e-4}, {"gyro.noise": 2e-3}, {"latency.command": 1e-3}, {"lateral.bias": 1e-4}):
        assert bound.limit(V, load_loop(**better), speed, WALKS).error < 0.995 * usual.error
    assert bound.limit(V, LOOP, speed, (200.0, 10.0)).error < 0.8 * usual.error
    assert bound.limit(V, LOOP, speed, WALKS, activity=500.0).error < 0.95 * usual.error


def test_the_bias_of_the_planes_stays():
    """What both planes share cannot be told from a displacement: 0.2 mm, drawn uniformly, mean of two planes."""
    assert bound.limit(V, LOOP, 11.0, WALKS).known > 0.95 * 0.2e-3 / np.sqrt(6)
    free = bound.limit(V, load_loop(**{"lateral.bias": 0.0}), 11.0, WALKS)
    assert free.known < 0.03e-3


def test_an_error_of_the_place_adds_the_slope_of_the_set_point():
    assert bound.with_place(0.0, np.array([1e-4, -1e-4]), LOOP) == pytest.approx(1e-4 / np.sqrt(3))
    assert bound.with_place(3e-5, np.zeros(4), LOOP) == pytest.approx(3e-5)
