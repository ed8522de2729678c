"""What is scored: a registered controller, or a file with one class.

A class with `torque` is a law of the 1 kHz control cycle, one with `plan` a slower controller that is made as
(vehicle, route, gear); see `railrepro.control.lateral`. A class attribute `tuned` may hold keyword arguments per
setting.
"""

from __future__ import annotations

import importlib.util
import re
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from railrepro.control import lateral
from railrepro.control.registry import CONTROLLERS, Controller
from railrepro.data import InputError, location
from railrepro.evidence.runs import tuning
from railrepro.track.irregularity import CHANNELS
from railrepro.track.route import INDEX, Route

NOTHING = "nothing"
"""Name of the controller that gives no torque."""
_MODULE = "railrepro_own_controller"
_SETTINGS = {tuning.EQUAL, tuning.LOOP}


@dataclass(frozen=True)
class Entry:
    """A controller that is scored; picklable.

    Attributes
    ----------
    name : str
        Key of `registry.CONTROLLERS`, `NOTHING`, or the name of a file with its suffix, which is never such a key.
    file : str
        Path of the file, empty for a registered controller.
    """

    name: str
    file: str = ""

    def enter(self, setting: str) -> tuple[str, dict]:
        """Name in the registry of this process, and parameters in some setting, of what is no file."""
        if self.name == NOTHING:
            return register(NOTHING, lambda settings: lateral.ZeroOrderHold()), {}
        return self.name, tuning.load(self.name, setting)["parameters"]


def register(name: str, build: Callable) -> str:
    """Enter a controller into the registry of this process, settings -> guidance; its name."""
    CONTROLLERS[name] = Controller(build, dict, False, "own")
    return name


def entry(controller: str) -> Entry:
    """The entry for a registered name or the path of a file; InputError when it is neither."""
    if controller in tuple(CONTROLLERS) or controller == NOTHING:
        return Entry(controller)
    file = location(controller)
    if not file.is_file():
        known = [*CONTROLLERS, NOTHING]
        raise InputError(f"controller {controller!r} is neither a file nor a registered controller; there are {known}")
    if not re.fullmatch(r"[A-Za-z0-9_+-][A-Za-z0-9_.+-]*\.py", file.name):
        raise InputError(
            f"controller {file.name!r}: a name of letters, digits, _, -, + and . that ends in .py is needed"
        )
    return Entry(file.name, str(file.resolve()))


def made(own: type, setting: str) -> lateral.Guidance:
    """Guidance of a class of a file with its numbers for some setting."""
    return _guidance(own, _settings(own, setting))


def _guidance(own: type, settings: dict) -> lateral.Guidance:
    if hasattr(own, "plan"):
        return lambda vehicle, route, gear: own(vehicle, known(route), gear, **settings)
    return own(**settings)


def known(route: Route) -> Route:
    """What a controller of a file may know of a route: neither irregularities nor friction."""
    cells = np.array(route.cells)
    hidden = (*CHANNELS, "poor_le", "poor_ri")
    names = [name for name in INDEX if name.lstrip("d") in hidden or name in hidden]
    cells[:, [INDEX[name] for name in names]] = 0.0
    return Route(cells, route.length)


def _settings(own: type, setting: str) -> dict:
    """Keyword arguments of a class for some setting, from its `tuned`."""
    tables = getattr(own, "tuned", {})
    if not isinstance(tables, dict) or not all(isinstance(table, dict) for table in tables.values()):
        raise InputError(f"{own.__name__}: its `tuned` is no table of keyword arguments per setting")
    if set(tables) - _SETTINGS:
        raise InputError(f"{own.__name__}: `tuned` has {sorted(tables)}, only {sorted(_SETTINGS)} are known")
    return tables.get(setting, {})


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
        raise InputError(f"does not import: {fault(error, file)}") from None
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


def fault(error: BaseException, file: Path, own: type | None = None) -> str:
    """What a stranger's code raised, in one sentence with the line of his file and the method of his class."""
    places = [
        (line, frame.f_code.co_qualname)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if frame.f_code.co_filename == str(file)
    ]
    if isinstance(error, SyntaxError) and error.filename == str(file):
        places.append((error.lineno or 1, "<module>"))
    inside = bool(places)
    method = getattr(own, "torque", getattr(own, "plan", None))
    if not places and hasattr(method, "__code__"):
        places.append((method.__code__.co_firstlineno, method.__qualname__))
    where = ""
    if places:
        line, name = places[-1]
        where = f"{file.name}, line {line}{'' if name == '<module>' else f' ({name})'}: "
    text = " ".join(str(error).partition("Possible prototypes")[0].split())
    text = re.sub(r"^\S+\.[ch]pp:\d+: ", "", text)
    told = isinstance(error, InputError) or (isinstance(error, ArithmeticError) and not inside)
    kind = "" if told else f"{type(error).__name__}: "
    return f"{where}{kind}{text}"[:300]


def description() -> str:
    """Names that `torque` of a law of the 1 kHz control cycle may use, with unit and meaning."""
    short = {full: name for name, full in lateral.SHORT.items()}
    lines = [
        "A law is one class with torque(self, q); q has these quantities as attributes, for example q.y. It returns",
        "the differential torque (N m, positive steers right) as an expression of CasADi. With `memory`, a tuple of",
        "names of its own that q has, too, it returns (torque, next value of each by name). See examples/.",
        "",
    ]
    for title, names in (("running gear", lateral.GEAR), ("track here", lateral.ROAD), ("vehicle", lateral.MODEL)):
        lines.append(title)
        for name, (unit, meaning) in names.items():
            shown = f"{name}, {short[name]}" if name in short else name
            lines.append(f"  {shown:22s}{unit:12s}{meaning}")
    return "\n".join(lines)
