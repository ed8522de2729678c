"""Steady rolling of equal half spaces under a given pressure: an independent judge of creep law and contact table.

Kalker's exact theory with constant traction on cells: the slip of a particle between two neighbouring cells is what the
creepages give less the change of its elastic displacement; where the traction would exceed its bound it slides against
its slip. Solved by a semi-smooth Newton method.

Source: Kalker 1990, Three-Dimensional Elastic Bodies in Rolling Contact, ch. 4; influence of a cell: Love 1929.
"""

from functools import lru_cache

import numpy as np

SHEAR, POISSON = 8.2e10, 0.28  # steel


class Rolling:
    """Cells of a contact (centres, sides) and the slip that tractions on them make, parts along the rail first."""

    def __init__(self, x, y, sides):
        self.x, self.y, self.sides = x, y, sides

        def displacement(dx):
            parts = [0.0, 0.0, 0.0]
            for sign_x in (1, -1):
                for sign_y in (1, -1):
                    u, v = dx + sign_x * sides[0] / 2, y[:, None] - y + sign_y * sides[1] / 2
                    along, across = v * np.arcsinh(u / np.abs(v)), u * np.arcsinh(v / np.abs(u))
                    normal = (1 - POISSON) * (along + across)
                    corner = normal + POISSON * along, normal + POISSON * across, -POISSON * np.hypot(u, v)
                    parts = [part + sign_x * sign_y * c for part, c in zip(parts, corner, strict=True)]
            return np.array(parts) / (np.pi * SHEAR)

        distance = x[:, None] - x
        xx, yy, xy = (displacement(distance) - displacement(distance + sides[0])) / sides[0]
        self.slip = np.block([[xx, xy], [xy, yy]])

    def load(self, bound, longitudinal, lateral, spin):
        """Force F_x, F_y (N) and moment (N m) by the largest traction (Pa) and the creepages of the cells."""
        n, scale = len(self.x), 1 / np.diag(self.slip)
        # A particle slips between two cells: a tenth of a cell ahead makes force and moment reciprocal.
        rigid = np.concatenate([longitudinal + 0 * self.x, lateral + spin * (self.x + 0.1 * self.sides[0])])

        def project(traction):
            """Error of the traction, and the derivative of its projection on the bound."""
            free = traction - scale * (self.slip @ traction + rigid)
            size = np.maximum(np.hypot(free[:n], free[n:]), 1e-300)
            keep, unit = np.minimum(1.0, bound / size), free.reshape(2, n) / size
            turn = np.where(size > bound, keep, 0.0)
            parts = keep - turn * unit[0] ** 2, keep - turn * unit[1] ** 2, -turn * unit[0] * unit[1]
            return traction - np.tile(keep, 2) * free, parts

        traction = np.linalg.solve(self.slip, -rigid)
        traction *= np.tile(np.minimum(1.0, bound / np.hypot(traction[:n], traction[n:])), 2)
        error, (xx, yy, xy) = project(traction)
        for _ in range(60):
            if np.abs(error).sum() < 1e-7 * bound.sum():
                moment = self.x @ traction[n:] - self.y @ traction[:n]
                return np.prod(self.sides) * np.array([traction[:n].sum(), traction[n:].sum(), moment])
            free = np.eye(2 * n) - scale[:, None] * self.slip
            along = xx[:, None] * free[:n] + xy[:, None] * free[n:]
            across = xy[:, None] * free[:n] + yy[:, None] * free[n:]
            step = np.linalg.solve(np.eye(2 * n) - np.vstack([along, across]), -error)
            trials = [(*project(traction + share * step), share) for share in (1.0, 0.5, 0.25, 0.1)]
            error, (xx, yy, xy), share = min(trials, key=lambda trial: np.abs(trial[0]).sum())
            traction = traction + share * step
        raise ArithmeticError("the tractions have not settled")


@lru_cache(maxsize=4)
def _ellipse(a, b, count):
    """Cells of an ellipse and Hertz's pressure on them over its mean."""
    sides = 2 * a / count, 2 * b / count
    places = [(np.arange(count) + 0.5) * side - half for side, half in zip(sides, (a, b), strict=True)]
    x, y = (grid.ravel() for grid in np.meshgrid(*places, indexing="ij"))
    share = 1 - (x / a) ** 2 - (y / b) ** 2
    return Rolling(x[share > 0], y[share > 0], sides), np.sqrt(share[share > 0])


def rolling(creepage, load, a, b, friction, count=20):
    """Force F_x, F_y (N) and moment (N m) on a wheel under longitudinal, lateral (-) and spin creepage (1/m)."""
    cells, pressure = _ellipse(a, b, count)
    bound = friction * load * pressure / (pressure.sum() * np.prod(cells.sides))
    return cells.load(bound, creepage[0] - creepage[2] * cells.y, *creepage[1:])
