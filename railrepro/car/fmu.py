"""The car as an FMI 2.0 co-simulation unit. Serves the paper's section Simulation Environment."""

from __future__ import annotations

import io
import platform
import sys
import uuid
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from railrepro.car import equations, stepper
from railrepro.car.component import DERAILED, LARGEST_TORQUE, SteppedCar
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.errors import InputError
from railrepro.files import write
from railrepro.track.route import CELL, COLUMNS, INDEX, Route
from railrepro.vehicle.parameters import Vehicle

_LARGEST_STATE = 1e7
"""Beyond it no state is meaningful (SI)."""


def export_fmu(path: Path | str, route: Route | str, speed: float, vehicle: Vehicle | None = None) -> Path:
    """Write the car on a route as an FMI 2.0 co-simulation unit for this platform.

    Inputs are the four motor torque commands `tau_front_le` … (N m), outputs `equations.car().outputs`. The
    communication step must be a whole number of ms; route, contact table and vehicle are built in. A torque that is no
    number or beyond `LARGEST_TORQUE` is refused with fmi2Error, a car that leaves the rail is told with fmi2Warning.
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

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Without C compiler, with an impossible speed, or where the file cannot be written.
    """
    if codegen.compiler() is None:
        raise InputError("an FMU holds compiled code: a C compiler is needed")
    car = SteppedCar(route, speed, vehicle)
    text = codegen.source_text(stepper.functions()) + stepper.c_text() + _constants(car)
    interface = Path(__file__).with_name("fmu.c").read_text()
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {text}{interface}{_description('')}"))
    text += f'\n#define GUID "{guid}"\n{interface}'
    target = Path(path)
    system = {"linux": "linux64", "darwin": "darwin64"}.get(sys.platform, sys.platform + platform.machine()[-2:])
    suffix = "dylib" if sys.platform == "darwin" else "so"
    compiled, packed = codegen.build(text, portable=True), io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(compiled, f"binaries/{system}/railrepro_car.{suffix}")
        archive.writestr("modelDescription.xml", _description(guid))
    write(target, packed.getvalue())
    return target


def _constants(car: SteppedCar) -> str:
    """C constants of an FMU: tables, parameters, start state."""

    def array(name: str, values: np.ndarray) -> str:
        numbers = ",".join(float(v).hex() for v in np.ravel(values))
        return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"

    contacts = car.table.cells()
    sizes = {"N_STATE": len(equations.STATES), "N_OUTPUT": len(equations.car().outputs), "N_CELL": len(COLUMNS)}
    sizes |= {"N_CELLS": len(car.route.cells), "N_CONTACT": equations.CONTACT_COLUMNS, "N_CONTACTS": len(contacts)}
    sizes |= {"BODIES": len(equations.BODIES), "WHEELS": len(equations.WHEELS)}
    grids = {"CELL_START": car.route.cells[0, INDEX["p"]], "CELL_STEP": CELL}
    grids |= {"CONTACT_START": car.table.start, "CONTACT_STEP": car.table.step, "PERIOD": EXCHANGE_PERIOD}
    grids |= {"LARGEST_TORQUE": LARGEST_TORQUE, "LARGEST_STATE": _LARGEST_STATE, "DERAILED": DERAILED}
    outputs = equations.car().outputs
    sizes |= {"FRONT_Y": outputs.index("front.y"), "REAR_Y": outputs.index("rear.y")}
    text = f'\n#define TORQUE_TEXT "{LARGEST_TORQUE:g} N m"\n'
    text += "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    text += "".join(f"#define {name} {float(value).hex()}\n" for name, value in grids.items())
    arrays = {"CELLS": car.route.cells, "CONTACTS": contacts, "PARAMETERS": car.parameters, "START": car.state}
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
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusError", "logStatusWarning"):
        ElementTree.SubElement(categories, "Category", name=name)
    step = str(EXCHANGE_PERIOD)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step)
    variables = ElementTree.SubElement(root, "ModelVariables")
    names = [(name, "output") for name in equations.car().outputs] + [
        (f"tau_{wheel}", "input") for wheel in equations.WHEELS
    ]
    for reference, (name, causality) in enumerate(names):
        attributes = {"name": name, "valueReference": str(reference), "causality": causality}
        entry = ElementTree.SubElement(variables, "ScalarVariable", variability="continuous", **attributes)
        limits = {"min": f"{-LARGEST_TORQUE:g}", "max": f"{LARGEST_TORQUE:g}", "start": "0"}
        ElementTree.SubElement(entry, "Real", **(limits if causality == "input" else {}))
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, kind)
        for index, (_, causality) in enumerate(names, start=1):
            if causality == "output":
                ElementTree.SubElement(unknowns, "Unknown", index=str(index))
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")
