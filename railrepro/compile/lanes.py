"""C for vector registers: several sets of arguments side by side, or mirrored operations of one set. `lanes_text`
evaluates a CasADi function for several sets of arguments at once. `pairs_text` writes a function whose inputs come in
pairs, such as those of two running gears. Two operations are twins if they do the same with mirrored operands. Twins
become one operation on two lanes, any other operation stays one on numbers. Functions consist of scalar operations (SX)
in `_OPERATIONS`; a KeyError names the code of another one."""

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import casadi as ca

from railrepro.compile.codegen import ELEMENTARY

_CALLS = ("tan", "asin", "atan", "exp", "log", "sqrt", "fabs", "sign", "pow", "fmin", "fmax")
_OPERATIONS = {
    **{ca.OP_INPUT: "{}", ca.OP_CONST: "{}"},
    **{ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}"},
    **{ca.OP_NEG: "-{}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}", ca.OP_INV: "{own}all(1.0) / {}"},
    **{getattr(ca, f"OP_{name.upper()}"): f"{{own}}{name}({{all}})" for name in _CALLS},
    **{ca.OP_CONSTPOW: "{own}pow({all})", ca.OP_IF_ELSE_ZERO: "{own}pick({} != 0, {}, {own}all(0.0))"},
    **{kind: f"{{own}}pick({condition}, {{own}}all(1.0), {{own}}all(0.0))" for kind, condition in (
        (ca.OP_LT, "{} < {}"), (ca.OP_LE, "{} <= {}"), (ca.OP_EQ, "{} == {}"), (ca.OP_NE, "{} != {}"),
        (ca.OP_NOT, "{} == 0"), (ca.OP_AND, "({} != 0) & ({} != 0)"), (ca.OP_OR, "({} != 0) | ({} != 0)"),
    )},
}  # fmt: skip
"""Operation (`ca.OP_…`) -> its C; `all` is the list of operands, `own` the prefix of functions of elementary.c."""


class Statements:
    """C statements `lines` that grow by `operation`. Each statement defines a constant: a vector `lanes_t` of several
    doubles (lanes.h) if the argument `wide` of `operation` is true, else a double."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._turned: dict[str, str] = {}

    def operation(self, kind: int, values: Sequence[str], wide: bool) -> str:
        """Append the C of a constant: operation `kind` (`ca.OP_…`) on names or numbers `values`; returns its name."""
        own = "lanes_" if wide else "own_"
        if kind in (ca.OP_SIN, ca.OP_COS):
            (angle,) = values
            if angle not in self._turned:
                self._turned[angle] = f"both{len(self.lines)}"
                self.lines.append(f"const {own}pair_t {self._turned[angle]} = {own}both({angle});")
            part = (".sin", ".cos") if wide else ("[0]", "[1]")
            text = self._turned[angle] + part[kind == ca.OP_COS]
        else:
            text = _OPERATIONS[kind].format(*values, own=own, all=", ".join(values))
        name = f"t{len(self.lines)}"
        self.lines.append(f"const {'lanes_t' if wide else 'double'} {name} = {text};")
        return name


def lanes_header(lanes: int = 4) -> str:
    """Write the C definitions that a text of `lanes_text` (4 lanes) or `pairs_text` (2) needs before it, after
    `codegen.source_text`."""
    return f"#define LANES {lanes}\n{Path(__file__).with_name('lanes.h').read_text(encoding='utf-8')}{ELEMENTARY}"


def lanes_text(function: ca.Function, common: Sequence[str] = ()) -> str:
    """Write C that evaluates a function for several sets of arguments at once, one set per lane of a register. The
    inputs `common` have one value for all sets; what depends on these alone is computed once. Returns a C function
    `static void NAME_lanes(...)` of a function called NAME. Its arguments are the inputs, then the outputs, as arrays
    of their nonzeros in CasADi's order: of double for common inputs, else of lanes_t with one double per set."""
    inputs, outputs = function.name_in(), function.name_out()
    kinds = ["double" if name in common else "lanes_t" for name in inputs]
    signature = [f"const {kind} *in_{name}" for kind, name in zip(kinds, inputs, strict=True)]
    signature += [f"lanes_t *out_{name}" for name in outputs]
    nodes, results = graph(function)
    body, constants = Statements(), list[tuple[str, bool]]()

    def widened(value: str, is_wide: bool) -> str:
        return value if is_wide else f"lanes_all({value})"

    for kind, *of in nodes:
        if kind == ca.OP_CONST:
            operands = [(repr(of[0]), False)]
        elif kind == ca.OP_INPUT:
            operands = [(f"in_{inputs[of[0]]}[{of[1]}]", kinds[of[0]] == "lanes_t")]
        else:
            operands = [constants[operand] for operand in of]
        wide = any(is_wide for _, is_wide in operands)
        values = [widened(*one) if wide else one[0] for one in operands]
        constants.append((body.operation(kind, values, wide), wide))
    for to, entry, node in results:
        body.lines.append(f"out_{outputs[to]}[{entry}] = {widened(*constants[node])};")
    text = "\n  ".join(body.lines)
    return f"static void {function.name()}_lanes({', '.join(signature)}) {{\n  {text}\n}}\n"


_PIECE = 1000
"""Number of statements at which a C function is split, since the time of compilers grows faster than the length."""
_NAME, _DEFINED = re.compile(r"\b(?:t|both)\d+\b"), re.compile(r"const (\w+) (\w+) = ")
_COMMUTING = (ca.OP_ADD, ca.OP_MUL)
_LEAVES = (ca.OP_INPUT, ca.OP_CONST)


def pairs_text(function: ca.Function, mirrored: Mapping[str, Sequence[int]]) -> str:
    """Write C of a CasADi function in which an operation and its mirror image share one vector register. The C function
    has the signature of the one that CasADi generates, and its results have the same bits. `mirrored` maps the name of
    an input to a list of int: for each entry the index of its mirror image, such as the same quantity at the other
    running gear, or its own index. Other inputs have no mirror images."""
    nodes, outputs = graph(function)
    twins = _twins(nodes, [mirrored.get(name) for name in function.name_in()])
    body, values = Statements(), dict[int, str]()
    registers: dict[str, str] = {}  # number in the first lane -> its register
    for node, (kind, *of) in enumerate(nodes):
        if node in values:
            continue
        twin, of_twin = twins[node]
        wide = twin != node and twin not in values and values.keys() >= {*of_twin}
        if kind in _LEAVES:
            pairs = [(_leaf(nodes[node]), _leaf(nodes[twin]))]
        else:
            pairs = [(values[one], values[other]) for one, other in zip(of, of_twin if wide else of, strict=True)]
        operands = [_lanes(*pair, registers) if wide else pair[0] for pair in pairs]
        name = body.operation(kind, operands, wide)
        values[node] = f"{name}[0]" if wide else name
        if wide:
            values[twin], registers[values[node]] = f"{name}[1]", name
    results = [f"if (res[{to}]) res[{to}][{entry}] = {values[node]};" for to, entry, node in outputs]
    return _in_pieces(function.name(), [*body.lines, *results])


def _leaf(node: tuple) -> str:
    """Write the C of a node that is an input or a constant."""
    kind, *of = node
    return f"arg[{of[0]}][{of[1]}]" if kind == ca.OP_INPUT else repr(of[0])


def graph(function: ca.Function) -> tuple[list[tuple], list[tuple]]:
    """List the operations of a CasADi function (SX) in the order of evaluation, equal ones once: two lists of tuples.
    The first list has a node for each operation: its kind `ca.OP_…`, then the indices of its operands in this list; for
    `ca.OP_INPUT` the indices of input and entry, for `ca.OP_CONST` the value. The second list has the indices of
    output, entry and node for each entry of an output."""
    nodes: list[tuple] = []
    index: dict[tuple, int] = {}
    slots: dict[int, int] = {}
    outputs: list[tuple] = []
    for i in range(function.n_instructions()):
        kind, to, of = function.instruction_id(i), function.instruction_output(i), function.instruction_input(i)
        if kind == ca.OP_OUTPUT:
            outputs.append((*to, slots[of[0]]))
            continue
        operands = [function.instruction_constant(i)] if kind == ca.OP_CONST else of
        node = (kind, *(operands if kind in _LEAVES else (slots[slot] for slot in of)))
        if node not in index:
            index[node] = len(nodes)
            nodes.append(node)
        slots[to[0]] = index[node]
    return nodes, outputs


def _twins(nodes: list[tuple], partners: list[Sequence[int] | None]) -> list[tuple[int, tuple[int, ...]]]:
    """Find the twin of each node, itself if it has none, with its operands in the order of those of the node."""
    index = {node: i for i, node in enumerate(nodes)}
    for i, (kind, *of) in enumerate(nodes):
        if kind in _COMMUTING:
            index.setdefault((kind, *of[::-1]), i)
    found: list[tuple[int, tuple[int, ...]]] = []

    def others(operand: int) -> list[int]:
        kind, *of = nodes[operand]
        opposite = [index[kind, -of[0]]] if kind == ca.OP_CONST and (kind, -of[0]) in index else []
        return [*opposite, found[operand][0]]

    for i, (kind, *of) in enumerate(nodes):
        if kind in _LEAVES:
            partner = partners[of[0]] if kind == ca.OP_INPUT else None
            found.append((index.get((kind, of[0], partner[of[1]]), i) if partner else i, ()))
        else:
            mirrored = [(kind, *operands) for operands in product(*map(others, of))]
            known = [node for node in mirrored if node in index]
            found.append((index[known[0]], known[0][1:]) if known else (i, tuple(of)))
    return found


def _lanes(one: str, other: str, registers: Mapping[str, str]) -> str:
    """Write the C of two lanes with these numbers: the register that has them, or a new one."""
    if one in registers and other == f"{registers[one]}[1]":
        return registers[one]
    return f"lanes_all({one})" if one == other else f"lanes_of({one}, {other})"


def _in_pieces(name: str, lines: list[str]) -> str:
    """Write a C function like those that CasADi generates, which calls one function for each `_PIECE` statements. These
    pass constants on in a struct `*m`. An element of it is used again once no later piece needs its constant."""
    pieces = [lines[k : k + _PIECE] for k in range(0, len(lines), _PIECE)]
    last = {constant: k for k, piece in enumerate(pieces) for line in piece for constant in _NAME.findall(line)}
    passed: dict[str, str] = {}  # constant -> its element
    free: dict[str, list[str]] = defaultdict(list)
    sizes: Counter[str] = Counter()
    text, calls = "", ""
    for k, piece in enumerate(pieces):
        text += f"static __attribute__((noinline)) void {name}_{k}(const double **arg, double **res, {name}_t *m) {{\n"
        for line in piece:
            text += f"  {_NAME.sub(lambda constant: passed.get(constant[0], constant[0]), line)}\n"
            kind, constant = _DEFINED.findall(line)[0] if line.startswith("const ") else ("", "")
            if last.get(constant, k) > k:
                sizes[kind] += not free[kind]
                passed[constant] = free[kind].pop() if free[kind] else f"m->of_{kind}[{sizes[kind] - 1}]"
                text += f"  {passed[constant]} = {constant};\n"
        for constant in [constant for constant in passed if last[constant] == k]:
            element = passed.pop(constant)
            free[element[len("m->of_") : element.index("[")]].append(element)
        text += "}\n"
        calls += f"  {name}_{k}(arg, res, &m);\n"
    members = " ".join(f"{kind} of_{kind}[{size}];" for kind, size in sizes.items())
    signature = f"int {name}(const double **arg, double **res, casadi_int *iw, double *w, int memory)"
    return f"typedef struct {{ {members} }} {name}_t;\n{text}{signature} {{\n  {name}_t m;\n{calls}  return 0;\n}}\n"
