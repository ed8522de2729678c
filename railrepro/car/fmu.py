"""The car as an FMI 2.0 co-simulation unit. Serves the paper's section Simulation Environment."""

from __future__ import annotations

import platform
import sys
import tempfile
import uuid
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from railrepro.car import equations, stepper
from railrepro.car.component import SteppedCar
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.errors import InputError
from railrepro.track.route import CELL, COLUMNS, INDEX, Route
from railrepro.vehicle.parameters import Vehicle


def export_fmu(path: Path | str, route: Route | str, speed: float, vehicle: Vehicle | None = None) -> Path:
    """Write the car on a route as an FMI 2.0 co-simulation unit for this platform.

    Inputs are the four motor torque commands `tau_front_le` … (N m), outputs `equations.car().outputs`. The
    communication step must be a whole number of ms; route, contact table and vehicle are built in.

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
    car = SteppedCar(route, speed, vehicle)
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {speed} {car.parameters.tobytes().hex()[:200]}"))
    text = codegen.source_text(stepper.functions()) + stepper.c_text()
    text += _constants(car, guid) + Path(__file__).with_name("fmu.c").read_text()
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

    contacts = car.table.cells()
    sizes = {"N_STATE": len(equations.STATES), "N_OUTPUT": len(equations.car().outputs), "N_CELL": len(COLUMNS)}
    sizes |= {"N_CELLS": len(car.route.cells), "N_CONTACT": equations.CONTACT_COLUMNS, "N_CONTACTS": len(contacts)}
    sizes |= {"BODIES": len(equations.BODIES), "WHEELS": len(equations.WHEELS)}
    grids = {"CELL_START": car.route.cells[0, INDEX["p"]], "CELL_STEP": CELL}
    grids |= {"CONTACT_START": car.table.start, "CONTACT_STEP": car.table.step, "PERIOD": EXCHANGE_PERIOD}
    text = f'\n#define GUID "{guid}"\n'
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
    step = str(EXCHANGE_PERIOD)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step)
    variables = ElementTree.SubElement(root, "ModelVariables")
    names = [(name, "output") for name in equations.car().outputs] + [
        (f"tau_{wheel}", "input") for wheel in equations.WHEELS
    ]
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
