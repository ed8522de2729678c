"""Tuning of one controller in one setting of comparison: by particle swarms, one per seed, or by the rule of poles."""

from __future__ import annotations

from bisect import bisect_left
from functools import partial

import pandas as pd

from railrepro import __version__, paths
from railrepro.control.registry import PAPER, SETTINGS, TUNED
from railrepro.data import InputError
from railrepro.studies.executor import ordered_map
from railrepro.tuning import margin, sets, swarm
from railrepro.tuning.cost import evaluate
from railrepro.tuning.task import Task, load_task, triple_pole
from railrepro.vehicle.parameters import Vehicle


def tune(controller: str, task: Task | str = PAPER, quiet: bool = False) -> dict:
    """Tune one controller with a swarm per seed of the budget, in parallel (`executor`); stored runs are read.

    `controller` is one of `Task.searched`, `task` a `Task`, or the setting of comparison whose task of
    data/tuning.toml is taken; `quiet` leaves out the progress bars. With its budget a task takes minutes.

    Returns a dict. Of the best swarm: controller, setting, parameters, cost (-), runs (as from `evaluate`), margins
    (see `margins`). swarms: a list of dicts with seed, cost, evaluations and parameters of each swarm. origin: dict of
    version and `Budget`. history: DataFrame with a row per evaluated particle (`Swarm.history`) and the column seed.
    """
    task = task if isinstance(task, Task) else load_task(setting=task)
    bounded = controller.removesuffix("_swarm")
    if bounded not in task.dimensions:
        raise InputError(f"controller {controller!r} has no bounds in tuning.toml; there are {sorted(task.dimensions)}")
    budget, evaluated, found = task.budget, partial(evaluate, controller, task), {}

    def costs(particles: list[dict], limits: list[float]) -> list[float]:
        limited = list(zip(particles, limits, strict=True))
        return ordered_map(lambda particle: evaluated(*particle)[0], limited, controller, quiet=True)

    for seed in budget["seeds"]:
        title = "" if quiet else f"{task.setting} {controller} {seed}"
        found[seed] = swarm.minimise(
            costs, task.dimensions[bounded], budget["particles"], budget["iterations"], seed,
            budget["patience"], task.start.get(bounded), title,
        )  # fmt: skip
    best = min(found.values(), key=lambda swarm: swarm.cost)
    cost, parts = ordered_map(evaluated, [best.best], controller, quiet=True)[0]
    return {
        "controller": controller,
        "setting": task.setting,
        "parameters": best.best,
        "cost": cost,
        "runs": parts,
        "margins": margins(controller, task, best.best),
        "swarms": [
            {"seed": seed, "cost": swarm.cost, "evaluations": len(swarm.rows), "parameters": swarm.best}
            for seed, swarm in found.items()
        ],
        "origin": {"version": __version__} | budget,
        "history": pd.concat([swarm.history.assign(seed=seed) for seed, swarm in found.items()], ignore_index=True),
    }


def margins(controller: str, task: Task, parameters: dict) -> list[dict]:
    """Disk margin (-) at each speed of a task: a list of dicts with the keys speed_kmh and disk_margin."""
    speeds = task.margin["speeds_kmh"]
    found = [margin.peaks(controller, parameters, speed, task.sensed)["disk_margin"] for speed in speeds]
    return [{"speed_kmh": speed, "disk_margin": one} for speed, one in zip(speeds, found, strict=True)]


def fastest_pole(
    controller: str, task: Task, parameters: dict, bounds: tuple[int, int] = (1, 200), vehicle: Vehicle | None = None
) -> float:
    """Rule of poles: the largest whole triple pole (rad/s) with which an inversion keeps the margin of a task.

    `parameters` are its other tuning parameters. Margins fall with the pole, so it bisects between the `bounds`.
    InputError if the lower one misses the margin.
    """
    least, speeds = task.margin["least"], task.margin["speeds_kmh"]

    def misses(pole: int) -> bool:
        given = triple_pole(float(pole)) | parameters
        return margin.smallest(controller, given, speeds, least, task.sensed, vehicle) < least

    first = bisect_left(range(bounds[0], bounds[1] + 1), True, key=misses)
    if not first:
        raise InputError(f"{controller}: with three poles at {bounds[0]} rad/s the disk margin is below {least}")
    return float(bounds[0] + first - 1)


def by_rule(controller: str, task: Task) -> dict:
    """Parameters of an inversion by the rule of poles: `fastest_pole` and what the task gives besides.

    Returns a dict with the keys controller, setting, parameters, margins (see `margins`), origin (dict of version).
    """
    given = task.rule[controller]
    found = triple_pole(fastest_pole(controller, task, given)) | given
    return {
        "controller": controller,
        "setting": task.setting,
        "parameters": found,
        "margins": margins(controller, task, found),
        "origin": {"version": __version__},
    }


def main(names: list[str]) -> None:
    """Command `tune`: tune controllers and write data/tuned.

    `names` are controllers and settings of comparison, InputError for others. Without a controller among `names` all
    controllers are tuned, without a setting all settings.
    """
    tasks = {setting: load_task(setting=setting) for setting in SETTINGS}
    known = {name for task in tasks.values() for name in (*task.dimensions, *task.searched)}
    settings = [name for name in names if name in SETTINGS] or SETTINGS
    wanted = [name for name in names if name not in SETTINGS]
    for name in wanted:
        if name not in known:
            raise InputError(
                f"{name!r} is neither setting ({list(SETTINGS)}) nor a controller of tuning.toml ({sorted(known)})"
            )
    for each in settings:
        task = tasks[each]
        for name in wanted or (*task.rule, *task.searched):
            if name in task.rule:
                result = by_rule(name, task)
                sets.save(result, paths.ROOT / TUNED / each)
                print(f"{each} {name}: three poles at {result['parameters']['pole']:g} rad/s", flush=True)
            elif name in task.searched:
                result = tune(name, task)
                sets.save(result, paths.ROOT / TUNED / each)
                costs = ", ".join(f"{swarm['cost']:.4f}" for swarm in result["swarms"])
                print(f"{each} {name}: costs {costs} after {len(result['history'])} evaluations", flush=True)
            else:
                print(f"{each} {name}: nothing to tune")
