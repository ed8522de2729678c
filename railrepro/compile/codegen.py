"""From CasADi functions to C source text, and from there to functions that are called.

The module that the others here import: `cache` compiles text and keeps the objects, `graphs` the functions
that they come from, `functions` binds them to buffers, `reciprocals` saves divisions.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import casadi as ca

from railrepro.compile.cache import CompilerError, build, compiler, flags
from railrepro.compile.functions import Call, CompiledFunction
from railrepro.compile.graphs import stored
from railrepro.compile.reciprocals import share_reciprocals

__all__ = [
    "Call",
    "CompiledFunction",
    "CompilerError",
    "build",
    "compiled",
    "compiler",
    "flags",
    "lanes_header",
    "lanes_text",
    "library",
    "share_reciprocals",
    "source_text",
    "stored",
]


_ROOM = Path(__file__).parent
ELEMENTARY = (_ROOM / "elementary.c").read_text()
"""C of elementary functions that takes the place of the system's, see its head."""


def source_text(functions: Sequence[ca.Function]) -> str:
    """C source of CasADi functions on `ELEMENTARY`, with their work-size and sparsity companions."""
    generator = ca.CodeGenerator("generated", {"with_header": False, "verbose": False})
    for function in functions:
        generator.add(function)
    return ELEMENTARY + generator.dump()


def lanes_header(lanes: int = 4) -> str:
    """C that functions of `lanes_text` (4 lanes) and `pairs.pairs_text` (2) need, to stand after `source_text`."""
    return f"#define LANES {lanes}\n{(_ROOM / 'lanes.h').read_text()}{ELEMENTARY}"


_OPERATIONS = {
    **{ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}"},
    **{ca.OP_NEG: "-{}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "{one} / {}"},
    **{kind: f"{{own}}{name}({{}})" for kind, name in (
        (ca.OP_TAN, "tan"), (ca.OP_ASIN, "asin"), (ca.OP_ATAN, "atan"),
        (ca.OP_EXP, "exp"), (ca.OP_LOG, "log"), (ca.OP_SQRT, "sqrt"), (ca.OP_FLOOR, "floor"), (ca.OP_FABS, "fabs"),
        (ca.OP_SIGN, "sign"),
    )},
    **{kind: f"{{own}}{name}({{}}, {{}})" for kind, name in (
        (ca.OP_POW, "pow"), (ca.OP_CONSTPOW, "pow"), (ca.OP_FMIN, "fmin"), (ca.OP_FMAX, "fmax"),
    )},
    **{kind: f"{{own}}pick({condition}, {{one}}, {{zero}})" for kind, condition in (
        (ca.OP_LT, "{} < {}"), (ca.OP_LE, "{} <= {}"), (ca.OP_EQ, "{} == {}"), (ca.OP_NE, "{} != {}"),
        (ca.OP_NOT, "{} == 0"), (ca.OP_AND, "({} != 0) & ({} != 0)"), (ca.OP_OR, "({} != 0) | ({} != 0)"),
    )},
    ca.OP_IF_ELSE_ZERO: "{own}pick({} != 0, {}, {zero})",
}  # fmt: skip


class Statements:
    """Statements of C, each an operation of CasADi on numbers or on lanes; `lines` so far."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._turned: dict[str, str] = {}

    def name(self, text: str, wide: bool) -> str:
        """Name of a new number or of new lanes with some value."""
        found = f"t{len(self.lines)}"
        self.lines.append(f"const {'lanes_t' if wide else 'double'} {found} = {text};")
        return found

    def operation(self, kind: int, values: Sequence[str], wide: bool) -> str:
        """Name of what an operation gives; ValueError for one that is not translated here."""
        own = "lanes_" if wide else "own_"
        if kind in (ca.OP_SIN, ca.OP_COS):
            (angle,) = values
            if angle not in self._turned:
                self._turned[angle] = f"both{len(self.lines)}"
                self.lines.append(f"const {own}pair_t {self._turned[angle]} = {own}both({angle});")
            part = (".sin", ".cos") if wide else ("[0]", "[1]")
            return self.name(self._turned[angle] + part[kind == ca.OP_COS], wide)
        if kind not in _OPERATIONS:
            raise ValueError(f"operation {kind} is not translated to lanes")
        return self.name(_OPERATIONS[kind].format(*values, own=own, one=f"{own}all(1.0)", zero=f"{own}all(0.0)"), wide)


def lanes_text(function: ca.Function, common: Sequence[str] = ()) -> str:
    """C source of a function that is evaluated for LANES sets of arguments side by side, in vector registers.

    Parameters
    ----------
    function : casadi.Function
        Of scalar operations (SX).
    common : sequence of str
        Names of the inputs that all sets share; what depends on these alone is computed once.

    Returns
    -------
    str
        `static void NAME_lanes(inputs, outputs)`, pointers in CasADi's order to lanes_t (lanes.h), or to double for the
        common inputs.

    Raises
    ------
    ValueError
        When the function uses an operation that is not translated here.
    """
    inputs, outputs = function.name_in(), function.name_out()
    kinds = ["double" if name in common else "lanes_t" for name in inputs]
    signature = [f"const {kind} *in_{name}" for kind, name in zip(kinds, inputs, strict=True)]
    signature += [f"lanes_t *out_{name}" for name in outputs]
    body, slots = Statements(), dict[int, tuple[str, bool]]()
    for i in range(function.n_instructions()):
        kind, to, of = function.instruction_id(i), function.instruction_output(i), function.instruction_input(i)
        if kind == ca.OP_OUTPUT:
            value, wide = slots[of[0]]
            body.lines.append(f"out_{outputs[to[0]]}[{to[1]}] = {value if wide else f'lanes_all({value})'};")
        elif kind == ca.OP_CONST:
            slots[to[0]] = body.name(repr(function.instruction_constant(i)), False), False
        elif kind == ca.OP_INPUT:
            wide = kinds[of[0]] == "lanes_t"
            slots[to[0]] = body.name(f"in_{inputs[of[0]]}[{of[1]}]", wide), wide
        else:
            operands = [slots[slot] for slot in of]
            wide = any(is_wide for _, is_wide in operands)
            values = [value if is_wide or not wide else f"lanes_all({value})" for value, is_wide in operands]
            slots[to[0]] = body.operation(kind, values, wide), wide
    text = "\n  ".join(body.lines)
    return f"static void {function.name()}_lanes({', '.join(signature)}) {{\n  {text}\n}}\n"


def library(functions: Sequence[ca.Function] | str, extra: str = "", level: str = "-Og") -> ctypes.CDLL:
    """Load CasADi functions, or their `source_text`, and extra C source as one shared object; `level` see `flags`."""
    text = functions if isinstance(functions, str) else source_text(functions)
    return ctypes.CDLL(str(build(text + extra, level=level)))


def compiled(function: ca.Function) -> CompiledFunction:
    """One CasADi function as compiled code, with buffers of its own."""
    return CompiledFunction(library([function]), function)
