"""The car in the public multibody code Exudyn, derived from the mechanics and not from the equations of the project.

Exudyn integrates three floating bodies in inertial coordinates with four wheels on revolute joints. Forces follow from
positions and velocities in space: a spring acts between its two points, a wheel is a surface of revolution whose
deepest point is searched along the rail. Rails, contact and creep are independent, too: the track is its integrated
curvature; a cone has Hertz's ellipse from Carlson's integrals and Kalker's coefficients from his table, S1002 has the
patches of `rolling_contact`. Shared with the project are data only: vehicle, profiles, segments of the track, samples
of irregularities.

Both cars need the same convention for torques of the suspension: a rotational element has the potential k e^2/2, where
e is the product of one axis of each body. So the pitch reaction (e = x_carrier . z_body) acts about z_body x x_carrier,
and motor torque times relative roll becomes a yaw torque. Needs the group `bench`. Serves the paper's section
Simulation Environment."""

from collections import namedtuple
from collections.abc import Callable
from math import exp

import casadi as ca
import numpy as np
import pandas as pd
import rolling_contact
from scipy.interpolate import CubicSpline, PPoly
from scipy.optimize import brentq
from scipy.special import elliprd

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.quantities import GEARS, WHEELS
from railrepro.track.alignment import Alignment
from railrepro.vehicle.parameters import Vehicle

MEASURED = (
    *(f"{gear}.{name}" for name in ("y", "psi_TrAx") for gear in GEARS),
    *(f"{wheel}.{name}" for name in ("w", "N") for wheel in WHEELS),
)
_OF_WHEEL = ("N", "adhesion", "sx", "nu_y", "angle", "place", "w", "tau")
OBSERVED = (
    *MEASURED,
    *(f"{gear}.{name}" for gear in GEARS for name in ("p", "v", "psi_Ax", "psidot_Ax")),
    *(f"{wheel}.{name}" for wheel in WHEELS for name in _OF_WHEEL if name not in ("w", "N")),
)
"""Columns of a run: `MEASURED`, further inputs of law and metrics, and the position of the rail on the wheel."""
STEP = 5e-4  # usual step of Exudyn's Runge-Kutta method (s)
WHEEL_MASS = 400.0  # of the mass of a running gear (kg); without influence, as the inertias of the gear contain wheels
CROWN_RADIUS = 0.3  # of the rail across (m)

Stiffness = namedtuple("Stiffness", "along across spin turn")
"""Creep forces over the shear modulus: by creepage along and across (m^2), by spin (m^3); moment by spin (m^4). The
moment by creepage across is the force by spin."""
_COLUMNS = ("effective", "rolling", *Stiffness._fields)
_PLACES = [OBSERVED.index(f"{wheel}.place") for wheel in WHEELS]
_GAUSS = np.polynomial.legendre.leggauss(4)
_CHANNELS = {"lateral": "lateral_m", "vertical": "vertical_m", "crosslevel": "crosslevel_rad", "gauge": "gauge_m"}
_LINE = ("p", "x", "y", "z", "psi", "kappa", "dkappa", "phi", "dphi", "eps", "deps")
_STATION = (*_LINE, *(f"{'d' * order}{name}" for name in _CHANNELS for order in range(4)))
_SPACING, _BEFORE, _AFTER = 0.5, 60.0, 400.0
_POISSON = (0.0, 0.25, 0.5)
_KALKER = np.array(
    [
        [(3.40, 4.12, 5.20), (3.40, 3.67, 3.98), (1.33, 1.47, 1.63), (1.21, 1.19, 1.16)],
        [(3.51, 4.22, 5.30), (3.51, 3.81, 4.16), (1.44, 1.59, 1.77), (1.16, 1.11, 1.06)],
        [(3.65, 4.36, 5.42), (3.65, 3.99, 4.39), (1.58, 1.75, 1.94), (1.10, 1.04, 0.954)],
        [(3.82, 4.54, 5.58), (3.82, 4.21, 4.67), (1.76, 1.95, 2.18), (1.05, 0.965, 0.852)],
        [(4.06, 4.78, 5.80), (4.06, 4.50, 5.04), (2.01, 2.23, 2.50), (1.01, 0.892, 0.751)],
        [(4.37, 5.10, 6.11), (4.37, 4.90, 5.56), (2.35, 2.62, 2.96), (0.958, 0.819, 0.650)],
    ]
)
"""C11, C22, C23 and C33 at b/a of 1, .9 .. .5, each for Poisson's ratio 0, .25 and .5 (Kalker 1990, Table E3)."""


def patch(vehicle: Vehicle) -> tuple[float, float, np.ndarray]:
    """Solve the contact of a cone on the crown of the rail at nominal load: semi-axes a, b along and across (m), and
    Kalker's coefficients c11, c22, c23, c33 (-). These are linear in b/a, their inverses a parabola over Poisson's
    ratio. Source: Hertz's pressure as a layer potential, R_D of Carlson 1979; Kalker 1990, Table E3."""
    data, along = vehicle.contact, np.cos(vehicle.wheel.cone_angle) / vehicle.wheel.radius
    modulus = data.young / (2 * (1 - data.poisson**2))

    def mismatch(flat):  # of the curvatures along and across the rail of an ellipse with b = flat a
        return elliprd(0, flat**2, 1) * (1 / CROWN_RADIUS) - elliprd(0, 1, flat**2) * along

    flat = brentq(mismatch, 0.5, 1.0, xtol=1e-12)
    a = (data.nominal_load * elliprd(0, flat**2, 1) / (np.pi * modulus * along)) ** (1 / 3)
    parabola = [np.prod([(data.poisson - q) / (p - q) for q in _POISSON if q != p]) for p in _POISSON]
    rows = 1 / np.tensordot(1 / _KALKER, parabola, axes=(2, 0))
    ratios = np.linspace(1.0, 0.5, len(rows))[::-1]
    return a, flat * a, np.array([np.interp(flat, ratios, column[::-1]) for column in rows.T])


def cells_at(wheels: PPoly, places) -> np.ndarray:
    """Look up start and coefficients of the cells of cubics at some places, shape (n, 25). `wheels` is over the
    position of the rail on the wheel, outwards of the tape circle (m): effective radius less the nominal one, rolling
    radius (m), and `Stiffness` at nominal load."""
    cell = np.clip(np.searchsorted(wheels.x, places, side="right") - 1, 0, len(wheels.x) - 2)
    return np.column_stack([wheels.x[cell], wheels.c[:, cell].transpose(1, 0, 2).reshape(len(cell), -1)])


def cones(vehicle: Vehicle) -> PPoly:
    """Conical wheels on the crown of the rail, see `cells_at`."""
    a, b, (c11, c22, c23, c33) = patch(vehicle)
    constant = 0.0, vehicle.wheel.radius, c11 * a * b, c22 * a * b, c23 * (a * b) ** 1.5, c33 * (a * b) ** 2
    cubics = np.zeros((4, 1, len(_COLUMNS)))
    cubics[2, 0, :2], cubics[3, 0] = -np.tan(vehicle.wheel.cone_angle), constant
    return PPoly(cubics, [0.0, 1.0])


def s1002() -> PPoly:
    """S1002 on 60E1 at 1:40, see `cells_at`."""
    return rolling_contact.splines(pd.read_csv(rolling_contact.TABLE))


def creep(
    vehicle: Vehicle, stiffness: Stiffness, load, nu_x, nu_y, spin, slip_speed, rail: str = "dry"
) -> tuple[ca.SX, ...]:
    """Compute the forces along and across the rail (N) and the moment about the normal (N m) on a wheel, from load (N),
    creepages (-, -, 1/m), slip speed (m/s) and adhesion set. Linear force and moment are reduced in the same ratio.
    Source: Kalker 1967 (linear theory); Polach 2005, eqs. (2) and (3); Shen, Hedrick and Elkins 1983 (direction)."""
    law, unit, longer = vehicle.adhesion[rail], vehicle.contact.shear_modulus, (load + 1) / vehicle.contact.nominal_load
    along = unit * longer ** (2 / 3) * stiffness.along * nu_x
    across = unit * (longer ** (2 / 3) * stiffness.across * nu_y + longer * stiffness.spin * spin)
    turning = unit * (longer * stiffness.spin * nu_y - longer ** (4 / 3) * stiffness.turn * spin)
    friction = law.mu0 * ((1 - law.a_ratio) * ca.exp(-law.b_decay * slip_speed) + law.a_ratio)
    ratio = np.pi / 4 * ca.sqrt(along**2 + across**2 + 1e-6) / (friction * (load + 1))
    reduced = (law.k_a / (1 + (law.k_a * ratio) ** 2) + ca.atan(law.k_s * ratio) / ratio) / 2
    return -reduced * along, -reduced * across, reduced * turning


class Rails:
    """The track in space by integration of its curvature, with the irregularities of its rails as splines."""

    def __init__(self, alignment: Alignment, irregularities: pd.DataFrame | None = None):
        ends = np.cumsum([0.0, *(segment.length for segment in alignment.segments)])
        samples = [] if irregularities is None else irregularities["p_m"]
        s = np.unique([*np.arange(-_BEFORE, ends[-1] + _AFTER, _SPACING), *ends, *samples])
        at, (before, after) = dict.fromkeys(_STATION, np.zeros(len(s))), (s < 0, s >= ends[-1])
        index = np.clip(np.searchsorted(ends, s, side="right") - 1, 0, len(alignment.segments) - 1)
        for name in ("kappa", "phi", "eps"):
            first, last = np.array([getattr(segment, name) for segment in alignment.segments])[index].T
            rate = np.where(before | after, 0.0, (last - first) / np.diff(ends)[index])
            at[name] = np.where(after, last, first + rate * (s - ends[index]))
            at["d" + name] = rate
        at["kappa"] = np.where(before, 0.0, at["kappa"])
        h = np.diff(s)
        turned = np.cumsum([0.0, *(at["kappa"][:-1] + at["dkappa"][:-1] * h / 2) * h])
        at |= {"p": s, "psi": turned - turned[np.argmin(np.abs(s))]}
        moved = np.zeros((3, len(h)))
        for node, weight in zip(*_GAUSS, strict=True):
            d = h * (1 + node) / 2
            psi = at["psi"][:-1] + (at["kappa"][:-1] + at["dkappa"][:-1] * d / 2) * d
            eps = at["eps"][:-1] + at["deps"][:-1] * d
            moved += weight / 2 * h * np.array([np.cos(eps) * np.cos(psi), np.cos(eps) * np.sin(psi), -np.sin(eps)])
        for name, steps in zip("xyz", moved, strict=True):
            reached = np.cumsum([0.0, *steps])
            at[name] = reached - reached[np.argmin(np.abs(s))]
        if irregularities is not None:
            inside = (s >= np.min(samples)) & (s < np.max(samples))
            for name, column in _CHANNELS.items():
                spline = CubicSpline(samples, irregularities[column], bc_type="clamped")
                at |= {f"{'d' * order}{name}": np.where(inside, spline(s, order), 0.0) for order in range(4)}
        self._stations, self._p = np.array([at[name] for name in _STATION]).T, s

    def at(self, s) -> np.ndarray:
        """Look up the last stations before the positions s (m), shape (n, len(_STATION))."""
        return self._stations[np.clip(np.searchsorted(self._p, s, side="right") - 1, 0, len(self._p) - 1)]


def _frame(get: dict, s: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Position (3) and rotation (3, 3) of the track frame at s, from the station before it."""

    def ahead(d):
        psi, eps = get["psi"] + (get["kappa"] + get["dkappa"] * d / 2) * d, get["eps"] + get["deps"] * d
        level = ca.vertcat(-ca.sin(psi), ca.cos(psi), 0)
        return ca.vertcat(ca.cos(eps) * ca.cos(psi), ca.cos(eps) * ca.sin(psi), -ca.sin(eps)), level

    d = s - get["p"]
    travelled = sum(weight / 2 * ahead(d * (1 + node) / 2)[0] for node, weight in zip(*_GAUSS, strict=True))
    (x, level), phi = ahead(d), get["phi"] + get["dphi"] * d
    y = ca.cos(phi) * level + ca.sin(phi) * ca.cross(x, level)
    return ca.vertcat(get["x"], get["y"], get["z"]) + d * travelled, ca.horzcat(x, y, ca.cross(x, y))


def _contact(vehicle: Vehicle, law: Callable, side: int, get: dict, cell, s, speed, axle, wheel) -> tuple[ca.SX, ...]:
    """Contact of a wheel on a line-shaped rail, at the point of the rail that is deepest inside the wheel: force and
    torque about the wheel's centre (in space), normal force (N), adhesion, slip, lateral creepage (-), contact angle
    (rad), and the position of the rail on the wheel (m)."""
    (centre, velocity, turn), data = wheel, vehicle.contact
    half, variable = side * vehicle.gear.contact_base / 2, ca.SX.sym("s")

    def rail(place):
        position, rotation = _frame(get, place)
        d = place - get["p"]
        lateral, vertical, cross, gauge = (
            get[name] + d * (get["d" + name] + d * (get["dd" + name] / 2 + d * get["ddd" + name] / 6))
            for name in _CHANNELS
        )
        return position + rotation @ ca.vertcat(0, half + lateral + side * gauge / 2, vertical + half * cross)

    def shape(at):
        d, cubics = at - cell[0], ca.vertsplit(cell[1:], len(_COLUMNS))
        return ((cubics[0] * d + cubics[1]) * d + cubics[2]) * d + cubics[3]

    def depth(point):
        arm = point - centre
        lateral = ca.dot(arm, axle)
        return vehicle.wheel.radius + shape(side * lateral)[0] - ca.norm_2(arm - lateral * axle)

    slope = ca.gradient(depth(rail(variable)), variable)
    deepest, newton = s, variable - slope / ca.gradient(slope, variable)
    for _ in range(2):
        deepest = ca.substitute(newton, variable, deepest)
    tangent = ca.substitute(ca.jacobian(rail(variable), variable), variable, deepest)
    tangent /= ca.norm_2(tangent)
    point = rail(deepest)
    arm, axial = point - centre, ca.dot(point - centre, axle)
    radial, place = arm - axial * axle, ca.SX.sym("place")
    incline = ca.substitute(-ca.jacobian(shape(place)[0], place), place, side * axial)
    effective, rolling, *stiffness = ca.vertsplit(shape(side * axial))
    cosine = 1 / ca.sqrt(1 + incline**2)
    outwards = radial / ca.norm_2(radial)
    normal = cosine * (outwards + side * incline * axle)
    arm += (rolling - vehicle.wheel.radius - effective) * outwards  # the effective radius is none to roll on
    lateral, slide = ca.cross(normal, tangent), velocity + ca.cross(turn, arm)

    elastic, rate = data.normal_stiffness * ca.fmax(cosine * depth(point), 0) ** 1.5, ca.dot(slide, normal)
    load = ca.fmax(elastic * (1 + data.normal_damping * rate), 0)
    forwards, slides = ca.sqrt(speed**2 + data.rest_speed**2), (ca.dot(slide, tangent), ca.dot(slide, lateral))
    slip_speed = ca.norm_2(ca.vertcat(*slides, 1e-6))
    creepages = (*(v / forwards for v in slides), ca.dot(turn, normal) / forwards)
    f_x, f_y, moment = law(vehicle, Stiffness(*stiffness), load, *creepages, slip_speed)
    force = f_x * tangent + f_y * lateral - load * normal
    found = f_x / (load + 1), slides[0] / ca.fmax(speed, 1.0), creepages[1], ca.atan(incline), side * axial
    return force, ca.cross(arm, force) + moment * normal, load, *found


def _suspension(vehicle: Vehicle, end: int, body, gear) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Force on the running gear (the opposite acts on the body), and torques on both about their centres (in space).
    Springs have the axes of the carrier and act on both bodies at the point of the body."""
    d = vehicle.suspension
    (x_b, v_b, w_b, r_b), (x_g, v_g, w_g, r_g) = body, gear
    acting = []

    def beyond(value, clearance):
        return ca.fmax(value - clearance, 0) + ca.fmin(value + clearance, 0)

    def spring(lateral, level, law):
        """Add an element between points at a lateral position and a height; law(gap, rate) -> force."""
        arm = r_b @ ca.vertcat(end * vehicle.body.gear_spacing / 2, lateral, vehicle.body.cg_height - level)
        lever = x_b + arm - x_g
        gap = lever - r_g @ ca.vertcat(0, lateral, vehicle.wheel.radius - level)
        force = r_g @ law(r_g.T @ gap, r_g.T @ (v_b + ca.cross(w_b, arm) - v_g - ca.cross(w_g, lever)))
        acting.append((force, ca.cross(lever, force), -ca.cross(arm, force)))

    def rotational(on_carrier, on_body, stiffness, damping, clearance=0.0):
        sine, axis = ca.dot(r_b[:, on_body], r_g[:, on_carrier]), ca.cross(r_b[:, on_body], r_g[:, on_carrier])
        torque = (stiffness * beyond(sine, np.sin(clearance)) + damping * ca.dot(axis, w_b - w_g)) * axis
        acting.append((ca.SX.zeros(3), torque, -torque))

    k, c = ca.DM([d.k_x, d.k_y, d.k_z]), ca.DM([d.c_x, d.c_y, d.c_z])
    preload = ca.DM([0, 0, vehicle.body.mass * vehicle.gravity / 4])
    for side in (-1, 1):
        spring(side * d.half_spacing, d.height, lambda gap, rate: preload + k * gap + c * rate)
    spring(0, d.height, lambda gap, _: ca.vertcat(0, d.bump_stiffness * beyond(gap[1], d.bump_clearance), 0))
    along = ca.DM([1, 0, 0])
    spring(0, vehicle.wheel.radius, lambda gap, rate: along * (d.link_stiffness * gap + d.link_damping * rate))
    x, y, z = range(3)
    rotational(z, y, d.antiroll_stiffness, d.antiroll_damping)
    rotational(x, z, d.pitch_stiffness, d.pitch_damping)
    rotational(y, x, d.yaw_stop_stiffness, 0, d.yaw_stop_angle)
    return tuple(sum(parts) for parts in zip(*acting, strict=True))


def forces(vehicle: Vehicle, law: Callable = creep) -> ca.Function:
    """Build the function of all loads on the bodies under a creep law like `creep`: (motion[18, 3], turns[3, 4],
    stations[n, 2], cells[25, 4], s[2], tau[4]) -> loads[6, 7], s[2], `OBSERVED`.

    motion: position, velocity, angular velocity, rotation by columns of body and both running gears; turns: angular
    velocities of the wheels; stations and s of the running gears, s a guess nearby; cells as of `cells_at`; loads:
    force and torque about the centre of body, running gears, wheels."""
    motion, turns = ca.SX.sym("motion", 18, 3), ca.SX.sym("turns", 3, 4)
    stations, guess, tau = ca.SX.sym("stations", len(_STATION), 2), ca.SX.sym("s", 2), ca.SX.sym("tau", 4)
    cells = ca.SX.sym("cells", 1 + 4 * len(_COLUMNS), 4)
    parts = [(*ca.vertsplit(motion[:9, i], 3), ca.reshape(motion[9:, i], 3, 3)) for i in range(3)]
    loads = [ca.SX.zeros(6) for _ in range(7)]
    seen = {}
    for g, (name, end) in enumerate(zip(GEARS, (1, -1), strict=True)):
        gear, s = parts[1 + g], guess[g]
        get = dict(zip(_STATION, ca.vertsplit(stations[:, g]), strict=True))
        for _ in range(3):
            position, rotation = _frame(get, s)
            s += ca.dot(rotation[:, 0], gear[0] - position)
        position, rotation = _frame(get, s)
        relative, axle, speed = rotation.T @ gear[3], gear[3][:, 1], ca.dot(rotation[:, 0], gear[1])
        seen |= {f"{name}.p": s, f"{name}.v": speed, f"{name}.y": ca.dot(rotation[:, 1], gear[0] - position)}
        seen[f"{name}.psi_TrAx"] = ca.atan2(relative[1, 0], relative[0, 0])
        seen[f"{name}.psi_Ax"] = ca.atan2(gear[3][1, 0], gear[3][0, 0])
        seen[f"{name}.psidot_Ax"] = ca.dot(gear[2], rotation[:, 2])
        force, on_gear, on_body = _suspension(vehicle, end, parts[0], gear)
        loads[0] -= ca.vertcat(force, -on_body)
        loads[1 + g] += ca.vertcat(force, on_gear)
        for i, side in ((2 * g, -1), (2 * g + 1, 1)):
            arm = side * vehicle.gear.contact_base / 2 * axle
            wheel = gear[0] + arm, gear[1] + ca.cross(gear[2], arm), turns[:, i]
            force, torque, *found = _contact(vehicle, law, side, get, cells[:, i], s, speed, axle, wheel)
            loads[3 + i] += ca.vertcat(force, torque - tau[i] * axle)
            loads[1 + g] += ca.vertcat(0, 0, 0, tau[i] * axle)
            found += [-ca.dot(axle, turns[:, i]), tau[i]]
            seen |= {f"{WHEELS[i]}.{key}": value for key, value in zip(_OF_WHEEL, found, strict=True)}
    reached, observed = ca.vertcat(seen["front.p"], seen["rear.p"]), ca.vertcat(*(seen[name] for name in OBSERVED))
    inputs = [motion, turns, stations, cells, guess, tau]
    return ca.Function("space_forces", inputs, [ca.densify(ca.horzcat(*loads)), reached, observed], {"cse": True})


class ExudynCar:
    """The car in Exudyn, with loads by user functions; it starts to roll with the front running gear at s = 0."""

    def __init__(
        self, vehicle: Vehicle, rails: Rails, speed: float, law: Callable = creep, wheels: PPoly | None = None
    ):
        import exudyn

        self._wheels = wheels or cones(vehicle)
        self._exu, self._lag, self._rails = exudyn, vehicle.drive.lag, rails
        self._container = exudyn.SystemContainer()
        self._mbs = self._container.AddSystem()
        self._forces = codegen.CompiledFunction(forces(vehicle, law))
        self._motion, self._turns, self._stations, self._cells, self._s, self._tau = self._forces.arguments
        body, gear, wheel = vehicle.body, vehicle.gear, vehicle.wheel
        wheels = 2 * (wheel.diametral_inertia + WHEEL_MASS * (gear.contact_base / 2) ** 2)
        carrier = (gear.inertia_x - wheels, gear.inertia_y, gear.inertia_z - wheels)
        load = (body.mass / 4 + gear.mass / 2) * vehicle.gravity / np.cos(wheel.cone_angle)
        sunk = (load / vehicle.contact.normal_stiffness) ** (2 / 3) / np.cos(wheel.cone_angle)
        self._cells[:] = cells_at(self._wheels, np.zeros(4)).ravel()
        rolling = float(self._cells.reshape(4, -1)[0, 1 + 3 * len(_COLUMNS) + 1])  # at the start of the cell of 0
        spin, half = speed / (rolling - sunk), body.gear_spacing / 2
        start = (-half, sunk - body.cg_height, speed)
        self._markers = self._floating(vehicle, start, body.mass, (body.inertia_x, body.inertia_y, body.inertia_z), ())
        for s in (0.0, -2 * half):
            start = (s, sunk - wheel.radius, speed)
            self._markers += self._floating(vehicle, start, gear.mass - 2 * WHEEL_MASS, carrier, (-spin, -spin))
        self._markers = [self._markers[i] for i in (0, 1, 4, 2, 3, 5, 6)]
        self._s[:] = 0.0, -2 * half
        self._stations[:] = rails.at(self._s).ravel()
        items = exudyn.itemInterface
        for number, marker in enumerate(self._markers):
            for kind, first in ((items.LoadForceVector, 0), (items.LoadTorqueVector, 3)):
                self._mbs.AddLoad(kind(markerNumber=marker, loadVectorUserFunction=self._load(number, first)))
        self._mbs.Assemble()

    def _floating(self, vehicle: Vehicle, start, mass, inertia, spins) -> list:
        """Add a rigid body on six joints to the ground, from `start` x, z (m) and speed along x (m/s), with wheels on
        revolute joints; return their markers."""
        exu, joint, wheel, n = self._exu, self._exu.JointType, vehicle.wheel, 6 + len(spins)
        ends = np.array([-1, 1]) * vehicle.gear.contact_base / 2
        node = exu.itemInterface.NodeGenericODE2(
            numberOfODE2Coordinates=n,
            referenceCoordinates=[0.0] * n,
            initialCoordinates=[start[0], 0.0, start[1], *[0.0] * (n - 3)],
            initialCoordinates_t=[start[2], *[0.0] * 5, *spins],
        )
        rotor = np.diag([wheel.diametral_inertia, wheel.spin_inertia, wheel.diametral_inertia])
        slides = [joint.PrismaticX, joint.PrismaticY, joint.PrismaticZ]
        tree = exu.itemInterface.ObjectKinematicTree(
            nodeNumber=self._mbs.AddNode(node),
            gravity=[0, 0, vehicle.gravity],
            jointTypes=[*slides, joint.RevoluteZ, joint.RevoluteY, joint.RevoluteX] + [joint.RevoluteY] * len(spins),
            linkParents=[-1, 0, 1, 2, 3, 4] + [5] * len(spins),
            jointTransformations=exu.Matrix3DList([np.eye(3)] * n),
            jointOffsets=exu.Vector3DList([np.zeros(3)] * 6 + [np.array([0, y, 0]) for y in ends[: len(spins)]]),
            linkInertiasCOM=exu.Matrix3DList([np.zeros((3, 3))] * 5 + [np.diag(inertia)] + [rotor] * len(spins)),
            linkCOMs=exu.Vector3DList([np.zeros(3)] * n),
            linkMasses=[0.0] * 5 + [mass] + [WHEEL_MASS] * len(spins),
        )
        number, marker = self._mbs.AddObject(tree), exu.itemInterface.MarkerKinematicTreeRigid
        return [self._mbs.AddMarker(marker(objectNumber=number, linkNumber=link)) for link in range(5, n)]

    def _load(self, number: int, first: int) -> Callable:
        """User function of a force or torque; the first one evaluates all loads."""

        def load(_mbs, time, _vector):
            if number == first == 0:
                self._evaluate(time)
            return self._loads[number][first : first + 3]

        return load

    def _evaluate(self, time: float) -> None:
        kind, read = self._exu.OutputVariableType, self._mbs.GetMarkerOutput
        quantities = (kind.Position, kind.Velocity, kind.AngularVelocity, kind.RotationMatrix)
        values = [read(marker, quantity) for marker in self._markers[:3] for quantity in quantities]
        values[3::4] = [rotation.reshape(3, 3).T.ravel() for rotation in values[3::4]]
        self._motion[:] = np.concatenate(values)
        self._turns[:] = np.concatenate([read(marker, kind.AngularVelocity) for marker in self._markers[3:]])
        self._tau[:] = self._command + (self._before - self._command) * exp((self._since - time) / self._lag)
        loads, self._found, self._observed = self._forces()
        self._loads = loads.reshape(7, 6).tolist()

    def run(self, law: Callable, cycles: int, step: float = STEP) -> pd.DataFrame:
        """Drive under law(number of the control cycle, observed) -> torque commands (4) for a cycle of a whole number
        of steps, or None to end. Returns one row per cycle, columns `OBSERVED` (SI)."""
        self._command, self._before, self._since = np.zeros(4), np.zeros(4), 0.0
        per_cycle, log, count = round(CONTROL_PERIOD / step), [], 0

        def before_step(_mbs, _end):
            nonlocal count
            time = count * step
            self._evaluate(time)
            advance, self._s[:] = self._found - self._s, self._found
            if count % per_cycle == 0:
                self._stations[:] = self._rails.at(self._s).ravel()
                self._evaluate(time)
                self._before, self._since = self._tau.copy(), time
                self._cells[:] = cells_at(self._wheels, self._observed[_PLACES]).ravel()
                log.append(self._observed.copy())
                command = law(len(log) - 1, log[-1])
                if command is None:
                    return False
                self._command = np.asarray(command)
            # A step has the station of its middle, so that a kink of the track comes neither early nor late.
            self._stations[:] = self._rails.at(self._s + advance / 2).ravel()
            count += 1
            return True

        self._mbs.SetPreStepUserFunction(before_step)
        settings = self._exu.SimulationSettings()
        settings.timeIntegration.endTime = cycles * CONTROL_PERIOD
        settings.timeIntegration.numberOfSteps = cycles * per_cycle
        settings.timeIntegration.explicit.computeEndOfStepAccelerations = False
        settings.solution.file.write = False
        self._mbs.SolveDynamic(settings, solverType=self._exu.DynamicSolverType.RK44)
        return pd.DataFrame(log, columns=OBSERVED)
