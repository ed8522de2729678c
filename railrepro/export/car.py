"""The car as an FMU (FMI 2.0). Serves the paper's section Simulation Environment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from railrepro.car import component, equations
from railrepro.car.component import DERAILED, LARGEST_SPEED, LARGEST_STATE, LARGEST_TORQUE, SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.export.fmu import Fmu, Parameter, constant, parameters, parameters_text, write_fmu
from railrepro.track.route import CELL, COLUMNS, INDEX, Route
from railrepro.vehicle.parameters import Vehicle

INPUTS = ("tau_front_le", "tau_front_ri", "tau_rear_le", "tau_rear_ri")
MODEL = Path(__file__).with_name("car_fmu.c")


def export_fmu(path: Path | str, route: Route | str, speed: float, vehicle: Vehicle | None = None) -> Path:
    """Write the car on a route as a co-simulation FMU for this platform.

    Inputs are the four motor torque commands `tau_front_le` … (N m), outputs `equations.car().outputs`. The
    communication step must be a whole number of ms; route and contact table are built in. What the car reads at run
    time (`equations.CarParameters`, as "body.mass" or "adhesion.poor.mu0") and its speed are parameters. A torque that
    is no number or beyond `LARGEST_TORQUE` is refused with status Error, a car that derails with status Warning.
    The code runs on any processor of this kind, unless RAILREPRO_CFLAGS asks for more.

    Parameters
    ----------
    path : path
        The .fmu file.
    route : Route or str
        Route, or the name of a track.
    speed : float
        Initial speed (m/s).
    vehicle : Vehicle, optional

    Raises
    ------
    InputError
        Without C compiler, with an impossible speed, or where the file cannot be written.
    """
    text, found = written(SteppedCar(route, speed, vehicle), speed)
    description = "Multibody car on independently rotating wheels"
    fmu = Fmu("car", description, equations.car().outputs, INPUTS, LARGEST_TORQUE, found)
    return write_fmu(path, fmu, text, MODEL.read_text())


def written(car: SteppedCar, speed: float, route: Callable = constant) -> tuple[str, list[Parameter]]:
    """C source of a car before `MODEL`, and its parameters; `route` writes the table of the route, see `constant`."""
    found = parameters(equations.CarParameters, car.parameters)
    found.append(Parameter("speed", speed, "m/s", 0.1, LARGEST_SPEED))
    text = component.c_text(equations.rest(car.table))
    return text + _constants(car, route) + parameters_text(found), found


def _constants(car: SteppedCar, route: Callable) -> str:
    """C constants of an FMU: tables, parameters, start state."""

    contacts = car.table.cells()
    sizes = {"N_STATE": len(equations.STATES), "N_OUTPUT": len(equations.car().outputs), "N_CELL": len(COLUMNS)}
    sizes |= {"N_CELLS": len(car.route.cells), "N_CONTACT": equations.CONTACT_COLUMNS, "N_CONTACTS": len(contacts)}
    sizes |= {"BODIES": len(equations.BODIES), "WHEELS": len(equations.WHEELS)}
    grids = {"CELL_START": car.route.cells[0, INDEX["p"]], "CELL_STEP": CELL}
    grids |= {"CONTACT_START": car.table.start, "CONTACT_STEP": car.table.step, "PERIOD": CONTROL_PERIOD}
    grids |= {"LARGEST_STATE": LARGEST_STATE, "DERAILED": DERAILED}
    outputs = equations.car().outputs
    sizes |= {"FRONT_Y": outputs.index("front.y"), "REAR_Y": outputs.index("rear.y")}
    text = '\n#define INPUTS_TEXT "the four torques"\n'
    text += f'#define INPUT_TEXT "a torque must be a number of at most {LARGEST_TORQUE:g} N m"\n'
    text += codegen.defines(sizes) + codegen.defines({name: float(value).hex() for name, value in grids.items()})
    arrays = {"CONTACTS": contacts, "START": car.state}
    return text + route("CELLS", car.route.cells) + "".join(constant(*array) for array in arrays.items())
