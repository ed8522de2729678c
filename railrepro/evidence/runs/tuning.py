"""What is tuned, for what, in which setting, and the tuned sets in data/tuned; `swarm` does the tuning.

One ranking of controllers does not exist: it depends on what they are given. The settings are `paper` (perfect
measurements, predictive controllers tuned on dry rail, inversions designed), `equal` (perfect measurements, all tuned
alike) and `loop` (all tuned alike with sensor noise, latency and filter).

Serves the paper's section Multi-Body Simulation Results (PSO over Q, R, q, H, T).
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import AfterValidator

from railrepro import data, paths
from railrepro.control.registry import CONTROLLERS, EQUAL, PAPER, TUNED, guidance, read
from railrepro.control.registry import LOOP as LOOP  # for those who take the settings from here
from railrepro.control.registry import SETTINGS as SETTINGS
from railrepro.control.registry import tuned as tuned
from railrepro.data import AS_GIVEN, DISTINCT, NOT_EMPTY, Flag, Free, InputError, Number, Plain, above, between
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.runs import pso, store
from railrepro.simulation.scenarios import Scenario, load_scenarios
from railrepro.vehicle.parameters import Vehicle, load_vehicle

COUNT = Annotated[int, between(1, 10**6)]
SEED = Annotated[int, between(0, 2**63)]


@dataclass(frozen=True)
class TuningRun:
    """One run of the cost, as the arguments of `experiment.Experiment` have it.

    Attributes
    ----------
    name : str
    scenario : Scenario
    irregular, plant, sensors : dict
        Rails, what only the car has, and sensors; empty is an ideal track, the nominal car, perfect measurements.
    """

    name: str
    scenario: Scenario
    irregular: dict = field(default_factory=dict)
    plant: dict = field(default_factory=dict)
    sensors: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Task:
    """What swarms are asked to minimise in some setting; see data/tuning.toml.

    Attributes
    ----------
    setting : str
    budget, cost : dict
    runs : tuple of TuningRun
        The hardest last.
    dimensions : dict
        Controller -> list of `pso.Dimension`.
    designed : dict
        Controller -> parameters that are given.
    start : dict
        Controller -> parameters at which the first particle of each swarm begins.
    searched_too : tuple of str
        Designed controllers that a swarm tunes for comparison.
    """

    setting: str
    budget: dict
    cost: dict
    runs: tuple[TuningRun, ...]
    dimensions: dict[str, list[pso.Dimension]]
    designed: dict[str, dict] = field(default_factory=dict)
    start: dict[str, dict] = field(default_factory=dict)
    searched_too: tuple[str, ...] = ()

    @property
    def searched(self) -> list[str]:
        """Controllers that a swarm tunes in this setting."""
        return [name for name in self.dimensions if name not in self.designed or name in self.searched_too]


@data.table
class Budget:
    """Size of a search, see data/tuning.toml."""

    particles: COUNT
    iterations: COUNT
    patience: COUNT
    seeds: Annotated[tuple[SEED, ...], NOT_EMPTY, DISTINCT]


@data.table
class Cost:
    """Scales of the cost, see data/tuning.toml."""

    y_scale_mm: Annotated[Number, above(0.0, 1e3, "mm")]
    du_scale_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    weight: Annotated[Number, between(0.0, 1e6)]
    activity_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    activity_weight: Annotated[Number, between(0.0, 1e6)]
    failure: Annotated[Number, above(0.0, 1e9)]


@data.table
class RunEntry:
    """A run in data/tuning.toml: a scenario with some of its entries changed, sensors, rails, car and inverter."""

    scenario: str
    end_m: Annotated[Number, between(1.0, 1e5, "m")]
    seed: SEED
    speed_kmh: Number | None = None
    irregular: dict[str, Free] = field(default_factory=dict)
    plant: dict[str, Plain] = field(default_factory=dict)
    inverter: dict[str, Plain] = field(default_factory=dict)


@data.table
class SettingEntry:
    """Setting in data/tuning.toml."""

    sensors: Flag
    runs: Annotated[tuple[str, ...], NOT_EMPTY, DISTINCT]
    designed: dict[str, dict[str, Plain]] = field(default_factory=dict)
    searched_too: Annotated[tuple[str, ...], DISTINCT] = ()
    start: dict[str, dict[str, Plain]] = field(default_factory=dict)


def _dimensions(bounds: dict) -> str | list[pso.Dimension]:
    """Dimensions of a table of [low, high, scale], or the name of the controller that has the same."""
    if set(bounds) == {"same_as"}:
        return str(bounds["same_as"])
    for name, bound in bounds.items():
        if not (isinstance(bound, list) and len(bound) in (2, 3) and all(map(data.is_number, bound[:2]))):
            raise ValueError(f"has {name} = {reprlib.repr(bound)}, [low, high, scale] is needed")
    return [pso.Dimension(name, *bound) for name, bound in bounds.items()]


@data.table
class Origin(Budget):
    """Where a tuned set comes from: budget of the search, version, and what it was tuned for."""

    data: str
    version: str


@data.table
class SwarmResult:
    """What one swarm found."""

    seed: SEED
    cost: Annotated[Number, between(0.0, 1e9)]
    evaluations: COUNT
    parameters: dict[str, Plain]


@data.table
class TunedSet:
    """Content of a file in data/tuned."""

    controller: str
    setting: Literal["paper", "equal", "loop"]
    parameters: dict[str, Plain]
    cost: Annotated[Number, between(0.0, 1e9)]
    runs: tuple[dict[str, Free], ...]
    swarms: Annotated[tuple[SwarmResult, ...], NOT_EMPTY]
    origin: Origin


@data.table
class TaskFile:
    """Content of data/tuning.toml."""

    budget: Annotated[Budget, AS_GIVEN]
    cost: Annotated[Cost, AS_GIVEN]
    run: Annotated[dict[str, RunEntry], NOT_EMPTY]
    setting: Annotated[dict[Literal["paper", "equal", "loop"], SettingEntry], NOT_EMPTY]
    controller: Annotated[dict[str, Annotated[dict[str, Any], AfterValidator(_dimensions)]], NOT_EMPTY]


def _known(names: Iterable[str], known: Iterable[str], where: str) -> None:
    """Refuse the first name that is none of the known ones."""
    for name in names:
        if name not in known:
            raise InputError(f"{where} {reprlib.repr(name)}, which is not known; there are {sorted(known)}")


def load_task(path: Path | str | None = None, setting: str = EQUAL) -> Task:
    """The tuning task of a TOML file (default data/tuning.toml) in some setting; InputError on wrong entries."""
    file = data.location(path, paths.source("data/tuning.toml"))
    content = data.build(TaskFile, data.read(file), file.name)
    _known([setting], content.setting, f"{file.name}: setting")
    entry, where = content.setting[setting], f"{file.name}: [setting.{setting}]"
    _known(entry.runs, content.run, f"{where} has the run")
    runs = [_run(name, content.run[name], entry.sensors, f"{file.name}: [run.{name}]") for name in entry.runs]
    _known(content.controller, CONTROLLERS, f"{file.name}: [controller] has")
    dimensions = {}
    for name, bounds in content.controller.items():
        dimensions[name] = content.controller.get(bounds) if isinstance(bounds, str) else bounds
        if not isinstance(dimensions[name], list) or not dimensions[name]:
            raise InputError(f"{file.name}: [controller.{name}] has no bounds, nor has a controller that it is same_as")
    _known([*entry.designed, *entry.start], dimensions, f"{where} has")
    _known(entry.searched_too, entry.designed, f"{where} designs, and has searched_too")
    try:
        for name, parameters in entry.designed.items():
            guidance(name, parameters)
        for name, parameters in entry.start.items():
            _check_start(name, parameters, dimensions[name])
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return Task(
        setting, content.budget, content.cost, tuple(runs), dimensions, entry.designed, entry.start,
        entry.searched_too,
    )  # fmt: skip


def _check_start(name: str, parameters: dict, dimensions: list[pso.Dimension]) -> None:
    needed = sorted(dimension.name for dimension in dimensions)
    if sorted(parameters) != needed:
        raise InputError(f"start of {name} has {sorted(parameters)}, {needed} are needed")
    for dimension in dimensions:
        dimension.position(parameters[dimension.name])


def _run(name: str, entry: RunEntry, sensed: bool, where: str) -> TuningRun:
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
    return TuningRun(name, scenario, entry.irregular, entry.plant, sensors)


def origin(controller: str, task: Task, vehicle: Vehicle) -> str:
    """Digest of the given numbers that the cost of a controller's parameters reads.

    These are scenarios, tracks, rails, vehicle, sensors, cost, budget and own bounds. Names and remarks do not
    count, nor does what is computed, so it is the same on every machine. A tuned set of another origin is used all the
    same; `is_current` says so, and 05_tuning recomputes its cost.
    """
    tracks, rails = (data.read(paths.source(f"data/{name}.toml")) for name in ("tracks", "irregularities"))
    sets = sorted({name for run in task.runs for name in (run.scenario.good, run.scenario.poor)})
    car = replace(vehicle, adhesion={name: vehicle.adhesion[name] for name in sets})
    runs = []
    for run in task.runs:
        scenario = {k: v for k, v in vars(run.scenario).items() if k not in ("name", "track", "paper")}
        rail = rails.get(str(run.irregular.get("spectrum")), None)
        runs.append([scenario, tracks.get(run.scenario.track), run.irregular, rail, run.plant, run.sensors])
    loop = load_loop() if any(run.sensors for run in task.runs) else None
    search = task.dimensions[controller], task.start.get(controller)
    return store.digest(runs, car, loop, task.budget, task.cost, *search)[:16]


def is_current(controller: str, setting: str) -> bool:
    """Whether a tuned set was searched with the numbers that stand in data/ today; designed sets are."""
    task = _task_here(setting)
    if controller in task.designed:
        return True
    return load(controller, setting)["origin"]["data"] == origin(controller, task, load_vehicle())


@lru_cache
def _task_here(setting: str) -> Task:
    return load_task(setting=setting)


def save(tuned: dict, folder: Path) -> None:
    """Write a tuned set as JSON and its particles as CSV."""
    content = {key: value for key, value in tuned.items() if key != "history"}
    data.write(
        folder / f"{tuned['controller']}_particles.csv", tuned["history"].to_csv(index=False, float_format="%.6g")
    )
    data.write(folder / f"{tuned['controller']}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = EQUAL) -> pd.DataFrame:
    """All evaluated particles of a controller: seed of the swarm, iteration, particle, cost, parameters."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))


def load(controller: str, setting: str = PAPER, folder: Path | None = None, searched: bool = False) -> dict:
    """Tuned set of a controller in some setting; a designed set has only `controller`, `setting` and `parameters`.

    With `searched`, what a swarm found for a controller that is designed (`Task.searched_too`).

    Raises
    ------
    InputError
        When there is none, when it does not hold a tuned set of this controller, or when it would not be read.
    """
    task = _task_here(setting)
    if searched and controller not in task.searched:
        raise InputError(f"{controller}: no swarm searches it in the setting {setting!r}; it does for {task.searched}")
    if controller in task.designed and folder is not None:
        raise InputError(f"{controller}: tuning.toml gives its set in the setting {setting!r}, no file is read")
    if controller in task.designed and not searched:
        return {"controller": controller, "setting": setting, "parameters": task.designed[controller]}
    content, name = read(controller, setting, folder), f"{controller}.json"
    data.build(TunedSet, content, name)
    if controller not in task.dimensions:
        raise InputError(f"{name}: tuning.toml has no bounds for {controller!r}")
    searched = {dimension.name for dimension in task.dimensions[controller]}
    for parameters in (content["parameters"], *(swarm["parameters"] for swarm in content["swarms"])):
        if set(parameters) != searched:
            raise InputError(f"{name}: has the parameters {sorted(parameters)}, {sorted(searched)} are needed")
    return content
