"""Particle swarm: bounds, moves, costs that are not finite, early end."""

import numpy as np
import pytest

from railrepro.tuning.swarm import Dimension, minimise

BOX = [Dimension("a", -5.12, 5.12), Dimension("b", -5.12, 5.12)]


def test_particles_stay_in_bounds_and_integers_are_whole():
    dimensions = [Dimension("r", 1e-12, 1e-8, "log"), Dimension("n", 5, 40, "integer")]
    history = minimise(lambda sets, limits: [-1e8 * s["r"] - s["n"] for s in sets], dimensions, 12, 30, seed=1).history
    assert history["r"].between(1e-12, 1e-8).all() and history["n"].isin(range(5, 41)).all()
    assert history["n"].iloc[-12:].max() == 40
    assert history["cost"].sum() == pytest.approx(-13989.890153759323, rel=1e-12), "the moves that tuned sets come from"


def test_a_swarm_may_begin_without_a_finite_cost_and_none_leads_it():
    costs = iter([[np.inf, np.nan, np.inf], np.array([3, np.inf, np.nan])])
    assert minimise(lambda sets, limits: next(costs), BOX, 3, 2, seed=0).cost == 3.0


def test_a_stagnant_swarm_stops_early():
    assert minimise(lambda sets, _: [1.0] * len(sets), BOX, 5, 50, seed=0, patience=4).history["iteration"].max() < 8
