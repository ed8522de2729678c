"""Tuning of all lateral controllers by particle swarm, with the same cost and budget, in the settings of `tuning`.

`python -m railrepro tune [setting …] [controller …]` tunes and writes data/tuned; an interrupted run
goes on where it was. Serves the paper's section Multi-Body Simulation Results (PSO over Q, R, q, H, T).
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from railrepro import __version__, paths
from railrepro.control.registry import CONTROLLERS
from railrepro.data import InputError
from railrepro.evidence.runs import pso, store
from railrepro.evidence.runs.executor import executor, ordered_map
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.runs.tuning import SETTINGS, TUNED, Task, load_task, origin, save
from railrepro.simulation import metrics, simulate
from railrepro.vehicle.parameters import load_vehicle


def driven(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Metrics of a run from which `run_cost` computes its cost, as a `store.Entry`: (dict, None).

    Mean over both gears of the RMSE of y (`rmse_y`, m), the RMS of du (`effort_du`, N m) and of its part above 5 Hz
    (`activity_du`, N m; nan when failed); `done`, the share of the distance before flange contact or failure (-); and
    `failed`, true also after flange contact. With imperfect sensors the error counts from the irregular rails.
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
    """Cost of a run (-) from its metrics `parts` (of `driven`) and the table [cost] of data/tuning.toml, `cost`.

    1e3 rmse_y / y_scale_mm + weight effort_du / du_scale_Nm + activity_weight max(activity_du / activity_Nm - 1, 0); a
    failed run costs failure (2 - done).
    """
    if parts["failed"]:
        return cost["failure"] * (2 - parts["done"])
    beyond = max(parts["activity_du"] / cost["activity_Nm"] - 1, 0.0)
    value = 1e3 * parts["rmse_y"] / cost["y_scale_mm"] + cost["weight"] * parts["effort_du"] / cost["du_scale_Nm"]
    return value + cost["activity_weight"] * beyond


def evaluate(controller: str, task: Task, parameters: dict, limit: float = np.inf) -> tuple[float, list[dict]]:
    """Mean cost (-) of tuning `parameters` over the runs of a task, and per run a dict: run, cost, metrics of `driven`.

    The hardest run, the last of the task, is simulated first. Once the mean is above `limit` the other runs are left
    out and count as zero: the cost is then a lower bound.
    """
    quick, number = CONTROLLERS[controller].quick, len(task.runs)
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
            break
    return sum(costs) / number, parts


def tune(controller: str, task: Task, pool, quiet: bool = False) -> dict:
    """Tune one controller with a swarm per seed on a `pool` of `executor`; finished runs are read from the store.

    Returns a dict: the tuned set, that of the best swarm (`controller`, `setting`, `parameters`, `cost` (-), `runs` as
    from `evaluate`), `swarms` (per swarm seed, cost, evaluations, parameters), `origin` (hash, version, budget), and
    `history`, a DataFrame of all evaluated particles (`Swarm.history` and seed).
    """
    budget, evaluated, found = task.budget, partial(evaluate, controller, task), {}

    def costs(particles: list[dict], limits: list[float]) -> list[float]:
        limited = list(zip(particles, limits, strict=True))
        return ordered_map(pool, lambda particle: evaluated(*particle)[0], limited, controller, quiet=True)

    for seed in budget["seeds"]:
        title = "" if quiet else f"{task.setting} {controller} {seed}"
        found[seed] = pso.minimise(
            costs, task.dimensions[controller], budget["particles"], budget["iterations"], seed,
            budget["patience"], task.start.get(controller), title,
        )  # fmt: skip
    best = min(found.values(), key=lambda swarm: swarm.cost)
    cost, parts = ordered_map(pool, evaluated, [best.best], controller, quiet=True)[0]
    return {
        "controller": controller,
        "setting": task.setting,
        "parameters": best.best,
        "cost": cost,
        "runs": parts,
        "swarms": [
            {"seed": seed, "cost": swarm.cost, "evaluations": len(swarm.rows), "parameters": swarm.best}
            for seed, swarm in found.items()
        ],
        "origin": {"data": origin(controller, task, load_vehicle()), "version": __version__} | budget,
        "history": pd.concat([swarm.history.assign(seed=seed) for seed, swarm in found.items()], ignore_index=True),
    }


def main(names: list[str]) -> None:
    """Tune the controllers among `names` (none: all) in the settings among them (none: all) and write data/tuned."""
    known = load_task().dimensions
    settings = [name for name in names if name in SETTINGS] or SETTINGS
    wanted = [name for name in names if name not in SETTINGS]
    for name in wanted:
        if name not in known:
            known = f"setting ({list(SETTINGS)}) nor a controller of tuning.toml ({sorted(known)})"
            raise InputError(f"{name!r} is neither {known}")
    with executor() as pool:
        for each in settings:
            task = load_task(setting=each)
            for name in wanted or task.searched:
                if name not in task.searched:
                    print(f"{each} {name}: designed, nothing to tune")
                    continue
                result = tune(name, task, pool)
                save(result, paths.ROOT / TUNED / each)
                costs = ", ".join(f"{swarm['cost']:.4f}" for swarm in result["swarms"])
                print(f"{each} {name}: costs {costs} after {len(result['history'])} evaluations", flush=True)
