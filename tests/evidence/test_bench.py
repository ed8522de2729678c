"""All solver paths find the optimum of Ipopt on recorded problems of all scenarios, with and without active bounds."""

import numpy as np
import pytest

from railrepro.control.registry import mpc_settings
from railrepro.evidence.bench import speed
from railrepro.evidence.runs import tuning
from railrepro.vehicle.parameters import load_vehicle

FEW, MANY = 3, 15
"""Successive problems per scenario: Ipopt takes a second for one whose bounds are active."""


@pytest.fixture(scope="module", params=[FEW, pytest.param(MANY, marks=pytest.mark.slow)])
def problem_set(request):
    vehicle, settings = load_vehicle(), mpc_settings(tuning.load("nmpc", "equal")["parameters"])
    plain = [speed.record(name, settings, vehicle, request.param) for name in speed.SCENARIOS]
    recordings = [recording for one in plain for recording in (one, speed.tightened(one))]
    return vehicle, recordings, [speed.solve_all("ipopt", recording, vehicle)[0] for recording in recordings]


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


def test_same_optimum_as_ipopt(problem_set):
    vehicle, recordings, exact = problem_set
    for recording, reference in zip(recordings, exact, strict=True):
        found, _, _, failures = speed.solve_all("gauss_newton", recording, vehicle)
        assert failures == 0
        assert np.abs(found - reference).max() < 1e-4 * vehicle.drive.torque_limit, recording.scenario
        for problem, ours, theirs in zip(recording.problems, found, reference, strict=True):
            costs = [problem.cost(problem.roll_out(du), du) for du in (ours, theirs)]
            assert costs[0] < costs[1] * (1 + 1e-6), recording.scenario


def test_real_time_iteration_meets_the_bounds(problem_set):
    vehicle, recordings, _ = problem_set
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


def test_steps_of_the_car_are_timed_in_both_forms():
    table = speed.step_times(calls=20, drives=2)
    assert table.groupby("function").size().to_dict() == {"coordinates": 2, "output": 2, "step": 2}
    assert (table["us"] > 0).all() and (table["ratio"][::2] == 1).all()
