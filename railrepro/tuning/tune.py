"""Tuning by particle swarm: a swarm per seed searches the parameters of one controller in one setting of comparison."""

from __future__ import annotations

from functools import partial

import pandas as pd

from railrepro import __version__, paths
from railrepro.control.registry import PAPER, SETTINGS, TUNED
from railrepro.data import InputError
from railrepro.studies.executor import ordered_map
from railrepro.tuning import sets, swarm
from railrepro.tuning.cost import evaluate
from railrepro.tuning.task import Task, load_task


def tune(controller: str, task: Task | str = PAPER, quiet: bool = False) -> dict:
    """Tune one controller with a swarm per seed of the budget, in parallel (`executor`); stored runs are read.

    `controller` is a key of `registry.CONTROLLERS`, `task` a `Task`, or the setting of comparison whose task of
    data/tuning.toml is taken; `quiet` leaves out the progress bars. With its budget a task takes minutes.

    Returns a dict. Of the best swarm: controller, setting, parameters, cost (-), runs (as from `evaluate`). swarms: a
    list of dicts with seed, cost, evaluations and parameters of each swarm. origin: dict of version and `Budget`.
    history: DataFrame with a row per evaluated particle (`Swarm.history`) and the column seed.
    """
    task = task if isinstance(task, Task) else load_task(setting=task)
    if controller not in task.dimensions:
        raise InputError(f"controller {controller!r} has no bounds in tuning.toml; there are {sorted(task.dimensions)}")
    budget, evaluated, found = task.budget, partial(evaluate, controller, task), {}

    def costs(particles: list[dict], limits: list[float]) -> list[float]:
        limited = list(zip(particles, limits, strict=True))
        return ordered_map(lambda particle: evaluated(*particle)[0], limited, controller, quiet=True)

    for seed in budget["seeds"]:
        title = "" if quiet else f"{task.setting} {controller} {seed}"
        found[seed] = swarm.minimise(
            costs, task.dimensions[controller], budget["particles"], budget["iterations"], seed,
            budget["patience"], task.start.get(controller), title,
        )  # fmt: skip
    best = min(found.values(), key=lambda swarm: swarm.cost)
    cost, parts = ordered_map(evaluated, [best.best], controller, quiet=True)[0]
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
        "origin": {"version": __version__} | budget,
        "history": pd.concat([swarm.history.assign(seed=seed) for seed, swarm in found.items()], ignore_index=True),
    }


def main(names: list[str]) -> None:
    """Command `tune`: tune controllers and write data/tuned.

    `names` are controllers and settings of comparison, InputError for others. Without a controller among `names` all
    controllers are tuned, without a setting all settings.
    """
    known: dict | str = load_task().dimensions
    settings = [name for name in names if name in SETTINGS] or SETTINGS
    wanted = [name for name in names if name not in SETTINGS]
    for name in wanted:
        if name not in known:
            known = f"setting ({list(SETTINGS)}) nor a controller of tuning.toml ({sorted(known)})"
            raise InputError(f"{name!r} is neither {known}")
    for each in settings:
        task = load_task(setting=each)
        for name in wanted or task.searched:
            if name not in task.searched:
                print(f"{each} {name}: designed, nothing to tune")
                continue
            result = tune(name, task)
            sets.save(result, paths.ROOT / TUNED / each)
            costs = ", ".join(f"{swarm['cost']:.4f}" for swarm in result["swarms"])
            print(f"{each} {name}: costs {costs} after {len(result['history'])} evaluations", flush=True)
