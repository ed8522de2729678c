"""Tuning of all lateral controllers by particle swarm, with the same cost, budget and scenarios.

`python -m railrepro.studies.tuning [controller …]` tunes and writes data/tuned; an interrupted run goes on where it
was. Serves the paper's section Multi-Body Simulation Results (PSO over Q, R, q, H, T).
"""

from __future__ import annotations

import json
import reprlib
import sys
import time
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator
from tqdm import tqdm

from railrepro import __version__, paths, schema
from railrepro.control.registry import CONTROLLERS, guidance
from railrepro.errors import InputError, told
from railrepro.files import write
from railrepro.schema import Number, above, between
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import Scenario, load_scenarios
from railrepro.studies import pso
from railrepro.studies.executor import executor, ordered_map
from railrepro.studies.fingerprint import fingerprint
from railrepro.vehicle.parameters import Vehicle, load_vehicle

TUNED = "data/tuned"


@dataclass(frozen=True)
class Task:
    """What a swarm is asked to minimise; see data/tuning.toml.

    Attributes
    ----------
    budget, cost : dict
    scenarios : tuple of Scenario
    dimensions : dict
        Controller -> list of `pso.Dimension`.
    """

    budget: dict
    cost: dict
    scenarios: tuple[Scenario, ...]
    dimensions: dict[str, list[pso.Dimension]]


_COUNT = Annotated[int, between(1, 10**6)]


@schema.table
class Budget:
    """Size of a swarm, see data/tuning.toml."""

    particles: _COUNT
    iterations: _COUNT
    patience: _COUNT
    seed: Annotated[int, between(0, 2**63)]


@schema.table
class Cost:
    """Scales of the cost, see data/tuning.toml."""

    y_scale_mm: Annotated[Number, above(0.0, 1e3, "mm")]
    du_scale_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    weight: Annotated[Number, between(0.0, 1e6)]
    failure: Annotated[Number, above(0.0, 1e9)]


def _dimensions(bounds: dict) -> str | list[pso.Dimension]:
    """Dimensions of a table of [low, high, scale], or the name of the controller that has the same."""
    if set(bounds) == {"same_as"}:
        return str(bounds["same_as"])
    for name, bound in bounds.items():
        if not (isinstance(bound, list) and len(bound) in (2, 3) and all(map(schema.is_number, bound[:2]))):
            raise ValueError(f"has {name} = {reprlib.repr(bound)}, [low, high, scale] is needed")
    return [pso.Dimension(name, *bound) for name, bound in bounds.items()]


@schema.table
class TaskFile:
    """Content of data/tuning.toml."""

    budget: Annotated[Budget, schema.AS_GIVEN]
    cost: Annotated[Cost, schema.AS_GIVEN]
    scenario: Annotated[tuple[dict[str, Any], ...], schema.NOT_EMPTY]
    controller: Annotated[dict[str, Annotated[dict[str, Any], AfterValidator(_dimensions)]], schema.NOT_EMPTY]


def load_task(path: Path | str | None = None) -> Task:
    """The tuning task of a TOML file, default data/tuning.toml; InputError with one sentence on wrong entries."""
    file = Path(path) if path else paths.source("data/tuning.toml")
    content = schema.build(TaskFile, schema.read(file), file.name)
    scenarios, known = [], load_scenarios()
    for number, changes in enumerate(content.scenario, 1):
        where, name = f"{file.name}: scenario {number}", changes.pop("scenario", None)
        if name not in tuple(known):
            raise InputError(f"{where} has the scenario {reprlib.repr(name)}; there are {sorted(known)}")
        scenarios.append(schema.build(Scenario, vars(known[name]) | changes, where))
    dimensions = {}
    for name, bounds in content.controller.items():
        if name not in CONTROLLERS:
            raise InputError(f"{file.name}: [controller.{name}] is not known; there are {sorted(CONTROLLERS)}")
        dimensions[name] = content.controller.get(bounds) if isinstance(bounds, str) else bounds
        if not isinstance(dimensions[name], list) or not dimensions[name]:
            raise InputError(f"{file.name}: [controller.{name}] has no bounds, nor has a controller that it is same_as")
    return Task(content.budget, content.cost, tuple(scenarios), dimensions)


def scenario_cost(run: simulate.Run, scenario: Scenario, cost: dict) -> tuple[float, dict]:
    """Cost of one run, and its parts: mean RMSE of y (m) and RMS of du (N m) over both gears, share of the way done."""
    error = np.mean([metrics.rmse(run.series, gear) for gear in simulate.GEARS])
    effort = np.mean([metrics.effort(run.series, gear) for gear in simulate.GEARS])
    done = float(np.clip(np.nan_to_num(run.series["front.p"]).max() / scenario.end_m, 0, 1))
    parts = {"rmse_y": float(error), "effort_du": float(effort), "done": 1.0}
    if run.failed or not np.isfinite(error + effort):
        return cost["failure"] * (2 - done), parts | {"done": done}
    return 1e3 * error / cost["y_scale_mm"] + cost["weight"] * effort / cost["du_scale_Nm"], parts


@dataclass(frozen=True)
class Evaluation:
    """Cost of parameter sets of one controller; picklable, so that any executor can run it."""

    controller: str
    task: Task
    vehicle: Vehicle

    def __call__(self, parameters: dict, limit: float = np.inf) -> tuple[float, list[dict]]:
        """Mean cost over the scenarios, and the parts per scenario.

        The last scenario, the hardest, comes first. Once a run has failed and the sum so far is beyond `limit`, the
        rest is left out and counts nothing: the cost is then a lower bound.
        """
        law = guidance(self.controller, parameters, CONTROLLERS[self.controller].quick)
        costs, parts, failed, number = [], [], False, len(self.task.scenarios)
        for scenario in reversed(self.task.scenarios):
            try:
                run = simulate.run(scenario, law, vehicle=self.vehicle)
                cost, part = scenario_cost(run, scenario, self.task.cost)
            except (ArithmeticError, np.linalg.LinAlgError):
                cost, part = 2 * self.task.cost["failure"], {"done": 0.0}
            costs.append(cost)
            parts.append({"scenario": scenario.name, "cost": cost, **part})
            failed = failed or part["done"] < 1
            if failed and sum(costs) > limit * number:
                break
        return sum(costs) / number, parts


def _cost(evaluation: Evaluation, particle: tuple[dict, float]) -> float:
    return evaluation(*particle)[0]


def origin(controller: str, task: Task, vehicle: Vehicle) -> str:
    """Fingerprint of what the cost of a controller's parameters reads: scenarios, vehicle, cost, own bounds, budget."""
    numbers = [sorted((key, float(value)) for key, value in table.items()) for table in (task.budget, task.cost)]
    bounds = [(d.name, float(d.low), float(d.high), d.scale) for d in task.dimensions[controller]]
    return fingerprint(task.scenarios, vehicle, *numbers, bounds, CONTROLLERS[controller].quick)


@lru_cache
def _origin_here(controller: str) -> str:
    return origin(controller, _task_here(), load_vehicle())


@lru_cache
def _task_here() -> Task:
    return load_task()


@schema.table
class Origin(Budget):
    """Where a tuned set comes from."""

    fingerprint: str
    version: str
    evaluations: _COUNT


@schema.table
class TunedSet:
    """Content of a file in data/tuned."""

    controller: str
    parameters: dict[str, schema.Plain]
    cost: Annotated[Number, between(0.0, 1e9)]
    scenarios: tuple[dict[str, schema.Free], ...]
    origin: Origin


def tune(controller: str, task: Task, pool, folder: Path, vehicle: Vehicle | None = None, quiet: bool = False) -> dict:
    """Tune one controller, or go on with an interrupted tuning.

    Parameters
    ----------
    controller : str
    task : Task
    pool : concurrent.futures.Executor
    folder : Path
        Checkpoints (`<controller>.checkpoint.json`).
    vehicle : Vehicle, optional
        Default data/vehicle.toml.
    quiet : bool
        No progress bar.

    Returns
    -------
    dict
        The tuned set (`controller`, `parameters`, `cost`, `scenarios`, `origin`) with the table of all evaluated
        particles under `history`.
    """
    vehicle, budget = vehicle or load_vehicle(), task.budget
    evaluation, own = Evaluation(controller, task, vehicle), origin(controller, task, vehicle)
    bar = tqdm(total=budget["iterations"], desc=controller, unit="iteration", disable=quiet)

    def evaluate(particles: list[dict], limits: list[float]) -> list[float]:
        limited = list(zip(particles, limits, strict=True))
        return ordered_map(pool, partial(_cost, evaluation), limited, controller, quiet=True)

    def report(swarm: pso.Swarm) -> None:
        bar.n = swarm.iteration
        bar.set_postfix_str(f"best cost {swarm.best[1]:.4f}")

    outcome = pso.minimise(
        evaluate, task.dimensions[controller], budget["particles"], budget["iterations"], budget["seed"],
        folder / f"{controller}.checkpoint.json", own + controller, budget["patience"], report,
    )  # fmt: skip
    bar.close()
    cost, parts = ordered_map(pool, evaluation, [outcome.best], controller, quiet=True)[0]
    provenance = {"fingerprint": own, "version": __version__, "evaluations": len(outcome.history)}
    return {
        "controller": controller,
        "parameters": outcome.best,
        "cost": cost,
        "scenarios": parts,
        "origin": provenance | budget,
        "history": outcome.history,
    }


def save(tuned: dict, folder: Path) -> None:
    """Write a tuned set as JSON and its particles as CSV."""
    content = {key: value for key, value in tuned.items() if key != "history"}
    write(folder / f"{tuned['controller']}_particles.csv", tuned["history"].to_csv(index=False, float_format="%.6g"))
    write(folder / f"{tuned['controller']}.json", json.dumps(content, indent=2) + "\n")


def load(controller: str, folder: Path | None = None) -> dict:
    """Tuned set of a controller.

    Raises
    ------
    InputError
        When there is none, when it does not hold a tuned set of this controller, or when it was tuned for another
        `origin`.
    """
    file = (folder or paths.source(TUNED)) / f"{controller}.json"
    if not file.exists():
        raise InputError(f"{file.name}: there is no tuned set for {controller!r}; `make tune` makes it")
    content = schema.read(file)
    found = schema.build(TunedSet, content, file.name)
    if found.controller != controller:
        raise InputError(f"{file.name}: holds a tuned set of {found.controller!r}, {controller!r} is needed")
    if controller not in _task_here().dimensions:
        raise InputError(f"{file.name}: tuning.toml has no bounds for {controller!r}")
    if found.origin.fingerprint != _origin_here(controller):
        raise InputError(
            f"{file.name}: was tuned for another vehicle, control model, cost or budget, other scenarios or bounds "
            f"({found.origin.fingerprint}, here {_origin_here(controller)}); `make tune` tunes again"
        )
    searched = {dimension.name for dimension in _task_here().dimensions[controller]}
    if set(found.parameters) != searched:
        raise InputError(f"{file.name}: has the parameters {sorted(found.parameters)}, {sorted(searched)} are needed")
    return content


def tuned(controller: str, options: dict | None = None, **changes):
    """Guidance of a controller with its tuned parameters, see `registry.guidance`."""
    return guidance(controller, load(controller)["parameters"], options, **changes)


def main(names: list[str]) -> None:
    """Tune the named controllers, or all."""
    task = load_task()
    unknown = set(names) - set(task.dimensions)
    if unknown:
        raise InputError(f"controller {min(unknown)!r} is not in tuning.toml; there are {sorted(task.dimensions)}")
    checkpoints = paths.BUILD / "tuning"
    with executor() as pool:
        for name in names or task.dimensions:
            begin = time.perf_counter()
            result = tune(name, task, pool, checkpoints)
            save(result, paths.ROOT / TUNED)
            print(f"{name}: cost {result['cost']:.4f} after {len(result['history'])} evaluations, "
                  f"{time.perf_counter() - begin:.0f} s")  # fmt: skip


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
