"""The car in the public multibody code Exudyn, written from the mechanics and not from our equations.

Exudyn gets three floating bodies in inertial coordinates with four wheels on revolute joints, forms their equations of
motion and integrates them. All forces come from positions and velocities in space: each spring between its two points,
each wheel as a cone whose deepest point is searched along the curve of the rail. Only data (parameters, cells of the
route, contact ellipse) and the scalar creep law are shared with `railrepro.car`.

One convention decides curves under torque and must be the same in both: a rotational element of the suspension has the
potential k e^2/2 of the product e of one axis of each body. The pitch reaction (e = x_carrier . z_body) therefore acts
about z_body x x_carrier, and motor torque times relative roll becomes a yaw torque.

Needs the extra `bench`. Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp

import casadi as ca
import numpy as np
import pandas as pd

from railrepro.car.equations import WHEELS, rest_state
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.contact.creep import polach, spin_coefficient, spin_moment
from railrepro.contact.table import cone_patch, contact_table
from railrepro.track import route
from railrepro.vehicle.parameters import Vehicle

GEARS = ("front", "rear")
MEASURED = (
    *(f"{gear}.{name}" for name in ("y", "psi_TrAx") for gear in GEARS),
    *(f"{wheel}.{name}" for name in ("w", "N") for wheel in WHEELS),
)
STEP = 5e-4
"""Usual step of Exudyn's Runge-Kutta method (s)."""
WHEEL_MASS = 400.0
"""Share of a wheel in the mass of a gear (kg); of no influence: the inertias of the gear contain the wheels."""
_GAUSS = np.polynomial.legendre.leggauss(4)


def _frame(get: dict, s: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Position (3) and rotation (3, 3) of the track frame at s, from a cell of the route by column."""

    def ahead(d):
        psi, eps = get["psi"] + (get["kappa"] + get["dkappa"] * d / 2) * d, get["eps"] + get["deps"] * d
        level = ca.vertcat(-ca.sin(psi), ca.cos(psi), 0)
        return ca.vertcat(ca.cos(eps) * ca.cos(psi), ca.cos(eps) * ca.sin(psi), -ca.sin(eps)), level

    d = s - get["p"]
    travelled = sum(weight / 2 * ahead(d * (1 + node) / 2)[0] for node, weight in zip(*_GAUSS, strict=True))
    (x, level), phi = ahead(d), get["phi"] + get["dphi"] * d
    y = ca.cos(phi) * level + ca.sin(phi) * ca.cross(x, level)
    return ca.vertcat(get["x"], get["y"], get["z"]) + d * travelled, ca.horzcat(x, y, ca.cross(x, y))


def _contact(vehicle: Vehicle, side: int, get: dict, s, speed, axle, wheel) -> tuple[ca.SX, ...]:
    """Force and torque about the wheel's centre (in space), and the normal force (N).

    The cone r = r0 - side tan(delta) eta stands on a line-shaped rail where the rail is deepest inside it. There the
    normal of the cone is at right angles with the rail and meets the axle.
    """
    (centre, velocity, turn), data, angle = wheel, vehicle.contact, vehicle.wheel.cone_angle
    half, variable = side * vehicle.gear.contact_base / 2, ca.SX.sym("s")

    def rail(place):
        """Point of the irregular rail at `place`."""
        position, rotation = _frame(get, place)
        lateral, vertical, cross, gauge = (
            route.irregularity_in(get, name, place)[0] for name in ("lateral", "vertical", "crosslevel", "gauge")
        )
        return position + rotation @ ca.vertcat(0, half + lateral + side * gauge / 2, vertical + half * cross)

    def depth(point):
        arm = point - centre
        lateral = ca.dot(arm, axle)
        radius = vehicle.wheel.radius - side * np.tan(angle) * lateral
        return (radius - ca.norm_2(arm - lateral * axle)) * np.cos(angle)

    slope = ca.gradient(depth(rail(variable)), variable)
    deepest, newton = s, variable - slope / ca.gradient(slope, variable)
    for _ in range(2):
        deepest = ca.substitute(newton, variable, deepest)
    tangent = ca.substitute(ca.jacobian(rail(variable), variable), variable, deepest)
    tangent /= ca.norm_2(tangent)
    point = rail(deepest)
    arm = point - centre
    radial = arm - ca.dot(arm, axle) * axle
    normal = np.cos(angle) * radial / ca.norm_2(radial) + side * np.sin(angle) * axle
    lateral, slide = ca.cross(normal, tangent), velocity + ca.cross(turn, arm)

    elastic, rate = data.normal_stiffness * ca.fmax(depth(point), 0) ** 1.5, ca.dot(slide, normal)
    load = ca.fmax(elastic * (1 + data.normal_damping * rate), 0)
    rolling, slides = ca.sqrt(speed**2 + data.rest_speed**2), (ca.dot(slide, tangent), ca.dot(slide, lateral))
    scale, (a, b, kalker) = ((load + 1) / data.nominal_load) ** (1 / 3), cone_patch(vehicle)
    creep = (
        *(v / rolling for v in slides), ca.dot(turn, normal) / rolling, load, scale * a, scale * b, *kalker,
        data.shear_modulus, *vars(vehicle.adhesion["dry"]).values(),
        ca.sqrt(slides[0] ** 2 + slides[1] ** 2 + 1e-12),
    )  # fmt: skip
    f_x, f_y = polach(*creep)
    force = f_x * tangent + f_y * lateral - load * normal
    return force, ca.cross(arm, force) + spin_moment(*creep, float(spin_coefficient(a / b))) * normal, load


def _beyond(value, clearance):
    return ca.fmax(value - clearance, 0) + ca.fmin(value + clearance, 0)


def _suspension(vehicle: Vehicle, end: int, body, gear) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Force on the gear (the opposite acts on the body), and torques on gear and body about their centres (in space).

    Springs have the axes of the carrier and act on both bodies at the point of the body.
    """
    d = vehicle.suspension
    (x_b, v_b, w_b, r_b), (x_g, v_g, w_g, r_g) = body, gear
    acting = []

    def spring(lateral, level, law):
        """Element between points at a lateral position and height above the rails; law(gap, rate) -> force."""
        arm = r_b @ ca.vertcat(end * vehicle.body.gear_spacing / 2, lateral, vehicle.body.cg_height - level)
        lever = x_b + arm - x_g
        gap = lever - r_g @ ca.vertcat(0, lateral, vehicle.wheel.radius - level)
        force = r_g @ law(r_g.T @ gap, r_g.T @ (v_b + ca.cross(w_b, arm) - v_g - ca.cross(w_g, lever)))
        acting.append((force, ca.cross(lever, force), -ca.cross(arm, force)))

    def rotational(on_carrier, on_body, stiffness, damping, clearance=0.0):
        sine, axis = ca.dot(r_b[:, on_body], r_g[:, on_carrier]), ca.cross(r_b[:, on_body], r_g[:, on_carrier])
        torque = (stiffness * _beyond(sine, np.sin(clearance)) + damping * ca.dot(axis, w_b - w_g)) * axis
        acting.append((ca.SX.zeros(3), torque, -torque))

    k, c = ca.DM([d.k_x, d.k_y, d.k_z]), ca.DM([d.c_x, d.c_y, d.c_z])
    preload = ca.DM([0, 0, vehicle.body.mass * vehicle.gravity / 4])
    for side in (-1, 1):
        spring(side * d.half_spacing, d.height, lambda gap, rate: preload + k * gap + c * rate)
    spring(0, d.height, lambda gap, _: ca.vertcat(0, d.bump_stiffness * _beyond(gap[1], d.bump_clearance), 0))
    along = ca.DM([1, 0, 0])
    spring(0, vehicle.wheel.radius, lambda gap, rate: along * (d.link_stiffness * gap + d.link_damping * rate))
    x, y, z = range(3)
    rotational(z, y, d.antiroll_stiffness, d.antiroll_damping)
    rotational(x, z, d.pitch_stiffness, d.pitch_damping)
    rotational(y, x, d.yaw_stop_stiffness, 0, d.yaw_stop_angle)
    return tuple(sum(parts) for parts in zip(*acting, strict=True))


def forces(vehicle: Vehicle) -> ca.Function:
    """Everything that acts on the bodies, from their motion in space.

    Returns
    -------
    casadi.Function
        (motion[18, 3], turns[3, 4], cells[ncol, 2], s[2], tau[4]) -> loads[6, 7], s[2], measured[12]. Motion of body,
        front and rear gear: position, velocity, angular velocity, rotation by columns; turns: angular velocity of the
        wheels; cells and s of the gears, s a guess nearby; loads on body, gears, wheels: force and torque about the
        centre; measured: `MEASURED`.
    """
    motion, turns = ca.SX.sym("motion", 18, 3), ca.SX.sym("turns", 3, 4)
    cells, guess, tau = ca.SX.sym("cells", len(route.COLUMNS), 2), ca.SX.sym("s", 2), ca.SX.sym("tau", 4)
    parts = [(*ca.vertsplit(motion[:9, i], 3), ca.reshape(motion[9:, i], 3, 3)) for i in range(3)]
    loads = [ca.SX.zeros(6) for _ in range(7)]
    places, lateral, yaw, spins, normals = [], [], [], [], []
    for g, end in enumerate((1, -1)):
        gear, s = parts[1 + g], guess[g]
        get = dict(zip(route.COLUMNS, ca.vertsplit(cells[:, g]), strict=True))
        for _ in range(3):
            position, rotation = _frame(get, s)
            s += ca.dot(rotation[:, 0], gear[0] - position)
        position, rotation = _frame(get, s)
        relative, axle = rotation.T @ gear[3], gear[3][:, 1]
        places.append(s)
        lateral.append(ca.dot(rotation[:, 1], gear[0] - position))
        yaw.append(ca.atan2(relative[1, 0], relative[0, 0]))
        force, on_gear, on_body = _suspension(vehicle, end, parts[0], gear)
        loads[0] -= ca.vertcat(force, -on_body)
        loads[1 + g] += ca.vertcat(force, on_gear)
        for i, side in ((2 * g, -1), (2 * g + 1, 1)):
            arm, speed = side * vehicle.gear.contact_base / 2 * axle, ca.dot(rotation[:, 0], gear[1])
            wheel = gear[0] + arm, gear[1] + ca.cross(gear[2], arm), turns[:, i]
            force, torque, normal = _contact(vehicle, side, get, s, speed, axle, wheel)
            loads[3 + i] += ca.vertcat(force, torque - tau[i] * axle)
            loads[1 + g] += ca.vertcat(0, 0, 0, tau[i] * axle)
            spins, normals = [*spins, -ca.dot(axle, turns[:, i])], [*normals, normal]
    results = [ca.densify(ca.horzcat(*loads)), ca.vertcat(*places), ca.vertcat(*lateral, *yaw, *spins, *normals)]
    return ca.Function("space_forces", [motion, turns, cells, guess, tau], results, {"cse": True})


class ExudynCar:
    """The car in Exudyn: bodies, joints and loads by user functions; starts rolling with the front gear at s = 0."""

    def __init__(self, vehicle: Vehicle, way: route.Route, speed: float):
        import exudyn

        self._exu, self._lag, self._way = exudyn, vehicle.drive.lag, way
        self._container = exudyn.SystemContainer()
        self._mbs = self._container.AddSystem()
        self._forces = codegen.compiled(forces(vehicle))
        self._motion, self._turns, self._cells, self._s, self._tau = self._forces.arguments
        rest = rest_state(vehicle, contact_table("cone", vehicle), speed)
        body, gear, wheel = vehicle.body, vehicle.gear, vehicle.wheel
        wheels = 2 * (wheel.diametral_inertia + WHEEL_MASS * (gear.contact_base / 2) ** 2)
        carrier = (gear.inertia_x - wheels, gear.inertia_y, gear.inertia_z - wheels)
        self._markers = self._floating(vehicle, rest, body.mass, (body.inertia_x, body.inertia_y, body.inertia_z), ())
        for i, spins in ((12, -rest[36:38]), (24, -rest[38:40])):
            self._markers += self._floating(vehicle, rest[i:], gear.mass - 2 * WHEEL_MASS, carrier, spins)
        self._markers = [self._markers[i] for i in (0, 1, 4, 2, 3, 5, 6)]
        self._s[:] = rest[[12, 24]]
        self._cells[:] = way.rows_at(self._s).ravel()
        items = exudyn.itemInterface
        for number, marker in enumerate(self._markers):
            for kind, first in ((items.LoadForceVector, 0), (items.LoadTorqueVector, 3)):
                self._mbs.AddLoad(kind(markerNumber=marker, loadVectorUserFunction=self._load(number, first)))
        self._mbs.Assemble()

    def _floating(self, vehicle: Vehicle, start, mass, inertia, spins) -> list:
        """A rigid body on six joints to the ground and its wheels on revolute joints; their markers."""
        exu, joint, wheel, n = self._exu, self._exu.JointType, vehicle.wheel, 6 + len(spins)
        ends = np.array([-1, 1]) * vehicle.gear.contact_base / 2
        node = exu.itemInterface.NodeGenericODE2(
            numberOfODE2Coordinates=n,
            referenceCoordinates=[0.0] * n,
            initialCoordinates=[start[0], 0.0, start[2], *[0.0] * (n - 3)],
            initialCoordinates_t=[start[6], *[0.0] * 5, *spins],
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
        """User function of a force or torque; that of the first load evaluates all."""

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
        loads, self._found, self._measured = self._forces()
        self._loads = loads.reshape(7, 6).tolist()

    def run(self, law: Callable, exchanges: int, step: float = STEP) -> pd.DataFrame:
        """Drive under law(number of the exchange, measured) -> torque commands (4), each held for an exchange.

        An exchange has a whole number of steps.

        Returns
        -------
        DataFrame
            One row per exchange, columns `MEASURED` (SI).
        """
        self._command, self._before, self._since = np.zeros(4), np.zeros(4), 0.0
        per_exchange, log, count = round(EXCHANGE_PERIOD / step), [], 0

        def before_step(_mbs, _end):
            nonlocal count
            time = count * step
            self._evaluate(time)
            advance, self._s[:] = self._found - self._s, self._found
            if count % per_exchange == 0:
                self._cells[:] = self._way.rows_at(self._s).ravel()
                self._evaluate(time)
                self._before, self._since = self._tau.copy(), time
                log.append(self._measured.copy())
                self._command = np.asarray(law(len(log) - 1, log[-1]))
            # A step has one cell, that of its middle: a kink of the track then comes neither early nor late.
            self._cells[:] = self._way.rows_at(self._s + advance / 2).ravel()
            count += 1
            return True

        self._mbs.SetPreStepUserFunction(before_step)
        settings = self._exu.SimulationSettings()
        settings.timeIntegration.endTime = exchanges * EXCHANGE_PERIOD
        settings.timeIntegration.numberOfSteps = exchanges * per_exchange
        settings.timeIntegration.explicit.computeEndOfStepAccelerations = False
        settings.solution.file.write = False
        self._mbs.SolveDynamic(settings, solverType=self._exu.DynamicSolverType.RK44)
        return pd.DataFrame(log, columns=MEASURED)
