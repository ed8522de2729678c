"""Fewer divisions: a denominator that divides several numerators is inverted once. A division costs about as much as
five multiplications."""

from collections import Counter

import casadi as ca

from railrepro.compile.lanes import graph


def share_reciprocals(function: ca.Function) -> ca.Function:
    """Replace the divisions x/y of a CasADi function (SX) by x (1/y) where y divides several times. The function that
    is returned has the same name, inputs and outputs, and equal values up to rounding."""
    nodes, outputs = graph(function)
    divided = Counter(of[-1] for kind, *of in nodes if kind in (ca.OP_DIV, ca.OP_INV))
    arguments = [ca.SX.sym(name, function.sparsity_in(i)) for i, name in enumerate(function.name_in())]
    results = [ca.SX.zeros(function.sparsity_out(i)) for i in range(function.n_out())]
    reciprocals: dict[int, ca.SX] = {}
    values: list[ca.SX] = []
    ca.GlobalOptions.setSimplificationOnTheFly(False)  # it would turn x (1/y) into x/y
    try:
        for kind, *of in nodes:
            if kind == ca.OP_INPUT:
                values.append(arguments[of[0]].nz[of[1]])
            elif kind == ca.OP_CONST:
                values.append(ca.SX(of[0]))
            elif kind in (ca.OP_DIV, ca.OP_INV) and divided[of[-1]] > 1:
                inverse = reciprocals.setdefault(of[-1], 1 / values[of[-1]])
                values.append(inverse if kind == ca.OP_INV else values[of[0]] * inverse)
            else:
                apply = ca.SX.unary if len(of) == 1 else ca.SX.binary
                values.append(apply(kind, *(values[operand] for operand in of)))
        for output, entry, node in outputs:
            results[output].nz[entry] = values[node]
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(True)
    return ca.Function(function.name(), arguments, results, function.name_in(), function.name_out())
