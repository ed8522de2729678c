r"""Linear lateral model of one running gear that creeps, with half of the car body.

The control model rolls without sliding; here the wheels need creepage to carry a force. Small angles, constant speed
v::

    y' = vy - r_0 phi_Tr',   psi' = r,   m vy' = F_y + F_s + F_N + m (g phi_Tr - v^2 kappa) + F_d
    J_z r' = b F_x - k_sz (psi + psi_Tr - psi_CB) - k_dz (r + v kappa - v kappa_CB) + 2 J_Wy v/r_0 (phi_Tr' - Gamma y')
             + 2 f N y + M_d - J_z v^2 kappa'
    E' = r_0/J_Wy (tau - r_0 F_x) - v^2 kappa' b/2,   T_m tau' = du - tau
    F_y = -2 k_22 ((1 + Gamma r_0) y'/v - psi),   F_x = k_11/v (E - r b/2 - Gamma b/2 v y/r_0) + f dN

with E = r_0 (w_le - w_ri)/2 - kappa v b/2, forces F_s of the suspension and F_N normal to the rails, half the
difference dN of the wheel loads (left less right) about their mean N, half the difference F_x of the longitudinal creep
forces. At used adhesion f the terms with f make the model unstable: body roll shifts wheel load, which turns the gear
through f, and the traction of both rails acts beside the centre of a gear that is not in the middle.

Serves the lateral dynamics that the paper's eq. (discr_state_space1) leaves out.
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np
from scipy.linalg import expm

from railrepro.contact.creep import polach
from railrepro.contact.table import cone_patch
from railrepro.errors import InputError
from railrepro.schema import above, between, require
from railrepro.vehicle.parameters import Vehicle

STATES = ("y", "vy", "psi", "r", "E", "tau", "yb", "vb", "phib", "wb")
"""Displacement (m), absolute lateral velocity (m/s), yaw (rad) and yaw rate (rad/s) against the track, difference of
the wheel speeds (m/s), motor torque (N m); displacement, lateral velocity, roll and absolute roll rate of the body."""
KNOWN = ("side", "turning", "rolling", "heading", "slewing")
"""What the track does to a gear at speed v: lateral acceleration g phi_Tr - v^2 kappa (m/s2), yaw acceleration of its
frame v^2 kappa' (rad/s2), roll rate v phi_Tr' (rad/s), its heading psi_Tr - psi_CB against the car body's (rad) and the
rate of that, v (kappa - kappa_CB) (rad/s). In these terms the model depends but weakly on the speed."""
UNKNOWN = ("force", "moment")
"""Disturbances: lateral force (N) and yaw moment (N m) on the gear."""
LEAST_SPEED = 0.5
"""Slowest speed of the model (m/s); creepage has no meaning at rest."""


@dataclass(frozen=True)
class Creep:
    """How stiffly a gear's wheels creep, and what they use already.

    Attributes
    ----------
    along, across : float
        Slope of the creep force of a wheel over longitudinal and lateral creepage, k_11 and k_22 (N).
    adhesion : float
        Used adhesion f, traction positive (-).

    Raises
    ------
    InputError
        When a value is not a number in its range.
    """

    along: float
    across: float
    adhesion: float = 0.0

    def __post_init__(self):
        for name, allowed in (("along", between(-1e14, 1e14, "N")), ("across", above(0.0, 1e14, "N"))):
            require(f"Creep: {name}", getattr(self, name), allowed)
        require("Creep: adhesion", self.adhesion, between(-2.0, 2.0))


@dataclass(frozen=True)
class LateralModel:
    """dx/dt = a x + b du + e known + d unknown; see `STATES`, `KNOWN`, `UNKNOWN`.

    Attributes
    ----------
    a, b, e, d : ndarray, shapes (10, 10), (10,), (10, 5), (10, 2)
    """

    a: np.ndarray
    b: np.ndarray
    e: np.ndarray
    d: np.ndarray

    def discrete(self, period: float) -> LateralModel:
        """The same model over a period (s) with held inputs, exact: x_next = a x + b du + e known + d unknown."""
        n, inputs = len(self.a), np.column_stack([self.b, self.e, self.d])
        whole = np.zeros((n + inputs.shape[1],) * 2)
        whole[:n, :n], whole[:n, n:] = self.a, inputs
        step = expm(whole * period)[:n]
        b, e, d = np.split(step[:, n:], [1, 1 + self.e.shape[1]], axis=1)
        return LateralModel(step[:, :n], b[:, 0], e, d)


def creep_at(vehicle: Vehicle, adhesion: str, speed: float, slip: float = 0.0) -> Creep:
    """Creep of a vehicle's wheels on a rail about rolling with a longitudinal slip, as the plant's law has it.

    Means of both wheels, whose spins are opposite; speed in m/s, slip traction positive (-).

    Raises
    ------
    InputError
        When the adhesion set is not known or a number is out of range.

    Source: Polach 2005, eqs. (2) and (3).
    """
    if adhesion not in tuple(vehicle.adhesion):
        raise InputError(f"creep: adhesion set {adhesion!r} is not known; there are {list(vehicle.adhesion)}")
    require("creep: speed", speed, between(0.0, 200.0, "m/s"))
    require("creep: slip", slip, between(-1.0, 1.0))
    a, b, kalker = cone_patch(vehicle)
    law, step = astuple(vehicle.adhesion[adhesion]), 1e-6
    load, shear = vehicle.contact.nominal_load, vehicle.contact.shear_modulus
    spin = np.tan(vehicle.wheel.cone_angle) / vehicle.wheel.radius * np.array([1.0, -1.0])

    def force(along: float, across: float) -> np.ndarray:
        sliding = speed * np.hypot(slip + along, across)
        arguments: list = [-slip - along, -across, spin, load, a, b, *kalker, shear, *law, sliding]
        return np.array(polach(*arguments)).mean(axis=1)

    slope_along = (force(step, 0.0) - force(-step, 0.0))[0] / (2 * step)
    slope_across = (force(0.0, step) - force(0.0, -step))[1] / (2 * step)
    return Creep(float(slope_along), float(slope_across), float(force(0.0, 0.0)[0] / load))


def lateral_model(vehicle: Vehicle, speed: float, creep: Creep) -> LateralModel:
    """The model of a gear at a speed (m/s) of at least `LEAST_SPEED`; InputError when that is out of range."""
    require("lateral model: speed", speed, between(LEAST_SPEED, 200.0, "m/s"))
    names = (*STATES, "du", *KNOWN, *UNKNOWN)
    z = dict(zip(names, np.eye(len(names)), strict=True))  # each quantity is a row of factors of all of these
    body, gear, wheel, stage = vehicle.body, vehicle.gear, vehicle.wheel, vehicle.suspension
    v, g, r_0, base, gamma = speed, vehicle.gravity, wheel.radius, gear.contact_base, vehicle.gamma
    half, inertia = body.mass / 2, body.inertia_x / 2
    weight = (half + gear.mass) * g
    below, above_axle = body.cg_height - stage.height, stage.height - r_0

    cant_rate = z["rolling"]
    ydot = z["vy"] - r_0 * cant_rate
    roll, roll_rate = -gamma * z["y"], cant_rate - gamma * ydot
    sway = z["yb"] - below * z["phib"] - z["y"] - above_axle * roll
    sway_rate = z["vb"] - below * z["wb"] - z["vy"] - above_axle * roll_rate
    spring = 2 * stage.k_y * sway + 2 * stage.c_y * sway_rate
    bar = stage.roll_stiffness * (z["phib"] - roll) + stage.roll_damping * (z["wb"] - roll_rate)
    across = -2 * creep.across * ((1 + gamma * r_0) * ydot / v - z["psi"])
    unloading = -(bar + above_axle * spring - r_0 * across + half * g * sway + weight * z["y"]) / base
    along = creep.along / v * (z["E"] - base / 2 * z["r"] - gamma * base / 2 * v / r_0 * z["y"])
    along = along + creep.adhesion * unloading
    normal = gear.mass * g * roll + 2 * np.tan(wheel.cone_angle) * unloading
    turning = base * along + creep.adhesion * weight * z["y"] + z["moment"]
    turning = turning + 2 * wheel.spin_inertia * v / r_0 * roll_rate - stage.yaw_stiffness * (z["psi"] + z["heading"])
    turning = turning - stage.yaw_damping * (z["r"] + z["slewing"])
    rates = {
        "y": ydot,
        "vy": (across + spring + normal + z["force"]) / gear.mass + z["side"],
        "psi": z["r"],
        "r": turning / gear.inertia_z - z["turning"],
        "E": r_0 / wheel.spin_inertia * (z["tau"] - r_0 * along) - base / 2 * z["turning"],
        "tau": (z["du"] - z["tau"]) / vehicle.drive.lag,
        "yb": z["vb"] - body.cg_height * cant_rate,
        "vb": -spring / half + z["side"],
        "phib": z["wb"] - cant_rate,
        "wb": (below * spring + half * g * below * z["phib"] - bar) / inertia,
    }
    a, b, e, d = np.split(np.array([rates[name] for name in STATES]), np.cumsum([len(STATES), 1, len(KNOWN)]), axis=1)
    return LateralModel(a, b[:, 0], e, d)
