"""Export of controllers as C source without dependencies, and as FMUs (FMI 2.0) for co-simulation. The export contains
the route, the 1 kHz law of both gears (lateral law, adhesion law, allocation, with sensors also the filter) and slower
controllers with their own period. Its inputs are outputs of the car's FMU, its outputs are the four torques. A master
that steps the controller before the car, each by 1 ms, gives the trajectory of `simulate.run`."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from railrepro.car.component import DERAILED
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import cycle, interface, lateral, law
from railrepro.control.mpc import PredictiveController
from railrepro.control.problem import TUNING, WEIGHTS, MPCSettings
from railrepro.control.solvers import riccati
from railrepro.data import InputError, Quantity, between, location, require, text, write
from railrepro.estimation.sensors import Readings, quality_ranges
from railrepro.export.car import INPUTS
from railrepro.export.fmu import Fmu, Variable, constant, index_enum, numbers_text, variable, variables
from railrepro.model.forecast import NOMINAL
from railrepro.model.parameters import PARAMETERS, PERMITTED
from railrepro.quantities import GEARS, indices, notes
from railrepro.track.route import CELL, Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_HERE = Path(__file__).parent
_HEADER, _STEP, _AS_FMU = (text(_HERE / f"controller{ending}") for ending in (".txt", ".c", "_fmu.c"))
_FIXED = re.compile(r"limit\.|filter\.|cost\.period$|(front|rear)\.(measurement|command|unknown_delay)$")
"""Names of parameters that are constant: plans and filters are computed for them, or the export does not use them."""


@dataclass(frozen=True)
class Export:
    """Controller of both gears on a route, for export as C source or as an FMU. `guidance` is a 1 kHz law, as `NDI()`,
    or a factory, as from `registry.tuned("nmpc")`: a function (vehicle, route, gear) -> `NMPC` (not with Ipopt),
    `LTVMPC` or the controller of `LqgPreview`. `vehicle` has the parameters that the controller assumes. With `sensors`
    the export contains the filter that estimates the states from noisy and delayed readings; None: exact measurements.
    InputError for a wrong type, and from the methods for another controller."""

    guidance: lateral.Guidance
    route: Route
    vehicle: Vehicle = field(default_factory=load_vehicle)
    sensors: Readings | None = None

    def __post_init__(self) -> None:
        require("export: route", self.route, Route)
        require("export: vehicle", self.vehicle, Vehicle)
        lateral.split(self.guidance)
        if self.sensors is not None:
            require("export: sensors", self.sensors, Readings)

    def write_source(self, path: Path | str) -> Path:
        """Write one C source file without dependencies, and return its path. Its struct controller_t has the arrays
        measured (inputs), torque (outputs) and parameters (SI). A comment at the beginning describes the functions and
        what controller_step, one step of 1 ms, returns."""
        file = location(path)
        write(file, _HEADER + self.fmu().text.removesuffix(_AS_FMU))
        return file

    def write_fmu(self, path: Path | str, platforms: Sequence[str] | None = None) -> Path:
        """Write an FMU (FMI 2.0) and return its path. Inputs are the measured outputs of the car's FMU, such as
        "front.p". Outputs are the four motor torques (N m), "tau_front_le" to "tau_rear_ri", and "fallbacks", the
        number of samples that a predictive controller could not solve. Parameters are the gains of the law, such as
        "lateral.k0", and of a predictive controller its weights ("cost.r") and model parameters ("belief.J_z").
        `platforms` are names such as ("linux64", "win64"), default the platform of this machine."""
        return self.fmu().write(path, platforms)

    def fmu(self, route_text: Callable = constant) -> Fmu:
        """Make the `Fmu` of the controller. InputError if it has no C source. `route_text` is a function (name, array)
        -> C source that defines the array. It gets "CELLS" and `Route.cells`, numbers of the route per 0.5 m."""
        lateral_law, factory = lateral.split(self.guidance)
        ends: dict[str, Any] = {"lateral_limit": DERAILED, "track_end": self.route.length, "stop_speed": -1.0}
        control = law.control_law(self.vehicle, lateral_law, sensors=self.sensors, **ends)
        planners = lateral.controllers(factory, self.vehicle, self.route) if factory else ()
        ranges = _ranges(lateral_law, self.sensors is not None)
        parameters = variables(control.signature.Gains, control.gains, ranges)
        functions, slower, fallbacks = [law.function(control.signature)], cycle.SLOTS, "0"
        first: Any = next(iter(planners), None)
        predictive = isinstance(first, PredictiveController) and first.compiled(None) is not None
        if first and not (predictive or hasattr(first, "exported")):
            raise InputError(
                f"export: {type(first).__name__} is no 1 kHz law, LTV-MPC, NMPC without Ipopt or LqgPreview; "
                "only these can be exported"
            )
        if any(type(one) is not type(first) or one.settings != first.settings for one in planners):
            raise InputError("export: both gears need controllers of one class with the same settings")
        if predictive:
            functions += riccati.functions(first.settings.variant, first.settings.discretisation)
            parameters += _parameters(planners)
            slower = _solver(planners, control.signature)
            fallbacks = "((c)->planner[0].h.fallbacks + (c)->planner[1].h.fallbacks)"
        elif first:
            slower = first.exported(planners, self.sensors.loop if self.sensors else None)
        parameters = [replace(p, low=p.value, high=p.value) if _FIXED.match(p.name) else p for p in parameters]
        inputs, cells = _inputs(self.route), self.route.cells
        numbers: dict[str, Any] = {"N_CELLS": len(cells), "CELL_START": self.route.start, "CELL_STEP": CELL}
        numbers["PLAN_STEPS"] = round(first.period / CONTROL_PERIOD) if first else 0
        numbers["FALLBACKS(c)"] = fallbacks
        source = codegen.source_text(functions) + codegen.PREAMBLE + codegen.defines(numbers)
        for prefix, names in (("MEASURED", interface.MEASURED), ("TORQUE", INPUTS), ("MARGIN", interface.MARGINS)):
            source += index_enum(prefix, names)
        source += route_text("CELLS", cells) + numbers_text(inputs, parameters)
        source += cycle.c_text(control.signature, len(parameters), slower) + _STEP + _AS_FMU
        description = "Controller of two running gears with independently rotating wheels"
        return Fmu("controller", description, INPUTS, inputs, parameters, source, ("fallbacks",))


def _ranges(lateral_law: lateral.LateralLaw, sensed: bool) -> dict[str, Quantity]:
    """Ranges of the numbers of the 1 kHz law that its class does not annotate: gains of the lateral law, parameters of
    the nominal vehicle, with sensors also their errors."""
    ranges = {f"lateral.{gain}": of for gain, of in getattr(lateral_law, "ranges", dict)().items()}
    ranges |= {f"model.{name}": of for name, of in PERMITTED.items()}
    errors = quality_ranges().items() if sensed else ()
    return ranges | {f"{gear}.{name}": of for gear in GEARS for name, of in errors}


def _inputs(route: Route) -> list[Variable]:
    """Measured quantities as inputs. Positions must be on the route, as the track beyond it is unknown."""
    ends = between(route.start, route.start + CELL * len(route.cells), "m")
    noted = ((name, ends if name.endswith(".p") else of) for name, of in notes(interface.Measured))
    return [variable(name, min(max(of.low, 0.0), of.high), of) for name, of in noted]


def _parameters(planners: tuple[PredictiveController, ...]) -> list[Variable]:
    """Parameters of the predictive controllers of both gears."""
    settings = planners[0].settings
    permitted = PERMITTED | dict(notes(MPCSettings)) | WEIGHTS
    tables = {"cost": (TUNING, settings.tuning()), "belief": (PARAMETERS, planners[0].parameters)}
    tables |= {f"forecast.{gear}": (NOMINAL, one.nominal) for gear, one in zip(GEARS, planners, strict=True)}
    found = [
        variable(f"{group}.{name}", value, permitted[name])
        for group, (names, values) in tables.items()
        for name, value in zip(names, values, strict=True)
    ]
    return [*found, variable("observer", settings.observer, permitted["observer"])]


def _solver(planners: tuple[PredictiveController, ...], signature: law.LawSignature) -> str:
    """C source of the predictive controllers of both gears: solver, constants and memory."""
    settings, drive = planners[0].settings, indices(signature.Gains).drive
    source = codegen.defines({"STEPS": settings.steps, "N_NOMINAL": len(NOMINAL), "DRIVE": drive.torque_limit})
    source += riccati.c_text(settings.variant, settings.discretisation)
    gears = ", ".join(codegen.initialiser(planner.c) for planner in planners)
    return source + f"static const horizon_t PLANNERS[] = {{{gears}}};\n" + text(_HERE / "planner_memory.c")
