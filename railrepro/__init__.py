"""Model predictive control of railway running gears with driven independently rotating wheels, replicated.

What a first program needs (`from railrepro import simulate, tuned`); a name is loaded when it is used first, so that
the import costs nothing:

- `simulate`: simulate the car in a scenario, see `railrepro.simulation.simulate.run`; the `Run` has `plot`
- `compare`: simulate several controllers side by side; the `Comparison` has `table` and `plot`
- `tune`: tune a controller by particle swarm
- `load_scenario`, `Scenario`: data/scenarios.toml
- `load_vehicle`, `Vehicle`: data/vehicle.toml
- `load_track`, `lay`: data/tracks.toml, and a track as a route with set point and rails
- `tuned`: a controller with its tuned parameters, data/tuned
- `NDI`, `NMPC`, `LTVMPC`, `LqgPreview`: the controllers with parameters of one's own
- `load_loop`, `Readings`: data/sensors.toml, and sensors of a run with the noise of one seed
- `SteppedCar`, `export_fmu`: the car alone, as an object and as a unit of FMI
- `Export`: a controller as C source or as a unit of FMI
- `metrics`: error, effort and more of a run
- `InputError`: exception for wrong input, its message one sentence
"""

import sys
from importlib import import_module
from typing import Any

if sys.platform == "win32":
    raise ImportError("railrepro runs on Linux, on Windows in WSL, the Windows Subsystem for Linux")

from railrepro import code  # noqa: E402, F401  before all others: it notes what this process imports

__version__ = "2.0.0"

FACADE = {
    "simulate": "railrepro.simulation.simulate.run",
    "compare": "railrepro.studies.compare.compare",
    "tune": "railrepro.tuning.tune.tune",
    "load_scenario": "railrepro.simulation.scenarios.load_scenario",
    "Scenario": "railrepro.simulation.scenarios.Scenario",
    "load_vehicle": "railrepro.vehicle.parameters.load_vehicle",
    "Vehicle": "railrepro.vehicle.parameters.Vehicle",
    "load_track": "railrepro.track.table.load_track",
    "lay": "railrepro.track.route.lay",
    "tuned": "railrepro.control.registry.tuned",
    "NDI": "railrepro.control.ndi.NDI",
    "NMPC": "railrepro.control.mpc.NMPC",
    "LTVMPC": "railrepro.control.mpc.LTVMPC",
    "LqgPreview": "railrepro.own.lqg.LqgPreview",
    "load_loop": "railrepro.estimation.sensors.load_loop",
    "Readings": "railrepro.estimation.sensors.Readings",
    "SteppedCar": "railrepro.car.component.SteppedCar",
    "export_fmu": "railrepro.export.car.export_fmu",
    "Export": "railrepro.export.controller.Export",
    "metrics": "railrepro.simulation.metrics",
    "InputError": "railrepro.data.InputError",
}
"""Public name of `railrepro` -> dotted path of the module, or of the object in a module, that it imports."""
_MODULES = ("metrics",)
__all__ = ["FACADE", "__version__", *FACADE]


def __getattr__(name: str) -> Any:
    if name not in FACADE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, entry = FACADE[name].rpartition(".")
    try:
        found = import_module(FACADE[name]) if name in _MODULES else getattr(import_module(module), entry)
    except ModuleNotFoundError as error:
        error.add_note("railrepro needs the Python of its installation: in a clone .venv/bin/python (`make setup`)")
        raise
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *FACADE})
