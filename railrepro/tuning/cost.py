"""Cost of a parameter set: the mean over the runs of a tuning task. Serves the paper's section Multi-Body Simulation
Results."""

from __future__ import annotations

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
    """Metrics from which `run_cost` computes the cost of a run; a measure for `Experiment.measured`.

    Returns (dict, None). Keys rmse_y (m), effort_du (RMS of du, N m), activity_du (RMS of du above 5 Hz, N m; NaN if
    failed), each the mean over both gears; failed, whether the run failed or a wheel touched its flange; done, share of
    the way before that (-). With sensors that have errors rmse_y counts from the irregular rails.
    """
    sensed = bool(experiment.sensors) and not experiment.sensors.get("perfect", False)

    def mean(metric):
        return float(np.mean([metric(run.series, gear) for gear in simulate.GEARS]))

    way = np.nan_to_num(run.series["front.p"].to_numpy())
    touched = metrics.on_flange(run.series)
    reached = way[touched.argmax()] if touched.any() else way.max()
    done = float(np.clip(reached / experiment.scenario.end_m, 0, 1))
    parts = {"rmse_y": mean(metrics.followed_rmse if sensed else metrics.rmse), "effort_du": mean(metrics.effort)}
    if run.failed or touched.any() or not np.isfinite(sum(parts.values())):
        return parts | {"activity_du": float("nan"), "done": done, "failed": True}, None
    return parts | {"activity_du": mean(metrics.activity), "done": 1.0, "failed": False}, None


def run_cost(parts: dict, cost: dict) -> float:
    """Cost of a run (-) from its metrics `parts` (dict of `driven`) and the table `cost` of data/tuning.toml.

    1e3 rmse_y / y_scale_mm + weight effort_du / du_scale_Nm + activity_weight max(activity_du / activity_Nm - 1, 0)
    with entries of `parts` and `cost`. A failed run costs failure (2 - done) instead.
    """
    if parts["failed"]:
        return cost["failure"] * (2 - parts["done"])
    beyond = max(parts["activity_du"] / cost["activity_Nm"] - 1, 0.0)
    value = 1e3 * parts["rmse_y"] / cost["y_scale_mm"] + cost["weight"] * parts["effort_du"] / cost["du_scale_Nm"]
    return value + cost["activity_weight"] * beyond


def missed(controller: str, task: Task, parameters: dict, speeds_kmh: Sequence[float]) -> float:
    """Cost (-) of a parameter set that misses the margin of a task at one of some speeds, 0 if it keeps it at all."""
    least = task.margin["least"]
    found = margin.smallest(controller, parameters, speeds_kmh, least, task.sensed)
    return task.cost["failure"] * (2 - found / least) if found < least else 0.0


def evaluate(controller: str, task: Task, parameters: dict, limit: float = np.inf) -> tuple[float, list[dict]]:
    """Cost (-) of tuning `parameters` in a task: the mean over its runs; returns a pair (cost, runs).

    runs is a list of dicts, the last run of the task first, with the keys run (name), cost and the metrics of `driven`.
    Once the mean is above `limit` the other runs are left out and count as zero: the cost is then a lower bound. A set
    without the margin of the task costs what `missed` returns; at the tightest speed it is measured before the runs.
    """
    quick, number = CONTROLLERS[controller].quick, len(task.runs)
    tightest, others = task.margin["speeds_kmh"][:1], task.margin["speeds_kmh"][1:]
    if penalty := missed(controller, task, parameters, tightest):
        return penalty, []
    costs, parts = [], []
    for name, run in reversed(task.runs.items()):
        asked = replace(run, controller=controller, parameters=parameters, options=quick)
        try:
            part, _ = asked.measured(driven)
            cost = run_cost(part, task.cost)
            part.pop("failed")
        except (ArithmeticError, np.linalg.LinAlgError):
            cost, part = 2 * task.cost["failure"], {"done": 0.0}
        costs.append(cost)
        parts.append({"run": name, "cost": cost, **part})
        if sum(costs) > limit * number:
            return sum(costs) / number, parts
    return missed(controller, task, parameters, others) or sum(costs) / number, parts
