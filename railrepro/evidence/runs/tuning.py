"""What is tuned, for what, in which setting, and the tuned sets in data/tuned; `swarm` does the tuning.

One ranking of controllers does not exist: it depends on what they are given. The settings are `paper` (perfect
measurements, predictive controllers tuned on dry rail, inversions designed), `equal` (perfect measurements, all tuned
alike) and `loop` (all tuned alike behind sensors, noise, latency and filter).

Serves the paper's section Multi-Body Simulation Results (PSO over Q, R, q, H, T).
"""

from __future__ import annotations

import hashlib
import json
import reprlib
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import AfterValidator

from railrepro import paths, schema
from railrepro.control.registry import REGISTERED, guidance
from railrepro.errors import InputError
from railrepro.estimation.sensors import Inverter, load_loop
from railrepro.evidence.runs import pso
from railrepro.evidence.runs.fingerprint import fingerprint
from railrepro.files import write
from railrepro.schema import Number, above, between
from railrepro.simulation.scenarios import Scenario, load_scenarios
from railrepro.track.irregularity import CHANNELS, irregularity_spectrum
from railrepro.vehicle.parameters import Vehicle, load_vehicle

TUNED = "data/tuned"
SETTINGS = ("paper", "equal", "loop")
"""Settings of comparison, see data/tuning.toml."""
EQUAL, LOOP = "equal", "loop"
_COUNT = Annotated[int, between(1, 10**6)]
_SEED = Annotated[int, between(0, 2**63)]


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
        Controller -> parameters that are given, not searched.
    """

    setting: str
    budget: dict
    cost: dict
    runs: tuple[TuningRun, ...]
    dimensions: dict[str, list[pso.Dimension]]
    designed: dict[str, dict] = field(default_factory=dict)

    @property
    def searched(self) -> list[str]:
        """Controllers that a swarm tunes in this setting."""
        return [name for name in self.dimensions if name not in self.designed]


@schema.table
class Budget:
    """Size of a search, see data/tuning.toml."""

    particles: _COUNT
    iterations: _COUNT
    patience: _COUNT
    seeds: Annotated[tuple[_SEED, ...], schema.NOT_EMPTY, schema.DISTINCT]


@schema.table
class Cost:
    """Scales of the cost, see data/tuning.toml."""

    y_scale_mm: Annotated[Number, above(0.0, 1e3, "mm")]
    du_scale_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    weight: Annotated[Number, between(0.0, 1e6)]
    activity_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    activity_weight: Annotated[Number, between(0.0, 1e6)]
    failure: Annotated[Number, above(0.0, 1e9)]


@schema.table
class RunEntry:
    """A run in data/tuning.toml; keys that it does not name itself belong to its scenario."""

    scenario: str
    end_m: Annotated[Number, between(1.0, 1e5, "m")]
    seed: _SEED
    irregular: dict[str, schema.Free] = field(default_factory=dict)
    plant: dict[str, schema.Plain] = field(default_factory=dict)
    inverter: dict[str, schema.Plain] = field(default_factory=dict)


@schema.table
class SettingEntry:
    """Setting in data/tuning.toml."""

    sensors: schema.Flag
    runs: Annotated[tuple[str, ...], schema.NOT_EMPTY, schema.DISTINCT]
    designed: dict[str, dict[str, schema.Plain]] = field(default_factory=dict)


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
    run: Annotated[dict[str, RunEntry], schema.NOT_EMPTY]
    setting: Annotated[dict[Literal["paper", "equal", "loop"], SettingEntry], schema.NOT_EMPTY]
    controller: Annotated[dict[str, Annotated[dict[str, Any], AfterValidator(_dimensions)]], schema.NOT_EMPTY]


def load_task(path: Path | str | None = None, setting: str = EQUAL) -> Task:
    """The tuning task of a TOML file (default data/tuning.toml) in some setting; InputError on wrong entries."""
    file = schema.location(path, paths.source("data/tuning.toml"))
    content = schema.build(TaskFile, schema.read(file), file.name)
    if setting not in content.setting:
        raise InputError(
            f"{file.name}: setting {reprlib.repr(setting)} is not known; there are {sorted(content.setting)}"
        )
    entry, known = content.setting[setting], load_scenarios()
    runs = []
    for name in entry.runs:
        if name not in content.run:
            raise InputError(
                f"{file.name}: [setting.{setting}] has the run {reprlib.repr(name)}; there are {sorted(content.run)}"
            )
        runs.append(_run(name, content.run[name], known, entry.sensors, f"{file.name}: [run.{name}]"))
    dimensions = {}
    for name, bounds in content.controller.items():
        if name not in REGISTERED:
            raise InputError(f"{file.name}: [controller.{name}] is not known; there are {sorted(REGISTERED)}")
        dimensions[name] = content.controller.get(bounds) if isinstance(bounds, str) else bounds
        if not isinstance(dimensions[name], list) or not dimensions[name]:
            raise InputError(f"{file.name}: [controller.{name}] has no bounds, nor has a controller that it is same_as")
    for name, parameters in entry.designed.items():
        if name not in dimensions:
            raise InputError(f"{file.name}: [setting.{setting}.designed] has {name!r}; there are {sorted(dimensions)}")
        guidance(name, parameters)
    return Task(setting, content.budget, content.cost, tuple(runs), dimensions, entry.designed)


def _run(name: str, entry: RunEntry, known: dict, sensed: bool, where: str) -> TuningRun:
    if entry.scenario not in tuple(known):
        raise InputError(f"{where} has the scenario {reprlib.repr(entry.scenario)}; there are {sorted(known)}")
    scenario = schema.build(Scenario, vars(known[entry.scenario]) | {"end_m": entry.end_m}, where)
    sensors = {}
    if sensed or entry.inverter:
        sensors = {"seed": entry.seed} | {f"inverter.{key}": value for key, value in entry.inverter.items()}
        sensors |= {} if sensed else {"perfect": True}
        unknown = set(entry.inverter) - {key.name for key in fields(Inverter)}
        if unknown:
            raise InputError(f"{where} has inverter.{min(unknown)}; there are {[key.name for key in fields(Inverter)]}")
    return TuningRun(name, scenario, entry.irregular, entry.plant, sensors)


def origin(controller: str, task: Task, vehicle: Vehicle) -> str:
    """Fingerprint of what the cost of a controller's parameters reads: runs, vehicle, cost, own bounds, budget."""
    numbers = [sorted((key, str(value)) for key, value in table.items()) for table in (task.budget, task.cost)]
    bounds = [(d.name, float(d.low), float(d.high), d.scale) for d in task.dimensions[controller]]
    around = [(run.irregular, _rails(run.irregular), run.plant, run.sensors) for run in task.runs]
    loop = repr(load_loop()) if any(run.sensors for run in task.runs) else ""
    scenarios = [run.scenario for run in task.runs]
    return fingerprint(scenarios, vehicle, *numbers, bounds, around, loop, REGISTERED[controller].quick)


def _rails(irregular: dict) -> list[str]:
    """What a file or a spectrum says about rails."""
    if not irregular:
        return []
    if "file" in irregular:
        return [hashlib.sha256(paths.source(irregular["file"]).read_bytes()).hexdigest()]
    spectrum = irregular.get("spectrum", "erri_low")
    return [f"{float(irregularity_spectrum(spectrum, channel, 0.5)):.9e}" for channel in CHANNELS]


@lru_cache
def _origin_here(controller: str, setting: str) -> str:
    return origin(controller, _task_here(setting), load_vehicle())


@lru_cache
def _task_here(setting: str) -> Task:
    return load_task(setting=setting)


@schema.table
class Origin(Budget):
    """Where a tuned set comes from."""

    fingerprint: str
    version: str


@schema.table
class SwarmResult:
    """What one swarm found."""

    seed: _SEED
    cost: Annotated[Number, between(0.0, 1e9)]
    evaluations: _COUNT
    parameters: dict[str, schema.Plain]


@schema.table
class TunedSet:
    """Content of a file in data/tuned."""

    controller: str
    setting: Literal["paper", "equal", "loop"]
    parameters: dict[str, schema.Plain]
    cost: Annotated[Number, between(0.0, 1e9)]
    runs: tuple[dict[str, schema.Free], ...]
    swarms: Annotated[tuple[SwarmResult, ...], schema.NOT_EMPTY]
    origin: Origin


def save(tuned: dict, folder: Path) -> None:
    """Write a tuned set as JSON and its particles as CSV."""
    content = {key: value for key, value in tuned.items() if key != "history"}
    write(folder / f"{tuned['controller']}_particles.csv", tuned["history"].to_csv(index=False, float_format="%.6g"))
    write(folder / f"{tuned['controller']}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = EQUAL) -> pd.DataFrame:
    """All evaluated particles of a controller: seed of the swarm, iteration, particle, cost, parameters."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))


def load(controller: str, setting: str = EQUAL, folder: Path | None = None) -> dict:
    """Tuned set of a controller in some setting; a designed set has only `controller`, `setting` and `parameters`.

    Raises
    ------
    InputError
        When there is none, when it does not hold a tuned set of this controller, or when it was tuned for another
        `origin`.
    """
    task = _task_here(setting)
    if controller in task.designed:
        return {"controller": controller, "setting": setting, "parameters": task.designed[controller]}
    file = (folder or paths.source(f"{TUNED}/{setting}")) / f"{controller}.json"
    if not file.exists():
        raise InputError(f"{setting}/{file.name}: there is no tuned set for {controller!r}; `make tune` makes it")
    content = schema.read(file)
    found = schema.build(TunedSet, content, file.name)
    if (found.controller, found.setting) != (controller, setting):
        raise InputError(
            f"{file.name}: holds a tuned set of {found.controller!r} in the setting {found.setting!r}, {controller!r} "
            f"in {setting!r} is needed"
        )
    if controller not in task.dimensions:
        raise InputError(f"{file.name}: tuning.toml has no bounds for {controller!r}")
    if found.origin.fingerprint != _origin_here(controller, setting):
        raise InputError(
            f"{file.name}: was tuned for another vehicle, control model, cost or budget, other runs or bounds "
            f"({found.origin.fingerprint}, here {_origin_here(controller, setting)}); `make tune` tunes again"
        )
    searched = {dimension.name for dimension in task.dimensions[controller]}
    for parameters in (found.parameters, *(swarm.parameters for swarm in found.swarms)):
        if set(parameters) != searched:
            raise InputError(f"{file.name}: has the parameters {sorted(parameters)}, {sorted(searched)} are needed")
    return content


def tuned(controller: str, options: dict | None = None, setting: str = EQUAL, **changes):
    """Guidance of a controller with its tuned parameters, see `registry.guidance`."""
    return guidance(controller, load(controller, setting)["parameters"], options, **changes)
