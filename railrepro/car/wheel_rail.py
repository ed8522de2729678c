"""Forces between a wheel and its rail: position of the contact, creepages, normal and creep force. Serves the paper's
section Train-Track Interaction, for the plant."""

from typing import Any

import casadi as ca

from railrepro.car.integrator import Stages
from railrepro.car.kinematics import Body, rotation
from railrepro.contact.creep import polach
from railrepro.contact.table import CELL_COLUMNS, in_cell
from railrepro.quantities import named, pack

_SIGN = {"le": -1, "ri": 1}  # Side of a wheel, positive to the right


def shift_to_flange(gear: Body, side: str, par: Any) -> ca.SX:
    """Compute the lateral shift of the wheel on side "le" or "ri" on its rail, positive towards the flange (m), with
    which the contact table is looked up. `gear` is the wheel carrier, `par` an `equations.CarParameters`."""
    sign = _SIGN[side]
    return sign * (sign * par.gear.contact_base / 2 - _rail_in_axle(gear, sign, par)[0])


def _rail_in_axle(gear: Body, sign: int, par: Any) -> tuple[ca.SX, ca.SX]:
    """Compute the lateral and vertical coordinate of the rail in the axes of the unpitched axle (m)."""
    y = sign * (par.gear.contact_base + gear.section.gauge) / 2 + gear.section.lateral - gear.y
    z = gear.section.vertical + sign * par.gear.contact_base / 2 * gear.section.crosslevel - gear.z
    across = y / ca.cos(gear.psi)
    return ca.cos(gear.phi) * across + ca.sin(gear.phi) * z, -ca.sin(gear.phi) * across + ca.cos(gear.phi) * z


def _rail_slopes(gear: Body, sign: int, par: Any) -> tuple[ca.SX, ca.SX]:
    """Compute the slopes of the irregular rail to the right and downwards along the track (-)."""
    rates = gear.section.irregularity_rates
    sinking = rates["vertical"] + sign * par.gear.contact_base / 2 * rates["crosslevel"]
    return rates["lateral"] + sign * rates["gauge"] / 2, sinking


class _Axes:
    """Unit vectors of a contact in the axes of the unpitched axle, where rail and profile do not depend on the pitch.

    Attributes:
        to_track, to_carrier (SX, shape (3, 3)): From these axes to the track frame, and to the axes of the carrier.
        tangent, lateral, normal (SX, shape (3, 1)): Along the rail, across it in the contact plane, normal to both.
    """

    def __init__(self, gear: Body, sign: int, slope: ca.SX, cos_angle: ca.SX, par: Any):
        self.to_track = rotation("z", gear.psi) @ rotation("x", gear.phi)
        self.to_carrier = rotation("x", -gear.phi) @ rotation("y", -gear.pitch) @ rotation("x", gear.phi)
        curvature, base = gear.section.curvature, sign * par.gear.contact_base / 2
        lateral_slope, vertical_slope = _rail_slopes(gear, sign, par)
        sinking = curvature[0] * base + vertical_slope
        tangent = ca.vertcat(1, ca.vertcat(lateral_slope, sinking) / (1 - curvature[2] * base))
        self.tangent = self.to_track.T @ (tangent / ca.norm_2(tangent))
        normal = ca.vertcat(0, sign * slope * cos_angle, cos_angle)
        normal -= self.tangent * ca.dot(self.tangent, normal)
        self.normal = normal / ca.norm_2(normal)
        self.lateral = ca.cross(self.normal, self.tangent)


class Contact:
    """Contact of a wheel with its rail: normal force with damping and lift-off, creepages, creep force.

    `gear` is the wheel carrier, `side` "le" (left) or "ri" (right), `speed` the absolute angular speed of the wheel
    (rad/s), positive when rolling forward. `row` is a row of the contact table, `par` an `equations.CarParameters`;
    `stages` puts symbols in place of motion and forces, so that the Jacobian of the car is cheap.

    Attributes:
        sliding, creepage (pair of SX): Sliding speeds along and across the rail (m/s); both over the running speed (-).
        spin_rate, spin (SX): Angular speed about the contact normal (rad/s); spin_rate over the running speed (1/m).
        force (SX, shape (3, 1)): Force on the wheel in track-frame components (N).
        moment (SX, shape (3, 1)): Moment on the carrier about its centre of gravity, in carrier axes (N m).
        normal, spin_moment (SX): Normal force (N), moment about the contact normal (N m).
        tangential (list of 2 SX): Creep forces along and across the rail (N).
        angle (SX): Contact angle (rad).
        energy, dissipation, friction_loss (SX): Elastic energy (J), power lost to damping and to creep (W).

    Source: eq. (4); Kalker 1990, Three-Dimensional Elastic Bodies in Rolling Contact (creepages).
    """

    def __init__(self, gear: Body, side: str, speed: ca.SX, row: ca.SX, par: Any, stages: Stages):
        sign, cell = _SIGN[side], named(CELL_COLUMNS, row)
        offset = shift_to_flange(gear, side, par) - cell["shift"]
        at, (rail_y, rail_z) = in_cell(cell, offset), _rail_in_axle(gear, sign, par)
        cos_angle = 1 / ca.sqrt(1 + at["slope"] ** 2)
        self.gear, self.angle = gear, ca.atan(at["slope"])
        self.penetration = (at["effective_radius"] - rail_z) * cos_angle
        axes = _Axes(gear, sign, at["slope"], cos_angle, par)
        # A wheel is a body of revolution, so the normal meets its axis. On a rail that climbs against the axle (cant
        # ramp) the contact lies ahead of or behind the lowest point.
        ahead = axes.normal[0] / axes.normal[2]
        depth = at["rolling_radius"] - self.penetration / cos_angle
        at_contact = ca.vertcat(ahead * depth, rail_y + sign * at["rail_contact"], depth)
        moving = ca.vertcat(gear.y, gear.z, gear.psi, gear.phi)
        rates = ca.vertcat(*(gear.rates[name] for name in ("y", "z", "psi", "phi")))
        rates -= ca.vertcat(*_rail_slopes(gear, sign, par), 0, 0) * gear.sdot
        motion = [offset, self.penetration, ca.jtimes(self.penetration, moving, rates)]
        motion += self._sliding(speed, at_contact, axes, par)
        forces = self._forces(stages.hold(*motion), cell, gear.section.poor[side], par)
        self.normal, self.spin_moment, *self.tangential = stages.hold(*forces)
        self._act(ca.vertcat(ahead * rail_z, rail_y, rail_z), at_contact, axes)

    def _sliding(self, speed: ca.SX, at_contact: ca.SX, axes: _Axes, par: Any) -> list[ca.SX]:
        """Compute the sliding speeds along and across the rail (m/s), the angular speed about the normal (rad/s) and
        the running speed (m/s), which is not 0 at standstill."""
        spin = axes.to_carrier.T @ ca.vertcat(self.gear.wx, -speed, self.gear.wz)
        # the axis of the wheel passes through the centre of gravity of the carrier
        slide = axes.to_track.T @ self.gear.v + ca.cross(spin, at_contact)
        rolling_speed = ca.sqrt(self.gear.vx**2 + par.contact.rest_speed**2)
        return [ca.dot(slide, axes.tangent), ca.dot(slide, axes.lateral), ca.dot(spin, axes.normal), rolling_speed]

    def _act(self, at_normal: ca.SX, at_contact: ca.SX, axes: _Axes) -> None:
        """Set `force`, `moment` and `friction_loss` of normal and creep force, which act at these two points (m)."""
        creep_force = axes.tangent * self.tangential[0] + axes.lateral * self.tangential[1]
        normal_force = -axes.normal * self.normal
        resultant = ca.vertcat(*self.tangential, self.spin_moment)
        self.friction_loss = -ca.dot(resultant, ca.vertcat(*self.sliding, self.spin_rate))
        # the y component of this moment about the centre of gravity of the carrier turns the wheel alone
        moment = ca.cross(at_contact, creep_force) + ca.cross(at_normal, normal_force) + axes.normal * self.spin_moment
        self.force, self.moment = axes.to_track @ (creep_force + normal_force), axes.to_carrier @ moment

    def _forces(self, motion: list[ca.SX], cell: dict[str, ca.SX], poor: ca.SX, par: Any) -> list[ca.SX]:
        """Compute normal force, spin moment, and creep forces along and across the rail from the motion of the contact.
        Source: Johnson 1985, Contact Mechanics, section 4.2 (normal force); Hunt and Crossley 1975 (its damping)."""
        offset, penetration, rate, *self.sliding, self.spin_rate, rolling_speed = motion
        at = in_cell(cell, offset)
        compression = ca.fmax(penetration, 0)
        elastic = at["normal_stiffness"] * compression * ca.sqrt(compression + 1e-20)
        normal = ca.fmax(elastic * (1 + par.contact.normal_damping * rate), 0)
        self.energy = elastic * compression / 2.5
        self.dissipation = (normal - elastic) * rate
        self.creepage = (self.sliding[0] / rolling_speed, self.sliding[1] / rolling_speed)
        self.spin = self.spin_rate / rolling_speed
        scale = ((normal + 1) / par.contact.nominal_load) ** (1 / 3)
        sets = zip(pack(par.adhesion.good), pack(par.adhesion.poor), strict=True)
        adhesion = [on_good * (1 - poor) + on_poor * poor for on_good, on_poor in sets]
        slip_speed = ca.sqrt(self.sliding[0] ** 2 + self.sliding[1] ** 2 + 1e-12)
        creep = (
            *self.creepage, self.spin, normal, at["semi_axis_x"] * scale, at["semi_axis_y"] * scale,
            at["c11"], at["c22"], at["c23"], at["c33"], par.contact.shear_modulus, *adhesion, slip_speed,
        )  # fmt: skip
        *tangential, moment = polach(*creep)
        return [normal, moment, *tangential]
