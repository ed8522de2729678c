"""Sensors of a running gear, read every ms: noise, bias, resolution and latency of readings; latency of commands. Noise
is counter-based: a function of seed, signal and millisecond, so it is the same on every executor and processor. The
paper calls lateral position and yaw difficult or costly to measure; its simulation measures them exactly."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Self

import casadi as ca
import numpy as np

from railrepro import data, paths
from railrepro.clock import CONTROL_PERIOD
from railrepro.quantities import Scalar, names, notes, unpack
from railrepro.vehicle.parameters import Parameter, loaded

LONGEST = 20
"""Longest latency (control cycles)."""
_Line = Annotated[list[Scalar], range(LONGEST + 1)]


@dataclass(frozen=True)
class Signals:
    """Readings of the sensors of a running gear in one control cycle, or the exact values of the same quantities."""

    y_ahead: Annotated[Scalar, "m", "displacement against the rails in a plane ahead of the axle"]
    y_behind: Annotated[Scalar, "m", "displacement against the rails in a plane behind the axle"]
    psidot_Ax: Annotated[Scalar, "rad/s", "yaw rate"]
    w_le: Annotated[Scalar, "rad/s", "angular speed of the left wheel"]
    w_ri: Annotated[Scalar, "rad/s", "angular speed of the right wheel"]
    v: Annotated[Scalar, "m/s", "speed along the track"]
    p: Annotated[Scalar, "m", "position along the track"]


SIGNALS = names(Signals)
_SENSORS = ("lateral", "lateral", "gyro", "wheel_speed", "wheel_speed", "speed", "position")
"""Field of `Loop` with the sensor of each of `SIGNALS`."""
_SEEDS = 1_000_003


@dataclass(frozen=True)
class SensorMemory:
    """Last 21 values of each delayed signal of a running gear, one per ms, newest first, from which delays of 0 to 20
    ms are read: displacement ahead of and behind the axle (m), yaw rate and wheel speeds w (rad/s), speed v (m/s), and
    torque commands tau (N m) to the left (le) and right (ri) motor. The position has no delay, and so no entry."""

    y_ahead: _Line
    y_behind: _Line
    psidot_Ax: _Line
    w_le: _Line
    w_ri: _Line
    v: _Line
    tau_le: _Line
    tau_ri: _Line


def _upto(high: float, unit: str) -> Parameter:
    return Parameter(0.0, high, unit, closed=True)


@data.table
class Lateral:
    """Two sensors of the lateral displacement of a gear from the rails (m), one ahead of the axle and one behind it.
    `base` is their distance along the track, `noise` the standard deviation of a reading, `resolution` the step to
    which it is rounded (0: none). A run draws the constant offset of each uniformly from [-bias, bias]."""

    base: Annotated[float, Parameter(0.1, 5.0, "m")]
    noise: Annotated[float, _upto(0.01, "m")]
    bias: Annotated[float, _upto(0.01, "m")]
    resolution: Annotated[float, _upto(0.001, "m")]


@data.table
class Rate:
    """Sensor of an angular velocity: gyroscope of a running gear or speed sensor of a wheel. `noise`: standard
    deviation of a reading; `bias`: largest constant offset, drawn for a run; `resolution`: step of rounding (rad/s)."""

    noise: Annotated[float, _upto(0.1, "rad/s")]
    bias: Annotated[float, _upto(0.1, "rad/s")]
    resolution: Annotated[float, _upto(0.1, "rad/s")]


@data.table
class Speed:
    """Sensor of the speed along the track. `noise`: standard deviation of a reading; `bias`: largest constant offset,
    drawn for a run; `resolution`: step of rounding (all m/s)."""

    noise: Annotated[float, _upto(1.0, "m/s")]
    bias: Annotated[float, _upto(1.0, "m/s")]
    resolution: Annotated[float, _upto(0.1, "m/s")]


@data.table
class Position:
    """Sensor of the track coordinate, without delay. `noise`: standard deviation of a reading; `bias`: largest constant
    offset, drawn for a run; `resolution`: step of rounding (all m)."""

    noise: Annotated[float, _upto(1.0, "m")]
    bias: Annotated[float, _upto(20.0, "m")]
    resolution: Annotated[float, _upto(1.0, "m")]


@data.table
class Latency:
    """Delays that controllers and filter know: `measurement`, age of all readings except the position (s); `command`,
    time from the controller to the inverter (s)."""

    measurement: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]
    command: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]


@data.table
class Inverter:
    """Errors of the inverters, which controllers and filter do not know: `delay` (s), added to the latency of commands;
    `gain`, ratio of torque to commanded torque (-)."""

    delay: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]
    gain: Annotated[float, Parameter(0.0, 10.0, "-")]


@data.table
class Filter:
    """Settings of the filter `estimation.observers`. The first four are process noise (roots of spectral densities) in
    the derivatives of a wheel's creep force, creep angle (from a gear's heading to its motion), yaw rate and gyro bias.
    The lags are time constants of low-pass filters: of the creep angle, which is added to the yaw angle that
    controllers get, slowly, as they must not react to it at once; and of the speed."""

    force_rate: Annotated[float, _upto(1e7, "N/s^0.5")]
    creep_rate: Annotated[float, _upto(1.0, "rad/s^0.5")]
    yaw_acceleration: Annotated[float, _upto(100.0, "rad/s^1.5")]
    gyro_drift: Annotated[float, _upto(1.0, "rad/s^1.5")]
    creep_lag: Annotated[float, _upto(10.0, "s")]
    speed_lag: Annotated[float, _upto(1.0, "s")]


@data.table
class Adhesion:
    """Settings of the adhesion law (slip control) for noisy readings: lag of its low-pass filters; slip rate below
    which no wheel counts as past its adhesion maximum (dead zone); speed below which the dead zone grows as 1/v."""

    filter_time: Annotated[float, _upto(1.0, "s")]
    dead_zone: Annotated[float, _upto(10.0, "1/s")]
    noise_speed: Annotated[float, _upto(200.0, "m/s")]


@data.table
class Loop:
    """All between car and controllers: errors of sensors, latencies, errors of inverters, settings of the filter of
    states; `load_loop` reads it from data/sensors.toml. InputError if delays exceed 20 ms in all."""

    lateral: Lateral
    gyro: Rate
    wheel_speed: Rate
    speed: Speed
    position: Position
    latency: Latency
    inverter: Inverter
    filter: Filter
    adhesion: Adhesion

    def __post_init__(self) -> None:
        total = self.latency.measurement + self.latency.command + self.inverter.delay
        if total > LONGEST * CONTROL_PERIOD + 1e-9:
            raise ValueError(f"latency of {1e3 * total:g} ms in all, at most {LONGEST} ms are allowed")

    def perfect(self) -> Self:
        """Copy with exact readings, no latency and the adhesion law's settings for exact readings; same inverters."""
        exact = {sensor: replace(getattr(self, sensor), noise=0.0, bias=0.0, resolution=0.0) for sensor in _SENSORS}
        return replace(self, **exact, latency=Latency(0.0, 0.0), adhesion=Adhesion(5e-3, 1e-3, 0.0))

    def lateral_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Compute the standard deviations of noise and of the uniform bias, each of shape (3,), of readings y, psi, r.
        The displacement y (m) is the mean of the two lateral sensors, the yaw angle psi (rad) their difference over
        `base`; r is the yaw rate (rad/s)."""
        of_planes = np.array([1 / np.sqrt(2), np.sqrt(2) / self.lateral.base])
        noise = np.append(self.lateral.noise * of_planes, self.gyro.noise)
        bias = np.append(self.lateral.bias * of_planes, self.gyro.bias)
        return noise, bias / np.sqrt(3)


_RANGES = dict(notes(Loop))


@dataclass(frozen=True)
class Quality:
    """Errors of a signal's sensor in a run, in its unit: standard deviation of noise, offset, step of rounding (0:
    none)."""

    noise: Scalar
    bias: Scalar
    resolution: Scalar


@dataclass(frozen=True)
class SensorGains:
    """Errors and delays of the sensors of a running gear in one run, as numbers that the compiled loop reads."""

    y_ahead: Quality
    y_behind: Quality
    psidot_Ax: Quality
    w_le: Quality
    w_ri: Quality
    v: Quality
    p: Quality
    measurement: Annotated[Scalar, data.between(0, LONGEST, "ms"), "delay of readings"]
    command: Annotated[Scalar, data.between(0, LONGEST, "ms"), "delay of commands"]
    unknown_delay: Annotated[Scalar, data.between(0, LONGEST, "ms"), "delay of the inverter"]
    torque_gain: Annotated[Scalar, _RANGES["inverter.gain"], "gain of the inverter"]
    seed: Annotated[Scalar, data.between(0, _SEEDS), "seed of the noise"]
    base: Annotated[Scalar, _RANGES["lateral.base"], "distance of the two planes"]


def quality_ranges() -> dict[str, data.Quantity]:
    """Return the permitted ranges of sensor errors, for exported controllers: a dict from signal and error, such as
    "y_ahead.noise" (fields of `Signals` and `Quality`), to a `data.Quantity`."""
    return {
        f"{signal}.{error}": replace(_RANGES[f"{sensor}.{error}"], signed=error == "bias")
        for signal, sensor in zip(SIGNALS, _SENSORS, strict=True)
        for error in names(Quality)
    }


def load_loop(path: Path | str | None = None, **overrides) -> Loop:
    """Read and check the sensor data of a TOML file, by default data/sensors.toml. InputError for a wrong key or value.
    `overrides` replace values (SI) by dotted key, as in `load_loop(**{"gyro.noise": 0.002})`."""
    return loaded(Loop, data.location(path, paths.source("data/sensors.toml")), overrides)[0]


def readings(perfect: bool = False, seed: int = 0, **overrides) -> "Readings":
    """Make the `Readings` of a run with the data of data/sensors.toml, changed by `overrides` as in `load_loop`, for
    one `seed` of noise and biases. With `perfect` readings and commands are exact and without delay, but inverters keep
    their errors."""
    loop = load_loop(**overrides)
    return Readings(loop.perfect() if perfect else loop, seed)


@dataclass(frozen=True)
class Readings:
    """Sensors of one run: their data, and the seed of noise and biases (at least 0)."""

    loop: Loop
    seed: int = 0

    def __post_init__(self) -> None:
        data.require("Readings: loop", self.loop, Loop)
        data.require("Readings: seed", self.seed, data.between(0, math.inf), whole=True)

    def gains(self, gear: int) -> SensorGains:
        """Draw the biases of a gear (0 front, 1 rear) from the seed, and return its `SensorGains`."""
        draw, loop, entries = np.random.default_rng((self.seed, gear)), self.loop, []
        for sensor in (getattr(loop, name) for name in _SENSORS):
            entries += [sensor.noise, sensor.bias * draw.uniform(-1.0, 1.0), sensor.resolution]
        delays = loop.latency.measurement, loop.latency.command, loop.inverter.delay
        entries += [delay / CONTROL_PERIOD for delay in delays]
        return unpack(SensorGains, [*entries, loop.inverter.gain, float(self.seed % _SEEDS), loop.lateral.base])


def sense(truth: Signals, ticks, gear: int, gain: SensorGains, memory: SensorMemory) -> tuple[Signals, dict[str, list]]:
    """Read the sensors of a gear (0 front, 1 rear) in this control cycle. All numbers are of type SX. `truth` are the
    exact values, `memory` the last values of each signal after the previous cycle. `ticks` counts the control cycles
    from the start; at 0 the first reading fills the memory. Returns the delayed readings that reach the controller, and
    the next memory as a dict: signal but p, such as "w_le" -> list of 21 values, newest first."""
    readings, lines = {}, {}
    for i, signal in enumerate(SIGNALS):
        quality = getattr(gain, signal)
        noisy = getattr(truth, signal) + quality.bias
        noisy += quality.noise * gaussian(gain.seed, len(SIGNALS) * gear + i, ticks)
        step = quality.resolution
        coarse = ca.if_else(step > 0, step * ca.floor(noisy / ca.fmax(step, 1e-12) + 0.5), noisy)
        if signal == "p":
            readings[signal] = coarse
            continue
        before = getattr(memory, signal)[:-1]
        line = lines[signal] = [coarse, *(ca.if_else(ticks < 0.5, coarse, old) for old in before)]
        readings[signal] = delayed(line, gain.measurement)
    return Signals(**readings), lines


def delayed(line: list, cycles):
    """Interpolate a list of values, one per cycle (ms), newest first, `cycles` control cycles ago. Numbers or SX."""
    return sum(ca.fmax(0, 1 - ca.fabs(cycles - k)) * value for k, value in enumerate(line))


def received_torque(line: list, gain: SensorGains):
    """Torque that a motor is given in this cycle (N m): torque_gain times the command in `line` (N m; one per ms,
    newest first) of command + unknown_delay ms ago, interpolated. All three are fields of `gain`."""
    return gain.torque_gain * delayed(line, gain.command + gain.unknown_delay)


def gaussian(seed, channel: int, ticks):
    """Draw a nearly normal pseudorandom number, zero mean and unit variance: a scaled sum of four uniform numbers. It
    is a hash of `seed`, `channel` (number of the noise source) and `ticks` (control cycle). The hash computes with
    whole numbers below 2^52, which are exact, so its bits are the same everywhere."""
    total = 0.0
    for k in range(2):
        x = _modulo(15485863.0 * ticks + 104729.0 * seed + 32452843.0 * (2 * channel + k) + 49979687.0)
        for constant in (7919.0, 611953.0, 1299709.0):
            x = _modulo(x * x + constant)
        high = ca.floor(x / 8192.0)
        total += (x - 8192.0 * high) / 8192.0 + high / 8192.0 - 1.0
    return np.sqrt(3.0) * total


def _modulo(x):
    """Reduce a whole number modulo the largest prime below 2^26. Where the rounded quotient is one off, the result is
    another whole number, the same everywhere."""
    return x - 67108859.0 * ca.floor(x * (1 / 67108859.0))
