"""Outputs of the car, which are the columns of a run's log: names and units.

Serves the paper's eqs. (18) to (20) and (4): psi_Ax, psi_TrAx, y_TrAx; f_x, s_x.
"""

from __future__ import annotations

from typing import Annotated

from railrepro.quantities import WHEELS, group

_STATES = "p m, psi_Ax rad, v m/s, psidot_Ax rad/s, y m, psi_TrAx rad"
GearStates = group("GearStates", _STATES)
"""States of a running gear in the order of the control model: track coordinate, heading, speed along the track, yaw
rate, lateral displacement and yaw angle against the track."""
GearOutputs = group("GearOutputs", _STATES, "phi rad, rail_y m")
"""More of a running gear: roll against the track, lateral offset of the rails from the ideal track."""
WheelOutputs = group(
    "WheelOutputs",
    "w rad/s, tau N m, N N, Fx N, Fy N, adhesion -, sx -, nu_x -, nu_y -, spin 1/m, M_spin N m, angle rad",
)
"""Speed and motor torque of a wheel; normal force and creep forces along and across; adhesion (creep over normal force)
and slip (v - w r)/v; creepages along, across and about the normal; moment of spin; contact angle."""
SuspensionOutputs = group("SuspensionOutputs", "yaw_to_body rad, sway m")
"""Yaw of a gear against the car body, and lateral deflection of its suspension."""
BodyOutputs = group("BodyOutputs", "s m, y m, z m, psi rad, pitch rad, phi rad, vx m/s")
"""Track coordinate, displacements, angles and speed of the car body, see `kinematics.Coordinates`."""
FloorOutputs = group("FloorOutputs", "ax m/s2, ay m/s2, az m/s2")
"""Acceleration of a point of the floor in axes of the car body, as an accelerometer reads it."""
Outputs = group(
    "Outputs",
    {"front": GearOutputs, "rear": GearOutputs},
    dict.fromkeys(WHEELS, WheelOutputs),
    {"front_suspension": Annotated[SuspensionOutputs, "front"]},
    {"rear_suspension": Annotated[SuspensionOutputs, "rear"]},
    {"body": BodyOutputs, "floor_front": FloorOutputs, "floor_centre": FloorOutputs, "floor_rear": FloorOutputs},
)
"""All outputs of the car."""
