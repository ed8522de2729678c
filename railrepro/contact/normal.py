"""Normal contact of wheel and rail: Hertz's ellipse, and elastic half spaces for real profiles. The contact modulus of
two bodies of one material is E* = E / (2 (1 - nu^2)) (Johnson 1985, Contact Mechanics, section 4.2). Serves the paper's
section Simulation Environment."""

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.special import ellipe, ellipk

_FLAT = np.geomspace(0.1, 1.0, 400)
_CELLS = 24, 72  # of the fine grid along and across the rail; the coarse grid has half as many in each direction
_REACH = 1.3e-4  # gap of the undeformed profiles up to which they may touch (m), more than any wheel here approaches
_TOLERANCE = 1e-4  # change of the pressure in an iteration, relative to the load, below which it has converged (-)
_ITERATIONS, _CHANGE = 4, 0.05  # largest number of iterations over the contact angle, and change that ends them (rad)


def hertz(curvature_x: float, curvature_y: float, load: float, modulus: float) -> tuple[float, float]:
    """Semi-axes along and across the rail (m) of the elliptic contact of two bodies; ratio limited to 0.1 to 10. The
    gap between the bodies is curvature_x x^2/2 + curvature_y y^2/2 with x along the rail; both curvatures (1/m) are
    positive. `load` is the normal force (N), `modulus` the contact modulus E* (Pa). Source: Johnson 1985, Contact
    Mechanics, section 4.2."""
    m = 1 - _FLAT**2
    with np.errstate(invalid="ignore"):
        known = np.where(m > 0, (ellipe(m) / _FLAT**2 - ellipk(m)) / (ellipk(m) - ellipe(m)), 1.0)
    across = max(curvature_x, curvature_y) / min(curvature_x, curvature_y)
    flat = np.exp(np.interp(np.log(across), np.log(known[::-1]), np.log(_FLAT[::-1])))
    m = 1 - flat**2
    major = (3 * load * ellipe(m) / (np.pi * modulus * flat**2 * (curvature_x + curvature_y))) ** (1 / 3)
    axes = float(major), float(flat * major)
    return axes if curvature_x <= curvature_y else axes[::-1]


@dataclass(frozen=True)
class Patch:
    """Contact patch of a wheel on a rail. `position` is the lateral distance of the centre of pressure from the track
    centre (m). `height` is the rolling radius at which the patch rolls without longitudinal force, minus the nominal
    radius (m): mean over the strips, weighted by their creep stiffness, which grows as their load to the power 2/3.
    `slope` is the slope of the wheel profile, mean over the pressure (-), and the tangent of the angle of the normal
    force. `strips`, shape (n,), is the lateral position of each strip in the contact plane, 0 at the centre of
    pressure; `half_lengths`, shape (n,), half the length of each strip along the rail (m)."""

    position: float
    height: float
    slope: float
    strips: np.ndarray
    half_lengths: np.ndarray


def elastic_contact(position, height, slope, rail_depth, radius: float, load: float, modulus: float) -> Patch:
    """Contact of a wheel profile with a rail profile: elastic half spaces in the plane of the mean contact angle. A
    coarse grid locates the contact. A fine grid then covers it with the same number of cells for every patch. Arrays
    have the shape (n,): `position`, lateral distance from the track centre, uniformly spaced (m); `height`, radius of
    the wheel profile minus the nominal `radius` (m), and its `slope` (-); `rail_depth` below the top of the rail (m).
    `load` is the normal force (N), `modulus` the contact modulus E* (Pa). Source: Kalker 1990, Three-Dimensional
    Elastic Bodies in Rolling Contact, ch. 4."""
    overlap = height - rail_depth
    gap, first = overlap.max() - overlap, int(np.argmax(overlap))
    rolling, angle = radius + height[first], np.arctan(slope[first])
    near = position[gap * np.cos(angle) < _REACH]
    reach_x, reach_y = np.sqrt(2 * rolling * _REACH / np.cos(angle)), (near[0], near[-1])
    for iteration in range(_ITERATIONS):
        cos, cells = np.cos(angle), np.array(_CELLS) // (1 if iteration else 2)
        x, y = np.linspace(-reach_x, reach_x, cells[0]), np.linspace(*reach_y, cells[1])
        cell = x[1] - x[0], (y[1] - y[0]) / cos
        distance = cos * (x[:, None] ** 2 / (2 * rolling) + np.interp(y, position, gap))
        pressure = half_space_pressure(distance, load, cell, modulus)
        across = pressure.sum(axis=0) / pressure.sum()
        mean = across @ np.interp(y, position, slope)
        if iteration and abs(np.arctan(mean) - angle) < _CHANGE:
            break
        touched, angle = y[across > 0], np.arctan(mean)
        reach_x = np.abs(x[pressure.any(axis=1)]).max() + cell[0]
        reach_y = touched[0] - cell[1] * cos, touched[-1] + cell[1] * cos
    # The pressure along a strip is semi-elliptic: its variance is a quarter of the squared half-length.
    variance = np.divide(x**2 @ pressure, pressure.sum(axis=0), out=np.zeros(len(y)), where=across > 0)
    stiffness = across ** (2 / 3)
    rolling = stiffness @ np.interp(y, position, height) / stiffness.sum()
    return Patch(across @ y, rolling, mean, (y - across @ y) / cos, 2 * np.sqrt(variance))


def half_space_pressure(gap: np.ndarray, load: float, sides: tuple[float, float], modulus: float) -> np.ndarray:
    """Normal pressure between two elastic half spaces (Pa), in the shape of `gap`; 0 where they do not touch. `gap`
    (m), shape (nx, ny), is the distance between the undeformed surfaces on a grid with the steps `sides` in x and y
    (m). `load` is the normal force (N), `modulus` the contact modulus E* (Pa). ArithmeticError if the pressure has not
    settled after 500 iterations. Source: Polonsky and Keer 1999 (conjugate gradients)."""
    shape = [2 * n for n in gap.shape]
    transform = fft.rfft2(_influence(gap.shape, sides, modulus))

    def deflection(pressure):
        return fft.irfft2(fft.rfft2(pressure, shape) * transform, shape)[: gap.shape[0], : gap.shape[1]]

    area = np.prod(sides)
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
        if moved < _TOLERANCE:
            return pressure
    raise ArithmeticError("the contact pressure has not settled after 500 iterations")


def _influence(shape: tuple[int, ...], sides: tuple[float, float], modulus: float) -> np.ndarray:
    """Deflection at grid distances from a cell under unit pressure (m/Pa), wrapped for the FFT. Source: Love 1929."""
    x, y = np.meshgrid(*(fft.fftfreq(2 * n, 1 / (2 * n)) * d for n, d in zip(shape, sides, strict=True)), indexing="ij")
    total = np.zeros_like(x)
    for sign_x, sign_y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        u, v = x + sign_x * sides[0] / 2, y + sign_y * sides[1] / 2
        total = total + sign_x * sign_y * (u * np.arcsinh(v / np.abs(u)) + v * np.arcsinh(u / np.abs(v)))
    return total / (np.pi * modulus)
