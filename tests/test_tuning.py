"""Tuning: graded cost, tuned sets and their origin, any executor, kill and resume."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from railrepro import paths
from railrepro.control.ndi import NDI
from railrepro.control.registry import CONTROLLERS, guidance
from railrepro.errors import InputError
from railrepro.simulation import simulate
from railrepro.studies import tuning
from railrepro.studies.executor import executor, ordered_map
from railrepro.vehicle.parameters import load_vehicle


def short_task(**budget):
    """The tuning task with one short scenario."""
    task = tuning.load_task()
    scenario = task.scenarios[2].but(end_m=80.0)
    return replace(task, scenarios=(scenario,), budget=task.budget | budget)


def test_all_controllers_are_searched_with_the_same_task():
    task = tuning.load_task()
    assert set(task.dimensions) == set(CONTROLLERS)
    assert len(task.scenarios) >= 4 and len({s.speed_kmh for s in task.scenarios}) >= 4
    assert task.budget["particles"] >= 24 and task.budget["iterations"] >= 20


def test_tuned_sets_belong_to_the_model_and_carry_their_origin():
    for name in CONTROLLERS:
        tuned = tuning.load(name)
        assert tuned["origin"]["seed"] == tuning.load_task().budget["seed"]
        assert set(tuned["parameters"]) == {d.name for d in tuning.load_task().dimensions[name]}


def test_tuned_sets_of_another_model_are_refused(tmp_path):
    content = json.loads((paths.source(tuning.TUNED) / "ndi.json").read_text())
    content["origin"]["fingerprint"] = "0" * 16
    (tmp_path / "ndi.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="ndi.json: was tuned for another vehicle"):
        tuning.load("ndi", tmp_path)
    with pytest.raises(InputError, match="make tune"):
        tuning.load("nmpc", tmp_path)


def test_failures_cost_more_the_earlier_they_happen():
    task, scenario = tuning.load_task(), tuning.load_task().scenarios[2]
    run = simulate.run(scenario.but(end_m=60.0), NDI())
    costs = []
    for share in (0.2, 0.8):
        series = run.series.assign(
            **{"front.p": run.series["front.p"] / run.series["front.p"].iloc[-1] * share * 400.0}
        )
        lost = replace(run, series=series, failed=True)
        costs.append(tuning.scenario_cost(lost, scenario, task.cost)[0])
    good = tuning.scenario_cost(run, scenario, task.cost)[0]
    assert costs[0] > costs[1] > task.cost["failure"] > good


def test_an_evaluation_beyond_its_limit_stops_at_the_first_failure():
    task = tuning.load_task()
    curve, loss = task.scenarios[-2:]
    task = replace(task, scenarios=(curve.but(end_m=60.0), loss.but(end_m=200.0)))
    evaluation = tuning.Evaluation("ndi", task, load_vehicle())
    hasty = {"pole": 104.0, "frequency": 83.0, "damping": 1.55}
    whole, parts = evaluation(hasty)
    assert [part["done"] < 1 for part in parts] == [True, False]
    bounded, first = evaluation(hasty, limit=1.0)
    assert first == parts[:1] and 1.0 < bounded < whole
    assert evaluation(hasty, limit=whole) == (whole, parts)


def test_unknown_controller_and_setting_are_refused():
    with pytest.raises(InputError, match="'pid' is not known"):
        guidance("pid", {})
    with pytest.raises(InputError, match="setting 'colour' is not known"):
        guidance("ndi", {"pole": 1.0, "frequency": 1.0, "damping": 1.0}, colour=1)


def square(x):
    """Picklable task."""
    return x * x


def test_results_do_not_depend_on_the_number_of_workers(monkeypatch, tmp_path):
    task, costs = short_task(particles=3, iterations=2, seed=5), []
    for workers in ("1", "2"):
        monkeypatch.setenv("RAILREPRO_WORKERS", workers)
        with executor() as pool:
            costs.append(tuning.tune("ndi", task, pool, tmp_path / workers, quiet=True)["history"])
    assert costs[0].equals(costs[1])


def test_a_dask_cluster_gives_the_same(monkeypatch):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp"
    ) as cluster:
        monkeypatch.setenv("RAILREPRO_DASK", cluster.scheduler_address)
        with executor() as pool:
            assert ordered_map(pool, square, [1, 2, 3], "squares", quiet=True) == [1, 4, 9]
            evaluation = tuning.Evaluation("ndi", short_task(), load_vehicle())
            parameters = {"pole": 20.0, "frequency": 20.0, "damping": 1.0}
            there = ordered_map(pool, evaluation, [parameters], "there", quiet=True)[0]
    assert there[0] == evaluation(parameters)[0]


WORKERS = """
import fcntl, sys, time
from railrepro.studies.executor import executor, ordered_map
def hold(path):
    with open(path, "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        time.sleep(600)
if __name__ == "__main__":
    with executor() as pool:
        ordered_map(pool, hold, sys.argv[1:], "hold", quiet=True)
"""


def test_workers_end_with_a_killed_parent(tmp_path):
    script, locks = tmp_path / "hold.py", [tmp_path / "one", tmp_path / "two"]
    script.write_text(WORKERS)
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT), "RAILREPRO_WORKERS": "2"}
    parent = subprocess.Popen([sys.executable, str(script), *map(str, locks)], env=environment)

    def held(path):
        try:
            with open(path) as file:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except FileNotFoundError:
            return False
        except BlockingIOError:
            return True
        return False

    def wait_until(reached):
        for _ in range(600):
            if reached():
                return True
            time.sleep(0.1)
        return False

    assert wait_until(lambda: all(map(held, locks)))
    parent.kill()
    parent.wait()
    assert wait_until(lambda: not any(map(held, locks)))


SCRIPT = """
import sys
from pathlib import Path
from railrepro.studies import pso
def cost(particles, limits):
    import time
    time.sleep(0.05)
    return [(p["x"] - 0.3) ** 2 + (p["y"] + 0.2) ** 2 for p in particles]
if __name__ == "__main__":
    dimensions = [pso.Dimension("x", -1, 1), pso.Dimension("y", -1, 1)]
    outcome = pso.minimise(cost, dimensions, 6, 30, 3, Path(sys.argv[1]))
    outcome.history.to_csv(sys.argv[2], index=False)
"""


def test_killed_and_restarted_it_ends_like_the_unbroken_run(tmp_path):
    script = tmp_path / "search.py"
    script.write_text(SCRIPT)
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)}

    def command(name):
        return [sys.executable, str(script), str(tmp_path / f"{name}.json"), str(tmp_path / f"{name}.csv")]

    subprocess.run(command("whole"), env=environment, check=True)
    broken = subprocess.Popen(command("broken"), env=environment)
    checkpoint = tmp_path / "broken.json"
    while not checkpoint.exists() or json.loads(checkpoint.read_text())["iteration"] < 5:
        time.sleep(0.02)
    os.kill(broken.pid, signal.SIGKILL)
    broken.wait()
    assert not Path(tmp_path / "broken.csv").exists()
    subprocess.run(command("broken"), env=environment, check=True)
    assert (tmp_path / "broken.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
