"""All solver paths find the optimum of Ipopt on recorded problems of all scenarios, with and without active bounds."""

import numpy as np
import pytest

from railrepro.control.registry import mpc_settings
from railrepro.studies import bench, tuning
from railrepro.vehicle.parameters import load_vehicle

FEW, MANY = 3, 15
"""Successive problems per scenario: Ipopt takes a second for one whose bounds are active."""


@pytest.fixture(scope="module", params=[FEW, pytest.param(MANY, marks=pytest.mark.slow)])
def problem_set(request):
    vehicle, settings = load_vehicle(), mpc_settings(tuning.load("nmpc")["parameters"])
    plain = [bench.record(name, settings, vehicle, request.param) for name in bench.SCENARIOS]
    recordings = [recording for one in plain for recording in (one, bench.tightened(one))]
    return vehicle, recordings, [bench.solve_all("ipopt", recording, vehicle)[0] for recording in recordings]


def test_there_are_enough_problems_and_bounds_are_active(problem_set):
    _, recordings, exact = problem_set
    needed = 200 if len(recordings[0].problems) > FEW else 40
    assert sum(len(recording.problems) for recording in recordings) >= needed
    active = [
        np.abs(du).max() > 0.999 * problem.bound
        for recording, plans in zip(recordings, exact, strict=True)
        for problem, du in zip(recording.problems, plans, strict=True)
        if "bounds" in recording.scenario
    ]
    assert np.mean(active) > 0.3


@pytest.mark.parametrize("kind", ["gauss_newton", "dense"])
def test_same_optimum_as_ipopt(problem_set, kind):
    vehicle, recordings, exact = problem_set
    for recording, reference in zip(recordings, exact, strict=True):
        found, _, _, failures = bench.solve_all(kind, recording, vehicle)
        assert failures == 0
        assert np.abs(found - reference).max() < 1e-4 * vehicle.drive.torque_limit, recording.scenario
        for problem, ours, theirs in zip(recording.problems, found, reference, strict=True):
            costs = [problem.cost(problem.roll_out(du), du) for du in (ours, theirs)]
            assert costs[0] < costs[1] * (1 + 1e-6), recording.scenario


def test_real_time_iteration_meets_the_bounds(problem_set):
    vehicle, recordings, _ = problem_set
    for recording in recordings:
        found, _, _, failures = bench.solve_all("rti", recording, vehicle)
        assert failures == 0
        bound = recording.problems[0].bound
        assert np.abs(found).max() <= bound + 1e-9
