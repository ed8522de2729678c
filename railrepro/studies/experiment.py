"""Experiments that can be sent to any worker: scenario, controller and changes, and the row of numbers they give.

Notebooks and studies are lists of these; the executor decides where they run.
"""

from __future__ import annotations

import inspect
import reprlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.law import EstimateSettings
from railrepro.control.registry import guidance
from railrepro.errors import InputError
from railrepro.simulation import metrics, ride, simulate
from railrepro.simulation.scenarios import Scenario
from railrepro.studies import tuning
from railrepro.studies.executor import executor, ordered_map
from railrepro.track import defects as defects_
from railrepro.track import preview
from railrepro.track.irregularity import CHANNELS, check, coordinates, faded, irregularities
from railrepro.track.measured import read_irregularities
from railrepro.track.route import CELL
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_SERIES = {
    **{"p": "p_m", "v": "v_mps", "y_ref": "y_ref_m", "y": "y_m", "psi_Ax": "psi_ax_rad", "psi_TrAx": "psi_trax_rad"},
    **{"du": "du_Nm", "u_d": "u_d_Nm", "tau_long": "tau_long_Nm", "f_star": "f_star", "segment": "segment"},
}
_WHEEL = {"tau": "tau_{}_Nm", "fx": "fx_{}", "sx": "sx_{}"}


@dataclass(frozen=True)
class Experiment:
    """One run to be made.

    Attributes
    ----------
    scenario : Scenario
    controller : str
        Key of `registry.CONTROLLERS`.
    label : dict
        Further columns of the row.
    parameters : dict or None
        Tuning parameters; None takes the tuned ones.
    options, changes : dict
        See `registry.guidance`.
    vehicle, plant : dict
        Vehicle parameters changed for car and controllers, and for the car alone (`parameters.load_vehicle`).
    adhesion, estimate, fixed_share
        See `simulate.run`.
    irregular : dict
        Arguments of `rough_track` besides the coordinates; empty is an ideal track.
    preview : dict
        What the controller knows of the irregularities, and the line that it plans with it: arguments of
        `preview.known` and `preview.planned_line` besides the frame (`smoothing_m` is that of the line); empty is
        nothing.
    substeps : int
        See `simulate.run`.
    ride : bool
        Whether the row also has the figures of `ride.ride_summary`.
    stride : int
        Every n-th exchange of the front gear is kept as a series; 0 keeps none.
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
    estimate: EstimateSettings | None = None
    fixed_share: float = 0.0
    irregular: dict = field(default_factory=dict)
    preview: dict = field(default_factory=dict)
    substeps: int = 1
    ride: bool = False
    stride: int = 0

    def car(self) -> Vehicle:
        """The car that is driven, with all changes."""
        return load_vehicle(**self.vehicle | self.plant)

    def run(self) -> simulate.Run:
        """The simulation itself."""
        parameters = tuning.load(self.controller)["parameters"] if self.parameters is None else self.parameters
        law = guidance(self.controller, parameters, self.options, **self.changes)
        rough = None
        if self.irregular:
            _fit("irregular", self.irregular, rough_track, irregularities)
            rough = rough_track(np.arange(0.0, self.scenario.end_m, CELL), **self.irregular)
        if self.preview:
            _fit("preview", self.preview, _line, preview.known)
            if rough is None:
                raise InputError("preview: the track is ideal, `irregular` is needed to know anything of it")
        return simulate.run(
            self.scenario,
            law,
            irregularities=rough,
            line=_line(rough, **self.preview) if self.preview else None,
            substeps=self.substeps,
            vehicle=load_vehicle(**self.vehicle),
            plant_vehicle=self.car(),
            adhesion=self.adhesion,
            estimate=self.estimate,
            fixed_share=self.fixed_share,
        )

    def __call__(self) -> tuple[dict, pd.DataFrame | None]:
        """Row of metrics (SI) and the kept series; of a failed run the place instead of how well it followed."""
        run, vehicle = self.run(), self.car()
        values = metrics.summary(run.series, vehicle.drive.torque_limit)
        if run.failed:
            values = {name: (np.nan, unit) for name, (_, unit) in values.items()}
        values |= metrics.longitudinal(run.series, self.scenario, vehicle)
        if self.ride and not run.failed:
            values |= ride.ride_summary(run.series, vehicle)
        row = {"scenario": self.scenario.name, "controller": self.controller, **self.label}
        row |= {name: value for name, (value, _) in values.items()}
        row |= {"failed_at_m": float(run.series["front.p"].iloc[-1]) if run.failed else np.nan}
        solves = [solve for controller in run.controllers for solve in controller.stats]
        row |= {"failed": run.failed, "ended": run.ended, "warnings": "; ".join(run.warnings)}
        row |= {"fallbacks": sum(solve.fallback for solve in solves)}
        return row, tidy(run.series, self.stride).assign(**self.label) if self.stride else None


def rough_track(p: np.ndarray, file: str | None = None, defects: Sequence[dict] = (), **random) -> pd.DataFrame:
    """Irregularities of a run.

    Parameters
    ----------
    p : ndarray, shape (n,)
        Track coordinates (m).
    file : str, optional
        Measured irregularities (`measured.read_irregularities`) in place of random ones.
    defects : sequence of dict
        Localised defects added to them: `kind` (a function of `railrepro.track.defects`) and its other arguments.
    random
        Arguments of `irregularity.irregularities`: spectrum, seed, shortest, longest.

    Returns
    -------
    DataFrame
        p_m and the columns of `irregularity.CHANNELS`.

    Raises
    ------
    InputError
        An argument that is not known, missing, or not of this kind; more than the flangeway takes.
    """
    p = coordinates(p)
    _fit("irregular", random, *([irregularities] if file is None else []))
    if file is None:
        frame = irregularities(p, **random)
    else:
        if not isinstance(file, str):
            raise InputError(f"irregular: file is {file!r}, the path of a CSV is needed")
        measured = read_irregularities(paths.source(file), length=float(p[-1]))
        channels = {c: np.interp(p, measured["p_m"], measured[c]) for c in CHANNELS.values()}
        frame = faded(pd.DataFrame({"p_m": p} | channels))
    shapes = {
        "dip": defects_.dip,
        "alignment_fault": defects_.alignment_fault,
        "lateral_offset": defects_.lateral_offset,
    }
    added = []
    if not isinstance(defects, list | tuple):
        raise InputError(f"irregular: defects are {reprlib.repr(defects)}, a list of tables is needed")
    for defect in defects:
        kind = defect.get("kind") if isinstance(defect, dict) else defect
        if kind not in tuple(shapes) or kind is defect:
            raise InputError(f"defect kind {kind!r} is not known; there are {sorted(shapes)}")
        arguments = {key: value for key, value in defect.items() if key != "kind"}
        _fit(f"defect {kind}", arguments, shapes[kind])
        added.append(shapes[kind](p, **arguments))
    total = defects_.superpose(frame, *added)
    check(total)
    return total


def _fit(what: str, given: dict, *functions: Callable) -> None:
    """Refuse a table of arguments with a name that none of the functions takes, or without one that they need.

    The first parameter of each (coordinates or a frame) is given anyway.
    """
    if not isinstance(given, dict):
        raise InputError(f"{what}: is {reprlib.repr(given)}, a table of arguments is needed")
    takes = [
        parameter for function in functions for parameter in list(inspect.signature(function).parameters.values())[1:]
    ]
    known = {parameter.name: parameter for parameter in takes if parameter.kind is not parameter.VAR_KEYWORD}
    for key in given:
        if key not in known:
            raise InputError(f"{what}: {key!r} is not known; there are {list(known)}")
    for name, parameter in known.items():
        if parameter.default is parameter.empty and name not in given:
            raise InputError(f"{what}: {name!r} is missing; needed are {list(known)}")


def _line(rough: pd.DataFrame, share=1.0, smoothing_m=3.0, limit=5e-3, **errors) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and planned line with its derivatives, from what is known of the irregularities."""
    believed = preview.known(rough, **errors)
    return believed["p_m"].to_numpy(), preview.planned_line(believed, share, smoothing_m, limit)


def tidy(series: pd.DataFrame, stride: int, gear: str = "front") -> pd.DataFrame:
    """Every `stride`-th row of one gear with the unit in each column's name (contract of data/results)."""
    rows = series.iloc[::stride]
    columns = {"t_s": rows["t_s"]} | {new: rows[f"{gear}.{old}"] for old, new in _SERIES.items()}
    columns |= {
        name.format(side): rows[f"{gear}_{side}.{old}"] for side in ("ri", "le") for old, name in _WHEEL.items()
    }
    return pd.DataFrame(columns)


def _call(experiment: Experiment):
    return experiment()


def run_all(
    experiments: Sequence[Experiment], title: str, quiet: bool = False
) -> tuple[pd.DataFrame, pd.DataFrame | None]:
    """Run experiments on the executor.

    Parameters
    ----------
    experiments : sequence of Experiment
    title : str
        Text of the progress bar.
    quiet : bool
        No progress bar.

    Returns
    -------
    table : DataFrame
        One row per experiment, in order.
    series : DataFrame or None
        Kept series with the column `controller`, or None.
    """
    with executor() as pool:
        results = ordered_map(pool, _call, experiments, title, quiet)
    kept = [
        series.assign(controller=experiment.controller)
        for experiment, (_, series) in zip(experiments, results, strict=True)
        if series is not None
    ]
    return pd.DataFrame([row for row, _ in results]), pd.concat(kept, ignore_index=True) if kept else None
