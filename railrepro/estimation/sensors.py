"""Sensors of a running gear: readings with noise, bias, resolution, period, dropouts and age, and the way of a command.

Noise is counter-based: a function of run, signal and millisecond, so it is the same on every executor and processor.
The paper names lateral position and yaw difficult or costly to measure; its own loop measures them exactly.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import casadi as ca
import numpy as np

from railrepro import data, paths
from railrepro.clock import CONTROL_PERIOD
from railrepro.vehicle.parameters import Parameter, loaded

LONGEST = 20
"""Longest latency that the delay lines hold (control cycles)."""
SIGNALS = ("y_ahead", "y_behind", "psidot_Ax", "w_le", "w_ri", "v", "p")
"""Readings of a gear (SI): displacement against the rails in two planes, absolute yaw rate, wheel speeds, speed and
position along the track."""
_GROUP = dict(
    zip(SIGNALS, ("lateral", "lateral", "gyro", "wheel_speed", "wheel_speed", "speed", "position"), strict=True)
)
_READ = ("noise", "bias", "resolution", "period", "dropout")
_MODULUS = 67108859.0
"""Largest prime below 2^26: squares of smaller whole numbers are exact in double precision."""


def _upto(high: float, unit: str) -> Parameter:
    return Parameter(0.0, high, unit, closed=True)


_PERIOD = Annotated[float, _upto(0.1, "s")]
_DROPOUT = Annotated[float, _upto(0.9, "-")]


@data.table
class Lateral:
    """Displacement of the axle against the rails in planes `base` apart."""

    base: Annotated[float, Parameter(0.1, 5.0, "m")]
    noise: Annotated[float, _upto(0.01, "m")]
    bias: Annotated[float, _upto(0.01, "m")]
    resolution: Annotated[float, _upto(0.001, "m")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Rate:
    """Angular velocity: the gyroscope of the carrier, or the speed of a wheel.

    Its range refuses numbers in degrees per second.
    """

    noise: Annotated[float, _upto(0.1, "rad/s")]
    bias: Annotated[float, _upto(0.1, "rad/s")]
    resolution: Annotated[float, _upto(0.1, "rad/s")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Speed:
    """Speed along the track."""

    noise: Annotated[float, _upto(1.0, "m/s")]
    bias: Annotated[float, _upto(1.0, "m/s")]
    resolution: Annotated[float, _upto(0.1, "m/s")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Position:
    """Position along the track, reported for the present moment."""

    noise: Annotated[float, _upto(1.0, "m")]
    bias: Annotated[float, _upto(20.0, "m")]
    resolution: Annotated[float, _upto(1.0, "m")]
    period: _PERIOD
    dropout: _DROPOUT


@data.table
class Latency:
    """Age of the readings and time from a command to the inverter."""

    measurement: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]
    command: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]


@data.table
class Inverter:
    """What becomes of a command that arrived, unknown to controllers and filter: a further delay, and a gain."""

    delay: Annotated[float, _upto(LONGEST * CONTROL_PERIOD, "s")]
    gain: Annotated[float, Parameter(0.0, 10.0, "-")]


@data.table
class Filter:
    """Process noise of the filter as spectral densities, and lags of what it hands on, see `observers`."""

    force_rate: Annotated[float, _upto(1e7, "N/s^0.5")]
    creep_rate: Annotated[float, _upto(1.0, "rad/s^0.5")]
    yaw_acceleration: Annotated[float, _upto(100.0, "rad/s^1.5")]
    gyro_drift: Annotated[float, _upto(1.0, "rad/s^1.5")]
    creep_lag: Annotated[float, _upto(10.0, "s")]
    speed_lag: Annotated[float, _upto(1.0, "s")]


@data.table
class Adhesion:
    """What the adhesion law needs behind noise, see `railrepro.control.adhesion.AdhesionSettings`."""

    filter_time: Annotated[float, _upto(1.0, "s")]
    dead_zone: Annotated[float, _upto(10.0, "1/s")]
    noise_speed: Annotated[float, _upto(200.0, "m/s")]


@data.table
class Loop:
    """All that stands between the car and its controllers; the numbers live in data/sensors.toml."""

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
        for group in dict.fromkeys(_GROUP.values()):
            ratio = getattr(self, group).period / CONTROL_PERIOD
            if ratio < 1 or abs(ratio - round(ratio)) > 1e-6:
                raise ValueError(
                    f"{group}.period is {1e3 * CONTROL_PERIOD * ratio:g} ms, a whole number of ms is needed"
                )

        total = self.latency.measurement + self.latency.command + self.inverter.delay
        if total > LONGEST * CONTROL_PERIOD + 1e-9:
            raise ValueError(f"latency of {1e3 * total:g} ms in all, at most {LONGEST} ms are held")

    def perfect(self) -> Loop:
        """Without noise, bias, rounding, dropouts and latency; the inverter stays as it is."""
        quiet = {
            group: replace(
                getattr(self, group), noise=0.0, bias=0.0, resolution=0.0, period=CONTROL_PERIOD, dropout=0.0
            )
            for group in dict.fromkeys(_GROUP.values())
        }
        return replace(self, **quiet, latency=Latency(0.0, 0.0), adhesion=Adhesion(5e-3, 1e-3, 0.0))


def load_loop(path: Path | str | None = None, **overrides) -> Loop:
    """Read and check the sensors.

    Parameters
    ----------
    path : path, optional
        A TOML file like data/sensors.toml, the default.
    overrides
        Values by dotted key, `load_loop(**{"gyro.noise": 0.002})` (SI units).

    Raises
    ------
    InputError
        One sentence naming file, key, what was found and what is allowed.
    """
    return loaded(Loop, data.location(path, paths.source("data/sensors.toml")), overrides)[0]


def readings(perfect: bool = False, seed: int = 0, **overrides) -> Readings:
    """Sensors of a run: those of `load_loop`, or perfect ones behind the same inverter."""
    data.require("sensors: perfect", perfect, bool)
    loop = load_loop(**overrides)
    return Readings(loop.perfect() if perfect else loop, seed)


@dataclass(frozen=True)
class Readings:
    """Numbers of the sensors in a run: what is constant in it is drawn from its seed.

    Attributes
    ----------
    loop : Loop
    seed : int
        Of the run; noise and biases of another seed are independent.
    """

    loop: Loop
    seed: int = 0

    def __post_init__(self) -> None:
        data.require("Readings: loop", self.loop, Loop)
        data.require("Readings: seed", self.seed, data.between(0, math.inf), whole=True)

    def gains(self, gear: int) -> dict[str, float]:
        """Run-time numbers of a gear (0 front, 1 rear) by name."""
        data.require("Readings: gear", gear, data.between(0, 1), whole=True)
        draw = np.random.default_rng((self.seed, gear))
        gains: dict[str, float] = {}
        for signal, group in _GROUP.items():
            settings = asdict(getattr(self.loop, group))
            settings["bias"] *= draw.uniform(-1.0, 1.0)
            gains |= {f"{signal}.{name}": settings[name] for name in _READ}
        delays = asdict(self.loop.latency) | {"unknown_delay": self.loop.inverter.delay}
        cycles = {name: value / CONTROL_PERIOD for name, value in delays.items()}
        constant = {"torque_gain": self.loop.inverter.gain, "base": self.loop.lateral.base}
        return gains | cycles | constant | {"seed": float(self.seed % 1_000_003)}


GAINS = (
    *(f"{signal}.{name}" for signal in SIGNALS for name in _READ),
    *("measurement", "command", "unknown_delay", "torque_gain", "seed", "base"),
)
"""Names of the run-time numbers of a gear."""
MEMORY = ("p.0", *(f"{s}.{k}" for s in (*SIGNALS, "tau_le", "tau_ri") if s != "p" for k in range(LONGEST + 1)))
"""Names of the delay lines of a gear, newest entry first; of the position only the last reading is needed."""


def sense(truth: dict, ticks, gear: int, gain: dict, memory: dict) -> tuple[dict, dict]:
    """Readings of a gear as they reach the controller.

    Parameters
    ----------
    truth : dict of SX
        Values of `SIGNALS` (SI).
    ticks : SX
        Control cycles since the start; on the first one the delay lines are filled with its readings.
    gear : int
    gain, memory : dict of SX
        By the names of `GAINS` and `MEMORY`.

    Returns
    -------
    readings : dict of SX
        By `SIGNALS`.
    kept : dict of SX
        Next memory.
    """
    readings, stored = {}, {}
    for i, signal in enumerate(SIGNALS):
        noisy = truth[signal] + gain[f"{signal}.bias"]
        noisy += gain[f"{signal}.noise"] * gaussian(gain["seed"], len(SIGNALS) * gear + i, ticks)
        step = gain[f"{signal}.resolution"]
        coarse = ca.if_else(step > 0, step * ca.floor(noisy / ca.fmax(step, 1e-12) + 0.5), noisy)
        due = ca.floor(ticks * CONTROL_PERIOD / gain[f"{signal}.period"] + 1e-6)
        before = ca.floor((ticks - 1) * CONTROL_PERIOD / gain[f"{signal}.period"] + 1e-6)
        chance = uniform(gain["seed"], 2 * (2 * len(SIGNALS) + len(SIGNALS) * gear + i), ticks)
        lost = chance < gain[f"{signal}.dropout"]
        fresh = ca.logic_or(ticks < 0.5, ca.logic_and(due > before, ca.logic_not(lost)))
        newest = ca.if_else(fresh, coarse, memory[f"{signal}.0"])
        if signal == "p":
            readings[signal], stored[f"{signal}.0"] = newest, newest
            continue
        line = [newest, *(ca.if_else(ticks < 0.5, newest, memory[f"{signal}.{k}"]) for k in range(LONGEST))]
        readings[signal] = late(line, gain["measurement"])
        stored |= {f"{signal}.{k}": value for k, value in enumerate(line)}
    return readings, stored


def sent(torque, signal: str, memory: dict) -> list:
    """Line of a wheel's commands (N m) with that of this cycle as its newest."""
    return [torque, *(memory[f"{signal}.{k}"] for k in range(LONGEST))]


def late(line: list, cycles):
    """Entry of a delay line (newest first) that is some control cycles old, linear in between."""
    return sum(ca.fmax(0, 1 - ca.fabs(cycles - k)) * value for k, value in enumerate(line))


def arriving(line: list, gain: dict):
    """Torque that a motor is commanded in this control cycle (N m), from the line of its commands."""
    return gain["torque_gain"] * late(line, gain["command"] + gain["unknown_delay"])


def gaussian(seed, channel: int, ticks):
    """Noise of zero mean and unit variance: the sum of four uniform numbers.

    Exact operations, hence the same bits on every processor.
    """
    total = 0.0
    for k in range(2):
        x = _hashed(seed, 2 * channel + k, ticks)
        high = ca.floor(x / 8192.0)
        total += (x - 8192.0 * high) / 8192.0 + high / 8192.0 - 1.0
    return np.sqrt(3.0) * total


def uniform(seed, channel: int, ticks):
    """Number between 0 and 1, another one in each cycle; `channel` counts on from those of `gaussian`, twice."""
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
