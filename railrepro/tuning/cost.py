"""Cost of a parameter set: the mean over the runs of a tuning task."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from railrepro.control.registry import CONTROLLERS
from railrepro.simulation import metrics, simulate
from railrepro.studies import store
from railrepro.studies.experiment import Experiment
from railrepro.tuning import margin
from railrepro.tuning.task import Task


def driven(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Compute the metrics of a run that `run_cost` needs; a function for `Experiment.measured`. Returns a pair (dict,
    None). Means over both gears: rmse_y (RMS of y - y*, m), effort_du (RMS of the differential torque du, added to the
    left motor of a gear and subtracted from the right, N m), activity_du (RMS of du above 5 Hz, N m; NaN in a failed
    run). failed: whether the run failed or a wheel touched its flange; done: fraction of the distance before that, 1
    without failure. With imperfect sensors y counts from the irregular rails, otherwise from the ideal track."""
    sensed = bool(experiment.sensors) and not experiment.sensors.get("perfect", False)

    def mean(metric):
        return float(np.mean([metric(run.series, gear) for gear in simulate.GEARS]))

    parts = {"rmse_y": mean(metrics.followed_rmse if sensed else metrics.rmse), "effort_du": mean(metrics.effort)}
    touched = metrics.on_flange(run.series)
    if not (run.failed or touched.any()) and np.isfinite(sum(parts.values())):
        return parts | {"activity_du": mean(metrics.activity), "done": 1.0, "failed": False}, None
    position = np.nan_to_num(run.series["front.p"].to_numpy())
    end = position[touched.argmax()] if touched.any() else position.max()
    done = float(np.clip(end / experiment.scenario.end_m, 0, 1))
    return parts | {"activity_du": float("nan"), "done": done, "failed": True}, None


def run_cost(parts: dict, cost: dict) -> float:
    """Cost of a run (-), lower is better, from its metrics `parts` (dict of `driven`) and the table `cost` of
    data/tuning.toml: 1e3 rmse_y / y_scale_mm + weight effort_du / du_scale_Nm + activity_weight max(activity_du /
    activity_Nm - 1, 0), or failure (2 - done) for a failed run. rmse_y is the lateral error (m), effort_du the RMS of
    the differential torque, activity_du above 5 Hz (N m), done the fraction driven; other names are in `cost`."""
    if parts["failed"]:
        return cost["failure"] * (2 - parts["done"])
    beyond = max(parts["activity_du"] / cost["activity_Nm"] - 1, 0.0)
    value = 1e3 * parts["rmse_y"] / cost["y_scale_mm"] + cost["weight"] * parts["effort_du"] / cost["du_scale_Nm"]
    return value + cost["activity_weight"] * beyond


def missed(controller: str, task: Task, parameters: dict, speeds_kmh: Sequence[float]) -> float:
    """Cost (-) of a parameter set whose disk margin is below least = `task.margin["least"]` at one of `speeds_kmh`: F
    (2 - margin / least) at the first such speed, F = `task.cost["failure"]`, the cost of a failed run; else 0."""
    least = task.margin["least"]
    smallest = margin.smallest(controller, parameters, speeds_kmh, least, task.sensed)
    return task.cost["failure"] * (2 - smallest / least) if smallest < least else 0.0


def evaluate(controller: str, task: Task, parameters: dict, limit: float = np.inf) -> tuple[float, list[dict]]:
    """Compute the cost (-) of tuning `parameters` in a task, the mean over its runs; returns a pair (cost, runs). runs
    is a list of dicts, the last run of the task first, with the keys run (name), cost and the metrics of `driven`. Once
    the mean exceeds `limit`, the remaining runs are left out and count as zero: the cost is then a lower bound. A set
    below the least disk margin has the cost of `missed`; the first, tightest speed is checked before all runs."""
    quick, number = CONTROLLERS[controller].quick, len(task.runs)
    tightest, others = task.margin["speeds_kmh"][:1], task.margin["speeds_kmh"][1:]
    if penalty := missed(controller, task, parameters, tightest):
        return penalty, []
    costs, parts = [], []
    for name, run in reversed(task.runs.items()):
        try:
            part, _ = replace(run, controller=controller, parameters=parameters, options=quick).measured(driven)
            cost = run_cost(part, task.cost)
            part.pop("failed")
        except (ArithmeticError, np.linalg.LinAlgError):
            cost, part = 2 * task.cost["failure"], {"done": 0.0}
        costs.append(cost)
        parts.append({"run": name, "cost": cost, **part})
        if sum(costs) > limit * number:
            return sum(costs) / number, parts
    return missed(controller, task, parameters, others) or sum(costs) / number, parts
