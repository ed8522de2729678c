r"""LQG with preview, a controller of this project without counterpart in the paper. `lqg.c` is its control cycle.

The model is `gear_model` with random walks of the unknown side force and yaw moment. The lateral offset of the rails is
white noise through the spectrum of ERRI B176 over the distance,

    S(Omega) = A Omega_c^2 / ((Omega^2 + Omega_r^2) (Omega^2 + Omega_c^2)).

Readings have the noise of the sensors, and the measured yaw angle and yaw rate have biases that drift. The states of
two Kalman filters, one for ideal and one for rough rails, are weighted by the likelihood of their innovations. The
regulator minimises, over an infinite horizon at the speed v,

    sum_k  y_k^2 + q^2 v / (100 m/s) r_k^2 + rho (du_k - du_(k-1))^2

with the displacement y_k from the set point over the rails, the yaw rate r_k against the track and the torque du_k. The
track ahead is known over a preview and constant beyond it. The weight q damps without an offset, because no steady
state has a yaw rate. The rear gear gets the rails from a fixed-lag smoother of the front gear. Source: Anderson and
Moore 1990, Optimal Control, ch. 2, 4 and 8; 1979, Optimal Filtering, ch. 7 (smoothing) and 10 (several models).
"""

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.linalg import expm
from scipy.signal import cont2discrete

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import lateral
from railrepro.data import between, table
from railrepro.estimation.sensors import Loop
from railrepro.model.forecast import nominal_values
from railrepro.own.gear_model import KNOWN, STATES, UNITS, UNKNOWN, lateral_model
from railrepro.track.route import CELL, COLUMNS, INDEX, Route
from railrepro.vehicle.parameters import Vehicle

SPEEDS = 1.5 * np.exp(0.1 * np.arange(46))
"""Speeds for which filters and regulators are designed (m/s), shape (46,); below the first the torque is held."""
TAP, LAG, LAGS, PITCH = 0.02, 4e-3, 20, 0.25
"""Time between points of the preview, time between lags of the smoother (s), their number, pitch of the rails (m)."""
_SHORT, _LONG = 0.8246, 0.0206  # Omega_c and Omega_r of the spectrum (rad/m)
_SMOOTH = 1e-12  # Amplitude A of ideal rails (m rad); above 0, so that equations are regular
_LEAK = 1 / 30  # Rate at which random walks return to zero (1/s): slower than any run, but stable
_N, _RAIL, _RATE, _MODEL, _FREE = len(STATES), *(len(STATES) + k for k in (2, 3, 4, 6))
"""Number of states of the gear; indices of rail offset and its rate; numbers of states without and with biases."""


class Design:
    """Kalman filters and regulator of a gear at one `speed` (m/s), in steps of 1 ms, for the `vehicle` that the
    controller assumes. One filter assumes ideal rails, the other rough ones; a run weights them by how well they
    predict the readings. Without sensors (`loop`, their errors and delays, is None) both assume ideal rails.

    Attributes:
        a, b, e (ndarray, shapes (10, 10), (10,), (10, 7)): Model over 1 ms, x+ = a x + b du + e known. x has the six
            states `gear_model.STATES` (displacement y to torque tau), unknown force and moment, lateral offset of the
            rails (m) beyond the known one, its rate (m/s). known has, of the track: lateral acceleration by cant and
            curve (m/s2), yaw acceleration (rad/s2), roll rate (rad/s), heading against the car body (rad), its rate
            (rad/s); known offset of the rails (m), its rate (m/s).
        delay (int): Time from a reading to the torque (ms); 0 without sensors.
        sent (int): Number of last torques that the regulator knows, on their way to the motor or acting: max(delay, 1).
        rails (tuple of float): Amplitude A of the rail spectrum in both filters (m rad).
        read (ndarray, shape (3, 12)): Maps x and the biases of psi and r to the readings of y, psi and r.
        noise, drift (ndarray, shapes (3,), (2,)): Standard deviations of the readings; random walk of the two biases
            (rad/s^0.5, rad/s^1.5).
    """

    def __init__(self, vehicle: Vehicle, speed: float, settings: "LqgPreview", loop: Loop | None):
        self.speed, self.settings, h = speed, settings, CONTROL_PERIOD
        self.delay = 0 if loop is None else 1 + round((loop.latency.measurement + loop.latency.command) / h)
        self.sent = max(self.delay, 1)
        self.rails = _SMOOTH, _SMOOTH if loop is None else settings.rails
        self.noise, self.drift = np.array([1e-6, 1e-6, 1e-5]), np.full(2, 1e-9)  # least ones, for regular equations
        if loop is not None:  # a bias drifts with the variance with which it is drawn
            noise, biases = loop.lateral_errors()
            self.noise = np.maximum(self.noise, noise)
            self.drift = np.maximum(self.drift, biases[1:] * np.sqrt(2 / settings.settle))
        a, b, e, d = lateral_model(vehicle, speed)
        rails = [KNOWN.index(name) for name in ("rail_offset", "rail_rate")]
        low, high = speed * _LONG, speed * _SHORT
        self.rates = np.zeros((_MODEL, _MODEL))
        self.rates[:_N] = np.hstack([a, d, e[:, rails]])
        self.rates[_N:_RAIL, _N:_RAIL] = -_LEAK * np.eye(len(UNKNOWN))
        self.rates[_RAIL, _RATE], self.rates[_RATE, _RAIL:] = 1.0, (-low * high, -low - high)
        inputs = np.zeros((_MODEL, 1 + len(KNOWN)))
        inputs[:_N] = np.column_stack([b, e])
        outputs = np.zeros((1, _MODEL)), np.zeros((1, 1 + len(KNOWN)))
        self.a, held, *_ = cont2discrete((self.rates, inputs, *outputs), h)
        self.b, self.e = held[:, 0], held[:, 1:]
        self.read = np.zeros((3, _FREE))
        self.read[0, [STATES.index("y"), _RAIL]] = 1, -1
        self.read[1, [STATES.index("psi"), _RATE, _MODEL]] = 1, -1 / speed, 1
        self.read[2, [STATES.index("r"), _MODEL + 1]] = 1, 1
        self._units = np.array([*UNITS, settings.force, settings.moment, 1e-3, 1e-3 * speed])

    def kalman(self, rough: float) -> tuple[np.ndarray, ...]:
        """Design the stationary Kalman filter for rails of amplitude A = `rough` (m rad). Returns the gain (12, 3) from
        the innovation of y, psi, r to x and the two biases; the covariance (3, 3) of the innovation; and the smoother
        (LAGS, 2, 3), whose row k is the gain to the rail offset (m) and direction (rad) k times `LAG` ago."""
        s, h, read, drive = self.settings, CONTROL_PERIOD, self.read, np.zeros((_MODEL, 4))
        drive[_N, 0], drive[_N + 1, 1], drive[STATES.index("tau"), 2] = s.force, s.moment, s.twist
        drive[_RATE, 3] = np.sqrt(np.pi * rough * _SHORT**2 * self.speed**3)
        both = expm(h * np.block([[-self.rates, drive @ drive.T], [np.zeros_like(self.rates), self.rates.T]]))
        a, q = np.eye(_FREE), np.zeros((_FREE, _FREE))
        a[:_MODEL, :_MODEL], q[:_MODEL, :_MODEL] = self.a, self.a @ both[:_MODEL, _MODEL:]  # Van Loan 1978
        q[np.diag_indices(_MODEL)] += 1e-13  # no state is certain, which keeps the equation regular
        q[[-2, -1], [-2, -1]] = h * self.drift**2
        p = riccati(a.T, (read / self.noise[:, None]).T, (q + q.T) / 2, 1 / np.append(self._units, [1e-4, 1e-3]))
        covariance = read @ p @ read.T + np.diag(self.noise**2)
        towards = read.T @ np.linalg.inv(covariance)
        gain, smoother = p @ towards, np.empty((LAGS, 2, 3))
        back = np.linalg.matrix_power(a @ (np.eye(_FREE) - gain @ read), round(LAG / h)).T
        for row in smoother:
            row[:] = (p @ towards)[_RAIL : _RATE + 1] / [[1.0], [self.speed]]
            towards = back @ towards
        return gain, covariance, smoother

    def regulator(self) -> tuple[np.ndarray, np.ndarray]:
        """Design the LQ regulator: it sets the change d of the torque per ms (N m) and minimises, summed over all ms,
        y^2 + turn^2 (speed / (100 m/s)) r^2 + change d^2 (m2). y is the displacement from the irregular rails minus set
        point (m), r the yaw rate (rad/s); `LqgPreview` has turn and change. Returns gains of d: (10 + sent,) for x,
        then torques sent, latest first; (points, 8) for known (7) and set point at points `TAP` (s) apart."""
        n, h = _MODEL + self.sent, CONTROL_PERIOD
        a, b, error = np.zeros((n, n)), np.zeros(n), np.zeros(n)
        a[:_MODEL, :_MODEL], a[_MODEL, _MODEL], b[_MODEL] = self.a, 1.0, 1.0
        a[_MODEL + 1 :, _MODEL:-1] = np.eye(self.sent - 1)
        a[:_MODEL, _MODEL + max(self.delay - 1, 0)] = self.b
        if self.delay == 0:  # the torque that is chosen now acts at once: the last one and its change
            b[:_MODEL] = self.b
        error[STATES.index("y")], error[_RAIL] = 1.0, -1.0
        units = np.append(self._units, np.full(self.sent, 100.0))
        weights = np.outer(error, error)
        weights[STATES.index("r"), STATES.index("r")] = self.settings.turn**2 * self.speed / 100
        p = riccati(a, b[:, None] / np.sqrt(self.settings.change), weights, units)
        size = self.settings.change + b @ p @ b
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
        """All numbers of the design as a vector, in the order of the struct `lqg_design_t` in lqg.c."""
        parts = [self.a, self.b, self.e, *self.regulator()]
        for rough in self.rails:
            gain, covariance, smoother = self.kalman(rough)
            parts += [gain, np.linalg.inv(covariance), np.array([np.linalg.slogdet(covariance)[1]])]
        return np.concatenate([part.ravel() for part in (*parts, smoother)])


def _on_taps(times: np.ndarray, factors: np.ndarray, taps: int) -> np.ndarray:
    """Distribute factors at times (s) to the points of the preview before and after, for linear interpolation."""
    positions = np.minimum(times / TAP, taps - 1)
    return np.maximum(1 - np.abs(np.arange(taps)[:, None] - positions), 0) @ factors


def riccati(a: np.ndarray, b: np.ndarray, q: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Stabilising solution p (n, n) of the discrete algebraic Riccati equation, by doubling. The system is x+ = a x + b
    u with a (n, n), b (n, m), the cost x' q x + u' u. `units` (n,), usual magnitudes of the states, scale the equation.
    Source: Chu, Fan, Lin and Wang 2004, Int. J. Control 77, algorithm SDA."""
    a, b, p = a * units / units[:, None], b / units[:, None], q * np.outer(units, units)
    g, one = b @ b.T, np.eye(len(a))
    for _ in range(20):  # 2^20 periods
        solved = np.linalg.solve(one + g @ p, np.hstack([a, g]))
        after, through = solved[:, : len(a)], solved[:, len(a) :]
        more = a.T @ p @ after
        g, p, a = g + a @ through @ a.T, p + (more + more.T) / 2, a @ after
        g = (g + g.T) / 2
    return p / np.outer(units, units)


@lru_cache(maxsize=1)
def designs(vehicle: Vehicle, settings: "LqgPreview", loop: Loop | None) -> tuple[int, np.ndarray]:
    """Design filters and regulator of a gear at all `SPEEDS`. Returns the delay from reading to torque (ms), and an
    array (46, n) with all numbers of the design (`Design.table`) for each speed."""
    made = [Design(vehicle, speed, settings, loop) for speed in SPEEDS]
    return made[0].delay, np.array([design.table() for design in made])


_SOURCE = Path(__file__).with_suffix(".c").read_text(encoding="utf-8")


def _source(delay: int, taps: int) -> tuple[str, dict[str, int]]:
    """C source of a control cycle, to stand below call.h, and sizes of its arrays; arguments as of `library`."""
    sizes = {"MODEL": _MODEL, "FREE": _FREE, "RAIL": _RAIL, "BIAS": _MODEL, "KNOWN": len(KNOWN), "WIDTH": len(COLUMNS)}
    sizes |= {"SIGNALS": 3, "FILTERS": 2, "LAGS": LAGS, "TAPS": taps}
    sizes |= {"LATE": delay, "SENT": max(delay, 1), "TORQUES": max(delay, 1) + 1}
    columns = {f"AT_{name}": i for name, i in INDEX.items()} | {f"K_{name.upper()}": i for i, name in enumerate(KNOWN)}
    speeds = {"LEAST_SPEED": SPEEDS[0], "LOG_STEP": np.log(SPEEDS[1] / SPEEDS[0]), "PERIOD": CONTROL_PERIOD}
    defined = sizes | columns | speeds | {"TAP": TAP, "LAG": LAG, "PITCH": PITCH, "CELL": CELL}
    return codegen.defines(defined) + _SOURCE, sizes


@lru_cache
def library(delay: int, taps: int) -> tuple[ctypes.CDLL, Any]:
    """Compile lqg.c, the controller, for a delay from reading to torque (ms) and a number of points of the preview.
    Returns the loaded shared object, and the ctypes class of `lqg_t`, the struct with design and memory."""
    text, sizes = _source(delay, taps)
    loaded = codegen.library((), codegen.PREAMBLE + text)
    loaded.lqg_sample.restype = ctypes.c_double
    return loaded, codegen.structure("lqg_t", _SOURCE, sizes)


class LqgGear:
    """LQG controller with preview of one gear (0 front, 1 rear) in compiled C; `simulate.run` calls it once per ms."""

    period = CONTROL_PERIOD

    def __init__(self, vehicle: Vehicle, route: Route, gear: int, settings: "LqgPreview"):
        lateral.check_arguments("LqgPreview", vehicle, route, gear)
        self.vehicle, self.route, self.gear, self.settings = vehicle, route, gear, settings

    def compiled(self, loop: Loop | None, leader: object = None) -> tuple[int, int]:
        """Make the controller; returns the addresses of its C function and memory for `ClosedLoop.connect`. `loop`
        None: exact readings. A rear gear gets the rails that its `leader`, a front `LqgGear`, estimates."""
        (delay, table), vehicle, cells = designs(self.vehicle, self.settings, loop), self.vehicle, self.route.cells
        acceleration, partner, _ = nominal_values(vehicle, self.gear)
        self.sizes = delay, round(self.settings.preview / TAP) + 1
        self.library, of_gear = library(*self.sizes)
        rows = round(len(cells) * CELL / PITCH)
        self.tables = {"designs": table, "route": cells, "rails": np.zeros((rows, 2))}
        self.memory = of_gear(
            speeds=len(table),
            cells=len(cells),
            rows=rows,
            behind=max(delay - 1, 0) * CONTROL_PERIOD,
            torque_limit=vehicle.drive.torque_limit,
            acceleration=acceleration,
            gravity=vehicle.gravity,
            base=vehicle.gear.contact_base,
            partner=partner,
            memory=self.settings.memory,
            start=self.route.start,
            known_until=self.route.start,
            **{name: values.ctypes.data for name, values in self.tables.items()},
        )
        if isinstance(leader, LqgGear):
            leader.memory.follower = ctypes.addressof(self.memory)
        return ctypes.cast(self.library.lqg_sample, ctypes.c_void_p).value or 0, ctypes.addressof(self.memory)

    def exported(self, gears: Sequence["LqgGear"], loop: Loop | None) -> str:
        """C source for `export.Export`: controllers of the `gears` [front, rear], with the tables of their designs."""
        for gear in gears:
            gear.compiled(loop)
        memories = ", ".join(codegen.initialiser(gear.memory) for gear in gears)
        values = ",".join(float(value).hex() for value in self.tables["designs"].ravel())
        text = f"static const lqg_t LQG_GEARS[] = {{{memories}}};\nstatic const double LQG_DESIGNS[] = {{{values}}};\n"
        text += codegen.enumeration([f"LQG_ROWS = {len(self.tables['rails'])}"])
        return _source(*self.sizes)[0] + text + Path(__file__).with_name("lqg_export.c").read_text(encoding="utf-8")


@table
class LqgPreview:
    """Factory of LQG controllers with preview, as `guidance` of `simulate.run`. The weights of the regulator, `change`
    of squared torque change per ms and `turn` of the yaw rate at 100 m/s, are relative to y in metres. Of the Kalman
    filters are `force` and `moment` (unknown side force and yaw moment walk at random by these standard deviations in 1
    s), `twist` (white noise of the torque rate), `rails` (amplitude of rough ones), `settle` (the longer, the slower a
    bias may drift) and `memory` (the longer, the slower old readings are forgotten). The controller knows track and set
    point over the time `preview`. Notebook `12_lqg` derives the values."""

    change: Annotated[float, between(1e-13, 1e-3, "m2/(N m)2")] = 8e-10
    """Weight rho of the squared change of torque per millisecond, relative to that of y (m2/(N m)2)."""
    turn: Annotated[float, between(0.0, 10.0, "m s/rad")] = 0.082
    """Weight q of the yaw rate relative to that of y (m s/rad), at 100 m/s. It raises stability margins, and makes them
    about equal at all speeds by growing with the square root of the speed."""
    force: Annotated[float, between(1.0, 1e8, "N")] = 1e5
    """Standard deviation after one second of the random walk of the unknown side force (N)."""
    moment: Annotated[float, between(1.0, 1e8, "N m")] = 2e4
    """The same of the unknown yaw moment (N m)."""
    twist: Annotated[float, between(0.0, 1e7, "N m/s^0.5")] = 2e5
    """White noise that the filters assume in the rate of the motor torque (N m/s^0.5); it raises stability margins."""
    rails: Annotated[float, between(1e-12, 1e-4, "m rad")] = 5e-8
    """Amplitude A of the spectrum of rough rails (m rad)."""
    settle: Annotated[float, between(0.01, 100.0, "s")] = 3.0
    """Time (s) in which the random walk that models a bias gains twice the variance with which the bias is drawn."""
    memory: Annotated[float, between(0.01, 100.0, "s")] = 0.5
    """Time constant (s) with which the log-likelihoods of the filters forget old readings."""
    preview: Annotated[float, between(0.02, 5.0, "s")] = 0.6
    """Length of the preview of set point and track (s)."""

    def __call__(self, vehicle: Vehicle, route: Route, gear: int) -> LqgGear:
        """Make the controller of a gear (0 front, 1 rear)."""
        return LqgGear(vehicle, route, gear, self)
