r"""LQG with preview, a controller of this project without counterpart in the paper: its design; its sample is `lqg.c`.

The model is that of `railrepro.own.gear_model`. Side force and yaw moment that it does not know are random walks. The
rails lie beside the track as white noise through the spectrum of ERRI B176 over the distance,

    S(Omega) = A Omega_c^2 / ((Omega^2 + Omega_r^2) (Omega^2 + Omega_c^2)).

Readings have the noise of the sensors; the read yaw angle and yaw rate have biases that drift. There are two designs,
for ideal and for rough rails. Each has a Kalman filter and a regulator; the likelihood of what both filters expected of
the readings weighs their torques. With the displacement y_k from the set point over the rails and the torque du_k,

    sum_k  y_k^2 + rho (du_k - du_(k-1))^2

is minimised over an infinite horizon; the way ahead is known over a preview and constant behind it. The rear gear knows
the rails that the front gear found, by a smoother of fixed lag.

Source: Anderson and Moore 1990, Optimal Control, ch. 2, 4 and 8; Anderson and Moore 1979, Optimal Filtering, ch. 7
(smoothing) and 10 (several models).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.linalg import expm

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.data import between, check_fields, require
from railrepro.estimation.sensors import Loop
from railrepro.model.forecast import nominal_values
from railrepro.own.gear_model import KNOWN, STATES, UNITS, UNKNOWN, bend, discrete, lateral_model
from railrepro.track.route import CELL, INDEX, Route
from railrepro.vehicle.parameters import Vehicle

SPEEDS = 1.5 * np.exp(0.1 * np.arange(46))
"""Speeds of the designs (m/s); below the first the torque is held."""
LEAST_NOISE = 1e-6, 1e-6, 1e-5
"""Noise of y (m), psi (rad) and r (rad/s) at least, which perfect measurements are believed to have."""
TAP, LAG, LAGS = 0.02, 4e-3, 20
"""Time between points of the preview and between lags of the smoother (s), and number of the latter."""
_SHORT, _LONG = 0.8246, 0.0206
"""Omega_c and Omega_r of the spectrum (rad/m)."""
_SMOOTH = 1e-12
"""Amplitude A of ideal rails (m rad), which keeps equations regular."""
_LEAK = 1 / 30
"""Rate at which walks return to zero (1/s): slower than any run, but they are stable."""
_PITCH, _LOST = 0.25, 5e-3
"""Pitch of the table of the rails, and distance of the filters from the reading at which they begin anew (m)."""
_N, _RAIL, _RATE, _MODEL, _FREE = len(STATES), *(len(STATES) + k for k in (2, 3, 4, 6))
"""Number of states of the gear; with unknown force and moment, rails and their rate; with both biases."""


@dataclass(frozen=True)
class LqgSettings:
    """Constants of the design; `11_lqg` derives them."""

    change: Annotated[float, between(1e-13, 1e-3, "m2/(N m)2")] = 1e-8
    """Weight rho of a change of torque per millisecond on ideal rails."""
    change_rough: Annotated[float, between(1e-13, 1e-3, "m2/(N m)2")] = 2e-9
    """The same on rough rails."""
    force: Annotated[float, between(1.0, 1e8, "N")] = 1e5
    """Random walk of the side force, standard deviation after one second."""
    moment: Annotated[float, between(1.0, 1e8, "N m")] = 5e3
    """The same of the yaw moment."""
    twist: Annotated[float, between(0.0, 1e7, "N m/s^0.5")] = 2e5
    """White noise of the motor torque that the filters believe in, which buys margins."""
    rails: Annotated[float, between(1e-12, 1e-4, "m rad")] = 5e-8
    """Amplitude A of rough rails."""
    settle: Annotated[float, between(0.01, 100.0, "s")] = 3.0
    """Time constant with which biases drift."""
    memory: Annotated[float, between(0.01, 100.0, "s")] = 0.5
    """Time over which the likelihood of readings counts."""
    preview: Annotated[float, between(0.02, 5.0, "s")] = 0.6
    """Time over which the way ahead is known."""

    def __post_init__(self) -> None:
        check_fields(self)


class Design:
    """Filters and regulators of a gear at a speed (m/s); without sensors (`loop` None) rails cannot be told from y.

    Attributes
    ----------
    a, last, before, e : ndarray, shapes (14, 14), (14,), (14,), (14, 9)
        States of the gear, force, moment, rails (m) and their rate (m/s) after a period: from themselves, the torque
        that acts last, the one before it, and known inputs.
    whole, sent : int
        Whole periods from reading to torque, and how many torques are under way or act, at least one.
    kinds : tuple
        rho and A of both designs.
    """

    def __init__(self, vehicle: Vehicle, speed: float, settings: LqgSettings, loop: Loop | None):
        self.speed, self.settings, h = speed, settings, CONTROL_PERIOD
        self.delay = 0.0 if loop is None else loop.latency.measurement + loop.latency.command + h
        periods = round(self.delay / h, 3)  # whole ones in spite of rounding
        self.whole, rest = int(periods), periods - int(periods)
        self.sent = max(self.whole + (rest > 0), 1)
        ideal = settings.change, _SMOOTH
        self.kinds = (ideal, ideal) if loop is None else (ideal, (settings.change_rough, settings.rails))
        self.noise, self.drift = _errors(loop, settings)
        a, b, e, d = lateral_model(vehicle, speed)
        rails = [KNOWN.index(name) for name in ("rail_offset", "rail_rate")]
        low, high = speed * _LONG, speed * _SHORT
        self.rates = np.zeros((_MODEL, _MODEL))
        self.rates[:_N] = np.hstack([a, d, e[:, rails]])
        self.rates[_N:_RAIL, _N:_RAIL] = -_LEAK * np.eye(len(UNKNOWN))
        self.rates[_RAIL, _RATE], self.rates[_RATE, _RAIL:] = 1.0, (-low * high, -low - high)
        inputs = np.zeros((_MODEL, 1 + len(KNOWN)))
        inputs[:_N] = np.column_stack([b, e])
        self.a, held = discrete(self.rates, inputs, h)
        self.last = discrete(self.rates, inputs, (1 - rest) * h)[1][:, 0]
        self.before, self.e = held[:, 0] - self.last, held[:, 1:]
        self._units = np.array([*UNITS, settings.force, settings.moment, 1e-3, 1e-3 * speed])

    def kalman(self, rough: float) -> tuple[np.ndarray, ...]:
        """Gain (16, 3) from readings y, psi, r to states and biases of psi and r, for rails of amplitude A; covariance
        (3, 3) of the innovation; gain (LAGS, 2, 3) to offset and direction of the rails some lags ago."""
        s, h, drive = self.settings, CONTROL_PERIOD, np.zeros((_MODEL, 4))
        drive[_N, 0], drive[_N + 1, 1], drive[STATES.index("tau"), 2] = s.force, s.moment, s.twist
        drive[_RATE, 3] = np.sqrt(np.pi * rough * _SHORT**2 * self.speed**3)
        both = expm(h * np.block([[-self.rates, drive @ drive.T], [np.zeros_like(self.rates), self.rates.T]]))
        a, q, read = np.eye(_FREE), np.zeros((_FREE, _FREE)), np.zeros((3, _FREE))
        a[:_MODEL, :_MODEL], q[:_MODEL, :_MODEL] = self.a, self.a @ both[:_MODEL, _MODEL:]  # Van Loan 1978
        q[np.diag_indices(_MODEL)] += 1e-13  # no state is certain, which keeps the equation regular
        q[[-2, -1], [-2, -1]] = h * self.drift**2
        read[0, [STATES.index("y"), _RAIL]] = 1, -1
        read[1, [STATES.index("psi"), _RATE, _MODEL]] = 1, -1 / self.speed, 1
        read[2, [STATES.index("r"), _MODEL + 1]] = 1, 1
        p = riccati(a.T, (read / self.noise[:, None]).T, (q + q.T) / 2, 1 / np.append(self._units, [1e-4, 1e-3]))
        covariance = read @ p @ read.T + np.diag(self.noise**2)
        towards = read.T @ np.linalg.inv(covariance)
        gain, smoother = p @ towards, np.empty((LAGS, 2, 3))
        back = np.linalg.matrix_power(a @ (np.eye(_FREE) - gain @ read), round(LAG / h)).T
        for row in smoother:
            row[:] = (p @ towards)[_RAIL : _RATE + 1] / [[1.0], [self.speed]]
            towards = back @ towards
        return gain, covariance, smoother

    def regulator(self, change: float) -> tuple[np.ndarray, np.ndarray]:
        """Factors of a change of torque for a weight rho: of the states and the torques sent, last first,
        shape (14 + sent,); of known inputs and set point ahead, shape (taps, 9 + 1)."""
        n, h = _MODEL + self.sent, CONTROL_PERIOD
        a, b, error = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        a[:_MODEL, :_MODEL], a[_MODEL, _MODEL], b[_MODEL] = self.a, 1.0, 1.0
        a[_MODEL + 1 :, _MODEL:-1] = np.eye(self.sent - 1)
        for age, column in ((self.whole, self.last), (self.whole + 1, self.before)):
            if age == 0:  # the torque that is chosen now acts at once: the last one and its change
                a[:_MODEL, _MODEL] += column
                b[:_MODEL] += column
            elif age <= self.sent:
                a[:_MODEL, _MODEL + age - 1] += column
        error[STATES.index("y")], error[_RAIL] = 1.0, -1.0
        units = np.append(self._units, np.full(self.sent, 100.0))
        p = riccati(a, b[:, None] / np.sqrt(change), np.outer(error, error), units)
        size = change + b @ p @ b
        feedback = b @ p @ a / size
        closed = (a - np.outer(b, feedback)).T
        rows = np.empty((round(self.settings.preview / h) + 1, n))
        rows[0] = b / size
        for k in range(1, len(rows)):
            rows[k] = rows[k - 1] @ closed
        rows[-1] = np.linalg.solve((np.eye(n) - closed).T, rows[-1])  # the last input stands for all that follow
        times, taps = h * np.arange(len(rows)), round(self.settings.preview / TAP) + 1
        known, point = -rows @ p[:, :_MODEL] @ self.e, (rows @ error)[:, None]
        return -feedback, np.hstack([_on_taps(times + h / 2, known, taps), _on_taps(times + h, point, taps)])

    def table(self) -> np.ndarray:
        """All numbers in the order of `lqg_design_t` of lqg.c."""
        parts = [self.a, self.last, self.before, self.e]
        for change, rough in self.kinds:
            gain, covariance, smoother = self.kalman(rough)
            size = np.array([np.linalg.slogdet(covariance)[1]])
            parts += [gain, np.linalg.inv(covariance), size, *self.regulator(change)]
        return np.concatenate([part.ravel() for part in (*parts, smoother)])


def _errors(loop: Loop | None, settings: LqgSettings) -> tuple[np.ndarray, np.ndarray]:
    """Noise of the readings y (m), psi (rad), r (rad/s), and drift of the biases of psi and r (per s^0.5).

    Two planes make y and psi; a bias is drawn uniformly, and drifts as a Gauss-Markov process of that variance.
    """
    if loop is None:
        return np.array(LEAST_NOISE), np.full(2, 1e-9)
    plane, of_psi = loop.lateral, np.sqrt(2) / loop.lateral.base
    noise = plane.noise / np.sqrt(2), plane.noise * of_psi, loop.gyro.noise
    biases = np.array([plane.bias * of_psi, loop.gyro.bias]) / np.sqrt(3)
    return np.maximum(noise, LEAST_NOISE), np.maximum(biases * np.sqrt(2 / settings.settle), 1e-9)


def _on_taps(times: np.ndarray, factors: np.ndarray, taps: int) -> np.ndarray:
    """Factors at times (s) shared by the points of the preview before and after, so that in between it is linear."""
    place = np.minimum(times / TAP, taps - 1.000001)
    low, found = place.astype(int), np.zeros((taps, factors.shape[1]))
    np.add.at(found, low, (1 - place + low)[:, None] * factors)
    np.add.at(found, low + 1, (place - low)[:, None] * factors)
    return found


def riccati(a: np.ndarray, b: np.ndarray, q: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Stabilising solution of the discrete Riccati equation with unit weight of the input, by doubling, found with the
    states in their units.

    Source: Chu, Fan, Lin and Wang 2004, International Journal of Control 77, algorithm SDA.
    """
    a, b, p = a * units / units[:, None], b / units[:, None], q * np.outer(units, units)
    g, one = b @ b.T, np.eye(len(a))
    for _ in range(40):
        solved = np.linalg.solve(one + g @ p, np.hstack([a, g]))
        after, through = solved[:, : len(a)], solved[:, len(a) :]
        more = a.T @ p @ after
        g, p, a = g + a @ through @ a.T, p + (more + more.T) / 2, a @ after
        g = (g + g.T) / 2
        if np.abs(more).max() < 1e-13 * np.abs(p).max():
            break
    return p / np.outer(units, units)


_DESIGNED: dict[tuple, np.ndarray] = {}


def designs(vehicle: Vehicle, settings: LqgSettings, loop: Loop | None) -> np.ndarray:
    """Designs at all `SPEEDS`, one row each; those of an earlier gear or run where they are the same."""
    first = Design(vehicle, SPEEDS[0], settings, loop)
    key = repr(vehicle), settings, first.delay, *first.noise, *first.drift
    if key not in _DESIGNED:
        _DESIGNED.clear()  # one vehicle at a time
        _DESIGNED[key] = np.array([Design(vehicle, v, settings, loop).table() for v in SPEEDS])
    return _DESIGNED[key]


_WHOLE = ("speeds", "design", "sent", "taps", "whole", "cells", "width", "bends", "rows")
_REAL: tuple[str, ...] = (
    "least_speed",
    "log_step",
    "behind",
    "period",
    "tap",
    "lag",
    "torque_limit",
    "acceleration",
    "gravity",
    "base",
)
_REAL += ("partner", "lost", "memory", "start", "cell", "bend_start", "bend_pitch", "pitch")
_TABLES = ("designs", "route", "bend")


class _Gear(ctypes.Structure):
    """`lqg_t` of lqg.c."""

    _fields_ = [
        *((name, ctypes.c_longlong) for name in _WHOLE),
        *((name, ctypes.c_double) for name in _REAL),
        *((name, ctypes.c_void_p) for name in (*_TABLES, "rails", "torques", "follower")),
        *((name, n * ctypes.c_double) for name, n in (("state", 2 * _FREE), ("weight", 2), ("share", 2))),
        *(("surprise", 3 * ctypes.c_double), ("known_until", ctypes.c_double)),
        *((name, ctypes.c_longlong) for name in ("started", "restarts")),
    ]


def source() -> str:
    """C source of a sample; starts after call.h."""
    columns = "".join(f"#define AT_{name} {i}\n" for name, i in INDEX.items())
    return columns + Path(__file__).with_name("lqg.c").read_text()


@lru_cache
def _library() -> ctypes.CDLL:
    return codegen.library((), Path(codegen.__file__).with_name("call.h").read_text() + source())


class LqgGear:
    """The controller of one gear, see `railrepro.control.lateral.CompiledController`."""

    period = CONTROL_PERIOD

    def __init__(self, vehicle: Vehicle, route: Route, gear: int, settings: LqgSettings):
        self.vehicle, self.route, self.gear, self.settings = vehicle, route, gear, settings

    def numbers(self, loop: Loop | None) -> tuple[dict[str, float], dict[str, np.ndarray]]:
        """Numbers of `lqg_t` by name, and its tables; rails and torques are memory."""
        s, vehicle, table = self.settings, self.vehicle, designs(self.vehicle, self.settings, loop)
        first, (at, bent), cells = Design(vehicle, SPEEDS[0], s, loop), bend(vehicle), self.route.cells
        acceleration, partner, _ = nominal_values(vehicle, self.gear)
        rows = round(len(cells) * CELL / _PITCH)
        taps = round(s.preview / TAP) + 1
        whole = len(table), table.shape[1], first.sent, taps, first.whole, *cells.shape, len(at), rows
        real = (
            *(SPEEDS[0], np.log(SPEEDS[1] / SPEEDS[0]), max(first.delay - CONTROL_PERIOD, 0.0)),
            *(CONTROL_PERIOD, TAP, LAG),
            *(vehicle.drive.torque_limit, acceleration, vehicle.gravity, vehicle.gear.contact_base, partner, _LOST),
            *(s.memory, self.route.start, CELL, at[0], at[1] - at[0], _PITCH),
        )  # fmt: skip
        memory = {"rails": np.zeros((rows, 2)), "torques": np.zeros(first.sent + 2)}
        tables = dict(zip(_TABLES, map(np.ascontiguousarray, (table, cells, bent.T)), strict=True)) | memory
        return dict(zip(_WHOLE, whole, strict=True)) | dict(zip(_REAL, map(float, real), strict=True)), tables

    def compiled(self, loop: Loop | None, leader: LqgGear | None = None) -> tuple[int, int]:
        """Addresses of the function and of its memory, for sensors or none; the leader is the gear in front."""
        numbers, self.tables = self.numbers(loop)
        self.memory = _Gear(**numbers, **{name: table.ctypes.data for name, table in self.tables.items()})
        self.memory.known_until = self.route.start
        if leader is not None:
            leader.memory.follower = ctypes.addressof(self.memory)
        return ctypes.cast(_library().lqg_sample, ctypes.c_void_p).value or 0, ctypes.addressof(self.memory)

    def exported(self, gears: Sequence[LqgGear], loop: Loop | None) -> str:
        """C source of the controllers of all gears for `railrepro.export.controller`."""
        (numbers, tables), *_ = found = [gear.numbers(loop) for gear in gears]
        rows = (", ".join(f"{value!r}" for value in of_gear.values()) for of_gear, _ in found)
        text = source() + f"static const lqg_t LQG_GEARS[] = {{{', '.join(f'{{{row}}}' for row in rows)}}};\n"
        for name in ("designs", "bend"):
            values = ",".join(float(value).hex() for value in tables[name].ravel())
            text += f"static const double LQG_{name.upper()}[] = {{{values}}};\n"
        text += f"enum {{ LQG_ROWS = {numbers['rows']}, LQG_TORQUES = {tables['torques'].size} }};\n"
        return text + Path(__file__).with_name("lqg_export.c").read_text()


@dataclass(frozen=True)
class LqgPreview:
    """Factory of the controllers of both gears, for `railrepro.simulation.simulate.run`; picklable."""

    settings: LqgSettings = field(default_factory=LqgSettings)

    def __post_init__(self) -> None:
        require("LqgPreview: settings", self.settings, LqgSettings)

    def __call__(self, vehicle: Vehicle, route: Route, gear: int) -> LqgGear:
        """The controller of a gear (0 front, 1 rear)."""
        return LqgGear(vehicle, route, gear, self.settings)
