"""Experiments: a scenario, a controller and changes of both, from which a run and its row of metrics are computed."""

from __future__ import annotations

import inspect
import json
import pickle
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from operator import call
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from railrepro import code, paths
from railrepro.control import registry
from railrepro.control.adhesion import AdhesionSettings
from railrepro.data import InputError, require, scratch
from railrepro.estimation import sensors
from railrepro.simulation import metrics, ride, simulate
from railrepro.simulation.scenarios import Scenario
from railrepro.studies import preview, store
from railrepro.studies.executor import ordered_map, work
from railrepro.track.alignment import Alignment
from railrepro.track.rough import rough_track
from railrepro.track.route import CELL, Route
from railrepro.track.table import build_table, load_track, write_table
from railrepro.vehicle.parameters import Vehicle, load_vehicle


@dataclass(frozen=True)
class Experiment:
    """One closed-loop run that is yet to be simulated; calling it returns its metrics and the series that it keeps.

    Attributes:
        scenario: Scenario
        controller: Key of `registry.CONTROLLERS`.
        label: Column -> value, added to the row of metrics and to the series, to tell runs apart.
        parameters: Tuning parameters by name (data/tuning.toml); None takes the tuned set of `setting`.
        options: Arguments of a predictive controller, as {"solver": "rti"}, see `registry.guidance`.
        changes: Changed fields of the controller's settings (`MPCSettings`, `NDI`), see `registry.guidance`.
        vehicle: Changed vehicle parameters, dotted key -> value as in `load_vehicle`, known to car and controllers.
        plant: Changed parameters of the simulated car that its controllers do not know; keys as in `vehicle`.
        adhesion: Settings of the adhesion law (slip control); None takes its defaults, or those that the sensors need.
        fixed_share: Share of the torque limit reserved for guidance (-); 0 is the paper's allocation.
        alignment: Alignment of a track in place of the scenario's own track; None keeps that.
        irregular: Arguments of `rough_track` besides p, as {"spectrum": "en_B_300", "seed": 3}; {} is an ideal track.
        preview: Arguments of `preview.plan` besides `frame`; {} is a controller without preview of irregular rails.
        sensors: Arguments of `estimation.sensors.readings`; {} gives the controllers the true signals.
        setting: Setting of comparison whose tuned parameters are taken: "paper" or "loop".
        substeps: Integration steps of the car per ms; None is 2 for ride figures on irregular rails, else 1.
        ride: Whether the row also has the comfort and force figures of `ride.ride_summary`.
        stride: Every n-th control cycle (1 ms) of the front gear is kept (`metrics.gear_series`); 0 keeps no series.
    """

    scenario: Scenario
    controller: str
    label: dict = field(default_factory=dict)
    parameters: dict | None = None
    options: dict = field(default_factory=dict)
    changes: dict = field(default_factory=dict)
    vehicle: dict = field(default_factory=dict)
    plant: dict = field(default_factory=dict)
    adhesion: AdhesionSettings | None = None
    fixed_share: float = 0.0
    alignment: Alignment | None = None
    irregular: dict = field(default_factory=dict)
    preview: dict = field(default_factory=dict)
    sensors: dict = field(default_factory=dict)
    setting: str = registry.PAPER
    substeps: int | None = None
    ride: bool = False
    stride: int = 0

    def __post_init__(self) -> None:
        require("experiment: scenario", self.scenario, Scenario)
        for name in ("vehicle", "plant", "sensors", "irregular", "preview"):
            require(f"experiment: {name}", getattr(self, name), dict)

    def car(self) -> Vehicle:
        """Parameters of the simulated car, with the changes of `vehicle` and `plant`."""
        return load_vehicle(**self.vehicle | self.plant)

    def tuned(self) -> dict:
        """Tuning parameters of the controller by name: `parameters`, or without them the tuned ones of `setting`."""
        if self.parameters is not None:
            return self.parameters
        return registry.parameters(self.controller, self.setting)

    def rails(self) -> tuple[pd.DataFrame | None, tuple[np.ndarray, np.ndarray] | None]:
        """Irregularities of the rails, and the line that a controller plans with them, as a pair.

        The first is a DataFrame of `rough_track` up to the end of the scenario, None on an ideal track. The second is
        the pair (p, line) of `preview.plan`, None without preview. InputError for a preview on an ideal track.
        """
        if not self.irregular and not self.preview:
            return None, None
        if not self.irregular:
            raise InputError("preview: the track is ideal, `irregular` is needed to know anything of it")
        allowed = [name for name in inspect.signature(preview.plan).parameters if name != "frame"]
        if unknown := sorted(set(self.preview) - set(allowed)):
            raise InputError(f"preview: {unknown[0]!r} is not known; there are {allowed}")
        changed = code.signature(paths.source("data/irregularities.toml"))
        return _rails(self.scenario.end_m, json.dumps(self.irregular), json.dumps(self.preview), changed)

    def run(self) -> simulate.Run:
        """Simulate and return the whole run: series of both gears and why it ended. The store is not used."""
        around = self._surroundings()
        return simulate.run(
            self.scenario,
            registry.guidance(self.controller, self.tuned(), self.options, **self.changes),
            route=around.route,
            sensors=around.sensors,
            substeps=1 + bool(self.ride and self.irregular) if self.substeps is None else self.substeps,
            vehicle=around.believed,
            plant_vehicle=around.car,
            adhesion=self.adhesion,
            fixed_share=self.fixed_share,
        )

    def _surroundings(self) -> Surroundings:
        """`Surroundings` of the run, made once for all runs with equal fields and unchanged files."""
        fields = tuple(getattr(self, name) for name in _AROUND)
        files = [*map(paths.source, _FILES), Path(self.scenario.track_file())]
        try:
            packed = pickle.dumps(fields)
        except (pickle.PickleError, TypeError, AttributeError):  # of a value that is refused
            return _made(self)
        return _shared(packed, tuple((str(file), code.signature(file)) for file in files))

    def _route(self) -> Route:
        """Route of the scenario with its rails, on its own track or on `alignment`."""
        rails = self.rails()
        if self.alignment is None:
            return self.scenario.route(*rails)
        with scratch() as folder:
            file = folder / f"{self.alignment.name}.csv"
            write_table(build_table(self.alignment), file)
            return self.scenario.but(track=str(file)).route(*rails)

    def key(self, measure: Measure) -> str | None:
        """Key of a result of this run in `store`, a hash; None for a controller from a user's file (not stored).

        `measure` is the function that computes the result, see `measured`. The key depends on the code and all values
        of vehicle, tuning parameters, track and sensors; names and labels do not count.
        """
        if not _is_ours(self.controller):
            return None  # of a user's file
        around = self._surroundings().digest
        own = {name: value for name, value in vars(self).items() if name not in ("label", "setting", *_AROUND)}
        own |= {"parameters": self.tuned()}
        return around and store.key(measure.__module__, measure.__qualname__, around, own)

    def measured(self, measure: Measure) -> store.Entry:
        """Result of `measure(run, experiment)` for this run: read from the store, else simulated by `executor.work`.

        `measure` is a module-level function. It returns a pair: a dict of plain values, and a DataFrame of numbers or
        None. It must not use labels of the experiment.
        """
        return store.entry(self.key(measure), lambda: work(_measured, self, measure))

    def __call__(self) -> tuple[dict, pd.DataFrame | None]:
        """Simulate the run, or read its result from the store; returns a pair (row, series).

        row: dict with the keys scenario, controller, those of `label` and those of `values`. series: DataFrame of
        `metrics.gear_series` with the `label` as columns, None for a `stride` of 0.
        """
        values, series = self.measured(_values)
        row = {"scenario": self.scenario.name, "controller": self.controller, **self.label, **values}
        return row, None if series is None else series.assign(**self.label)

    def values(self, run: simulate.Run) -> dict:
        """Metrics of a run in SI units, as a dict: name -> value.

        Keys: names of `metrics.summary` (NaN if the run failed), of `metrics.longitudinal` and, with `ride`, of
        `ride.ride_summary`; failed (bool); failed_at_m (NaN unless failed); ended, why the run ended (text); warnings
        (text); fallbacks, number of samples of both gears in which a predictive controller found no solution.
        """
        vehicle, series = self._surroundings().car, run.series
        values = metrics.summary(series)
        if run.failed:
            values = {name: (np.nan, unit) for name, (_, unit) in values.items()}
        values |= metrics.longitudinal(series, self.scenario, vehicle)
        if self.ride and not run.failed:
            values |= ride.ride_summary(series, vehicle)
        row = {name: value for name, (value, _) in values.items()}
        row |= {"failed_at_m": float(series["front.p"].iloc[-1]) if run.failed else np.nan}
        row |= {"failed": run.failed, "ended": run.ended, "warnings": "; ".join(run.warnings)}
        return row | {"fallbacks": sum(getattr(controller, "fallbacks", 0) for controller in run.controllers)}


class Surroundings(NamedTuple):
    """What surrounds the controller in a run. Runs of a study share it, so nothing of it may be changed.

    Attributes:
        believed, car (Vehicle): Parameters that the controllers assume, and those of the simulated car.
        route (Route): Track, rails and set point.
        sensors (Readings or None): Sensors between car and controllers.
        digest (str or None): Hash of the values that it follows from; None for a value that `store` does not take.
    """

    believed: Vehicle
    car: Vehicle
    route: Route
    sensors: sensors.Readings | None
    digest: str | None


_AROUND = ("scenario", "alignment", "vehicle", "plant", "irregular", "preview", "sensors")
"""Fields of an `Experiment` from which its `Surroundings` follow."""
_FILES = tuple(f"data/{name}.toml" for name in ("vehicle", "tracks", "irregularities", "sensors"))
"""Files from which they follow, besides a track of its own."""


@lru_cache(maxsize=32)
def _shared(packed: bytes, _files: tuple) -> Surroundings:
    """`Surroundings` of the packed values of `_AROUND`, with the present state of the files."""
    return _made(Experiment(controller=registry.NOTHING, **dict(zip(_AROUND, pickle.loads(packed), strict=True))))


def _made(of: Experiment) -> Surroundings:
    scenario = {name: value for name, value in vars(of.scenario).items() if name not in ("name", "track")}
    track = None if of.alignment else load_track(of.scenario.track_file())
    believed, car, route = load_vehicle(**of.vehicle), of.car(), of._route()
    route.cells.flags.writeable = False
    read: list = [scenario, track and (track.table.to_numpy(), track.design_speed), of.alignment, believed, car]
    read += [of.rails(), of.preview, (of.sensors, sensors.load_loop()) if of.sensors else None]
    seen, digest = sensors.readings(**of.sensors) if of.sensors else None, None
    with suppress(TypeError):
        digest = store.digest(*read)
    return Surroundings(believed, car, route, seen, digest)


@lru_cache(maxsize=64)
def _rails(
    end: float, irregular: str, known: str, changed: tuple | None
) -> tuple[pd.DataFrame, tuple[np.ndarray, np.ndarray] | None]:
    """Irregularities up to a coordinate (m), and the line planned with them; studies drive the same ones very often.
    `changed` is the state of the file with the spectra."""
    if known == "{}":
        return rough_track(np.arange(0.0, end, CELL), **json.loads(irregular)), None
    rough, _ = _rails(end, irregular, "{}", changed)
    return rough, preview.plan(rough, **json.loads(known))


def _is_ours(controller: str) -> bool:
    """Whether the factory of a controller, with what it is given, comes from this package."""
    if controller not in registry.CONTROLLERS:
        return False
    build = registry.CONTROLLERS[controller].build
    parts = (build.func, *build.args) if isinstance(build, partial) else (build,)
    return all(part.__module__.partition(".")[0] == "railrepro" for part in parts if callable(part))


Measure = Callable[[simulate.Run, Experiment], store.Entry]


def _values(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """What the row of an experiment has, and the kept series."""
    stride = experiment.stride
    return experiment.values(run), metrics.gear_series(run.series, stride=stride) if stride else None


def _measured(experiment: Experiment, measure: Measure) -> store.Entry:
    return measure(experiment.run(), experiment)


def run_all(
    experiments: Sequence[Experiment], title: str, quiet: bool = False
) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """Run experiments in parallel (`executor`), with a progress bar called `title` unless `quiet`.

    Returns:
        table (DataFrame): One row per experiment, in order: scenario, controller, labels and metrics (SI) of
            `Experiment.values`.
        series (DataFrame or None): Series (`metrics.gear_series`) below each other, with labels and the column
            controller; None when no experiment keeps one.
    """
    results = ordered_map(call, experiments, title, quiet)
    stored = [
        series.assign(controller=experiment.controller)
        for experiment, (_, series) in zip(experiments, results, strict=True)
        if series is not None
    ]
    return pd.DataFrame([row for row, _ in results]), pd.concat(stored, ignore_index=True) if stored else None
