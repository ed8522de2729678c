"""Tuning by particle swarm in three settings of comparison: runs, cost, budget, and the tuned sets of data/tuned.

The ranking of controllers depends on their tuning and measurements, so there are three settings: `paper` (perfect
measurements, predictive controllers tuned on dry rail, inversions designed), `equal` (perfect measurements, all tuned
with the same cost and budget) and `loop` (as `equal`, with sensor noise, latency and filter). Serves the paper's
section Multi-Body Simulation Results (PSO over Q, R, q, H, T).
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pandas as pd
from pydantic import AfterValidator, StrictBool

from railrepro import __version__, data, paths
from railrepro.control.registry import CONTROLLERS, EQUAL, NOTHING, PAPER, TUNED, guidance, read, tuned_set
from railrepro.control.registry import LOOP as LOOP  # for those who take the settings from here
from railrepro.control.registry import SETTINGS as SETTINGS
from railrepro.control.registry import tuned as tuned
from railrepro.data import AS_GIVEN, NOT_EMPTY, Free, InputError, Number, Plain, above, between
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.runs import pso, store
from railrepro.evidence.runs.executor import ordered_map
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import Scenario, load_scenarios

COUNT = Annotated[int, between(1, 10**6)]
SEED = Annotated[int, between(0, 2**63)]


@dataclass(frozen=True)
class Task:
    """Tuning task of one setting of comparison: the runs, their cost, and the parameters that swarms search.

    Attributes:
        setting: Setting of comparison.
        budget, cost: Tables of data/tuning.toml, see `Budget` and `Cost`.
        runs: Name -> run without controller. The cost is the mean over these runs; the hardest is the last.
        dimensions: Controller -> parameters that its swarms search, with bounds.
        designed: Controller -> tuning parameters chosen by hand, name -> value.
        start: Controller -> tuning parameters at which the first particle of each swarm begins.
        searched_too: Controllers in `designed` that a swarm tunes as well, for comparison.
    """

    setting: str
    budget: dict
    cost: dict
    runs: dict[str, Experiment]
    dimensions: dict[str, list[pso.Dimension]]
    designed: dict[str, dict] = field(default_factory=dict)
    start: dict[str, dict] = field(default_factory=dict)
    searched_too: tuple[str, ...] = ()

    @property
    def searched(self) -> list[str]:
        """Names of the controllers that a swarm tunes in this setting."""
        return [name for name in self.dimensions if name not in self.designed or name in self.searched_too]


@data.table
class Budget:
    """Size of a search: particles per swarm, iterations, iterations without improvement (`patience`), swarm seeds."""

    particles: COUNT
    iterations: COUNT
    patience: COUNT
    seeds: Annotated[tuple[SEED, ...], NOT_EMPTY]


@data.table
class Cost:
    """Scales and weights of the cost of a run, see `run_cost`."""

    y_scale_mm: Annotated[Number, above(0.0, 1e3, "mm")]
    du_scale_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    weight: Annotated[Number, between(0.0, 1e6)]
    activity_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    activity_weight: Annotated[Number, between(0.0, 1e6)]
    failure: Annotated[Number, above(0.0, 1e9)]


@data.table
class RunEntry:
    """Run of the tuning task, an entry of data/tuning.toml: a scenario by name with changes.

    `end_m` is the end of the run (m), `seed` the one of its sensors, `speed_kmh` its speed (None: of the scenario).
    `irregular` and `plant` are as in `Experiment`, `inverter` has changed entries of data/sensors.toml.
    """

    scenario: str
    end_m: Annotated[Number, between(1.0, 1e5, "m")]
    seed: SEED
    speed_kmh: Number | None = None
    irregular: dict[str, Free] = field(default_factory=dict)
    plant: dict[str, Plain] = field(default_factory=dict)
    inverter: dict[str, Plain] = field(default_factory=dict)


@data.table
class SettingEntry:
    """Setting of comparison in data/tuning.toml: whether runs have sensors, names of runs, the rest as in `Task`."""

    sensors: StrictBool
    runs: Annotated[tuple[str, ...], NOT_EMPTY]
    designed: dict[str, dict[str, Plain]] = field(default_factory=dict)
    searched_too: tuple[str, ...] = ()
    start: dict[str, dict[str, Plain]] = field(default_factory=dict)


def _dimensions(bounds: dict[str, tuple[Number, Number, str]]) -> list[pso.Dimension]:
    return [pso.Dimension(name, *bound) for name, bound in bounds.items()]


_SCALE = Literal["linear", "log", "integer"]
_BOUNDS = Annotated[dict[str, tuple[Number, Number, _SCALE]], NOT_EMPTY, AfterValidator(_dimensions)]


@data.table
class TaskFile:
    """Content of data/tuning.toml; `controller` maps a controller to the `pso.Dimension` of each searched parameter."""

    budget: Annotated[Budget, AS_GIVEN]
    cost: Annotated[Cost, AS_GIVEN]
    run: Annotated[dict[str, RunEntry], NOT_EMPTY]
    setting: Annotated[dict[Literal["paper", "equal", "loop"], SettingEntry], NOT_EMPTY]
    controller: Annotated[dict[str, _BOUNDS], NOT_EMPTY]


def _known(names: Iterable[str], known: Iterable[str], where: str) -> None:
    """Refuse the first name that is none of the known ones."""
    for name in names:
        if name not in known:
            raise InputError(f"{where} {reprlib.repr(name)}, which is not known; there are {sorted(known)}")


def load_task(path: Path | str | None = None, setting: str = EQUAL) -> Task:
    """Tuning task of a setting of comparison from a TOML file (default data/tuning.toml); InputError if it is wrong."""
    file = data.location(path, paths.source("data/tuning.toml"))
    content = data.build(TaskFile, data.read(file), file.name)
    _known([setting], content.setting, f"{file.name}: setting")
    entry, where = content.setting[setting], f"{file.name}: [setting.{setting}]"
    _known(entry.runs, content.run, f"{where} has the run")
    runs = {name: _run(content.run[name], entry.sensors, f"{file.name}: [run.{name}]") for name in entry.runs}
    _known(content.controller, CONTROLLERS, f"{file.name}: [controller] has")
    dimensions = content.controller
    _known([*entry.designed, *entry.start], dimensions, f"{where} has")
    _known(entry.searched_too, entry.designed, f"{where} designs, and has searched_too")
    try:
        for name, parameters in entry.designed.items():
            guidance(name, parameters)
        for name, parameters in entry.start.items():
            pso.Swarm(dimensions[name], 1, 0, parameters)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    budget, cost = content.budget, content.cost
    return Task(setting, budget, cost, runs, dimensions, entry.designed, entry.start, entry.searched_too)


def _run(entry: RunEntry, sensed: bool, where: str) -> Experiment:
    scenarios = load_scenarios()
    _known([entry.scenario], scenarios, f"{where} has the scenario")
    change = {"end_m": entry.end_m} | ({} if entry.speed_kmh is None else {"speed_kmh": entry.speed_kmh})
    scenario = data.build(Scenario, vars(scenarios[entry.scenario]) | change, where)
    inverter = {f"inverter.{key}": value for key, value in entry.inverter.items()}
    try:
        load_loop(**inverter)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    sensors = {"seed": entry.seed} | inverter if sensed or inverter else {}
    sensors |= {"perfect": True} if inverter and not sensed else {}
    return Experiment(scenario, NOTHING, irregular=entry.irregular, plant=entry.plant, sensors=sensors)


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


def evaluate(controller: str, task: Task, parameters: dict, limit: float = np.inf) -> tuple[float, list[dict]]:
    """Mean cost (-) of tuning `parameters` over the runs of a task; returns a pair (cost, runs).

    runs is a list of dicts, the last run of the task first, with the keys run (name), cost and the metrics of `driven`.
    Once the mean is above `limit` the other runs are left out and count as zero: the cost is then a lower bound.
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


def tune(controller: str, task: Task, quiet: bool = False) -> dict:
    """Tune one controller with a swarm per seed of the budget, in parallel (`executor`); stored runs are read.

    Returns a dict. Of the best swarm: controller, setting, parameters, cost (-), runs (as from `evaluate`). swarms: a
    list of dicts with seed, cost, evaluations and parameters of each swarm. origin: dict of version and `Budget`.
    history: DataFrame with a row per evaluated particle (`Swarm.history`) and the column seed.
    """
    budget, evaluated, found = task.budget, partial(evaluate, controller, task), {}

    def costs(particles: list[dict], limits: list[float]) -> list[float]:
        limited = list(zip(particles, limits, strict=True))
        return ordered_map(lambda particle: evaluated(*particle)[0], limited, controller, quiet=True)

    for seed in budget["seeds"]:
        title = "" if quiet else f"{task.setting} {controller} {seed}"
        found[seed] = pso.minimise(
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


def save(found: dict, folder: Path) -> None:
    """Write `found`, a result of `tune`, to a folder: CONTROLLER.json, and its history to CONTROLLER_particles.csv."""
    content = {key: value for key, value in found.items() if key != "history"}
    particles = found["history"].to_csv(index=False, float_format="%.6g")
    data.write(folder / f"{found['controller']}_particles.csv", particles)
    data.write(folder / f"{found['controller']}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = EQUAL) -> pd.DataFrame:
    """Evaluated particles of all swarms of a tuning, read from data/tuned: a row each, columns as `tune`'s history."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))


def load(controller: str, setting: str = PAPER, searched: bool = False) -> dict:
    """Tuned set of a controller in a setting of comparison: the dict of `tune` without history.

    A designed controller has only the keys controller, setting and parameters; with `searched` it is the set that a
    swarm found for this controller (`Task.searched_too`). InputError when there is none.
    """
    return read(controller, setting) if searched else tuned_set(controller, setting)


def main(names: list[str]) -> None:
    """Command `tune`: tune controllers and write data/tuned.

    `names` are controllers and settings of comparison, InputError for others. Without a controller among `names` all
    controllers are tuned, without a setting all settings.
    """
    known = load_task().dimensions
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
            save(result, paths.ROOT / TUNED / each)
            costs = ", ".join(f"{swarm['cost']:.4f}" for swarm in result["swarms"])
            print(f"{each} {name}: costs {costs} after {len(result['history'])} evaluations", flush=True)
