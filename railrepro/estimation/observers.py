r"""Filter of a running gear: estimates states, creep forces and slips from delayed, noisy readings.

Two kinds of Kalman filter with stationary gains run at the time of the readings. One per wheel estimates the speed w
and the longitudinal creep force F from the commanded motor torque u:

    T_m tau' = u - tau,   J_Wy w' = tau - r_0 F,   F' = noise

One per gear estimates displacement y, yaw angle psi against the track, yaw rate r, gyro bias and creep angle beta, from
heading to motion. Its inputs are the creep forces of the wheels, its gains are scheduled over the speed:

    y' = v (psi + beta),   psi' = r - v kappa,   J_z r' = b/2 (F_le - F_ri) - springs and dampers + gyroscopic moment

Wheels carry lateral force only at a creep angle. Controllers get psi plus the low-pass filtered beta as yaw angle,
because an inversion must not react to beta at once. All estimates are predicted to the time when a torque acts.
Serves the measured states of the paper's eq. (18).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any

import casadi as ca
import numpy as np
from scipy.linalg import expm, solve_discrete_are

from railrepro.clock import CONTROL_PERIOD
from railrepro.estimation.sensors import Loop, SensorGains, Signals, delayed
from railrepro.quantities import SIDES, Scalar, pack, unpack
from railrepro.vehicle.parameters import Vehicle

SPEEDS = (2.0, 5.0, 10.0, 20.0, 40.0, 70.0, 120.0)
"""Speeds at which the gains of the lateral filter are computed (m/s)."""
_LEAST_NOISE = 1e-9  # Assumed noise of perfect sensors (SI), which keeps the gains finite
LATERAL = ("y", "psi", "r", "bias", "beta")
"""States of the lateral filter: displacement (m), yaw angle against the track (rad), absolute yaw rate (rad/s), gyro
bias (rad/s), creep angle from heading to motion (rad). The first three are read."""
_GAINS = [f"{state}.{read}.{k}" for state in LATERAL for read in LATERAL[:3] for k in range(len(SPEEDS))]


@dataclass(frozen=True)
class WheelState:
    """States of the Kalman filter of a wheel, which estimates its creep force from motor torque and measured speed."""

    tau: Annotated[Scalar, "N m", "motor torque"]
    w: Annotated[Scalar, "rad/s", "angular speed"]
    force: Annotated[Scalar, "N", "longitudinal creep force"]


@dataclass(frozen=True)
class FilterState:
    """States of the Kalman filters of a running gear and its left (le) and right (ri) wheel: displacement y, yaw angle
    psi against the track, yaw rate r, bias of the gyroscope, creep angle beta from the heading to the direction of
    motion, positive to the right; and of low-pass filters of speed and creep angle."""

    y: Annotated[Scalar, "m"]
    psi: Annotated[Scalar, "rad"]
    r: Annotated[Scalar, "rad/s"]
    bias: Annotated[Scalar, "rad/s"]
    beta: Annotated[Scalar, "rad"]
    le: WheelState
    ri: WheelState
    v: Annotated[Scalar, "m/s", "low-pass filtered speed"]
    creep: Annotated[Scalar, "rad", "low-pass filtered creep angle"]


@dataclass(frozen=True)
class FilterGains:
    """Run-time numbers of the filters of a running gear. `lateral` has the Kalman gains (SI) from readings of y, psi, r
    to `LATERAL` (y, psi, r, bias, creep angle beta from heading to motion) at each of `SPEEDS`, the last index."""

    lateral: Annotated[list[Scalar], _GAINS]
    wheel_w: Annotated[Scalar, "-", "Kalman gain of the speed of a wheel"]
    wheel_force: Annotated[Scalar, "N s", "Kalman gain of the creep force of a wheel"]
    prediction: Annotated[Scalar, "s", "time from the readings to the effect of a torque"]
    creep_pole: Annotated[Scalar, "-", "gain per cycle of the low-pass filter of the creep angle"]
    speed_pole: Annotated[Scalar, "-", "gain per cycle of the low-pass filter of the speed"]
    J_z: Annotated[Scalar, "kg m2", "yaw inertia"]


@dataclass(frozen=True)
class Estimates:
    """Estimates of a running gear at the time when a torque acts. Lists are [left, right] wheel. Slip is (v - r_0 w) /
    max(v, 1 m/s) with speed v, wheel radius r_0, angular speed of the wheel w: positive in braking."""

    y_TrAx: Annotated[Scalar, "m", "lateral displacement"]
    psi_TrAx: Annotated[Scalar, "rad", "yaw angle against the track"]
    psidot_Ax: Annotated[Scalar, "rad/s", "yaw rate"]
    xdot: Annotated[Scalar, "m/s", "speed"]
    f: Annotated[list[Scalar], SIDES, "adhesion: force over nominal load (-)"]
    s: Annotated[list[Scalar], SIDES, "slip (-)"]


def lateral_matrices(vehicle: Vehicle, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Build the matrices A (5, 5), C (3, 5) of the lateral filter at a speed v (m/s), SI: x' = A x, readings C x. x
    holds y, yaw angle psi, yaw rate r, gyro bias and creep angle beta, from heading to direction of motion: y' = v (psi
    + beta), beta' = 0. Read are y, psi, and r plus the gyro bias."""
    k, d, inertia = vehicle.suspension.yaw_stiffness, vehicle.suspension.yaw_damping, vehicle.gear.inertia_z
    gyroscopic = 2 * vehicle.wheel.spin_inertia * speed / vehicle.wheel.radius * vehicle.gamma * speed
    a = [
        [0.0, speed, 0.0, 0.0, speed],
        [0.0, 0.0, 1.0, 0.0, 0.0],
        [0.0, -(k + gyroscopic) / inertia, -d / inertia, 0.0, -gyroscopic / inertia],
        [0.0] * 5,
        [0.0] * 5,
    ]
    return np.array(a), np.array([[1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 1.0, 0.0]])


def _stationary(a, c, q, r) -> tuple[np.ndarray, np.ndarray]:
    """Compute the stationary Kalman gain, and the covariance after a reading. The system is x' = a x + noise of
    spectral density q; c x is read every ms, covariance r. Source: Van Loan 1978; Anderson and Moore 1979, ch. 4."""
    n = len(a)
    both = expm(np.block([[-a, q], [np.zeros((n, n)), a.T]]) * CONTROL_PERIOD)
    step = both[n:, n:].T
    p = solve_discrete_are(step.T, c.T, step @ both[:n, n:], r)
    gain = p @ c.T @ np.linalg.inv(c @ p @ c.T + r)
    return gain, p - gain @ c @ p


def lateral_filter(vehicle: Vehicle, loop: Loop, speed: float) -> tuple[np.ndarray, np.ndarray]:
    """Design the lateral filter at a speed (m/s) for the noise of sensors and process in `loop`, SI. Returns the
    stationary Kalman gain (5, 3) from readings of y, psi, r to the states y, psi, r, gyro bias, creep angle (from
    heading to motion), and the covariance (5, 5) of these states after a reading."""
    rates = loop.filter
    y = max(loop.lateral.noise / np.sqrt(2), _LEAST_NOISE)
    readings = np.diag([y**2, (2 * y / loop.lateral.base) ** 2, max(loop.gyro.noise, _LEAST_NOISE) ** 2])
    process = np.diag([1e-12, 1e-12, rates.yaw_acceleration**2, rates.gyro_drift**2, rates.creep_rate**2])
    return _stationary(*lateral_matrices(vehicle, speed), process, readings)


@lru_cache(maxsize=16)
def stationary_gains(vehicle: Vehicle, loop: Loop) -> FilterGains:
    """Design the Kalman filters of a running gear and its wheels for the noise and delays of the sensors in `loop`;
    their models have the parameters of `vehicle`. Returns the gains, those of the lateral filter by speed."""
    rates = loop.filter
    inertia, radius = vehicle.wheel.spin_inertia, vehicle.wheel.radius
    at_speeds = np.array([lateral_filter(vehicle, loop, speed)[0] for speed in SPEEDS])
    spin = np.array([[0.0, -radius / inertia], [0.0, 0.0]])
    noise = max(loop.wheel_speed.noise, _LEAST_NOISE) ** 2
    wheel, _ = _stationary(spin, np.array([[1.0, 0.0]]), np.diag([1e-8, rates.force_rate**2]), np.array([[noise]]))
    return FilterGains(
        np.moveaxis(at_speeds, 0, -1).ravel().tolist(),
        wheel_w=float(wheel[0, 0]),
        wheel_force=float(wheel[1, 0]),
        prediction=loop.latency.measurement + loop.latency.command,
        creep_pole=CONTROL_PERIOD / (rates.creep_lag + CONTROL_PERIOD),
        speed_pole=CONTROL_PERIOD / (rates.speed_lag + CONTROL_PERIOD),
        J_z=vehicle.gear.inertia_z,
    )


def observe(
    readings: Signals, commands: Sequence[list], track: Any, ticks, sensor: SensorGains, gain: Any, memory: FilterState
) -> tuple[Estimates, FilterState]:
    """Correct the filters of a gear by the readings of this cycle, and predict to the time when a torque acts. Returns
    the `Estimates` at that time, and the corrected `FilterState` at the time of the readings. Numbers are SX.
    `commands` has two lists, torques sent to the left and the right wheel before this cycle (N m), newest first.
    `track` has curvature and angles of the track at the gear (`lateral.TrackInputs`). `gain` is a `law.SensedGains`:
    `filter` has the Kalman gains (`FilterGains`), `model`, `drive`, `nominal_load` the nominal vehicle, motor and wheel
    load. `sensor` has the delays. `ticks` counts control cycles from the start; at 0 the readings set the states.
    `memory` are states that `advance` predicted in the previous cycle for the time of the readings."""
    planes = readings.y_ahead, readings.y_behind
    read = sum(planes) / 2, (planes[0] - planes[1]) / sensor.base, readings.psidot_Ax
    le, ri = WheelState(0, readings.w_le, 0), WheelState(0, readings.w_ri, 0)
    start = FilterState(*read, 0, 0, le, ri, readings.v, 0)
    x = unpack(FilterState, (ca.if_else(ticks < 0.5, *pair) for pair in zip(pack(start), pack(memory), strict=True)))
    v = x.v + gain.filter.speed_pole * (readings.v - x.v)
    innovation = read[0] - x.y, read[1] - x.psi, read[2] - x.r - x.bias
    corrected = {}
    for i, state in enumerate(LATERAL):
        gains = [_scheduled(gain.filter.lateral, 3 * i + j, v) for j in range(3)]
        corrected[state] = getattr(x, state) + sum(k * error for k, error in zip(gains, innovation, strict=True))

    def corrected_wheel(wheel: WheelState, reading: Any) -> WheelState:
        error = reading - wheel.w
        w, force = wheel.w + gain.filter.wheel_w * error, wheel.force + gain.filter.wheel_force * error
        return replace(wheel, w=w, force=force)

    le, ri = corrected_wheel(x.le, readings.w_le), corrected_wheel(x.ri, readings.w_ri)
    creep = x.creep + gain.filter.creep_pole * (corrected["beta"] - x.creep)
    x = replace(x, **corrected, le=le, ri=ri, v=v, creep=creep)

    y, psi, r = _predicted(x, commands, track, sensor, gain)
    f = [wheel.force / gain.nominal_load for wheel in (x.le, x.ri)]
    s = [(v - gain.model.r_0 * wheel.w) / ca.fmax(v, 1.0) for wheel in (x.le, x.ri)]
    return Estimates(y, psi + x.creep, r, v, f, s), x


def advance(x: FilterState, commands: Sequence[list], track: Any, sensor: SensorGains, gain: Any) -> FilterState:
    """Predict `x`, the corrected `FilterState` of `observe`, by a control cycle; the result is `memory` of the next
    `observe`. Arguments are those of that `observe`, but `commands` begin with the torques of this cycle."""
    h, model = CONTROL_PERIOD, gain.model

    def wheel(state: WheelState, line: list) -> WheelState:
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


def _scheduled(gains: list, index: int, v):
    """Interpolate a gain of the lateral filter at a speed v (m/s): linear between `SPEEDS`, constant beyond them."""
    at_speeds = gains[index * len(SPEEDS) : (index + 1) * len(SPEEDS)]
    value = at_speeds[0]
    for k, (low, high) in enumerate(pairwise(SPEEDS)):
        fraction = ca.fmin(ca.fmax((v - low) / (high - low), 0), 1)
        value += fraction * (at_speeds[k + 1] - at_speeds[k])
    return value


def _yaw_acceleration(x: FilterState, track: Any, gain: Any):
    """Compute the yaw acceleration (rad/s2) due to creep forces, springs, dampers and the gyroscopic moment."""
    model = gain.model
    moment = model.b / 2 * (x.le.force - x.ri.force)
    moment -= model.k_sz * (track.psi_Tr + x.psi - track.psi_CB)
    moment -= model.k_dz * (x.r - x.v * track.dpsi_dp_CB)
    roll_rate = x.v * (track.dphi_dp - model.gamma * (x.psi + x.beta))
    return (moment + 2 * model.J_Wy * x.v / model.r_0 * roll_rate) / gain.filter.J_z


def _predicted(x: FilterState, commands: Sequence[list], track: Any, sensor: SensorGains, gain: Any) -> tuple:
    """Predict y, psi and r of `FilterState` to the time when a torque of this cycle acts. The torques that are still
    under way change the yaw rate as if the wheels rolled without creep."""
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
