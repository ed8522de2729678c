"""The multibody car in place of SIMPACK: 22 degrees of freedom on independently rotating wheels.

Bodies are the car body, two wheel carriers (6 degrees of freedom each) and four wheels (spin). Velocities are
absolute, in track-frame components; angular velocities are absolute, in body axes. With these quasi-velocities
centrifugal, Coriolis, cant, inclination and gyroscopic terms are exact and no second derivative of the track is needed.

State: per body the coordinates of `kinematics.COORDINATES`, wheel speeds `w` (traction-positive, rad/s), motor torques
`tau` (traction-positive, N m); `INDEX` has the index of each. Input: torque commands of `WHEELS` (N m). Output: named
in `Car.outputs`. Signs as in the documentation: x forward, y right, z down; yaw to the right, pitch nose up, roll right
side down.

Serves the paper's section Simulation Environment. The parts: `kinematics`, `suspension`, `wheel_rail`, `integrator`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import casadi as ca
import numpy as np

from railrepro.car.integrator import Stages, rodas3
from railrepro.car.kinematics import COORDINATES, Body, named
from railrepro.car.suspension import Suspension
from railrepro.car.wheel_rail import ADHESION, Contact, shift_to_flange
from railrepro.compile.codegen import share_reciprocals, stored
from railrepro.contact.table import CELL_COLUMNS, ContactTable, in_cell
from railrepro.data import InputError
from railrepro.track import route
from railrepro.vehicle.parameters import Vehicle

GEARS = ("front", "rear")
BODIES = ("body", *GEARS)
SIDES = ("le", "ri")
WHEELS = tuple(f"{gear}_{side}" for gear in GEARS for side in SIDES)
STATES = (
    *(f"{body}.{name}" for body in BODIES for name in COORDINATES),
    *(f"w.{wheel}" for wheel in WHEELS),
    *(f"tau.{wheel}" for wheel in WHEELS),
)
INDEX = {name: i for i, name in enumerate(STATES)}
"""Index of each state in the state vector."""
FLOOR = {"floor_front": 0.5, "floor_centre": 0.0, "floor_rear": -0.5}
"""Points of the car body floor and their positions along the body over the distance of the gears."""
CONTACT_COLUMNS = len(CELL_COLUMNS)
_GROUPS = {
    "body": ("mass", "inertia_x", "inertia_y", "inertia_z", "cg_height", "gear_spacing", "floor_height"),
    "gear": ("mass", "inertia_x", "inertia_y", "inertia_z", "contact_base", "axle_damping"),
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
    "drive": ("torque_limit", "lag"),
    "contact": ("shear_modulus", "nominal_load", "normal_damping", "rest_speed"),
}
PARAMETERS = (
    *(f"{group}.{name}" for group, names in _GROUPS.items() for name in names),
    *(f"adhesion.{share}.{name}" for share in ("good", "poor") for name in ADHESION),
    "gravity",
)
SLIP_FLOOR = 1.0
"""Speed below which the slip estimate is scaled by this value instead of the speed (m/s)."""
HOLDING_SPEED = 0.2
"""Circumferential wheel speed below which a braking torque follows its wheel, to hold it at rest (m/s)."""


def indices(*names: str) -> list[int]:
    """Indices of the named states in the state vector."""
    return [INDEX[name] for name in names]


def parameter_vector(vehicle: Vehicle, good: str = "dry", poor: str = "poor") -> np.ndarray:
    """Run-time parameters of the plant in the order of `PARAMETERS` (SI), shape (len(PARAMETERS),).

    Raises
    ------
    InputError
        When the vehicle lacks an adhesion set.
    """
    for name in (good, poor):
        if name not in tuple(vehicle.adhesion):
            raise InputError(f"adhesion set {name!r} is not known; there are {list(vehicle.adhesion)}")

    def value(key: str) -> Any:
        head, *rest = key.split(".")
        if head == "adhesion":
            return getattr(vehicle.adhesion[good if rest[0] == "good" else poor], rest[1])
        return reduce(getattr, key.split("."), vehicle)

    return np.array([value(key) for key in PARAMETERS], dtype=float)


@dataclass(frozen=True)
class Car:
    """CasADi functions of the car; all share the inputs rows (3 track cells), contacts (4 table rows), parameters.

    Attributes
    ----------
    states : tuple of str
        `STATES`.
    rate : Function
        (x, u[4], rows[ncol, 3], contacts[ncell, 4], par) -> dx/dt.
    step : Function
        (x, u, rows, contacts, par, h) -> state after h (s) and embedded error estimate, Rodas3.
    coordinates : Function
        (x, rows, par) -> look-up coordinates: s of 3 bodies, then shift of 4 wheels (m); of the rows only the
        irregularities count, so those of the previous cycle serve.
    output : Function
        (x, u, rows, contacts, par) -> values named in `outputs`.
    energy : Function
        (x, u, rows, contacts, par) -> [mechanical energy (J), motor power, damping loss, creep loss (W)].
    outputs : tuple of str
        Names of the output vector.
    operations : dict
        Number of operations of the whole rate and of what contact and suspension need by themselves.
    """

    states: tuple[str, ...]
    rate: ca.Function
    step: ca.Function
    coordinates: ca.Function
    output: ca.Function
    energy: ca.Function
    outputs: tuple[str, ...]
    operations: dict[str, int]


@lru_cache(maxsize=1)
def car() -> Car:
    """The equations of motion of the car as CasADi functions; derived once (about a second), then stored."""
    return Car(**_derived())


@dataclass(frozen=True)
class _Elements:
    """Bodies of a car and what acts between them, each by name."""

    bodies: dict[str, Body]
    suspensions: dict[str, Suspension]
    wheels: dict[str, Contact]
    speeds: dict[str, ca.SX]
    torques: dict[str, ca.SX]

    @property
    def forces(self) -> tuple:
        """All elements that store energy."""
        return (*self.suspensions.values(), *self.wheels.values())


def _elements(state: dict, row: dict, cell: dict, par: dict, stages: Stages) -> _Elements:
    bodies = {name: Body(name, state, row[name]) for name in BODIES}
    suspensions = {
        gear: Suspension(bodies["body"], bodies[gear], end, par, stages)
        for gear, end in zip(GEARS, (1, -1), strict=True)
    }
    speeds, torques = ({wheel: state[f"{name}.{wheel}"] for wheel in WHEELS} for name in ("w", "tau"))
    wheels = {
        wheel: Contact(bodies[gear], side, speeds[wheel], cell[wheel], par, stages)
        for wheel, gear, side in ((f"{gear}_{side}", gear, side) for gear in GEARS for side in SIDES)
    }
    return _Elements(bodies, suspensions, wheels, speeds, torques)


@stored
def _derived() -> dict:
    """Attributes of a `Car`."""
    x, u = ca.SX.sym("x", len(STATES)), ca.SX.sym("u", len(WHEELS))
    rows = ca.SX.sym("rows", len(route.COLUMNS), len(BODIES))
    contacts = ca.SX.sym("contacts", len(CELL_COLUMNS), len(WHEELS))
    par_, h = ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("h")
    state, commands, par, stages = named(STATES, x), named(WHEELS, u), named(PARAMETERS, par_), Stages()
    row, cell = (dict(zip(names, ca.horzsplit(m), strict=True)) for names, m in ((BODIES, rows), (WHEELS, contacts)))
    elements, inertias = _elements(state, row, cell, par, stages), _inertias(par)
    staged, feels = _motion(elements, inertias, commands, par)
    rate = ca.cse(stages.resolve(staged))

    bodies, wheels = elements.bodies, elements.wheels
    x_next, error = rodas3(rate, stages.jacobian(staged, x), x, h)
    outputs = _outputs(bodies, wheels, elements.speeds, elements.torques, elements.suspensions)
    outputs |= _floor(bodies["body"], feels, par)
    energies = _energies(elements, inertias, par)
    shifts = [shift_to_flange(bodies[wheel.split("_")[0]], wheel.split("_")[1], par) for wheel in WHEELS]
    look_up = ca.vertcat(*(bodies[name].s for name in BODIES), *shifts)
    forces = {
        "all": rate,
        "contact": stages.resolve(ca.vertcat(*(ca.vertcat(w.force, w.moment) for w in wheels.values()))),
        "suspension": stages.resolve(ca.vertcat(*(s.force_on_lower for s in elements.suspensions.values()))),
    }
    inputs, names, cse = [x, u, rows, contacts, par_], ["x", "u", "rows", "contacts", "par"], {"cse": True}
    step = ca.Function("car_step", [*inputs, h], [x_next, error], [*names, "h"], ["x_next", "error"], cse)
    y, energy = stages.resolve(ca.vertcat(*outputs.values())), stages.resolve(ca.vertcat(*energies))
    return dict(
        states=STATES,
        rate=ca.Function("car_rate", inputs, [rate], names, ["dx"]),
        step=share_reciprocals(step),
        coordinates=ca.Function("car_coordinates", [x, rows, par_], [look_up], ["x", "rows", "par"], ["places"]),
        output=ca.Function("car_output", inputs, [y], names, ["y"], cse),
        energy=ca.Function("car_energy", inputs, [energy], names, ["energies"], cse),
        outputs=tuple(outputs),
        operations={name: ca.Function(name, inputs, [f], cse).n_instructions() for name, f in forces.items()},
    )


def _motion(elements: _Elements, inertias: dict, commands: dict, par: dict) -> tuple[ca.SX, dict]:
    """Derivatives of the states, and force per mass and angular acceleration that the car body feels."""
    bodies, speeds, torques = elements.bodies, elements.speeds, elements.torques
    body, gravity = bodies["body"], ca.vertcat(0, 0, par["gravity"])
    carried, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for gear, suspension in elements.suspensions.items():
        carried += body.section.rotation.T @ bodies[gear].attitude @ suspension.force_on_upper
        moment += suspension.moment_on_upper
    force = carried + par["body.mass"] * body.section.rotation.T @ gravity
    derivatives = [body.derivatives(force, moment, *inertias["body"])]
    feels = {"force": body.rotation.T @ carried / par["body.mass"], "turning": derivatives[0][-3:]}
    derivatives += [_gear_motion(name, elements, inertias[name], gravity, par) for name in GEARS]
    coupling = {wheel: par["gear.axle_damping"] * (speeds[_opposite(wheel)] - speeds[wheel]) for wheel in WHEELS}
    spin_up = [
        (torques[wheel] + coupling[wheel] - elements.wheels[wheel].moment[1]) / par["wheel.spin_inertia"]
        for wheel in WHEELS
    ]
    lag = [_torque_rate(commands[wheel], speeds[wheel], torques[wheel], par) for wheel in WHEELS]
    return ca.vertcat(*derivatives, *spin_up, *lag), feels


def _gear_motion(name: str, elements: _Elements, inertia: tuple, gravity: ca.SX, par: dict) -> ca.SX:
    """Derivatives of the states of a running gear's carrier."""
    gear, wheels = elements.bodies[name], [f"{name}_{side}" for side in SIDES]
    suspension = elements.suspensions[name]
    force = inertia[0] * gear.section.rotation.T @ gravity + gear.rotation @ suspension.force_on_lower
    moment = suspension.moment_on_lower
    for wheel in wheels:
        force += elements.wheels[wheel].force
        moment += elements.wheels[wheel].moment * ca.vertcat(1, 0, 1) + ca.vertcat(0, elements.torques[wheel], 0)
    spin = -par["wheel.spin_inertia"] * sum(elements.speeds[wheel] for wheel in wheels)
    return gear.derivatives(force, moment, *inertia, spin)


def _opposite(wheel: str) -> str:
    """The other wheel of the same gear."""
    gear, side = wheel.split("_")
    return f"{gear}_{SIDES[1 - SIDES.index(side)]}"


def _inertias(par: dict[str, ca.SX]) -> dict[str, tuple[ca.SX, ca.SX]]:
    """Mass (kg) and principal moments of inertia (kg m2, shape (3, 1)) by body."""

    def stated(prefix: str) -> tuple[ca.SX, ca.SX]:
        return par[f"{prefix}mass"], ca.vertcat(*(par[f"{prefix}inertia_{axis}"] for axis in "xyz"))

    return {"body": stated("body.")} | dict.fromkeys(GEARS, stated("gear."))


def _torque_rate(command: ca.SX, speed: ca.SX, torque: ca.SX, par: dict[str, ca.SX]) -> ca.SX:
    """Time derivative of a motor torque (N m/s): lag behind the command within the torque limit.

    A negative command brakes: its torque acts against the rotation, whatever its direction. Near standstill the lag
    slows down with the wheel, so that the torque is a function of the angle turned, stays at rest what it was, and so
    holds the wheel with anything up to the command.

    Source: Dahl 1968, A Solid Friction Model (torque over angle near rest).
    """
    limit = par["drive.torque_limit"]
    # by comparison, as fmin and fmax would make a limit of a command that is no number
    limited = ca.if_else(command > limit, limit, ca.if_else(command < -limit, -limit, command))
    turning = ca.if_else(limited < 0, ca.fmin(ca.fabs(speed) * par["wheel.radius"] / HOLDING_SPEED, 1), 1)
    wanted = ca.if_else(speed < 0, ca.fabs(limited), limited)  # a positive command drives forward at any speed
    return turning * (wanted - torque) / par["drive.lag"]


def _outputs(bodies, wheels, speeds, torques, suspensions) -> dict[str, ca.SX]:
    """Measured and logged quantities by name (SI).

    Source: eqs. (parameters) and (kalker): psi_Ax, psi_TrAx, y_TrAx; f_x, s_x.
    """
    out: dict[str, ca.SX] = {}
    for name in GEARS:
        gear = bodies[name]
        out |= {
            f"{name}.p": gear.s,
            f"{name}.psi_Ax": gear.section.psi + gear.psi,
            f"{name}.v": gear.sdot,
            f"{name}.psidot_Ax": gear.section.kappa * gear.sdot + gear.rates["psi"],
            f"{name}.y": gear.y,
            f"{name}.psi_TrAx": gear.psi,
            f"{name}.phi": gear.phi,
            f"{name}.rail_y": gear.section.lateral,
        }
    for wheel, contact in wheels.items():
        along, across = contact.tangential
        out |= {
            f"{wheel}.w": speeds[wheel],
            f"{wheel}.tau": torques[wheel],
            f"{wheel}.N": contact.normal,
            f"{wheel}.Fx": along,
            f"{wheel}.Fy": across,
            f"{wheel}.fx": along / (contact.normal + 1),
            f"{wheel}.sx": contact.sliding[0] / ca.fmax(contact.gear.vx, SLIP_FLOOR),
            f"{wheel}.nu_x": contact.creepage[0],
            f"{wheel}.nu_y": contact.creepage[1],
            f"{wheel}.spin": contact.spin,
            f"{wheel}.M_spin": contact.spin_moment,
            f"{wheel}.angle": contact.angle,
        }
    for gear, suspension in suspensions.items():
        out[f"{gear}.yaw_to_body"] = ca.asin(suspension.yaw_sine)
        out[f"{gear}.sway"] = suspension.sway
    body = bodies["body"]
    out |= {f"body.{name}": getattr(body, name) for name in ("s", "y", "z", "psi", "pitch", "phi", "vx")}
    return out


def _floor(body: Body, feels: dict[str, ca.SX], par: dict[str, ca.SX]) -> dict[str, ca.SX]:
    """Accelerations of points of the floor in axes of the car body, as an accelerometer reads them (m/s2).

    Source: Goldstein, Poole and Safko 2002, Classical Mechanics, ch. 4 (rigid body).
    """
    out: dict[str, ca.SX] = {}
    for point, position in FLOOR.items():
        lever = ca.vertcat(position * par["body.gear_spacing"], 0, par["body.cg_height"] - par["body.floor_height"])
        swing = ca.cross(feels["turning"], lever) + ca.cross(body.w, ca.cross(body.w, lever))
        out |= {
            f"{point}.a{axis}": value for axis, value in zip("xyz", ca.vertsplit(feels["force"] + swing), strict=True)
        }
    return out


def _energies(elements: _Elements, inertias: dict, par: dict) -> list[ca.SX]:
    """Mechanical energy, motor power and losses, for the energy balance."""
    speeds, torques, wheels = elements.speeds, elements.torques, elements.wheels
    energy = sum(force.energy for force in elements.forces)
    for name, body in elements.bodies.items():
        mass, inertia = inertias[name]
        energy += mass * (ca.sumsqr(body.v) / 2 - par["gravity"] * body.position[2])
        energy += ca.dot(inertia, body.w**2) / 2
    energy += par["wheel.spin_inertia"] * ca.sumsqr(ca.vertcat(*speeds.values())) / 2
    motor = sum(torques[wheel] * (speeds[wheel] + wheels[wheel].gear.wy) for wheel in WHEELS)
    creep = sum(wheel.friction_loss for wheel in wheels.values())
    damping = sum(force.dissipation for force in elements.forces)
    damping += par["gear.axle_damping"] * sum((speeds[f"{g}_le"] - speeds[f"{g}_ri"]) ** 2 for g in GEARS)
    return [energy, motor, damping, creep]


def rest_state(vehicle: Vehicle, table: ContactTable, speed: float, p: float = 0.0) -> np.ndarray:
    """State of steady rolling at a speed (m/s) on straight level track with the front gear at `p` (m), SI.

    All four wheels have the contact of the table. By `STATES`.

    Source: Johnson 1985, Contact Mechanics, section 4.2 (approach of the wheel under its load).
    """
    cell = dict(zip(CELL_COLUMNS, table.cells()[round((0.0 - table.start) / table.step)], strict=True))
    contact = in_cell(cell, 0.0 - cell["shift"])
    cos_angle = 1 / np.hypot(1, contact["slope"])
    load = (vehicle.body.mass / 4 + vehicle.gear.mass / 2) * vehicle.gravity / cos_angle
    drop = (load / contact["normal_stiffness"]) ** (2 / 3) / cos_angle
    state = dict.fromkeys(STATES, 0.0)
    half, radius = vehicle.body.gear_spacing / 2, contact["effective_radius"]
    sink, axle = vehicle.wheel.radius - radius + drop, drop - radius
    positions = {"body": (p - half, sink - vehicle.body.cg_height), "front": (p, axle), "rear": (p - 2 * half, axle)}
    for name, (s, z) in positions.items():
        state |= {f"{name}.s": s, f"{name}.z": z, f"{name}.vx": speed}
    state |= {f"w.{wheel}": speed / (contact["rolling_radius"] - drop) for wheel in WHEELS}
    return np.array(list(state.values()))
