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

import casadi as ca
import numpy as np

from railrepro.car.component import DERAILED
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import interface, lateral, law
from railrepro.control.mpc import LTVMPC, NMPC, PredictiveController
from railrepro.control.problem import TUNING, torque_limit
from railrepro.control.solvers import riccati
from railrepro.data import InputError, location, require, write
from railrepro.export.car import INPUTS
from railrepro.export.fmu import (
    Fmu,
    Parameter,
    constant,
    index_enum,
    parameters,
    parameters_text,
    write_fmu,
)
from railrepro.model.control_model import STATES
from railrepro.model.forecast import NOMINAL, nominal_values
from railrepro.model.parameters import PARAMETERS
from railrepro.quantities import GEARS, indices, names, pack
from railrepro.track.route import CELL, COLUMNS, INDEX, Route, set_point
from railrepro.vehicle.parameters import Vehicle, load_vehicle

TORQUES = INPUTS
"""Outputs of a controller (N m), inputs of the car."""
_LARGEST = 1e9
"""Largest magnitude of what is measured (SI)."""
_HERE = Path(__file__).parent
MODEL = _HERE / "controller_fmu.c"
SIZES = f"""#define N_OUTPUT {len(TORQUES)}
#define INPUTS_TEXT "what is measured"
#define INPUT_TEXT "what is measured must be a number of at most {_LARGEST:g}"
"""
"""What `MODEL` needs besides `Export.source`."""
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
    """A controller on a route, ready to be written.

    Attributes
    ----------
    guidance : lateral.Guidance
        A 1 kHz law, or a factory of `NMPC` (not by Ipopt), of `LTVMPC` or of `LqgPreview`.
    route : Route
    vehicle : Vehicle
        What it believes of the car.
    settings : law.LawSettings

    Raises
    ------
    InputError
        An attribute of another kind.
    """

    guidance: lateral.Guidance
    route: Route
    vehicle: Vehicle = field(default_factory=load_vehicle)
    settings: law.LawSettings = law.PLAIN

    def __post_init__(self) -> None:
        require("export: route", self.route, Route)
        require("export: vehicle", self.vehicle, Vehicle)
        require("export: settings", self.settings, law.LawSettings)

    def source(self) -> str:
        """C source: controller_t with `measured`, `torque` and `parameters`, controller_reset(c), controller_step(c).

        Places in them are enumerated by name, as c.measured[MEASURED_FRONT_P], c.torque[TORQUE_TAU_FRONT_LE] (SI). A
        step takes 1 ms. Parameters are changed after controller_reset(c), and controller_start(c) takes them over.
        """
        return self.written()[0]

    def written(self, road: Callable = constant) -> tuple[str, list[Parameter]]:
        """C source, and the parameters; `road` writes the table of the route, see `constant`.

        InputError when the slower controller of the guidance is written in Python.
        """
        lateral_law, factory = lateral.split(self.guidance)
        limits = {"lateral_limit": DERAILED, "track_end": self.route.length, "stop_speed": -1.0}
        control = law.control_law(self.vehicle, lateral_law, self.settings, **limits)
        planners: list = []
        if factory:
            planners += [_checked(factory(self.vehicle, self.route, gear)) for gear in range(len(GEARS))]
        predictive = bool(planners) and isinstance(planners[0], PredictiveController)
        functions = [control.function, set_point(), *(_solver_functions(planners[0]) if predictive else ())]
        text = codegen.source_text(functions) + codegen.PREAMBLE
        found = parameters(control.signature.Gains, control.gains) + list(_LAID)
        if predictive:
            found += self._solver_parameters(planners)
        text += self._constants(control, road) + parameters_text(found)
        text += _inputs(planners[0].period, control.signature) if planners else ""
        if predictive:
            text += self._solver(planners, control.signature)
        elif planners:
            sensors = self.settings.sensors
            text += planners[0].exported(planners, sensors.loop if sensors else None)
        return text + (_HERE / "controller.c").read_text(), found

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
        text, found = self.written()
        description = "Controller of two running gears with independently rotating wheels"
        fmu = Fmu("controller", description, TORQUES, interface.MEASURED, _LARGEST, found)
        return write_fmu(path, fmu, text + SIZES, MODEL.read_text())

    def _constants(self, control: law.ControlLaw, road: Callable) -> str:
        """Sizes, road and gains of the law."""
        sizes: dict[str, int | str] = {"N_MEASURED": len(interface.MEASURED), "N_TORQUE": len(TORQUES)}
        sizes |= {"N_MEMORY": len(control.signature.memory), "GEARS": len(GEARS), "N_CELLS": len(self.route.cells)}
        sizes |= _work("LAW", [control.function, set_point()])
        sizes |= {f"AT_{name.upper()}": INDEX[name] for name in ("p", "y_ref", "force")}
        sizes |= {"CELL_START": float(self.route.cells[0, INDEX["p"]]).hex(), "CELL_STEP": float(CELL).hex()}
        measured = indices(interface.Measured)
        sizes |= {"PERIOD": float(CONTROL_PERIOD).hex()}
        positions = [gear.p for gear in (measured.front, measured.rear)]
        text = index_enum("MEASURED", interface.MEASURED) + index_enum("TORQUE", TORQUES)
        text += (
            codegen.defines(sizes)
            + f"enum {{ N_CELL_COLUMNS = {len(COLUMNS)} }};\n"
            + _integers("POSITIONS", positions)
        )
        cells = self.route.cells.copy()
        if lateral.split(self.guidance)[1] is None:
            cells[:, ~_read(control.function)] = 0.0
        return text + road("CELLS", cells)

    def _solver_parameters(self, planners: list[PredictiveController]) -> list[Parameter]:
        """Numbers of the predictive controllers of both gears; what fixes a size keeps its value."""
        first, large = planners[0], 1e15
        tables = {"cost": (TUNING, first.settings.tuning()), "belief": (PARAMETERS, first.parameters)}
        for gear, name in enumerate(GEARS):
            tables[f"forecast.{name}"] = NOMINAL, nominal_values(self.vehicle, gear)
        found = [
            Parameter(f"{below}.{name}", float(value), "", -large, large)
            for below, (of, values) in tables.items()
            for name, value in zip(of, values, strict=True)
        ]
        found.append(Parameter("observer", first.settings.observer, "", 0.0, 1.0))
        return [replace(one, low=one.value, high=one.value) if one.name == "cost.period" else one for one in found]

    def _solver(self, planners: list[PredictiveController], signature: law.LawSignature) -> str:
        """The predictive controllers of both gears: solver, numbers and memory."""
        settings, first = planners[0].settings, planners[0]
        sizes: dict[str, int | str] = {"STEPS": settings.steps, "MOST_SETS": riccati.MOST_SETS, "MODE": first.mode}
        sizes |= {"YIELDING": int(settings.yielding), "INFORMED": int(settings.informed)}
        sizes |= _work("PLAN", _solver_functions(first))
        sizes |= {"AFFINE": float(first.horizon.c.affine).hex(), "N_NOMINAL": len(NOMINAL)}
        sizes |= {"DRIVE": indices(signature.Gains).drive.torque_limit}
        text = codegen.defines(sizes) + riccati.c_text(settings.variant, settings.discretisation)
        return text + (_HERE / "planner_memory.c").read_text()


def _solver_functions(planner: PredictiveController) -> list[ca.Function]:
    settings = planner.settings
    return [*riccati.functions(settings.variant, settings.discretisation), torque_limit()]


def _inputs(period: float, signature: law.LawSignature) -> str:
    """How often slower controllers plan, and where they find states, readings and base torque of their gear."""
    read = [STATES.index(name) for name in names(interface.ReadGear)]
    sizes = {"PLAN_STEPS": round(period / CONTROL_PERIOD), "ESTIMATED_IN_MEMORY": int(signature.sensed)}
    sizes |= {"N_STATES_OF_GEAR": len(STATES), "N_READINGS": len(read)}
    measured, memory = indices(interface.Measured), indices(signature.Memory)
    gears, states = (memory.front, memory.rear), [pack(measured.front), pack(measured.rear)]
    estimated, readings = (
        [pack(getattr(gear, part)) if signature.sensed else [0] * size for gear in gears]
        for part, size in (("estimated", len(STATES)), ("read", len(read)))
    )
    text = codegen.defines(sizes) + _integers("STATES_AT", states) + _integers("ESTIMATED", estimated)
    text += _integers("READ_AT", [[row[i] for i in read] for row in states]) + _integers("READ", readings)
    return text + _integers("BASE", [gear.u for gear in gears])


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


def _read(function: ca.Function) -> np.ndarray:
    """Which columns of a cell the torques and memory of a law depend on, and where it begins; bool, (len(COLUMNS),)."""
    rows = function.index_in("rows")
    used = [i for output in range(2) for i in function.jac_sparsity(output, rows).get_triplet()[1]]
    return np.isin(np.arange(len(COLUMNS)), [INDEX["p"], *(i % len(COLUMNS) for i in used)])


def _integers(name: str, values) -> str:
    """C constant of whole numbers in one or two dimensions."""
    table = np.array(values)
    shape = "".join(f"[{n}]" for n in table.shape)
    rows = ["{" + ",".join(map(str, row)) + "}" for row in table] if table.ndim == 2 else map(str, table)
    return f"static const int {name}{shape} = {{{','.join(rows)}}};\n"
