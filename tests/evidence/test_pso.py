"""Swarm: published test functions, bounds, seeds."""

import numpy as np
import pytest

from railrepro.evidence.runs.pso import Dimension, Swarm, minimise


def sphere(sets, limits=()):
    return [sum((v - 0.3) ** 2 for v in s.values()) for s in sets]


def rosenbrock(sets, limits=()):
    return [100 * (s["b"] - s["a"] ** 2) ** 2 + (1 - s["a"]) ** 2 for s in sets]


def rastrigin(sets, limits=()):
    return [sum(v**2 - 10 * np.cos(2 * np.pi * v) + 10 for v in s.values()) for s in sets]


BOX = [Dimension("a", -5.12, 5.12), Dimension("b", -5.12, 5.12)]


@pytest.mark.parametrize(("function", "least", "tolerance"), [(sphere, 0.3, 1e-3), (rosenbrock, 1.0, 0.05)])
def test_minimum_of_smooth_functions_is_found(function, least, tolerance):
    found = minimise(function, BOX, 30, 120, seed=3)
    assert found.best["a"] == pytest.approx(least, abs=tolerance)
    assert found.best["b"] == pytest.approx(least, abs=2 * tolerance)


def test_global_minimum_among_many_local_ones_is_found_most_of_the_time():
    hits = sum(minimise(rastrigin, BOX, 30, 100, seed=s).cost < 0.1 for s in range(10))
    assert hits >= 8


def test_particles_stay_in_bounds_and_integers_are_whole():
    dimensions = [Dimension("r", 1e-12, 1e-8, "log"), Dimension("n", 5, 40, "integer")]
    history = minimise(lambda sets, limits: [-1e8 * s["r"] - s["n"] for s in sets], dimensions, 12, 30, seed=1).history
    assert history["r"].between(1e-12, 1e-8).all()
    assert history["n"].isin(range(5, 41)).all()
    assert history["n"].iloc[-12:].max() == 40
    assert history["cost"].sum() == pytest.approx(-13989.890153759323, rel=1e-12), "the moves that tuned sets come from"


def test_same_seed_same_swarm_another_seed_another():
    first, second, other = (minimise(sphere, BOX, 8, 10, seed=s).history for s in (5, 5, 6))
    assert first.equals(second)
    assert not first["a"].equals(other["a"])


def test_failures_count_as_worst_and_never_lead():
    swarm = Swarm(BOX, 6, seed=0)
    swarm.tell([np.nan, np.inf, 3.0, 2.0, 1.0, np.nan])
    assert swarm.cost == 1.0


def test_a_stagnant_swarm_stops_early():
    assert minimise(lambda sets, _: [1.0] * len(sets), BOX, 5, 50, seed=0, patience=4).history["iteration"].max() < 8
