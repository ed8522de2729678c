"""The multibody car in place of SIMPACK: 22 degrees of freedom on independently rotating wheels.

Bodies are the car body, two wheel carriers (6 degrees of freedom each) and four wheels (spin); with a two-stage
suspension also two frames between them, 34 degrees of freedom, their states after all others. Velocities are absolute,
in track-frame components; angular velocities are absolute, in body axes. With these quasi-velocities centrifugal,
Coriolis, cant, inclination and gyroscopic terms are exact and no second derivative of the track is needed.

State: per body the coordinates of `kinematics.COORDINATES`, wheel speeds `w` (traction-positive, rad/s), motor torques
`tau` (traction-positive, N m); `INDEX` has the place of each. Input: torque commands of `WHEELS` (N m). Output: named
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
from railrepro.car.suspension import PrimaryStage, Suspension
from railrepro.car.wheel_rail import ADHESION, Contact, shift_to_flange
from railrepro.compile.codegen import share_reciprocals, stored
from railrepro.contact.table import CELL_COLUMNS, ContactTable, in_cell
from railrepro.errors import InputError
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
FRAMES = {gear: f"{gear}_frame" for gear in GEARS}
TWO_STAGE_STATES = (*STATES, *(f"{frame}.{name}" for frame in FRAMES.values() for name in COORDINATES))
"""States with frames, those without them first."""
INDEX = {name: i for i, name in enumerate(TWO_STAGE_STATES)}
"""Place of each state in the state vector."""
FLOOR = {"floor_front": 0.5, "floor_centre": 0.0, "floor_rear": -0.5}
"""Points of the car body floor and their places along the body over the distance of the gears."""
CONTACT_COLUMNS = len(CELL_COLUMNS)
_GROUPS = {
    "body": ("mass", "inertia_x", "inertia_y", "inertia_z", "cg_height", "gear_spacing", "floor_height"),
    "gear": ("mass", "inertia_x", "inertia_y", "inertia_z", "contact_base", "axle_damping"),
    "wheel": ("radius", "spin_inertia"),
    "wear": ("front_le", "front_ri", "rear_le", "rear_ri"),
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
        *("antiroll_stiffness", "antiroll_damping", "pitch_stiffness", "pitch_damping", "pitch_rods_on_carrier"),
        *("yaw_stop_angle", "yaw_stop_stiffness", "bump_clearance", "bump_stiffness"),
    ),
    "primary": (
        *("frame_mass", "frame_inertia_x", "frame_inertia_y", "frame_inertia_z", "half_spacing"),
        *("k_x", "c_x", "k_y", "c_y", "k_z", "c_z", "pitch_stiffness", "pitch_damping"),
    ),
    "drive": ("torque_limit", "power_limit", "lag"),
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
    """Places of the named states in the state vector."""
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
        if key == "drive.power_limit" and not vehicle.drive.power_limited:
            return np.inf
        return reduce(getattr, key.split("."), vehicle)

    values = np.array([value(key) for key in PARAMETERS], dtype=float)
    return np.where(np.isinf(values), 1e12, values)


@dataclass(frozen=True)
class Car:
    """CasADi functions of the car; all share the inputs rows (3 track cells), contacts (4 table rows), parameters.

    Attributes
    ----------
    states : tuple of str
        `STATES`, or `TWO_STAGE_STATES`.
    rate : Function
        (x, u[4], rows[ncol, 3], contacts[ncell, 4], par) -> dx/dt.
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

    states: tuple[str, ...]
    rate: ca.Function
    step: ca.Function
    coordinates: ca.Function
    output: ca.Function
    energy: ca.Function
    outputs: tuple[str, ...]
    operations: dict[str, int]


@lru_cache(maxsize=2)
def car(two_stage: bool = False) -> Car:
    """The equations of motion of the car as CasADi functions; derived once (about a second), then stored.

    With `two_stage` a frame stands on a primary suspension between each carrier and the car body.
    """
    return Car(**_derived(bool(two_stage)))


@dataclass(frozen=True)
class _Elements:
    """Bodies of a car and what acts between them, each by name; `frames` and `primaries` belong to two stages."""

    bodies: dict[str, Body]
    frames: dict[str, Body]
    suspensions: dict[str, Suspension]
    primaries: dict[str, PrimaryStage]
    wheels: dict[str, Contact]
    speeds: dict[str, ca.SX]
    torques: dict[str, ca.SX]

    @property
    def moving(self) -> dict[str, Body]:
        """All bodies by the names of their states."""
        return self.bodies | {FRAMES[name]: frame for name, frame in self.frames.items()}

    @property
    def forces(self) -> tuple:
        """All elements that store energy."""
        return (*self.suspensions.values(), *self.primaries.values(), *self.wheels.values())


def _elements(state: dict, row: dict, cell: dict, par: dict, stages: Stages, two_stage: bool) -> _Elements:
    bodies = {name: Body(name, state, row[name]) for name in BODIES}
    frames = {gear: Body(frame, state, row[gear]) for gear, frame in FRAMES.items()} if two_stage else {}
    suspensions = {
        gear: Suspension(bodies["body"], frames.get(gear, bodies[gear]), end, par, stages)
        for gear, end in zip(GEARS, (1, -1), strict=True)
    }
    primaries = {gear: PrimaryStage(frame, bodies[gear], par, stages) for gear, frame in frames.items()}
    speeds, torques = ({wheel: state[f"{name}.{wheel}"] for wheel in WHEELS} for name in ("w", "tau"))
    wheels = {
        wheel: Contact(bodies[gear], side, speeds[wheel], cell[wheel], par, stages, par[f"wear.{wheel}"])
        for wheel, gear, side in ((f"{gear}_{side}", gear, side) for gear in GEARS for side in SIDES)
    }
    return _Elements(bodies, frames, suspensions, primaries, wheels, speeds, torques)


@stored
def _derived(two_stage: bool) -> dict:
    """Attributes of a `Car`."""
    states = TWO_STAGE_STATES if two_stage else STATES
    x, u = ca.SX.sym("x", len(states)), ca.SX.sym("u", len(WHEELS))
    rows = ca.SX.sym("rows", len(route.COLUMNS), len(BODIES))
    contacts = ca.SX.sym("contacts", len(CELL_COLUMNS), len(WHEELS))
    par_, h = ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("h")
    state, commands, par, stages = named(states, x), named(WHEELS, u), named(PARAMETERS, par_), Stages()
    row, cell = (dict(zip(names, ca.horzsplit(m), strict=True)) for names, m in ((BODIES, rows), (WHEELS, contacts)))
    elements, inertias = _elements(state, row, cell, par, stages, two_stage), _inertias(par, two_stage)
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
    kind = "two_stage_car" if two_stage else "car"
    inputs, names, cse = [x, u, rows, contacts, par_], ["x", "u", "rows", "contacts", "par"], {"cse": True}
    step = ca.Function(f"{kind}_step", [*inputs, h], [x_next, error], [*names, "h"], ["x_next", "error"], cse)
    y, energy = stages.resolve(ca.vertcat(*outputs.values())), stages.resolve(ca.vertcat(*energies))
    return dict(
        states=states,
        rate=ca.Function(f"{kind}_rate", inputs, [rate], names, ["dx"]),
        step=share_reciprocals(step),
        coordinates=ca.Function(f"{kind}_coordinates", [x, rows, par_], [look_up], ["x", "rows", "par"], ["places"]),
        output=ca.Function(f"{kind}_output", inputs, [y], names, ["y"], cse),
        energy=ca.Function(f"{kind}_energy", inputs, [energy], names, ["energies"], cse),
        outputs=tuple(outputs),
        operations={name: ca.Function(name, inputs, [f], cse).n_instructions() for name, f in forces.items()},
    )


def _motion(elements: _Elements, inertias: dict, commands: dict, par: dict) -> tuple[ca.SX, dict]:
    """Derivatives of the states, and force per mass and angular acceleration that the car body feels."""
    bodies, frames, speeds, torques = elements.bodies, elements.frames, elements.speeds, elements.torques
    body, gravity = bodies["body"], ca.vertcat(0, 0, par["gravity"])
    carried, moment = ca.SX.zeros(3), ca.SX.zeros(3)
    for gear, suspension in elements.suspensions.items():
        carrying = frames.get(gear, bodies[gear])
        carried += body.section.rotation.T @ carrying.attitude @ suspension.force_on_upper
        moment += suspension.moment_on_upper
    carried += ca.vertcat(0, body.section.side_force, 0)
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
    framed = []
    for name, frame in frames.items():
        above, below = elements.suspensions[name], elements.primaries[name]
        pushed = frame.section.rotation.T @ bodies[name].attitude @ below.force_on_upper
        force = inertias[FRAMES[name]][0] * frame.section.rotation.T @ gravity + pushed
        force += frame.rotation @ above.force_on_lower
        moment = below.moment_on_upper + above.moment_on_lower
        framed.append(frame.derivatives(force, moment, *inertias[FRAMES[name]]))
    return ca.vertcat(*derivatives, *spin_up, *lag, *framed), feels


def _gear_motion(name: str, elements: _Elements, inertia: tuple, gravity: ca.SX, par: dict) -> ca.SX:
    """Derivatives of the states of a running gear's carrier."""
    gear, wheels = elements.bodies[name], [f"{name}_{side}" for side in SIDES]
    stage = elements.primaries.get(name, elements.suspensions[name])
    force = inertia[0] * gear.section.rotation.T @ gravity + gear.rotation @ stage.force_on_lower
    moment = stage.moment_on_lower
    for wheel in wheels:
        force += elements.wheels[wheel].force
        moment += elements.wheels[wheel].moment * ca.vertcat(1, 0, 1) + ca.vertcat(0, elements.torques[wheel], 0)
    spin = -par["wheel.spin_inertia"] * sum(elements.speeds[wheel] for wheel in wheels)
    return gear.derivatives(force, moment, *inertia, spin)


def _opposite(wheel: str) -> str:
    """The other wheel of the same gear."""
    gear, side = wheel.split("_")
    return f"{gear}_{SIDES[1 - SIDES.index(side)]}"


def _inertias(par: dict[str, ca.SX], two_stage: bool) -> dict[str, tuple[ca.SX, ca.SX]]:
    """Mass (kg) and principal moments of inertia (kg m2, shape (3, 1)) by body; a gear's contain those of its frame."""

    def stated(prefix: str) -> tuple[ca.SX, ca.SX]:
        return par[f"{prefix}mass"], ca.vertcat(*(par[f"{prefix}inertia_{axis}"] for axis in "xyz"))

    gear, found = stated("gear."), {"body": stated("body.")}
    if not two_stage:
        return found | dict.fromkeys(GEARS, gear)
    frame = stated("primary.frame_")
    carrier = gear[0] - frame[0], gear[1] - frame[1]
    return found | dict.fromkeys(GEARS, carrier) | dict.fromkeys(FRAMES.values(), frame)


def _torque_rate(command: ca.SX, speed: ca.SX, torque: ca.SX, par: dict[str, ca.SX]) -> ca.SX:
    """Time derivative of a motor torque (N m/s): lag behind the command within the limits of torque and power.

    A negative command brakes: its torque acts against the rotation, whatever its direction. Near standstill the lag
    slows down with the wheel, so that the torque is a function of the angle turned, stays at rest what it was, and so
    holds the wheel with anything up to the command.

    Source: Dahl 1968, A Solid Friction Model (torque over angle near rest).
    """
    limit = ca.fmin(par["drive.torque_limit"], par["drive.power_limit"] / ca.fmax(ca.fabs(speed), 1e-3))
    limited = ca.fmin(ca.fmax(command, -limit), limit)
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
    for point, place in FLOOR.items():
        lever = ca.vertcat(place * par["body.gear_spacing"], 0, par["body.cg_height"] - par["body.floor_height"])
        swing = ca.cross(feels["turning"], lever) + ca.cross(body.w, ca.cross(body.w, lever))
        out |= {
            f"{point}.a{axis}": value for axis, value in zip("xyz", ca.vertsplit(feels["force"] + swing), strict=True)
        }
    return out


def _energies(elements: _Elements, inertias: dict, par: dict) -> list[ca.SX]:
    """Mechanical energy, motor power and losses, for the energy balance."""
    speeds, torques, wheels = elements.speeds, elements.torques, elements.wheels
    energy = sum(force.energy for force in elements.forces)
    for name, body in elements.moving.items():
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

    All four wheels have the contact of the table. Worn wheels stand on their rails: the gears sink and roll, the car
    body sinks and pitches. By `STATES` or, with a two-stage suspension, `TWO_STAGE_STATES`.

    Source: Johnson 1985, Contact Mechanics, section 4.2 (approach of the wheel under its load).
    """
    cell = dict(zip(CELL_COLUMNS, table.cells()[round((0.0 - table.start) / table.step)], strict=True))
    contact = in_cell(cell, 0.0 - cell["shift"])
    cos_angle = 1 / np.hypot(1, contact["slope"])
    load = (vehicle.body.mass / 4 + vehicle.gear.mass / 2) * vehicle.gravity / cos_angle
    drop = (load / contact["normal_stiffness"]) ** (2 / 3) / cos_angle
    two_stage = vehicle.primary.two_stage
    state = dict.fromkeys(TWO_STAGE_STATES if two_stage else STATES, 0.0)
    half, radius = vehicle.body.gear_spacing / 2, contact["effective_radius"]
    worn = {gear: [getattr(vehicle.wear, f"{gear}_{side}") for side in SIDES] for gear in GEARS}
    front, rear = (sum(worn[gear]) / 2 for gear in GEARS)
    sink, axle = vehicle.wheel.radius - radius + drop + (front + rear) / 2, drop - radius
    places = {"body": (p - half, sink - vehicle.body.cg_height)}
    places |= {"front": (p, axle + front), "rear": (p - 2 * half, axle + rear)}
    if two_stage:
        places |= {FRAMES[gear]: places[gear] for gear in GEARS}
    for name, (s, z) in places.items():
        state |= {f"{name}.s": s, f"{name}.z": z, f"{name}.vx": speed}
    base = vehicle.gear.contact_base - 2 * radius * abs(contact["slope"])  # a roll moves the contacts aside, too
    for gear, (le, ri) in worn.items():
        for name in (gear, FRAMES[gear]) if two_stage else (gear,):
            state[f"{name}.phi"] = (ri - le) / base
        for side, lost in zip(SIDES, (le, ri), strict=True):
            state[f"w.{gear}_{side}"] = speed / (contact["rolling_radius"] - lost - drop)
    state["body.pitch"] = (rear - front) / vehicle.body.gear_spacing
    return np.array(list(state.values()))
