"""Rodas3 with an unrolled sparse LU: one linearly implicit step as a single CasADi expression.

The wheel-spin creep lag shrinks with speed (0.2 ms at 40 km/h, towards zero at standstill), so explicit steps of 1 ms
fail; this L-stable method of order 3 takes one Jacobian and one factorisation per step at every speed. Source: Sandu et
al., Atmospheric Environment 31 (1997) 3459 (Rodas3); scaled as in Hairer and Wanner, Solving ODEs II.
"""

from __future__ import annotations

import casadi as ca
import numpy as np


class Stages:
    """Symbols that stand for intermediate results of a large expression, so that Jacobians follow the chain rule.
    Differentiating a force law by its few arguments is much cheaper than by all states."""

    def __init__(self) -> None:
        self._symbols: list[ca.SX] = []
        self._definitions: list[ca.SX] = []

    def hold(self, *expressions: ca.SX) -> list[ca.SX]:
        """Replace expressions by new symbols of the same shapes, return these, and remember what each stands for. The
        expressions may contain the state and symbols from earlier calls."""
        definition = ca.vertcat(*(ca.vec(expression) for expression in expressions))
        symbols = ca.SX.sym(f"stage{len(self._symbols)}", definition.numel())
        self._symbols.append(symbols)
        self._definitions.append(definition)
        limits = np.cumsum([0, *(expression.numel() for expression in expressions)])
        parts = ca.vertsplit(symbols, limits.tolist())
        return [ca.reshape(part, *expression.shape) for part, expression in zip(parts, expressions, strict=True)]

    def resolve(self, expression: ca.SX) -> ca.SX:
        """Expression in which each symbol that `hold` returned is replaced by the expression that it stands for."""
        for symbols, definition in zip(reversed(self._symbols), reversed(self._definitions), strict=True):
            expression = ca.substitute(expression, symbols, definition)
        return expression

    def jacobian(self, expression: ca.SX, x: ca.SX) -> ca.SX:
        """Total derivative of an expression (n, 1) by the symbols x (m, 1), shape (n, m), after `resolve`."""
        totals: list[ca.SX] = []
        for k, definition in enumerate((*self._definitions, expression)):
            total = ca.jacobian(definition, x)
            for symbols, inner in zip(self._symbols[:k], totals, strict=False):
                total += ca.jacobian(definition, symbols) @ inner
            totals.append(total)
        return self.resolve(totals[-1])


def rodas3(f: ca.SX, jacobian: ca.SX, x: ca.SX, h: ca.SX) -> ca.SX:
    """State after one Rodas3 step of x' = f(x), shape (n, 1); the local error is O(h^4).

    Args:
        f (SX, shape (n, 1)): Right-hand side, an expression in `x`.
        jacobian (SX, shape (n, n)): df/dx, an expression in `x`.
        x (SX, shape (n, 1)): State, symbols only.
        h (SX or float): Step (s).
    """
    solve = factorise(2 / h * ca.SX.eye(x.numel()) - jacobian)
    k1 = solve(f)
    k2 = solve(f + 4 / h * k1)
    k3 = solve(ca.substitute(f, x, x + 2 * k1) + (k1 - k2) / h)
    k4 = solve(ca.substitute(f, x, x + 2 * k1 + k3) + (k1 - k2 - 8 / 3 * k3) / h)
    return x + 2 * k1 + k3 + k4


def factorise(matrix: ca.SX):
    """Factorise a sparse matrix A (n, n) as an expression, and return a function that solves A x = b for b (n, 1).

    LU without pivoting: A has to be 2/h I - J with a small h, so that its blocks are diagonally dominant. Source:
    Markowitz 1957 (order of the pivots).
    """
    n = matrix.shape[0]
    rows: list[dict] = [{} for _ in range(n)]
    for column in range(n):
        for entry in range(matrix.colind(column), matrix.colind(column + 1)):
            rows[matrix.row(entry)][column] = matrix.nz[entry]
    order, remaining, coupled = [], set(range(n)), [len(row) for row in rows]
    lower, inverse = {}, {}
    while remaining:
        pivot = min(remaining, key=lambda i: (_fill_in(rows, remaining, i), coupled[i], i))
        remaining.remove(pivot)
        order.append(pivot)
        inverse[pivot] = 1 / rows[pivot][pivot]
        for i in sorted(remaining):
            if pivot not in rows[i]:
                continue
            factor = rows[i].pop(pivot) * inverse[pivot]
            lower[i, pivot] = factor
            for column, value in rows[pivot].items():
                if column != pivot:
                    rows[i][column] = rows[i].get(column, 0) - factor * value

    def solve(right_hand_side: ca.SX) -> ca.SX:
        b = ca.vertsplit(right_hand_side)
        for position, pivot in enumerate(order):
            for i in order[position + 1 :]:
                if (i, pivot) in lower:
                    b[i] = b[i] - lower[i, pivot] * b[pivot]
        for pivot in reversed(order):
            total = b[pivot]
            for column, value in rows[pivot].items():
                if column != pivot:
                    total = total - value * b[column]
            b[pivot] = total * inverse[pivot]
        return ca.vertcat(*b)

    return solve


def _fill_in(rows: list[dict], remaining: set[int], i: int) -> int:
    """Markowitz count of pivot i among the remaining rows."""
    in_row = sum(1 for column in rows[i] if column != i)
    in_column = sum(1 for j in remaining if j != i and i in rows[j])
    return in_row * in_column
