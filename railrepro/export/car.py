"""The car as an FMU (FMI 2.0). Serves the paper's section Simulation Environment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from railrepro.car import component, equations
from railrepro.car.component import LARGEST_SPEED, LARGEST_STATE, LARGEST_TORQUE, SteppedCar
from railrepro.compile import codegen
from railrepro.export.fmu import Fmu, Parameter, constant, parameters, parameters_text
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

INPUTS = ("tau_front_le", "tau_front_ri", "tau_rear_le", "tau_rear_ri")
"""Names of the inputs of the car: torque commands to its four motors (N m)."""


def export_fmu(path: Path | str, route: Route | str, speed: float, vehicle: Vehicle | None = None) -> Path:
    """Write the car on a route as a co-simulation FMU for this platform.

    Inputs are the torque commands `INPUTS` to the motors (N m), outputs `railrepro.car.equations.car().outputs`. The
    communication step must be a whole number of ms; route and contact table are built in. Parameters are
    `equations.CarParameters` (such as "body.mass", "adhesion.poor.mu0") and the initial "speed". A torque that is not a
    number or beyond `component.LARGEST_TORQUE` (N m) gives status Error, as does a car that leaves all bounds.
    The code runs on any processor of this kind, unless RAILREPRO_CFLAGS asks for more.

    Args:
        path (path): The .fmu file to write; it is also returned.
        route (Route or str): Route, or the name of a track.
        speed (float): Initial speed (m/s).
        vehicle (Vehicle, optional): Default `load_vehicle()`.

    Raises:
        InputError: Without C compiler, with an impossible speed, or where the file cannot be written.
    """
    return car_fmu(SteppedCar(route, speed, vehicle), speed).write(path)


def car_fmu(car: SteppedCar, speed: float, road: Callable = constant) -> Fmu:
    """`Fmu` of a car with initial speed (m/s); `road`: function (name, `Route.cells`) -> C text of this array."""
    found = parameters(equations.CarParameters, car.parameters)
    found.append(Parameter("speed", speed, "m/s", 0.1, LARGEST_SPEED))
    outputs = equations.car().outputs
    numbers = {"N_INPUT": len(INPUTS), "LARGEST_STATE": LARGEST_STATE}
    text = component.c_text(equations.rest(car.table)) + codegen.defines(numbers)
    text += f"static const car_t CAR = {codegen.initialiser(car.c)};\n" + road("CELLS", car.route.cells)
    text += constant("CONTACTS", car.table.cells()) + parameters_text(found)
    text += Path(__file__).with_name("car_fmu.c").read_text()
    return Fmu("car", "Multibody car on independently rotating wheels", outputs, INPUTS, LARGEST_TORQUE, found, text)
