"""Outputs of the car, the columns of a run's log. Serves the paper's eqs. (18) to (20) and (4): psi_Ax, psi_TrAx,
y_TrAx; f_x, s_x."""

from dataclasses import dataclass
from typing import Annotated

from railrepro.data import between
from railrepro.quantities import Scalar

DERAILED = 0.030
"""Lateral displacement of a running gear, to either side, at which it derails (m)."""


@dataclass(frozen=True)
class GearStates:
    """State of a running gear, which the controllers measure: track coordinate p, heading psi_Ax, speed v, yaw rate
    psidot_Ax, lateral displacement y and yaw angle psi_TrAx against the track. The ranges are wider than any run."""

    p: Annotated[Scalar, between(-1e6, 1e6, "m"), "track coordinate"]
    psi_Ax: Annotated[Scalar, between(-1e3, 1e3, "rad"), "heading"]
    v: Annotated[Scalar, between(-1.0, 150.0, "m/s"), "speed along the track"]
    psidot_Ax: Annotated[Scalar, between(-10.0, 10.0, "rad/s"), "yaw rate"]
    y: Annotated[Scalar, between(-DERAILED, DERAILED, "m"), "lateral displacement from the track"]
    psi_TrAx: Annotated[Scalar, between(-1.0, 1.0, "rad"), "yaw angle against the track"]


@dataclass(frozen=True)
class GearOutputs(GearStates):
    """Outputs for a running gear: its state, its roll angle, and the lateral irregularity of the rails below it."""

    phi: Annotated[Scalar, "rad", "roll angle against the track"]
    rail_y: Annotated[Scalar, "m", "lateral offset of the rails from the ideal track"]


@dataclass(frozen=True)
class WheelOutputs:
    """Outputs for a wheel and its contact with the rail: speed, motor torque, contact forces, creepages, angle."""

    w: Annotated[Scalar, "rad/s", "angular speed"]
    tau: Annotated[Scalar, "N m", "motor torque"]
    N: Annotated[Scalar, "N", "normal force"]
    Fx: Annotated[Scalar, "N", "creep force along the rail"]
    Fy: Annotated[Scalar, "N", "creep force across the rail"]
    adhesion: Annotated[Scalar, "-", "Fx/N"]
    sx: Annotated[Scalar, "-", "slip (v - w r)/v"]
    nu_x: Annotated[Scalar, "-", "creepage along the rail"]
    nu_y: Annotated[Scalar, "-", "creepage across the rail"]
    spin: Annotated[Scalar, "1/m", "spin creepage, about the normal"]
    M_spin: Annotated[Scalar, "N m", "moment of spin"]
    angle: Annotated[Scalar, "rad", "contact angle"]


@dataclass(frozen=True)
class SuspensionOutputs:
    """Outputs for the suspension of a running gear: its yaw angle and lateral deflection against the car body."""

    yaw_to_body: Annotated[Scalar, "rad", "yaw angle of the running gear against the car body"]
    sway: Annotated[Scalar, "m", "lateral deflection"]


@dataclass(frozen=True)
class BodyOutputs:
    """Outputs for the car body: track coordinate, displacements and angles against the track, and speed."""

    s: Annotated[Scalar, "m", "track coordinate"]
    y: Annotated[Scalar, "m", "lateral displacement"]
    z: Annotated[Scalar, "m", "vertical displacement"]
    psi: Annotated[Scalar, "rad", "yaw angle"]
    pitch: Annotated[Scalar, "rad", "pitch angle"]
    phi: Annotated[Scalar, "rad", "roll angle"]
    vx: Annotated[Scalar, "m/s", "speed"]


@dataclass(frozen=True)
class FloorOutputs:
    """Acceleration that an accelerometer at a point of the floor reads, in axes of the car body: at rest az is -g."""

    ax: Annotated[Scalar, "m/s2"]
    ay: Annotated[Scalar, "m/s2"]
    az: Annotated[Scalar, "m/s2"]


@dataclass(frozen=True)
class Outputs:
    """All outputs of the car: both running gears, four wheels (left and right: "le", "ri"), suspensions, car body, and
    the accelerations at three points of the floor. Names are such as "front.y", "front_le.N" and "floor_rear.ay"."""

    front: GearOutputs
    rear: GearOutputs
    front_le: WheelOutputs
    front_ri: WheelOutputs
    rear_le: WheelOutputs
    rear_ri: WheelOutputs
    front_suspension: Annotated[SuspensionOutputs, "front"]
    rear_suspension: Annotated[SuspensionOutputs, "rear"]
    body: BodyOutputs
    floor_front: FloorOutputs
    floor_centre: FloorOutputs
    floor_rear: FloorOutputs
