"""Fewer divisions: a denominator that divides several numerators is inverted once and multiplied.

Derivatives and factorisations divide row after row by the same number, and CasADi writes each x (1/y) as x/y. A
division costs about as much as five multiplications.
"""

from __future__ import annotations

from collections import Counter

import casadi as ca


def share_reciprocals(function: ca.Function) -> ca.Function:
    """Rewrite a function of scalar operations (SX) with one reciprocal for each denominator that occurs more than once.

    Name, inputs and outputs stay; values are equal up to rounding.
    """
    arguments = [ca.SX.sym(name, function.sparsity_in(i)) for i, name in enumerate(function.name_in())]
    results = [ca.SX.zeros(function.sparsity_out(i)) for i in range(function.n_out())]
    instructions = [
        (function.instruction_id(k), function.instruction_output(k), function.instruction_input(k))
        for k in range(function.n_instructions())
    ]
    dividing = _denominators(instructions)
    uses = Counter(dividing.values())
    reciprocals: dict[int, ca.SX] = {}
    slots: dict[int, ca.SX] = {}
    ca.GlobalOptions.setSimplificationOnTheFly(False)  # it turns x (1/y) into x/y
    try:
        for k, (kind, to, of) in enumerate(instructions):
            if kind == ca.OP_OUTPUT:
                results[to[0]].nz[to[1]] = slots[of[0]]
            elif kind == ca.OP_INPUT:
                slots[to[0]] = arguments[of[0]].nz[of[1]]
            elif kind == ca.OP_CONST:
                slots[to[0]] = ca.SX(function.instruction_constant(k))
            elif k in dividing and uses[dividing[k]] > 1:
                inverse = reciprocals.setdefault(dividing[k], 1 / slots[of[-1]])
                slots[to[0]] = inverse if kind == ca.OP_INV else slots[of[0]] * inverse
            else:
                apply = ca.SX.unary if len(of) == 1 else ca.SX.binary
                slots[to[0]] = apply(kind, *(slots[slot] for slot in of))
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(True)
    return ca.Function(function.name(), arguments, results, function.name_in(), function.name_out())


def _denominators(instructions: list[tuple[int, list[int], list[int]]]) -> dict[int, int]:
    """Instructions (kind, output, inputs) that divide, each with the instruction that made its denominator."""
    dividing: dict[int, int] = {}
    made: dict[int, int] = {}
    for k, (kind, to, of) in enumerate(instructions):
        if kind in (ca.OP_DIV, ca.OP_INV):
            dividing[k] = made[of[-1]]
        if kind != ca.OP_OUTPUT:
            made[to[0]] = k
    return dividing
