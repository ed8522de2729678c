"""Sensors of a running gear: noise, bias, resolution, period, dropouts and age of readings; latency of commands.

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
_QUALITY = ("noise", "bias", "resolution", "period", "dropout")
SensorGains = group(
    "SensorGains",
    dict.fromkeys(SIGNALS, group("Quality", dict.fromkeys(_QUALITY, Any))),
    "measurement ms, command ms, unknown_delay ms, torque_gain -, seed -, base m",
)
"""Run-time numbers of a gear's sensors: for each of `Signals` noise, bias, resolution (unit of the signal), period (s),
dropout (-); delays of readings, commands and inverter (ms), its gain (-), seed, distance `base` of the planes (m)."""
_LINE = listed(range(LONGEST + 1))
SensorMemory = group(
    "SensorMemory", dict.fromkeys(SIGNALS, _LINE) | {"p": Any}, dict.fromkeys(("tau_le", "tau_ri"), _LINE)
)
"""Delay lines of readings and torque commands (N m), `LONGEST` + 1 entries, newest first; of p the last reading."""
_MODULUS = 67108859.0
"""Largest prime below 2^26: squares of smaller whole numbers are exact in double precision."""


def _upto(high: float, unit: str) -> Parameter:
    return Parameter(0.0, high, unit, closed=True)


_PERIOD = Annotated[float, _upto(0.1, "s")]
_DROPOUT = Annotated[float, _upto(0.9, "-")]


@data.table
class Lateral:
    """Sensors of the displacement of the axle against the rails in two planes, `base` (m) apart.

    noise: standard deviation of a reading (m); bias: largest constant offset of a run (m), drawn uniformly from [-bias,
    bias]; resolution: step of rounding (m), 0 none; period: time between readings (s), a whole number of ms;
    dropout: share of readings that are lost (-), in whose place the last one is held.
    """

    base: Annotated[float, Parameter(0.1, 5.0, "m")]
    noise: Annotated[float, _upto(0.01, "m")]
    bias: Annotated[float, _upto(0.01, "m")]
    resolution: Annotated[float, _upto(0.001, "m")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Rate:
    """Sensor of an angular velocity: yaw rate by the gyroscope of the running gear, or angular speed of a wheel.

    noise: standard deviation of a reading, bias: largest offset, resolution (rad/s; not a density, not degrees);
    period (s), dropout (-); all as in `Lateral`.
    """

    noise: Annotated[float, _upto(0.1, "rad/s")]
    bias: Annotated[float, _upto(0.1, "rad/s")]
    resolution: Annotated[float, _upto(0.1, "rad/s")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Speed:
    """Sensor of the speed along the track: noise, bias, resolution (m/s), period (s), dropout (-), as in `Lateral`."""

    noise: Annotated[float, _upto(1.0, "m/s")]
    bias: Annotated[float, _upto(1.0, "m/s")]
    resolution: Annotated[float, _upto(0.1, "m/s")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Position:
    """Sensor of the track coordinate, no delay: noise, bias, resolution (m), period (s), dropout (-), as `Lateral`."""

    noise: Annotated[float, _upto(1.0, "m")]
    bias: Annotated[float, _upto(20.0, "m")]
    resolution: Annotated[float, _upto(1.0, "m")]
    period: _PERIOD
    dropout: _DROPOUT


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
        for sensor in dict.fromkeys(_GROUP.values()):
            ratio = getattr(self, sensor).period / CONTROL_PERIOD
            if ratio < 1 or abs(ratio - round(ratio)) > 1e-6:
                raise ValueError(
                    f"{sensor}.period is {1e3 * CONTROL_PERIOD * ratio:g} ms, a whole number of ms is needed"
                )

        total = self.latency.measurement + self.latency.command + self.inverter.delay
        if total > LONGEST * CONTROL_PERIOD + 1e-9:
            raise ValueError(f"latency of {1e3 * total:g} ms in all, at most {LONGEST} ms are held")

    def perfect(self) -> Loop:
        """Copy with exact readings every ms, no latency, and adhesion settings that suit them; inverter errors stay."""
        quiet = {
            group: replace(
                getattr(self, group), noise=0.0, bias=0.0, resolution=0.0, period=CONTROL_PERIOD, dropout=0.0
            )
            for group in dict.fromkeys(_GROUP.values())
        }
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
    """Read and check the data of the sensors.

    Parameters
    ----------
    path : path, optional
        A TOML file like data/sensors.toml, the default.
    overrides
        Values by dotted key, `load_loop(**{"gyro.noise": 0.002})` (SI units).

    Raises
    ------
    InputError
        When a key or value is wrong; the message names file, key, value and what is allowed.
    """
    return loaded(Loop, data.location(path, paths.source("data/sensors.toml")), overrides)[0]


def readings(perfect: bool = False, seed: int = 0, **overrides) -> Readings:
    """`Readings` of `load_loop(**overrides)` with a seed; `perfect`: without errors and latency, see `Loop.perfect`."""
    data.require("sensors: perfect", perfect, bool)
    loop = load_loop(**overrides)
    return Readings(loop.perfect() if perfect else loop, seed)


@dataclass(frozen=True)
class Readings:
    """Sensors of one run: their data `loop`, and `seed`, from which noise and constant biases follow."""

    loop: Loop
    seed: int = 0
    """Whole number from 0; other seeds give independent noise and biases."""

    def __post_init__(self) -> None:
        data.require("Readings: loop", self.loop, Loop)
        data.require("Readings: seed", self.seed, data.between(0, math.inf), whole=True)

    def gains(self, gear: int) -> Any:
        """`SensorGains` of a gear (0 front, 1 rear), its biases drawn from the seed."""
        data.require("Readings: gear", gear, data.between(0, 1), whole=True)
        draw, loop = np.random.default_rng((self.seed, gear)), self.loop
        sensors = {signal: getattr(loop, group) for signal, group in _GROUP.items()}
        biases = {signal: sensor.bias * draw.uniform(-1.0, 1.0) for signal, sensor in sensors.items()}
        entries = [
            {**vars(sensor), "bias": biases[signal]}[name] for signal, sensor in sensors.items() for name in _QUALITY
        ]
        delays = loop.latency.measurement, loop.latency.command, loop.inverter.delay
        entries += [delay / CONTROL_PERIOD for delay in delays]
        return unpack(SensorGains, [*entries, loop.inverter.gain, float(self.seed % 1_000_003), loop.lateral.base])


def sense(truth: Any, ticks, gear: int, gain: Any, memory: Any) -> tuple[Any, dict[str, Any]]:
    """Readings (`Signals`) of a gear as they reach the controller, and dict of the next delay lines by signal.

    Parameters
    ----------
    truth : Signals of SX
        Exact values.
    ticks : SX
        Control cycles since the start; at 0 the delay lines are filled with the first readings.
    gear : int
        0 front, 1 rear.
    gain, memory : SensorGains, SensorMemory of SX
        Run-time numbers and delay lines of this gear.
    """
    readings, lines = {}, {}
    for i, signal in enumerate(SIGNALS):
        quality = getattr(gain, signal)
        before = getattr(memory, signal)
        noisy = getattr(truth, signal) + quality.bias
        noisy += quality.noise * gaussian(gain.seed, len(SIGNALS) * gear + i, ticks)
        step = quality.resolution
        coarse = ca.if_else(step > 0, step * ca.floor(noisy / ca.fmax(step, 1e-12) + 0.5), noisy)
        due, due_before = (ca.floor(tick * CONTROL_PERIOD / quality.period + 1e-6) for tick in (ticks, ticks - 1))
        chance = uniform(gain.seed, 2 * (2 * len(SIGNALS) + len(SIGNALS) * gear + i), ticks)
        lost = chance < quality.dropout
        fresh = ca.logic_or(ticks < 0.5, ca.logic_and(due > due_before, ca.logic_not(lost)))
        if signal == "p":
            readings[signal] = lines[signal] = ca.if_else(fresh, coarse, before)
            continue
        newest = ca.if_else(fresh, coarse, before[0])
        line = lines[signal] = [newest, *(ca.if_else(ticks < 0.5, newest, old) for old in before[:-1])]
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


def uniform(seed, channel: int, ticks):
    """Uniform pseudorandom number in [0, 1), arguments as of `gaussian`, whose channel c uses channels 2 c, 2 c + 1."""
    return _hashed(seed, channel, ticks) / _MODULUS


def _hashed(seed, channel: int, ticks):
    """Whole number below `_MODULUS` from hashed counters; whole numbers below 2^52 and exact operations."""
    x = _modulo(15485863.0 * ticks + 104729.0 * seed + 32452843.0 * channel + 49979687.0)
    for constant in (7919.0, 611953.0, 1299709.0):
        x = _modulo(x * x + constant)
    return x


def _modulo(x):
    """Remainder of whole numbers; a quotient that is one off gives another whole number, the same everywhere."""
    return x - _MODULUS * ca.floor(x * (1 / _MODULUS))
