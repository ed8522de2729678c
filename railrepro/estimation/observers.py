r"""Filter of a running gear: from late, noisy readings to its present states, creep forces and slips.

Two kinds of Kalman filter with stationary gains run on the readings, that is, in the past. One per wheel finds speed w
and longitudinal creep force F from the torque that was commanded to the motor:

    T_m tau' = u - tau,   J_Wy w' = tau - r_0 F,   F' = noise

One per gear finds lateral position, yaw angle against the track, yaw rate, gyro bias and creep angle; its gains are
scheduled over the speed, and the creep forces of the wheels turn it:

    y' = v (psi + beta),   psi' = r - v kappa,   J_z r' = b/2 (F_le - F_ri) - springs and dampers + gyroscopic moment

Creep angle and yaw angle are two states: the car needs the first to carry lateral force, and the inversion of a
controller must not take it for the second at once. Then both are predicted to the moment when a torque will arrive.
Serves the measured states of the paper's eq. (18).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm, solve_discrete_are

from railrepro.clock import CONTROL_PERIOD
from railrepro.estimation.sensors import Loop, delayed
from railrepro.quantities import SIDES, group, listed, pack, unpack
from railrepro.vehicle.parameters import Vehicle

SPEEDS = (2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 120.0)
"""Speeds at which the gains of the lateral filter are computed (m/s); in between they are interpolated."""
_LEAST = 1e-9
"""Noise of perfect sensors, for gains that stay finite (SI)."""
LATERAL = ("y", "psi", "r", "bias", "beta")
"""States of the lateral filter: displacement (m), yaw angle against the track (rad), absolute yaw rate (rad/s), gyro
bias (rad/s), creep angle (rad)."""
_READ = ("y", "psi", "r")
WheelState = group("WheelState", "tau N m, w rad/s, force N")
"""States of the filter of a wheel: motor torque, angular speed, longitudinal creep force."""
_WHEELS = dict.fromkeys(SIDES, WheelState)
FilterState = group("FilterState", "y m, psi rad, r rad/s, bias rad/s, beta rad", _WHEELS, "v m/s, creep rad")
"""States of the filter of a gear: `LATERAL`, left and right wheel, low-pass filtered speed and creep angle."""
_LateralGain = group("LateralGain", dict.fromkeys(_READ, listed(range(len(SPEEDS)))))
_LateralGains = group("LateralGains", dict.fromkeys(LATERAL, _LateralGain))
_REST = "wheel_w -, wheel_force N s, prediction s, creep_pole -, speed_pole -, J_z kg m2"
FilterGains = group("FilterGains", {"lateral": _LateralGains}, _REST)
"""Run-time numbers of the filter: Kalman gains (of the lateral filter at `SPEEDS`), prediction time, gains per cycle of
the low-pass filters, yaw inertia."""
_SIDES = {"f": listed(SIDES), "s": listed(SIDES)}
Estimates = group("Estimates", "y_TrAx m, psi_TrAx rad, psidot_Ax rad/s, xdot m/s", _SIDES)
"""Estimates of a gear: states when a torque will arrive; adhesion f (force over nominal load) and slip s (-)."""


def lateral_matrices(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Pair of matrices A (5, 5), C (3, 5) of the lateral filter at a speed (m/s), SI: x' = A x, readings C x. x holds
    the states `LATERAL`. The readings are y, psi, and r plus the gyro bias."""
    y, psi, r, bias, beta = range(len(LATERAL))
    a, c = np.zeros((5, 5)), np.zeros((3, 5))
    inertia = vehicle.gear.inertia_z
    rolling = 2 * vehicle.wheel.spin_inertia * speed / vehicle.wheel.radius
    a[y, [psi, beta]] = speed
    a[psi, r] = 1.0
    a[r, psi] = -(vehicle.suspension.yaw_stiffness + rolling * vehicle.gamma * speed) / inertia
    a[r, beta] = -rolling * vehicle.gamma * speed / inertia
    a[r, r] = -vehicle.suspension.yaw_damping / inertia
    c[0, y] = c[1, psi] = c[2, r] = c[2, bias] = 1.0
    return a, c


def _stationary(a, c, q, r) -> tuple[np.ndarray, np.ndarray]:
    """Stationary Kalman gain for x' = a x + noise of spectral density q, read every cycle with covariance r; covariance
    after a reading. Source: Van Loan 1978; Anderson and Moore 1979, Optimal Filtering, ch. 4."""
    n = len(a)
    both = expm(np.block([[-a, q], [np.zeros((n, n)), a.T]]) * CONTROL_PERIOD)
    step = both[n:, n:].T
    p = solve_discrete_are(step.T, c.T, step @ both[:n, n:], r)
    gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + r)
    return gain, p - gain @ c @ p


def lateral_filter(vehicle: Vehicle, loop: Loop, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Stationary Kalman filter of the model `lateral_matrices` at a speed (m/s), with a reading every ms (SI).

    `loop` has the noise of sensors and process. Returns a pair: gain (5, 3); covariance (5, 5) of the states `LATERAL`
    after a reading.
    """
    rates = loop.filter
    y = max(loop.lateral.noise / np.sqrt(2), _LEAST)
    readings = np.diag([y**2, (2 * y / loop.lateral.base) ** 2, max(loop.gyro.noise, _LEAST) ** 2])
    wander = np.diag([1e-12, 1e-12, rates.yaw_acceleration**2, rates.gyro_drift**2, rates.creep_rate**2])
    return _stationary(*lateral_matrices(vehicle, speed), wander, readings)


@lru_cache(maxsize=16)
def stationary_gains(vehicle: Vehicle, loop: Loop) -> Any:
    """`FilterGains` of one gear, for the noise and latencies of `loop` and the vehicle parameters that the filter
    assumes."""
    rates = loop.filter
    inertia, radius = vehicle.wheel.spin_inertia, vehicle.wheel.radius
    at_speeds = np.array([lateral_filter(vehicle, loop, speed)[0] for speed in SPEEDS])
    spin = np.array([[0.0, -radius / inertia], [0.0, 0.0]])
    noise = max(loop.wheel_speed.noise, _LEAST) ** 2
    wheel, _ = _stationary(spin, np.array([[1.0, 0.0]]), np.diag([1e-8, rates.force_rate**2]), np.array([[noise]]))
    lateral = unpack(_LateralGains, np.moveaxis(at_speeds, 0, -1).ravel().tolist())
    return FilterGains(
        lateral,
        wheel_w=float(wheel[0, 0]),
        wheel_force=float(wheel[1, 0]),
        prediction=loop.latency.measurement + loop.latency.command,
        creep_pole=CONTROL_PERIOD / (rates.creep_lag + CONTROL_PERIOD),
        speed_pole=CONTROL_PERIOD / (rates.speed_lag + CONTROL_PERIOD),
        J_z=vehicle.gear.inertia_z,
    )


def observe(
    readings: Any, commands: Sequence[list], track: Any, ticks, sensor: Any, gain: Any, memory: Any
) -> tuple[Any, Any]:
    """Correct the filter of a gear by the readings of this cycle, and predict to the time when a torque will act.

    Args:
        readings (Signals of SX): Delayed readings.
        commands (two lists of SX): Torques sent to left and right wheel before this cycle (N m), newest first.
        track (interface.Track of SX): Track at the gear.
        ticks (SX): Control cycles since the start. At 0 the filter takes its states from the readings.
        sensor (SensorGains of SX): Run-time numbers of the sensors of this gear.
        gain (LawSignature.Gains of SX): Of these `filter`, `model`, `drive` and `nominal_load` are used.
        memory (FilterState of SX): States of the filter at the time of the readings, before the correction.

    Returns:
        tuple: `Estimates` of SX; `FilterState` of SX after the correction, at the time of the readings, for `advance`.
    """
    planes = readings.y_ahead, readings.y_behind
    read = {"y": sum(planes) / 2, "psi": (planes[0] - planes[1]) / sensor.base, "r": readings.psidot_Ax}
    le, ri = WheelState(0, readings.w_le, 0), WheelState(0, readings.w_ri, 0)
    start = FilterState(read["y"], read["psi"], read["r"], 0, 0, le, ri, readings.v, 0)
    x = unpack(FilterState, (ca.if_else(ticks < 0.5, *pair) for pair in zip(pack(start), pack(memory), strict=True)))
    v = x.v + gain.filter.speed_pole * (readings.v - x.v)
    innovation = {"y": read["y"] - x.y, "psi": read["psi"] - x.psi, "r": read["r"] - x.r - x.bias}
    corrected = {
        state: getattr(x, state)
        + sum(_scheduled(getattr(getattr(gain.filter.lateral, state), name), v) * innovation[name] for name in _READ)
        for state in LATERAL
    }
    for side, w in (("le", readings.w_le), ("ri", readings.w_ri)):
        wheel: Any = getattr(x, side)
        error = w - wheel.w
        corrected[side] = replace(
            wheel, w=wheel.w + gain.filter.wheel_w * error, force=wheel.force + gain.filter.wheel_force * error
        )
    creep = x.creep + gain.filter.creep_pole * (corrected["beta"] - x.creep)
    x = replace(x, **corrected, v=v, creep=creep)

    y, psi, r = _predicted(x, commands, track, sensor, gain)
    f = [wheel.force / gain.nominal_load for wheel in (x.le, x.ri)]
    s = [(v - gain.model.r_0 * wheel.w) / ca.fmax(v, 1.0) for wheel in (x.le, x.ri)]
    return Estimates(y, psi + x.creep, r, v, f, s), x


def advance(x: Any, commands: Sequence[list], track: Any, sensor: Any, gain: Any) -> Any:
    """`FilterState` of SX one control cycle after `x`, the second result of `observe`. The other arguments are as in
    `observe`, but `commands` include the torques of this cycle."""
    h, model = CONTROL_PERIOD, gain.model

    def wheel(state: Any, line: list) -> Any:
        commanded = delayed(line, sensor.measurement + sensor.command)
        tau = state.tau + (1 - ca.exp(-h / gain.drive.lag)) * (commanded - state.tau)
        w = state.w + h / model.J_Wy * ((state.tau + tau) / 2 - model.r_0 * state.force)
        return replace(state, tau=tau, w=w)

    return replace(
        x,
        y=x.y + h * x.v * (x.psi + x.beta),
        psi=x.psi + h * (x.r - x.v * track.dpsi_dp),
        r=x.r + h * _yaw_acceleration(x, track, gain),
        le=wheel(x.le, commands[0]),
        ri=wheel(x.ri, commands[1]),
    )


def _scheduled(at_speeds: list, v):
    """Gain at a speed, linear between `SPEEDS` and constant beyond them."""
    value = at_speeds[0]
    for k, (low, high) in enumerate(pairwise(SPEEDS)):
        share = ca.fmin(ca.fmax((v - low) / (high - low), 0), 1)
        value += share * (at_speeds[k + 1] - at_speeds[k])
    return value


def _yaw_acceleration(x: Any, track: Any, gain: Any):
    """Yaw acceleration under the creep forces of both wheels, springs, dampers and gyroscopic moment (rad/s2)."""
    model = gain.model
    moment = model.b / 2 * (x.le.force - x.ri.force)
    moment -= model.k_sz * (track.psi_Tr + x.psi - track.psi_CB)
    moment -= model.k_dz * (x.r - x.v * track.dpsi_dp_CB)
    roll_rate = x.v * (track.dphi_dp - model.gamma * (x.psi + x.beta))
    return (moment + 2 * model.J_Wy * x.v / model.r_0 * roll_rate) / gain.filter.J_z


def _predicted(x: Any, commands: Sequence[list], track: Any, sensor: Any, gain: Any) -> tuple:
    """Position, yaw and yaw rate when a torque of this cycle will arrive; torques under way act as on rolling
    wheels."""
    steps, model = 5, gain.model
    h = gain.filter.prediction / steps
    y, psi, r, v, yaw = x.y, x.psi, x.r, x.v, _yaw_acceleration(x, track, gain)
    motor, before = [x.le.tau, x.ri.tau], x.le.tau - x.ri.tau
    for k in range(steps):
        age = sensor.measurement + sensor.command - (k + 0.5) * h / CONTROL_PERIOD
        for side, line in enumerate(commands):
            commanded = delayed(line, ca.fmax(age - 0.5, 0))
            motor[side] += (1 - ca.exp(-h / gain.drive.lag)) * (commanded - motor[side])
        change = model.b / (2 * model.r_0 * model.J_eff) * (motor[0] - motor[1] - before)
        y += h * v * (psi + x.beta)
        psi += h * (r - v * track.dpsi_dp)
        r += h * (yaw + change)
    return y, psi, r
