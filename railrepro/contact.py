"""Wheel-rail contact as a table over the lateral shift of the wheel: cone on a line rail, or S1002 on 60E1 at 1:40.

The plant needs, at each shift u (positive towards the flange): the radius of the equivalent wheel on a knife-edge rail
(its slope is the tangent of the contact angle, so the normal force is conservative), the true rolling radius and
contact position, the contact ellipse, Kalker coefficients and Hertz stiffness.

Serves the paper's eq. (z_and_phi) (cone) and section Simulation Environment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from railrepro.creep import kalker_coefficients
from railrepro.errors import InputError
from railrepro.parameters import Vehicle

_LINEAR = (
    *("rolling_radius_m", "wheel_contact_m", "semi_axis_x_m", "semi_axis_y_m"),
    *("c11", "c22", "c23", "normal_stiffness"),
)
CONE_AXES = (6.28e-3, 7.02e-3)
"""Semi-axes of the contact ellipse of the cone at nominal load, along and across the rail (m)."""


@dataclass(frozen=True)
class ContactTable:
    """Contact quantities over the shift of a wheel towards its flange.

    Attributes
    ----------
    name : str
    frame : DataFrame
        Uniform grid `shift_m` with effective_radius_m, angle_rad, rolling_radius_m, wheel_contact_m (lateral position
        on the wheel, positive to the field side), semi_axis_x_m, semi_axis_y_m (at nominal load), c11, c22, c23,
        normal_stiffness (N/m^1.5).
    """

    name: str
    frame: pd.DataFrame

    @property
    def start(self) -> float:
        """First shift (m)."""
        return float(self.frame["shift_m"].iloc[0])

    @property
    def step(self) -> float:
        """Grid step (m)."""
        return float(self.frame["shift_m"].iloc[1] - self.start)

    def cells(self) -> np.ndarray:
        """Rows for the compiled plant, shape (n, 21).

        Shift at the start of the cell; four coefficients of the effective radius as a cubic in the offset (value and
        slope continuous); value and slope of eight further quantities.
        """
        shift = self.frame["shift_m"].to_numpy()
        h = np.diff(shift)
        radius, slope = (
            self.frame["effective_radius_m"].to_numpy(),
            np.tan(self.frame["angle_rad"].to_numpy()),
        )
        secant = np.diff(radius) / h
        square = (3 * secant - 2 * slope[:-1] - slope[1:]) / h
        cube = (slope[:-1] + slope[1:] - 2 * secant) / h**2
        columns = [shift[:-1], radius[:-1], slope[:-1], square, cube]
        for name in _LINEAR:
            values = self.frame[name].to_numpy()
            columns += [values[:-1], np.diff(values) / h]
        return np.ascontiguousarray(np.array(columns).T)


def contact_table(profile: str, vehicle: Vehicle) -> ContactTable:
    """Contact table of a profile pair ("cone" or "s1002") for a vehicle; see `ContactTable`."""
    if profile == "cone":
        return _cone(vehicle)
    raise InputError(f"contact profile {profile!r} is not known; there is 'cone'")


def _cone(vehicle: Vehicle) -> ContactTable:
    """Cone on a line-shaped rail: r = r0 + u tan(delta0), constant ellipse. Source: paper, eq. (z_and_phi)."""
    shift = np.arange(-400, 401) * 1e-4
    slope = np.tan(vehicle.wheel.cone_angle)
    a, b = CONE_AXES
    c11, c22, c23 = kalker_coefficients(a / b)
    radius = vehicle.wheel.radius + slope * shift
    constant = {
        "angle_rad": vehicle.wheel.cone_angle,
        "wheel_contact_m": 0.0,
        "semi_axis_x_m": a,
        "semi_axis_y_m": b,
        "c11": float(c11),
        "c22": float(c22),
        "c23": float(c23),
        "normal_stiffness": vehicle.contact.normal_stiffness,
    }
    frame = {"shift_m": shift, "effective_radius_m": radius, "rolling_radius_m": radius}
    return ContactTable("cone", pd.DataFrame(frame).assign(**constant))
