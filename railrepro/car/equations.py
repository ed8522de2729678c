"""Equations of motion of the multibody car, which stands in for SIMPACK: 22 degrees of freedom. Bodies are the car body
and two wheel carriers (6 degrees of freedom each) and four wheels (spin). Velocities are absolute in track-frame
components, angular velocities absolute in body axes. With these quasi-velocities centrifugal, Coriolis, cant,
inclination and gyroscopic terms are exact without a second derivative of the track. x forward, y right, z down; yaw to
the right, pitch nose up, roll right side down. Serves the paper's section Simulation Environment."""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Annotated, Any

import casadi as ca
import numpy as np

from railrepro.car.integrator import Stages, rodas3
from railrepro.car.kinematics import Body, Coordinates
from railrepro.car.outputs import BodyOutputs, FloorOutputs, GearOutputs, Outputs, SuspensionOutputs, WheelOutputs
from railrepro.car.suspension import Suspension
from railrepro.car.wheel_rail import Contact, shift_to_flange
from railrepro.compile.codegen import stored
from railrepro.compile.reciprocals import share_reciprocals
from railrepro.contact.table import CELL_COLUMNS, ContactTable, in_cell
from railrepro.data import InputError
from railrepro.quantities import GEARS, SIDES, WHEELS, Scalar, names, notes, pack, symbols, unpack
from railrepro.track import route
from railrepro.vehicle.parameters import AdhesionSet, CarBody, Drive, Environment, Gear, Vehicle, Wheel, WheelRail
from railrepro.vehicle.parameters import Suspension as SuspensionData

BODIES = ("body", *GEARS)


@dataclass(frozen=True)
class CarState:
    """State of the car: 12 coordinates of the car body and of each running gear; angular speeds `w` of the four wheels
    (rad/s) and their motor torques `tau` (N m), positive in traction."""

    body: Coordinates
    front: Coordinates
    rear: Coordinates
    w: Annotated[list[Scalar], WHEELS]
    tau: Annotated[list[Scalar], WHEELS]


STATES = names(CarState)
INDEX = {name: i for i, name in enumerate(STATES)}
"""Name of a state -> its index in the state vector."""
FLOOR = {"floor_front": 0.5, "floor_centre": 0.0, "floor_rear": -0.5}
"""Points of the car body floor -> distance ahead of the centre of gravity, as a fraction of the gear spacing (-)."""


@dataclass(frozen=True)
class Rails:
    """Parameters of the creep law on the normal rail (`good`) and on the slippery stretches of a track (`poor`)."""

    good: AdhesionSet
    poor: AdhesionSet


_GRAVITY = dict(notes(Environment))["gravity"]


@dataclass(frozen=True)
class CarParameters:
    """Parameters of car, rail adhesion and gravity (SI), as numbers or CasADi symbols. They are inputs of the compiled
    equations, so that another vehicle needs no compilation."""

    body: CarBody
    gear: Gear
    wheel: Wheel
    suspension: SuspensionData
    drive: Drive
    contact: WheelRail
    adhesion: Rails
    gravity: Annotated[Scalar, _GRAVITY]


PARAMETERS = names(CarParameters)
SLIP_FLOOR = 1.0
"""Lower limit of the speed by which the slip `sx` divides the sliding speed (m/s)."""
HOLDING_SPEED = 0.2
"""Circumferential wheel speed below which a braking torque follows its command more slowly, to hold the wheel (m/s)."""


def mirrored() -> dict[str, list[int]]:
    """Return how the inputs of the functions of `Car` change when front and rear running gear are exchanged, so that
    compiled code computes both at once (`pairs_text`). Inputs "x", "u", "rows", "contacts" each have a list. Its
    element i is the index of the same quantity at the other running gear, or i for the car body. Matrices count by
    columns."""
    at, wheels = unpack(CarState, range(len(STATES))), [2, 3, 0, 1]
    exchanged = CarState(at.body, at.rear, at.front, [at.w[i] for i in wheels], [at.tau[i] for i in wheels])
    rows = np.arange(len(BODIES) * len(route.COLUMNS)).reshape(len(BODIES), -1)[[0, 2, 1]]
    contacts = np.arange(len(WHEELS) * len(CELL_COLUMNS)).reshape(len(WHEELS), -1)[wheels]
    columns = {"rows": rows.ravel().tolist(), "contacts": contacts.ravel().tolist()}
    return {"x": pack(exchanged), "u": wheels} | columns


def indices(*names: str) -> list[int]:
    """Return the positions in the state vector of the car of the states with these names, such as "front.y"."""
    return [INDEX[name] for name in names]


def parameter_vector(vehicle: Vehicle, good: str = "dry", poor: str = "poor") -> np.ndarray:
    """Return the run-time parameters of the car as a vector in the order of `PARAMETERS` (SI). `good` and `poor` are
    keys of `vehicle.adhesion`: creep law of the normal rail and of slippery stretches. InputError for another name."""
    for name in (good, poor):
        if not isinstance(name, str) or name not in vehicle.adhesion:
            raise InputError(f"adhesion set {name!r} is not known; there are {list(vehicle.adhesion)}")
    groups = vehicle.body, vehicle.gear, vehicle.wheel, vehicle.suspension, vehicle.drive, vehicle.contact
    rails = Rails(vehicle.adhesion[good], vehicle.adhesion[poor])
    return np.array(pack(CarParameters(*groups, rails, vehicle.gravity)), dtype=float)


@dataclass(frozen=True)
class Car:
    """CasADi functions of the car (SI).

    Their arguments are:
    - x: state in the order of `states`;
    - u: torque commands of the four `WHEELS` (N m);
    - rows: row of the route at each of the 3 `BODIES`, shape (len(route.COLUMNS), 3);
    - contacts: row of the contact table at each of the 4 wheels, shape (len(CELL_COLUMNS), 4);
    - par: parameters in the order of `PARAMETERS`.

    Attributes:
        states, outputs (tuple of str): Names of the entries of the state and of the output vector.
        rate (Function): (x, u, rows, contacts, par) -> dx/dt.
        step (Function): (x, u, rows, contacts, par, h) -> state after one integration step of length h (s) by Rodas3.
        coordinates (Function): (x, rows, par) -> arguments of the tables, shape (7, 1): track coordinate of the 3
            bodies, then shift of the 4 wheels towards the flange (m). Of `rows` only irregularities count.
        output (Function): (x, u, rows, contacts, par) -> values of `outputs`.
        energy (Function): (x, u, rows, contacts, par) -> the four values of `component.ENERGIES`.
    """

    states: tuple[str, ...]
    rate: ca.Function
    step: ca.Function
    coordinates: ca.Function
    output: ca.Function
    energy: ca.Function
    outputs: tuple[str, ...]


class _Elements:
    """Bodies of the car, its suspensions and wheel-rail contacts, with the speeds and torques of the wheels."""

    def __init__(self, state: CarState, rows: ca.SX, contacts: ca.SX, par: CarParameters, stages: Stages):
        states = zip((state.body, state.front, state.rear), ca.horzsplit(rows), strict=True)
        self.body, *self.gears = (Body(of, row) for of, row in states)
        ends = zip(self.gears, (1, -1), strict=True)
        self.suspensions = [Suspension(self.body, gear, end, par, stages) for gear, end in ends]
        cells = zip(state.w, ca.horzsplit(contacts), product(self.gears, SIDES), strict=True)
        self.wheels = [Contact(gear, side, speed, cell, par, stages) for speed, cell, (gear, side) in cells]
        self.speeds, self.torques = state.w, state.tau


@stored
def car() -> Car:
    """Return the equations of motion of the car as CasADi functions, derived or read from disk."""
    (x, state), u = symbols(CarState, "x"), ca.SX.sym("u", len(WHEELS))
    rows = ca.SX.sym("rows", len(route.COLUMNS), len(BODIES))
    contacts = ca.SX.sym("contacts", len(CELL_COLUMNS), len(WHEELS))
    (par_, par), h, stages = symbols(CarParameters, "par"), ca.SX.sym("h"), Stages()
    elements = _Elements(state, rows, contacts, par, stages)
    staged, felt_force, felt_rotation = _motion(elements, ca.vertsplit(u), par)
    rate = ca.cse(stages.resolve(staged))
    x_next = rodas3(rate, stages.jacobian(staged, x), x, h)
    outputs = _outputs(elements, _floor(elements.body, felt_force, felt_rotation, par))
    energies = _energies(elements, par)
    shifts = [shift_to_flange(gear, side, par) for gear, side in product(elements.gears, SIDES)]
    look_up = ca.vertcat(elements.body.s, *(gear.s for gear in elements.gears), *shifts)
    inputs, arguments, cse = [x, u, rows, contacts, par_], ["x", "u", "rows", "contacts", "par"], {"cse": True}
    step = ca.Function("car_step", [*inputs, h], [x_next], [*arguments, "h"], ["x_next"], cse)
    y, energy = stages.resolve(ca.vertcat(*outputs)), stages.resolve(ca.vertcat(*energies))
    return Car(
        states=STATES,
        rate=ca.Function("car_rate", inputs, [rate], arguments, ["dx"]),
        step=share_reciprocals(step),
        coordinates=ca.Function("car_coordinates", [x, rows, par_], [look_up], ["x", "rows", "par"], ["coordinates"]),
        output=ca.Function("car_output", inputs, [y], arguments, ["y"], cse),
        energy=ca.Function("car_energy", inputs, [energy], arguments, ["energies"], cse),
        outputs=names(Outputs),
    )


def _motion(elements: _Elements, commands: list, par: CarParameters) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the derivatives of the states, the acceleration that the car body feels, and its angular acceleration."""
    speeds, torques, body = elements.speeds, elements.torques, elements.body
    gravity: Any = ca.vertcat(0, 0, par.gravity)
    carried, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for gear, suspension in zip(elements.gears, elements.suspensions, strict=True):
        carried -= body.section.rotation.T @ gear.attitude @ suspension.force_on_lower
        moment += suspension.moment_on_upper
    force = carried + par.body.mass * body.section.rotation.T @ gravity
    derivatives = [body.derivatives(force, moment, *_inertia(par.body))]
    felt = body.rotation.T @ carried / par.body.mass, derivatives[0][-3:]
    derivatives += [_gear_motion(g, elements, gravity, par) for g in range(len(GEARS))]
    opposite = [speeds[i] for i in (1, 0, 3, 2)]
    spin_up = [
        (torque + par.gear.axle_damping * (other - speed) - wheel.moment[1]) / par.wheel.spin_inertia
        for torque, other, speed, wheel in zip(torques, opposite, speeds, elements.wheels, strict=True)
    ]
    lag = [_torque_rate(*of_wheel, par) for of_wheel in zip(commands, speeds, torques, strict=True)]
    return ca.vertcat(*derivatives, *spin_up, *lag), *felt


def _gear_motion(g: int, elements: _Elements, gravity: ca.SX, par: CarParameters) -> ca.SX:
    """Compute the derivatives of the states of the wheel carrier of running gear number `g`."""
    gear, suspension, of_gear = elements.gears[g], elements.suspensions[g], slice(2 * g, 2 * g + 2)
    mass, inertia = _inertia(par.gear)
    force = mass * gear.section.rotation.T @ gravity + gear.rotation @ suspension.force_on_lower
    moment = suspension.moment_on_lower
    for wheel, torque in zip(elements.wheels[of_gear], elements.torques[of_gear], strict=True):
        force += wheel.force
        moment += wheel.moment * ca.vertcat(1, 0, 1) + ca.vertcat(0, torque, 0)
    spin = -par.wheel.spin_inertia * sum(elements.speeds[of_gear])
    return gear.derivatives(force, moment, mass, inertia, spin)


def _inertia(of: CarBody | Gear) -> tuple[Any, Any]:
    """Return mass (kg) and principal moments of inertia (kg m2, shape (3, 1)) of a body."""
    return of.mass, ca.vertcat(of.inertia_x, of.inertia_y, of.inertia_z)


def _torque_rate(command: ca.SX, speed: ca.SX, torque: ca.SX, par: CarParameters) -> ca.SX:
    """Compute the derivative of a motor torque (N m/s): first-order lag behind the command within the limit of the
    drive. A braking torque holds the wheel at rest. Source: Dahl 1968, A Solid Friction Model."""
    limit = par.drive.limit(speed)
    # comparisons, since fmin and fmax would turn NaN into a limit
    limited = ca.if_else(command > limit, limit, ca.if_else(command < -limit, -limit, command))
    fraction = ca.if_else(limited < 0, ca.fmin(ca.fabs(speed) * par.wheel.radius / HOLDING_SPEED, 1), 1)
    wanted = ca.if_else(speed < 0, ca.fabs(limited), limited)  # a positive command drives forward at any speed
    return fraction * (wanted - torque) / par.drive.lag


def _outputs(elements: _Elements, floor: list) -> list[ca.SX]:
    """Compute the values of `Outputs` in their order."""
    gears = [
        GearOutputs(
            p=gear.s,
            psi_Ax=gear.section.psi + gear.psi,
            v=gear.sdot,
            psidot_Ax=gear.section.kappa * gear.sdot + gear.rates["psi"],
            y=gear.y,
            psi_TrAx=gear.psi,
            phi=gear.phi,
            rail_y=gear.section.lateral,
        )
        for gear in elements.gears
    ]
    wheels = [
        WheelOutputs(
            w=speed,
            tau=torque,
            N=contact.normal,
            Fx=contact.tangential[0],
            Fy=contact.tangential[1],
            adhesion=contact.tangential[0] / (contact.normal + 1),
            sx=contact.sliding[0] / ca.fmax(contact.gear.vx, SLIP_FLOOR),
            nu_x=contact.creepage[0],
            nu_y=contact.creepage[1],
            spin=contact.spin,
            M_spin=contact.spin_moment,
            angle=contact.angle,
        )
        for speed, torque, contact in zip(elements.speeds, elements.torques, elements.wheels, strict=True)
    ]
    suspensions = [SuspensionOutputs(ca.asin(of.yaw_sine), of.sway) for of in elements.suspensions]
    body = elements.body
    of_body = BodyOutputs(body.s, body.y, body.z, body.psi, body.pitch, body.phi, body.vx)
    return [entry for of in (*gears, *wheels, *suspensions, of_body, *floor) for entry in pack(of)]


def _floor(body: Body, force: ca.SX, rotation: ca.SX, par: CarParameters) -> list:
    """Compute the accelerations of the points of the floor. Source: Goldstein, Poole and Safko 2002, Classical
    Mechanics, ch. 4."""
    below = par.body.cg_height - par.body.floor_height
    levers = [ca.vertcat(ahead * par.body.gear_spacing, 0, below) for ahead in FLOOR.values()]
    swings = [ca.cross(rotation, lever) + ca.cross(body.w, ca.cross(body.w, lever)) for lever in levers]
    return [FloorOutputs(*ca.vertsplit(force + swing)) for swing in swings]


def _energies(elements: _Elements, par: CarParameters) -> list[ca.SX]:
    """Compute energy, power of the motors, and losses in dampers and by creep: `component.ENERGIES`."""
    speeds, torques, wheels = elements.speeds, elements.torques, elements.wheels
    forces: list[Any] = [*elements.suspensions, *wheels]
    energy = sum(force.energy for force in forces)
    for body in (elements.body, *elements.gears):
        mass, inertia = _inertia(par.body if body is elements.body else par.gear)
        energy += mass * (ca.sumsqr(body.v) / 2 - par.gravity * body.position[2])
        energy += ca.dot(inertia, body.w**2) / 2
    energy += par.wheel.spin_inertia * ca.sumsqr(ca.vertcat(*speeds)) / 2
    motor = sum(torque * (w + wheel.gear.wy) for torque, w, wheel in zip(torques, speeds, wheels, strict=True))
    creep = sum(wheel.friction_loss for wheel in wheels)
    damping = sum(force.dissipation for force in forces)
    damping += par.gear.axle_damping * sum((speeds[i] - speeds[i + 1]) ** 2 for i in (0, 2))
    return [energy, motor, damping, creep]


def rest(table: ContactTable) -> ca.Function:
    """Make the CasADi function (parameters, speed (m/s)) -> initial state: steady rolling on straight level track,
    wheels centred, front running gear at 0 m. Parameters have the order of `PARAMETERS`, states the order of `STATES`
    (SI). Rolling radius and approach are from the table. Source: Johnson 1985, Contact Mechanics, sec. 4.2."""
    return _rest(tuple(table.cells()[table.frame["shift_m"].abs().argmin()].tolist()))


@lru_cache
def _rest(centred: tuple[float, ...]) -> ca.Function:
    (par, vehicle), speed = symbols(CarParameters, "par"), ca.SX.sym("speed")
    cell = dict(zip(CELL_COLUMNS, centred, strict=True))
    contact = in_cell(cell, 0.0 - cell["shift"])
    cos_angle = 1 / np.hypot(1, contact["slope"])
    load = (vehicle.body.mass / 4 + vehicle.gear.mass / 2) * vehicle.gravity / cos_angle
    drop = (load / contact["normal_stiffness"]) ** (2 / 3) / cos_angle
    half, axle = vehicle.body.gear_spacing / 2, drop - contact["effective_radius"]
    body = vehicle.wheel.radius - contact["effective_radius"] + drop - vehicle.body.cg_height
    state = dict.fromkeys(STATES, 0.0) | dict.fromkeys((f"{name}.vx" for name in BODIES), speed)
    state |= {"body.s": -half, "rear.s": -(2 * half), "body.z": body, "front.z": axle, "rear.z": axle}
    state |= dict.fromkeys((f"w.{wheel}" for wheel in WHEELS), speed / (contact["rolling_radius"] - drop))
    return ca.Function("car_rest", [par, speed], [ca.densify(ca.vertcat(*state.values()))])
