"""Outputs of the car, which are the columns of a run's log: names and units. Serves the paper's eqs. (18) to (20) and
(4): psi_Ax, psi_TrAx, y_TrAx; f_x, s_x."""

from __future__ import annotations

from typing import Annotated

from railrepro.quantities import WHEELS, group

_STATES = "p m, psi_Ax rad, v m/s, psidot_Ax rad/s, y m, psi_TrAx rad"
GearOutputs = group("GearOutputs", _STATES, "phi rad, rail_y m")
"""States of a running gear in the order of the control model: track coordinate p (m), heading psi_Ax (rad), speed
along the track v (m/s), yaw rate psidot_Ax (rad/s), lateral displacement y (m) and yaw angle psi_TrAx (rad) against
the track. Then roll against the track phi (rad) and lateral offset of the rails from the ideal track rail_y (m)."""
WheelOutputs = group(
    "WheelOutputs",
    "w rad/s, tau N m, N N, Fx N, Fy N, adhesion -, sx -, nu_x -, nu_y -, spin 1/m, M_spin N m, angle rad",
)
"""Speed w (rad/s) and motor torque tau (N m) of a wheel; normal force N, creep forces along and across the rail Fx,
Fy (N); adhesion Fx/N and slip sx = (v - w r)/v (-); creepages nu_x, nu_y along and across (-) and spin (1/m) about
the normal; moment of spin M_spin (N m); contact angle (rad)."""
SuspensionOutputs = group("SuspensionOutputs", "yaw_to_body rad, sway m")
"""Yaw of a gear against the car body (rad), and lateral deflection of its suspension `sway` (m)."""
BodyOutputs = group("BodyOutputs", "s m, y m, z m, psi rad, pitch rad, phi rad, vx m/s")
"""Track coordinate s, displacements y, z (m), angles psi, pitch, phi (rad) and speed vx (m/s) of the car body."""
FloorOutputs = group("FloorOutputs", "ax m/s2, ay m/s2, az m/s2")
"""Acceleration ax, ay, az of a point of the floor in axes of the car body (m/s2) as an accelerometer reads it: at
rest az is -g."""
Outputs = group(
    "Outputs",
    {"front": GearOutputs, "rear": GearOutputs},
    dict.fromkeys(WHEELS, WheelOutputs),
    {"front_suspension": Annotated[SuspensionOutputs, "front"]},
    {"rear_suspension": Annotated[SuspensionOutputs, "rear"]},
    {"body": BodyOutputs, "floor_front": FloorOutputs, "floor_centre": FloorOutputs, "floor_rear": FloorOutputs},
)
"""All outputs of the car; `quantities.names` gives their names, such as "front.y", "front_le.N" and "floor_rear.ay"."""
