"""From C source text to an FMU (FMI 2.0) for co-simulation, for this platform. Each FMU has its own C (`fmu_t`, reset,
begin, advance), which fmi2.c translates to the standard. All run-time numbers of car and controllers are parameters of
their FMUs."""

from __future__ import annotations

import io
import sys
import uuid
import zipfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

import numpy as np

from railrepro import data
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import cache, codegen
from railrepro.data import location, write
from railrepro.quantities import notes

_HERE = Path(__file__).parent
_FOLDER, _SUFFIX = {"darwin": ("darwin64", "dylib")}.get(sys.platform, ("linux64", "so"))
"""Name of this platform in FMI 2.0, and suffix of its shared objects."""


@dataclass(frozen=True)
class Parameter:
    """A run-time number of an exported car or controller: name, value, unit (SI), allowed range `low` to `high`."""

    name: str
    value: float
    unit: str
    low: float
    high: float


def parameters(of: type, values: Iterable[float]) -> list[Parameter]:
    """`Parameter` list of the entries of a dataclass of quantities (`railrepro.quantities`). `values` (SI) are in the
    order of the entries. Ranges are those of the class, +-1e12 where it states none."""
    found = []
    for (name, note), value in zip(notes(of), values, strict=True):
        allowed = note if isinstance(note, data.Quantity) else data.Quantity(-1e12, 1e12, note or "", closed=True)
        low = -allowed.high if allowed.signed else allowed.low
        found.append(Parameter(name, float(value), allowed.unit, low, allowed.high))
    return found


def parameters_text(of: Sequence[Parameter]) -> str:
    """C text of parameters: an enum of their indices (PARAMETER_BODY_MASS, …), N_PARAMETER, array PARAMETERS."""
    text = index_enum("PARAMETER", [one.name for one in of]) + codegen.defines({"N_PARAMETER": len(of)})
    return text + constant("PARAMETERS", np.array([one.value for one in of]))


def index_enum(prefix: str, of: Iterable[str]) -> str:
    """C enum of the indices of names: for the prefix MEASURED the name front.p becomes MEASURED_FRONT_P."""
    return codegen.enumeration(f"{prefix}_{name.replace('.', '_').upper()}" for name in of)


def constant(name: str, values: np.ndarray) -> str:
    """C text of a constant array of doubles called `name`, row by row. Numbers are hexadecimal, so they are exact."""
    numbers = ",".join(float(v).hex() if v else "0" for v in np.ravel(values))
    return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"


@dataclass(frozen=True)
class Fmu:
    """Content of an FMU of a car or a controller; `write` makes the file.

    Attributes:
        name, description (str): "car" or "controller"; one line on it.
        outputs, inputs (tuple of str): Names of the variables in the order of the C arrays (SI).
        parameters (sequence of Parameter): In the order of the C array.
    """

    name: str
    description: str
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    largest: float
    """Largest magnitude of an input (SI)."""
    parameters: Sequence[Parameter]
    text: str
    """C source with call.h, generated functions and constants, which defines the type fmu_t, its members FMU_INPUTS,
    FMU_OUTPUTS and FMU_PARAMETERS, and the functions reset, begin and advance."""

    def write(self, path: Path | str) -> Path:
        """Compile the source, write the .fmu file and return its path. InputError if the file cannot be written."""
        file = location(path)
        limits = [(-self.largest, self.largest)] * len(self.inputs) + [(one.low, one.high) for one in self.parameters]
        lowest, highest = np.transpose(limits)
        text = self.text + constant("LOWEST", lowest) + constant("HIGHEST", highest)
        text += codegen.defines({"FMU_NAME": f'"{self.name}"', "PERIOD": CONTROL_PERIOD})
        text += (_HERE / "fmi2.c").read_text(encoding="utf-8")
        guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {text}{self.model_description('')}"))
        compiled, packed = cache.build(text, portable=True), io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.write(compiled, f"binaries/{_FOLDER}/railrepro_{self.name}.{_SUFFIX}")
            archive.writestr("modelDescription.xml", self.model_description(guid))
            archive.writestr("sources/all.c", text)
        write(file, packed.getvalue())
        return file

    def model_description(self, guid: str) -> str:
        """Text of modelDescription.xml with the GUID `guid`. Value references count outputs, then inputs, then
        parameters."""
        limits = f'min="{-self.largest:g}" max="{self.largest:g}" start="0"'
        shown = [(name, "output", "continuous", "") for name in self.outputs]
        shown += [(name, "input", "continuous", limits) for name in self.inputs]
        for one in self.parameters:
            edges = f'start="{one.value!r}" min="{one.low!r}" max="{one.high!r}" unit="{one.unit or "-"}"'
            shown.append((one.name, "parameter", "fixed", edges))
        variables = (
            f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}" variability="{variability}">'
            f"<Real {number}/></ScalarVariable>"
            for i, (name, causality, variability, number) in enumerate(shown)
        )
        return Template((_HERE / "modelDescription.xml").read_text(encoding="utf-8")).substitute(
            identifier=f"railrepro_{self.name}",
            description=self.description,
            guid=guid,
            step=CONTROL_PERIOD,
            units="".join(f'<Unit name="{unit}"/>' for unit in sorted({one.unit or "-" for one in self.parameters})),
            variables="\n    ".join(variables),
            unknowns="".join(f'<Unknown index="{i + 1}"/>' for i in range(len(self.outputs))),
        )
