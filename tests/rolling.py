"""Steady rolling of equal half spaces with Hertz's pressure: an independent judge of the creep law.

Kalker's exact theory with constant traction on cells: the slip of a particle between two neighbouring cells is what the
creepages give less the change of its elastic displacement; where the traction would exceed its bound it slides against
its slip. Solved by a semi-smooth Newton method.

Source: Kalker 1990, Three-Dimensional Elastic Bodies in Rolling Contact, ch. 4; influence of a cell: Love 1929, Cerruti.
"""

from functools import lru_cache

import numpy as np


@lru_cache(maxsize=4)
def _grid(a, b, shear, poisson, count):
    """Cells of the ellipse (centres, relative pressure, sides) and slip over traction (1/Pa), the x parts first."""
    sides = 2 * a / count, 2 * b / count
    places = [(np.arange(count) + 0.5) * side - half for side, half in zip(sides, (a, b), strict=True)]
    x, y = (grid.ravel() for grid in np.meshgrid(*places, indexing="ij"))
    share = 1 - (x / a) ** 2 - (y / b) ** 2
    x, y, pressure = x[share > 0], y[share > 0], np.sqrt(share[share > 0])

    def displacement(dx):
        parts = [0.0, 0.0, 0.0]
        for sign_x in (1, -1):
            for sign_y in (1, -1):
                u, v = dx + sign_x * sides[0] / 2, y[:, None] - y + sign_y * sides[1] / 2
                along, across = v * np.arcsinh(u / np.abs(v)), u * np.arcsinh(v / np.abs(u))
                normal = (1 - poisson) * (along + across)
                corner = normal + poisson * along, normal + poisson * across, -poisson * np.hypot(u, v)
                parts = [part + sign_x * sign_y * c for part, c in zip(parts, corner, strict=True)]
        return np.array(parts) / (np.pi * shear)

    distance = x[:, None] - x
    xx, yy, xy = (displacement(distance) - displacement(distance + sides[0])) / sides[0]
    return x, y, pressure, sides, np.block([[xx, xy], [xy, yy]])


def rolling(creepage, load, a, b, friction, shear=8.2e10, poisson=0.28, count=20):
    """Force F_x, F_y (N) and moment (N m) on a wheel under longitudinal, lateral (-) and spin creepage (1/m)."""
    x, y, pressure, sides, slip = _grid(a, b, shear, poisson, count)
    n, area = len(x), sides[0] * sides[1]
    bound = friction * load * pressure / (pressure.sum() * area)
    rigid = np.concatenate([creepage[0] - creepage[2] * y, creepage[1] + creepage[2] * (x + 0.1 * sides[0])])
    scale = 1 / np.diag(slip)

    def project(traction):
        """Error of the traction, and the derivative of its projection on the bound."""
        free = traction - scale * (slip @ traction + rigid)
        size = np.maximum(np.hypot(free[:n], free[n:]), 1e-300)
        keep, unit = np.minimum(1.0, bound / size), free.reshape(2, n) / size
        turn = np.where(size > bound, keep, 0.0)
        parts = keep - turn * unit[0] ** 2, keep - turn * unit[1] ** 2, -turn * unit[0] * unit[1]
        return traction - np.tile(keep, 2) * free, parts

    traction = np.linalg.solve(slip, -rigid)
    traction *= np.tile(np.minimum(1.0, bound / np.hypot(traction[:n], traction[n:])), 2)
    error, (xx, yy, xy) = project(traction)
    for _ in range(60):
        if np.abs(error).sum() < 1e-7 * bound.sum():
            moment = x @ traction[n:] - y @ traction[:n]
            return area * np.array([traction[:n].sum(), traction[n:].sum(), moment])
        free = np.eye(2 * n) - scale[:, None] * slip
        along, across = xx[:, None] * free[:n] + xy[:, None] * free[n:], xy[:, None] * free[:n] + yy[:, None] * free[n:]
        step = np.linalg.solve(np.eye(2 * n) - np.vstack([along, across]), -error)
        trials = [(*project(traction + share * step), share) for share in (1.0, 0.5, 0.25, 0.1)]
        error, (xx, yy, xy), share = min(trials, key=lambda trial: np.abs(trial[0]).sum())
        traction = traction + share * step
    raise ArithmeticError("the tractions have not settled")
