"""Experiments: a scenario and a controller with changes of both, from which a run and its metrics are computed."""

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
    """Closed-loop run that is yet to be simulated; calling it returns its metrics and its series.

    Attributes:
        scenario: Track, speed, adhesion, set point and force demand.
        controller: Key of `registry.CONTROLLERS`, such as "nmpc", "ltv_mpc" or "ndi".
        label: Column -> value, added to the row of metrics and to the series, to tell runs apart.
        parameters: Tuning parameters by name (data/tuning.toml); None takes the tuned set of `setting`.
        options: Arguments of MPC: {"solver": "rti"}, "gauss_newton" or "ipopt" (NMPC); {"printed": True} (LTV-MPC).
        changes: Changed fields of the controller's settings (`MPCSettings`, `NDI`), as {"steps": 20} or {"pole": 40.0}.
        vehicle: Changed parameters of the car, known to its controllers, as {"body.mass": 3e4}; keys of `load_vehicle`.
        plant: Changed parameters of the simulated car, unknown to its controllers, with the keys of `vehicle`.
        adhesion: Settings of the adhesion law (slip control). None: its defaults; with sensors the settings [adhesion]
            of data/sensors.toml, because noise needs slower filters and a larger dead zone.
        fixed_share: Fraction of the torque limit reserved for guidance (-); 0 is the paper's allocation.
        alignment: Alignment of a track, which replaces the track of the scenario; None: no change.
        irregular: Irregular rails: spectrum, seed and local defects, the arguments of `rough_track` besides p, as
            {"spectrum": "en_B_300", "seed": 3, "defects": [{"kind": "dip", …}]}; {} is an ideal track.
        preview: Plan of the set point with known irregularities: arguments of `preview.plan` besides `frame`; {} for
            none.
        sensors: Sensors with noise and delays: arguments of `sensors.readings`; {} gives controllers the true signals.
        setting: Setting of comparison whose tuned parameters are taken: "paper" (exact signals) or "loop" (sensors).
        substeps: Integration steps of the car per ms; None is 2 for ride figures on irregular rails, else 1.
        ride: Whether the row also has the comfort and force figures of `ride.ride_summary`.
        stride: The series has every n-th control cycle (1 ms), see `metrics.gear_series`; 0 for no series.
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
        """Tuning parameters of the controller by name: `parameters`, or the parameters of its tuned set."""
        return registry.parameters(self.controller, self.setting) if self.parameters is None else self.parameters

    def run(self) -> simulate.Run:
        """Simulate and return the run: series of both gears and why it ended. The store is not used."""
        around = self._surroundings()
        return simulate.run(
            self.scenario,
            registry.guidance(self.controller, self.tuned(), self.options, **self.changes),
            route=around.route,
            sensors=around.sensors,
            substeps=1 + bool(self.ride and self.irregular) if self.substeps is None else self.substeps,
            vehicle=around.nominal,
            plant_vehicle=around.car,
            adhesion=self.adhesion,
            fixed_share=self.fixed_share,
        )

    def _surroundings(self) -> "Surroundings":
        """`Surroundings` of the run, made once for all runs with equal fields and unchanged files."""
        files = [*map(paths.source, _FILES), Path(self.scenario.track_file())]
        try:
            packed = pickle.dumps([getattr(self, name) for name in _AROUND])
        except (pickle.PickleError, TypeError, AttributeError):  # of a value that is refused
            return _made(self)
        return _shared(packed, tuple((str(file), code.signature(file)) for file in files))

    def key(self, measure: "Measure") -> str | None:
        """Hash under which `store` keeps what the function `measure` returns for this run (see `measured`). It depends
        on the code and on all values of vehicle, tuning parameters, track and sensors, not on names and labels. None
        for a controller from a user's file, whose results are not stored."""
        if not _is_ours(self.controller):
            return None
        around = self._surroundings().digest
        others = {name: value for name, value in vars(self).items() if name not in ("label", "setting", *_AROUND)}
        others |= {"parameters": self.tuned()}
        return around and store.key(measure.__module__, measure.__qualname__, around, others)

    def measured(self, measure: "Measure") -> store.Entry:
        """Return `measure(run, experiment)` for this run, read from the store or simulated by `executor.work`.
        `measure` is a function of a module, which must not use the `label`. `measure` returns a pair: a dict of plain
        values, and a DataFrame of numbers or None."""
        return store.entry(self.key(measure), lambda: work(_measured, self, measure))

    def __call__(self) -> tuple[dict, pd.DataFrame | None]:
        """Simulate the run, or read its result from the store; returns a pair (row, series). row: dict with scenario,
        controller, the keys of `label`, and the metrics of `values`. series: DataFrame of t_s, front.p, front.y,
        front.du, … (`metrics.gear_series`) with the `label` as columns, None for a `stride` of 0."""
        values, series = self.measured(_values)
        row = {"scenario": self.scenario.name, "controller": self.controller, **self.label, **values}
        return row, None if series is None else series.assign(**self.label)

    def values(self, run: simulate.Run) -> dict:
        """Metrics of a run, in SI units, as a dict from name to value. Of the front gear, NaN if the run failed (m,
        torques N m): RMS of y - y* (rmse_y, of the rear gear rmse_y_rear), of y from the irregular rails minus y*
        (followed_rmse_y), of y from these rails (rail_rmse_y), of the differential torque du (effort_du) and of du
        above 5 Hz (activity_du); largest |y - y*| (largest_error), mean of y - y* in the last third
        (mean_error_last_third), distance by which y trails y* (delay). Further: largest_slip of all wheels (-);
        stopping_distance (m), the distance driven; with a force demand, utilisation, mean adhesion over its limit (-);
        failed (bool); failed_at_m, where it failed (m; NaN unless failed); ended, why the run ended (text); warnings
        (text); fallbacks, number of samples of both gears in which a predictive controller found no solution; with
        `ride`, forces and comfort from `ride.ride_summary`, as y_over_q."""
        vehicle, series = self._surroundings().car, run.series
        values = metrics.summary(series)
        if run.failed:
            values = {name: (np.nan, unit) for name, (_, unit) in values.items()}
        values |= metrics.longitudinal(series, self.scenario, vehicle)
        if self.ride and not run.failed:
            values |= ride.ride_summary(series, vehicle)
        return {name: value for name, (value, _) in values.items()} | {
            "failed_at_m": float(series["front.p"].iloc[-1]) if run.failed else np.nan,
            "failed": run.failed,
            "ended": run.ended,
            "warnings": "; ".join(run.warnings),
            "fallbacks": sum(getattr(controller, "fallbacks", 0) for controller in run.controllers),
        }


class Surroundings(NamedTuple):
    """Car, route and sensors around the controllers of a run. Runs of a study share them, so they must not be changed.
    `nominal` is the car that the controllers assume, `car` the simulated one. `digest` is a hash of all values from
    which the other fields are made, for keys of `store`; None if `store` cannot hash the type of a value."""

    nominal: Vehicle
    car: Vehicle
    route: Route
    sensors: sensors.Readings | None
    digest: str | None


_AROUND = ("scenario", "alignment", "vehicle", "plant", "irregular", "preview", "sensors")
"""Fields of an `Experiment` from which its `Surroundings` follow."""
_FILES = tuple(f"data/{name}.toml" for name in ("vehicle", "tracks", "irregularities", "sensors"))
"""Files from which they follow, besides a track in a file of its own."""


@lru_cache(maxsize=32)
def _shared(packed: bytes, _files: tuple) -> Surroundings:
    """`Surroundings` of the packed values of `_AROUND`, for a state of the files."""
    return _made(Experiment(controller=registry.NOTHING, **dict(zip(_AROUND, pickle.loads(packed), strict=True))))


def _made(experiment: Experiment) -> Surroundings:
    spectra = code.signature(paths.source("data/irregularities.toml"))
    rails = _rails(experiment.scenario.end_m, json.dumps(experiment.irregular), json.dumps(experiment.preview), spectra)
    if experiment.alignment is None:
        track = load_track(experiment.scenario.track_file())
        route, table = experiment.scenario.route(*rails), (track.table.to_numpy(), track.design_speed)
    else:
        with scratch() as folder:
            file = folder / f"{experiment.alignment.name}.csv"
            write_table(build_table(experiment.alignment), file)
            route, table = experiment.scenario.but(track=str(file)).route(*rails), None
    route.cells.flags.writeable = False
    nominal, car, digest = load_vehicle(**experiment.vehicle), experiment.car(), None
    readings = sensors.readings(**experiment.sensors) if experiment.sensors else None
    scenario = {name: value for name, value in vars(experiment.scenario).items() if name not in ("name", "track")}
    loop = (experiment.sensors, sensors.load_loop()) if experiment.sensors else None
    with suppress(TypeError):
        digest = store.digest(scenario, table, experiment.alignment, nominal, car, rails, experiment.preview, loop)
    return Surroundings(nominal, car, route, readings, digest)


@lru_cache(maxsize=64)
def _rails(end: float, irregular: str, known: str, spectra: tuple | None) -> tuple[pd.DataFrame | None, tuple | None]:
    """Irregularities (`rough_track`) up to a coordinate (m), and the pair (p, line) of `preview.plan`; None without.
    `irregular` and `known` are the fields irregular and preview as JSON, `spectra` the state of the file of spectra."""
    if irregular == known == "{}":
        return None, None
    if known == "{}":
        return rough_track(np.arange(0.0, end, CELL), **json.loads(irregular)), None
    if irregular == "{}":
        raise InputError("preview: the track is ideal, `irregular` is needed to know anything of it")
    asked, allowed = json.loads(known), [*inspect.signature(preview.plan).parameters][1:]
    if unknown := sorted(set(asked) - set(allowed)):
        raise InputError(f"preview: {unknown[0]!r} is not known; there are {allowed}")
    rough, _ = _rails(end, irregular, "{}", spectra)
    return rough, preview.plan(rough, **asked)


def _is_ours(controller: str) -> bool:
    """Whether the factory of a controller, with its arguments, comes from this package."""
    if controller not in registry.CONTROLLERS:
        return False
    build = registry.CONTROLLERS[controller].build
    parts = (build.func, *build.args) if isinstance(build, partial) else (build,)
    return all(part.__module__.partition(".")[0] == "railrepro" for part in parts if callable(part))


Measure = Callable[[simulate.Run, Experiment], store.Entry]


def _values(run: simulate.Run, experiment: Experiment) -> store.Entry:
    """Metrics of a run, and its series where the stride asks for one; for `Experiment.__call__`."""
    stride = experiment.stride
    return experiment.values(run), metrics.gear_series(run.series, stride=stride) if stride else None


def _measured(experiment: Experiment, measure: Measure) -> store.Entry:
    return measure(experiment.run(), experiment)


def run_all(experiments: Sequence[Experiment], title: str) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """Run experiments in parallel (`executor`), with a progress bar called `title`. Returns a pair: a DataFrame with a
    row per experiment, in order: scenario, controller, label, metrics (`Experiment.values`); and a DataFrame with their
    time series below each other (t_s, front.p, front.y, front.du, …), each with its label and controller as columns,
    None when no experiment has one."""
    results = ordered_map(call, experiments, title)
    pairs = zip(experiments, results, strict=True)
    series = [one.assign(controller=experiment.controller) for experiment, (_, one) in pairs if one is not None]
    return pd.DataFrame([row for row, _ in results]), pd.concat(series, ignore_index=True) if series else None
