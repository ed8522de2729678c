"""Experiments that can be sent to any worker: scenario, controller and changes, and the row of numbers they give.

Notebooks and studies are lists of these; the executor decides where they run, and `store` whether they must.
"""

from __future__ import annotations

import inspect
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache, partial
from operator import call
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro.control import registry
from railrepro.control.adhesion import AdhesionSettings
from railrepro.data import InputError, require
from railrepro.estimation import sensors
from railrepro.evidence.runs import preview, store
from railrepro.evidence.runs.executor import executor, ordered_map, work
from railrepro.simulation import metrics, ride, simulate
from railrepro.simulation.scenarios import Scenario
from railrepro.track.alignment import Alignment
from railrepro.track.rough import rough_track
from railrepro.track.route import CELL
from railrepro.track.table import build_table, load_track, write_table
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_SERIES = {
    **{"p": "p_m", "v": "v_mps", "y_ref": "y_ref_m", "y": "y_m", "psi_Ax": "psi_ax_rad", "psi_TrAx": "psi_trax_rad"},
    **{"du": "du_Nm", "u_d": "u_d_Nm", "tau_long": "tau_long_Nm", "f_star": "f_star", "segment": "segment"},
}
_WHEEL = {"tau": "tau_{}_Nm", "adhesion": "fx_{}", "sx": "sx_{}"}


@dataclass(frozen=True)
class Experiment:
    """One run to be made."""

    scenario: Scenario
    controller: str
    """Key of `registry.CONTROLLERS`."""
    label: dict = field(default_factory=dict)
    """Further columns of the row."""
    parameters: dict | None = None
    """Tuning parameters; None takes the tuned ones."""
    options: dict = field(default_factory=dict)
    """See `registry.guidance`, as `changes`."""
    changes: dict = field(default_factory=dict)
    vehicle: dict = field(default_factory=dict)
    """Vehicle parameters changed for car and controllers (`parameters.load_vehicle`)."""
    plant: dict = field(default_factory=dict)
    """The same for the car alone."""
    adhesion: AdhesionSettings | None = None
    """See `simulate.run`, as `fixed_share`."""
    fixed_share: float = 0.0
    alignment: Alignment | None = None
    """Track in place of that of the scenario."""
    irregular: dict = field(default_factory=dict)
    """Arguments of `rough_track` besides the coordinates; empty is an ideal track."""
    preview: dict = field(default_factory=dict)
    """What the controller knows of the irregularities, and the line that it plans with it: arguments of `preview.plan`
    besides the frame; empty is nothing."""
    sensors: dict = field(default_factory=dict)
    """Arguments of `railrepro.estimation.sensors.readings`; empty is nothing between car and controllers."""
    setting: str = registry.PAPER
    """Which tuned parameters are taken, see `registry.parameters`."""
    substeps: int | None = None
    """See `simulate.run`; default 2 for ride figures on irregular rails, whose wheel loads need it, else 1."""
    ride: bool = False
    """Whether the row also has the figures of `ride.ride_summary`."""
    stride: int = 0
    """Every n-th control cycle of the front gear is kept as a series; 0 keeps none."""

    def __post_init__(self) -> None:
        require("experiment: scenario", self.scenario, Scenario)
        for name in ("vehicle", "plant", "sensors", "irregular", "preview"):
            require(f"experiment: {name}", getattr(self, name), dict)

    def car(self) -> Vehicle:
        """The car that is driven, with all changes."""
        return load_vehicle(**self.vehicle | self.plant)

    def tuned(self) -> dict:
        """Tuning parameters of the controller."""
        if self.parameters is not None:
            return self.parameters
        return registry.parameters(self.controller, self.setting)

    def rails(self) -> tuple[pd.DataFrame | None, tuple[np.ndarray, np.ndarray] | None]:
        """Irregularities, and the line that is planned with what is known of them; None where there is nothing."""
        if not self.irregular and not self.preview:
            return None, None
        if not self.irregular:
            raise InputError("preview: the track is ideal, `irregular` is needed to know anything of it")
        allowed = [name for name in inspect.signature(preview.plan).parameters if name != "frame"]
        if unknown := sorted(set(self.preview) - set(allowed)):
            raise InputError(f"preview: {unknown[0]!r} is not known; there are {allowed}")
        return _rails(self.scenario.end_m, json.dumps(self.irregular), json.dumps(self.preview))

    def run(self) -> simulate.Run:
        """The simulation itself."""
        rough, line = self.rails()
        with self._laid() as scenario:
            return simulate.run(
                scenario,
                registry.guidance(self.controller, self.tuned(), self.options, **self.changes),
                irregularities=rough,
                line=line,
                sensors=sensors.readings(**self.sensors) if self.sensors else None,
                substeps=1 + bool(self.ride and self.irregular) if self.substeps is None else self.substeps,
                vehicle=load_vehicle(**self.vehicle),
                plant_vehicle=self.car(),
                adhesion=self.adhesion,
                fixed_share=self.fixed_share,
            )

    @contextmanager
    def _laid(self) -> Iterator[Scenario]:
        """The scenario, on its own track or on `alignment`."""
        if self.alignment is None:
            yield self.scenario
            return
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / f"{self.alignment.name}.csv"
            write_table(build_table(self.alignment), file)
            yield self.scenario.but(track=str(file))

    def key(self, measure: Measure) -> str | None:
        """Key of what a function measures of this run (`store.key`); None when it cannot be stored.

        It holds the resolved values, not the names of vehicle, parameters, track and sensors, and the code that the run
        and the function can reach.
        """
        if not _is_ours(self.controller):
            return None  # of a user's file
        scenario = {name: value for name, value in vars(self.scenario).items() if name not in ("name", "track")}
        track = None if self.alignment else load_track(self.scenario.track_file())
        believed, car = load_vehicle(**self.vehicle), self.car()
        read = vars(self) | {
            "scenario": (scenario, track and (track.table.to_numpy(), track.design_speed)),
            "label": {},
            "parameters": self.tuned(),
            "vehicle": believed,
            "plant": car,
            "irregular": self.rails(),
            "sensors": (self.sensors, sensors.load_loop()) if self.sensors else None,
        }
        return store.key(measure.__module__, measure.__qualname__, read)

    def measured(self, measure: Measure) -> store.Entry:
        """What a function measures of this run: from the store where it is there, else by a worker (`executor.work`).

        `measure` is a function of a module, (Run, Experiment) -> row of plain values and table of numbers or None,
        which uses of the experiment what `key` holds.
        """
        return store.entry(self.key(measure), lambda: work(_measured, self, measure))

    def __call__(self) -> tuple[dict, pd.DataFrame | None]:
        """Row of metrics, see `values`, and the kept series."""
        values, series = self.measured(_values)
        row = {"scenario": self.scenario.name, "controller": self.controller, **self.label, **values}
        return row, None if series is None else series.assign(**self.label)

    def values(self, run: simulate.Run) -> dict:
        """Metrics of a run (SI); of a failed run the place instead of how well it followed."""
        vehicle, series = self.car(), run.series
        values = metrics.summary(series, vehicle.drive.torque_limit)
        if run.failed:
            values = {name: (np.nan, unit) for name, (_, unit) in values.items()}
        values |= metrics.longitudinal(series, self.scenario, vehicle)
        if self.ride and not run.failed:
            values |= ride.ride_summary(series, vehicle)
        row = {name: value for name, (value, _) in values.items()}
        row |= {"failed_at_m": float(series["front.p"].iloc[-1]) if run.failed else np.nan}
        row |= {"failed": run.failed, "ended": run.ended, "warnings": "; ".join(run.warnings)}
        return row | {"fallbacks": sum(getattr(controller, "fallbacks", 0) for controller in run.controllers)}


@lru_cache(maxsize=64)
def _rails(end: float, irregular: str, known: str) -> tuple[pd.DataFrame, tuple[np.ndarray, np.ndarray] | None]:
    """Irregularities up to a coordinate (m), and the line planned with them; studies drive the same ones very often."""
    if known == "{}":
        return rough_track(np.arange(0.0, end, CELL), **json.loads(irregular)), None
    rough, _ = _rails(end, irregular, "{}")
    return rough, preview.plan(rough, **json.loads(known))


def tidy(series: pd.DataFrame, stride: int) -> pd.DataFrame:
    """Every `stride`-th row of the front gear with the unit in each column's name (contract of data/results)."""
    rows = series.iloc[::stride]
    columns = {"t_s": rows["t_s"]} | {new: rows[f"front.{old}"] for old, new in _SERIES.items()}
    creepage = rows["front_ri.nu_y"] + rows["front_le.nu_y"]
    columns |= {"creep_rad": -creepage / 2}  # the angle between heading and motion
    columns |= {name.format(side): rows[f"front_{side}.{old}"] for side in ("ri", "le") for old, name in _WHEEL.items()}
    return pd.DataFrame(columns)


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
    return experiment.values(run), tidy(run.series, experiment.stride) if experiment.stride else None


def _measured(experiment: Experiment, measure: Measure) -> store.Entry:
    return measure(experiment.run(), experiment)


def run_all(
    experiments: Sequence[Experiment], title: str, quiet: bool = False
) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """Run experiments on the executor, with a progress bar unless `quiet`.

    Returns
    -------
    table : DataFrame
        One row per experiment, in order.
    series : DataFrame or None
        Kept series with the column `controller`, or None.
    """
    with executor() as pool:
        results = ordered_map(pool, call, experiments, title, quiet)
    stored = [
        series.assign(controller=experiment.controller)
        for experiment, (_, series) in zip(experiments, results, strict=True)
        if series is not None
    ]
    return pd.DataFrame([row for row, _ in results]), pd.concat(stored, ignore_index=True) if stored else None
