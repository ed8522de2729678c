"""From C source text to an FMU (FMI 2.0) for co-simulation, for this platform.

What an FMU does stands in its own C (`fmu_t`, connect, reset, begin, advance), which fmi2.c translates to the
standard. All run-time numbers of car and controllers are parameters of their FMUs.
"""

from __future__ import annotations

import io
import platform
import sys
import uuid
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from railrepro import data
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import cache, codegen
from railrepro.data import location, write
from railrepro.quantities import names, notes

_SOURCE = "all.c"
"""Name of the C source in an FMU."""
_ANY = data.Quantity(-1e12, 1e12, "", closed=True)
"""Range of what states none."""


@dataclass(frozen=True)
class Parameter:
    """A number of an exported car or controller that may be changed before a run (SI)."""

    name: str
    value: float
    unit: str
    low: float
    high: float


def parameters(of: type, values: Iterable[float], below: str = "") -> list[Parameter]:
    """The entries of a dataclass of quantities as parameters, their names `below` another one."""
    found = []
    for name, note, value in zip(names(of), notes(of), values, strict=True):
        allowed = note if isinstance(note, data.Quantity) else replace(_ANY, unit=note or "")
        low = -allowed.high if allowed.signed else allowed.low
        found.append(Parameter(below + name, float(value), allowed.unit, low, allowed.high))
    return found


def parameters_text(of: Sequence[Parameter]) -> str:
    """C of start values and ranges, and where each stands: PARAMETER_BODY_MASS and so on."""
    tables = {"PARAMETERS": "value", "LOWEST": "low", "HIGHEST": "high"}
    text = "".join(constant(name, np.array([getattr(one, key) for one in of])) for name, key in tables.items())
    return index_enum("PARAMETER", [one.name for one in of]) + f"enum {{ N_PARAMETER = {len(of)} }};\n" + text


def index_enum(prefix: str, of: Iterable[str]) -> str:
    """C enumeration of the indices of named values, MEASURED_FRONT_P and so on."""
    return f"enum {{ {', '.join(f'{prefix}_{name.replace(chr(46), chr(95)).upper()}' for name in of)} }};\n"


@dataclass(frozen=True)
class Fmu:
    """What the description of an FMU says.

    Attributes
    ----------
    name, description : str
    outputs, inputs : tuple of str
    largest : float
        Largest magnitude of an input (SI).
    parameters : sequence of Parameter
    """

    name: str
    description: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    largest: float
    parameters: Sequence[Parameter]

    @property
    def identifier(self) -> str:
        """Name of the FMU among others."""
        return f"railrepro_{self.name}"


def constant(name: str, values: np.ndarray) -> str:
    """C constant that holds numbers exactly."""
    numbers = ",".join(float(v).hex() if v else "0" for v in np.ravel(values))
    return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"


def write_fmu(path: Path | str, fmu: Fmu, text: str, model: str) -> Path:
    """Compile and pack an FMU.

    Parameters
    ----------
    path : path
        The .fmu file.
    fmu : Fmu
    text : str
        C source with call.h, generated functions and constants. It defines INPUTS_TEXT (names of the inputs, for
        error messages) and INPUT_TEXT (message for an input out of range).
    model : str
        C source of the FMU's model: type fmu_t, functions connect, reset, begin and advance.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    numbers = {"N_INPUT": len(fmu.inputs), "LARGEST_INPUT": float(fmu.largest).hex(), "FMU_NAME": f'"{fmu.name}"'}
    text += codegen.defines(numbers)
    file, around = location(path), model + Path(__file__).with_name("fmi2.c").read_text()
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {text}{around}{_description(fmu, '')}"))
    text += f'\n#define GUID "{guid}"\n{around}'
    suffix = "dylib" if sys.platform == "darwin" else "so"
    compiled, packed = cache.build(text, portable=True), io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(compiled, f"binaries/{_system()}/{fmu.identifier}.{suffix}")
        archive.writestr("modelDescription.xml", _description(fmu, guid))
        archive.writestr(f"sources/{_SOURCE}", text)
    write(file, packed.getvalue())
    return file


def _system() -> str:
    """Name of this platform in FMI 2.0."""
    return {"linux": "linux64", "darwin": "darwin64"}.get(sys.platform, sys.platform + platform.machine()[-2:])


def _variables(fmu: Fmu) -> list[tuple[dict[str, str], dict[str, str]]]:
    """Attributes of each variable, and those of its number; value references count outputs, inputs, parameters."""
    limits = {"min": f"{-fmu.largest:g}", "max": f"{fmu.largest:g}", "start": "0"}
    shown: list[tuple] = [(name, "output", {}) for name in fmu.outputs]
    shown += [(name, "input", limits) for name in fmu.inputs]
    for one in fmu.parameters:
        edges = {"start": repr(one.value), "min": repr(one.low), "max": repr(one.high)}
        shown.append((one.name, "parameter", edges | ({"unit": one.unit} if one.unit.strip("-") else {})))
    found = []
    for i, (name, causality, number) in enumerate(shown):
        variability = "fixed" if causality == "parameter" else "continuous"
        head = {"variability": variability, "name": name, "valueReference": str(i), "causality": causality}
        found.append((head, number))
    return found


def _description(fmu: Fmu, guid: str) -> str:
    """modelDescription.xml."""
    named = {"fmiVersion": "2.0", "modelName": fmu.identifier, "guid": guid, "numberOfEventIndicators": "0"}
    own = {"description": fmu.description, "generationTool": "railrepro", "variableNamingConvention": "structured"}
    root = ElementTree.Element("fmiModelDescription", named | own)
    can = {"canHandleVariableCommunicationStepSize": "true", "canGetAndSetFMUstate": "false"}
    simulation = ElementTree.SubElement(root, "CoSimulation", {"modelIdentifier": fmu.identifier} | can)
    ElementTree.SubElement(ElementTree.SubElement(simulation, "SourceFiles"), "File", name=_SOURCE)
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({one.unit for one in fmu.parameters if one.unit.strip("-")}):
        ElementTree.SubElement(units, "Unit", name=unit)
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusError", "logStatusWarning"):
        ElementTree.SubElement(categories, "Category", name=name)
    step = str(CONTROL_PERIOD)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step)
    variables = ElementTree.SubElement(root, "ModelVariables")
    for attributes, number in _variables(fmu):
        ElementTree.SubElement(ElementTree.SubElement(variables, "ScalarVariable", attributes), "Real", number)
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, kind)
        for index in range(1, len(fmu.outputs) + 1):
            ElementTree.SubElement(unknowns, "Unknown", index=str(index))
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")
