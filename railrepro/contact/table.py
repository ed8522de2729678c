"""Wheel-rail contact as a table over the lateral shift of the wheel: cone on a line rail, or S1002 on 60E1 at 1:40.

The plant needs, at each shift u (positive towards the flange): the radius of the equivalent wheel on a knife-edge rail
(its slope is the tangent of the contact angle, so the normal force is conservative), the true rolling radius and
contact position, the contact ellipse, Kalker coefficients and Hertz stiffness.

A rigid wheel on a rigid rail touches in a point that jumps by 12 mm when an S1002 wheel passes the centre; under load
the patch spans the jump. So geometry is averaged over the pressure of elastic half spaces at nominal load, which makes
it continuous. The rolling radius is that at which the patch rolls without longitudinal force (`normal.Patch`), creep
coefficients are those of its strips (`creep.strip_coefficients`). Weight pushes a gear beside the middle back, spin
pushes it on; the net force is a fifth of each, and within 15 % of half spaces. The normal force acts at the fixed line
of the rail, as the energy of the effective radius has it; moved with the patch it would change no error of a gear that
keeps off its flanges by more than 1 %.

Serves the paper's eqs. (10), (11) (cone) and section Simulation Environment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline, PchipInterpolator

from railrepro.compile.codegen import stored
from railrepro.contact import normal, profiles
from railrepro.contact.creep import elementary, kalker_coefficients, strip_coefficients
from railrepro.data import InputError
from railrepro.vehicle.parameters import Vehicle

_LINEAR = (
    *("rolling_radius", "rail_contact", "semi_axis_x", "semi_axis_y"),
    *("c11", "c22", "c23", "c33", "normal_stiffness"),
)
CELL_COLUMNS = (
    *("shift", "width", "effective_radius", "radius_slope", "radius_square", "radius_cube"),
    *(column for name in _LINEAR for column in (name, f"d{name}")),
)
"""Entries of a cell of the table (SI): shift at its start, its width, the coefficients of the effective radius as a
cubic in the offset from the start, and of each other quantity the value at the start and its slope (d…) over the
shift."""
_BEYOND = 1e-12
"""How far a cell goes on beyond its ends (m): at a node, also a rounded one, derivatives are those of the cell."""
_PATCH = ("semi_axis_x_m", "semi_axis_y_m", "c11", "c22", "c23", "c33")


@dataclass(frozen=True)
class ContactTable:
    """Contact quantities over the lateral shift of a wheel towards its flange.

    Attributes:
        frame (DataFrame): Uniform grid `shift_m` with effective_radius_m, angle_rad (contact angle), rolling_radius_m,
            rail_contact_m (lateral position on the rail, from half the contact base, positive to the field side),
            semi_axis_x_m, semi_axis_y_m (at nominal load), Kalker's c11, c22, c23, c33 (-), normal_stiffness (N/m^1.5).
    """

    frame: pd.DataFrame

    def cells(self) -> np.ndarray:
        """Cells between the n grid points, one a row, columns `CELL_COLUMNS` (SI), shape (n - 1, len(CELL_COLUMNS)).

        Effective radius and its slope are continuous from cell to cell.

        Source: cubic Hermite interpolation, de Boor, A Practical Guide to Splines, ch. IV.
        """
        quantities = {name.removesuffix("_m"): self.frame[name].to_numpy() for name in self.frame}
        shift, radius = quantities["shift"], quantities["effective_radius"]
        slope, h = np.tan(quantities["angle_rad"]), np.diff(shift)
        secant = np.diff(radius) / h
        columns = {
            "shift": shift[:-1],
            "width": h,
            "effective_radius": radius[:-1],
            "radius_slope": slope[:-1],
            "radius_square": (3 * secant - 2 * slope[:-1] - slope[1:]) / h,
            "radius_cube": (slope[:-1] + slope[1:] - 2 * secant) / h**2,
        }
        for name in _LINEAR:
            columns |= {name: quantities[name][:-1], f"d{name}": np.diff(quantities[name]) / h}
        return np.ascontiguousarray(np.array([columns[name] for name in CELL_COLUMNS]).T)


def in_cell(cell: dict, offset) -> dict:
    """Contact at an offset (m) from the start of a cell, a dict by `CELL_COLUMNS` of numbers, arrays or symbols.

    A wheel that hits its flange leaves its cell by several widths within a stage of the integrator. Beyond the cell the
    effective radius goes on along its tangent, so that it stays the integral of its slope and the contact makes no
    energy, the rolling radius goes with it, as on a cone, and all else keeps its value, so that no ellipse grows a
    negative axis.

    Returns:
        dict: effective_radius (m) and its slope (-), which is the tangent of the contact angle, rolling_radius,
        rail_contact, semi_axis_x, semi_axis_y (m), c11, c22, c23, c33 (-), normal_stiffness (N/m^1.5).
    """
    first, square, cube = (cell[f"radius_{name}"] for name in ("slope", "square", "cube"))
    m = elementary(offset)
    held = m.fmin(m.fmax(offset, -_BEYOND), cell["width"] + _BEYOND)
    slope = first + held * (2 * square + held * 3 * cube)
    beyond = slope * (offset - held)
    at = {name: cell[name] + cell[f"d{name}"] * held for name in _LINEAR}
    at["effective_radius"] = cell["effective_radius"] + held * (first + held * (square + held * cube)) + beyond
    return at | {"slope": slope, "rolling_radius": at["rolling_radius"] + beyond}


def contact_table(profile: str, vehicle: Vehicle) -> ContactTable:
    """`ContactTable` of a vehicle for the profile "cone" or "s1002"; InputError for another name."""
    material = vehicle.contact
    modulus = material.young / (2 * (1 - material.poisson**2))
    if profile == "cone":
        return _cone(vehicle, modulus)
    if profile != "s1002":
        raise InputError(f"profile {profile!r} is not known; there are cone and s1002")
    return pair_table(vehicle.wheel.radius, material.nominal_load, modulus, material.normal_stiffness)


def middle_patch(vehicle: Vehicle) -> tuple[float, float, tuple[float, ...]]:
    """Contact ellipse of the vehicle's own wheel profile in the middle of the track, at nominal load.

    Returns:
        a, b (float): Semi-axes along and across the rail (m).
        coefficients (tuple of float): c11, c22, c23, c33 (-).
    """
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    a, b, *coefficients = frame.loc[frame["shift_m"].abs().argmin(), [*_PATCH]].tolist()
    return a, b, tuple(coefficients)


def _cone(vehicle: Vehicle, modulus: float) -> ContactTable:
    """Cone on a line-shaped rail: r = r0 + u tan(delta0), constant ellipse, with the contact modulus E* (Pa).

    A cone of 1:40 stands upright on a rail that is inclined 1:40 and touches its crown; its generating line is
    straight, so the crown alone curves the contact across the rail.

    Source: paper, eqs. (10), (11); Johnson 1985, Contact Mechanics, section 4.2 (ellipse).
    """
    along = np.cos(vehicle.wheel.cone_angle) / vehicle.wheel.radius
    a, b = normal.hertz(along, 1 / profiles.CROWN_RADIUS, vehicle.contact.nominal_load, modulus)
    shift = np.arange(-400, 401) * 1e-4
    radius = vehicle.wheel.radius + np.tan(vehicle.wheel.cone_angle) * shift
    columns = {
        "shift_m": shift,
        "effective_radius_m": radius,
        "rolling_radius_m": radius,
        "angle_rad": vehicle.wheel.cone_angle,
        "rail_contact_m": 0.0,
        **dict(zip(_PATCH, (a, b, *kalker_coefficients(a / b)), strict=True)),
        "normal_stiffness": vehicle.contact.normal_stiffness,
    }
    return ContactTable(pd.DataFrame(columns))


@cache
def _rail() -> tuple[np.ndarray, np.ndarray]:
    """Uniform lateral grid over the rail head and its depth (m)."""
    points, depth = profiles.inclined_rail()
    step = 2e-5
    position = np.arange(np.ceil(points[0] / step), np.floor(points[-1] / step)) * step
    return position, np.interp(position, points, depth)


def section(shift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cross-section of an S1002 wheel on 60E1 at 1:40, shifted towards its flange by `shift` (m).

    Returns distance from the track centre (m), height of the wheel profile, radius less the nominal one (m), its slope
    (-) and depth of the rail below its top (m), each of shape (n,).
    """
    position, depth = _rail()
    height, slope = profiles.s1002(position - profiles.TAPE_CIRCLE - shift)
    return position, height, -slope, depth


@stored
def pair_table(radius: float, load: float, modulus: float, stiffness: float) -> ContactTable:
    """Contact table of S1002 on 60E1 at 1:40, averaged over the elastic patch, each tenth of a millimetre.

    The effective radius is the integral of the mean slope, so that at nominal load the normal forces of the patch have
    the resultant that the table gives. The Hertz stiffness is the same at every shift: one that changed with the shift
    would need a lateral force of its own, or the contact would make energy.

    Args:
        radius (float): Nominal rolling radius (m).
        load, modulus (float): Normal force (N), contact modulus E* (Pa).
        stiffness (float): Hertz stiffness (N/m^1.5).

    Source: Kalker 1990, Three-Dimensional Elastic Bodies in Rolling Contact (half spaces, coefficients).
    """
    shifts = np.arange(-150, 121) * 1e-4
    patches = [normal.elastic_contact(*section(shift), radius, load, modulus) for shift in shifts]
    position, height, slope = np.array([(patch.position, patch.height, patch.slope) for patch in patches]).T
    a, b, coefficients = zip(*(strip_coefficients(patch.half_lengths, patch.strips) for patch in patches), strict=True)
    centre = int(np.argmin(np.abs(shifts)))
    depth_at_contact = np.interp(position[centre], *_rail())
    climb = PchipInterpolator(shifts, slope).antiderivative()(shifts)
    rolling = radius + height
    columns = {
        "shift_m": shifts,
        "effective_radius_m": rolling[centre] - depth_at_contact + climb - climb[centre],
        "angle_rad": np.arctan(slope),
        "rolling_radius_m": rolling,
        "rail_contact_m": position - profiles.TAPE_CIRCLE,
        **dict(zip(_PATCH, (a, b, *np.transpose(coefficients)), strict=True)),
        "normal_stiffness": stiffness,
    }
    return ContactTable(pd.DataFrame(columns))


def equivalent_conicity(frame: pd.DataFrame, amplitude: float) -> float:
    """Equivalent conicity (-): of the cone on which a wheelset oscillates by `amplitude` (m) with the same wavelength.

    The wheelset follows y'' = -(r_ri - r_le)/(b r_0) along the track, without roll. `frame` has columns shift_m, at
    least over the amplitude to both sides, and rolling_radius_m. 0 where the radii do not bring the wheelset back.

    Source: EN 15302, by integration of the equation of motion (quarter of a wave from its energy integral).
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
