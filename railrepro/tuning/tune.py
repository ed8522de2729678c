"""Tuning of a controller for exact measurements or sensors: by particle swarms, one per seed, or the rule of poles."""

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
    """Tune a controller by a particle swarm per seed of the budget, in parallel (minutes; stored runs are read).
    `controller` is one of `Task.searched`. `task` is a `Task`, or the name of one in data/tuning.toml: "paper", exact
    measurements, or "loop", sensors. `quiet` leaves out the progress bars. Returns a dict. Of the best swarm:
    controller, setting, parameters, cost (-), runs (name, cost and metrics of each), margins (disk margin at each
    speed). swarms: list of dicts with seed, cost, evaluations and parameters of each swarm. origin: dict of version and
    budget. history: DataFrame with a row per evaluated particle: seed, iteration, particle, cost, parameters."""
    task = task if isinstance(task, Task) else load_task(setting=task)
    bounded = controller.removesuffix("_swarm")
    if bounded not in task.dimensions:
        raise InputError(f"controller {controller!r} has no bounds in tuning.toml; there are {sorted(task.dimensions)}")
    evaluated, swarms = partial(evaluate, controller, task), {}
    budget = {key: value for key, value in task.budget.items() if key != "seeds"}

    def costs(particles: list[dict], limits: list[float]) -> list[float]:
        limited = list(zip(particles, limits, strict=True))
        return ordered_map(lambda particle: evaluated(*particle)[0], limited, controller, quiet=True)

    for seed in task.budget["seeds"]:
        title = "" if quiet else f"{task.setting} {controller} {seed}"
        searched = {"dimensions": task.dimensions[bounded], "start": task.start.get(bounded)}
        swarms[seed] = swarm.minimise(costs, seed=seed, title=title, **searched, **budget)
    best = min(swarms.values(), key=lambda swarm: swarm.cost)
    cost, parts = ordered_map(evaluated, [best.best], controller, quiet=True)[0]
    result = {"controller": controller, "setting": task.setting, "parameters": best.best, "cost": cost, "runs": parts}
    result["margins"] = margins(controller, task, best.best)
    result["swarms"] = [
        {"seed": seed, "cost": swarm.cost, "evaluations": len(swarm.rows), "parameters": swarm.best}
        for seed, swarm in swarms.items()
    ]
    result["origin"] = {"version": __version__} | task.budget
    history = [swarm.history.assign(seed=seed) for seed, swarm in swarms.items()]
    return result | {"history": pd.concat(history, ignore_index=True)}


def margins(controller: str, task: Task, parameters: dict) -> list[dict]:
    """Disk margin (-) of a controller at each speed of a task: list of dicts, keys speed_kmh and disk_margin."""
    return [
        {"speed_kmh": speed, "disk_margin": margin.peaks(controller, parameters, speed, task.sensed)["disk_margin"]}
        for speed in task.margin["speeds_kmh"]
    ]


def fastest_pole(
    controller: str, task: Task, parameters: dict, bounds: tuple[int, int] = (1, 200), vehicle: Vehicle | None = None
) -> float:
    """Find the largest whole triple pole (rad/s) with which NDI keeps the least disk margin of a task: the rule of
    poles. `controller` is "ndi", "ndi_feedforward" or "ndi_integral", `parameters` are its other tuning parameters. As
    the margin falls with the pole, it bisects between `bounds`. InputError if the lower bound misses the margin."""
    least, speeds = task.margin["least"], task.margin["speeds_kmh"]

    def misses(pole: int) -> bool:
        given = triple_pole(float(pole)) | parameters
        return margin.smallest(controller, given, speeds, least, task.sensed, vehicle) < least

    first = bisect_left(range(bounds[0], bounds[1] + 1), True, key=misses)
    if not first:
        raise InputError(f"{controller}: with three poles at {bounds[0]} rad/s the disk margin is below {least}")
    return float(bounds[0] + first - 1)


def by_rule(controller: str, task: Task) -> dict:
    """Tune NDI by the largest triple pole that keeps the margin (`fastest_pole`); other parameters are in `Task.rule`.
    Returns a dict: controller, setting, parameters, margins (disk margin at each speed), origin (version)."""
    given = task.rule[controller]
    parameters = triple_pole(fastest_pole(controller, task, given)) | given
    result = {"controller": controller, "setting": task.setting, "parameters": parameters}
    return result | {"margins": margins(controller, task, parameters), "origin": {"version": __version__}}


def main(names: list[str]) -> None:
    """Command `tune`: tune controllers (minutes each) and write their parameters to data/tuned, a CONTROLLER.json each,
    and for swarms CONTROLLER_particles.csv, a row per evaluated parameter set. `names` are controllers and settings,
    "paper" (exact measurements), "loop" (sensors). Without a controller all are tuned, without a setting in both.
    InputError for another name."""
    tasks = {setting: load_task(setting=setting) for setting in SETTINGS}
    known = {name for task in tasks.values() for name in (*task.dimensions, *task.searched)}
    wanted = [name for name in names if name not in SETTINGS]
    if unknown := [name for name in wanted if name not in known]:
        needed = f"setting ({list(SETTINGS)}) nor a controller of tuning.toml ({sorted(known)})"
        raise InputError(f"{unknown[0]!r} is neither {needed}")
    for setting in [name for name in names if name in SETTINGS] or SETTINGS:
        task = tasks[setting]
        for name in wanted or (*task.rule, *task.searched):
            if name not in (*task.rule, *task.searched):
                print(f"{setting} {name}: nothing to tune")
                continue
            result = by_rule(name, task) if name in task.rule else tune(name, task)
            sets.save(result, paths.ROOT / TUNED / setting)
            costs = "".join(f", cost {swarm['cost']:.4f}" for swarm in result.get("swarms", ()))
            print(f"{setting} {name}: {result['parameters']}{costs}", flush=True)
