"""From C source text to a unit of FMI 2.0 for co-simulation, for this platform.

What a unit does stands in its own C (`unit_t`, connect, reset, begin, advance) between fmi2.h and fmi2.c.
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
from railrepro.files import write


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
    numbers = ",".join(float(v).hex() for v in np.ravel(values))
    return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"


def write_unit(path: Path | str, unit: Unit, text: str, own: str) -> Path:
    """Compile and pack a unit.

    Parameters
    ----------
    path : path
        The .fmu file.
    unit : Unit
    text : str
        C source with call.h, generated functions and constants; INPUTS_TEXT says what can be set, INPUT_TEXT what a
        refused value is told.
    own : str
        C source of the unit.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    begin, end = (Path(__file__).with_name(name).read_text() for name in ("fmi2.h", "fmi2.c"))
    numbers = {"N_INPUT": len(unit.inputs), "LARGEST_INPUT": float(unit.largest).hex(), "UNIT": f'"{unit.name}"'}
    text += "".join(f"#define {name} {value}\n" for name, value in numbers.items())
    guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {text}{begin}{own}{end}{_description(unit, '')}"))
    text += f'\n#define GUID "{guid}"\n{begin}{own}{end}'
    system = {"linux": "linux64", "darwin": "darwin64"}.get(sys.platform, sys.platform + platform.machine()[-2:])
    suffix = "dylib" if sys.platform == "darwin" else "so"
    compiled, packed = codegen.build(text, portable=True), io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(compiled, f"binaries/{system}/{unit.identifier}.{suffix}")
        archive.writestr("modelDescription.xml", _description(unit, guid))
    write(Path(path), packed.getvalue())
    return Path(path)


def _description(unit: Unit, guid: str) -> str:
    """modelDescription.xml; value references count outputs first, then inputs."""
    root = ElementTree.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=unit.identifier, guid=guid,
        description=unit.description, generationTool="railrepro",
        variableNamingConvention="structured", numberOfEventIndicators="0",
    )  # fmt: skip
    ElementTree.SubElement(
        root, "CoSimulation", modelIdentifier=unit.identifier, canHandleVariableCommunicationStepSize="true",
        canGetAndSetFMUstate="false",
    )  # fmt: skip
    categories = ElementTree.SubElement(root, "LogCategories")
    for name in ("logStatusError", "logStatusWarning"):
        ElementTree.SubElement(categories, "Category", name=name)
    step = str(EXCHANGE_PERIOD)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=step)
    variables = ElementTree.SubElement(root, "ModelVariables")
    names = [(name, "output") for name in unit.outputs] + [(name, "input") for name in unit.inputs]
    for reference, (name, causality) in enumerate(names):
        attributes = {"name": name, "valueReference": str(reference), "causality": causality}
        entry = ElementTree.SubElement(variables, "ScalarVariable", {"variability": "continuous"} | attributes)
        limits = {"min": f"{-unit.largest:g}", "max": f"{unit.largest:g}", "start": "0"}
        ElementTree.SubElement(entry, "Real", limits if causality == "input" else {})
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        unknowns = ElementTree.SubElement(structure, kind)
        for index, (_, causality) in enumerate(names, start=1):
            if causality == "output":
                ElementTree.SubElement(unknowns, "Unknown", index=str(index))
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode")
