r"""Linear lateral model of one running gear whose wheels creep, with half of the car body.

The control model of the paper rolls without sliding; here the wheels need creepage to carry a force. Small angles,
constant speed v::

    y' = vy - r_0 phi_Tr',   psi' = r,   m vy' = F_y + F_s + F_N + m (g phi_Tr - v^2 kappa) + F_d
    J_z r' = b F_x - k_sz (psi + psi_Tr - psi_CB) - k_dz (r + v kappa - v kappa_CB) + 2 J_Wy v/r_0 (phi_Tr' - Gamma y')
             + M_s + M_d - J_z v^2 kappa'
    E' = r_0/J_Wy (tau - r_0 F_x) - v^2 kappa' b/2,   T_m tau' = du - tau,   F_x = k_11/v (E - r b/2 - lambda v y/r_0)

with E = r_0 (w_le - w_ri)/2 - kappa v b/2, force F_s of the suspension, lateral creep force F_y and moment M_s of both
contacts, force F_N normal to the rails, and half the difference F_x of the longitudinal creep forces. Forces of the
contact count y from the rails.

A profile is not linear: its secants belong to one displacement. What its contact angle and rolling radius make of
another one is an offset of y in their terms (`bend`), which is known where the gear will be.

Serves the lateral dynamics that the paper's eq. (discr_state_space1) leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple

import numpy as np
from scipy.linalg import expm

from railrepro.contact.creep import polach, spin_moment
from railrepro.contact.table import contact_table
from railrepro.vehicle.parameters import Vehicle

STATES = ("y", "vy", "psi", "r", "E", "tau", "yb", "vb", "phib", "wb")
"""Displacement (m), absolute lateral velocity (m/s), yaw (rad) and yaw rate (rad/s) against the track, difference of
the wheel speeds (m/s), motor torque (N m); displacement, lateral velocity, roll and absolute roll rate of the body."""
KNOWN = ("side", "turning", "rolling", "heading", "slewing", "rail_offset", "rail_rate", "angle_bend", "radius_bend")
"""What the track does to a gear at speed v: lateral acceleration g phi_Tr - v^2 kappa (m/s2), yaw acceleration of its
frame v^2 kappa' (rad/s2), roll rate v phi_Tr' (rad/s), its heading psi_Tr - psi_CB against the car body's (rad) and the
rate of that, v (kappa - kappa_CB) (rad/s); lateral offset of the rails from the track (m) and its rate (m/s); `bend` of
the profile (m)."""
UNKNOWN = ("force", "moment")
"""Disturbances: lateral force (N) and yaw moment (N m) on the gear."""
UNITS = (1e-3, 1e-2, 1e-3, 1e-2, 1e-2, 100.0, 1e-2, 1e-2, 1e-3, 1e-2)
"""Usual sizes of the states (SI), in which Riccati equations are well scaled."""
_REACH = 1e-3
"""Displacement over which a profile counts as linear: secants from here to the other side (m)."""
_INSIDE, _PITCH = 4.5e-3, 2.5e-5
"""Displacement up to which `bend` follows a profile, inside of its flange, and pitch of its table (m)."""
_CREEP_SPEED = 20.0
"""Speed at which the slopes of the creep law are taken (m/s); wheels that roll hardly slide."""


def discrete(rates: np.ndarray, inputs: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition over a time (s), and effect of inputs that are held, exact; x' = rates x + inputs u."""
    n, k = inputs.shape
    step = expm(time * np.block([[rates, inputs], [np.zeros((k, n + k))]]))
    return step[:n, :n], step[:n, n:]


def _frame(vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Contact of a wheel over its shift towards the flange, by column."""
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    return {name: frame[name].to_numpy() for name in frame}


def _secants(vehicle: Vehicle) -> tuple[float, float, float]:
    """Slope of the contact angle s = dr/dy (-), its change over the shift (1/m), and the conicity lambda (-)."""
    frame = _frame(vehicle)
    columns = frame["effective_radius_m"], np.tan(frame["angle_rad"]), frame["rolling_radius_m"]
    ends = [np.interp((-_REACH, _REACH), frame["shift_m"], column) for column in columns]
    slope, steepening, conicity = (float(high - low) / (2 * _REACH) for low, high in ends)
    return slope, steepening, conicity


def bend(vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (m), shape (n,), and how far the contact angle and the rolling radius there belong to another
    displacement in the terms of their secants (m), shape (2, n); zero on cones."""
    frame, (_, *rates) = _frame(vehicle), _secants(vehicle)
    at = np.arange(-_INSIDE, _INSIDE + _PITCH / 2, _PITCH)
    found = np.zeros((2, len(at)))
    for row, column, rate in zip(found, (np.tan(frame["angle_rad"]), frame["rolling_radius_m"]), rates, strict=True):
        if abs(rate) > 1e-9:
            low, high = (np.interp(side * at, frame["shift_m"], column) for side in (-1, 1))
            row[:] = (high - low) / (2 * rate) - at
    return at, found


def _both_wheels(vehicle: Vehicle) -> Callable[..., np.ndarray]:
    """Function that gives the creep forces of both wheels together, along and across (N), and their moment (N m).

    Its arguments are longitudinal and lateral creepage (-), displacement (m), turning r/v (1/m) and the load that moves
    to the left wheel (N).
    """
    frame, law = _frame(vehicle), astuple(vehicle.adhesion["dry"])
    load, shear, r_0 = vehicle.contact.nominal_load, vehicle.contact.shear_modulus, vehicle.wheel.radius
    side = np.array([-1.0, 1.0])

    def forces(along=0.0, across=0.0, y=0.0, turning=0.0, moved=0.0) -> np.ndarray:
        at = {name: np.interp(side * y, frame["shift_m"], column) for name, column in frame.items()}
        each = load - side * moved
        scale = (each / load) ** (1 / 3)
        patch = scale * at["semi_axis_x_m"], scale * at["semi_axis_y_m"], at["c11"], at["c22"], at["c23"], at["c33"]
        spin = turning - side * np.sin(at["angle_rad"]) / r_0
        sliding = _CREEP_SPEED * np.hypot(along, across)
        arguments: list = [-along, across, spin, each, *patch, shear, *law, sliding]
        return np.array([*polach(*arguments), spin_moment(*arguments)]).sum(axis=1)

    return forces


def _creep(vehicle: Vehicle) -> tuple[float, np.ndarray]:
    """k_11 (N), and lateral force and moment of both wheels per displacement (m), lateral creepage (-), turning (1/m)
    and load that moves to the left wheel (N), shape (2, 4)."""
    forces = _both_wheels(vehicle)

    def slope(name: str, size: float) -> np.ndarray:
        return (forces(**{name: size}) - forces(**{name: -size})) / (2 * size)

    load = vehicle.contact.nominal_load
    sizes = {"y": _REACH, "across": 1e-6, "turning": 1e-6, "moved": 1e-3 * load}
    per = np.array([slope(name, size)[1:] for name, size in sizes.items()]).T
    return float(slope("along", 1e-6)[0]) / 2, per


def lateral_model(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, ...]:
    """Matrices a (10, 10), b (10,), e (10, 9), d (10, 2) of x' = a x + b du + e known + d unknown at a speed (m/s)."""
    names = (*STATES, "du", *KNOWN, *UNKNOWN)
    z = dict(zip(names, np.eye(len(names)), strict=True))  # each quantity is a row of factors of all of these
    body, gear, wheel, stage = vehicle.body, vehicle.gear, vehicle.wheel, vehicle.suspension
    v, g, r_0, base = speed, vehicle.gravity, wheel.radius, gear.contact_base
    (slope, steepening, conicity), (k_11, creep) = _secants(vehicle), _creep(vehicle)
    gamma, half = vehicle.roll_per_shift(slope), body.mass / 2
    weight, above_axle, below = (half + gear.mass) * g, stage.height - r_0, body.cg_height - stage.height

    ydot = z["vy"] - r_0 * z["rolling"]
    aside, aside_rate = z["y"] - z["rail_offset"], ydot - z["rail_rate"]  # against the rails where they lie
    angled, radial = aside + z["angle_bend"], aside + z["radius_bend"]
    roll, roll_rate = -gamma * aside, z["rolling"] - gamma * aside_rate
    sway = z["yb"] - below * z["phib"] - z["y"] - above_axle * roll
    sway_rate = z["vb"] - below * z["wb"] - z["vy"] - above_axle * roll_rate
    spring = 2 * stage.k_y * sway + 2 * stage.c_y * sway_rate
    bar = stage.roll_stiffness * (z["phib"] - roll) + stage.roll_damping * (z["wb"] - roll_rate)

    creepage, turn = (ydot + gamma * r_0 * aside_rate) / v - z["psi"], z["r"] / v
    across, moment = creep[:, :3] @ np.array([angled, creepage, turn])
    centring = -weight * steepening * angled
    per_load = 2 * slope + creep[0, 3]
    unloading = -(bar + above_axle * spring - r_0 * (across + centring) + half * g * sway + weight * aside)
    unloading = unloading / (base - r_0 * per_load)
    along = k_11 / v * (z["E"] - base / 2 * z["r"] - conicity * v / r_0 * radial)
    normal = gear.mass * g * roll + centring + per_load * unloading
    turning = base * along + moment + creep[1, 3] * unloading + z["moment"]
    turning = turning + 2 * wheel.spin_inertia * v / r_0 * roll_rate - stage.yaw_stiffness * (z["psi"] + z["heading"])
    turning = turning - stage.yaw_damping * (z["r"] + z["slewing"])
    rates = {
        "y": ydot,
        "vy": (across + spring + normal + z["force"]) / gear.mass + z["side"],
        "psi": z["r"],
        "r": turning / gear.inertia_z - z["turning"],
        "E": r_0 / wheel.spin_inertia * (z["tau"] - r_0 * along) - base / 2 * z["turning"],
        "tau": (z["du"] - z["tau"]) / vehicle.drive.lag,
        "yb": z["vb"] - body.cg_height * z["rolling"],
        "vb": -spring / half + z["side"],
        "phib": z["wb"] - z["rolling"],
        "wb": (below * spring + half * g * below * z["phib"] - bar) / (body.inertia_x / 2),
    }
    a, b, e, d = np.split(np.array([rates[name] for name in STATES]), np.cumsum([len(STATES), 1, len(KNOWN)]), axis=1)
    return a, b[:, 0], e, d
