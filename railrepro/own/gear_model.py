r"""Linear lateral model of one running gear with creep, which the paper's eq. (7) leaves out.

In the paper's control model wheels roll without sliding; here they need creepage to carry a force. For small angles, a
constant speed v and a car body that stays on the track::

    y' = vy - r_0 phi_Tr',   psi' = r,   m vy' = F_y + F_s + F_N + m g (phi - phi_Tr) + (m + m_CB/2) a_y + F_d
    J_z r' = b F_x - k_sz (psi + psi_Tr - psi_CB) - k_dz (r + v kappa - v kappa_CB) + 2 J_Wy v/r_0 (phi_Tr' - Gamma y')
             + M_s + M_d - J_z v^2 kappa'
    E' = r_0/J_Wy (tau - r_0 F_x) - v^2 kappa' b/2,   T_m tau' = du - tau,   F_x = k_11/v (E - r b/2 - lambda v y/r_0)

with a_y = g phi_Tr - v^2 kappa, E = r_0 (w_le - w_ri)/2 - kappa v b/2, force F_s of the suspension, lateral creep force
F_y and moment M_s of both contacts, force F_N normal to the rails, half the difference F_x of the longitudinal creep
forces, unknown force F_d and moment M_d. Of the gear are mass m, yaw inertia J_z, roll phi, distance b of the contacts,
yaw stiffness k_sz and damping k_dz to the car body (mass m_CB, heading psi_CB, curvature of its path kappa_CB); of the
wheels radius r_0, spin inertia J_Wy, speeds w, motor lag T_m, conicity lambda; of the track heading psi_Tr, cant angle
phi_Tr, curvature kappa. Gamma is roll per displacement, k_11 Kalker's coefficient. In contact forces y counts from the
rails. Slopes of the wheel profile are secants.
"""

import numpy as np

from railrepro.contact.table import contact_table
from railrepro.vehicle.parameters import Vehicle

STATES = ("y", "vy", "psi", "r", "E", "tau")
"""Lateral displacement (m), absolute lateral velocity (m/s), yaw angle (rad) and yaw rate (rad/s) against the track,
half the difference E of the circumferential speeds minus its part by curvature (m/s), differential torque (N m)."""
KNOWN = ("side", "turning", "rolling", "heading", "slewing", "rail_offset", "rail_rate")
"""Known inputs from the track: lateral acceleration g phi_Tr - v^2 kappa (m/s2), yaw acceleration v^2 kappa' of the
track frame (rad/s2), roll rate v phi_Tr' (rad/s), heading psi_Tr - psi_CB of the track against the car body (rad) and
its rate v (kappa - kappa_CB) (rad/s); lateral offset of the rails from the track (m) and its rate (m/s)."""
UNKNOWN = ("force", "moment")
"""Unknown inputs: lateral force (N) and yaw moment (N m) on the gear."""
UNITS = (1e-3, 1e-2, 1e-3, 1e-2, 1e-2, 100.0)
"""Usual magnitudes of `STATES` (SI), by which Riccati equations are scaled."""
_REACH = 1e-3  # Displacement to either side at which the secants of a wheel profile end (m)


def _profile(vehicle: Vehicle) -> tuple[dict[str, float], float, float, float]:
    """Columns of the contact table at the centre, name -> value; slope dr/dy of the effective radius (-), change of the
    slope with the shift (1/m), conicity lambda (-)."""
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    middle, low, high = ({n: np.interp(at, frame["shift_m"], frame[n]) for n in frame} for at in (0, -_REACH, _REACH))
    slope, conicity = ((high[n] - low[n]) / (2 * _REACH) for n in ("effective_radius_m", "rolling_radius_m"))
    return middle, slope, (np.tan(high["angle_rad"]) - np.tan(low["angle_rad"])) / (2 * _REACH), conicity


def _creep(vehicle: Vehicle, middle: dict[str, float], steepening: float) -> tuple[float, np.ndarray]:
    """Kalker's linear creep coefficients on dry rail, reduced as in Polach's law at small creepage: k_11 (N), and force
    (N) and moment (N m) of both wheels per displacement, lateral creepage and r/v, shape (2, 3)."""
    contact, dry = vehicle.contact, vehicle.adhesion["dry"]
    root = np.sqrt(middle["semi_axis_x_m"] * middle["semi_axis_y_m"])
    reduced = (dry.k_a + min(dry.k_s, dry.k_a)) / 2 * contact.shear_modulus
    powers = {"c11": 2, "c22": 2, "c23": 3, "c33": 4}
    k_11, k_22, k_23, k_33 = (reduced * root**power * middle[name] for name, power in powers.items())
    spin = steepening / vehicle.wheel.radius
    return float(k_11), 2 * np.array([[k_23 * spin, -k_22, -k_23], [k_33 * spin, k_23, -k_33]])


def lateral_model(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, ...]:
    """Build the lateral model of a running gear at a speed (m/s): x' = a x + b du + e known + d unknown (SI), du the
    differential torque: added to the left motor, subtracted from the right one. Returns a (6, 6), b (6,), e (6, 7), d
    (6, 2). x (`STATES`): displacement y, velocity vy, yaw angle psi, yaw rate r, E (half of left minus right wheel
    speed, less its part by the curve), motor torque tau. known (`KNOWN`), of the track: lateral acceleration by cant
    and curve (m/s2), yaw acceleration (rad/s2), roll rate (rad/s), heading against the car body (rad), its rate
    (rad/s); offset of the rails (m), its rate (m/s). unknown: force (N) to the right and yaw moment (N m)."""
    names = (*STATES, "du", *KNOWN, *UNKNOWN)
    z = dict(zip(names, np.eye(len(names)), strict=True))  # each quantity is a row of factors of all of these
    gear, wheel, stage = vehicle.gear, vehicle.wheel, vehicle.suspension
    v, g, r_0, base = speed, vehicle.gravity, wheel.radius, gear.contact_base
    middle, slope, steepening, conicity = _profile(vehicle)
    k_11, creep = _creep(vehicle, middle, steepening)
    gamma, mass, above_axle = vehicle.roll_per_shift(slope), vehicle.body.mass / 2 + gear.mass, stage.height - r_0

    ydot = z["vy"] - r_0 * z["rolling"]
    aside, aside_rate = z["y"] - z["rail_offset"], ydot - z["rail_rate"]  # against the rails where they lie
    roll, roll_rate = -gamma * aside, z["rolling"] - gamma * aside_rate
    spring = -2 * stage.k_y * (z["y"] + above_axle * roll) - 2 * stage.c_y * (z["vy"] + above_axle * roll_rate)
    across, moment = creep @ np.array([aside, (ydot + gamma * r_0 * aside_rate) / v - z["psi"], z["r"] / v])
    along = k_11 / v * (z["E"] - base / 2 * z["r"] - conicity * v / r_0 * aside)
    normal = gear.mass * g * roll - mass * g * steepening * aside
    turning = base * along + moment + z["moment"] + 2 * wheel.spin_inertia * v / r_0 * roll_rate
    turning = turning - stage.yaw_stiffness * (z["psi"] + z["heading"]) - stage.yaw_damping * (z["r"] + z["slewing"])
    rates = {
        "y": ydot,
        "vy": (across + spring + normal + mass * z["side"] + z["force"]) / gear.mass,
        "psi": z["r"],
        "r": turning / gear.inertia_z - z["turning"],
        "E": r_0 / wheel.spin_inertia * (z["tau"] - r_0 * along) - base / 2 * z["turning"],
        "tau": (z["du"] - z["tau"]) / vehicle.drive.lag,
    }
    a, b, e, d = np.split(np.array([rates[name] for name in STATES]), np.cumsum([len(STATES), 1, len(KNOWN)]), axis=1)
    return a, b[:, 0], e, d
