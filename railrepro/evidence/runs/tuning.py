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
from pathlib import Path
from typing import Annotated, Literal

import pandas as pd
from pydantic import AfterValidator

from railrepro import data, paths
from railrepro.control.registry import CONTROLLERS, EQUAL, NOTHING, PAPER, TUNED, guidance, read, tuned_set
from railrepro.control.registry import LOOP as LOOP  # for those who take the settings from here
from railrepro.control.registry import SETTINGS as SETTINGS
from railrepro.control.registry import tuned as tuned
from railrepro.data import AS_GIVEN, DISTINCT, NOT_EMPTY, Flag, Free, InputError, Number, Plain, above, between
from railrepro.estimation.sensors import load_loop
from railrepro.evidence.runs import pso, store
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation.scenarios import Scenario, load_scenarios
from railrepro.vehicle.parameters import Vehicle

COUNT = Annotated[int, between(1, 10**6)]
SEED = Annotated[int, between(0, 2**63)]


@dataclass(frozen=True)
class Task:
    """What swarms are asked to minimise in some setting; see data/tuning.toml."""

    setting: str
    budget: dict
    cost: dict
    runs: dict[str, Experiment]
    """Runs of the cost by name, without controller, the hardest last."""
    dimensions: dict[str, list[pso.Dimension]]
    """Searched parameters by controller, as the following."""
    designed: dict[str, dict] = field(default_factory=dict)
    """Parameters that are given."""
    start: dict[str, dict] = field(default_factory=dict)
    """Parameters at which the first particle of each swarm begins."""
    searched_too: tuple[str, ...] = ()
    """Designed controllers that a swarm tunes for comparison."""

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


def _dimensions(bounds: dict[str, tuple[Number, Number, str]]) -> list[pso.Dimension]:
    return [pso.Dimension(name, *bound) for name, bound in bounds.items()]


_SCALE = Literal["linear", "log", "integer"]
_BOUNDS = Annotated[dict[str, tuple[Number, Number, _SCALE]], NOT_EMPTY, AfterValidator(_dimensions)]


@data.table
class TaskFile:
    """Content of data/tuning.toml."""

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
    """The tuning task of a TOML file (default data/tuning.toml) in some setting; InputError on wrong entries."""
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


def origin(controller: str, task: Task, vehicle: Vehicle) -> str:
    """Digest of the given numbers that the cost of a controller's parameters reads.

    These are scenarios, tracks, rails, vehicle, sensors, cost, budget and own bounds. Names and remarks do not
    count, nor does what is computed, so it is the same on every machine. A tuned set of another origin is used all the
    same; 05_tuning recomputes its cost.
    """
    tracks, rails = (data.read(paths.source(f"data/{name}.toml")) for name in ("tracks", "irregularities"))
    sets = sorted({name for run in task.runs.values() for name in (run.scenario.good, run.scenario.poor)})
    car = replace(vehicle, adhesion={name: vehicle.adhesion[name] for name in sets})
    runs = []
    for run in task.runs.values():
        scenario = {k: v for k, v in vars(run.scenario).items() if k not in ("name", "track", "paper")}
        rail = rails.get(str(run.irregular.get("spectrum")), None)
        runs.append([scenario, tracks.get(run.scenario.track), run.irregular, rail, run.plant, run.sensors])
    loop = load_loop() if any(run.sensors for run in task.runs.values()) else None
    search = task.dimensions[controller], task.start.get(controller)
    return store.digest(runs, car, loop, task.budget, task.cost, *search)[:16]


def save(found: dict, folder: Path) -> None:
    """Write a tuned set as JSON and its particles as CSV."""
    content = {key: value for key, value in found.items() if key != "history"}
    particles = found["history"].to_csv(index=False, float_format="%.6g")
    data.write(folder / f"{found['controller']}_particles.csv", particles)
    data.write(folder / f"{found['controller']}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = EQUAL) -> pd.DataFrame:
    """All evaluated particles of a controller: seed of the swarm, iteration, particle, cost, parameters."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))


def load(controller: str, setting: str = PAPER, searched: bool = False) -> dict:
    """Tuned set of a controller in some setting; a designed set has only `controller`, `setting` and `parameters`.

    With `searched`, what a swarm found for a controller that is designed (`Task.searched_too`). InputError when there
    is none.
    """
    return read(controller, setting) if searched else tuned_set(controller, setting)
