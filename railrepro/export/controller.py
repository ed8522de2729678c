"""Export of controllers: as C that needs nothing else, and as FMUs (FMI 2.0) for co-simulation.

What is exported is the 1 kHz law of both gears (lateral law, adhesion law, allocation, with sensors also their filter)
with the road, and before it the predictive controllers at their own period. It measures what the car's FMU puts out
and gives the four torques; a master that steps the controller before the car, each by 1 ms, gives the trajectory of
`simulate.run`.
"""

from __future__ import annotations

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
from railrepro.data import InputError, Quantity, between, location, require, write
from railrepro.estimation.sensors import Readings, quality_ranges
from railrepro.export.car import INPUTS
from railrepro.export.fmu import Fmu, Variable, constant, index_enum, numbers_text, variable, variables
from railrepro.model.forecast import NOMINAL
from railrepro.model.parameters import PARAMETERS, PERMITTED
from railrepro.quantities import GEARS, indices, notes
from railrepro.track.route import CELL, Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

TORQUES = INPUTS
"""Names of the outputs of a controller, motor torques (N m). They are the inputs of the car."""
_HERE = Path(__file__).parent
_HEADER, _STEP, _AS_FMU = (
    (_HERE / f"controller{part}").read_text(encoding="utf-8") for part in (".txt", ".c", "_fmu.c")
)
_FALLBACKS = "((c)->planner[0].h.fallbacks + (c)->planner[1].h.fallbacks)"
"""C expression: samples of the predictive controllers of both gears that were not solved."""
_FIXED = re.compile(r"limit\.|filter\.|cost\.period$|(front|rear)\.(measurement|command|unknown_delay)$")
"""Names of the parameters that keep their values, as plans and filters are made for them, or the export has no use."""


@dataclass(frozen=True)
class Export:
    """Controller of both gears on a route, for export as C source or FMU. InputError if a field has a wrong type."""

    guidance: lateral.Guidance
    """A 1 kHz law, or a factory of `NMPC` (not with Ipopt), `LTVMPC` or `LqgPreview`."""
    route: Route
    vehicle: Vehicle = field(default_factory=load_vehicle)
    """Vehicle parameters that the controller assumes."""
    sensors: Readings | None = None
    """Sensors and latencies between car and controller; default none."""

    def __post_init__(self) -> None:
        require("export: route", self.route, Route)
        require("export: vehicle", self.vehicle, Vehicle)
        lateral.split(self.guidance)
        if self.sensors is not None:
            require("export: sensors", self.sensors, Readings)

    def write_source(self, path: Path | str) -> Path:
        """Write C source that needs no other file, and return its path.

        Its struct controller_t has the arrays measured, torque and parameters (SI). The text begins with a description
        of its functions and of what controller_step(c), one step of 1 ms, returns.
        """
        file = location(path)
        write(file, _HEADER + self.fmu().text.removesuffix(_AS_FMU))
        return file

    def write_fmu(self, path: Path | str, platforms: Sequence[str] | None = None) -> Path:
        """Write an FMU (FMI 2.0) and return its path.

        Inputs are `control.interface.MEASURED`, outputs `TORQUES` and "fallbacks", the number of samples that a
        predictive controller could not solve. Parameters are the gains of the law, such as "lateral.k0". A predictive
        controller also has its weights ("cost.r") and the parameters of its model ("belief.J_z"). `platforms` is as in
        `export.fmu.Fmu.write`.
        """
        return self.fmu().write(path, platforms)

    def fmu(self, road: Callable = constant) -> Fmu:
        """`Fmu` of the controller, not yet written to a file. InputError for a slower controller without C of its own.
        `road` is a function (name, array of cells) -> C text that defines the route; default `export.fmu.constant`."""
        lateral_law, factory = lateral.split(self.guidance)
        ends: dict[str, Any] = {"lateral_limit": DERAILED, "track_end": self.route.length, "stop_speed": -1.0}
        control = law.control_law(self.vehicle, lateral_law, sensors=self.sensors, **ends)
        planners = lateral.controllers(factory, self.vehicle, self.route) if factory else ()
        ranges = _ranges(lateral_law, self.sensors is not None)
        found, functions = variables(control.signature.Gains, control.gains, ranges), [law.function(control.signature)]
        slower, fallbacks = cycle.SLOTS, "0"
        first: Any = next(iter(planners), None)
        predictive = isinstance(first, PredictiveController) and first.compiled(None) is not None
        if first and not (predictive or hasattr(first, "exported")):
            raise InputError(
                f"export: {type(first).__name__} is no 1 kHz law, LTV-MPC, NMPC by another solver than Ipopt or "
                "LqgPreview, which alone have C of their own"
            )
        if any(type(one) is not type(first) or one.settings != first.settings for one in planners):
            raise InputError("export: both gears need controllers of one class with the same settings")
        if predictive:
            functions += riccati.functions(first.settings.variant, first.settings.discretisation)
            found += _parameters(planners)
            slower, fallbacks = _solver(planners, control.signature), _FALLBACKS
        elif first:
            slower = first.exported(planners, self.sensors.loop if self.sensors else None)
        numbers: dict[str, Any] = {"N_CELLS": len(self.route.cells), "CELL_START": self.route.start, "CELL_STEP": CELL}
        numbers["PLAN_STEPS"] = round(first.period / CONTROL_PERIOD) if first else 0
        numbers["FALLBACKS(c)"] = fallbacks
        found = [replace(one, low=one.value, high=one.value) if _FIXED.match(one.name) else one for one in found]
        inputs = _inputs(self.route)
        text = codegen.source_text(functions) + codegen.PREAMBLE + codegen.defines(numbers)
        names = {"MEASURED": interface.MEASURED, "TORQUE": TORQUES, "MARGIN": interface.MARGINS}
        text += "".join(index_enum(prefix, of) for prefix, of in names.items())
        text += road("CELLS", self.route.cells) + numbers_text(inputs, found)
        text += cycle.c_text(control.signature, len(found), slower) + _STEP + _AS_FMU
        description = "Controller of two running gears with independently rotating wheels"
        return Fmu("controller", description, TORQUES, inputs, found, text, ("fallbacks",))


def _ranges(lateral_law: lateral.LateralLaw, sensed: bool) -> dict[str, Quantity]:
    """Ranges of those numbers of the law that its class `law.LawGains` does not know: gains of the lateral law, numbers
    of the nominal vehicle, and errors of each signal with sensors."""
    ranges = {f"lateral.{gain}": of for gain, of in getattr(lateral_law, "ranges", dict)().items()}
    ranges |= {f"model.{name}": of for name, of in PERMITTED.items()}
    errors = quality_ranges().items() if sensed else ()
    return ranges | {f"{gear}.{name}": of for gear in GEARS for name, of in errors}


def _inputs(route: Route) -> list[Variable]:
    """What is measured; positions are on the route, beyond which no controller knows the track."""
    ends = between(route.start, route.start + CELL * len(route.cells), "m")
    noted = ((name, ends if name.endswith(".p") else of) for name, of in notes(interface.Measured))
    return [variable(name, min(max(of.low, 0.0), of.high), of) for name, of in noted]


def _parameters(planners: tuple[PredictiveController, ...]) -> list[Variable]:
    """Numbers of the predictive controllers of both gears."""
    settings = planners[0].settings
    permitted = PERMITTED | dict(notes(MPCSettings)) | WEIGHTS
    tables = {"cost": (TUNING, settings.tuning()), "belief": (PARAMETERS, planners[0].parameters)}
    for gear, name in enumerate(GEARS):
        tables[f"forecast.{name}"] = NOMINAL, planners[gear].nominal
    found = [
        variable(f"{below}.{name}", value, permitted[name])
        for below, (of, values) in tables.items()
        for name, value in zip(of, values, strict=True)
    ]
    return [*found, variable("observer", settings.observer, permitted["observer"])]


def _solver(planners: tuple[PredictiveController, ...], signature: law.LawSignature) -> str:
    """The predictive controllers of both gears: solver, numbers and memory."""
    settings, drive = planners[0].settings, indices(signature.Gains).drive
    text = codegen.defines({"STEPS": settings.steps, "N_NOMINAL": len(NOMINAL), "DRIVE": drive.torque_limit})
    text += riccati.c_text(settings.variant, settings.discretisation)
    gears = ", ".join(codegen.initialiser(planner.c) for planner in planners)
    text += f"static const horizon_t PLANNERS[] = {{{gears}}};\n"
    return text + (_HERE / "planner_memory.c").read_text(encoding="utf-8")
