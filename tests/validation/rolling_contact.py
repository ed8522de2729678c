"""Rolling contact of half spaces on squares: where two bodies touch, and the creep forces of a patch as it is.

Nothing of `railrepro.contact` but the profiles is used. Where the core makes an ellipse of the patch and takes Kalker's
coefficients from his table, here the condition that nothing slides is solved for the tractions of every square, so that
lobes, their ends and the rolling radius across the patch are in the forces. As a script this writes the table beside
it (4 minutes), which the second car reads.

Source: Kalker 1990, Three-Dimensional Elastic Bodies in Rolling Contact, chs. 3 and 4 (linear theory, half spaces);
Johnson 1985, Contact Mechanics, section 3.6 (displacement under tangential load).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline, make_smoothing_spline
from tqdm import tqdm

from railrepro.contact import profiles
from railrepro.vehicle.parameters import Vehicle, load_vehicle

SQUARE = 0.5e-3
"""Side of the squares (m)."""
_SMOOTHING = 0.03
"""Weight of the square of the second derivative (1/mm^2) when columns of the table are smoothed."""
_REACH = 1.3e-4
"""Distance of the undeformed bodies up to which they may touch (m)."""


def _integrals(x, y, side: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Integrals of y^2/r^3, x^2/r^3 and x y/r^3 over a square, seen from its centre at x, y; their first two sum to
    that of 1/r."""
    found = np.zeros((3, *np.shape(x)))
    for ends in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        u, v = x + ends[0] * side / 2, y + ends[1] * side / 2
        corner = u * np.arcsinh(v / np.abs(u)), v * np.arcsinh(u / np.abs(v)), -np.hypot(u, v)
        found += ends[0] * ends[1] * np.array(corner)
    return tuple(found)


def pressure(gap: np.ndarray, x: np.ndarray, y: np.ndarray, load: float, modulus: float):
    """Pressure on squares at some distance (m): positive where they touch (Pa), and the approach of the bodies (m)."""
    touch = gap < np.partition(gap, len(gap) // 3)[len(gap) // 3]
    across, along, _ = _integrals(x[:, None] - x, y[:, None] - y, SQUARE)
    influence = (across + along) / (np.pi * modulus)
    for _ in range(40):
        inside = np.flatnonzero(touch)
        of_one, of_gap = np.linalg.solve(
            influence[np.ix_(inside, inside)], np.stack([inside * 0 + 1, gap[inside]], 1)
        ).T
        approach = (load / SQUARE**2 + of_gap.sum()) / of_one.sum()
        found = np.zeros_like(gap)
        found[inside] = approach * of_one - of_gap
        again = (found > 0) | (~touch & (gap + influence @ found < approach))
        if (again == touch).all():
            return found, float(approach)
        touch = again
    raise ArithmeticError("the patch was not found in 40 turns")


def sticking(x: np.ndarray, y: np.ndarray, slip: np.ndarray, poisson: float) -> np.ndarray:
    """Forces along and across (m^2) and moment (m^3), over the shear modulus, of a patch on which nothing slides.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Squares of the patch (m).
    slip : ndarray, shape (m, 2, n)
        Rigid slip of the wheel along and across on each square, over the speed, in m cases.
    poisson : float

    Returns
    -------
    ndarray, shape (m, 3)
    """

    def displaced(ahead):
        """Displacement under unit tractions, at places ahead of the squares."""
        across, along, mixed = _integrals(x[:, None] + ahead - x, y[:, None] - y, SQUARE)
        one, other = (1 - poisson) * across + along, across + (1 - poisson) * along
        return np.block([[one, poisson * mixed], [poisson * mixed, other]]) / np.pi

    # what is at a square was one square ahead before, and slid meanwhile by nothing
    moved = displaced(0.0) - displaced(SQUARE)
    tractions = np.linalg.solve(moved, -SQUARE * slip.reshape(len(slip), -1).T).T.reshape(slip.shape)
    forces = tractions.sum(axis=2)
    moments = (x * tractions[:, 1] - y * tractions[:, 0]).sum(axis=1)
    return np.column_stack([forces, moments]) * SQUARE**2


@dataclass(frozen=True)
class Patch:
    """Contact of a wheel at some shift: slope of the resultant (-), rolling radius (m), and creep forces over the shear
    modulus by longitudinal and lateral creepage (m^2), by spin, which is also the moment by lateral creepage (m^3), and
    moment by spin (m^4)."""

    slope: float
    rolling: float
    along: float
    across: float
    spin: float
    turn: float


TABLE = Path(__file__).with_name("s1002_contact.csv")
COLUMNS = ("slope", "rolling", "along", "across", "spin", "turn")


def patch(shift: float, vehicle: Vehicle) -> Patch:
    """Contact of S1002 on 60E1 at nominal load, the wheel shifted towards its flange (m)."""
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
        found, _ = pressure(gap, x, y, data.nominal_load, data.young / (2 * (1 - data.poisson**2)))
        slope = -np.interp(at, position, rise) @ found / found.sum()
        angle = np.arctan(slope)
    held = found > 0
    centre = (at @ found) / found.sum()
    x, y, at = x[held], (at[held] - centre) / np.cos(angle), at[held]
    radii = radius + np.interp(at, position, height)
    mean, local = radii.mean(), np.sin(np.arctan(np.interp(at, position, rise)))
    nothing, one = np.zeros_like(x), np.ones_like(x)
    # creepages, and spin by the shape of the wheel: its radii along, its slope across the patch
    turned = np.stack([1 - radii / mean, x * local / mean])
    forces = -sticking(x, y, np.array([[one, nothing], [nothing, one], turned]), data.poisson)
    spin = -np.sin(angle) / mean
    rolling = mean * (1 - forces[2, 0] / forces[0, 0])
    return Patch(slope, rolling, forces[0, 0], forces[1, 1], forces[2, 1] / spin, forces[2, 2] / spin)


def table(vehicle: Vehicle, shifts: np.ndarray) -> pd.DataFrame:
    """Patches over the shift towards the flange, columns shift_m and `COLUMNS`."""
    rows = [{"shift_m": shift} | asdict(patch(float(shift), vehicle)) for shift in tqdm(shifts)]
    return pd.DataFrame(rows)


def splines(frame: pd.DataFrame) -> CubicSpline:
    """Effective radius less the nominal one (m), and `COLUMNS` but the slope, over the place of the rail on the wheel.

    The place counts from the tape circle outwards (m). Squares make the columns uneven by a percent, which is smoothed.
    The effective radius is the integral of the slope, so that the normal force makes no energy.
    """
    place = -frame["shift_m"].to_numpy()[::-1]
    smooth = [make_smoothing_spline(1e3 * place, frame[name].to_numpy()[::-1], lam=_SMOOTHING) for name in COLUMNS]
    slope, *others = (spline(1e3 * place) for spline in smooth)
    radius = CubicSpline(place, -slope).antiderivative()
    return CubicSpline(place, np.column_stack([radius(place) - radius(0.0), *others]))


if __name__ == "__main__":
    table(load_vehicle(), np.arange(-24, 25) * 0.25e-3).to_csv(TABLE, index=False, float_format="%.6g")
