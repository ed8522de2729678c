"""Tuning tasks (searched parameters, runs, cost, budget) per setting of comparison, and the tuned sets of data/tuned.

The ranking of controllers depends on their tuning and measurements, so there are three settings of comparison: `paper`
(perfect measurements, predictive controllers tuned on dry rail, inversions designed), `equal` (perfect measurements,
all tuned alike) and `loop` (all tuned alike with sensor noise, latency and filter). `swarm` does the tuning.

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
    """Tuning task of one setting of comparison: the runs, their cost, and the parameters that swarms search.

    `budget` and `cost` are the tables of these names in data/tuning.toml, see `Budget` and `Cost`.
    """

    setting: str
    budget: dict
    cost: dict
    runs: dict[str, Experiment]
    """Runs over which the cost is averaged, by name, without controller; the hardest is the last."""
    dimensions: dict[str, list[pso.Dimension]]
    """Controller -> its searched parameters."""
    designed: dict[str, dict] = field(default_factory=dict)
    """Controller -> tuning parameters chosen by hand, name -> value."""
    start: dict[str, dict] = field(default_factory=dict)
    """Controller -> tuning parameters at which the first particle of each swarm begins."""
    searched_too: tuple[str, ...] = ()
    """Controllers in `designed` that a swarm tunes as well, for comparison."""

    @property
    def searched(self) -> list[str]:
        """Names of the controllers that a swarm tunes in this setting."""
        return [name for name in self.dimensions if name not in self.designed or name in self.searched_too]


@data.table
class Budget:
    """Size of a search: particles per swarm, iterations, those without improvement until it stops, a seed per swarm."""

    particles: COUNT
    iterations: COUNT
    patience: COUNT
    seeds: Annotated[tuple[SEED, ...], NOT_EMPTY, DISTINCT]


@data.table
class Cost:
    """Scales and weights of the cost of a run, see `swarm.run_cost`."""

    y_scale_mm: Annotated[Number, above(0.0, 1e3, "mm")]
    du_scale_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    weight: Annotated[Number, between(0.0, 1e6)]
    activity_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    activity_weight: Annotated[Number, between(0.0, 1e6)]
    failure: Annotated[Number, above(0.0, 1e9)]


@data.table
class RunEntry:
    """A run in data/tuning.toml: name of a scenario, its end (m), random seed of its sensors, and optional changes.

    `speed_kmh` is in km/h, `irregular` and `plant` are as in `Experiment`, `inverter` as in data/sensors.toml.
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
    """Read the tuning task of a setting from a TOML file (default data/tuning.toml); InputError for wrong entries."""
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
    """Hash (16 hexadecimal digits) of all given numbers on which the tuning of a controller depends.

    These are scenarios, tracks, rails, vehicle, sensors, cost, budget, bounds and start of the searched parameters; not
    names, remarks or machine. A tuned set of another origin is still used; notebook 05_tuning recomputes its cost.
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
    """Write `found`, a result of `swarm.tune`, to a folder: CONTROLLER.json, its history CONTROLLER_particles.csv."""
    content = {key: value for key, value in found.items() if key != "history"}
    particles = found["history"].to_csv(index=False, float_format="%.6g")
    data.write(folder / f"{found['controller']}_particles.csv", particles)
    data.write(folder / f"{found['controller']}.json", json.dumps(content, indent=2) + "\n")


def particles(controller: str, setting: str = EQUAL) -> pd.DataFrame:
    """Read a row per evaluated particle: iteration, particle, cost (-), a column per parameter, seed of the swarm."""
    return pd.read_csv(paths.source(f"{TUNED}/{setting}/{controller}_particles.csv"))


def load(controller: str, setting: str = PAPER, searched: bool = False) -> dict:
    """Tuned set of a controller in a setting of comparison, see `swarm.tune` (without `history`).

    A designed controller has only `controller`, `setting` and `parameters`; with `searched` the set that a swarm found
    for it (`Task.searched_too`). InputError when there is none.
    """
    return read(controller, setting) if searched else tuned_set(controller, setting)
