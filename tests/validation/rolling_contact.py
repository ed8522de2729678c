"""Rolling contact of half spaces on squares: the area of contact, and the creep forces of the patch.

Of `railrepro.contact` only the profiles are used. Instead of an ellipse with Kalker's coefficients, the tractions of
every square are solved from the condition that nothing slides, so that the whole shape of the patch enters the forces.
With friction (`Rolling.load`) this judges the creep law of the project. As a script it writes s1002_contact.csv (4
minutes), which judges the contact table of the project and is read by the second car. Source: Kalker 1990,
Three-Dimensional Elastic Bodies in Rolling Contact, chs. 3 and 4 (linear theory, half spaces); Johnson 1985, Contact
Mechanics, section 3.6 (displacement under tangential load)."""

from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline, make_smoothing_spline
from tqdm import tqdm

from railrepro.contact import profiles
from railrepro.vehicle.parameters import Vehicle, load_vehicle

SHEAR, POISSON = 8.2e10, 0.28  # steel
SQUARE = 0.5e-3  # side of the squares (m)
_SMOOTHING = 0.03  # weight of the squared second derivative when columns of the table are smoothed (1/mm^2)
_REACH = 1.3e-4  # distance of the undeformed bodies up to which they may touch (m)


def _integrals(x, y, sides) -> np.ndarray:
    """Integrals of y^2/r^3, x^2/r^3, x y/r^3 over a rectangle about x, y; the first two sum to that of 1/r."""
    found = np.zeros((3, *np.shape(x)))
    for ends in product((-1, 1), repeat=2):
        u, v = x + ends[0] * sides[0] / 2, y + ends[1] * sides[1] / 2
        corner = u * np.arcsinh(v / np.abs(u)), v * np.arcsinh(u / np.abs(v)), -np.hypot(u, v)
        found += ends[0] * ends[1] * np.array(corner)
    return found


def pressure(gap: np.ndarray, x: np.ndarray, y: np.ndarray, load: float, modulus: float):
    """Compute the pressure (Pa) on squares with some gap (m): positive where they touch."""
    touch = gap < np.partition(gap, len(gap) // 3)[len(gap) // 3]
    across, along, _ = _integrals(x[:, None] - x, y[:, None] - y, (SQUARE, SQUARE))
    influence = (across + along) / (np.pi * modulus)
    for _ in range(40):
        inside = np.flatnonzero(touch)
        right = np.stack([inside * 0 + 1, gap[inside]], 1)
        of_one, of_gap = np.linalg.solve(influence[np.ix_(inside, inside)], right).T
        approach = (load / SQUARE**2 + of_gap.sum()) / of_one.sum()
        found = np.zeros_like(gap)
        found[inside] = approach * of_one - of_gap
        again = (found > 0) | (~touch & (gap + influence @ found < approach))
        if (again == touch).all():
            return found
        touch = again
    raise ArithmeticError("the patch was not found in 40 turns")


class Rolling:
    """Cells of a contact (centres, sides) and the slip under tractions on them, components along the rail first. A
    particle in a cell was one cell ahead before, and slid by the change of its displacement."""

    def __init__(self, x, y, sides, shear=SHEAR, poisson=POISSON):
        self.x, self.y, self.sides = x, y, sides

        def displacement(ahead):
            """Displacement under unit tractions, at positions ahead of the cells."""
            across, along, mixed = _integrals(x[:, None] + ahead - x, y[:, None] - y, sides)
            one, other = (1 - poisson) * across + along, across + (1 - poisson) * along
            return np.block([[one, poisson * mixed], [poisson * mixed, other]]) / (np.pi * shear)

        self.slip = (displacement(0.0) - displacement(sides[0])) / sides[0]

    def load(self, bound, longitudinal, lateral, spin):
        """Compute force F_x, F_y (N) and moment (N m) from the largest traction (Pa) and the creepages of the cells."""
        n, scale = len(self.x), 1 / np.diag(self.slip)
        # A particle slips between two cells: a tenth of a cell ahead makes force and moment reciprocal.
        rigid = np.concatenate([longitudinal + 0 * self.x, lateral + spin * (self.x + 0.1 * self.sides[0])])

        traction, free = np.zeros(2 * n), np.eye(2 * n) - scale[:, None] * self.slip
        for _ in range(60):
            wanted = free @ traction - scale * rigid
            size = np.maximum(np.hypot(wanted[:n], wanted[n:]), 1e-300)
            keep, unit = np.minimum(1.0, bound / size), wanted.reshape(2, n) / size
            error = traction - np.tile(keep, 2) * wanted
            if np.abs(error).sum() < 1e-7 * bound.sum():
                moment = self.x @ traction[n:] - self.y @ traction[:n]
                return np.prod(self.sides) * np.array([traction[:n].sum(), traction[n:].sum(), moment])
            turn = np.where(size > bound, keep, 0.0)  # derivative of the projection on the bound
            xx, yy, xy = keep - turn * unit[0] ** 2, keep - turn * unit[1] ** 2, -turn * unit[0] * unit[1]
            along = xx[:, None] * free[:n] + xy[:, None] * free[n:]
            across = xy[:, None] * free[:n] + yy[:, None] * free[n:]
            traction -= np.linalg.solve(np.eye(2 * n) - np.vstack([along, across]), error)
        raise ArithmeticError("the tractions have not settled")


def sticking(x: np.ndarray, y: np.ndarray, slip: np.ndarray, poisson: float) -> np.ndarray:
    """Compute forces along and across (m^2) and moment (m^3) over the shear modulus, shape (m, 3), of a patch of n
    squares x, y (m) without sliding. `slip` is the rigid slip along and across over the speed, shape (m, 2, n)."""
    cells = Rolling(x, y, (SQUARE, SQUARE), 1.0, poisson)
    tractions = np.linalg.solve(cells.slip, -slip.reshape(len(slip), -1).T).T.reshape(slip.shape)
    forces = tractions.sum(axis=2)
    moments = (x * tractions[:, 1] - y * tractions[:, 0]).sum(axis=1)
    return np.column_stack([forces, moments]) * SQUARE**2


@lru_cache(maxsize=4)
def _ellipse(a, b):
    """Cells of an ellipse, and Hertz's pressure on them up to a factor."""
    count = 20
    sides = 2 * a / count, 2 * b / count
    places = [(np.arange(count) + 0.5) * side - half for side, half in zip(sides, (a, b), strict=True)]
    x, y = (grid.ravel() for grid in np.meshgrid(*places, indexing="ij"))
    share = 1 - (x / a) ** 2 - (y / b) ** 2
    return Rolling(x[share > 0], y[share > 0], sides), np.sqrt(share[share > 0])


def rolling(creepage, load, a, b, friction):
    """Compute force F_x, F_y (N) and moment (N m) on a wheel under longitudinal, lateral (-), spin creepage (1/m)."""
    cells, pressure = _ellipse(a, b)
    bound = friction * load * pressure / (pressure.sum() * np.prod(cells.sides))
    return cells.load(bound, creepage[0] - creepage[2] * cells.y, *creepage[1:])


class Patch(NamedTuple):
    """Contact of a wheel at some shift; forces and moments are over the shear modulus."""

    slope: float  # of the resultant (-)
    rolling: float  # radius (m)
    along: float  # force by longitudinal creepage (m^2)
    across: float  # force by lateral creepage (m^2)
    spin: float  # force by spin, moment by lateral creepage (m^3)
    turn: float  # moment by spin (m^4)


TABLE = Path(__file__).with_name("s1002_contact.csv")


def patch(shift: float, vehicle: Vehicle) -> Patch:
    """Solve the contact of S1002 on 60E1 at nominal load, the wheel shifted towards its flange (m)."""
    data, radius = vehicle.contact, vehicle.wheel.radius
    position, depth = profiles.inclined_rail()
    height, rise = profiles.s1002(position - profiles.TAPE_CIRCLE - shift)
    overlap = height - depth
    near = position[overlap > overlap.max() - _REACH]
    first = int(np.argmax(overlap))
    angle, middle = -np.arctan(rise[first]), position[first]
    for _ in range(3):
        half = np.sqrt(2 * radius * _REACH)
        rows = (np.arange(np.ceil(2 * half / SQUARE)) + 0.5) * SQUARE - half
        columns = np.arange((near[0] - middle) / np.cos(angle), (near[-1] - middle) / np.cos(angle), SQUARE)
        x, y = (each.ravel() for each in np.meshgrid(rows, columns, indexing="ij"))
        at = middle + y * np.cos(angle)
        gap = np.cos(angle) * (overlap.max() - np.interp(at, position, overlap)) + x**2 * np.cos(angle) / (2 * radius)
        close = gap < _REACH
        x, y, at, gap = x[close], y[close], at[close], gap[close]
        found = pressure(gap, x, y, data.nominal_load, data.young / (2 * (1 - data.poisson**2)))
        slope = -np.interp(at, position, rise) @ found / found.sum()
        angle = np.arctan(slope)
    held = found > 0
    centre = (at @ found) / found.sum()
    x, y, at = x[held], (at[held] - centre) / np.cos(angle), at[held]
    radii = radius + np.interp(at, position, height)
    mean, local = radii.mean(), np.sin(np.arctan(np.interp(at, position, rise)))
    nothing, one = np.zeros_like(x), np.ones_like(x)
    turned = np.stack([1 - radii / mean, x * local / mean])  # by spin: from radii along, slope across the patch
    forces = -sticking(x, y, np.array([[one, nothing], [nothing, one], turned]), data.poisson)
    spin = -np.sin(angle) / mean
    rolling = mean * (1 - forces[2, 0] / forces[0, 0])
    return Patch(slope, rolling, forces[0, 0], forces[1, 1], forces[2, 1] / spin, forces[2, 2] / spin)


def splines(frame: pd.DataFrame) -> CubicSpline:
    """Effective radius less the nominal one (m), and `Patch` but the slope, over the position of the rail on the wheel,
    from the tape circle outwards (m). Smoothing removes a percent of unevenness from the squares. The effective radius
    is the integral of the slope, so that the normal force adds no energy."""
    place, columns = -frame["shift_m"].to_numpy()[::-1], frame[[*Patch._fields]].to_numpy()[::-1].T
    slope, *others = (make_smoothing_spline(1e3 * place, each, lam=_SMOOTHING)(1e3 * place) for each in columns)
    radius = CubicSpline(place, -slope).antiderivative()
    return CubicSpline(place, np.column_stack([radius(place) - radius(0.0), *others]))


if __name__ == "__main__":
    shifts, car = np.arange(-24, 25) * 0.25e-3, load_vehicle()
    rows = [{"shift_m": shift} | patch(float(shift), car)._asdict() for shift in tqdm(shifts)]
    pd.DataFrame(rows).to_csv(TABLE, index=False, float_format="%.6g")
