"""Tuning: graded cost, tuned sets and their origin, any number of processes."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from railrepro.control.ndi import NDI
from railrepro.control.registry import BY_SWARM, INVERSIONS, LOOP, SETTINGS, SHOWN, read
from railrepro.simulation import simulate
from railrepro.studies.experiment import Experiment
from railrepro.tuning import cost as costs
from railrepro.tuning import margin, sets
from railrepro.tuning.cost import evaluate
from railrepro.tuning.task import load_task, triple_pole
from railrepro.tuning.tune import by_rule, tune

POLES = triple_pole(36.0)


def shortened(task, end_m, *names):
    """A tuning task with some of its runs, up to a track coordinate."""
    runs = {name: replace(task.runs[name], scenario=task.runs[name].scenario.but(end_m=end_m)) for name in names}
    return replace(task, runs=runs)


@pytest.mark.parametrize("setting", SETTINGS)
def test_tuned_sets_belong_to_the_model_keep_the_margin_and_carry_their_origin(setting):
    task = load_task(setting=setting)
    for name in (*SHOWN, *BY_SWARM):
        tuned = sets.load(name, setting)
        if name in task.designed:
            assert tuned["parameters"] == task.designed[name]
            continue
        assert [one["speed_kmh"] for one in tuned["margins"]] == task.margin["speeds_kmh"]
        assert min(one["disk_margin"] for one in tuned["margins"]) >= task.margin["least"] == 0.5
        bounded = name.removesuffix("_swarm")
        assert set(tuned["parameters"]) == {d.name for d in task.dimensions[bounded]}
        if name in task.rule:
            continue
        found = sets.particles(bounded if setting == LOOP else name, setting).groupby("seed")["cost"].min()
        assert found.to_dict() == pytest.approx({one["seed"]: one["cost"] for one in tuned["swarms"]}, rel=1e-5)
        assert list(found.index) == task.budget["seeds"] and tuned["cost"] == pytest.approx(found.min(), rel=1e-5)


@pytest.mark.parametrize("name", INVERSIONS)
def test_poles_by_the_rule_are_the_fastest_that_keep_the_margin(name):
    task, parameters = load_task(), read(name)["parameters"]
    assert by_rule(name, task)["parameters"] == parameters
    assert (pole := parameters["pole"]) == parameters["frequency"] == int(pole)
    faster = parameters | {"pole": pole + 1, "frequency": pole + 1}
    assert margin.smallest(name, faster, [400]) < 0.5 <= margin.smallest(name, parameters, [400, 300, 200, 100])


def test_a_set_without_the_margin_costs_more_the_more_it_misses():
    task, margins = load_task(), [margin.peaks("ndi", triple_pole(pole), 400)["disk_margin"] for pole in (40.0, 60.0)]
    failure, missed = task.cost["failure"], [evaluate("ndi", task, triple_pole(pole)) for pole in (40.0, 60.0)]
    assert missed == [(pytest.approx(failure * (2 - each / 0.5)), []) for each in margins]
    assert failure < missed[0][0] < missed[1][0] <= 2 * failure
    slow_only = replace(shortened(task, 60.0, "sine"), margin={"least": 0.65, "speeds_kmh": [100, 200, 400]})
    cost, parts = evaluate("ndi", slow_only, POLES)  # margins 0.71, 0.64 and 0.51
    assert [part["run"] for part in parts] == ["sine"] and failure < cost < 1.1 * failure


@pytest.fixture(scope="module")
def driven():
    """A run of 60 m, its scenario and the cost."""
    scenario = load_task().runs["T3"].scenario
    return simulate.run(scenario.but(end_m=60.0), NDI()), scenario, load_task().cost


def cost_and_parts(run, scenario, cost, **around):
    parts, _ = costs.driven(run, Experiment(scenario, "ndi", **around))
    return costs.run_cost(parts, cost), parts


def test_failures_cost_more_the_earlier_they_happen(driven):
    run, scenario, cost = driven
    for fraction in (0.2, 0.8):
        position = run.series["front.p"] / run.series["front.p"].iloc[-1] * fraction * scenario.end_m
        lost = replace(run, series=run.series.assign(**{"front.p": position}), failed=True)
        assert cost_and_parts(lost, scenario, cost)[0] == pytest.approx(cost["failure"] * (2 - fraction))
    assert cost["failure"] > cost_and_parts(run, scenario, cost)[0]


@pytest.mark.parametrize(("frequency", "counts"), [(8.0, True), (2.0, False)])
def test_a_limit_cycle_costs_though_the_error_stays(driven, frequency, counts):
    run, scenario, cost = driven
    shaking = 1000.0 * np.sin(2 * np.pi * frequency * run.series["t_s"].to_numpy())
    series = run.series.assign(**{f"{gear}.du": shaking for gear in simulate.GEARS})
    value, parts = cost_and_parts(replace(run, series=series), scenario, cost)
    low, high = (670, 745) if counts else (0, 60)  # 1000 / sqrt(2) above 5 Hz, or next to nothing
    assert low < parts["activity_du"] < high
    beyond = parts["activity_du"] / 500 - 1 if counts else 0.0
    assert value == pytest.approx(1e3 * parts["rmse_y"] + 0.25e-3 * parts["effort_du"] + beyond, rel=1e-9)


def test_behind_sensors_the_error_counts_from_the_rails(driven):
    run, scenario, cost = driven
    moved = run.series.assign(**{f"{gear}.rail_y": 2e-3 for gear in simulate.GEARS})
    moved = replace(run, series=moved.assign(**{f"{gear}.y": moved[f"{gear}.y"] + 2e-3 for gear in simulate.GEARS}))
    around = {"seed": 1}, {"seed": 1, "perfect": True}
    sensed, ideal = (cost_and_parts(moved, scenario, cost, sensors=sensors)[1]["rmse_y"] for sensors in around)
    assert sensed == pytest.approx(cost_and_parts(run, scenario, cost)[1]["rmse_y"]) and ideal > 1.5e-3


def test_an_evaluation_beyond_its_limit_stops():
    evaluation = partial(evaluate, "ndi", shortened(load_task(), 60.0, "T3", "sine"), POLES)
    whole, parts = evaluation()
    assert [part["run"] for part in parts] == ["sine", "T3"]
    bounded, first = evaluation(limit=0.4 * parts[0]["cost"])
    assert first == parts[:1] and bounded == parts[0]["cost"] / 2 < whole
    assert evaluation(limit=whole) == (whole, parts)


def test_results_do_not_depend_on_the_number_of_workers(monkeypatch):
    task, found = shortened(load_task(), 80.0, "T3"), []
    small = replace(task, budget=task.budget | {"particles": 3, "iterations": 2, "seeds": [5, 6]})
    for workers in ("1", "2"):
        monkeypatch.setenv("RAILREPRO_WORKERS", workers)
        found.append(tune("ndi", small, quiet=True))
    tables = [each.pop("history") for each in found]
    assert tables[0].equals(tables[1]) and found[0] == found[1]
    assert found[0]["cost"] == tables[0]["cost"].min() and len(tables[0]) == 2 * 3 * 2
