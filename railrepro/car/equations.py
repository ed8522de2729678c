"""The multibody car in place of SIMPACK: 22 degrees of freedom on independently rotating wheels.

Bodies are the car body, two wheel carriers (6 degrees of freedom each) and four wheels (spin). Velocities are absolute,
in track-frame components; angular velocities are absolute, in body axes. With these quasi-velocities centrifugal,
Coriolis, cant, inclination and gyroscopic terms are exact and no second derivative of the track is needed.

State: per body the coordinates of `kinematics.COORDINATES`, wheel speeds `w` (traction-positive, rad/s), motor torques
`tau` (traction-positive, N m); where each stands tells `INDEX`. Input: torque commands of `WHEELS` (N m). Output: named
in `Car.outputs`. Signs as in the documentation: x forward, y right, z down; yaw to the right, pitch nose up, roll right
side down.

Serves the paper's section Simulation Environment. The parts: `kinematics`, `suspension`, `wheel_rail`, `integrator`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, reduce

import casadi as ca
import numpy as np

from railrepro.car.integrator import Stages, rodas3
from railrepro.car.kinematics import COORDINATES, Body, named
from railrepro.car.suspension import Suspension
from railrepro.car.wheel_rail import ADHESION, Contact, shift_to_flange
from railrepro.contact.table import CELL_COLUMNS, ContactTable, in_cell
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
"""Place of each state in the state vector."""
CONTACT_COLUMNS = len(CELL_COLUMNS)
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
    *(f"adhesion.{share}.{name}" for share in ("good", "poor") for name in ADHESION),
    "gravity",
)
SLIP_FLOOR = 1.0
"""Speed below which the slip estimate is scaled by this value instead of the speed (m/s)."""
BRAKE_FADE = 0.2
"""Circumferential wheel speed below which a braking torque fades out, so that it holds instead of reversing (m/s)."""


def indices(*names: str) -> list[int]:
    """Places of the named states in the state vector."""
    return [INDEX[name] for name in names]


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


@dataclass(frozen=True)
class Car:
    """CasADi functions of the car; all share the inputs rows (3 track cells), contacts (4 table rows), parameters.

    Attributes
    ----------
    rate : Function
        (x[44], u[4], rows[ncol, 3], contacts[ncell, 4], par) -> dx/dt.
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
    u = ca.SX.sym("u", len(WHEELS))
    rows = ca.SX.sym("rows", len(route.COLUMNS), len(BODIES))
    contacts = ca.SX.sym("contacts", len(CELL_COLUMNS), len(WHEELS))
    par_ = ca.SX.sym("par", len(PARAMETERS))
    state, commands, par, stages = named(STATES, x), named(WHEELS, u), named(PARAMETERS, par_), Stages()
    row, cell = (dict(zip(names, ca.horzsplit(m), strict=True)) for names, m in ((BODIES, rows), (WHEELS, contacts)))

    bodies = {name: Body(name, state, row[name]) for name in BODIES}
    body = bodies["body"]
    suspensions = {
        gear: Suspension(body, bodies[gear], end, par, stages) for gear, end in zip(GEARS, (1, -1), strict=True)
    }
    speeds, torques = ({wheel: state[f"{name}.{wheel}"] for wheel in WHEELS} for name in ("w", "tau"))
    places = {f"{gear}_{side}": (bodies[gear], side) for gear in GEARS for side in SIDES}
    wheels = {wheel: Contact(*places[wheel], speeds[wheel], cell[wheel], par, stages) for wheel in WHEELS}

    gravity = ca.vertcat(0, 0, par["gravity"])
    force = par["body.mass"] * body.section.rotation.T @ gravity
    moment = ca.SX.zeros(3)
    for gear, suspension in suspensions.items():
        force += body.section.rotation.T @ bodies[gear].attitude @ suspension.force_on_body
        moment += suspension.moment_on_body
    derivatives = [body.derivatives(force, moment, par["body.mass"], _inertia("body", par))]
    for name, suspension in suspensions.items():
        gear, own = bodies[name], [f"{name}_{side}" for side in SIDES]
        force = par["gear.mass"] * gear.section.rotation.T @ gravity + gear.rotation @ suspension.force_on_gear
        moment = suspension.moment_on_gear
        for wheel in own:
            force += wheels[wheel].force
            moment += wheels[wheel].moment + ca.vertcat(0, torques[wheel], 0)
        spin = -par["wheel.spin_inertia"] * sum(speeds[wheel] for wheel in own)
        derivatives.append(gear.derivatives(force, moment, par["gear.mass"], _inertia("gear", par), spin))
    spin_up = [(torques[wheel] - wheels[wheel].axle_moment[1]) / par["wheel.spin_inertia"] for wheel in WHEELS]
    lag = [(_available(commands[wheel], speeds[wheel], par) - torques[wheel]) / par["drive.lag"] for wheel in WHEELS]
    staged = ca.vertcat(*derivatives, *spin_up, *lag)
    rate = ca.cse(stages.resolve(staged))

    inputs, names = [x, u, rows, contacts, par_], ["x", "u", "rows", "contacts", "par"]
    h = ca.SX.sym("h")
    x_next, error = rodas3(rate, stages.jacobian(staged, x), x, h)
    shifts = [shift_to_flange(*places[wheel], par) for wheel in WHEELS]
    outputs = _outputs(bodies, wheels, speeds, torques, suspensions)
    energies = _energies(bodies, wheels, speeds, torques, suspensions, par)
    look_up = ca.vertcat(*(bodies[name].s for name in BODIES), *shifts)
    forces = {
        "all": rate,
        "contact": stages.resolve(ca.vertcat(*(ca.vertcat(w.force, w.axle_moment) for w in wheels.values()))),
        "suspension": stages.resolve(ca.vertcat(*(s.force_on_gear for s in suspensions.values()))),
    }
    counts = {
        name: ca.Function(name, inputs, [entry], {"cse": True}).n_instructions() for name, entry in forces.items()
    }
    return Car(
        rate=ca.Function("car_rate", inputs, [rate], names, ["dx"]),
        step=ca.Function("car_step", [*inputs, h], [x_next, error], [*names, "h"], ["x_next", "error"], {"cse": True}),
        coordinates=ca.Function("car_coordinates", [x, rows, par_], [look_up], ["x", "rows", "par"], ["places"]),
        output=ca.Function(
            "car_output", inputs, [stages.resolve(ca.vertcat(*outputs.values()))], names, ["y"], {"cse": True}
        ),
        energy=ca.Function(
            "car_energy", inputs, [stages.resolve(ca.vertcat(*energies))], names, ["energies"], {"cse": True}
        ),
        outputs=tuple(outputs),
        operations=counts,
    )


def _inertia(group: str, par: dict[str, ca.SX]) -> ca.SX:
    """Principal moments of inertia of the body or of a gear (kg m2), shape (3, 1)."""
    return ca.vertcat(*(par[f"{group}.inertia_{axis}"] for axis in "xyz"))


def _available(command: ca.SX, speed: ca.SX, par: dict[str, ca.SX]) -> ca.SX:
    """Motor torque that the drive can give for a command (N m): limits of torque and power, braking holds at rest."""
    limit = ca.fmin(par["drive.torque_limit"], par["drive.power_limit"] / ca.fmax(ca.fabs(speed), 1e-3))
    limited = ca.fmin(ca.fmax(command, -limit), limit)
    fade = ca.fmin(ca.fmax(speed * par["wheel.radius"] / BRAKE_FADE, 0), 1)
    return ca.if_else(limited < 0, limited * fade, limited)


def _outputs(bodies, wheels, speeds, torques, suspensions) -> dict[str, ca.SX]:
    """Measured and logged quantities by name (SI).

    Source: eqs. (parameters) and (kalker): psi_Ax, psi_TrAx, y_TrAx; f_x, s_x.
    """
    out = {}
    for name in GEARS:
        gear = bodies[name]
        out |= {
            f"{name}.p": gear.s,
            f"{name}.psi_Ax": gear.section.psi + gear.psi,
            f"{name}.v": gear.sdot,
            f"{name}.psidot_Ax": gear.section.kappa * gear.sdot + gear.rates["psi"],
            f"{name}.y": gear.y,
            f"{name}.psi_TrAx": gear.psi,
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
            f"{wheel}.angle": contact.angle,
        }
    for gear, suspension in suspensions.items():
        out[f"{gear}.yaw_to_body"] = ca.asin(suspension.yaw_sine)
    body = bodies["body"]
    out |= {f"body.{name}": getattr(body, name) for name in ("s", "y", "z", "psi", "pitch", "phi", "vx")}
    return out


def _energies(bodies, wheels, speeds, torques, suspensions, par) -> list[ca.SX]:
    """Mechanical energy, motor power and losses, for the energy balance."""
    elements = (*suspensions.values(), *wheels.values())
    energy = sum(s.energy for s in suspensions.values()) + sum(w.energy for w in wheels.values())
    for name, body in bodies.items():
        group = "body" if name == "body" else "gear"
        energy += par[f"{group}.mass"] * (ca.sumsqr(body.v) / 2 - par["gravity"] * body.position[2])
        energy += ca.dot(_inertia(group, par), body.w**2) / 2
    energy += par["wheel.spin_inertia"] * ca.sumsqr(ca.vertcat(*speeds.values())) / 2
    motor = sum(torques[wheel] * (speeds[wheel] + wheels[wheel].gear.wy) for wheel in WHEELS)
    creep = sum(wheel.friction_loss for wheel in wheels.values())
    damping = sum(element.dissipation for element in elements)
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
    ndarray, shape (len(STATES),)

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
    places = {"body": (p - half, sink - vehicle.body.cg_height), "front": (p, axle), "rear": (p - 2 * half, axle)}
    for name, (s, z) in places.items():
        state |= {f"{name}.s": s, f"{name}.z": z, f"{name}.vx": speed}
    state |= {f"w.{wheel}": speed / (contact["rolling_radius"] - drop) for wheel in WHEELS}
    return np.array(list(state.values()))
