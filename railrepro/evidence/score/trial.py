"""One case of one controller in a process of its own, which cannot take anybody else along.

A stranger's controller may throw, loop for ever, exit, or crash the interpreter: it runs in a copy of the worker that
ends by a signal of the system when its time is over. What went wrong comes back as a sentence.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from pathlib import Path

import numpy as np

from railrepro.compile import codegen
from railrepro.control import lateral
from railrepro.control.registry import REGISTERED, guidance
from railrepro.evidence.runs.experiment import Experiment, sample_times, tidy
from railrepro.evidence.score import suite
from railrepro.evidence.score.entry import NOT_FINITE, Entry, fault
from railrepro.evidence.uncertainty.margins import QUANTITIES, RAILS, survived
from railrepro.simulation.scenarios import load_scenario

PROCESSOR, WALL = 20.0, 60.0
"""Time limits of a case: of the processor, and of the clock for one that sleeps (s)."""
STRIDE = 20
"""Every n-th exchange is kept for the page."""
DRIVES = 3
"""Drives of which each sample's least time counts, for a case that leaves the time for it."""
_CALLS = 2000
MARGINS = ("delay", "lag")


@dataclass(frozen=True)
class Trial:
    """A case driven by an entry; a call gives its row, whatever happens. Picklable.

    Attributes
    ----------
    entry : Entry
    case : Case or str
        A run, or the setting in which the margins are looked for.
    seed : int
    processor, wall : float
        Time limits (s).
    """

    entry: Entry
    case: suite.Case | str
    seed: int = suite.SEED
    processor: float = PROCESSOR
    wall: float = WALL

    def __call__(self) -> dict:
        """Row of metrics; `failure` is a sentence, empty when all went well."""
        _ready()
        task = self._margins if isinstance(self.case, str) else self._run
        return self.head() | alone(task, Path(self.entry.file), self.processor, self.wall)

    def head(self) -> dict:
        """Row of a case that gave nothing."""
        name, setting = ("margins", self.case) if isinstance(self.case, str) else (self.case.name, self.case.setting)
        return {"scenario": name, "setting": setting, "controller": self.entry.name, "failure": "", "series": None}

    def _experiment(self, scenario, setting: str, **around) -> Experiment:
        name, parameters = self.entry.enter(setting)
        return Experiment(
            scenario, name, parameters=parameters, options=REGISTERED[name].quick, setting=setting, **around
        )

    def _run(self) -> dict:
        case = self.case
        experiment = self._experiment(
            case.scenario, case.setting, irregular=case.irregular, plant=case.plant, sensors=case.sensors, ride=True
        )
        law = guidance(experiment.controller, experiment.parameters, experiment.options)
        begin = time.monotonic()
        run = experiment.run()
        spent = max(time.process_time() / self.processor, (time.monotonic() - begin) / self.wall)
        row = {key: value for key, value in experiment.row(run).items() if isinstance(value, float | int)}
        lost = sum(count for name, count in run.memory.items() if name.endswith(f".lateral.{NOT_FINITE}"))
        ended = f"torque() gave {lost:.0f} times no finite number; {run.ended}" if lost else run.ended
        row |= {"failure": ended if run.failed or lost else "", "way": float(run.series["front.p"].iloc[-1])}
        if case.scenario.stop_kmh is not None and not run.ended.startswith("stop"):
            row["stopping_distance"] = float("nan")
        elif case.scenario.stop_kmh is None:
            row.pop("stopping_distance")
        row["comfort"] = max((row[k] for k in row if k.startswith("n_mv_")), default=float("nan"))
        again = DRIVES - 1 if spent < 1 / (2 * DRIVES) else 0
        seconds = sample_times(run, experiment, again) if run.controllers else _call_times(law)
        row |= {"sample_median": float(np.median(seconds)), "sample_p99": float(np.quantile(seconds, 0.99))}
        row["sample_max"] = float(np.max(seconds))
        stored = tidy(run.series, STRIDE)[["p_m", "y_m", "y_ref_m", "du_Nm"]]
        return row | {"series": {name: stored[name].round(7).tolist() for name in stored}}

    def _margins(self) -> dict:
        """Smallest over the rails of what is survived of each quantity."""
        found = {}
        for what in MARGINS:
            values = [survived(self._fails(what, rail), QUANTITIES[what]) for rail in RAILS]
            found[f"{what}_survived"] = min(value if isfinite(value) else 0.0 for value in values)
        return found

    def _fails(self, what: str, rail: str) -> Callable[[float], bool]:
        name, end = RAILS[rail]
        perfect = {} if self.case == suite.LOOP else {"perfect": True}

        def fails(value: float) -> bool:
            change = QUANTITIES[what].change(value)
            sensors = {"seed": self.seed} | perfect | change.get("sensors", {})
            scenario = load_scenario(name).but(end_m=end)
            return self._experiment(scenario, self.case, plant=change.get("plant", {}), sensors=sensors).run().failed

        return fails


def call(trial: Trial) -> dict:
    """The row of a trial, for `executor.ordered_map`."""
    return trial()


@lru_cache
def _ready() -> None:
    """Load what all cases need, so that the copies of this process have it."""
    for sensors in ({}, {"seed": 1}):
        Experiment(load_scenario("curve_entry_T3").but(end_m=1.0), "ndi", parameters=_ANY, sensors=sensors).run()


_ANY = {"pole": 30.0, "frequency": 30.0, "damping": 1.0}


def _call_times(law: lateral.LateralLaw) -> list[float]:
    """Times of single calls of a compiled 1 kHz law through Python, most of it the way there and back (s)."""
    function = codegen.compiled(lateral.kind(law).function)
    for argument in function.arguments:
        argument[:] = 0.1
    times = []
    for _ in range(_CALLS):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return times


def alone(task: Callable[[], dict], file: Path, processor: float, wall: float) -> dict:
    """Result of a task in a copy of this process, or `failure`, one sentence.

    Parameters
    ----------
    task : callable
        Without arguments; its result must be JSON.
    file : Path
        Where lines of a stranger's faults are looked up.
    processor, wall : float
        Time limits (s); the compiler does not count for the first.
    """
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(read)
            _limit(processor, wall)
            answer = json.dumps(_attempt(task, file)).encode()
            with os.fdopen(write, "wb") as stream:
                stream.write(answer)
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read, "rb") as stream:
        answer = stream.read()
    _, status = os.waitpid(child, 0)
    ended = signal.Signals(os.WTERMSIG(status)) if os.WIFSIGNALED(status) else None
    if ended in (signal.SIGXCPU, signal.SIGKILL):
        return {"failure": f"took more than {processor:g} s of the processor"}
    if ended is signal.SIGALRM:
        return {"failure": f"took more than {wall:g} s"}
    try:
        return json.loads(answer)
    except ValueError:
        return {"failure": f"ended the process{f' by signal {ended.name}' if ended else ''}"}


def _limit(processor: float, wall: float) -> None:
    """Have the system end this process when its time is over, and let nobody hear what it prints."""
    faulthandler.disable()
    for number in (signal.SIGXCPU, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, wall)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    seconds = int(processor) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    with open(os.devnull, "w") as nobody:
        for stream in (1, 2):
            os.dup2(nobody.fileno(), stream)


def _attempt(task: Callable[[], dict], file: Path) -> dict:
    try:
        return task()
    except (Exception, SystemExit) as error:  # a stranger's controller may raise whatever it likes
        return {"failure": fault(error, file)}
