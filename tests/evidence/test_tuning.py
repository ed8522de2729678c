"""Tuning: graded cost, tuned sets and their origin, any number of workers."""

import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from railrepro import paths
from railrepro.control.ndi import NDI
from railrepro.control.registry import SETTINGS, SHOWN, TUNED, read
from railrepro.data import InputError
from railrepro.simulation import simulate
from railrepro.studies.experiment import Experiment
from railrepro.tuning import sets
from railrepro.tuning.cost import driven as measured
from railrepro.tuning.cost import evaluate, run_cost
from railrepro.tuning.task import load_task
from railrepro.tuning.tune import tune


@pytest.mark.parametrize("setting", SETTINGS)
def test_tuned_sets_belong_to_the_model_and_carry_their_origin(setting):
    task = load_task(setting=setting)
    for name in SHOWN:
        tuned = sets.load(name, setting)
        if name in task.designed:
            assert tuned["parameters"] == task.designed[name]
            continue
        assert set(tuned["parameters"]) == {d.name for d in task.dimensions[name]}
        found = sets.particles(name, setting).groupby("seed")["cost"].min()
        assert found.to_dict() == pytest.approx({one["seed"]: one["cost"] for one in tuned["swarms"]}, rel=1e-5)
        assert list(found.index) == task.budget["seeds"] and tuned["cost"] == pytest.approx(found.min(), rel=1e-5)


def test_tuned_sets_of_another_controller_or_setting_are_refused(tmp_path):
    shutil.copy(paths.source(TUNED) / "equal" / "ndi.json", tmp_path)
    with pytest.raises(InputError, match="no tuned set for 'nmpc'"):
        read("nmpc", "equal", tmp_path)
    with pytest.raises(InputError, match="holds a tuned set of 'ndi' in the setting 'equal'"):
        read("ndi", "loop", tmp_path)
    file = tmp_path / "ndi.json"
    file.write_text(file.read_text().replace('"pole": ', '"pole": NaN, "other": '))
    with pytest.raises(InputError, match="ndi.json: parameters: pole is nan, a number "):
        read("ndi", "equal", tmp_path)


@pytest.fixture(scope="module")
def driven():
    """A run of 60 m, its scenario and the cost."""
    scenario = load_task().runs["T3"].scenario
    return simulate.run(scenario.but(end_m=60.0), NDI()), scenario, load_task().cost


def cost_and_parts(run, scenario, cost, **around):
    parts, _ = measured(run, Experiment(scenario, "ndi", **around))
    return run_cost(parts, cost), parts


def test_failures_cost_more_the_earlier_they_happen(driven):
    run, scenario, cost = driven
    costs = []
    for share in (0.2, 0.8):
        way = run.series["front.p"] / run.series["front.p"].iloc[-1] * share * scenario.end_m
        lost = replace(run, series=run.series.assign(**{"front.p": way}), failed=True)
        costs.append(cost_and_parts(lost, scenario, cost)[0])
        assert costs[-1] == pytest.approx(cost["failure"] * (2 - share))
    assert costs[0] > costs[1] > cost["failure"] > cost_and_parts(run, scenario, cost)[0]


@pytest.mark.parametrize(("frequency", "counts"), [(8.0, True), (2.0, False)])
def test_a_limit_cycle_costs_though_the_error_stays(driven, frequency, counts):
    run, scenario, cost = driven
    shaking = 1000.0 * np.sin(2 * np.pi * frequency * run.series["t_s"].to_numpy())
    series = run.series.assign(**{f"{gear}.du": shaking for gear in simulate.GEARS})
    value, parts = cost_and_parts(replace(run, series=series), scenario, cost)
    if counts:
        assert parts["activity_du"] == pytest.approx(1000 / np.sqrt(2), rel=0.05)
    else:
        assert parts["activity_du"] < 60
    beyond = parts["activity_du"] / 500 - 1 if counts else 0.0
    assert value == pytest.approx(1e3 * parts["rmse_y"] + 0.25e-3 * parts["effort_du"] + beyond, rel=1e-9)


def test_behind_sensors_the_error_counts_from_the_rails(driven):
    run, scenario, cost = driven
    moved = run.series.assign(**{f"{gear}.rail_y": 2e-3 for gear in simulate.GEARS})
    moved = moved.assign(**{f"{gear}.y": run.series[f"{gear}.y"] + 2e-3 for gear in simulate.GEARS})
    run = replace(run, series=moved)
    around = {"seed": 1}, {"seed": 1, "perfect": True}
    seen, ideal = (cost_and_parts(run, scenario, cost, sensors=sensors)[1]["rmse_y"] for sensors in around)
    assert seen == pytest.approx(cost_and_parts(driven[0], scenario, cost)[1]["rmse_y"])
    assert ideal > 1.5e-3


def test_an_evaluation_beyond_its_limit_stops():
    task = load_task()
    runs = {name: replace(run, scenario=run.scenario.but(end_m=60.0)) for name, run in task.runs.items()}
    evaluation = partial(evaluate, "ndi", replace(task, runs={name: runs[name] for name in ("T3", "poor")}))
    poles = {"pole": 40.0, "frequency": 30.0, "damping": 1.0}
    whole, parts = evaluation(poles)
    assert [part["run"] for part in parts] == ["poor", "T3"]
    bounded, first = evaluation(poles, limit=0.4 * parts[0]["cost"])
    assert first == parts[:1] and bounded == parts[0]["cost"] / 2 < whole
    assert evaluation(poles, limit=whole) == (whole, parts)


def test_results_do_not_depend_on_the_number_of_workers(monkeypatch):
    task, found = load_task(), []
    runs = {"T3": replace(task.runs["T3"], scenario=task.runs["T3"].scenario.but(end_m=80.0))}
    small = replace(task, runs=runs, budget=task.budget | {"particles": 3, "iterations": 2, "seeds": [5, 6]})
    for workers in ("1", "2"):
        monkeypatch.setenv("RAILREPRO_WORKERS", workers)
        found.append(tune("ndi", small, quiet=True))
    tables = [each.pop("history") for each in found]
    assert tables[0].equals(tables[1]) and found[0] == found[1]
    assert found[0]["cost"] == tables[0]["cost"].min() and len(tables[0]) == 2 * 3 * 2
