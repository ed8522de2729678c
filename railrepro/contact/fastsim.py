"""The contact of wheel and rail by other methods, and what a gear feels of it: FASTSIM, rigid profiles, centring force,
equivalent conicity.

They check the contact of the simulated car (`creep`, `table`), which does not use them. Serves the paper's section
Simulation Environment.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from railrepro.contact.creep import polach, strip_coefficients
from railrepro.contact.normal import contact_modulus
from railrepro.contact.table import elastic_patch, section
from railrepro.vehicle.parameters import Vehicle


def fastsim(nu_x, nu_y, spin, load, a, b, friction, coefficients, shear_modulus, cells=(40, 21)):
    """Creep forces by Kalker's simplified theory, constant friction, many cases at once.

    Each creepage has the flexibility of its own direction, so that small creepages of any mixture reproduce linear
    theory. Strips run from the leading edge backwards; where the traction would exceed its parabolic bound it slides,
    and slides against its own direction.

    Parameters
    ----------
    nu_x, nu_y, spin, load, a, b, friction : array_like, broadcast to one shape
        Creepages (-, -, 1/m), normal force (N), semi-axes along and across the rail (m), coefficient of friction (-).
    coefficients : tuple of array_like
        Kalker's c11, c22, c23 (-), broadcast to the same shape.
    shear_modulus : float
        G (Pa).
    cells : tuple of int
        Elements along a strip and number of strips.

    Returns
    -------
    F_x, F_y : ndarray
        Force on the wheel (N), in the shape of the broadcast arguments.

    Source: Kalker 1982.
    """
    inputs = np.broadcast_arrays(nu_x, nu_y, spin, load, a, b, friction, *coefficients)
    shape = inputs[0].shape
    nu_x, nu_y, spin, load, a, b, friction, c11, c22, c23 = (np.reshape(v, (-1, 1)).astype(float) for v in inputs)
    flexible_x, flexible_y = (8 * a / (3 * shear_modulus * c) for c in (c11, c22))
    turning = spin * 4 * shear_modulus * c23 * np.sqrt(a * b) / (np.pi * a**2)
    n_along, n_across = cells
    eta = (np.arange(n_across) - (n_across - 1) / 2) / (n_across / 2)
    half = a * np.sqrt(1 - eta**2)
    step, width = 2 * half / n_along, 2 * b / n_across
    p_x, p_y = np.zeros_like(half), np.zeros_like(half)
    f_x, f_y = np.zeros(len(a)), np.zeros(len(a))
    for k in range(n_along):
        x = half - (k + 0.5) * step
        advance = step if k else step / 2
        p_x = p_x - advance * (nu_x / flexible_x - turning * eta * b)
        p_y = p_y - advance * (nu_y / flexible_y + turning * (x + step / 2 if k else x + step / 4))
        bound = 2 * friction * load / (np.pi * a * b) * np.maximum(1 - (x / a) ** 2 - eta**2, 0)
        p_x, p_y = _slide(p_x, p_y, bound, flexible_x, flexible_y)
        f_x += np.sum(p_x * step * width, axis=1)
        f_y += np.sum(p_y * step * width, axis=1)
    return f_x.reshape(shape), f_y.reshape(shape)


def _slide(p_x, p_y, bound, flexible_x, flexible_y):
    """Traction within its bound: what a sliding element gives up, times its flexibility, is along its traction.

    So p_i = q_i / (1 + w/L_i) of the traction q before, with w from Newton's rule for 1/|p| = 1/bound, which is exact
    for equal flexibilities.
    """
    size, bound = np.hypot(p_x, p_y), np.maximum(bound, 1e-9)
    over = size > bound
    weight = np.where(over, np.sqrt(flexible_x * flexible_y) * (size / bound - 1), 0.0)
    for _ in range(3):
        along, across = p_x / (1 + weight / flexible_x), p_y / (1 + weight / flexible_y)
        square = np.maximum(along**2 + across**2, 1e-300)
        fall = np.maximum(along**2 / (flexible_x + weight) + across**2 / (flexible_y + weight), 1e-300)
        weight = weight + np.where(over, (np.sqrt(square) - bound) * square / (bound * fall), 0.0)
    return p_x / (1 + weight / flexible_x), p_y / (1 + weight / flexible_y)


def rigid_contact(shifts, radius: float) -> pd.DataFrame:
    """Point contact of a rigid S1002 wheel on rigid 60E1 at 1:40, at lateral shifts of the wheel to its flange (m).

    `shifts` has the shape (n,), `radius` is the nominal rolling radius (m). Returns n rows with the columns shift_m,
    position_m (from the track centre), tan_angle (-), rolling_radius_m.
    """
    rows = []
    for shift in shifts:
        position, height, slope, rail_depth = section(shift)
        i = int(np.argmax(height - rail_depth))
        rows.append((shift, position[i], slope[i], radius + height[i]))
    return pd.DataFrame(rows, columns=["shift_m", "position_m", "tan_angle", "rolling_radius_m"])


def centring_forces(shift: float, vehicle: Vehicle, load: float, friction: float) -> tuple[float, float]:
    """Lateral forces on a running gear with independent wheels that stands off the middle of the track (N).

    Parameters
    ----------
    shift : float
        Displacement to the right (m).
    vehicle : Vehicle
        For its wheel radius and material; wheels and rails are S1002 on 60E1 at 1:40.
    load, friction : float
        Normal force of each wheel (N), coefficient of friction (-).

    Returns
    -------
    weight, spin : float
        Sums over both wheels, positive to the left, which at a positive shift is towards the middle (N): of the normal
        forces, which the contact angles incline, and of the creep forces by spin, which have the opposite sign.
    """
    material, weight, pushed = vehicle.contact, 0.0, 0.0
    modulus, radius = contact_modulus(material.young, material.poisson), vehicle.wheel.radius
    for side in (1, -1):
        patch = elastic_patch(side * shift, radius, load, modulus)
        a, b, coefficients = strip_coefficients(patch.half_lengths, patch.strips)
        spin = -np.sin(np.arctan(patch.slope)) / (radius + patch.height)
        law = (*coefficients, material.shear_modulus, 1.0, 1.0, friction, 1.0, 0.0, 0.0)
        weight += side * load * patch.slope
        pushed -= side * float(polach(0.0, 0.0, spin, load, a, b, *law)[1])
    return weight, pushed


def equivalent_conicity(frame: pd.DataFrame, amplitude: float) -> float:
    """Equivalent conicity (-): that of the cone on which a wheelset would oscillate with the same wavelength.

    The wheelset follows y'' = -(r_ri - r_le)/(b r_0) along the track, without roll: both wheels shift by y. From the
    energy integral comes the length of a quarter of a wave. 0 where the radii do not bring the wheelset back.

    Parameters
    ----------
    frame : DataFrame
        Columns shift_m, at least from -amplitude to +amplitude, and rolling_radius_m, as of `rigid_contact` or
        `ContactTable.frame`.
    amplitude : float
        Amplitude of the lateral oscillation (m).

    Source: EN 15302, by integration of the equation of motion.
    """
    y = np.linspace(0.0, amplitude, 4001)
    right, left = (np.interp(side * y, frame["shift_m"], frame["rolling_radius_m"]) for side in (1, -1))
    potential = CubicSpline(y, right - left).antiderivative()
    phase = (np.arange(4000) + 0.5) * np.pi / 8000
    energy = potential(amplitude) - potential(amplitude * np.sin(phase))
    if energy.min() <= 0:
        return 0.0
    quarter = np.mean(amplitude * np.cos(phase) / np.sqrt(2 * energy)) * np.pi / 2
    return float((np.pi / 2 / quarter) ** 2 / 2)
