"""Export of the car as an FMU (FMI 2.0) for co-simulation."""

from collections.abc import Callable, Sequence
from pathlib import Path

from railrepro.car import component, equations
from railrepro.compile import codegen
from railrepro.data import above
from railrepro.export.fmu import Fmu, Variable, constant, numbers_text, variable, variables
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

INPUTS = ("tau_front_le", "tau_front_ri", "tau_rear_le", "tau_rear_ri")
"""Names of the inputs of the car and of the outputs of a controller: torque commands to the four motors (N m)."""


def export_fmu(
    path: Path | str,
    route: Route | str,
    speed: float,
    vehicle: Vehicle | None = None,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write the car on a route as an FMU (FMI 2.0) for co-simulation, and return the path of the file. Inputs are the
    torques of the four motors (N m): tau_front_le, tau_front_ri, tau_rear_le, tau_rear_ri. Outputs are the signals of
    the car in a run (SI), such as "front.y". Parameters are the numbers of the car, such as "body.mass", and "speed",
    the initial speed. Route and contact table are constants. The communication step must be a whole number of ms. The
    FMU returns the status Error if a torque is NaN or its magnitude above 1e5 N m, and if a state is not finite or
    reaches 1e7 (SI). `route` may be the name of a track; `speed` is the initial speed (m/s); `vehicle` is by default
    data/vehicle.toml. `platforms` are names such as ("linux64", "win64"), default the platform of this machine.
    InputError for a wrong argument, a missing compiler, or a file that cannot be written."""
    return car_fmu(component.SteppedCar(route, speed, vehicle), speed).write(path, platforms)


def car_fmu(car: component.SteppedCar, speed: float, route_text: Callable = constant) -> Fmu:
    """Make the `Fmu` (content of an FMU, not yet compiled) of a car with its initial speed (m/s). `route_text` is a
    function (name, array) -> C source that defines the array. It gets "CELLS" and `Route.cells`, numbers of the route
    per 0.5 m. By default the C array is constant (`constant`); in the live page it is filled at run time."""
    parameters = variables(equations.CarParameters, car.parameters)
    parameters.append(variable("speed", speed, above(0.0, component.LARGEST_SPEED, "m/s")))
    inputs = [Variable(name, 0.0, "N m", -component.LARGEST_TORQUE, component.LARGEST_TORQUE) for name in INPUTS]
    numbers = {"N_INPUT": len(INPUTS), "LARGEST_STATE": component.LARGEST_STATE}
    text = component.c_text(equations.rest(car.table)) + codegen.defines(numbers)
    text += f"static const car_t CAR = {codegen.initialiser(car.c)};\n" + route_text("CELLS", car.route.cells)
    text += constant("CONTACTS", car.table.cells()) + numbers_text(inputs, parameters)
    text += Path(__file__).with_name("car_fmu.c").read_text(encoding="utf-8")
    description = "Multibody car on independently rotating wheels"
    return Fmu("car", description, equations.car().outputs, inputs, parameters, text)
