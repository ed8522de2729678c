"""What is scored: a registered controller, or a file with one class, which is entered into the registry by its name.

A class with `torque` is a law of the 1 kHz exchange, one with `plan` a slower controller that is made as
(vehicle, route, gear); see `railrepro.control.lateral`. A class attribute `tuned` may hold keyword arguments per
setting.
"""

from __future__ import annotations

import importlib.util
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro.control import lateral
from railrepro.control.predictive import PredictiveController, Solve
from railrepro.control.registry import REGISTERED, Controller
from railrepro.errors import InputError
from railrepro.evidence.runs import tuning
from railrepro.schema import is_number

NOT_FINITE, LARGEST = "not_finite", 1e12
"""State of an own law that counts exchanges with a torque beyond all bounds (N m)."""
_MODULE = "railrepro_own_controller"


@dataclass(frozen=True)
class Entry:
    """A controller that is scored; picklable.

    Attributes
    ----------
    name : str
        Key of `registry.REGISTERED`, or the name of a file without its suffix.
    file : str
        Path of the file, empty for a registered controller.
    """

    name: str
    file: str = ""

    def enter(self, setting: str) -> tuple[str, dict]:
        """Name in the registry of this process, and parameters in some setting.

        Raises
        ------
        InputError
            When the file does not hold one controller, or has no numbers to set it.
        """
        if not self.file:
            return self.name, tuning.load(self.name, setting)["parameters"]
        own = load_class(Path(self.file))
        parameters = getattr(own, "tuned", {})
        if not isinstance(parameters, dict) or not all(isinstance(table, dict) for table in parameters.values()):
            raise InputError(f"{self.name}: its `tuned` is no table of keyword arguments per setting")
        known = {"equal", "loop"}
        if set(parameters) - known:
            raise InputError(f"{self.name}: `tuned` has {sorted(parameters)}, only {sorted(known)} are known")
        REGISTERED[f"own {self.name}"] = Controller(lambda settings: _Own(own, settings).guidance(), dict, True, "own")
        return f"own {self.name}", parameters.get(setting, {})


def entry(controller: str) -> Entry:
    """The entry for a registered name or the path of a file; InputError when it is neither."""
    if controller in tuple(REGISTERED):
        return Entry(controller)
    file = Path(controller)
    if not file.is_file():
        raise InputError(
            f"controller {controller!r} is neither a file nor a registered controller; there are {list(REGISTERED)}"
        )
    return Entry(file.stem, str(file.resolve()))


def load_class(file: Path) -> type:
    """The one controller class that a file defines.

    Raises
    ------
    InputError
        When the file cannot be run, or defines none or several.
    """
    spec = importlib.util.spec_from_file_location(_MODULE, file)
    if spec is None or spec.loader is None:
        raise InputError(f"{file.name}: is no Python file")
    module = importlib.util.module_from_spec(spec)
    sys.modules[_MODULE] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # a stranger's file may raise whatever it likes
        raise InputError(f"does not import: {fault(error, file)}") from error
    found = [
        thing
        for name, thing in vars(module).items()
        if isinstance(thing, type) and thing.__module__ == _MODULE and not name.startswith("_")
        if any(hasattr(thing, method) for method in ("torque", "plan")) or "__call__" in dir(thing)
    ]
    if len(found) != 1:
        names = [thing.__name__ for thing in found]
        raise InputError(f"{file.name}: one class with `torque` or with `plan` is needed, found {names or 'none'}")
    return found[0]


def fault(error: BaseException, file: Path) -> str:
    """What a stranger's code raised, in one sentence with the line of his file."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
    if isinstance(error, SyntaxError) and error.filename == str(file):
        lines.append(error.lineno)
    where = f"{file.name}, line {lines[-1]}: " if lines else ""
    text = " ".join(str(error).split())
    kind = "" if isinstance(error, InputError | ArithmeticError) and not lines else f"{type(error).__name__}: "
    return f"{where}{kind}{text}"[:300]


class _Own:
    """A class from a file with its keyword arguments."""

    def __init__(self, kind: type, settings: dict):
        self._kind, self._settings = kind, settings

    def guidance(self) -> lateral.Guidance:
        """What `simulate.run` takes; plans of a slower controller are timed."""
        if hasattr(self._kind, "plan"):
            return lambda vehicle, route, gear: Timed(self._kind(vehicle, route, gear, **self._settings))
        made = self._kind(**self._settings)
        law, factory = lateral.split(made)
        return _Counted(law) if factory is None else _TimedGuidance(law, factory)


class _Counted:
    """A 1 kHz law that counts where its torque is not finite: limits further on would make full torque of it."""

    def __init__(self, law: lateral.LateralLaw):
        lateral.kind(law)  # tells what is wrong with it, before it is counted
        self._law, self.memory, self.gains = law, (*law.memory, NOT_FINITE), law.gains

    def torque(self, gear: dict, track_ahead: dict, memory: dict, gain: dict, model: dict) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        answer = self._law.torque(gear, track_ahead, memory, gain, model)
        if not (isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[1], dict)):
            return answer  # `lateral.kind` tells what is wrong
        du, following = answer
        lost = 1 - (ca.fabs(du) < LARGEST)
        return du, following | {NOT_FINITE: memory[NOT_FINITE] + lost}


class _TimedGuidance(_Counted):
    """The same with slower controllers, whose plans are timed."""

    def __init__(self, law: lateral.LateralLaw, factory: lateral.Factory):
        super().__init__(law)
        self._factory = factory

    def __call__(self, vehicle, route, gear: int) -> Timed:
        return Timed(self._factory(vehicle, route, gear))


class Timed:
    """A slower controller with a record of its samples, as the predictive controllers have; checks what it gives.

    Attributes
    ----------
    stats : list of Solve
    """

    def __init__(self, controller: lateral.SlowController):
        self._controller, self._own = controller, []
        if hasattr(controller, "notice"):
            self.notice = controller.notice
        if not is_number(getattr(controller, "period", None)):
            raise InputError(f"period is {getattr(controller, 'period', None)!r}, a number of seconds is needed")
        self.period = float(controller.period)

    @property
    def stats(self) -> list[Solve]:
        """Record of the samples; a predictive controller keeps a better one itself."""
        return self._controller.stats if isinstance(self._controller, PredictiveController) else self._own

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """See `SlowController.plan`."""
        begin = time.perf_counter()
        torque = self._controller.plan(x_hat, u_d)
        self._own.append(Solve(time.perf_counter() - begin, 0, False))
        if np.ndim(torque) or not np.isrealobj(torque) or isinstance(torque, str | type(None)):
            raise InputError(f"plan() returned {torque!r}, a number (N m) is needed")
        return float(torque)
