r"""Linear lateral model of one running gear that creeps, with half of the car body.

The control model rolls without sliding; here the wheels need creepage to carry a force. Small angles, constant speed
v::

    y' = vy - r_0 phi_Tr',   psi' = r,   m vy' = F_y + F_s + F_N + m (g phi_Tr - v^2 kappa) + F_d
    J_z r' = b F_x - k_sz (psi + psi_Tr - psi_CB) - k_dz (r + v kappa - v kappa_CB) + 2 J_Wy v/r_0 (phi_Tr' - Gamma y')
             + 2 f N y + M_d - J_z v^2 kappa'
    E' = r_0/J_Wy (tau - r_0/w F_x) - v^2 kappa' b/2,   T_m tau' = du - tau
    F_y = -2 k_22 ((1 + Gamma r_0) y'/v - psi) + S_y,   F_x = k_11/v (E - r b/2 - lambda v y/r_0) + f dN

with E = r_0 (w_le - w_ri)/2 - kappa v b/2, forces F_s of the suspension and F_N normal to the rails, half the
difference dN of the wheel loads (left less right) about their mean N, half the difference F_x of the longitudinal creep
forces. At used adhesion f the terms with f make the model unstable: body roll shifts wheel load, which turns the gear
through f, and the traction of both rails acts beside the centre of a gear that is not in the middle.

The contact of wheels with a profile (`Shape`) turns and wanders with the displacement y. Its slope pushes the gear
back by F_N = 2 (s dN - N s' y), its spin pushes it away by S_y and turns it (`Spin`), and traction gains a longer arm:
f N y becomes f N (1 + arm) y. On cones s' and the arm are zero and lambda is the slope s. Where rails lie aside of the
track, forces of the contact count y from the rails. A profile is not linear: its secants belong to one displacement,
and what its contact angle, rolling radius and contact point make of another one is an offset of y in their terms
(`shifts`), which is known where the gear will be.

The share w is 1 where both wheels creep alike. Where one of them slides and has no stiffness left, E is the speed of
the other one, which holds with twice the mean stiffness; F_x is half of its force: w = 1/2.

Serves the lateral dynamics that the paper's eq. (7) leaves out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass, field

import numpy as np
from scipy.linalg import expm

from railrepro.contact.creep import polach, spin_moment
from railrepro.contact.table import contact_table
from railrepro.data import InputError, above, between, require
from railrepro.vehicle.parameters import Vehicle

STATES = ("y", "vy", "psi", "r", "E", "tau", "yb", "vb", "phib", "wb")
"""Displacement (m), absolute lateral velocity (m/s), yaw (rad) and yaw rate (rad/s) against the track, difference of
the wheel speeds (m/s), motor torque (N m); displacement, lateral velocity, roll and absolute roll rate of the body."""
KNOWN: tuple[str, ...] = ("side", "turning", "rolling", "heading", "slewing", "rail_offset", "rail_rate")
KNOWN += ("angle_shift", "radius_shift", "contact_shift")
"""What the track does to a gear at speed v: lateral acceleration g phi_Tr - v^2 kappa (m/s2), yaw acceleration of its
frame v^2 kappa' (rad/s2), roll rate v phi_Tr' (rad/s), its heading psi_Tr - psi_CB against the car body's (rad) and the
rate of that, v (kappa - kappa_CB) (rad/s); lateral offset of the rails from the track (m) and its
rate (m/s); `shifts` of the profile (m). In these terms the model depends but weakly on the speed."""
SHIFTS = slice(KNOWN.index("angle_shift"), len(KNOWN))
"""Place of `shifts` in `KNOWN`."""
UNKNOWN = ("force", "moment")
"""Disturbances: lateral force (N) and yaw moment (N m) on the gear."""
LEAST_SPEED = 0.5
"""Slowest speed of the model (m/s); creepage has no meaning at rest."""
REACH = 1e-3
"""Displacement over which a profile counts as linear: secants from here to the other side (m)."""
_INSIDE, _PITCH = 4.5e-3, 2.5e-5
"""Displacement up to which `shifts` follows a profile, inside of its flange, and pitch of its table (m)."""


@dataclass(frozen=True)
class Shape:
    """A wheel's contact on its rail over the shift towards the flange, secants over twice `REACH`.

    Attributes
    ----------
    slope : float
        Tangent s of the contact angle (-).
    slope_rate : float
        Its change s' over the shift (1/m).
    conicity : float
        Change lambda of the rolling radius (-).
    arm : float
        How far the contact moves on the rail, to the track's middle (-).
    """

    slope: float
    slope_rate: float
    conicity: float
    arm: float


@dataclass(frozen=True)
class Spin:
    """Lateral force S_y on both wheels and their moment about the vertical, beyond k_22.

    Attributes
    ----------
    force : tuple of 3 float
        Lateral force per displacement (N/m), per turning r/v (N m) and per load that moves to the left wheel (-).
    moment : tuple of 4 float
        Moment per displacement (N), per turning (N m2), per load (m) and per lateral creepage (N m).
    """

    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    moment: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)

    def times(self, factor: float) -> Spin:
        """The same with forces and moments times a factor."""
        return Spin(tuple(factor * np.array(self.force)), tuple(factor * np.array(self.moment)))


@dataclass(frozen=True)
class Creep:
    """How stiffly a gear's wheels creep, and what they use already.

    Attributes
    ----------
    along, across : float
        Slope of the creep force of a wheel over longitudinal and lateral creepage, k_11 and k_22 (N).
    adhesion : float
        Used adhesion f, traction positive (-).
    spin : Spin
        By default none.
    share : float
        Share w of a difference of the wheel torques that both rails together take from the wheels, 1 or less (-).

    Raises
    ------
    InputError
        When a value is not a number in its range.
    """

    along: float
    across: float
    adhesion: float = 0.0
    spin: Spin = field(default_factory=Spin)
    share: float = 1.0

    def __post_init__(self):
        for name, allowed in (("along", between(-1e14, 1e14, "N")), ("across", above(0.0, 1e14, "N"))):
            require(f"Creep: {name}", getattr(self, name), allowed)
        require("Creep: adhesion", self.adhesion, between(-2.0, 2.0))
        require("Creep: spin", self.spin, Spin)
        require("Creep: share", self.share, between(0.5, 1.0))


@dataclass(frozen=True)
class LateralModel:
    """dx/dt = a x + b du + e known + d unknown; see `STATES`, `KNOWN`, `UNKNOWN`.

    Attributes
    ----------
    a, b, e, d : ndarray, shapes (10, 10), (10,), (10, 10), (10, 2)
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


def shape(vehicle: Vehicle) -> Shape:
    """The `Shape` of a vehicle's wheels in the middle of the track."""
    shift, radius, *columns = _contact(vehicle)

    def secant(column: np.ndarray) -> float:
        low, high = np.interp((-REACH, REACH), shift, column)
        return float(high - low) / (2 * REACH)

    return Shape(*(secant(column) for column in (radius, *columns)))


def shifts(vehicle: Vehicle) -> Callable[[np.ndarray], np.ndarray]:
    """How far a gear seems to be elsewhere because its profile is not linear: function of the displacement.

    For displacements (m), shape () or (n,), within +-4.5 mm, it gives shape (3,) or (3, n): the differences (m) with
    which the secants of `Shape` meet the contact angle, the rolling radius and the contact point of both wheels. They
    are 0 in the middle, at `REACH`, and everywhere on cones.
    """
    shift, _, *columns = _contact(vehicle)
    form = shape(vehicle)
    at = np.arange(-_INSIDE, _INSIDE + _PITCH / 2, _PITCH)
    found = np.zeros((3, len(at)))
    for row, column, rate in zip(found, columns, (form.slope_rate, form.conicity, form.arm), strict=True):
        if abs(rate) > 1e-9:
            row[:] = (np.interp(at, shift, column) - np.interp(-at, shift, column)) / (2 * rate) - at

    def bent(y: np.ndarray) -> np.ndarray:
        place = np.minimum(np.maximum((y + _INSIDE) / _PITCH, 0.0), len(at) - 1.001)
        index = place.astype(int)
        return found[:, index] + (place - index) * (found[:, index + 1] - found[:, index])

    return bent


def _contact(vehicle: Vehicle) -> tuple[np.ndarray, ...]:
    """Shift of a wheel towards its flange (m), and over it effective radius (m), tangent of the contact angle (-),
    rolling radius (m) and place of the contact on the rail, to the track's middle (m)."""
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    shift, radius, rolling, contact = (
        frame[name].to_numpy() for name in ("shift_m", "effective_radius_m", "rolling_radius_m", "rail_contact_m")
    )
    return shift, radius, np.tan(frame["angle_rad"].to_numpy()), rolling, -contact


def creep_at(vehicle: Vehicle, adhesion: str, speed: float, slip: float = 0.0) -> Creep:
    """Creep of a vehicle's wheels on a rail about rolling with a longitudinal slip, as the plant's law has it.

    Of both wheels together, whose spins are opposite; speed in m/s, slip traction positive (-).

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
    pair, step = _pair(vehicle, astuple(vehicle.adhesion[adhesion]), speed, slip), 1e-6

    def slope(name: str, size: float) -> np.ndarray:
        return (pair(**{name: size}) - pair(**{name: -size})) / (2 * size)

    load = vehicle.contact.nominal_load
    along, across = slope("along", step), slope("across", step)
    moved, turned, loaded = slope("y", REACH), slope("turning", 1e-6), slope("shifted", 1e-3 * load)
    spin = Spin((moved[1], turned[1], loaded[1]), (moved[2], turned[2], loaded[2], across[2]))
    return Creep(float(along[0]) / 2, -float(across[1]) / 2, float(pair()[0] / (2 * load)), spin)


def _pair(vehicle: Vehicle, law: tuple, speed: float, slip: float) -> Callable[..., np.ndarray]:
    """Function that gives the creep forces of both wheels together, along and across (N), and their moment (N m).

    Its arguments are changes: of the slip and the lateral creepage (-), the displacement (m), the turning (1/m) and the
    load that moves to the left wheel (N).
    """
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    load, shear, r_0 = vehicle.contact.nominal_load, vehicle.contact.shear_modulus, vehicle.wheel.radius
    side = np.array([-1.0, 1.0])

    def pair(
        along: float = 0.0, across: float = 0.0, y: float = 0.0, turning: float = 0.0, shifted: float = 0.0
    ) -> np.ndarray:
        def at(name: str) -> np.ndarray:
            return np.interp(side * y, frame["shift_m"], frame[name])

        each = load - side * shifted
        scale = (each / load) ** (1 / 3)
        patch = scale * at("semi_axis_x_m"), scale * at("semi_axis_y_m"), at("c11"), at("c22"), at("c23")
        spin = turning - side * np.sin(at("angle_rad")) / r_0
        sliding = speed * np.hypot(slip + along, across)
        arguments: list = [-slip - along, across, spin, each, *patch, shear, *law, sliding]
        moment = spin_moment(*(*arguments, at("c33")))
        return np.array([*polach(*arguments), moment]).sum(axis=1)

    return pair


def lateral_model(vehicle: Vehicle, speed: float, creep: Creep) -> LateralModel:
    """The model of a gear at a speed (m/s) of at least `LEAST_SPEED`; InputError when that is out of range."""
    require("lateral model: speed", speed, between(LEAST_SPEED, 200.0, "m/s"))
    names = (*STATES, "du", *KNOWN, *UNKNOWN)
    z = dict(zip(names, np.eye(len(names)), strict=True))  # each quantity is a row of factors of all of these
    body, gear, wheel, stage = vehicle.body, vehicle.gear, vehicle.wheel, vehicle.suspension
    v, g, r_0, base = speed, vehicle.gravity, wheel.radius, gear.contact_base
    form, spin = shape(vehicle), creep.spin
    gamma = vehicle.roll_per_shift(form.slope)
    half, inertia = body.mass / 2, body.inertia_x / 2
    weight = (half + gear.mass) * g
    below, above_axle = body.cg_height - stage.height, stage.height - r_0

    cant_rate = z["rolling"]
    ydot = z["vy"] - r_0 * cant_rate
    aside, aside_rate = z["y"] - z["rail_offset"], ydot - z["rail_rate"]  # against the rails where they lie
    angled, radial, touched = (aside + z[name] for name in KNOWN[SHIFTS])
    roll, roll_rate = -gamma * aside, cant_rate - gamma * aside_rate
    sway = z["yb"] - below * z["phib"] - z["y"] - above_axle * roll
    sway_rate = z["vb"] - below * z["wb"] - z["vy"] - above_axle * roll_rate
    spring = 2 * stage.k_y * sway + 2 * stage.c_y * sway_rate
    bar = stage.roll_stiffness * (z["phib"] - roll) + stage.roll_damping * (z["wb"] - roll_rate)

    creepage, turn = (ydot + gamma * r_0 * aside_rate) / v - z["psi"], z["r"] / v
    across = -2 * creep.across * creepage + spin.force[0] * angled + spin.force[1] * turn
    steepening = -weight * form.slope_rate * angled
    per_load = 2 * form.slope + spin.force[2]
    unloading = -(bar + above_axle * spring - r_0 * (across + steepening) + half * g * sway + weight * aside)
    unloading = unloading / (base - r_0 * per_load)
    along = creep.along / v * (z["E"] - base / 2 * z["r"] - form.conicity * v / r_0 * radial)
    along = along + creep.adhesion * unloading
    normal = gear.mass * g * roll + steepening + per_load * unloading
    turning = base * along + creep.adhesion * weight * (aside + form.arm * touched) + z["moment"]
    turning = turning + spin.moment[0] * angled + spin.moment[1] * turn + spin.moment[2] * unloading
    turning = turning + spin.moment[3] * creepage
    turning = turning + 2 * wheel.spin_inertia * v / r_0 * roll_rate - stage.yaw_stiffness * (z["psi"] + z["heading"])
    turning = turning - stage.yaw_damping * (z["r"] + z["slewing"])
    rates = {
        "y": ydot,
        "vy": (across + spring + normal + z["force"]) / gear.mass + z["side"],
        "psi": z["r"],
        "r": turning / gear.inertia_z - z["turning"],
        "E": r_0 / wheel.spin_inertia * (z["tau"] - r_0 / creep.share * along) - base / 2 * z["turning"],
        "tau": (z["du"] - z["tau"]) / vehicle.drive.lag,
        "yb": z["vb"] - body.cg_height * cant_rate,
        "vb": -spring / half + z["side"],
        "phib": z["wb"] - cant_rate,
        "wb": (below * spring + half * g * below * z["phib"] - bar) / inertia,
    }
    a, b, e, d = np.split(np.array([rates[name] for name in STATES]), np.cumsum([len(STATES), 1, len(KNOWN)]), axis=1)
    return LateralModel(a, b[:, 0], e, d)
