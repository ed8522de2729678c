r"""Filter of a running gear: from late, noisy readings to its present states, creep forces and slips.

Two kinds of Kalman filter with stationary gains run on the readings, that is, in the past. One per wheel finds speed w
and longitudinal creep force F from the torque that was commanded to the motor:

    T_m tau' = u - tau,   J_Wy w' = tau - r_0 F,   F' = noise

One per gear finds lateral position, yaw angle against the track, yaw rate, gyro bias and creep angle; its gains are
scheduled over the speed, and the creep forces of the wheels turn it:

    y' = v (psi + beta),   psi' = r - v kappa,   J_z r' = b/2 (F_le - F_ri) - springs and dampers + gyroscopic moment

Creep angle and yaw angle are two states: the car needs the first to carry lateral force, and the inversion of a
controller must not take it for the second at once. Then both are predicted to the moment when a torque will arrive.

Serves the measured states of the paper's eq. (states).
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.linalg import expm, solve_discrete_are

from railrepro.clock import CONTROL_PERIOD
from railrepro.estimation.sensors import Loop, late
from railrepro.vehicle.parameters import Vehicle

SPEEDS = (2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 120.0)
"""Speeds at which the gains of the lateral filter are computed (m/s); in between they are interpolated."""
_LEAST = 1e-9
"""Noise of perfect sensors, for gains that stay finite (SI)."""
LATERAL = ("y", "psi", "r", "bias", "beta")
"""States of the lateral filter: displacement (m), yaw against the track (rad), absolute yaw rate and gyro bias (rad/s),
creep angle (rad)."""
_READ = ("y", "psi", "r")
WHEEL = ("tau", "w", "force")
STATES = (*LATERAL, *(f"{name}_{side}" for side in ("le", "ri") for name in WHEEL), "v", "creep")
"""Memory of the filter per gear: both filters, low-passed speed (m/s) and creep angle (rad)."""
MODEL = ("J_z", "J_Wy", "k_sz", "k_dz", "r_0", "b", "gamma", "lag", "J_eff")
GAINS = (
    *(f"lateral.{state}.{read}.{k}" for state in LATERAL for read in _READ for k in range(len(SPEEDS))),
    *("wheel.w", "wheel.force", "prediction", "creep_pole", "speed_pole"),
    *(f"model.{name}" for name in MODEL),
)
ESTIMATES = ("y_TrAx", "psi_TrAx", "psidot_Ax", "xdot", "f_le", "f_ri", "s_le", "s_ri")
"""What the filter hands on (SI): states when a torque will arrive, creep force over nominal load and slip of wheels."""


def lateral_matrices(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Continuous system matrix (5, 5) of the lateral filter at a speed (m/s), and how its readings follow (3, 5)."""
    index = {name: i for i, name in enumerate(LATERAL)}
    a, c = np.zeros((5, 5)), np.zeros((3, 5))
    inertia = vehicle.gear.inertia_z
    rolling = 2 * vehicle.wheel.spin_inertia * speed / vehicle.wheel.radius
    a[index["y"], [index["psi"], index["beta"]]] = speed
    a[index["psi"], index["r"]] = 1.0
    a[index["r"], index["psi"]] = -(vehicle.suspension.yaw_stiffness + rolling * vehicle.gamma * speed) / inertia
    a[index["r"], index["beta"]] = -rolling * vehicle.gamma * speed / inertia
    a[index["r"], index["r"]] = -vehicle.suspension.yaw_damping / inertia
    c[0, index["y"]] = c[1, index["psi"]] = c[2, index["r"]] = c[2, index["bias"]] = 1.0
    return a, c


def _stationary(a, c, q, r) -> tuple[np.ndarray, np.ndarray]:
    """Stationary Kalman gain for x' = a x + noise of spectral density q, read every cycle with covariance r, and the
    covariance of the states after a reading.

    Source: Van Loan 1978 (discretisation); Anderson and Moore 1979, Optimal Filtering, ch. 4.
    """
    return _solved(len(a), *(matrix.tobytes() for matrix in (a, c, q, r)))


@lru_cache(maxsize=128)
def _solved(n: int, *matrices: bytes) -> tuple[np.ndarray, np.ndarray]:
    a, c, q, r = (np.frombuffer(matrix) for matrix in matrices)
    a, c, q = a.reshape(n, n), c.reshape(-1, n), q.reshape(n, n)
    r, h = r.reshape(len(c), len(c)), CONTROL_PERIOD
    both = expm(np.block([[-a, q], [np.zeros((n, n)), a.T]]) * h)
    step = both[n:, n:].T
    p = solve_discrete_are(step.T, c.T, step @ both[:n, n:], r)
    gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + r)
    return gain, p - gain @ c @ p


def lateral_filter(vehicle: Vehicle, loop: Loop, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Stationary gain (5, 3) of the lateral filter at a speed (m/s), and covariance (5, 5) of its states (SI)."""
    rates = loop.filter
    y = max(loop.lateral.noise / np.sqrt(2), _LEAST)
    readings = np.diag([y**2, (2 * y / loop.lateral.base) ** 2, max(loop.gyro.noise, _LEAST) ** 2])
    wander = np.diag([1e-12, 1e-12, rates.yaw_acceleration**2, rates.gyro_drift**2, rates.creep_rate**2])
    return _stationary(*lateral_matrices(vehicle, speed), wander, readings)


def stationary_gains(vehicle: Vehicle, loop: Loop) -> dict[str, float]:
    """Run-time numbers of the filter of one gear, by the names of `GAINS`; the vehicle is what the filter believes."""
    rates = loop.filter
    inertia, radius = vehicle.wheel.spin_inertia, vehicle.wheel.radius
    gains: dict[str, float] = {}
    for k, speed in enumerate(SPEEDS):
        found, _ = lateral_filter(vehicle, loop, speed)
        gains |= {
            f"lateral.{state}.{read}.{k}": float(found[i, j])
            for i, state in enumerate(LATERAL)
            for j, read in enumerate(_READ)
        }
    spin = np.array([[0.0, -radius / inertia], [0.0, 0.0]])
    noise = max(loop.wheel_speed.noise, _LEAST) ** 2
    found, _ = _stationary(spin, np.array([[1.0, 0.0]]), np.diag([1e-8, rates.force_rate**2]), np.array([[noise]]))
    gains |= {"wheel.w": float(found[0, 0]), "wheel.force": float(found[1, 0])}
    gains |= {"prediction": loop.latency.measurement + loop.latency.command}
    gains |= {
        f"{name}_pole": CONTROL_PERIOD / (getattr(rates, f"{name}_lag") + CONTROL_PERIOD) for name in ("creep", "speed")
    }
    values = [vehicle.gear.inertia_z, inertia, vehicle.suspension.yaw_stiffness, vehicle.suspension.yaw_damping]
    values += [radius, vehicle.gear.contact_base, vehicle.gamma, vehicle.drive.lag, vehicle.effective_yaw_inertia]
    return gains | {f"model.{name}": float(value) for name, value in zip(MODEL, values, strict=True)}


def observe(readings: dict, commands: dict, track_ahead: dict, ticks, gain: dict, memory: dict) -> tuple[dict, dict]:
    """What the filter of a gear makes of new readings.

    Parameters
    ----------
    readings : dict of SX
        By `sensors.SIGNALS`, as late as they are.
    commands : dict of SX
        Torques that were sent to the wheels by side (N m), newest first; that of this cycle is not among them.
    track_ahead : dict of SX
        dpsi_dp, dphi_dp, psi_Tr, psi_CB, dpsi_dp_CB where the gear is, see `railrepro.control.lateral.ROAD`.
    ticks : SX
        Control cycles since the start; the filter begins with the first readings.
    gain, memory : dict of SX
        By the names of `GAINS` (and "measurement", "command" of the sensors, "nominal_load"), and of `STATES`.

    Returns
    -------
    estimates : dict of SX
        By `ESTIMATES`.
    state : dict of SX
        By `STATES`, at the time of the readings; `advance` carries it on.
    """
    model = {name: gain[f"model.{name}"] for name in MODEL}
    first = ticks < 0.5
    planes = readings["y_ahead"], readings["y_behind"]
    read = {"y": sum(planes) / 2, "psi": (planes[0] - planes[1]) / gain["base"], "r": readings["psidot_Ax"]}
    starts = read | {"bias": 0, "beta": 0, "v": readings["v"], "creep": 0}
    starts |= {f"w_{side}": readings[f"w_{side}"] for side in ("le", "ri")}
    x = {name: ca.if_else(first, starts.get(name, 0), memory[name]) for name in STATES}
    v = x["v"] = x["v"] + gain["speed_pole"] * (readings["v"] - x["v"])
    innovation = {"y": read["y"] - x["y"], "psi": read["psi"] - x["psi"], "r": read["r"] - x["r"] - x["bias"]}
    for state in LATERAL:
        x[state] += sum(_scheduled(f"lateral.{state}.{name}", v, gain) * innovation[name] for name in _READ)
    for side in ("le", "ri"):
        surprise = readings[f"w_{side}"] - x[f"w_{side}"]
        x[f"w_{side}"] += gain["wheel.w"] * surprise
        x[f"force_{side}"] += gain["wheel.force"] * surprise
    x["creep"] += gain["creep_pole"] * (x["beta"] - x["creep"])

    y, psi, r = _predicted(x, commands, track_ahead, gain, model)
    estimates = {"y_TrAx": y, "psi_TrAx": psi + x["creep"], "psidot_Ax": r, "xdot": v}
    for side in ("le", "ri"):
        estimates[f"f_{side}"] = x[f"force_{side}"] / gain["nominal_load"]
        estimates[f"s_{side}"] = (v - model["r_0"] * x[f"w_{side}"]) / ca.fmax(v, 1.0)
    return estimates, x


def advance(x: dict, commands: dict, track_ahead: dict, gain: dict) -> dict:
    """State of the filter a cycle later; parameters as of `observe`, this cycle's torques among the commands."""
    model = {name: gain[f"model.{name}"] for name in MODEL}
    h, following = CONTROL_PERIOD, dict(x)
    following["y"] += h * x["v"] * (x["psi"] + x["beta"])
    following["psi"] += h * (x["r"] - x["v"] * track_ahead["dpsi_dp"])
    following["r"] += h * _yaw_acceleration(x, track_ahead, model)
    for side in ("le", "ri"):
        torque, commanded = x[f"tau_{side}"], late(commands[side], gain["measurement"] + gain["command"])
        following[f"tau_{side}"] += (1 - ca.exp(-h / model["lag"])) * (commanded - torque)
        mean = (torque + following[f"tau_{side}"]) / 2
        following[f"w_{side}"] += h / model["J_Wy"] * (mean - model["r_0"] * x[f"force_{side}"])
    return following


def _scheduled(name: str, v, gain: dict):
    """Gain at a speed, linear between `SPEEDS` and constant beyond them."""
    value = gain[f"{name}.0"]
    for k, (low, high) in enumerate(zip(SPEEDS[:-1], SPEEDS[1:], strict=True)):
        share = ca.fmin(ca.fmax((v - low) / (high - low), 0), 1)
        value += share * (gain[f"{name}.{k + 1}"] - gain[f"{name}.{k}"])
    return value


def _yaw_acceleration(x: dict, track_ahead: dict, model: dict):
    """Yaw acceleration under the creep forces of both wheels, springs, dampers and gyroscopic moment (rad/s2)."""
    v = x["v"]
    turning = model["b"] / 2 * (x["force_le"] - x["force_ri"])
    turning -= model["k_sz"] * (track_ahead["psi_Tr"] + x["psi"] - track_ahead["psi_CB"])
    turning -= model["k_dz"] * (x["r"] - v * track_ahead["dpsi_dp_CB"])
    roll_rate = v * (track_ahead["dphi_dp"] - model["gamma"] * (x["psi"] + x["beta"]))
    return (turning + 2 * model["J_Wy"] * v / model["r_0"] * roll_rate) / model["J_z"]


def _predicted(x: dict, commands: dict, track_ahead: dict, gain: dict, model: dict) -> tuple:
    """Position, yaw and yaw rate when a torque of this cycle will arrive.

    The yaw acceleration that was found goes on; torques that are on their way change it as on rolling wheels.
    """
    steps = 5
    h = gain["prediction"] / steps
    y, psi, r, v, yaw = x["y"], x["psi"], x["r"], x["v"], _yaw_acceleration(x, track_ahead, model)
    motor = {side: x[f"tau_{side}"] for side in ("le", "ri")}
    before = motor["le"] - motor["ri"]
    for k in range(steps):
        age = gain["measurement"] + gain["command"] - (k + 0.5) * h / CONTROL_PERIOD
        for side in motor:
            commanded = late(commands[side], ca.fmax(age - 0.5, 0))
            motor[side] += (1 - ca.exp(-h / model["lag"])) * (commanded - motor[side])
        change = model["b"] / (2 * model["r_0"] * model["J_eff"]) * (motor["le"] - motor["ri"] - before)
        y += h * v * (psi + x["beta"])
        psi += h * (r - v * track_ahead["dpsi_dp"])
        r += h * (yaw + change)
    return y, psi, r
