"""The multibody car in place of SIMPACK: 22 degrees of freedom on independently rotating wheels.

Bodies are the car body, two wheel carriers (6 degrees of freedom each) and four wheels (spin). Velocities are absolute,
in track-frame components; angular velocities are absolute, in body axes. With these quasi-velocities centrifugal,
Coriolis, cant, inclination and gyroscopic terms are exact and no second derivative of the track is needed.

State (44): per body `s y z psi theta phi vx vy vz wx wy wz` (position in its own track section, angles relative to the
track frame), wheel speeds `w` (traction-positive), motor torques `tau`. Wheel order: front_le, front_ri, rear_le,
rear_ri. Signs as in the documentation: x forward, y right, z down; torques traction-positive.

Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, reduce

import casadi as ca
import numpy as np

from railrepro.car.integrator import Stages, rodas3
from railrepro.contact.creep import polach
from railrepro.contact.table import ContactTable
from railrepro.track import route
from railrepro.vehicle.parameters import Vehicle

BODIES = ("body", "front", "rear")
WHEELS = ("front_le", "front_ri", "rear_le", "rear_ri")
COORDINATES = ("s", "y", "z", "psi", "theta", "phi", "vx", "vy", "vz", "wx", "wy", "wz")
STATES = (
    *(f"{body}.{name}" for body in BODIES for name in COORDINATES),
    *(f"w.{wheel}" for wheel in WHEELS),
    *(f"tau.{wheel}" for wheel in WHEELS),
)
CONTACT_COLUMNS = 21
_BLEND = ("k_a", "k_s", "mu0", "a_ratio", "b_decay")
_GROUPS = {
    "body": ("mass", "inertia_x", "inertia_y", "inertia_z", "cg_height", "gear_spacing"),
    "gear": ("mass", "inertia_x", "inertia_y", "inertia_z", "contact_base"),
    "wheel": ("radius", "spin_inertia"),
    "suspension": (
        *(
            "half_spacing",
            "height",
            "k_x",
            "c_x",
            "k_y",
            "c_y",
            "k_z",
            "c_z",
            "link_stiffness",
            "link_damping",
        ),
        *("antiroll_stiffness", "antiroll_damping", "pitch_stiffness", "pitch_damping"),
        *("yaw_stop_angle", "yaw_stop_stiffness", "bump_clearance", "bump_stiffness"),
    ),
    "drive": ("torque_limit", "power_limit", "lag"),
    "contact": ("shear_modulus", "nominal_load", "normal_damping", "rest_speed"),
}
PARAMETERS = (
    *(f"{group}.{name}" for group, names in _GROUPS.items() for name in names),
    *(f"adhesion.{share}.{name}" for share in ("good", "poor") for name in _BLEND),
    "gravity",
)
SLIP_FLOOR = 1.0
"""Speed below which the slip estimate is scaled by this value instead of the speed (m/s)."""
BRAKE_FADE = 0.2
"""Circumferential wheel speed below which a braking torque fades out, so that it holds instead of reversing (m/s)."""


def parameter_vector(vehicle: Vehicle, good: str = "dry", poor: str = "poor") -> np.ndarray:
    """Run-time parameters of the plant in the order of `PARAMETERS` (SI), shape (len(PARAMETERS),)."""

    def value(key: str) -> float:
        head, *rest = key.split(".")
        if head == "adhesion":
            return getattr(vehicle.adhesion[good if rest[0] == "good" else poor], rest[1])
        if key == "drive.power_limit" and not vehicle.drive.power_limited:
            return np.inf
        return reduce(getattr, key.split("."), vehicle)

    values = np.array([value(key) for key in PARAMETERS], dtype=float)
    return np.where(np.isinf(values), 1e12, values)


class _Symbols:
    """Named access to the entries of a symbolic vector."""

    def __init__(self, names: tuple[str, ...], vector: ca.SX):
        self._entries = {name: vector[i] for i, name in enumerate(names)}

    def __getitem__(self, name: str) -> ca.SX:
        return self._entries[name]


def _rotation(axis: str, angle: ca.SX) -> ca.SX:
    """Elementary rotation matrix about one axis, shape (3, 3); maps components of the turned frame to the old one."""
    c, s = ca.cos(angle), ca.sin(angle)
    entries = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return ca.vertcat(*(ca.horzcat(*row) for row in entries))


def _turn(psi: ca.SX, pitch: ca.SX, roll: ca.SX) -> ca.SX:
    """Rz(psi) Ry(pitch) Rx(roll), the paper's eq. (1)."""
    return _rotation("z", psi) @ _rotation("y", pitch) @ _rotation("x", roll)


class _Section:
    """Track section at a body: angles, rates per metre, position, irregularities as expressions of s."""

    def __init__(self, s: ca.SX, row: ca.SX):
        cell = _Symbols(route.COLUMNS, row)
        d = s - cell["p"]
        self.kappa = cell["kappa"] + cell["dkappa"] * d
        self.dphi, self.deps = cell["dphi"], cell["deps"]
        self.psi = cell["psi"] + (cell["kappa"] + cell["dkappa"] * d / 2) * d
        self.phi = cell["phi"] + self.dphi * d
        self.eps = cell["eps"] + self.deps * d
        self.rotation = _turn(self.psi, self.eps, self.phi)
        self.position = ca.vertcat(cell["x"], cell["y"], cell["z"]) + self._travel(cell, d)
        self.lateral = cell["lateral"] + cell["dlateral"] * d
        self.vertical = cell["vertical"] + cell["dvertical"] * d
        self.crosslevel = cell["crosslevel"] + cell["dcrosslevel"] * d
        self.irregularity_rates = (cell["dlateral"], cell["dvertical"], cell["dcrosslevel"])
        self.poor = {"le": cell["poor_le"], "ri": cell["poor_ri"]}
        sin, cos = ca.sin, ca.cos
        self.turn_rate = ca.vertcat(
            self.dphi - sin(self.eps) * self.kappa,
            cos(self.phi) * self.deps + sin(self.phi) * cos(self.eps) * self.kappa,
            -sin(self.phi) * self.deps + cos(self.phi) * cos(self.eps) * self.kappa,
        )

    @staticmethod
    def _travel(cell: _Symbols, d: ca.SX) -> ca.SX:
        """Displacement inside the cell: third-order Taylor expansion of the integral of the tangent."""
        q = ca.SX.sym("q")
        psi = cell["psi"] + (cell["kappa"] + cell["dkappa"] * q / 2) * q
        eps = cell["eps"] + cell["deps"] * q
        tangent = [ca.vertcat(ca.cos(eps) * ca.cos(psi), ca.cos(eps) * ca.sin(psi), -ca.sin(eps))]
        for _ in range(2):
            tangent.append(ca.jacobian(tangent[-1], q))
        at_start = [ca.substitute(term, q, 0) for term in tangent]
        return d * (at_start[0] + d / 2 * (at_start[1] + d / 3 * at_start[2]))


@lru_cache(maxsize=1)
def section_kinematics() -> ca.Function:
    """Track frame inside a cell: (s, row of a `Route`) -> rotation (3, 3), turn rate (1/m), position (m)."""
    s, row = ca.SX.sym("s"), ca.SX.sym("row", len(route.COLUMNS))
    section = _Section(s, row)
    return ca.Function("section", [s, row], [section.rotation, section.turn_rate, section.position])


class _Body:
    """Kinematics of one rigid body in its own track section."""

    def __init__(self, name: str, x: _Symbols, row: ca.SX):
        get = {coordinate: x[f"{name}.{coordinate}"] for coordinate in COORDINATES}
        self.__dict__.update(get)
        self.section = _Section(self.s, row)
        self.rotation = _turn(self.psi, self.theta, self.phi)
        self.v = ca.vertcat(self.vx, self.vy, self.vz)
        self.w = ca.vertcat(self.wx, self.wy, self.wz)
        k = self.section.turn_rate
        self.sdot = self.vx / (1 + k[1] * self.z - k[2] * self.y)
        self.turn = k * self.sdot
        relative = self.w - self.rotation.T @ self.turn
        psidot = (relative[1] * ca.sin(self.phi) + relative[2] * ca.cos(self.phi)) / ca.cos(self.theta)
        thetadot = relative[1] * ca.cos(self.phi) - relative[2] * ca.sin(self.phi)
        phidot = relative[0] + psidot * ca.sin(self.theta)
        ydot = self.vy + self.turn[0] * self.z
        zdot = self.vz - self.turn[0] * self.y
        self.rates = ca.vertcat(self.sdot, ydot, zdot, psidot, thetadot, phidot)
        self.attitude = self.section.rotation @ self.rotation
        self.position = self.section.position + self.section.rotation @ ca.vertcat(0, self.y, self.z)

    def accelerations(self, force: ca.SX, moment: ca.SX, mass: ca.SX, inertia: ca.SX, spin: ca.SX = 0) -> ca.SX:
        """Newton-Euler: force (N, track components), moment (N m, body axes), spin momentum about y (kg m2/s)."""
        momentum = inertia * self.w + ca.vertcat(0, spin, 0)
        return ca.vertcat(force / mass - ca.cross(self.turn, self.v), (moment - ca.cross(self.w, momentum)) / inertia)


def _stop(value: ca.SX, clearance: ca.SX) -> ca.SX:
    """How far `value` exceeds +-clearance, signed."""
    return ca.fmax(value - clearance, 0) + ca.fmin(value + clearance, 0)


class _Suspension:
    """Springs, dampers, traction link and stops between the car body and one carrier, in carrier axes.

    Attachment points coincide at rest, and both bodies feel a force at the body-side point, so that no angular momentum
    leaks. The moment on the car body is collected in carrier axes about its centre of gravity.
    """

    def __init__(self, body: _Body, gear: _Body, end: int, p: _Symbols, stages: Stages):
        def get(name):
            return p["suspension." + name]

        relative = gear.attitude.T @ body.attitude
        offset = gear.attitude.T @ (body.position - gear.position)
        velocity = gear.attitude.T @ (body.section.rotation @ body.v - gear.section.rotation @ gear.v)
        held = stages.hold(*ca.vertsplit(ca.vertcat(ca.vec(relative), offset, velocity, relative @ body.w)))
        self._relative = ca.reshape(ca.vertcat(*held[:9]), 3, 3)
        self._offset, self._velocity = ca.vertcat(*held[9:12]), ca.vertcat(*held[12:15])
        self._body_turn, self._gear_turn = ca.vertcat(*held[15:]), gear.w
        self._force, self._on_gear, self._on_body = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3)
        self.energy, self.dissipation = 0, 0
        half = end * p["body.gear_spacing"] / 2
        self._spring_pair(half, p, get)
        self._link(half, p, get)
        self._rotational((2, 1), get("antiroll_stiffness"), get("antiroll_damping"))
        self._rotational((0, 2), get("pitch_stiffness"), get("pitch_damping"))
        self._rotational((1, 0), get("yaw_stop_stiffness"), 0, get("yaw_stop_angle"))
        self.yaw_sine = -self._relative[1, 0]
        self.force_on_gear, self.moment_on_gear = self._force, self._on_gear
        self.force_on_body, self.moment_on_body = -self._force, -self._relative.T @ self._on_body

    def _deflection(self, on_body: ca.SX, on_gear: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Arm on the body, relative displacement of two points and its rate, all in carrier axes."""
        arm = self._relative @ on_body
        deflection = self._offset + arm - on_gear
        rate = self._velocity + ca.cross(self._body_turn, arm) - ca.cross(self._gear_turn, arm + self._offset)
        return arm, deflection, rate

    def _act(self, arm: ca.SX, force: ca.SX) -> None:
        """Force on the gear (and its reaction on the body) at the body-side point."""
        self._force += force
        self._on_body += ca.cross(arm, force)
        self._on_gear += ca.cross(arm + self._offset, force)

    def _spring_pair(self, half: ca.SX, p: _Symbols, get) -> None:
        """Left and right spring and damper with lateral bump stop: their mean at the centre and their difference."""
        stiffness = ca.vertcat(get("k_x"), get("k_y"), get("k_z"))
        damping = ca.vertcat(get("c_x"), get("c_y"), get("c_z"))
        preload = ca.vertcat(0, 0, p["body.mass"] * p["gravity"] / 2)
        on_body = ca.vertcat(half, 0, p["body.cg_height"] - get("height"))
        arm, mean, rate = self._deflection(on_body, ca.vertcat(0, 0, p["wheel.radius"] - get("height")))
        over = _stop(mean[1], get("bump_clearance"))
        self._act(
            arm,
            preload + 2 * stiffness * mean + 2 * damping * rate + ca.vertcat(0, get("bump_stiffness") * over, 0),
        )
        lever = get("half_spacing") * self._relative[:, 1]
        difference = lever - ca.vertcat(0, get("half_spacing"), 0)
        difference_rate = ca.cross(self._body_turn - self._gear_turn, lever)
        couple = 2 * ca.cross(lever, stiffness * difference + damping * difference_rate)
        self._on_body += couple
        self._on_gear += couple
        self.energy += ca.dot(stiffness, mean**2 + difference**2) + ca.dot(preload, mean)
        self.energy += get("bump_stiffness") * over**2 / 2
        self.dissipation += 2 * ca.dot(damping, rate**2 + difference_rate**2)

    def _link(self, half: ca.SX, p: _Symbols, get) -> None:
        """Traction link at axle height; acts along the carrier only."""
        on_body = ca.vertcat(half, 0, p["body.cg_height"] - p["wheel.radius"])
        arm, deflection, rate = self._deflection(on_body, ca.SX.zeros(3))
        force = get("link_stiffness") * deflection[0] + get("link_damping") * rate[0]
        self._act(arm, ca.vertcat(force, 0, 0))
        self.energy += get("link_stiffness") * deflection[0] ** 2 / 2
        self.dissipation += get("link_damping") * rate[0] ** 2

    def _rotational(self, entry: tuple[int, int], stiffness, damping, free=None) -> None:
        """Torque with the potential k e^2/2 of an entry e of the relative rotation matrix (e = sine of an angle)."""
        row, column = entry
        angle = self._relative[row, column]
        gradient = ca.cross(self._relative[:, column], ca.SX.eye(3)[:, row])
        over = angle if free is None else _stop(angle, ca.sin(free))
        rate = ca.dot(gradient, self._body_turn - self._gear_turn)
        torque = (stiffness * over + damping * rate) * gradient
        self._on_gear += torque
        self._on_body += torque
        self.energy += stiffness * over**2 / 2
        self.dissipation += damping * rate**2


class _Contact:
    """One wheel on its rail: normal force with damping and lift-off, creepages, tangential force."""

    def __init__(self, gear: _Body, speed: ca.SX, side: str, row: ca.SX, p: _Symbols, stages: Stages):
        sign = 1 if side == "ri" else -1
        section = gear.section
        d = self.shift(gear, sign, p) - row[0]
        effective = row[1] + d * (row[2] + d * (row[3] + d * row[4]))
        slope = row[2] + d * (2 * row[3] + d * 3 * row[4])
        rolling, wheel_contact = row[5] + row[6] * d, row[7] + row[8] * d
        cos_angle = 1 / ca.sqrt(1 + slope**2)
        eta, zeta = self._rail_in_axle(gear, sign, p)
        self.penetration = (effective - zeta) * cos_angle
        self.angle = ca.atan(slope)

        upright = _rotation("z", gear.psi) @ _rotation("x", gear.phi)
        k, y_rail = section.turn_rate, sign * p["gear.contact_base"] / 2
        tangent = ca.vertcat(1, 0, k[0] * y_rail / (1 - k[2] * y_rail))
        tangent /= ca.norm_2(tangent)
        normal = upright @ ca.vertcat(0, sign * slope * cos_angle, cos_angle)
        normal -= tangent * ca.dot(tangent, normal)
        normal /= ca.norm_2(normal)
        lateral = ca.cross(normal, tangent)
        to_body = gear.rotation.T @ upright
        centre = ca.vertcat(0, y_rail, 0)
        # A wheel is a body of revolution, so the normal meets its axis: on a rail that climbs against the axle (cant
        # ramp) the contact sits ahead of or behind the lowest point.
        normal_axes = upright.T @ normal
        ahead = normal_axes[0] / normal_axes[2]
        depth = rolling - self.penetration / cos_angle
        at_normal = to_body @ ca.vertcat(ahead * zeta, eta, zeta)
        at_contact = to_body @ ca.vertcat(ahead * depth, eta + sign * wheel_contact, depth)

        spin = ca.vertcat(gear.wx, -speed, gear.wz)
        slide = gear.v + gear.rotation @ (ca.cross(gear.w, centre) + ca.cross(spin, at_contact - centre))
        rolling_speed = ca.sqrt(gear.vx**2 + p["contact.rest_speed"] ** 2)
        motion = (d, self.penetration, self._penetration_rate(gear, sign, p), ca.dot(slide, tangent))
        motion += (ca.dot(slide, lateral), ca.dot(gear.rotation @ spin, normal), rolling_speed)
        self._forces(stages.hold(*motion), row, section.poor[side], p)
        self.normal, *self.tangential = stages.hold(self.normal, *self.tangential)

        creep_force = tangent * self.tangential[0] + lateral * self.tangential[1]
        normal_force = -normal * self.normal
        self.force = creep_force + normal_force
        creep_axes, normal_axes = gear.rotation.T @ creep_force, gear.rotation.T @ normal_force
        self.axle_moment = ca.cross(at_contact - centre, creep_axes) + ca.cross(at_normal - centre, normal_axes)
        bearing = ca.cross(centre, creep_axes + normal_axes)
        self.moment = ca.vertcat(self.axle_moment[0], 0, self.axle_moment[2]) + bearing
        self.slip = self.sliding[0] / ca.fmax(gear.vx, SLIP_FLOOR)

    def _forces(self, motion: list[ca.SX], row: ca.SX, poor: ca.SX, p: _Symbols) -> None:
        """Hertzian normal force with damping, and creep forces, from the motion of the contact."""
        d, penetration, rate, *self.sliding, turn, rolling_speed = motion
        a, b, c11, c22, c23, stiffness = (row[9 + 2 * i] + row[10 + 2 * i] * d for i in range(6))
        compression = ca.fmax(penetration, 0)
        elastic = stiffness * compression**1.5
        self.normal = ca.fmax(elastic * (1 + p["contact.normal_damping"] * rate), 0)
        self.energy = elastic * compression / 2.5
        self.dissipation = (self.normal - elastic) * rate
        self.creepage = (self.sliding[0] / rolling_speed, self.sliding[1] / rolling_speed)
        self.spin = turn / rolling_speed
        scale = ((self.normal + 1) / p["contact.nominal_load"]) ** (1 / 3)
        adhesion = [p[f"adhesion.good.{n}"] * (1 - poor) + p[f"adhesion.poor.{n}"] * poor for n in _BLEND]
        slip_speed = ca.sqrt(self.sliding[0] ** 2 + self.sliding[1] ** 2 + 1e-12)
        self.tangential = polach(
            *self.creepage, self.spin, self.normal, a * scale, b * scale, c11, c22, c23,
            p["contact.shear_modulus"], *adhesion, slip_speed,
        )  # fmt: skip

    @staticmethod
    def _rail_in_axle(gear: _Body, sign: int, p: _Symbols) -> tuple[ca.SX, ca.SX]:
        """Lateral and vertical coordinate of the rail point in the (unpitched) axle frame (m)."""
        y = sign * p["gear.contact_base"] / 2 + gear.section.lateral - gear.y
        z = gear.section.vertical + sign * p["gear.contact_base"] / 2 * gear.section.crosslevel - gear.z
        across = y / ca.cos(gear.psi)
        return ca.cos(gear.phi) * across + ca.sin(gear.phi) * z, -ca.sin(gear.phi) * across + ca.cos(gear.phi) * z

    @classmethod
    def shift(cls, gear: _Body, sign: int, p: _Symbols) -> ca.SX:
        """Shift of the wheel towards its flange against the rail (m), abscissa of the contact table."""
        return sign * (sign * p["gear.contact_base"] / 2 - cls._rail_in_axle(gear, sign, p)[0])

    def _penetration_rate(self, gear: _Body, sign: int, p: _Symbols) -> ca.SX:
        """Time derivative of the penetration along the motion of the carrier over the rail (m/s)."""
        section = gear.section
        moving = ca.vertcat(gear.y, gear.z, gear.psi, gear.phi)
        rates = gear.rates[[1, 2, 3, 5]]
        gradient = ca.jacobian(self.penetration, moving) @ rates
        dlateral, dvertical, dcrosslevel = section.irregularity_rates
        y_change = -dlateral
        z_change = -(dvertical + sign * p["gear.contact_base"] / 2 * dcrosslevel)
        along = ca.jacobian(self.penetration, moving[:2]) @ ca.vertcat(y_change, z_change)
        return gradient + along * gear.sdot


@dataclass(frozen=True)
class Car:
    """CasADi functions of the car; all share the inputs rows (3 track cells), contacts (4 table rows), parameters.

    Attributes
    ----------
    rate : Function
        (x[44], u[4], rows[ncol, 3], contacts[21, 4], par) -> dx/dt.
    step : Function
        (x, u, rows, contacts, par, h) -> state after h (s) and embedded error estimate, Rodas3.
    coordinates : Function
        (x, rows, par) -> look-up coordinates: s of 3 bodies, then shift of 4 wheels (m); of the rows only the
        irregularities count, so those of the previous exchange serve.
    output : Function
        (x, u, rows, contacts, par) -> values named in `outputs`.
    energy : Function
        (x, u, rows, contacts, par) -> [mechanical energy (J), motor power, damping loss, creep loss (W)].
    outputs : tuple of str
        Names of the output vector.
    operations : dict
        Number of operations of the whole rate and of what contact and suspension need by themselves.
    """

    rate: ca.Function
    step: ca.Function
    coordinates: ca.Function
    output: ca.Function
    energy: ca.Function
    outputs: tuple[str, ...]
    operations: dict[str, int]


@lru_cache(maxsize=1)
def car() -> Car:
    """Derive the equations of motion of the car as CasADi functions (about a second)."""
    x = ca.SX.sym("x", len(STATES))
    u = ca.SX.sym("u", 4)
    rows = ca.SX.sym("rows", len(route.COLUMNS), 3)
    contacts = ca.SX.sym("contacts", CONTACT_COLUMNS, 4)
    par = ca.SX.sym("par", len(PARAMETERS))
    state, p, stages = _Symbols(STATES, x), _Symbols(PARAMETERS, par), Stages()

    bodies = {name: _Body(name, state, rows[:, i]) for i, name in enumerate(BODIES)}
    body, gears = bodies["body"], (bodies["front"], bodies["rear"])
    suspensions = [_Suspension(body, gear, end, p, stages) for gear, end in zip(gears, (1, -1), strict=True)]
    speeds, torques = x[36:40], x[40:44]
    wheels = [
        _Contact(gears[i // 2], speeds[i], wheel[-2:], contacts[:, i], p, stages) for i, wheel in enumerate(WHEELS)
    ]

    gravity = ca.vertcat(0, 0, p["gravity"])
    inertia = ca.vertcat(p["body.inertia_x"], p["body.inertia_y"], p["body.inertia_z"])
    force = p["body.mass"] * body.section.rotation.T @ gravity
    moment = ca.SX.zeros(3)
    for gear, suspension in zip(gears, suspensions, strict=True):
        force += body.section.rotation.T @ gear.attitude @ suspension.force_on_body
        moment += suspension.moment_on_body
    derivatives = [body.rates, body.accelerations(force, moment, p["body.mass"], inertia)]
    inertia = ca.vertcat(p["gear.inertia_x"], p["gear.inertia_y"], p["gear.inertia_z"])
    for g, (gear, suspension) in enumerate(zip(gears, suspensions, strict=True)):
        own = range(2 * g, 2 * g + 2)
        force = p["gear.mass"] * gear.section.rotation.T @ gravity + gear.rotation @ suspension.force_on_gear
        moment = suspension.moment_on_gear
        for i in own:
            force += wheels[i].force
            moment += wheels[i].moment + ca.vertcat(0, torques[i], 0)
        spin = -p["wheel.spin_inertia"] * (speeds[own[0]] + speeds[own[1]])
        derivatives += [gear.rates, gear.accelerations(force, moment, p["gear.mass"], inertia, spin)]
    spin_up = [(torques[i] - wheels[i].axle_moment[1]) / p["wheel.spin_inertia"] for i in range(4)]
    lag = [(_available(u[i], speeds[i], p) - torques[i]) / p["drive.lag"] for i in range(4)]
    staged = ca.vertcat(*derivatives, *spin_up, *lag)
    rate = ca.cse(stages.resolve(staged))

    inputs, names = [x, u, rows, contacts, par], ["x", "u", "rows", "contacts", "par"]
    h = ca.SX.sym("h")
    x_next, error = rodas3(rate, stages.jacobian(staged, x), x, h)
    shifts = [_Contact.shift(gears[i // 2], 1 if wheel[-2:] == "ri" else -1, p) for i, wheel in enumerate(WHEELS)]
    outputs = _outputs(bodies, wheels, speeds, torques, suspensions)
    energies = _energies(bodies, wheels, speeds, torques, suspensions, p)
    places = ca.vertcat(*(bodies[name].s for name in BODIES), *shifts)
    forces = {
        "all": rate,
        "contact": stages.resolve(ca.vertcat(*(ca.vertcat(wheel.force, wheel.axle_moment) for wheel in wheels))),
        "suspension": stages.resolve(ca.vertcat(*(s.force_on_gear for s in suspensions))),
    }
    counts = {
        name: ca.Function(name, inputs, [entry], {"cse": True}).n_instructions() for name, entry in forces.items()
    }
    return Car(
        rate=ca.Function("car_rate", inputs, [rate], names, ["dx"]),
        step=ca.Function("car_step", [*inputs, h], [x_next, error], [*names, "h"], ["x_next", "error"], {"cse": True}),
        coordinates=ca.Function("car_coordinates", [x, rows, par], [places], ["x", "rows", "par"], ["places"]),
        output=ca.Function(
            "car_output", inputs, [stages.resolve(ca.vertcat(*outputs.values()))], names, ["y"], {"cse": True}
        ),
        energy=ca.Function(
            "car_energy", inputs, [stages.resolve(ca.vertcat(*energies))], names, ["energies"], {"cse": True}
        ),
        outputs=tuple(outputs),
        operations=counts,
    )


def _available(u: ca.SX, speed: ca.SX, p: _Symbols) -> ca.SX:
    """Motor torque that the drive can give for a command u (N m): limits of torque and power, braking holds at rest."""
    limit = ca.fmin(p["drive.torque_limit"], p["drive.power_limit"] / ca.fmax(ca.fabs(speed), 1e-3))
    limited = ca.fmin(ca.fmax(u, -limit), limit)
    fade = ca.fmin(ca.fmax(speed * p["wheel.radius"] / BRAKE_FADE, 0), 1)
    return ca.if_else(limited < 0, limited * fade, limited)


def _outputs(bodies, wheels, speeds, torques, suspensions) -> dict[str, ca.SX]:
    """Measured and logged quantities by name (SI)."""
    out = {}
    for name in ("front", "rear"):
        gear = bodies[name]
        out |= {
            f"{name}.p": gear.s,
            f"{name}.psi_Ax": gear.section.psi + gear.psi,
            f"{name}.v": gear.sdot,
            f"{name}.psidot_Ax": gear.section.kappa * gear.sdot + gear.rates[3],
            f"{name}.y": gear.y,
            f"{name}.psi_TrAx": gear.psi,
        }
    for i, wheel in enumerate(WHEELS):
        contact_ = wheels[i]
        out |= {
            f"{wheel}.w": speeds[i],
            f"{wheel}.tau": torques[i],
            f"{wheel}.N": contact_.normal,
            f"{wheel}.Fx": contact_.tangential[0],
            f"{wheel}.Fy": contact_.tangential[1],
            f"{wheel}.fx": contact_.tangential[0] / (contact_.normal + 1),
            f"{wheel}.sx": contact_.slip,
            f"{wheel}.nu_x": contact_.creepage[0],
            f"{wheel}.nu_y": contact_.creepage[1],
            f"{wheel}.spin": contact_.spin,
            f"{wheel}.angle": contact_.angle,
        }
    for name, suspension in zip(("front", "rear"), suspensions, strict=True):
        out[f"{name}.yaw_to_body"] = ca.asin(suspension.yaw_sine)
    body = bodies["body"]
    out |= {f"body.{name}": getattr(body, name) for name in ("s", "y", "z", "psi", "theta", "phi", "vx")}
    return out


def _energies(bodies, wheels, speeds, torques, suspensions, p) -> list[ca.SX]:
    """Mechanical energy, motor power and losses, for the energy balance."""
    energy = sum(s.energy for s in suspensions) + sum(w.energy for w in wheels)
    for name, body in bodies.items():
        group = "body" if name == "body" else "gear"
        inertia = ca.vertcat(*(p[f"{group}.inertia_{axis}"] for axis in "xyz"))
        energy += p[f"{group}.mass"] * (ca.sumsqr(body.v) / 2 - p["gravity"] * body.position[2])
        energy += ca.dot(inertia, body.w**2) / 2
    energy += p["wheel.spin_inertia"] * ca.sumsqr(speeds) / 2
    carriers = (bodies["front"], bodies["front"], bodies["rear"], bodies["rear"])
    motor = sum(torques[i] * (speeds[i] + carriers[i].wy) for i in range(4))
    creep = -sum(w.tangential[0] * w.sliding[0] + w.tangential[1] * w.sliding[1] for w in wheels)
    damping = sum(element.dissipation for element in (*suspensions, *wheels))
    return [energy, motor, damping, creep]


def rest_state(vehicle: Vehicle, table: ContactTable, speed: float, p: float = 0.0) -> np.ndarray:
    """State of steady rolling on straight level track with the front gear at `p`.

    Parameters
    ----------
    vehicle : Vehicle
    table : ContactTable
        Wheel-rail contact of all four wheels.
    speed : float
        Running speed (m/s).
    p : float
        Track coordinate of the front gear (m).

    Returns
    -------
    ndarray, shape (44,)
    """
    row = table.cells()[round((0.0 - table.start) / table.step)]
    slope = row[2] - row[0] * 2 * row[3]
    radius, rolling, stiffness = (
        row[1] - row[0] * row[2],
        row[5] - row[0] * row[6],
        row[19] - row[0] * row[20],
    )
    cos_angle = 1 / np.hypot(1, slope)
    load = (vehicle.body.mass / 4 + vehicle.gear.mass / 2) * vehicle.gravity / cos_angle
    drop = (load / stiffness) ** (2 / 3) / cos_angle
    x = np.zeros(len(STATES))
    half = vehicle.body.gear_spacing / 2
    sink = vehicle.wheel.radius - radius + drop
    for i, (s, z) in enumerate(
        ((p - half, sink - vehicle.body.cg_height), (p, drop - radius), (p - 2 * half, drop - radius))
    ):
        x[12 * i], x[12 * i + 2], x[12 * i + 6] = s, z, speed
    x[36:40] = speed / (rolling - drop)
    return x
