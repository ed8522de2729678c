"""Creep forces between wheel and rail: Kalker's coefficients, and Polach's law, which has the falling branch that
adhesion control needs. Its mean / largest errors relative to the friction force, against half spaces in steady rolling
with a/b from 0.7 to 2: 0.02 / 0.03 without spin, 0.02 / 0.04 with the spin of a cone, 0.04 / 0.09 with that of S1002 on
dry rail, 0.07 / 0.23 with 2.5 times that. Serves eq. (4) and Fig. 2 of the paper, which name no law."""

from dataclasses import astuple
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

_POISSON = (0.0, 0.25, 0.5)
# Kalker's table: semi-axis ratio a/b, then c11, c22, c23, c33, each for the three Poisson's ratios.
_TABLE = np.array(
    [
        (0.1, 2.51, 3.31, 4.85, 2.51, 2.52, 2.53, 0.334, 0.473, 0.731, 6.42, 8.28, 11.7),
        (0.2, 2.59, 3.37, 4.81, 2.59, 2.63, 2.66, 0.483, 0.603, 0.809, 3.46, 4.27, 5.66),
        (0.3, 2.68, 3.44, 4.80, 2.68, 2.75, 2.81, 0.607, 0.715, 0.889, 2.49, 2.96, 3.72),
        (0.4, 2.78, 3.53, 4.82, 2.78, 2.88, 2.98, 0.720, 0.823, 0.977, 2.02, 2.32, 2.77),
        (0.5, 2.88, 3.62, 4.83, 2.88, 3.01, 3.14, 0.827, 0.929, 1.07, 1.74, 1.93, 2.22),
        (0.6, 2.98, 3.72, 4.91, 2.98, 3.14, 3.31, 0.930, 1.03, 1.18, 1.56, 1.68, 1.86),
        (0.7, 3.09, 3.81, 4.97, 3.09, 3.28, 3.48, 1.03, 1.14, 1.29, 1.43, 1.50, 1.60),
        (0.8, 3.19, 3.91, 5.05, 3.19, 3.41, 3.65, 1.13, 1.25, 1.40, 1.34, 1.37, 1.42),
        (0.9, 3.29, 4.01, 5.12, 3.29, 3.54, 3.82, 1.23, 1.36, 1.51, 1.27, 1.27, 1.27),
        (1.0, 3.40, 4.12, 5.20, 3.40, 3.67, 3.98, 1.33, 1.47, 1.63, 1.21, 1.19, 1.16),
        (1 / 0.9, 3.51, 4.22, 5.30, 3.51, 3.81, 4.16, 1.44, 1.59, 1.77, 1.16, 1.11, 1.06),
        (1 / 0.8, 3.65, 4.36, 5.42, 3.65, 3.99, 4.39, 1.58, 1.75, 1.94, 1.10, 1.04, 0.954),
        (1 / 0.7, 3.82, 4.54, 5.58, 3.82, 4.21, 4.67, 1.76, 1.95, 2.18, 1.05, 0.965, 0.852),
        (1 / 0.6, 4.06, 4.78, 5.80, 4.06, 4.50, 5.04, 2.01, 2.23, 2.50, 1.01, 0.892, 0.751),
        (2.0, 4.37, 5.10, 6.11, 4.37, 4.90, 5.56, 2.35, 2.62, 2.96, 0.958, 0.819, 0.650),
        (2.5, 4.84, 5.57, 6.57, 4.84, 5.48, 6.31, 2.88, 3.24, 3.70, 0.912, 0.747, 0.549),
        (10 / 3, 5.57, 6.34, 7.34, 5.57, 6.40, 7.51, 3.79, 4.32, 5.01, 0.868, 0.674, 0.446),
        (5.0, 6.96, 7.78, 8.82, 6.96, 8.14, 9.79, 5.72, 6.63, 7.89, 0.828, 0.601, 0.341),
        (10.0, 10.7, 11.7, 12.9, 10.7, 12.8, 16.0, 12.2, 14.6, 18.0, 0.795, 0.526, 0.228),
    ]
)
_SPINNING = 1.4
"""Factor of c33 a b spin^2 in the friction used by spin (-), fitted to half spaces in steady rolling, a/b from 0.5 to
1. The resultant alone would be too small in a wide patch, in which tractions of spin cancel."""
_PLAIN = 0.4, 2.0  # range of a/b in which `strip_coefficients` fits straight lines: that of S1002 on 60E1


def kalker_coefficients(ratio, poisson: float = 0.28) -> tuple[np.ndarray, ...]:
    """Kalker's creep coefficients c11, c22, c23, c33 (-) of an elliptic contact, each in the shape of `ratio`. `ratio`
    is the semi-axis ratio a/b, with a along and b across the rail, clipped to 0.1 to 10. `poisson` is Poisson's ratio,
    0 to 0.5. Source: Kalker 1990, Table E3; parabola over Poisson's ratio, spline over the logarithm of a/b."""
    weights = [np.prod([(poisson - q) / (p - q) for q in _POISSON if q != p]) for p in _POISSON]
    table = np.stack(np.split(_TABLE[:, 1:], 4, axis=1)) @ weights
    spline = CubicSpline(np.log(_TABLE[:, 0]), np.log(table.T))
    return tuple(np.moveaxis(np.exp(spline(np.log(np.clip(ratio, 0.1, 10.0)))), -1, 0))


@lru_cache
def _strips_and_ends(poisson: float) -> tuple[list[np.ndarray], np.ndarray]:
    """Straight lines (slope, value at 0) of c11, c22 and c23 / sqrt(a/b) of ellipses over a/b, and of c33 over b/a."""
    ratios = np.linspace(*_PLAIN, 50)
    c11, c22, c23, c33 = kalker_coefficients(ratios, poisson)
    lines = [np.polyfit(ratios, row, 1) for row in (c11, c22, c23 / np.sqrt(ratios))]
    spin, *_ = np.linalg.lstsq(np.stack([1 / ratios, 0 * ratios + 1], axis=1), c33, rcond=None)
    return lines, spin


def strip_coefficients(half_length: np.ndarray, position: np.ndarray, poisson: float = 0.28):
    """Equivalent ellipse and creep coefficients of a contact patch of any shape, divided into strips along the rail.

    For ellipses, c11 a b and c22 a b of Kalker's table are nearly A a b + B a^2 with constants A, B, and c23 (a b)^1.5
    is nearly A a^2 b + B a^3. Here the A term is a sum over the strips. The B term represents the lateral ends of
    the patch by half the total variation of the squared half-length across the strips (cubed for c23), so that each
    lobe has ends. For c33 strips are weighted by their squared distance from the middle. An elliptic patch gets the
    coefficients of Kalker's table.

    Each strip has half of its length (m), 0 without contact, in `half_length`, shape (n,), and a lateral `position`
    (m), shape (n,), equally spaced, 0 at the centre of pressure. Returns half the length a of the longest strip, the
    lateral semi-axis b of the ellipse of the same area (m), and the tuple c11, c22, c23, c33 (-), to be used with this
    ellipse.
    """
    width = position[1] - position[0]
    a = half_length.max()
    b = 2 * half_length.sum() * width / (np.pi * a)
    forces, (steep, flat) = _strips_and_ends(poisson)
    shares = []
    for (ends, strips), power, mean in zip(forces, (1, 1, 2), (2 / np.pi, 2 / np.pi, 3 / 4), strict=True):
        ups_and_downs = np.abs(np.diff(half_length ** (power + 1), prepend=0.0, append=0.0)).sum()
        patch = strips * mean * (half_length**power).sum() * width + ends * ups_and_downs / 2
        shares.append(patch / (strips * a**power * b + ends * a ** (power + 1)))
    spread = 8 / np.pi * (half_length * position**2).sum() * width
    shares.append((steep * spread + flat * (a * b) ** 2) / (steep * a * b**3 + flat * (a * b) ** 2))
    return a, b, tuple(float(c * share) for c, share in zip(kalker_coefficients(a / b, poisson), shares, strict=True))


def polach(
    nu_x, nu_y, spin, load, a, b, c11, c22, c23, c33, shear_modulus, k_a, k_s, mu0, a_ratio, b_decay, slip_speed
):
    """Creep forces on a wheel: Polach's resultant with falling friction, in the direction of Kalker's linear force.

    The linear force includes spin, so small creepages of any mixture agree with linear theory. The moment about the
    contact normal is Kalker's linear one, f23 nu_y - f33 spin, reduced like the force. Its term in nu_y is also
    multiplied by 1 - used + 2 used^2 (1 - used)^2, where `used` is the fraction of the friction in use; this is fitted
    to half spaces in steady rolling. All arguments are floats, arrays (elementwise) or CasADi SX. Values and
    derivatives are finite at zero creepage and load. Source: Polach 2005, eqs. (2) and (3) (resultant), Shen, Hedrick
    and Elkins 1983 (direction), Kalker 1990 (moment).

    Args:
        nu_x, nu_y, spin: Longitudinal and lateral creepage (-), spin creepage (1/m).
        load, shear_modulus, slip_speed: Normal force (N), shear modulus (Pa), sliding speed of the contact (m/s).
        a, b: Semi-axes of the contact along and across the rail (m).
        c11, c22, c23, c33: Kalker's coefficients (-).
        k_a, k_s: Factors on the creep stiffness in the areas of adhesion and of slip (-).
        mu0, a_ratio, b_decay: Friction coefficient mu0 ((1 - a_ratio) exp(-b_decay slip_speed) + a_ratio) (-, -, s/m).

    Returns the tangential forces on the wheel along and across the rail (N), together never larger than the friction
    force, and the moment about the contact normal, which points into the rail (N m).
    """
    m = elementary(nu_x, nu_y, spin, load)
    friction, root = mu0 * ((1 - a_ratio) * m.exp(-b_decay * slip_speed) + a_ratio), m.sqrt(a * b)
    along, across, turning, rolled = c11 * nu_x, c22 * nu_y, c23 * root * spin, c33 * a * b * spin**2
    # Spin uses the friction of its resultant or of its moment, whichever is larger; a fourth power makes it smooth.
    spinning = m.sqrt(turning**4 + (_SPINNING * rolled) ** 2 + 1e-26)
    linear = m.sqrt(along**2 + across**2 + 2 * across * turning + spinning)
    stiffness = shear_modulus * a * b
    gradient = np.pi / 4 * stiffness * linear / ((load + 1.0) * (friction + 1e-9))
    adhering = k_a * gradient
    used = 2 / np.pi * (adhering / (1 + adhering**2) + m.arctan(m.fmin(k_s, k_a) * gradient))
    secant = load * friction * used / linear
    fade = (1 - used) * (1 + 2 * used**2 * (1 - used))
    return -secant * along, -secant * (across + turning), secant * root * (fade * c23 * nu_y - root * c33 * spin)


def elementary(*values):
    """Module whose sqrt, exp, fmin … take these values: casadi if any of them is SX or MX, else numpy."""
    return ca if any(isinstance(value, ca.SX | ca.MX) for value in values) else np


def adhesion_maximum(adhesion, speed: float, load: float, a: float, b: float, coefficients, shear_modulus: float):
    """Adhesion maximum in pure traction: largest creep force over normal force (-), and the longitudinal creepage at
    which it occurs (-), searched from 1e-5 to 0.5. `adhesion` is an `AdhesionSet`, `speed` the running speed (m/s),
    `load` the normal force (N), `a` and `b` are the semi-axes of the contact along and across the rail (m),
    `coefficients` c11, c22, c23, c33 (-). The shear modulus is in Pa."""
    slip = np.geomspace(1e-5, 0.5, 20_000)
    law = *coefficients, shear_modulus, *astuple(adhesion), slip * speed
    force, *_ = polach(-slip, 0.0, 0.0, load, a, b, *law)
    best = int(np.argmax(force))
    return float(force[best] / load), float(slip[best])
