# The names of `railrepro`: editors and type checkers read them here, __init__.py takes FACADE from the imports.
from railrepro.car.component import SteppedCar as SteppedCar
from railrepro.control.mpc import LTVMPC as LTVMPC
from railrepro.control.mpc import NMPC as NMPC
from railrepro.control.ndi import NDI as NDI
from railrepro.control.registry import tuned as tuned
from railrepro.data import InputError as InputError
from railrepro.estimation.sensors import Readings as Readings
from railrepro.estimation.sensors import load_loop as load_loop
from railrepro.export.car import export_fmu as export_fmu
from railrepro.export.controller import Export as Export
from railrepro.own.lqg import LqgPreview as LqgPreview
from railrepro.simulation import metrics as metrics
from railrepro.simulation.scenarios import Scenario as Scenario
from railrepro.simulation.scenarios import load_scenario as load_scenario
from railrepro.simulation.simulate import run as simulate
from railrepro.studies.compare import compare as compare
from railrepro.track.route import lay as lay
from railrepro.track.table import load_track as load_track
from railrepro.tuning.tune import tune as tune
from railrepro.vehicle.parameters import Vehicle as Vehicle
from railrepro.vehicle.parameters import load_vehicle as load_vehicle

__all__ = [
    "Export",
    "InputError",
    "LTVMPC",
    "LqgPreview",
    "NDI",
    "NMPC",
    "Readings",
    "Scenario",
    "SteppedCar",
    "Vehicle",
    "compare",
    "export_fmu",
    "lay",
    "load_loop",
    "load_scenario",
    "load_track",
    "load_vehicle",
    "metrics",
    "simulate",
    "tune",
    "tuned",
    "FACADE",
    "__version__",
]

FACADE: dict[str, str]
__version__: str
