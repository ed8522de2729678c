"""All solver paths find the optimum of Ipopt on recorded problems of all scenarios, with and without active bounds."""

import numpy as np

from railrepro.control.registry import mpc_settings, parameters
from railrepro.evidence.bench import speed
from railrepro.vehicle.parameters import load_vehicle


def test_the_time_of_a_run_of_a_study_is_split_and_its_store_is_not_asked():
    (row,) = speed.study_times(["ndi"], ["paper"], repeats=1).to_dict("records")
    assert 0 < row["loop_ms"] < row["run_ms"] and row["ratio"] == row["run_ms"] / row["loop_ms"]


def test_same_optimum_as_ipopt_and_one_iteration_meets_the_bounds():
    vehicle, settings = load_vehicle(), mpc_settings(parameters("nmpc", "loop"))
    # few problems, as Ipopt takes a second for one whose bounds are active
    plain = [speed.record(name, settings, vehicle, 3) for name in speed.SCENARIOS]
    recordings = [recording for one in plain for recording in (one, speed.tightened(one))]
    active = []
    for recording in recordings:
        reference = speed.solve_all("ipopt", recording, vehicle)[0]
        found, _, _, failures = speed.solve_all("gauss_newton", recording, vehicle)
        once, _, _, lost = speed.solve_all("rti", recording, vehicle)
        assert failures == lost == 0 and np.abs(once).max() <= recording.problems[0].bound + 1e-9
        assert np.abs(found - reference).max() < 1e-4 * vehicle.drive.torque_limit, recording.scenario
        if "bounds" in recording.scenario:
            active += [np.abs(du).max() > 0.999 * recording.problems[0].bound for du in reference]
    assert len(active) > 20 and np.mean(active) > 0.3
