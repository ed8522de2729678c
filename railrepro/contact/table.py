"""Wheel-rail contact as a table over the lateral shift of the wheel: cone on a line rail, or S1002 on 60E1 at 1:40. A
rigid S1002 wheel touches a rigid rail at a point that jumps by 12 mm when the wheel is near the centre; under load the
contact patch spans the jump. So the geometry is averaged over the pressure of elastic half spaces at nominal load. Off
centre, the weight drives a running gear back and spin creep drives it away; the net force is a fifth of each, and
within 15 % of that of half spaces. The normal force acts at a fixed line of the rail. If it moved with the patch, the
lateral error of a gear without flange contact would change by less than 1 %. Serves the paper's eqs. (10), (11) (cone)
and section Simulation Environment."""

from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline, PchipInterpolator

from railrepro.compile.codegen import for_c, stored
from railrepro.contact import normal, profiles
from railrepro.contact.creep import elementary, kalker_coefficients, strip_coefficients
from railrepro.data import InputError, require
from railrepro.vehicle.parameters import Vehicle

_ELLIPSE = ("semi_axis_x", "semi_axis_y", "c11", "c22", "c23", "c33")
_LINEAR = ("rolling_radius", "rail_contact", *_ELLIPSE, "normal_stiffness")
_USED = ("shift", "effective_radius", "angle_rad", *_LINEAR)  # columns, without units, that determine the cells
_CUBIC = ("shift", "width", "effective_radius", "radius_slope", "radius_square", "radius_cube")
CELL_COLUMNS = (*_CUBIC, *(column for name in _LINEAR for column in (name, f"d{name}")))
"""Entries of a cell of the table (SI): shift at its start, its width, the coefficients of the effective radius as a
cubic in the offset from the start; for each other quantity its value at the start and its slope (d…) over the shift."""
_BEYOND = 1e-12  # cells extend so far beyond their ends (m) that a node, even if rounded, has their derivatives
_PATCH = ("semi_axis_x_m", "semi_axis_y_m", *_ELLIPSE[2:])


@dataclass(frozen=True)
class ContactTable:
    """Contact quantities over the lateral shift of a wheel towards its flange. `frame` has one row per shift, uniformly
    spaced. Columns: shift_m; effective_radius_m (height of the axle above the rail at which the wheel touches; the
    normal force follows from it, and is conservative as its slope is the tangent of the contact angle); angle_rad
    (contact angle); rolling_radius_m (at which the wheel rolls; creepages follow from it); rail_contact_m (lateral
    position of the contact on the rail, from half the contact base, positive to the field side); semi_axis_x_m,
    semi_axis_y_m (of the contact ellipse at nominal load, along and across the rail); Kalker's c11, c22, c23, c33 (-);
    normal_stiffness (N/m^1.5)."""

    frame: pd.DataFrame

    def cells(self) -> np.ndarray:
        """Coefficients to interpolate between the n rows of `frame`, shape (n - 1, len(CELL_COLUMNS)), SI, read-only.
        Row i covers the shifts from row i to row i + 1 of `frame`. The effective radius is a cubic with continuous
        slope, all else is linear. InputError if `frame` lacks a column, has a value that is not a finite number, or its
        shifts are not uniformly spaced from below to above 0. Source: de Boor, A Practical Guide to Splines, ch. IV."""
        require("contact table: frame", self.frame, pd.DataFrame)
        given = {name.removesuffix("_m"): column for name, column in self.frame.items()}
        used = [for_c(f"contact table: {name}", given.get(name), (len(self.frame),)) for name in _USED]
        return _cells(np.array(used).tobytes())


@lru_cache(maxsize=16)
def _cells(content: bytes) -> np.ndarray:
    """Cells of a table whose columns `_USED` have these values. A frame may be edited, so it is no key of a cache."""
    quantities = dict(zip(_USED, np.frombuffer(content).reshape(len(_USED), -1), strict=True))
    shift, radius = quantities["shift"], quantities["effective_radius"]
    slope, h = np.tan(quantities["angle_rad"]), np.diff(shift)
    if not (shift.size > 2 and shift[0] < 0 < shift[-1] and h[0] > 0 and np.ptp(h) <= 1e-6 * h[0]):
        raise InputError("contact table: shift_m has to increase in equal steps from below to above 0")
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
    cells = np.ascontiguousarray(np.array([columns[name] for name in CELL_COLUMNS]).T)
    cells.flags.writeable = False  # cars share it
    return cells


def in_cell(cell: dict, offset) -> dict:
    """Contact quantities of a wheel from `cell`, a row of `ContactTable.cells` as a dict: `CELL_COLUMNS` -> values. A
    wheel that hits its flange may leave the row by several widths in a stage of the integrator. There the effective
    radius and the rolling radius continue along their tangents, and all else is constant. So the effective radius
    remains the integral of its slope, and the contact generates no energy. `offset` is the shift minus the shift at the
    start of the row (m). `offset` and the values of `cell` are numbers, arrays or symbols. The result is a dict:
    effective_radius (m), slope (its derivative, the tangent of the contact angle, -), rolling_radius, rail_contact,
    semi_axis_x, semi_axis_y (m), c11, c22, c23, c33 (-), normal_stiffness (N/m^1.5)."""
    first, square, cube = (cell[f"radius_{name}"] for name in ("slope", "square", "cube"))
    m = elementary(offset)
    inside = m.fmin(m.fmax(offset, -_BEYOND), cell["width"] + _BEYOND)
    slope = first + inside * (2 * square + inside * 3 * cube)
    beyond = slope * (offset - inside)
    at = {name: cell[name] + cell[f"d{name}"] * inside for name in _LINEAR}
    at["effective_radius"] = cell["effective_radius"] + inside * (first + inside * (square + inside * cube)) + beyond
    return at | {"slope": slope, "rolling_radius": at["rolling_radius"] + beyond}


def contact_table(profile: str, vehicle: Vehicle) -> ContactTable:
    """Make the table of contact angle, rolling radius and patch over lateral shift, for the wheel profile "cone" or
    "s1002" with radius, load and material of a vehicle. InputError for another profile."""
    material = vehicle.contact
    modulus = material.young / (2 * (1 - material.poisson**2))
    if profile == "cone":
        return _cone(vehicle, modulus)
    if profile != "s1002":
        raise InputError(f"profile {profile!r} is not known; there are cone and s1002")
    load, stiffness = material.nominal_load, material.normal_stiffness
    return pair_table(vehicle.wheel.radius, load, modulus, material.poisson, stiffness)


def middle_patch(vehicle: Vehicle) -> tuple[float, float, tuple[float, ...]]:
    """Contact ellipse of a wheel of the vehicle centred in the track, at nominal load: semi-axes along and across the
    rail (m), and the tuple of Kalker's c11, c22, c23, c33 (-)."""
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    a, b, *coefficients = frame.loc[frame["shift_m"].abs().argmin(), [*_PATCH]].tolist()
    return a, b, tuple(coefficients)


def _cone(vehicle: Vehicle, modulus: float) -> ContactTable:
    """Cone on a line-shaped rail: r = r0 + u tan(delta0), ellipse of the rail's crown. Source: eqs. (10), (11)."""
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
        **dict(zip(_PATCH, (a, b, *kalker_coefficients(a / b, vehicle.contact.poisson)), strict=True)),
        "normal_stiffness": vehicle.contact.normal_stiffness,
    }
    return ContactTable(pd.DataFrame(columns))


@cache
def _rail() -> tuple[np.ndarray, np.ndarray]:
    """Uniform lateral grid over the rail head, and depth of the head (m)."""
    points, depth = profiles.inclined_rail()
    step = 2e-5
    position = np.arange(np.ceil(points[0] / step), np.floor(points[-1] / step)) * step
    return position, np.interp(position, points, depth)


def section(shift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cross-section of an S1002 wheel, shifted towards its flange by `shift` (m), on 60E1 at 1:40: arrays of shape
    (n,): lateral distance from the track centre (m); radius of the wheel profile minus the nominal radius (m); slope of
    the profile (-), positive where the radius grows towards the flange; depth of the rail below its top (m)."""
    position, depth = _rail()
    height, slope = profiles.s1002(position - profiles.TAPE_CIRCLE - shift)
    return position, height, -slope, depth


@stored
def pair_table(radius: float, load: float, modulus: float, poisson: float, stiffness: float) -> ContactTable:
    """Table of S1002 on 60E1 at 1:40, averaged over the elastic patch, with a row every 0.1 mm. Arguments: nominal
    rolling radius (m), normal force (N), contact modulus E* (Pa), Poisson's ratio (-), Hertz stiffness (N/m^1.5). The
    stiffness is the same at every shift, otherwise the contact would generate energy. Source: Kalker 1990,
    Three-Dimensional Elastic Bodies in Rolling Contact."""
    shifts = np.arange(-150, 121) * 1e-4
    patches = [normal.elastic_contact(*section(shift), radius, load, modulus) for shift in shifts]
    position, height, slope = np.array([(patch.position, patch.height, patch.slope) for patch in patches]).T
    strips = [strip_coefficients(patch.half_lengths, patch.strips, poisson) for patch in patches]
    a, b, coefficients = zip(*strips, strict=True)
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
    """Equivalent conicity (-): slope of cones on which a wheelset would oscillate with the same wavelength at a lateral
    amplitude (m); 0 if the wheelset does not return. `frame` has the columns rolling_radius_m and shift_m, which covers
    the amplitude on both sides. The motion follows y'' = -(r_ri - r_le)/(b r_0) along the track, without roll; b and
    r_0 cancel out. Source: EN 15302, by integration of the equation of motion."""
    y = np.linspace(0.0, amplitude, 4001)
    right, left = (np.interp(side * y, frame["shift_m"], frame["rolling_radius_m"]) for side in (1, -1))
    potential = CubicSpline(y, right - left).antiderivative()
    phase = (np.arange(4000) + 0.5) * np.pi / 8000
    energy = potential(amplitude) - potential(amplitude * np.sin(phase))
    if energy.min() <= 0:
        return 0.0
    quarter = np.mean(amplitude * np.cos(phase) / np.sqrt(2 * energy)) * np.pi / 2
    return float((np.pi / 2 / quarter) ** 2 / 2)
