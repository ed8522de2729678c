"""Export of controllers: as C that needs nothing else, and as FMUs (FMI 2.0) for co-simulation.

What is exported is the 1 kHz law of both gears (lateral law, adhesion law, allocation, with sensors also their filter)
with the road, and before it the predictive controllers at their own period. It measures what the car's FMU puts out
and gives the four torques; a master that steps the controller before the car, each by 1 ms, gives the trajectory of
`simulate.run`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from railrepro.car.component import DERAILED
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import cycle, interface, lateral, law
from railrepro.control.mpc import PredictiveController
from railrepro.control.problem import TUNING
from railrepro.control.solvers import riccati
from railrepro.data import InputError, location, require, write
from railrepro.estimation.sensors import Readings
from railrepro.export.car import INPUTS
from railrepro.export.fmu import Fmu, Parameter, constant, index_enum, parameters, parameters_text
from railrepro.model.forecast import NOMINAL
from railrepro.model.parameters import PARAMETERS
from railrepro.quantities import GEARS, indices
from railrepro.track.route import CELL, Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

TORQUES = INPUTS
"""Names of the outputs of a controller, motor torques (N m). They are the inputs of the car."""
_LARGEST = 1e9
"""Largest magnitude of what is measured (SI)."""
_HERE = Path(__file__).parent
_AS_FMU = (_HERE / "controller_fmu.c").read_text(encoding="utf-8")


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

    def write_source(self, path: Path | str) -> Path:
        """Write C source that needs no other file, and return its path.

        Its struct controller_t has the arrays measured, torque and parameters (SI). Entries have enumerated names, as
        in c.measured[MEASURED_FRONT_P] and c.torque[TORQUE_TAU_FRONT_LE]. controller_reset(c) sets the start;
        controller_step(c) computes one step of 1 ms. To change parameters, set them after controller_reset(c), then
        call controller_start(c).
        """
        file = location(path)
        write(file, self.fmu().text.removesuffix(_AS_FMU))
        return file

    def write_fmu(self, path: Path | str) -> Path:
        """Write an FMU (FMI 2.0) for this platform and return its path.

        Inputs are `control.interface.MEASURED`, outputs `TORQUES`. Parameters are the gains of the law, such as
        "lateral.k0". A predictive controller also has its weights ("cost.r") and the parameters of its model
        ("belief.J_z").
        """
        return self.fmu().write(path)

    def fmu(self, road: Callable = constant) -> Fmu:
        """`Fmu` of the controller, not yet written to a file. InputError for a slower controller without C of its own.
        `road` is a function (name, array of cells) -> C text that defines the route; default `export.fmu.constant`."""
        lateral_law, factory = lateral.split(self.guidance)
        ends: dict[str, Any] = {"lateral_limit": DERAILED, "track_end": self.route.length, "stop_speed": -1.0}
        control = law.control_law(self.vehicle, lateral_law, sensors=self.sensors, **ends)
        planners = lateral.controllers(factory, self.vehicle, self.route) if factory else ()
        found, functions = parameters(control.signature.Gains, control.gains), [law.function(control.signature)]
        slower = cycle.SLOTS
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
            slower = _solver(planners, control.signature)
        elif first:
            slower = first.exported(planners, self.sensors.loop if self.sensors else None)
        numbers = {"N_CELLS": len(self.route.cells), "CELL_START": self.route.start, "CELL_STEP": CELL}
        numbers["PLAN_STEPS"] = round(first.period / CONTROL_PERIOD) if first else 0
        text = codegen.source_text(functions) + codegen.PREAMBLE + codegen.defines(numbers)
        text += index_enum("MEASURED", interface.MEASURED) + index_enum("TORQUE", TORQUES)
        text += road("CELLS", self.route.cells) + parameters_text(found)
        text += cycle.c_text(control.signature, len(found), slower)
        text += (_HERE / "controller.c").read_text(encoding="utf-8") + _AS_FMU
        description = "Controller of two running gears with independently rotating wheels"
        return Fmu("controller", description, TORQUES, interface.MEASURED, _LARGEST, found, text)


def _parameters(planners: tuple[PredictiveController, ...]) -> list[Parameter]:
    """Numbers of the predictive controllers of both gears; what fixes a size keeps its value."""
    first, large = planners[0], 1e15
    tables = {"cost": (TUNING, first.settings.tuning()), "belief": (PARAMETERS, first.parameters)}
    for gear, name in enumerate(GEARS):
        tables[f"forecast.{name}"] = NOMINAL, planners[gear].nominal
    found = [
        Parameter(f"{below}.{name}", float(value), "", -large, large)
        for below, (of, values) in tables.items()
        for name, value in zip(of, values, strict=True)
    ]
    found.append(Parameter("observer", first.settings.observer, "", 0.0, 1.0))
    return [replace(one, low=one.value, high=one.value) if one.name == "cost.period" else one for one in found]


def _solver(planners: tuple[PredictiveController, ...], signature: law.LawSignature) -> str:
    """The predictive controllers of both gears: solver, numbers and memory."""
    settings, drive = planners[0].settings, indices(signature.Gains).drive
    text = codegen.defines({"STEPS": settings.steps, "N_NOMINAL": len(NOMINAL), "DRIVE": drive.torque_limit})
    text += riccati.c_text(settings.variant, settings.discretisation)
    gears = ", ".join(codegen.initialiser(planner.c) for planner in planners)
    text += f"static const horizon_t PLANNERS[] = {{{gears}}};\n"
    return text + (_HERE / "planner_memory.c").read_text(encoding="utf-8")
