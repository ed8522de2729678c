"""One case of one controller: the car is driven, and what the controller does wrong becomes a sentence in its row."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from railrepro.compile.codegen import CompilerError
from railrepro.control.registry import CONTROLLERS, guidance
from railrepro.data import InputError
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.score import suite
from railrepro.evidence.score.entry import Entry, fault, load_class, made, register


@dataclass(frozen=True)
class Trial:
    """A case driven by an entry; a call gives its row, whatever the controller does. Picklable.

    Attributes
    ----------
    entry : Entry
    case : Case
    """

    entry: Entry
    case: suite.Case

    def __call__(self) -> dict:
        """Row of metrics; `failure` is a sentence, empty when all went well."""
        own = None
        try:
            own = load_class(Path(self.entry.file)) if self.entry.file else None
            return self.head() | self._run(own)
        except (InputError, ArithmeticError, CompilerError) as error:
            said = fault(error, Path(self.entry.file), own) if self.entry.file else str(error)
        except (Exception, SystemExit) as error:  # the file of a user may raise whatever it likes
            if not self.entry.file:
                raise
            said = fault(error, Path(self.entry.file), own)
        return self.head() | {"failure": said}

    def head(self) -> dict:
        """Row of a case that gave nothing."""
        case = self.case
        names = {"scenario": case.name, "setting": case.setting, "group": case.group or case.name}
        return names | {"controller": self.entry.name, "failure": ""}

    def experiment(self, own: type | None = None) -> Experiment:
        """The run, with the class of the entry's file when it has one."""
        case = self.case
        if own is not None:
            written = suite.counted(made(own, case.setting))
            name, parameters, options = register(f"own {self.entry.name}", lambda settings: written), {}, {}
        else:
            name, parameters = self.entry.enter(case.setting)
            options = CONTROLLERS[name].quick
        if case.delay:
            inner = guidance(name, parameters, options)
            name = register(f"delayed {self.entry.name}", lambda settings: suite.delayed(inner, case.delay))
            parameters, options = {}, {}
        around = {"irregular": case.irregular, "plant": case.plant, "sensors": case.sensors, "ride": True}
        return Experiment(case.scenario, name, parameters=parameters, options=options, setting=case.setting, **around)

    def _run(self, own: type | None) -> dict:
        experiment = self.experiment(own)
        run = experiment.run()
        row = {key: value for key, value in experiment.row(run).items() if isinstance(value, float | int)}
        lost = sum(count for name, count in run.memory.items() if name.endswith(f".lateral.{suite.LOST}"))
        ended = f"torque() returned NaN or Inf {lost:.0f} times; {run.ended}" if lost else run.ended
        row |= {"failure": ended if run.failed or lost else "", "way": float(run.series["front.p"].iloc[-1])}
        if self.case.scenario.stop_kmh is None:
            row.pop("stopping_distance")
        elif not run.ended.startswith("stop"):
            row["stopping_distance"] = float("nan")
        row["comfort"] = max((row[k] for k in row if k.startswith("n_mv_")), default=float("nan"))
        return row


def call(trial: Trial) -> dict:
    """The row of a trial, for `executor.ordered_map`."""
    return trial()
