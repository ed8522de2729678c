"""One case of one controller: the car is driven and measured here, a file's controller lives in a confined process."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from railrepro.compile import codegen
from railrepro.compile.codegen import CompilerError
from railrepro.control import lateral
from railrepro.control.law import GEARS, SIDES
from railrepro.control.registry import REGISTERED, guidance
from railrepro.errors import InputError
from railrepro.evidence.runs.experiment import Experiment, sample_times, tidy
from railrepro.evidence.score import suite
from railrepro.evidence.score.entry import Entry, register
from railrepro.evidence.score.host import (
    NOT_FINITE,
    PROCESSOR,
    WALL,
    Fault,
    Guest,
    HandedGuidance,
    HandedLaw,
)  # fmt: skip
from railrepro.simulation import metrics
from railrepro.simulation.simulate import Run
from railrepro.track.route import INDEX

STRIDE = 20
"""Every n-th exchange is kept for the page."""
DRIVES = 3
"""Drives of which each sample's least time counts, where they take less than `PATIENCE`."""
PATIENCE = 10.0
"""Time of a drive above which it is not repeated for the times of its samples (s)."""
_CALLS = 2000


@dataclass(frozen=True)
class Trial:
    """A case driven by an entry; a call gives its row, whatever the controller does. Picklable.

    Attributes
    ----------
    entry : Entry
    case : Case
    processor, wall : float
        Time limits of a file's controller (s).
    """

    entry: Entry
    case: suite.Case
    processor: float = PROCESSOR
    wall: float = WALL

    def __call__(self) -> dict:
        """Row of metrics; `failure` is a sentence, empty when all went well."""
        guests: list[HandedGuidance] = []
        try:
            return self.head() | self._run(guests)
        except (Fault, InputError, ArithmeticError, CompilerError) as error:
            return self.head() | {"failure": str(error)}
        finally:
            for hosted in guests:
                hosted.close()

    def head(self) -> dict:
        """Row of a case that gave nothing."""
        case = self.case
        names = {"scenario": case.name, "setting": case.setting, "group": case.group or case.name}
        return names | {"controller": self.entry.name, "failure": "", "series": None}

    def experiment(self, guests: list[HandedGuidance]) -> Experiment:
        """The run; controllers of a file that live in a process are entered in `guests`."""
        case, file = self.case, self.entry.file
        if file:
            law = handed(file, Path(file).read_bytes(), case.setting, self.processor, self.wall)
            hosted = HandedLaw(law)
            if law["slow"]:
                hosted = HandedGuidance(law, partial(Guest, file, case.setting, self.processor, self.wall))
                guests.append(hosted)
            name, parameters, options = register(f"own {self.entry.name}", lambda settings: hosted), {}, {}
        else:
            name, parameters = self.entry.enter(case.setting)
            options = REGISTERED[name].quick
        if case.delay:
            inner = guidance(name, parameters, options)
            name = register(f"delayed {self.entry.name}", lambda settings: suite.delayed(inner, case.delay))
            parameters, options = {}, {}
        around = {"irregular": case.irregular, "plant": case.plant, "sensors": case.sensors, "ride": True}
        return Experiment(case.scenario, name, parameters=parameters, options=options, setting=case.setting, **around)

    def _run(self, guests: list[HandedGuidance]) -> dict:
        experiment, begin = self.experiment(guests), time.monotonic()
        run = experiment.run()
        spent = time.monotonic() - begin
        row = {key: value for key, value in experiment.row(run).items() if isinstance(value, float | int)}
        lost = sum(count for name, count in run.memory.items() if name.endswith(f".lateral.{NOT_FINITE}"))
        ended = f"torque() returned NaN or Inf {lost:.0f} times; {run.ended}" if lost else run.ended
        row |= {"failure": ended if run.failed or lost else "", "way": float(run.series["front.p"].iloc[-1])}
        if self.case.scenario.stop_kmh is None:
            row.pop("stopping_distance")
        elif not run.ended.startswith("stop"):
            row["stopping_distance"] = float("nan")
        row["comfort"] = max((row[k] for k in row if k.startswith("n_mv_")), default=float("nan"))
        if self.case.group != suite.MARGINS:
            row["series"] = series(run, experiment)
        return row | (sampled(run, experiment, spent) if self.case.timed else {})


def driven_file(entry: Entry, case: suite.Case) -> Run:
    """Run of a file's controller in a case; InputError with what it did wrong."""
    guests: list[HandedGuidance] = []
    try:
        return Trial(entry, case).experiment(guests).run()
    except Fault as error:
        raise InputError(str(error)) from None
    finally:
        for hosted in guests:
            hosted.close()


def call(trial: Trial) -> dict:
    """The row of a trial, for `executor.ordered_map`."""
    return trial()


@lru_cache(maxsize=16)
def handed(file: str, content: bytes, setting: str, processor: float, wall: float) -> dict:
    """Law of a file, see `guest.operations`; asked once for the same content."""
    guest = Guest(file, setting, processor, wall)
    guest.close()
    return guest.law


def series(run: Run, experiment: Experiment) -> dict[str, dict[str, list]]:
    """What the page draws of a run, by gear: p, y, y_ref (m), du (N m) and the share of the adhesion in use (-)."""
    scenario, vehicle, route = experiment.scenario, experiment.car(), experiment.scenario.route()
    rows, found = run.series.iloc[::STRIDE], {}
    for gear in GEARS:
        p, speed = rows[f"{gear}.p"].to_numpy(), rows[f"{gear}.v"].to_numpy()
        used = []
        for wheel, side in ((f"{gear}_{side}", side) for side in SIDES):
            share = route.rows_at(p)[:, INDEX[f"poor_{side}"]]
            force = np.hypot(rows[f"{wheel}.Fx"], rows[f"{wheel}.Fy"]) / np.maximum(rows[f"{wheel}.N"], 1.0)
            used.append(force / metrics.adhesion_limit(speed, share, scenario, vehicle))
        columns = tidy(run.series, STRIDE, gear)[["p_m", "y_m", "y_ref_m", "du_Nm"]]
        columns["adhesion"] = np.max(used, axis=0)
        found[gear] = {name: columns[name].round(7).tolist() for name in columns}
    return found


def sampled(run: Run, experiment: Experiment, spent: float) -> dict[str, float]:
    """Times of the samples of a run that took `spent` (s)."""
    again = DRIVES - 1 if spent < PATIENCE else 0
    seconds = sample_times(run, experiment, again) if run.controllers else call_times(experiment)
    row = {"sample_median": np.median(seconds), "sample_p99": np.quantile(seconds, 0.99), "sample_max": seconds.max()}
    return {name: float(value) for name, value in row.items()}


def call_times(experiment: Experiment) -> np.ndarray:
    """Times of single calls of a compiled 1 kHz law (s), each the least of `DRIVES`: most is the way through Python."""
    law, _ = lateral.split(guidance(experiment.controller, experiment.tuned()))
    function = codegen.compiled(lateral.kind(law).function)
    for argument in function.arguments:
        argument[:] = 0.1
    times = np.empty((DRIVES, _CALLS))
    for drive in range(DRIVES):
        for k in range(_CALLS):
            begin = time.perf_counter()
            function()
            times[drive, k] = time.perf_counter() - begin
    return times.min(axis=0)
