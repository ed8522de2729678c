"""From C source text to an FMU (FMI 2.0) for co-simulation, for this platform and others. Each FMU has its own C (type
`fmu_t`, reset, begin, advance, …), which fmi2.c translates to the standard. All run-time numbers of car and controllers
are parameters of their FMUs; a range comes from the `data.Quantity` of the number."""

from __future__ import annotations

import io
import math
import reprlib
import sys
import uuid
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import cache, codegen
from railrepro.data import InputError, Quantity, between, location, require, write
from railrepro.quantities import notes

_HERE = Path(__file__).parent
_LARGEST = sys.float_info.max
PLATFORMS = {
    "linux64": ("so", "x86_64-linux-gnu"),
    "win64": ("dll", "x86_64-windows-gnu"),
    "darwin64": ("dylib", "aarch64-macos"),
}
"""Name of a platform in FMI 2.0 -> suffix of its shared objects, and target of the compiler of the package ziglang."""
HERE = "darwin64" if sys.platform == "darwin" else "linux64"
"""Name of this platform, for which its own compiler is taken."""


@dataclass(frozen=True)
class Variable:
    """An input or a parameter of an exported car or controller: name, value at the start, unit (SI), permitted range
    `low` to `high`, by default all finite numbers. InputError if the value is out of the range."""

    name: str
    value: float
    unit: str = ""
    low: float = -_LARGEST
    high: float = _LARGEST

    def __post_init__(self) -> None:
        require(f"export: {self.name}", self.value, between(self.low, self.high, self.unit))


def variable(name: str, value: float, note: Any = None) -> Variable:
    """`Variable` whose range is that of `note`, a `data.Quantity`, or a note of `quantities.notes` without range. The
    sign of `value` stays where the range excludes 0."""
    note = between(0.0, 1.0) if note is bool else note
    if not isinstance(note, Quantity):
        return Variable(name, float(value), note if isinstance(note, str) else "")
    low, high = note.low, note.high
    if not note.closed:
        low = math.nextafter(low, math.inf) if low else sys.float_info.min
    if note.signed:
        low, high = (-high, high) if note.closed else (low, high) if value > 0 else (-high, -low)
    return Variable(name, float(value), note.unit, float(low), float(high))


def variables(of: type, values: Iterable[float], ranges: Mapping[str, Quantity] | None = None) -> list[Variable]:
    """`variable` of each entry of a dataclass of quantities, with its range in `ranges`, by its name, or else its note.
    `values` (SI) are in the order of the entries."""
    noted = [(name, (ranges or {}).get(name, note)) for name, note in notes(of)]
    return [variable(name, value, note) for (name, note), value in zip(noted, values, strict=True)]


def numbers_text(inputs: Sequence[Variable], of: Sequence[Variable]) -> str:
    """C text of the parameters `of`: an enum of their indices (PARAMETER_BODY_MASS, …), N_PARAMETER, array PARAMETERS;
    arrays LOWEST and HIGHEST with the ranges of the inputs, then of the parameters."""
    text = index_enum("PARAMETER", [one.name for one in of]) + codegen.defines({"N_PARAMETER": len(of)})
    text += constant("PARAMETERS", np.array([one.value for one in of]))
    lowest, highest = np.transpose([(one.low, one.high) for one in (*inputs, *of)])
    return text + constant("LOWEST", lowest) + constant("HIGHEST", highest)


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
        outputs (tuple of str): Names of the outputs in the order of the C array.
        inputs, parameters (sequence of Variable): In the order of the C arrays.
    """

    name: str
    description: str
    outputs: tuple[str, ...]
    inputs: Sequence[Variable]
    parameters: Sequence[Variable]
    text: str
    """C source with call.h, generated functions and `numbers_text`, which defines the type fmu_t, its members
    FMU_INPUTS, FMU_OUTPUTS and FMU_PARAMETERS, the macro FMU_COUNT and the functions reset, begin and advance."""
    counter: tuple[str, ...] = ()
    """Name of the output that is a whole number, FMU_COUNT, if there is one."""

    def write(self, path: Path | str, platforms: Sequence[str] | None = None) -> Path:
        """Compile the source, write the .fmu file and return its path.

        Args:
            path (path): The file to write.
            platforms (sequence of str, optional): Keys of `PLATFORMS` to compile for; default this platform. Others
                need the package ziglang.

        Raises:
            InputError: No path, unknown platform, no compiler for it, or the file cannot be written.
        """
        file, kinds = location(path), (HERE,) if platforms is None else platforms
        if not isinstance(kinds, tuple | list) or not kinds or any(kind not in tuple(PLATFORMS) for kind in kinds):
            raise InputError(f"platforms is {reprlib.repr(kinds)}, a list of names in {tuple(PLATFORMS)} is needed")
        needed = ", ".join(
            f'"{one.name}: a number from {one.low:g} up to {one.high:g} {one.unit} is needed"'
            for one in (*self.inputs, *self.parameters)
        )
        numbers = {"FMU_NAME": f'"{self.name}"', "PERIOD": CONTROL_PERIOD, "N_COUNTER": len(self.counter)}
        text = self.text + f"static const char *const NEEDED[] = {{{needed}}};\n" + codegen.defines(numbers)
        text += (_HERE / "fmi2.c").read_text(encoding="utf-8")
        guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {text}{self.model_description('')}"))
        # where a DLL exports something by name, as CasADi's functions, it exports nothing else
        text = codegen.defines({"FMU_GUID": f'"{guid}"', "CASADI_SYMBOL_EXPORT": ""}) + text
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for kind in dict.fromkeys(kinds):
                suffix, triple = PLATFORMS[kind]
                compiled = cache.build(text, portable=True, triple="" if kind == HERE else triple)
                archive.write(compiled, f"binaries/{kind}/railrepro_{self.name}.{suffix}")
            archive.writestr("modelDescription.xml", self.model_description(guid))
            archive.writestr("sources/all.c", text)
        write(file, packed.getvalue())
        return file

    def model_description(self, guid: str) -> str:
        """Text of modelDescription.xml with the GUID `guid`. Value references count outputs, then inputs, then
        parameters; the counter has its own."""
        numbers = (*self.inputs, *self.parameters)
        reals = [(name, "output", "continuous", "<Real/>") for name in self.outputs]
        reals += [(one.name, "input", "continuous", _real(one)) for one in self.inputs]
        reals += [(one.name, "parameter", "fixed", _real(one)) for one in self.parameters]
        counts = [(name, "output", "discrete", "<Integer/>") for name in self.counter]
        results = [*range(1, len(self.outputs) + 1), *range(len(reals) + 1, len(reals) + len(counts) + 1)]
        variables = (
            f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}" variability="{variability}">'
            f"{kind}</ScalarVariable>"
            for of in (reals, counts)
            for i, (name, causality, variability, kind) in enumerate(of)
        )
        return Template((_HERE / "modelDescription.xml").read_text(encoding="utf-8")).substitute(
            identifier=f"railrepro_{self.name}",
            description=self.description,
            guid=guid,
            step=CONTROL_PERIOD,
            units="".join(f'<Unit name="{unit}"/>' for unit in sorted({one.unit or "-" for one in numbers})),
            variables="\n    ".join(variables),
            unknowns="".join(f'<Unknown index="{index}"/>' for index in results),
        )


def _real(of: Variable) -> str:
    return f'<Real start="{of.value!r}" min="{of.low!r}" max="{of.high!r}" unit="{of.unit or "-"}"/>'
