"""From C source to an FMU (FMI 2.0) for co-simulation, for this platform and others. Car and controllers have their own
C interface (type `fmu_t`, reset, begin, advance), to which fmi2.c adds the functions of the standard. All their
run-time numbers are parameters of the FMU, with the range of their `data.Quantity`."""

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
from railrepro.data import InputError, Quantity, between, location, require, text, write
from railrepro.quantities import notes

_HERE = Path(__file__).parent
PLATFORMS = {
    "linux64": ("so", "x86_64-linux-gnu"),
    "win64": ("dll", "x86_64-windows-gnu"),
    "darwin64": ("dylib", "aarch64-macos"),
}
"""Name of a platform in FMI 2.0 -> suffix of its shared objects, and target of the compiler of the package ziglang."""
HERE = "darwin64" if sys.platform == "darwin" else "linux64"
"""Name of this platform, whose own C compiler is used."""


@dataclass(frozen=True)
class Variable:
    """An input or a parameter of an FMU: name, initial value, unit (SI), and permitted range, by default all finite
    numbers. InputError if the value is out of the range."""

    name: str
    value: float
    unit: str = ""
    low: float = -sys.float_info.max
    high: float = sys.float_info.max

    def __post_init__(self) -> None:
        require(f"export: {self.name}", self.value, between(self.low, self.high, self.unit))


def variable(name: str, value: float, note: Any = None) -> Variable:
    """Make a `Variable` from its name, its value and a `note`: its unit, a `data.Quantity` with unit and range, bool (0
    to 1), or None. A range of magnitudes low < |x| <= high has two parts; FMI knows only one minimum and maximum, so
    the `Variable` gets the part with the sign of `value`."""
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
    """Make a `Variable` for each quantity in the dataclass `of`, such as "body.mass", from its value (SI) and its
    annotation, a unit or a `data.Quantity`. `ranges`, name -> `data.Quantity`, has precedence over annotations."""
    noted = [(name, (ranges or {}).get(name, note)) for name, note in notes(of)]
    return [variable(name, value, note) for (name, note), value in zip(noted, values, strict=True)]


def numbers_text(inputs: Sequence[Variable], parameters: Sequence[Variable]) -> str:
    """C source of the numbers of an FMU: an enum of the indices of parameters (PARAMETER_BODY_MASS, …), N_PARAMETER,
    array PARAMETERS with their values; arrays LOWEST and HIGHEST with the ranges of the inputs, then of the
    parameters."""
    source = index_enum("PARAMETER", [p.name for p in parameters]) + codegen.defines({"N_PARAMETER": len(parameters)})
    source += constant("PARAMETERS", np.array([p.value for p in parameters]))
    lowest, highest = np.transpose([(one.low, one.high) for one in (*inputs, *parameters)])
    return source + constant("LOWEST", lowest) + constant("HIGHEST", highest)


def index_enum(prefix: str, names: Iterable[str]) -> str:
    """C enum of the indices of names: with the prefix MEASURED the name front.p becomes MEASURED_FRONT_P."""
    return codegen.enumeration(f"{prefix}_{name.replace('.', '_').upper()}" for name in names)


def constant(name: str, values: np.ndarray) -> str:
    """C source of a constant array of doubles, row by row. Numbers are hexadecimal, so they are exact."""
    numbers = ",".join(float(v).hex() if v else "0" for v in np.ravel(values))
    return f"static const double {name}[{np.size(values)}] = {{{numbers}}};\n"


@dataclass(frozen=True)
class Fmu:
    """Content of the FMU of a car or a controller: outputs, inputs and parameters in the order of the C arrays; `text`,
    C source with the functions reset, begin and advance; `counter`, name of an integer output that counts events, as
    ("fallbacks",), () for none."""

    name: str
    description: str
    outputs: tuple[str, ...]
    inputs: Sequence[Variable]
    parameters: Sequence[Variable]
    text: str
    """C source with call.h, generated functions and `numbers_text`. It defines the type fmu_t; macros FMU_INPUTS,
    FMU_OUTPUTS, FMU_PARAMETERS, which name its arrays; FMU_COUNT(u), the value of `counter`, 0 for none; and, for a
    pointer u to an fmu_t, reset(u) to the start values, begin(u) with the present parameters, advance(u, ms)."""
    counter: tuple[str, ...] = ()

    def write(self, path: Path | str, platforms: Sequence[str] | None = None) -> Path:
        """Compile the source, write the .fmu file and return its path. `platforms` are keys of `PLATFORMS`, such as
        ("linux64", "win64"); default this platform, others need the package ziglang. InputError if path or platforms
        are invalid, a compiler is missing, or writing fails."""
        file, kinds = location(path), (HERE,) if platforms is None else platforms
        if not isinstance(kinds, tuple | list) or not kinds or any(kind not in tuple(PLATFORMS) for kind in kinds):
            raise InputError(f"platforms is {reprlib.repr(kinds)}, a list of names in {tuple(PLATFORMS)} is needed")
        needed = ", ".join(
            f'"{one.name}: a number from {one.low:g} up to {one.high:g} {one.unit} is needed"'
            for one in (*self.inputs, *self.parameters)
        )
        numbers = {"FMU_NAME": f'"{self.name}"', "PERIOD": CONTROL_PERIOD, "N_COUNTER": len(self.counter)}
        source = self.text + f"static const char *const NEEDED[] = {{{needed}}};\n" + codegen.defines(numbers)
        source += text(_HERE / "fmi2.c")
        guid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"railrepro {source}{self.model_description('')}"))
        # If a DLL exports functions by name, as CasADi's are by default, it exports no others.
        source = codegen.defines({"FMU_GUID": f'"{guid}"', "CASADI_SYMBOL_EXPORT": ""}) + source
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for kind in dict.fromkeys(kinds):
                suffix, triple = PLATFORMS[kind]
                compiled = cache.build(source, portable=True, triple="" if kind == HERE else triple)
                archive.write(compiled, f"binaries/{kind}/railrepro_{self.name}.{suffix}")
            archive.writestr("modelDescription.xml", self.model_description(guid))
            archive.writestr("sources/all.c", source)
        write(file, packed.getvalue())
        return file

    def model_description(self, guid: str) -> str:
        """Text of modelDescription.xml with the identifier `guid`. Value references count outputs, then inputs, then
        parameters; the counter, an integer output, has the reference 0."""
        reals = [(name, "output", "continuous", "<Real/>") for name in self.outputs]
        reals += [(one.name, "input", "continuous", _real(one)) for one in self.inputs]
        reals += [(one.name, "parameter", "fixed", _real(one)) for one in self.parameters]
        counts = [(name, "output", "discrete", "<Integer/>") for name in self.counter]
        results = [*range(1, len(self.outputs) + 1), *range(len(reals) + 1, len(reals) + len(counts) + 1)]
        units = {one.unit or "-" for one in (*self.inputs, *self.parameters)}
        variables = (
            f'<ScalarVariable name="{name}" valueReference="{i}" causality="{causality}" variability="{variability}">'
            f"{kind}</ScalarVariable>"
            for of in (reals, counts)
            for i, (name, causality, variability, kind) in enumerate(of)
        )
        return Template(text(_HERE / "modelDescription.xml")).substitute(
            identifier=f"railrepro_{self.name}",
            description=self.description,
            guid=guid,
            step=CONTROL_PERIOD,
            units="".join(f'<Unit name="{unit}"/>' for unit in sorted(units)),
            variables="\n    ".join(variables),
            unknowns="".join(f'<Unknown index="{index}"/>' for index in results),
        )


def _real(one: Variable) -> str:
    return f'<Real start="{one.value!r}" min="{one.low!r}" max="{one.high!r}" unit="{one.unit or "-"}"/>'
