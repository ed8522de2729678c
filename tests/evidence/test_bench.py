"""All solver paths find the optimum of Ipopt on recorded problems of all scenarios, with and without active bounds."""

import numpy as np
import pytest

from railrepro.control.registry import mpc_settings
from railrepro.evidence.bench import speed
from railrepro.evidence.runs import tuning
from railrepro.vehicle.parameters import load_vehicle

EACH = 3
"""Successive problems per scenario: Ipopt takes a second for one whose bounds are active."""


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle()


@pytest.fixture(scope="module")
def recordings(vehicle):
    settings = mpc_settings(tuning.load("nmpc", "equal")["parameters"])
    plain = [speed.record(name, settings, vehicle, EACH) for name in speed.SCENARIOS]
    return [recording for one in plain for recording in (one, speed.tightened(one))]


def test_same_optimum_as_ipopt(vehicle, recordings):
    active = []
    for recording in recordings:
        reference = speed.solve_all("ipopt", recording, vehicle)[0]
        found, _, _, failures = speed.solve_all("gauss_newton", recording, vehicle)
        assert failures == 0
        assert np.abs(found - reference).max() < 1e-4 * vehicle.drive.torque_limit, recording.scenario
        for problem, ours, theirs in zip(recording.problems, found, reference, strict=True):
            costs = [problem.cost(problem.roll_out(du), du) for du in (ours, theirs)]
            assert costs[0] < costs[1] * (1 + 1e-6), recording.scenario
            if "bounds" in recording.scenario:
                active.append(np.abs(theirs).max() > 0.999 * problem.bound)
    assert len(active) > 20 and np.mean(active) > 0.3


def test_real_time_iteration_meets_the_bounds(vehicle, recordings):
    for recording in recordings:
        found, _, _, failures = speed.solve_all("rti", recording, vehicle)
        assert failures == 0
        bound = recording.problems[0].bound
        assert np.abs(found).max() <= bound + 1e-9


def test_samples_are_timed_in_closed_loop():
    table = speed.sample_times(("paper", "loop"), ("curve_entry_T3",), drives=2, end_m=15.0)
    assert len(table) == 12 and not table["failed"].any() and not table["fallbacks"].any()
    assert (table["median_ms"] <= table["p99_ms"]).all() and (table["p99_ms"] <= table["max_ms"]).all()
    assert set(table["solver"]) == {"gauss_newton", "rti", "one QP"} and table["median_ms"].min() > 0
