"""The car as an FMU (FMI 2.0). Serves the paper's section Simulation Environment."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from railrepro.car import component, equations
from railrepro.car.component import DERAILED, LARGEST_SPEED, LARGEST_STATE, LARGEST_TORQUE, SteppedCar
from railrepro.clock import CONTROL_PERIOD
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
    number or beyond `component.LARGEST_TORQUE` (N m) gives status Error, a car that derails status Warning.
    The code runs on any processor of this kind, unless RAILREPRO_CFLAGS asks for more.

    Parameters
    ----------
    path : path
        The .fmu file to write; it is also returned.
    route : Route or str
        Route, or the name of a track.
    speed : float
        Initial speed (m/s).
    vehicle : Vehicle, optional
        Default `load_vehicle()`.

    Raises
    ------
    InputError
        Without C compiler, with an impossible speed, or where the file cannot be written.
    """
    return car_fmu(SteppedCar(route, speed, vehicle), speed).write(path)


def car_fmu(car: SteppedCar, speed: float, road: Callable = constant) -> Fmu:
    """`Fmu` of a car with initial speed (m/s); `road`: function (name, `Route.cells`) -> C text of this array."""
    found = parameters(equations.CarParameters, car.parameters)
    found.append(Parameter("speed", speed, "m/s", 0.1, LARGEST_SPEED))
    outputs = equations.car().outputs
    places = {"N_INPUT": len(INPUTS), "FRONT_Y": outputs.index("front.y"), "REAR_Y": outputs.index("rear.y")}
    exact = {"PERIOD": CONTROL_PERIOD, "LARGEST_STATE": LARGEST_STATE, "DERAILED": DERAILED}
    said = {
        "INPUTS_TEXT": '"the four torques"',
        "INPUT_TEXT": f'"a torque must be a number of at most {LARGEST_TORQUE:g} N m"',
    }
    text = component.c_text(equations.rest(car.table)) + codegen.defines(places | exact | said)
    text += f"static const car_t CAR = {codegen.initialiser(car.c)};\n" + road("CELLS", car.route.cells)
    text += constant("CONTACTS", car.table.cells()) + constant("START", car.state)
    description, model = "Multibody car on independently rotating wheels", Path(__file__).with_name("car_fmu.c")
    return Fmu("car", description, outputs, INPUTS, LARGEST_TORQUE, found, text + parameters_text(found), model)
