"""Normal contact of wheel and rail: Hertz's ellipse, the strip method for real profiles, and the elastic half space.

The car's contact table comes from the strip method, which takes milliseconds; the half space is its judge. Serves the
paper's section Simulation Environment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

_FLAT = np.geomspace(0.1, 1.0, 400)
_INTERPENETRATION = 0.55
"""Virtual interpenetration over elastic approach. Source: Piotrowski and Kik 2008."""


def contact_modulus(young: float, poisson: float) -> float:
    """Modulus E* = E / (2 (1 - nu^2)) of two bodies of the same material (Pa).

    Source: Johnson 1985, Contact Mechanics, section 4.2.
    """
    return young / (2 * (1 - poisson**2))


def hertz(curvature_x, curvature_y, load, modulus) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Contact ellipse of two bodies whose distance is curvature_x x^2/2 + curvature_y y^2/2.

    Parameters
    ----------
    curvature_x, curvature_y : array_like
        Sum of both bodies' curvatures along and across the rail (1/m), positive.
    load : float
        Normal force (N).
    modulus : float
        Contact modulus E* (Pa).

    Returns
    -------
    a, b : ndarray
        Semi-axes along and across the rail (m); the ratio is held within 0.1 to 10.
    approach : ndarray
        Approach of the bodies (m).

    Source: Johnson 1985, Contact Mechanics, section 4.2.
    """
    curvature_x, curvature_y = np.asarray(curvature_x, dtype=float), np.asarray(curvature_y, dtype=float)
    m = 1 - _FLAT**2
    with np.errstate(invalid="ignore"):
        known = np.where(m > 0, (ellipe(m) / _FLAT**2 - ellipk(m)) / (ellipk(m) - ellipe(m)), 1.0)
    across = np.maximum(curvature_x, curvature_y) / np.minimum(curvature_x, curvature_y)
    flat = np.exp(np.interp(np.log(across), np.log(known[::-1]), np.log(_FLAT[::-1])))
    m = 1 - flat**2
    major = (3 * load * ellipe(m) / (np.pi * modulus * flat**2 * (curvature_x + curvature_y))) ** (1 / 3)
    minor = flat * major
    along = curvature_x <= curvature_y
    approach = 3 * load * ellipk(m) / (2 * np.pi * modulus * major)
    return np.where(along, major, minor), np.where(along, minor, major), approach


@dataclass(frozen=True)
class Patch:
    """Patch of the strip method: weighted means over the patch, weights proportional to the pressure of a strip.

    Attributes
    ----------
    position, height, slope : float
        Lateral position (m), height of the wheel profile (m), slope of the wheel profile (-).
    curvature : float
        Lateral curvature of the parabola with the same spread of penetration (1/m).
    approach : float
        Elastic approach along the contact normal (m).
    """

    position: float
    height: float
    slope: float
    curvature: float
    approach: float


def strip_contact(position, height, slope, rail_depth, radius: float, load: float, modulus: float) -> Patch:
    """Elastic contact of a wheel profile on a rail profile by virtual interpenetration.

    The profiles are pushed into each other by 0.55 of the elastic approach; where they overlap is the patch; a strip
    along the rail carries a semi-elliptic pressure whose sum is proportional to its overlap. The deflection of the half
    space under this pressure, taken at the centroid, gives the approach that carries the load.

    Parameters
    ----------
    position, height, slope, rail_depth : ndarray, shape (n,)
        Uniform lateral grid (m), wheel profile and its slope on it (m, -), depth of the rail (m).
    radius : float
        Nominal rolling radius (m).
    load : float
        Normal force (N).
    modulus : float
        Contact modulus E* (Pa).

    Returns
    -------
    Patch

    Source: Piotrowski and Kik 2008; weights as in Kik and Piotrowski 1996, centroid in place of the first point of
    contact because the latter jumps.
    """
    overlap = height - rail_depth
    gap = overlap.max() - overlap
    near = gap < 1e-3
    position, height, slope, gap = position[near], height[near], slope[near], gap[near]
    step = position[1] - position[0]

    def press(depth: float):
        penetration = np.maximum(depth - gap, 0.0)
        weight = penetration / penetration.sum()
        mean = weight @ position
        cos = 1 / np.hypot(1.0, weight @ slope)
        half_squared = 2 * (radius + height) * penetration
        away = ((position - mean) / cos) ** 2 + (step / 4) ** 2
        m = half_squared / (half_squared + away)
        deflection = 2 * np.sqrt(half_squared + away) * (ellipk(m) - ellipe(m))
        approach = depth / _INTERPENETRATION * cos
        carried = np.pi * modulus * approach * np.sum(np.pi / 2 * half_squared) / np.sum(deflection)
        return carried, weight, mean, cos, approach

    depth = brentq(lambda d: press(d)[0] - load, 1e-7, 9e-4, xtol=1e-12, rtol=1e-10)
    _, weight, mean, cos, approach = press(depth)
    spread = weight @ (position - mean) ** 2 / cos**2
    curvature = 2 * depth * cos / (5 * spread)
    return Patch(mean, weight @ height, weight @ slope, curvature, approach)


def half_space_pressure(gap: np.ndarray, load: float, cell: float, modulus: float, tolerance: float = 1e-6):
    """Pressure between elastic half spaces that are pressed together, by conjugate gradients.

    Parameters
    ----------
    gap : ndarray, shape (nx, ny)
        Distance of the undeformed surfaces on a square grid (m).
    load : float
        Normal force (N).
    cell : float
        Grid step (m).
    modulus : float
        Contact modulus E* (Pa).
    tolerance : float
        Change of the pressure per iteration, relative to the load, at which to stop (-).

    Returns
    -------
    pressure : ndarray, shape (nx, ny)
        (Pa)
    approach : float
        Approach of the bodies (m).

    Raises
    ------
    ArithmeticError
        When 500 iterations are not enough.

    Source: Polonsky and Keer 1999; deflection under a square cell: Love 1929.
    """
    shape = [2 * n for n in gap.shape]
    transform = fft.rfft2(_influence(gap.shape, cell, modulus))

    def deflection(pressure):
        return fft.irfft2(fft.rfft2(pressure, shape) * transform, shape)[: gap.shape[0], : gap.shape[1]]

    area = cell**2
    pressure = np.where(gap < gap.min() + 5e-5, 1.0, 0.0)
    pressure *= load / (pressure.sum() * area)
    direction, previous, keep = np.zeros_like(pressure), 1.0, 0.0
    for _ in range(500):
        touching = pressure > 0
        error = deflection(pressure) + gap
        error -= error[touching].mean()
        size = np.sum(error[touching] ** 2)
        direction = np.where(touching, error + keep * size / previous * direction, 0.0)
        previous = size
        change = deflection(direction)
        change -= change[touching].mean()
        step = np.sum(error[touching] * direction[touching]) / np.sum(change[touching] * direction[touching])
        updated = np.maximum(pressure - step * direction, 0.0)
        overlapping = (updated == 0) & (error < 0)
        keep = 0.0 if overlapping.any() else 1.0
        updated[overlapping] -= step * error[overlapping]
        updated *= load / (updated.sum() * area)
        moved = np.abs(updated - pressure).sum() * area / load
        pressure = updated
        if moved < tolerance:
            return pressure, float((deflection(pressure) + gap)[pressure > 0].mean())
    raise ArithmeticError("the contact pressure has not settled after 500 iterations")


def _influence(shape: tuple[int, int], cell: float, modulus: float) -> np.ndarray:
    """Deflection of the half spaces at grid distances under unit pressure on one cell (m/Pa), wrapped for the FFT.

    Source: Love 1929.
    """
    x, y = np.meshgrid(*(fft.fftfreq(2 * n, 1 / (2 * n)) * cell for n in shape), indexing="ij")
    half, total = cell / 2, 0.0
    for sign_x in (1, -1):
        for sign_y in (1, -1):
            u, v = x + sign_x * half, y + sign_y * half
            total = total + sign_x * sign_y * (u * np.arcsinh(v / np.abs(u)) + v * np.arcsinh(u / np.abs(v)))
    return total / (np.pi * modulus)
