"""One step of the integrator Rodas3 as a CasADi expression, with its Jacobian and a sparse LU factorisation. The time
constant of the spin of a wheel against creep falls with speed, to 0.2 ms at 40 km/h and to zero at standstill, so
explicit steps of 1 ms fail. Rodas3 is linearly implicit, L-stable and of order 3. Source: Sandu et al., Atmospheric
Environment 31 (1997) 3459 (Rodas3); scaled as in Hairer and Wanner, Solving ODEs II."""

import casadi as ca
import numpy as np


class Stages:
    """Store of intermediate expressions, such as forces, while the equations of the car are written. Symbols stand in
    their place, so that the Jacobian follows the chain rule: a force law is differentiated by its few arguments, which
    costs less than by all states. Nothing is evaluated numerically."""

    def __init__(self) -> None:
        self._held: list[tuple[ca.SX, ca.SX]] = []

    def hold(self, *expressions: ca.SX) -> list[ca.SX]:
        """Store expressions and return new symbols of the same shapes, to write later expressions with until `resolve`
        or `jacobian` puts the stored ones back. Expressions may contain the state and symbols from earlier calls."""
        definition = ca.vertcat(*map(ca.vec, expressions))
        symbols = ca.SX.sym(f"stage{len(self._held)}", definition.numel())
        self._held.append((symbols, definition))
        limits = np.cumsum([0, *(expression.numel() for expression in expressions)])
        parts = ca.vertsplit(symbols, limits.tolist())
        return [ca.reshape(part, *expression.shape) for part, expression in zip(parts, expressions, strict=True)]

    def resolve(self, expression: ca.SX) -> ca.SX:
        """Replace each symbol from `hold` in an expression by the expression that it stands for."""
        for symbols, definition in reversed(self._held):
            expression = ca.substitute(expression, symbols, definition)
        return expression

    def jacobian(self, expression: ca.SX, x: ca.SX) -> ca.SX:
        """Differentiate an expression (n, 1), which may contain symbols from `hold`, by the symbols x (m, 1): shape (n,
        m). In the result each symbol from `hold` is replaced by the expression that it stands for."""
        totals: list[ca.SX] = []
        for definition in (*(definition for _, definition in self._held), expression):
            total = ca.jacobian(definition, x)
            for (symbols, _), inner in zip(self._held, totals, strict=False):
                total += ca.jacobian(definition, symbols) @ inner
            totals.append(total)
        return self.resolve(totals[-1])


def rodas3(f: ca.SX, jacobian: ca.SX, x: ca.SX, h: ca.SX) -> ca.SX:
    """Integrate x' = f(x) over one step h: the state after it, shape (n, 1), with a local error O(h^4). The right-hand
    side f (n, 1) and its Jacobian df/dx (n, n) are expressions in the symbols x (n, 1)."""
    solve = factorise(2 / h * ca.SX.eye(x.numel()) - jacobian)
    k1 = solve(f)
    k2 = solve(f + 4 / h * k1)
    k3 = solve(ca.substitute(f, x, x + 2 * k1) + (k1 - k2) / h)
    k4 = solve(ca.substitute(f, x, x + 2 * k1 + k3) + (k1 - k2 - 8 / 3 * k3) / h)
    return x + 2 * k1 + k3 + k4


def factorise(matrix: ca.SX):
    """Factorise a sparse matrix A (n, n) of expressions; returns a function b (n, 1) -> x that solves A x = b. LU with
    pivots on the diagonal, which needs A = 2/h I - J with a small h. Source: Markowitz 1957 (order of the pivots)."""
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
        inverse[pivot] = 1 / rows[pivot].pop(pivot)
        for i in sorted(remaining):
            if pivot in rows[i]:
                lower[i, pivot] = rows[i].pop(pivot) * inverse[pivot]
                for column, value in rows[pivot].items():
                    rows[i][column] = rows[i].get(column, 0) - lower[i, pivot] * value

    def solve(right_hand_side: ca.SX) -> ca.SX:
        b = ca.vertsplit(right_hand_side)
        for position, pivot in enumerate(order):
            for i in order[position + 1 :]:
                if (i, pivot) in lower:
                    b[i] = b[i] - lower[i, pivot] * b[pivot]
        for pivot in reversed(order):
            total = b[pivot]
            for column, value in rows[pivot].items():
                total = total - value * b[column]
            b[pivot] = total * inverse[pivot]
        return ca.vertcat(*b)

    return solve


def _fill_in(rows: list[dict], remaining: set[int], i: int) -> int:
    """Count the other entries in the row of pivot i times those in its column, among the remaining rows (Markowitz)."""
    return (len(rows[i]) - 1) * (sum(i in rows[j] for j in remaining) - 1)
