"""Replication of model predictive control of railway running gears with driven independently rotating wheels.

The names of a first program, as in `from railrepro import simulate, tuned`. A name is imported when it is first used:

- `simulate`: simulate the car in a scenario
- `compare`: simulate several controllers in the same scenario
- `tune`: tune a controller by particle swarm
- `load_scenario`, `Scenario`: scenarios of data/scenarios.toml
- `load_vehicle`, `Vehicle`: vehicle parameters, data/vehicle.toml
- `load_track`, `lay`: tracks of data/tracks.toml, and a route: a track with set point and rails
- `tuned`: a controller with its tuned parameters, data/tuned
- `NDI`, `NMPC`, `LTVMPC`, `LqgPreview`: the controllers with your own parameters
- `load_loop`, `Readings`: sensors and delays of data/sensors.toml, and the same for one run, with a seed of the noise
- `SteppedCar`, `export_fmu`: the car without controller, as an object and as an FMU
- `Export`: a controller as C source or as an FMU
- `metrics`: error, effort and other metrics of a run
- `InputError`: exception for invalid input
"""

import re
import sys
from pathlib import Path
from typing import Any

if sys.platform == "win32":
    raise ImportError("railrepro runs on Linux, and on Windows in WSL, the Windows Subsystem for Linux")

from railrepro import code  # noqa: E402, F401  before all others: it reads the files that this process imports

__version__ = "3.0.0"

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
FACADE = {
    name: f"{module}.{entry}"
    for module, entry, name in re.findall(r"^from (\S+) import (\w+) as (\w+)$", _STUB, re.MULTILINE)
}
"""Public name of `railrepro` -> dotted path of its object or module. They are listed once, in __init__.pyi."""
__all__ = ["FACADE", "__version__", *FACADE]


def __getattr__(name: str) -> Any:
    if name not in FACADE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, entry = FACADE[name].rpartition(".")
    try:
        value = getattr(__import__(module, fromlist=[entry]), entry)  # from module import entry
    except ModuleNotFoundError as error:
        error.add_note("railrepro needs the Python of its installation: in a clone .venv/bin/python (`make setup`)")
        raise
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *FACADE})
