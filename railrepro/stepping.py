"""The car as a component: step it with four motor torques, read named outputs and energies, linearise it, export it.

For users with controllers and loops of their own; the project's experiments use `railrepro.exchange`, which keeps the
control law in the compiled loop. `export_fmu` writes an FMI 2.0 co-simulation unit. Serves the paper's section
Simulation Environment.
"""

from __future__ import annotations

import platform
import sys
import tempfile
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pandas as pd

from railrepro import codegen, exchange, plant, route
from railrepro.contact import contact_table
from railrepro.errors import InputError
from railrepro.parameters import Vehicle, load_vehicle
from railrepro.track import load_track

_LARGEST = 1e7
"""No state of a car that moves grows beyond this (SI)."""
ENERGIES = ("mechanical_J", "motor_W", "damping_W", "creep_W")


@dataclass(frozen=True)
class Linearisation:
    """dx = A x + B u, y = C x + D u about an operating point, with named rows and columns.

    Attributes
    ----------
    a, b, c, d : DataFrame
        States `plant.STATES`, inputs the motor torque commands of `plant.WHEELS`, outputs `plant.car().outputs` (SI).
    """

    a: pd.DataFrame
    b: pd.DataFrame
    c: pd.DataFrame
    d: pd.DataFrame


class SteppedCar:
    """The multibody car on a route, advanced by the caller.

    Attributes
    ----------
    state : ndarray, shape (44,)
        See `plant.STATES`; writable.
    torque : ndarray, shape (4,)
        Motor torque commands in the order of `plant.WHEELS`, traction-positive (N m).
    time : float
        Simulated time (s).
    """

    def __init__(self, way: route.Route | str, speed: float, vehicle: Vehicle | None = None, good="dry", poor="poor"):
        vehicle = vehicle or load_vehicle()
        self.way = route.lay(load_track(way)) if isinstance(way, str) else way
        self.table = contact_table(vehicle.contact.profile, vehicle)
        self.parameters = plant.parameter_vector(vehicle, good, poor)
        self.state, self.torque, self.time = plant.rest_state(vehicle, self.table, speed), np.zeros(4), 0.0
        self._contacts = self.table.cells()
        self._rows = self.way.rows_at(self.state[[0, 12, 24]])
        shared = [self.state, self.torque, np.zeros(3 * len(route.COLUMNS)), np.zeros(4 * plant.CONTACT_COLUMNS)]
        shared.append(self.parameters)
        self._shared, self._h = shared, np.zeros(1)
        car = plant.car()
        self._places = np.zeros(7)
        bindings = (
            (car.coordinates, [shared[0], shared[2], shared[4]], [self._places]),
            (car.output, shared, None),
            (car.step, [*shared, self._h], None),
        )
        library = exchange.compiled_car()
        if library is None:
            self._calls = [codegen.InterpretedFunction(*binding) for binding in bindings]
        else:
            self._calls = [codegen.CompiledFunction(library, *binding) for binding in bindings]
        for _ in range(2):
            self._look_up()

    def _look_up(self) -> None:
        self._calls[0]()
        table = self.table
        self._shared[2][:] = self.way.rows_at(self._places[:3]).ravel()
        index = np.clip((self._places[3:] - table.start) / table.step, 0, len(self._contacts) - 1).astype(int)
        self._shared[3][:] = self._contacts[index].ravel()

    def step(self, torque=None, exchanges: int = 1, period: float = plant.EXCHANGE_PERIOD) -> None:
        """Advance by some exchanges with the torques held.

        Parameters
        ----------
        torque : array_like, shape (4,), optional
            Motor torque commands (N m); default the last ones.
        exchanges : int
        period : float
            Step (s).

        Raises
        ------
        ArithmeticError
            One sentence with time, state and track coordinate when a state is no longer finite or absurdly large;
            `state` is that of the last good exchange.
        """
        if torque is not None:
            self.torque[:] = torque
        self._h[:] = period
        for _ in range(exchanges):
            self._look_up()
            new, _ = self._calls[2]()
            if not (np.abs(new) < _LARGEST).all():
                worst = int(np.argmax(~(np.abs(new) < _LARGEST)))
                raise ArithmeticError(
                    f"{plant.STATES[worst]} = {new[worst]:.3g} left all bounds after t = {self.time:.3f} s, "
                    f"p = {self.state[12]:.1f} m"
                )
            self.state[:] = new
            self.time += period

    @property
    def outputs(self) -> dict[str, float]:
        """Positions, wheel loads, creepages, contact forces by name (`plant.car().outputs`, SI)."""
        self._look_up()
        return dict(zip(plant.car().outputs, self._calls[1]()[0].tolist(), strict=True))

    @property
    def energies(self) -> dict[str, float]:
        """Mechanical energy (J), motor power and losses (W), see `ENERGIES`."""
        self._look_up()
        return dict(zip(ENERGIES, np.array(plant.car().energy(*self._inputs())).ravel().tolist(), strict=True))

    def _inputs(self) -> list[np.ndarray]:
        state, torque, rows, contacts, parameters = self._shared
        return [state, torque, rows.reshape(3, -1).T, contacts.reshape(4, -1).T, parameters]

    def linearise(self) -> Linearisation:
        """Linear model about the present state and torques, track and contact cells held."""
        self._look_up()
        car, inputs = plant.car(), self._inputs()
        x, u = ca.SX.sym("x", len(plant.STATES)), ca.SX.sym("u", 4)
        rate, output = car.rate(x, u, *inputs[2:]), car.output(x, u, *inputs[2:])
        jacobians = [ca.jacobian(f, v) for f in (rate, output) for v in (x, u)]
        a, b, c, d = (np.array(m) for m in ca.Function("linear", [x, u], jacobians)(*inputs[:2]))
        states, wheels, outputs = list(plant.STATES), list(plant.WHEELS), list(car.outputs)
        return Linearisation(
            pd.DataFrame(a, states, states),
            pd.DataFrame(b, states, wheels),
            pd.DataFrame(c, outputs, states),
            pd.DataFrame(d, outputs, wheels),
        )


def export_fmu(path: Path | str, way: route.Route | str, speed: float, vehicle: Vehicle | None = None) -> Path:
    """Write the car on a route as an FMI 2.0 co-simulation unit for this platform.

    Inputs are the four motor torque commands `tau_front_le` … (N m), outputs `plant.car().outputs`. The communication
    step must be a whole number of ms; route, contact table and vehicle are built in.

    Parameters
    ----------
    path : path
        The .fmu file.
    way : Route or str
        Route, or the name of a track.
    speed : float
        Initial speed (m/s).
    vehicle : Vehicle, optional

    Returns
    -------
    Path
    """
    if codegen.compiler() is None:
        raise InputError("an FMU holds compiled code: a C compiler is needed")
    car = SteppedCar(way, speed, vehicle)
    functions = (plant.car().coordinates, plant.car().output, plant.car().step)
    here = Path(__file__)
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {speed} {car.parameters.tobytes().hex()[:200]}"))
    text = codegen.source_text(functions) + here.with_name("call.h").read_text()
    text += _constants(car, guid) + here.with_name("fmu.c").read_text()
    target = Path(path)
    system = {"linux": "linux64", "darwin": "darwin64"}.get(sys.platform, sys.platform + platform.machine()[-2:])
    suffix = "dylib" if sys.platform == "darwin" else "so"
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        part = Path(scratch, "unit.fmu")
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(codegen.build(text), f"binaries/{system}/railrepro_car.{suffix}")
            archive.writestr("modelDescription.xml", _description(guid))
        part.replace(target)
    return target


def _constants(car: SteppedCar, guid: str) -> str:
    """C constants of an FMU: tables, parameters, start state."""

    def array(name: str, values: np.ndarray) -> str:
        numbers = ",".join(float(v).hex() for v in np.ravel(values))
        return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"

    sizes = {"N_STATE": len(plant.STATES), "N_OUTPUT": len(plant.car().outputs), "N_CELL": len(route.COLUMNS)}
    sizes |= {"N_CELLS": len(car.way.cells), "N_CONTACT": plant.CONTACT_COLUMNS, "N_CONTACTS": len(car._contacts)}
    grids = {"CELL_START": car.way.cells[0, 0], "CELL_STEP": route.CELL}
    grids |= {"CONTACT_START": car.table.start, "CONTACT_STEP": car.table.step, "PERIOD": plant.EXCHANGE_PERIOD}
    text = f'\n#define GUID "{guid}"\n'
    text += "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    text += "".join(f"#define {name} {float(value).hex()}\n" for name, value in grids.items())
    arrays = {"CELLS": car.way.cells, "CONTACTS": car._contacts, "PARAMETERS": car.parameters, "START": car.state}
    return text + "".join(array(name, values) for name, values in arrays.items())


def _description(guid: str) -> str:
    """modelDescription.xml of the unit; value references count outputs first, then inputs."""
    root = ElementTree.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName="railrepro_car", guid=guid,
        description="Multibody car on independently rotating wheels", generationTool="railrepro",
        variableNamingConvention="structured", numberOfEventIndicators="0",
    )  # fmt: skip
    ElementTree.SubElement(
        root, "CoSimulation", modelIdentifier="railrepro_car", canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="false",
    )  # fmt: skip
    step = str(plant.EXCHANGE_PERIOD)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step)
    variables = ElementTree.SubElement(root, "ModelVariables")
    names = [(name, "output") for name in plant.car().outputs] + [(f"tau_{wheel}", "input") for wheel in plant.WHEELS]
    for reference, (name, causality) in enumerate(names):
        attributes = {"name": name, "valueReference": str(reference), "causality": causality}
        entry = ElementTree.SubElement(variables, "ScalarVariable", variability="continuous", **attributes)
        ElementTree.SubElement(entry, "Real", **({"start": "0"} if causality == "input" else {}))
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = ElementTree.SubElement(structure, "Outputs")
    for index, (_, causality) in enumerate(names, start=1):
        if causality == "output":
            ElementTree.SubElement(outputs, "Unknown", index=str(index))
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")
