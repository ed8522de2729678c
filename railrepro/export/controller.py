"""Export of controllers: as C that needs nothing else, and as FMUs (FMI 2.0) for co-simulation.

What is exported is the 1 kHz law of both gears (lateral law, adhesion law, allocation, with sensors also their filter)
with the road, and before it the predictive controllers at their own period. It measures what the car's FMU puts out
and gives the four torques; a master that steps the controller before the car, each by 1 ms, gives the trajectory of
`simulate.run`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi as ca

from railrepro.car.component import DERAILED
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import interface, lateral, law
from railrepro.control.mpc import LTVMPC, NMPC, PredictiveController
from railrepro.control.problem import TUNING, torque_limit
from railrepro.control.solvers import riccati
from railrepro.data import InputError, location, require, write
from railrepro.estimation.sensors import Readings
from railrepro.export.car import INPUTS
from railrepro.export.fmu import Fmu, Parameter, constant, index_enum, parameters, parameters_text
from railrepro.model.control_model import STATES
from railrepro.model.forecast import NOMINAL
from railrepro.model.parameters import PARAMETERS
from railrepro.quantities import GEARS, indices, names
from railrepro.track.route import CELL, COLUMNS, INDEX, Route, set_point
from railrepro.vehicle.parameters import Vehicle, load_vehicle

TORQUES = INPUTS
"""Outputs of a controller (N m), inputs of the car."""
_LARGEST = 1e9
"""Largest magnitude of what is measured (SI)."""
_HERE = Path(__file__).parent
_LAID = (
    Parameter("set_point.kind", -1.0, "", -1.0, 2.0),  # -1: as the route has it, else see `SetPoint`
    Parameter("set_point.amplitude", 3e-3, "m", -0.02, 0.02),
    Parameter("set_point.period_start", 150.0, "m", 1.0, 1e5),
    Parameter("set_point.period_end", 40.0, "m", 1.0, 1e5),
    Parameter("set_point.start", 0.0, "m", -1e5, 1e5),
    Parameter("set_point.end", 1e5, "m", -1e5, 1e6),
    Parameter("set_point.fade", 30.0, "m", 0.1, 1e5),
    Parameter("force_factor", 1.0, "", -10.0, 10.0),
)
"""What `controller_lay` puts on the road, in the order of `SetPoint`, and a factor on the force demand."""


@dataclass(frozen=True)
class Export:
    """A controller on a route, ready to be written; InputError for an attribute of another kind."""

    guidance: lateral.Guidance
    """A 1 kHz law, or a factory of `NMPC` (not by Ipopt), of `LTVMPC` or of `LqgPreview`."""
    route: Route
    vehicle: Vehicle = field(default_factory=load_vehicle)
    """What it believes of the car."""
    sensors: Readings | None = None
    """What stands between the car and the controller; default nothing."""

    def __post_init__(self) -> None:
        require("export: route", self.route, Route)
        require("export: vehicle", self.vehicle, Vehicle)

    def source(self) -> str:
        """C source: controller_t with `measured`, `torque` and `parameters`, controller_reset(c), controller_step(c).

        Places in them are enumerated by name, as c.measured[MEASURED_FRONT_P], c.torque[TORQUE_TAU_FRONT_LE] (SI). A
        step takes 1 ms. Parameters are changed after controller_reset(c), and controller_start(c) takes them over.
        """
        return self.fmu().text

    def write_source(self, path: Path | str) -> Path:
        """Write `source` to a file."""
        file = location(path)
        write(file, self.source())
        return file

    def write_fmu(self, path: Path | str) -> Path:
        """Write an FMU (FMI 2.0) for this platform; inputs `interface.MEASURED`, outputs `TORQUES`.

        Parameters are the gains of the law (as "lateral.k0", "adhesion.drop_step", "drive.torque_limit"), and of a
        predictive controller weights ("cost.r") and model ("belief.J_z"). `set_point.kind` 0, 1 or 2 puts another set
        point on the road than the route's (-1), see `railrepro.track.route.SetPoint`.
        """
        return self.fmu().write(path)

    def fmu(self, road: Callable = constant) -> Fmu:
        """C source and description; `road` writes the table of the route, see `constant`.

        InputError when the slower controller of the guidance is written in Python.
        """
        lateral_law, factory = lateral.split(self.guidance)
        ends: dict[str, Any] = {"lateral_limit": DERAILED, "track_end": self.route.length, "stop_speed": -1.0}
        control = law.control_law(self.vehicle, lateral_law, sensors=self.sensors, **ends)
        planners: list = []
        if factory:
            planners += [_checked(factory(self.vehicle, self.route, gear)) for gear in range(len(GEARS))]
        predictive = bool(planners) and isinstance(planners[0], PredictiveController)
        functions, solver = [control.function, set_point()], _solver_functions(planners[0]) if predictive else []
        found = parameters(control.signature.Gains, control.gains) + list(_LAID)
        if predictive:
            found += self._solver_parameters(planners)
        text = codegen.source_text([*functions, *solver]) + codegen.PREAMBLE
        text += codegen.defines(self._numbers(control.signature) | _work("LAW", functions))
        text += index_enum("MEASURED", interface.MEASURED) + index_enum("TORQUE", TORQUES)
        text += road("CELLS", self.route.cells) + parameters_text(found)
        if planners:
            text += codegen.defines(_plan_numbers(planners[0].period, control.signature))
        if predictive:
            text += self._solver(planners[0], control.signature)
        elif planners:
            text += planners[0].exported(planners, self.sensors.loop if self.sensors else None)
        text += (_HERE / "controller.c").read_text()
        description = "Controller of two running gears with independently rotating wheels"
        named = "controller", description, TORQUES, interface.MEASURED, _LARGEST
        return Fmu(*named, found, text, _HERE / "controller_fmu.c")

    def _numbers(self, signature: law.LawSignature) -> dict[str, float | int | str]:
        """Sizes, grid of the road, and where a gear finds its own among what is measured."""
        measured = indices(interface.Measured)
        numbers: dict[str, float | int | str] = {"N_INPUT": len(interface.MEASURED), "N_OUTPUT": len(TORQUES)}
        numbers |= {"N_MEMORY": len(signature.memory), "GEARS": len(GEARS), "N_CELLS": len(self.route.cells)}
        numbers |= {"N_CELL_COLUMNS": len(COLUMNS), "CELL_START": self.route.start, "CELL_STEP": CELL}
        numbers |= {f"AT_{name.upper()}": INDEX[name] for name in ("p", "y_ref", "force")}
        numbers |= {"GEAR_MEASURED": measured.rear.p - measured.front.p, "PERIOD": CONTROL_PERIOD}
        said = f'"what is measured must be a number of at most {_LARGEST:g}"'
        return numbers | {"INPUTS_TEXT": '"what is measured"', "INPUT_TEXT": said}

    def _solver_parameters(self, planners: list[PredictiveController]) -> list[Parameter]:
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

    def _solver(self, planner: PredictiveController, signature: law.LawSignature) -> str:
        """The predictive controllers of both gears: solver, numbers and memory."""
        s = planner.settings
        sizes: dict[str, int | float] = {"STEPS": s.steps, "MOST_SETS": riccati.MOST_SETS, "MODE": planner.mode}
        sizes |= {"YIELDING": int(s.yielding), "INFORMED": int(s.informed), "AFFINE": float(planner.horizon.c.affine)}
        sizes |= {"N_NOMINAL": len(NOMINAL), "DRIVE": indices(signature.Gains).drive.torque_limit}
        sizes |= _work("PLAN", _solver_functions(planner))
        text = codegen.defines(sizes) + riccati.c_text(s.variant, s.discretisation)
        return text + (_HERE / "planner_memory.c").read_text()


def _solver_functions(planner: PredictiveController) -> list[ca.Function]:
    settings = planner.settings
    return [*riccati.functions(settings.variant, settings.discretisation), torque_limit()]


def _plan_numbers(period: float, signature: law.LawSignature) -> dict[str, int | str]:
    """How often slower controllers plan, and where they find states, readings and base torque of their gear."""
    read, memory = names(interface.ReadGear), indices(signature.Memory)
    numbers: dict[str, int | str] = {"PLAN_STEPS": round(period / CONTROL_PERIOD), "BASE": memory.front.u}
    numbers |= {"GEAR_MEMORY": memory.rear.u - memory.front.u, "N_READINGS": len(read)}
    numbers |= {"READ_OF_STATE": "{" + ", ".join(str(STATES.index(name)) for name in read) + "}"}
    if not signature.sensed:
        return numbers | {"ESTIMATED": 0, "READ": 0}
    return numbers | {"ESTIMATED": memory.front.estimated.x, "READ": memory.front.read.y_TrAx}


def _checked(planner: lateral.SlowController | lateral.CompiledController):
    """A controller that has C of its own; InputError for any other one."""
    solved = isinstance(planner, LTVMPC) or (isinstance(planner, NMPC) and planner.solver != "ipopt")
    if solved or hasattr(planner, "exported"):
        return planner
    raise InputError(
        f"export: {type(planner).__name__} is no 1 kHz law, LTV-MPC, NMPC by another solver than Ipopt or LqgPreview, "
        "which alone have C of their own"
    )


def _work(name: str, functions: Sequence[ca.Function]) -> dict[str, int]:
    """Sizes of the memory of generated functions."""
    sizes = {"ARG": "sz_arg", "RES": "sz_res", "IW": "sz_iw", "W": "sz_w"}
    return {f"{name}_{key}": max(getattr(f, size)() for f in functions) for key, size in sizes.items()}
