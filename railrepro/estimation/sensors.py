"""Sensors of a running gear, read every ms: noise, bias, resolution and age of readings; latency of commands.

Noise is counter-based: a function of seed, signal and millisecond, so it is the same on every executor and processor.
The paper names lateral position and yaw difficult or costly to measure; its own loop measures them exactly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import casadi as ca
import numpy as np

from railrepro import data, paths
from railrepro.clock import CONTROL_PERIOD
from railrepro.quantities import group, listed, names, unpack
from railrepro.vehicle.parameters import Parameter, loaded

LONGEST = 20
"""Longest latency that the delay lines hold (control cycles)."""
Signals = group("Signals", "y_ahead m, y_behind m, psidot_Ax rad/s, w_le rad/s, w_ri rad/s, v m/s, p m")
"""Readings of a gear: displacement against the rails in planes ahead of and behind the axle, yaw rate, angular speeds
of left and right wheel, speed and position along the track."""
SIGNALS = names(Signals)
_GROUP = dict(
    zip(SIGNALS, ("lateral", "lateral", "gyro", "wheel_speed", "wheel_speed", "speed", "position"), strict=True)
)
_QUALITY = ("noise", "bias", "resolution")
SensorGains = group(
    "SensorGains",
    dict.fromkeys(SIGNALS, group("Quality", dict.fromkeys(_QUALITY, Any))),
    "measurement ms, command ms, unknown_delay ms, torque_gain -, seed -, base m",
)
"""Run-time numbers of a gear's sensors: for each of `Signals` noise, bias, resolution (unit of the signal); delays of
readings, commands and inverter (ms), its gain (-), seed, distance `base` of the planes (m)."""
_LINE = listed(range(LONGEST + 1))
SensorMemory = group("SensorMemory", dict.fromkeys([*SIGNALS[:-1], "tau_le", "tau_ri"], _LINE))
"""Delay lines of readings, but for p, and of torque commands (N m), `LONGEST` + 1 entries, newest first."""
_MODULUS = 67108859.0
"""Largest prime below 2^26: squares of smaller whole numbers are exact in double precision."""


def _upto(high: float, unit: str) -> Parameter:
    return Parameter(0.0, high, unit, closed=True)


@data.table
class Lateral:
    """Sensors of the displacement of the axle against the rails in two planes, `base` (m) apart.

    noise: standard deviation of a reading (m); bias: largest constant offset of a run (m), drawn uniformly from [-bias,
    bias]; resolution: step of rounding (m), 0 none.
    """

    base: Annotated[float, Parameter(0.1, 5.0, "m")]
    noise: Annotated[float, _upto(0.01, "m")]
    bias: Annotated[float, _upto(0.01, "m")]
    resolution: Annotated[float, _upto(0.001, "m")]


@data.table
class Rate:
    """Sensor of an angular velocity: yaw rate by the gyroscope of the running gear, or angular speed of a wheel.

    noise, bias, resolution (rad/s), as in `Lateral`; noise is no density.
    """

    noise: Annotated[float, _upto(0.1, "rad/s")]
    bias: Annotated[float, _upto(0.1, "rad/s")]
    resolution: Annotated[float, _upto(0.1, "rad/s")]


@data.table
class Speed:
    """Sensor of the speed along the track: noise, bias, resolution (m/s), as in `Lateral`."""

    noise: Annotated[float, _upto(1.0, "m/s")]
    bias: Annotated[float, _upto(1.0, "m/s")]
    resolution: Annotated[float, _upto(0.1, "m/s")]


@data.table
class Position:
    """Sensor of the track coordinate, no delay: noise, bias, resolution (m), as in `Lateral`."""

    noise: Annotated[float, _upto(1.0, "m")]
    bias: Annotated[float, _upto(20.0, "m")]
    resolution: Annotated[float, _upto(1.0, "m")]


@data.table
class Latency:
    """`measurement`: age of all readings but the position (s); `command`: time from a command to the inverter (s)."""

    measurement: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]
    command: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]


@data.table
class Inverter:
    """Errors unknown to controllers and filter: further `delay` of commands (s); `gain`, torque over command (-)."""

    delay: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]
    gain: Annotated[float, Parameter(0.0, 10.0, "-")]


@data.table
class Filter:
    """Process noise of the filter in `observers`, as square roots of spectral densities, and its low-pass filters.

    Noise of the time derivatives of creep force `force_rate` (N/s^0.5), creep angle `creep_rate` (rad/s^0.5), yaw rate
    `yaw_acceleration` and gyro bias `gyro_drift` (rad/s^1.5); time constants (s) of the low-pass filters of estimated
    creep angle `creep_lag` and read speed `speed_lag`.
    """

    force_rate: Annotated[float, _upto(1e7, "N/s^0.5")]
    creep_rate: Annotated[float, _upto(1.0, "rad/s^0.5")]
    yaw_acceleration: Annotated[float, _upto(100.0, "rad/s^1.5")]
    gyro_drift: Annotated[float, _upto(1.0, "rad/s^1.5")]
    creep_lag: Annotated[float, _upto(10.0, "s")]
    speed_lag: Annotated[float, _upto(1.0, "s")]


@data.table
class Adhesion:
    """Values of `control.adhesion.AdhesionSettings` with sensors: filter time (s), dead zone (1/s), speed (m/s)."""

    filter_time: Annotated[float, _upto(1.0, "s")]
    dead_zone: Annotated[float, _upto(10.0, "1/s")]
    noise_speed: Annotated[float, _upto(200.0, "m/s")]


@data.table
class Loop:
    """Sensors, latencies, inverter errors and filter between car and controllers; defaults in data/sensors.toml."""

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
            raise ValueError(f"latency of {1e3 * total:g} ms in all, at most {LONGEST} ms are held")

    def perfect(self) -> Loop:
        """Copy with exact readings, no latency, and adhesion settings that suit them; inverter errors stay."""
        exact = dict.fromkeys(_QUALITY, 0.0)
        quiet = {sensor: replace(getattr(self, sensor), **exact) for sensor in _GROUP.values()}
        return replace(self, **quiet, latency=Latency(0.0, 0.0), adhesion=Adhesion(5e-3, 1e-3, 0.0))

    def lateral_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations of noise and of bias, each for displacement y (m), yaw angle psi (rad) and yaw rate r
        (rad/s), shape (3,); y is the mean of both planes, psi their difference over `base`; a bias is drawn uniformly.
        """
        of_planes = np.array([1 / np.sqrt(2), np.sqrt(2) / self.lateral.base])
        noise = np.append(self.lateral.noise * of_planes, self.gyro.noise)
        bias = np.append(self.lateral.bias * of_planes, self.gyro.bias)
        return noise, bias / np.sqrt(3)


def load_loop(path: Path | str | None = None, **overrides) -> Loop:
    """Read and check a TOML file like data/sensors.toml, the default; InputError for a wrong key or value.

    `overrides` are values by dotted key, as `load_loop(**{"gyro.noise": 0.002})` (SI).
    """
    return loaded(Loop, data.location(path, paths.source("data/sensors.toml")), overrides)[0]


def readings(perfect: bool = False, seed: int = 0, **overrides) -> Readings:
    """`Readings` of `load_loop(**overrides)` with a seed; `perfect`: without errors and latency, see `Loop.perfect`."""
    loop = load_loop(**overrides)
    return Readings(loop.perfect() if perfect else loop, seed)


@dataclass(frozen=True)
class Readings:
    """Sensors of one run: their data `loop`, and `seed`, a whole number from 0, which draws noise and biases."""

    loop: Loop
    seed: int = 0

    def __post_init__(self) -> None:
        data.require("Readings: seed", self.seed, data.between(0, math.inf), whole=True)

    def gains(self, gear: int) -> Any:
        """`SensorGains` of a gear (0 front, 1 rear), its biases drawn from the seed."""
        draw, loop, entries = np.random.default_rng((self.seed, gear)), self.loop, []
        for of_signal in _GROUP.values():
            sensor = getattr(loop, of_signal)
            sensor = replace(sensor, bias=sensor.bias * draw.uniform(-1.0, 1.0))
            entries += [getattr(sensor, name) for name in _QUALITY]
        delays = loop.latency.measurement, loop.latency.command, loop.inverter.delay
        entries += [delay / CONTROL_PERIOD for delay in delays]
        return unpack(SensorGains, [*entries, loop.inverter.gain, float(self.seed % 1_000_003), loop.lateral.base])


def sense(truth: Any, ticks, gear: int, gain: Any, memory: Any) -> tuple[Any, dict[str, Any]]:
    """Readings (`Signals`) of a gear as they reach the controller, and dict of the next delay lines by signal.

    Args:
        truth (Signals of SX): Exact values.
        ticks (SX): Control cycles since the start; at 0 the delay lines are filled with the first readings.
        gear (int): 0 front, 1 rear.
        gain, memory (SensorGains, SensorMemory of SX): Run-time numbers and delay lines of this gear.
    """
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
    """Value of a delay line (list of a value per cycle, newest first) `cycles` ago, linear between entries."""
    return sum(ca.fmax(0, 1 - ca.fabs(cycles - k)) * value for k, value in enumerate(line))


def received_torque(line: list, gain: Any):
    """Torque command at a motor in this control cycle (N m), from its `line` (newest first) and `SensorGains`."""
    return gain.torque_gain * delayed(line, gain.command + gain.unknown_delay)


def gaussian(seed, channel: int, ticks):
    """Pseudorandom number of zero mean and unit variance, nearly normal: scaled sum of four uniform numbers.

    A function of seed, channel (number of the source) and control cycle `ticks`, the same bits on every processor.
    """
    total = 0.0
    for k in range(2):
        x = _hashed(seed, 2 * channel + k, ticks)
        high = ca.floor(x / 8192.0)
        total += (x - 8192.0 * high) / 8192.0 + high / 8192.0 - 1.0
    return np.sqrt(3.0) * total


def _hashed(seed, channel: int, ticks):
    """Whole number below `_MODULUS` from hashed counters; whole numbers below 2^52 and exact operations."""
    x = _modulo(15485863.0 * ticks + 104729.0 * seed + 32452843.0 * channel + 49979687.0)
    for constant in (7919.0, 611953.0, 1299709.0):
        x = _modulo(x * x + constant)
    return x


def _modulo(x):
    """Remainder of whole numbers; a quotient that is one off gives another whole number, the same everywhere."""
    return x - _MODULUS * ca.floor(x * (1 / _MODULUS))
