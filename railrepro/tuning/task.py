"""Tuning tasks of data/tuning.toml (runs, cost, bounds): "paper" for exact measurements, "loop" for sensors."""

import reprlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, StrictBool

from railrepro import data, paths
from railrepro.control.registry import CONTROLLERS, INVERSIONS, NOTHING, PAPER, guidance
from railrepro.data import AS_GIVEN, NOT_EMPTY, Free, InputError, Number, Plain, above, between
from railrepro.estimation.sensors import load_loop
from railrepro.simulation.scenarios import Scenario, load_scenarios
from railrepro.studies.experiment import Experiment
from railrepro.tuning.swarm import Dimension, Swarm

COUNT = Annotated[int, between(1, 10**6)]
SEED = Annotated[int, between(0, 2**63)]


@dataclass(frozen=True)
class Task:
    """Tuning task of one setting: what a swarm searches, and the simulated runs by which it judges.

    Attributes:
        setting: "paper" (exact measurements) or "loop" (sensors with noise and delays).
        budget, cost, margin: Size of search, scales of cost, least disk margin: keys of `Budget`, `Cost`, `Margin`.
        runs: Name -> run without a controller. The cost is the mean over these runs; the last one is the hardest.
        dimensions: Controller -> parameters that its swarms search, with bounds.
        designed: Controller -> tuning parameters chosen by hand, name -> value.
        start: Controller -> tuning parameters at which the first particle of each swarm begins.
        rule: NDI controller whose poles `tune.by_rule` sets, as fast as the margin permits -> its other parameters.
        sensed: Whether the controllers have sensors.
    """

    setting: str
    budget: dict
    cost: dict
    margin: dict
    runs: dict[str, Experiment]
    dimensions: dict[str, list[Dimension]]
    designed: dict[str, dict] = field(default_factory=dict)
    start: dict[str, dict] = field(default_factory=dict)
    rule: dict[str, dict] = field(default_factory=dict)
    sensed: bool = False

    @property
    def searched(self) -> list[str]:
        """Names of the controllers that a swarm tunes in this setting."""
        names = [name for name in self.dimensions if name not in self.designed]
        return [f"{name}_swarm" if name in self.rule else name for name in names]


@data.table
class Budget:
    """Size of a search: particles of a swarm, its largest number of iterations, and of iterations without improvement
    (`patience`); a swarm per seed."""

    particles: COUNT
    iterations: COUNT
    patience: COUNT
    seeds: Annotated[tuple[SEED, ...], NOT_EMPTY]


@data.table
class Cost:
    """Scales and weights of the cost of a run, 1e3 rmse_y / y_scale_mm + weight effort_du / du_scale_Nm +
    activity_weight max(activity_du / activity_Nm - 1, 0), or failure (2 - done) for a failed run. rmse_y is the lateral
    error (m), effort_du the RMS of the differential torque, activity_du above 5 Hz (N m), done the fraction driven."""

    y_scale_mm: Annotated[Number, above(0.0, 1e3, "mm")]
    du_scale_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    weight: Annotated[Number, between(0.0, 1e6)]
    activity_Nm: Annotated[Number, above(0.0, 1e6, "N m")]
    activity_weight: Annotated[Number, between(0.0, 1e6)]
    failure: Annotated[Number, above(0.0, 1e9)]


@data.table
class Margin:
    """Stability that every tuned parameter set keeps: `least` is the lowest disk margin (-), which measures how far
    gain and phase of the loop may change, at each of `speeds_kmh`, which are measured in this order."""

    least: Annotated[Number, between(0.0, 2.0)]
    speeds_kmh: tuple[Annotated[Number, between(10.0, 500.0, "km/h")], ...]


@data.table
class RunEntry:
    """Run by which a tuning task judges, as in data/tuning.toml: a scenario by name, and what differs from it. The run
    ends at the track coordinate `end_m` (m). `seed` determines the noise of sensors. `speed_kmh` None keeps the speed
    of the scenario. `irregular` has arguments of `rough_track`, `plant` changed parameters of the car unknown to its
    controllers. `inverter` has errors of the inverters: delay (s), gain (torque over command, -)."""

    scenario: str
    end_m: Annotated[Number, between(1.0, 1e5, "m")]
    seed: SEED
    speed_kmh: Number | None = None
    irregular: dict[str, Free] = field(default_factory=dict)
    plant: dict[str, Plain] = field(default_factory=dict)
    inverter: dict[str, Plain] = field(default_factory=dict)


@data.table
class SettingEntry:
    """Tuning with exact measurements ("paper") or sensors ("loop"), as in data/tuning.toml. `sensors`: whether there
    are sensors. `runs`: names of the simulated runs whose mean cost judges a parameter set. The others map controller
    -> parameter -> value: `designed` has parameters chosen by hand; `rule` those of NDI controllers besides the poles,
    which a search makes as fast as the least disk margin permits; `start` the first particle of a swarm."""

    sensors: StrictBool
    runs: Annotated[tuple[str, ...], NOT_EMPTY]
    designed: dict[str, dict[str, Plain]] = field(default_factory=dict)
    rule: dict[str, dict[str, Plain]] = field(default_factory=dict)
    start: dict[str, dict[str, Plain]] = field(default_factory=dict)


_SCALE = Literal["linear", "log", "integer"]
_DIMENSIONS = AfterValidator(lambda bounds: [Dimension(name, *bound) for name, bound in bounds.items()])
_BOUNDS = Annotated[dict[str, tuple[Number, Number, _SCALE]], NOT_EMPTY, _DIMENSIONS]


@data.table
class TaskFile:
    """Content of data/tuning.toml: size of a search (`budget`), scales of the `cost`, least `margin`. `run` maps a name
    to a simulated run, `setting` the names "paper" (exact measurements) and "loop" (sensors) to what is tuned there,
    `controller` a controller to the parameters that a swarm searches, with bounds and scale."""

    budget: Annotated[Budget, AS_GIVEN]
    cost: Annotated[Cost, AS_GIVEN]
    margin: Annotated[Margin, AS_GIVEN]
    run: Annotated[dict[str, RunEntry], NOT_EMPTY]
    setting: Annotated[dict[Literal["paper", "loop"], SettingEntry], NOT_EMPTY]
    controller: Annotated[dict[str, _BOUNDS], NOT_EMPTY]


def triple_pole(pole: float) -> dict[str, float]:
    """Tuning parameters of NDI with three poles at `pole` (rad/s): keys pole and frequency (rad/s), damping (-)."""
    return {"pole": pole, "frequency": pole, "damping": 1.0}


def _known(names: Iterable[str], known: Iterable[str], where: str) -> None:
    """Raise InputError for the first name that is not among the known ones."""
    for name in names:
        if name not in known:
            raise InputError(f"{where} {reprlib.repr(name)}, which is not known; there are {sorted(known)}")


def load_task(path: Path | str | None = None, setting: str = PAPER) -> Task:
    """Read the tuning task of a setting, "paper" (exact measurements) or "loop" (sensors), from a TOML file (default
    data/tuning.toml). InputError if the file is wrong or has no such setting."""
    file = data.location(path, paths.source("data/tuning.toml"))
    content = data.build(TaskFile, data.read(file), file.name)
    _known([setting], content.setting, f"{file.name}: setting")
    entry, where = content.setting[setting], f"{file.name}: [setting.{setting}]"
    _known(entry.runs, content.run, f"{where} has the run")
    runs = {name: _run(content.run[name], entry.sensors, f"{file.name}: [run.{name}]") for name in entry.runs}
    dimensions = content.controller
    _known(dimensions, CONTROLLERS, f"{file.name}: [controller] has")
    _known([*entry.designed, *entry.start], dimensions, f"{where} has")
    _known(entry.rule, INVERSIONS, f"{where} has the rule of poles for")
    try:
        for name, parameters in entry.designed.items():
            guidance(name, parameters)
        for name, parameters in entry.start.items():
            Swarm(dimensions[name], 1, 0, parameters)
        for name, parameters in entry.rule.items():
            guidance(name, triple_pole(1.0) | parameters)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    choices = entry.designed, entry.start, entry.rule, entry.sensors
    return Task(setting, content.budget, content.cost, content.margin, runs, dimensions, *choices)


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
    sensors = {"seed": entry.seed, **inverter} if sensed or inverter else {}
    if inverter and not sensed:
        sensors["perfect"] = True
    return Experiment(scenario, NOTHING, irregular=entry.irregular, plant=entry.plant, sensors=sensors)
