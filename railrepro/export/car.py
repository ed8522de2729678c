"""The car as an FMU (FMI 2.0). Serves the paper's section Simulation Environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from railrepro.car import component, equations
from railrepro.car.component import LARGEST_SPEED, LARGEST_STATE, LARGEST_TORQUE, SteppedCar
from railrepro.compile import codegen
from railrepro.data import above
from railrepro.export.fmu import Fmu, Variable, constant, numbers_text, variable, variables
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

INPUTS = ("tau_front_le", "tau_front_ri", "tau_rear_le", "tau_rear_ri")
"""Names of the inputs of the car: torque commands to its four motors (N m)."""


def export_fmu(
    path: Path | str,
    route: Route | str,
    speed: float,
    vehicle: Vehicle | None = None,
    platforms: Sequence[str] | None = None,
) -> Path:
    """Write the car on a route as a co-simulation FMU (FMI 2.0) and return the path of the file.

    The inputs are the torque commands `INPUTS` (N m), the outputs those of `railrepro.car.equations.car()`. The
    parameters are `equations.CarParameters` (such as "body.mass") and the initial "speed". Route and contact table are
    built in. The communication step has to be a whole number of ms. The FMU returns the status Error for a torque that
    is no number or above 1e5 N m, and when a state is not finite or reaches 1e7 (SI).

    Args:
        path (path): The .fmu file to write.
        route (Route or str): Route, or the name of a track.
        speed (float): Initial speed (m/s), above 0 up to 125.
        vehicle (Vehicle, optional): Default data/vehicle.toml.
        platforms (sequence of str, optional): As in `export.fmu.Fmu.write`, such as ("linux64", "win64"); default this
            platform.

    Raises:
        InputError: An argument has a wrong type or is out of range, no C compiler, or the file cannot be written.
    """
    return car_fmu(SteppedCar(route, speed, vehicle), speed).write(path, platforms)


def car_fmu(car: SteppedCar, speed: float, road: Callable = constant) -> Fmu:
    """`Fmu` of a car, not yet written to a file.

    Args:
        car (SteppedCar): Car with its route and contact table.
        speed (float): Initial speed (m/s).
        road (callable): Function (name, `Route.cells`) -> C text that defines this array.
    """
    found = variables(equations.CarParameters, car.parameters)
    found.append(variable("speed", speed, above(0.0, LARGEST_SPEED, "m/s")))
    inputs = [Variable(name, 0.0, "N m", -LARGEST_TORQUE, LARGEST_TORQUE) for name in INPUTS]
    outputs = equations.car().outputs
    numbers = {"N_INPUT": len(INPUTS), "LARGEST_STATE": LARGEST_STATE}
    text = component.c_text(equations.rest(car.table)) + codegen.defines(numbers)
    text += f"static const car_t CAR = {codegen.initialiser(car.c)};\n" + road("CELLS", car.route.cells)
    text += constant("CONTACTS", car.table.cells()) + numbers_text(inputs, found)
    text += Path(__file__).with_name("car_fmu.c").read_text(encoding="utf-8")
    return Fmu("car", "Multibody car on independently rotating wheels", outputs, inputs, found, text)
