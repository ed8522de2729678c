"""Kinematics of the car: rotations, the track at a body, position and motion of the body. Serves the paper's section
Coordinate Frames, for the plant."""

from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca

from railrepro.quantities import Scalar, named, names, pack
from railrepro.track import route
from railrepro.track.irregularity import CHANNELS


@dataclass(frozen=True)
class Coordinates:
    """State of a rigid body: position and angles (yaw, pitch, roll) in the track frame, velocity, angular velocity."""

    s: Annotated[Scalar, "m", "track coordinate"]
    y: Annotated[Scalar, "m", "lateral position in the track frame at s"]
    z: Annotated[Scalar, "m", "vertical position in the track frame at s"]
    psi: Annotated[Scalar, "rad", "yaw angle against the track frame"]
    pitch: Annotated[Scalar, "rad", "pitch angle against the track frame"]
    phi: Annotated[Scalar, "rad", "roll angle against the track frame"]
    vx: Annotated[Scalar, "m/s", "absolute velocity in track-frame components"]
    vy: Annotated[Scalar, "m/s"]
    vz: Annotated[Scalar, "m/s"]
    wx: Annotated[Scalar, "rad/s", "absolute angular velocity in body axes"]
    wy: Annotated[Scalar, "rad/s"]
    wz: Annotated[Scalar, "rad/s"]


COORDINATES = names(Coordinates)


def rotation(axis: str, angle: ca.SX) -> ca.SX:
    """Return the matrix (3, 3) of a rotation about "x", "y" or "z" by an angle (rad), from turned to original frame."""
    c, s = ca.cos(angle), ca.sin(angle)
    entries: Any = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return ca.vertcat(*[ca.horzcat(*row) for row in entries])


def orientation(yaw: ca.SX, pitch: ca.SX, roll: ca.SX) -> ca.SX:
    """Return the matrix Rz(yaw) Ry(pitch) Rx(roll), shape (3, 3), of angles in rad: from turned to original frame.
    Source: eq. (1)."""
    return rotation("z", yaw) @ rotation("y", pitch) @ rotation("x", roll)


class Section:
    """The track at a coordinate s (m), as CasADi expressions; `row` are the coefficients `route.COLUMNS` of the route's
    interval around s. Source: eq. (3), with the rotation of eq. (1).

    Attributes:
        psi, phi, eps (SX): Heading, cant angle and inclination of the track (rad).
        kappa, dphi, deps (SX): Derivatives of psi, phi, eps with respect to s (rad/m).
        rotation (SX, shape (3, 3)): From track-frame to inertial components.
        position (SX, shape (3, 1)): Origin of the track frame in inertial components (m).
        curvature (SX, shape (3, 1)): Rotation of the track frame per metre of track, in its own axes (rad/m).
        lateral, vertical, gauge, crosslevel (SX): Irregularities (m; crosslevel rad).
        irregularity_rates (dict): Name of an irregularity -> its derivative by s (-; crosslevel rad/m).
        poor (dict): Rail "le" or "ri" -> weight (SX, 0 to 1) of the poor adhesion set against the good one.
    """

    def __init__(self, s: ca.SX, row: ca.SX):
        cell = named(route.COLUMNS, row)
        self.psi, self.kappa, self.phi, self.dphi, self.eps, self.deps = route.track_in(cell, s)
        self.rotation = orientation(self.psi, self.eps, self.phi)
        self.position = ca.vertcat(cell["x"], cell["y"], cell["z"]) + self._travel(cell, s - cell["p"])
        irregularity = {name: route.irregularity_in(cell, name, s) for name in CHANNELS}
        self.lateral, self.vertical, self.crosslevel, self.gauge = (value for value, _ in irregularity.values())
        self.irregularity_rates = {name: slope for name, (_, slope) in irregularity.items()}
        self.poor = {"le": cell["poor_le"], "ri": cell["poor_ri"]}
        sin, cos = ca.sin, ca.cos
        self.curvature = ca.vertcat(
            self.dphi - sin(self.eps) * self.kappa,
            cos(self.phi) * self.deps + sin(self.phi) * cos(self.eps) * self.kappa,
            -sin(self.phi) * self.deps + cos(self.phi) * cos(self.eps) * self.kappa,
        )

    @staticmethod
    def _travel(cell: dict[str, ca.SX], d: ca.SX) -> ca.SX:
        """Expand the displacement (m) from the start of the cell to d (m) further in a Taylor series of third order."""
        q = ca.SX.sym("q")
        psi = cell["psi"] + (cell["kappa"] + cell["dkappa"] * q / 2) * q
        eps = cell["eps"] + cell["deps"] * q
        tangent = [ca.vertcat(ca.cos(eps) * ca.cos(psi), ca.cos(eps) * ca.sin(psi), -ca.sin(eps))]
        for _ in range(2):
            tangent.append(ca.jacobian(tangent[-1], q))
        at_start = [ca.substitute(term, q, 0) for term in tangent]
        return d * (at_start[0] + d / 2 * (at_start[1] + d / 3 * at_start[2]))


class Body(Coordinates):
    """Position and motion of a rigid body with the state `state`, as CasADi expressions; `row` is its row of the route.

    Attributes:
        s, y, z, psi, pitch, phi, vx, vy, vz, wx, wy, wz (SX): The fields of `state` (m, rad, m/s, rad/s).
        section (Section): The track at s.
        rotation, attitude (SX, shape (3, 3)): From body axes to the track frame; from body axes to the inertial frame.
        position (SX, shape (3, 1)): Centre of gravity in inertial components (m).
        v, w (SX, shape (3, 1)): Velocity in track-frame components (m/s); angular velocity in body axes (rad/s).
        frame_rate (SX, shape (3, 1)): Angular velocity of the track frame at the body, in track-frame axes (rad/s).
        sdot (SX): Speed along the track (m/s).
        rates (dict): Name of a coordinate (s, y, z, psi, pitch, phi) -> its time derivative (m/s, rad/s).

    Source: Goldstein, Poole and Safko 2002, Classical Mechanics, ch. 4 (rates of the angles, rotating frame).
    """

    def __init__(self, state: Coordinates, row: ca.SX):
        super().__init__(*pack(state))
        self.section = Section(self.s, row)
        self.rotation = orientation(self.psi, self.pitch, self.phi)
        self.v: Any = ca.vertcat(self.vx, self.vy, self.vz)
        self.w: Any = ca.vertcat(self.wx, self.wy, self.wz)
        curvature = self.section.curvature
        self.sdot = self.vx / (1 + curvature[1] * self.z - curvature[2] * self.y)
        self.frame_rate = curvature * self.sdot
        relative = self.w - self.rotation.T @ self.frame_rate
        psidot = (relative[1] * ca.sin(self.phi) + relative[2] * ca.cos(self.phi)) / ca.cos(self.pitch)
        self.rates = {
            "s": self.sdot,
            "y": self.vy + self.frame_rate[0] * self.z,
            "z": self.vz - self.frame_rate[0] * self.y,
            "psi": psidot,
            "pitch": relative[1] * ca.cos(self.phi) - relative[2] * ca.sin(self.phi),
            "phi": relative[0] + psidot * ca.sin(self.pitch),
        }
        self.attitude = self.section.rotation @ self.rotation
        self.position = self.section.position + self.section.rotation @ ca.vertcat(0, self.y, self.z)

    def derivatives(self, force: ca.SX, moment: ca.SX, mass: ca.SX, inertia: ca.SX, spin: ca.SX | float = 0) -> ca.SX:
        """Compute the time derivatives of `COORDINATES` by the equations of Newton and Euler (SI), shape (12, 1). The
        force (3, 1) is in track-frame components, the moment (3, 1) about the centre of gravity in body axes. `inertia`
        (3, 1) has the principal moments, `spin` is the angular momentum of rotors on the body about its y axis (kg
        m2/s). Source: Wittenburg 2008, Dynamics of Multibody Systems (gyrostat)."""
        momentum = inertia * self.w + ca.vertcat(0, spin, 0)
        rates = self.rates | named(("vx", "vy", "vz"), force / mass - ca.cross(self.frame_rate, self.v))
        rates |= named(("wx", "wy", "wz"), (moment - ca.cross(self.w, momentum)) / inertia)
        return ca.vertcat(*(rates[name] for name in COORDINATES))
