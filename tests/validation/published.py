"""Vehicles with published critical speeds, made from the project's car: a lab wheelset and Cooperrider's bogie.

Each is the car with other data and its own contact table; some bodies are held or have further springs. As a script it
writes data/results/published_vehicles.csv, which `15_car` shows. Serves the paper's section Simulation Environment."""

import warnings
from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.car.equations import WHEELS
from railrepro.contact.table import ContactTable, contact_table
from railrepro.data import write
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_LATERAL = ("y", "psi", "phi", "vy", "wz", "wx")
_PATCH = 1e-4  # semi-axis of a contact in which spin gives no force (m)
_RIGID = {"gear.axle_damping": 1e8, "contact.normal_stiffness": 1e13, "wheel.spin_inertia": 1e-3}
_RIGID |= {"wheel.diametral_inertia": 1e-4, "adhesion.dry.k_a": 1.0, "adhesion.dry.k_s": 1.0, "adhesion.dry.mu0": 1.0}
_RIGID |= {"suspension.c_x": 0.0, "suspension.c_y": 0.0, "suspension.c_z": 0.0}
_RIGID |= {"suspension.antiroll_stiffness": 0.0, "suspension.antiroll_damping": 0.0}
"""Rigid axles without gyroscopic moment on rigid rails, springs without dampers, Kalker's stiffness not reduced."""


def lateral(car: SteppedCar, *bodies: str) -> pd.DataFrame:
    """Linearise the lateral motion of some bodies (`equations.BODIES`) of a car, the others held: state matrix."""
    spins = [f"w.{wheel}" for wheel in WHEELS if wheel.split("_")[0] in bodies]
    names = [f"{body}.{name}" for body in bodies for name in _LATERAL] + spins
    return car.linearise().a.loc[names, names]


def hunting(matrix) -> tuple[float, float]:
    """Find growth rate (1/s) and frequency (rad/s) of the least damped oscillation of dx/dt = matrix x."""
    poles = np.linalg.eigvals(np.asarray(matrix))
    worst = max(poles[poles.imag > 1.0], key=np.real)
    return float(worst.real), float(worst.imag)


def critical_speed(matrix: Callable[[float], np.ndarray], low: float, high: float) -> tuple[float, float]:
    """Find the speed between `low` and `high` (m/s) at which an oscillation of dx/dt = matrix(speed) x starts to grow,
    and its frequency (rad/s)."""
    speed = brentq(lambda v: hunting(matrix(v))[0], low, high, xtol=1e-5)
    return speed, hunting(matrix(speed))[1]


def profile(vehicle: Vehicle, angle, rolling_radius, creep: float) -> ContactTable:
    """Make a contact table without forces and moments by spin. `angle` is the tangent of the contact angle (-), a
    straight line, `rolling_radius` the rolling radius less the nominal one (m), both functions of the shift (m) towards
    the flange; `creep` is the longitudinal and lateral stiffness of a wheel at nominal load (N)."""
    shift = (np.arange(-100, 101) - 0.25) * 1e-4  # zero inside a cell, where slopes have one value
    climb = shift * (angle(shift) + angle(0.0)) / 2
    coefficient = creep / (vehicle.contact.shear_modulus * _PATCH**2)
    base = contact_table("cone", vehicle).frame.iloc[: len(shift)]
    frame = base.assign(
        shift_m=shift,
        angle_rad=np.arctan(angle(shift)),
        effective_radius_m=vehicle.wheel.radius + climb,
        rolling_radius_m=vehicle.wheel.radius + rolling_radius(shift),
        **dict.fromkeys(("semi_axis_x_m", "semi_axis_y_m"), _PATCH),
        **{"c11": coefficient, "c22": coefficient, "c23": 0.0, "c33": 0.0},
    )
    return ContactTable(frame)


LAB = {"m": 1e3, "d": 0.72, "r0": 0.46, "k": 13e3, "N": 20e3, "R": 0.23, "Rr": 0.20, "delta0": np.pi / 180, "f": 1e6}
"""Lab wheelset: mass (kg), half base, rolling radius (m), stiffness k1 = k2 (N/m), wheel load (N), radii of wheel and
rail profile (m), contact angle (rad), creep coefficient of a wheel (N). Source: Moore, EME 134, lab 1."""


def lab_equations(speed: float, roll: float = 1.0) -> np.ndarray:
    """State matrix of the lab wheelset at a speed (m/s): y, psi and their rates, shape (4, 4). `roll` is 1 as
    published. With roll of the wheelset it is 1 + r0 delta0/d: conicity and lateral creepage grow by it, gravity
    stiffness and lateral creep damping by its square. Source: Moore, EME 134 (University of California, Davis), lab 1,
    equations of motion."""
    m, d, r0, k, load, wheel, rail, delta0, f = LAB.values()
    conicity, gravity, inertia = wheel * delta0 / (wheel - rail), 2 * load / (wheel - rail), m * d**2
    sway = [-(2 * k + gravity * roll**2) / m, 2 * f * roll / m, -2 * f * roll**2 / (speed * m), 0.0]
    yaw = np.array([-2 * f * conicity * roll * d / r0, -k * d**2 / 2, 0.0, -2 * f * d**2 / speed]) / inertia
    return np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], sway, yaw])


def lab_wheelset(speed: float) -> pd.DataFrame:
    """State matrix of the lab wheelset at a speed (m/s): the front running gear of the car under a held body."""
    m, d, r0, k, load, wheel, rail, delta0, f = LAB.values()
    own = {"body.mass": 2e3, "environment.gravity": 20.0, "gear.mass": m, "gear.inertia_z": m * d**2}
    own |= {"gear.inertia_x": 1e-3, "gear.contact_base": 2 * d, "wheel.radius": r0, "contact.nominal_load": load}
    own |= {"suspension.height": r0, "suspension.half_spacing": d / 2, "suspension.k_x": k, "suspension.k_y": k}
    vehicle = load_vehicle(**_RIGID | own | {"contact.profile": "cone", "wheel.cone_angle": delta0})
    conicity = wheel * delta0 / (wheel - rail)
    table = profile(vehicle, lambda u: delta0 + u / (wheel - rail), lambda u: conicity * u, f)
    return lateral(SteppedCar("T5", speed, vehicle, table=table), "front")


BOGIE = {"f11": 6.563e6 / 0.60252, "f22": 6.563e6 / 0.54219, "cone": 0.05, "h1": 0.0762, "h2": 0.6584, "d2": 0.68}
BOGIE |= {"k4": 182.3e3, "k5": 333.3e3, "k6": 2.71e6, "D1": 20e3, "D2": 29.2e3}
"""Cooperrider's bogie: creep stiffnesses of a wheel (N), conicity (rad), heights of the frame's centre of gravity above
the primary and below the secondary springs (m), and these: half spacing (m), stiffness lateral, vertical (N/m) and in
yaw (N m/rad), dampers vertical and lateral (N s/m)."""


def cooperrider_bogie(speed: float) -> pd.DataFrame:
    """State matrix of Cooperrider's bogie at a speed (m/s), with level contacts, as published. The frame is the body of
    the car, with secondary springs and dampers to a car body at rest; the wheelsets are the running gears. The
    longitudinal creep stiffness enters only as f11 d^2 and f11 d lambda, so f22 in its place with d and lambda
    multiplied by sqrt(f11/f22) gives the same equations. Source: Cooperrider 1972; numbers as in Kaas-Petersen 1986 and
    the examples of bifurcation.de."""
    f22 = BOGIE["f22"]
    share = np.sqrt(BOGIE["f11"] / f22)
    own = {"body.mass": 2918.0, "body.inertia_x": 6780.0, "body.inertia_z": 6780.0, "body.gear_spacing": 2 * 1.074}
    own |= {"gear.mass": 1022.0, "gear.inertia_z": 678.0, "gear.inertia_x": 678.0}
    own |= {"gear.contact_base": 2 * 0.716 * share, "wheel.cone_angle": share * BOGIE["cone"]}
    own |= {"wheel.radius": 0.4572, "suspension.height": 0.4572, "body.cg_height": 0.4572 + BOGIE["h1"]}
    own |= {"suspension.half_spacing": 0.62, "suspension.k_y": 1.823e6, "suspension.k_x": 3.646e6}
    own |= {"suspension.k_z": 3.646e6, "contact.nominal_load": (2918.0 / 4 + 1022.0 / 2) * 9.81}
    vehicle = load_vehicle(**_RIGID | own | {"contact.profile": "cone"})
    slope = np.tan(vehicle.wheel.cone_angle)
    table = profile(vehicle, lambda u: 0.0 * u, lambda u: slope * u, f22)
    a = lateral(SteppedCar("T5", speed, vehicle, table=table), "body", "front", "rear")
    h, d, body = BOGIE["h2"], BOGIE["d2"], vehicle.body
    lever = np.array([1.0, h])  # displacement of the secondary springs by y and phi, h2 above the centre
    for shift, k_y, k_z, k_yaw in (
        (("y", "phi", "psi"), BOGIE["k4"], BOGIE["k5"], BOGIE["k6"]),
        (("vy", "wx", "wz"), BOGIE["D2"], BOGIE["D1"], 0.0),
    ):
        y, phi, psi = (f"body.{name}" for name in shift)
        push = 2 * k_y * lever
        a.loc["body.vy", [y, phi]] -= push / body.mass
        a.loc["body.wx", [y, phi]] -= (h * push + [0.0, 2 * k_z * d**2]) / body.inertia_x
        a.loc["body.wz", psi] -= k_yaw / body.inertia_z
    return a


def comparison() -> pd.DataFrame:
    """Compare published quantities with those of the car; the limits of relative differences were fixed beforehand."""
    roll = 1 + LAB["r0"] * LAB["delta0"] / LAB["d"]
    printed = critical_speed(lab_equations, 30.0, 80.0)
    rolling = critical_speed(lambda speed: lab_equations(speed, roll), 30.0, 80.0)
    ours, bogie = critical_speed(lab_wheelset, 45.0, 55.0), critical_speed(cooperrider_bogie, 60.0, 75.0)
    rows = [
        ("lab wheelset, with roll", "critical speed (m/s)", rolling[0], ours[0], 2e-3),
        ("lab wheelset, with roll", "frequency (rad/s)", rolling[1], ours[1], 2e-3),
        ("lab wheelset, as published", "critical speed (m/s)", printed[0], ours[0], 1.5e-2),
        ("lab wheelset, as published", "frequency (rad/s)", printed[1], ours[1], 1.5e-2),
        ("Cooperrider's bogie", "Hopf speed (m/s)", 68.66, bogie[0], 5e-3),  # bifurcation.de
    ]
    return pd.DataFrame(rows, columns=["vehicle", "quantity", "published", "ours", "limit"])


if __name__ == "__main__":
    warnings.simplefilter("ignore", UserWarning)  # their data are out of the range of the project's car
    table = comparison()
    write(paths.product("data/results/published_vehicles.csv"), table.to_csv(index=False, float_format="%.17g"))
    print(table.to_string(index=False))
