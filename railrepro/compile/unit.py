"""From C source text to a unit of FMI 2.0 or 3.0 for co-simulation, for this platform.

What a unit does stands in its own C (`unit_t`, connect, reset, begin, advance) between fmi.h and fmi.c; fmi2.c and
fmi3.c translate to the two versions of the standard.
"""

from __future__ import annotations

import io
import platform
import sys
import uuid
import zipfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.errors import InputError
from railrepro.files import write
from railrepro.schema import location

VERSIONS = ("2.0", "3.0")
"""Versions of FMI."""


@dataclass(frozen=True)
class Unit:
    """What the description of a unit says.

    Attributes
    ----------
    name, description : str
    outputs, inputs : tuple of str
    largest : float
        Largest magnitude of an input (SI).
    """

    name: str
    description: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    largest: float

    @property
    def identifier(self) -> str:
        """Name of the unit among others."""
        return f"railrepro_{self.name}"


def constant(name: str, values: np.ndarray) -> str:
    """C constant that holds numbers exactly."""
    numbers = ",".join(float(v).hex() if v else "0" for v in np.ravel(values))
    return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"


def unit_file(path: Path | str) -> Path:
    """A file that a unit can be written to.

    Raises
    ------
    InputError
        For a folder, and where no C compiler makes the code in it.
    """
    file = location(path)
    if file.is_dir():
        raise InputError(f"{file} is a folder, the name of an .fmu file is needed")
    if codegen.compiler() is None:
        raise InputError("an FMU holds compiled code: a C compiler is needed")
    return file


def write_unit(path: Path | str, unit: Unit, text: str, own: str, fmi: str = "2.0") -> Path:
    """Compile and pack a unit.

    Parameters
    ----------
    path : path
        The .fmu file.
    unit : Unit
    text : str
        C source with call.h, generated functions and constants; INPUTS_TEXT says what can be set, INPUT_TEXT what a
        refused value gets as an answer.
    own : str
        C source of the unit.
    fmi : str
        One of `VERSIONS`.

    Raises
    ------
    InputError
        With another version, or where the file cannot be written.
    """
    if fmi not in VERSIONS:
        raise InputError(f"FMI {fmi!r} is not known; there are {list(VERSIONS)}")
    describe, system = (_description_2, _system_2()) if fmi == "2.0" else (_description_3, _system_3())
    parts = ("fmi.h", "fmi.c", f"fmi{fmi[0]}.c")
    begin, shared, version = (Path(__file__).with_name(name).read_text() for name in parts)
    numbers = {"N_INPUT": len(unit.inputs), "LARGEST_INPUT": float(unit.largest).hex(), "UNIT": f'"{unit.name}"'}
    text += "".join(f"#define {name} {value}\n" for name, value in numbers.items())
    around = f"{begin}{own}{shared}{version}"
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {text}{around}{describe(unit, '')}"))
    text += f'\n#define GUID "{guid}"\n{around}'
    suffix = "dylib" if sys.platform == "darwin" else "so"
    compiled, packed = codegen.build(text, portable=True), io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(compiled, f"binaries/{system}/{unit.identifier}.{suffix}")
        archive.writestr("modelDescription.xml", describe(unit, guid))
    write(Path(path), packed.getvalue())
    return Path(path)


def _system_2() -> str:
    """Name of this platform in FMI 2.0."""
    return {"linux": "linux64", "darwin": "darwin64"}.get(sys.platform, sys.platform + platform.machine()[-2:])


def _system_3() -> str:
    """Name of this platform in FMI 3.0."""
    machine = platform.machine().lower()
    return {"arm64": "aarch64", "amd64": "x86_64"}.get(machine, machine) + f"-{sys.platform}"


def _variables(unit: Unit) -> list[tuple[dict[str, str], dict[str, str]]]:
    """Attributes of each variable, and those of its number; value references count outputs first, then inputs."""
    limits = {"min": f"{-unit.largest:g}", "max": f"{unit.largest:g}", "start": "0"}
    names: list[tuple] = [(name, "output", {}) for name in unit.outputs] + [
        (name, "input", limits) for name in unit.inputs
    ]
    return [
        ({"variability": "continuous", "name": name, "valueReference": str(i), "causality": causality}, number)
        for i, (name, causality, number) in enumerate(names)
    ]


def _root(version: str, unit: Unit, can: dict[str, str], **attributes: str) -> ElementTree.Element:
    """What both versions begin with."""
    own = {"description": unit.description, "generationTool": "railrepro", "variableNamingConvention": "structured"}
    named = {"fmiVersion": version, "modelName": unit.identifier}
    root = ElementTree.Element("fmiModelDescription", named | attributes | own)
    ElementTree.SubElement(root, "CoSimulation", {"modelIdentifier": unit.identifier} | can)
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusError", "logStatusWarning"):
        ElementTree.SubElement(categories, "Category", name=name)
    step = str(EXCHANGE_PERIOD)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step)
    return root


def _text(root: ElementTree.Element) -> str:
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")


def _description_2(unit: Unit, guid: str) -> str:
    """modelDescription.xml of FMI 2.0."""
    can = {"canHandleVariableCommunicationStepSize": "true", "canGetAndSetFMUstate": "false"}
    root = _root("2.0", unit, can, guid=guid, numberOfEventIndicators="0")
    variables = ElementTree.SubElement(root, "ModelVariables")
    for attributes, number in _variables(unit):
        ElementTree.SubElement(ElementTree.SubElement(variables, "ScalarVariable", attributes), "Real", number)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, kind)
        for index in range(1, len(unit.outputs) + 1):
            ElementTree.SubElement(unknowns, "Unknown", index=str(index))
    return _text(root)


def _description_3(unit: Unit, guid: str) -> str:
    """modelDescription.xml of FMI 3.0, which wants the time among the variables."""
    can = {"canHandleVariableCommunicationStepSize": "true", "fixedInternalStepSize": str(EXCHANGE_PERIOD)}
    root = _root("3.0", unit, can, instantiationToken=guid)
    variables = ElementTree.SubElement(root, "ModelVariables")
    for attributes, number in _variables(unit):
        ElementTree.SubElement(variables, "Float64", attributes | number)
    time = {"name": "time", "valueReference": str(len(variables)), "causality": "independent"}
    ElementTree.SubElement(variables, "Float64", {"variability": "continuous"} | time)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Output", "InitialUnknown"):
        for reference in range(len(unit.outputs)):
            ElementTree.SubElement(structure, kind, valueReference=str(reference))
    return _text(root)
