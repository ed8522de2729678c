"""Predictive control of a running gear that knows creep: a slower controller with a filter of its own.

Where the paper's model predictive controllers optimise over a model that rolls without sliding, this one optimises over
`railrepro.own.creep_model`. Without active bounds the optimum is linear in states, disturbances and preview, so
its gains are scheduled over speed, used adhesion and slip; the torque limit cuts what they ask for, which the filter is
told.
A Kalman filter finds creepage, body motion and disturbances from displacement, yaw angle and yaw rate; the disturbances
make the controller free of steady error. With sensors the filter works on the readings themselves, with their age and
the way of the commands in its model, not on what the filter of the loop makes of them for models that roll. There the
front gear also measures how the rails lie, which is preview for the rear one.

No counterpart in the paper.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.table import contact_table
from railrepro.control.lateral import SlowController
from railrepro.control.mpc import Solve
from railrepro.data import InputError, require
from railrepro.model import control_model as model
from railrepro.model.forecast import nominal_values
from railrepro.own.creep_gains import ALERT, READ, CreepSettings, delay_of, schedule
from railrepro.own.creep_model import KNOWN, LEAST_SPEED, SHIFTS, STATES, UNKNOWN, Creep, creep_at, shifts
from railrepro.track.route import CELL, INDEX, Route
from railrepro.vehicle.parameters import Vehicle

_SLIP_LAG = 0.02
"""Time constant of the low-pass of measured adhesion and slip (s)."""
_FREE, _FREE_APART = 3e-3, 1e-2
"""Adhesion that base and differential torque may demand of a wheel that rolls on any rail (-). Under more demand a
wheel that slips on a poor rail looks like one of another radius."""
_RADIUS_LAG, _APART_LAG = 0.03, 0.3
"""Time constants in which the mean radius of wheels that roll is learnt, and their difference, which a profile changes
with the displacement (s)."""
_LOST = 5e-3
"""Distance between filter and reading of the displacement beyond which the filter begins anew (m)."""
_WHITE_LAG, _MEAN_LAG = 0.03, 0.15
"""Time constants of the low-pass that separates coloured innovations from white ones, and of its mean square (s)."""
_CALM, _AWAKE = 1.5, 2.5
"""Power of low-passed innovations over that of white ones up to which the filter is quiet, from which it is awake."""
_SETTLED = 2.0
"""Time that it takes from awake to quiet (s)."""
_GRID = 0.25
"""Pitch of the table of the preview (m)."""
_RAIL_LAG, _RAIL_FADE = 0.01, 0.3
"""Time constants of the band-pass through which a gear measures the direction of the rails (s)."""
_RAIL_NOISE = 1.2e-4
"""Direction of the rails that is taken for noise, root mean square (rad): readings make .5e-4 to 1.1e-4 of ideal rails,
rails of class B at 300 km/h have 2.3e-4."""
_RAIL_AHEAD = 100.0
"""Distance over which the rails are taken to stay as offset as where the front gear is (m)."""


@dataclass(frozen=True)
class CreepMPC:
    """Factory of the controllers of both gears, for `railrepro.simulation.simulate.run`; picklable.

    Attributes
    ----------
    settings : CreepSettings
    creep : Creep, optional
        Of wheels that hardly slip; default that of the vehicle on a dry rail. What they do when they slip is measured.

    Raises
    ------
    InputError
        When settings or creep are of another kind, or the creep has a used adhesion.
    """

    settings: CreepSettings = field(default_factory=CreepSettings)
    creep: Creep | None = None

    def __post_init__(self) -> None:
        require("CreepMPC: settings", self.settings, CreepSettings)
        if self.creep is not None:
            require("CreepMPC: creep", self.creep, Creep)
            if self.creep.adhesion:
                raise InputError(f"CreepMPC: creep.adhesion = {self.creep.adhesion!r}, 0 is needed, for it is measured")

    def __call__(self, vehicle: Vehicle, route: Route, gear: int) -> CreepGuide:
        """The controller of a gear (0 front, 1 rear)."""
        creep = creep_at(vehicle, "dry", 20.0) if self.creep is None else self.creep
        return CreepGuide(vehicle, route, gear, self.settings, creep)


class CreepGuide:
    """The controller of one gear, a `railrepro.control.lateral.SlowController`.

    Attributes
    ----------
    period : float
        Sampling time (s).
    state : ndarray, shape (13,)
        Filtered states of the creep model, disturbances, and bias of the yaw rate (SI).
    sent : ndarray
        Torques that are under way or act, the last one first (N m).
    missed : int
        Samples whose measurement was not finite, so that the filter went on without it.
    restarts : int
        How often the filter was so far off that it began anew.
    rails : ndarray or None
        Rows of the table of the gear behind into which the offset of the rails that this gear measures is written.
    stats : list of Solve
        One record per sample.
    """

    def __init__(self, vehicle: Vehicle, route: Route, gear: int, settings: CreepSettings, creep: Creep):
        self.period, self.missed, self.restarts = settings.period, 0, 0
        self.stats: list[Solve] = []
        self.state = np.zeros(len(STATES) + len(UNKNOWN) + 1)
        self._vehicle, self._settings, self._creep, self._started = vehicle, settings, creep, False
        self._acceleration, partner, _ = nominal_values(vehicle, gear)
        self._shifts = shifts(vehicle) if settings.uses_bend else lambda y: np.zeros((len(KNOWN[SHIFTS]), *y.shape))
        self._ahead, self._start = _table(route, partner, self._shifts), route.start
        self._times = self.period * np.append(0.0, np.arange(settings.steps + 1) + 0.5)
        self._load, self._offset, self._learnt, self._demanded = vehicle.wheel_load, np.zeros(2), 0, 0.0
        self._profile = _apparent_slip(vehicle)
        self._bounds = self._load * np.array([1.0, vehicle.gear.contact_base])
        self._seen, self._slip = np.zeros(len(model.STATES)), np.zeros((2, 2))
        self._slow, self._power, self._slow_power, self._alert = 0.0, 0.0, 0.0, 0.0
        self._read: np.ndarray | None = None
        self._uses = np.array([[settings.uses_adhesion], [settings.uses_slip]], dtype=float)
        self.rails: np.ndarray | None = None
        self._measure = _RailOffset(self.period)
        self._wait(0.0)

    def follow(self, leader: SlowController) -> None:
        """Know the offset of the rails that the gear in front measures, see `SlowController`."""
        if self._settings.uses_rails and isinstance(leader, CreepGuide):
            leader.rails = self._ahead[-2:]

    def _wait(self, delay: float) -> None:
        """Plan for torques that act a delay (s) after what was read."""
        self._delay, self._late = delay, delay_of(delay, self._settings)
        self._behind = max(delay - CONTROL_PERIOD, 0.0)  # the measured position is that of a control cycle before
        self._schedule = schedule(self._vehicle, self._settings, self._creep, delay)
        self.sent = np.zeros(self._late.sent)

    def read(self, readings: np.ndarray, delay: float) -> None:
        """What sensors read: displacement (m), yaw angle (rad), yaw rate (rad/s); and the time from there to the torque
        (s), see `SlowController`."""
        if delay != self._delay:
            self._wait(delay)
        self._read = np.array(readings)

    def notice(self, adhesion: np.ndarray, slip: np.ndarray) -> None:
        """Used adhesion (traction positive) and slip of both wheels (-), see `SlowController`."""
        side = np.array([-self._seen[model.Y], self._seen[model.Y]])  # shifts towards the flange, left and right
        over = self._profile(side) - slip
        if not (np.isfinite(adhesion).all() and np.isfinite(over).all()) or not (adhesion.any() or slip.any()):
            return  # nothing was measured yet
        if self._demanded < 1.0:  # such wheels roll: what they seem to slip more is their radius
            self._learnt += 1
            mean, each = (max(self.period / (self.period + lag), 1 / self._learnt) for lag in (_RADIUS_LAG, _APART_LAG))
            found = over - self._load * adhesion / self._creep.across - self._offset
            self._offset += mean * found.mean() + each * (found - found.mean())
        seen = np.array([adhesion, over - self._offset])
        self._slip += self.period / (self.period + _SLIP_LAG) * (seen - self._slip)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Differential torque (N m) from the measured states (6,) and the base torque per wheel (N m).

        Below the slowest speed of the model the torque is held.
        """
        begin = time.thread_time()
        measured = bool(np.isfinite(x_hat).all() and (self._read is None or np.isfinite(self._read).all()))
        if measured:
            self._seen[:] = x_hat
        else:
            self.missed += 1
            self._seen[model.X] += self._seen[model.XDOT] * self.period
        if np.isfinite(u_d):
            asked = max(abs(u_d) / _FREE, abs(self.sent[0]) / _FREE_APART) / (self._vehicle.wheel.radius * self._load)
            self._demanded = max(asked, self._demanded * (1 - self.period / _RADIUS_LAG))  # wheels come to rest
        v = float(self._seen[model.XDOT])
        here, ahead = self._track_ahead(v, u_d * self._acceleration if np.isfinite(u_d) else 0.0)
        read = self._seen[[model.Y, model.PSI_TRAX, model.PSIDOT_AX]] if self._read is None else self._read.copy()
        read[-1] -= v * here[0]
        if self._read is not None:
            read[:2] += here[1:]  # from the track, not from the rails
        sound = bool(np.isfinite(self.state).all() and np.isfinite(self.sent).all()) and not (
            measured and abs(read[0] - self.state[0]) > _LOST
        )
        lost = self._started and not sound
        self.restarts += lost
        if not self._started or lost or v < LEAST_SPEED:
            self._started = True
            self._begin(v, read)
        if v >= LEAST_SPEED:
            if measured and self._read is not None and self.rails is not None:
                self._notice_rails(self.rails, read, v)
            self._follow(read if measured else None, ahead, v)
        self.stats.append(Solve(time.thread_time() - begin, 0, False))
        return float(self.sent[0])

    def _follow(self, read: np.ndarray | None, ahead: np.ndarray, v: float) -> None:
        """Correct the state by what was read, choose the torque, predict the state of the next sample."""
        adhesion, slip = self._uses * self._slip
        low, high, share = self._schedule.around(v, adhesion, slip, self._alertness())
        state, limit, free = self.state, self._vehicle.drive.torque_limit, len(STATES) + len(UNKNOWN)
        if read is not None:
            expected = state[_READ]
            expected[-1] += state[-1]
            surprise = read - expected
            state += (low.read + share * (high.read - low.read)) @ surprise
            self._notice_colour(float(surprise[0]))
            state[len(STATES) : free] = np.minimum(np.maximum(state[len(STATES) : free], -self._bounds), self._bounds)
        here = ahead[: len(KNOWN), 0].copy()
        here[SHIFTS] = self._shifts(state[0] - here[_RAIL_OFFSET])  # where the gear is, not where it should be
        known = np.concatenate([state, self.sent, ahead.ravel()])
        below, above = low.change @ known, high.change @ known
        torque = min(max(self.sent[0] + below + share * (above - below), -limit), limit)
        torques = np.array([torque, *self.sent])
        acts = torques[[self._late.whole, min(self._late.whole + 1, len(torques) - 1)]]
        step = low.step + share * (high.step - low.step)
        state[: len(STATES)] = step @ np.concatenate([state[:free], acts, here])
        self.sent = torques[: len(self.sent)]

    def _notice_colour(self, surprise: float) -> None:
        """Power of the innovation of the displacement (m), and of its low-pass, which noise alone would leave small."""
        h = self.period
        self._slow += h / (h + _WHITE_LAG) * (surprise - self._slow)
        mean = h / (h + _MEAN_LAG)
        self._power += mean * (surprise**2 - self._power)
        self._slow_power += mean * (self._slow**2 - self._slow_power)

    def _alertness(self) -> int:
        """Steps from quiet (0: innovations are white, the model says what happens) to awake (`ALERT`)."""
        colour = self._slow_power * (1 + 2 * _WHITE_LAG / self.period) / self._power if self._power > 0.0 else 0.0
        now = min(max((colour - _CALM) / (_AWAKE - _CALM), 0.0), 1.0)
        self._alert = max(now, self._alert - self.period / _SETTLED)
        return round(ALERT * self._alert)

    def _begin(self, v: float, read: np.ndarray) -> None:
        """State without creepage and disturbance at what was read; the torque stays."""
        y, psi, r = read
        start = {"y": y, "vy": v * psi, "psi": psi, "r": r, "E": self._vehicle.gear.contact_base / 2 * r, "yb": y}
        self.state[:] = [start.get(name, 0.0) for name in (*STATES, *UNKNOWN, "bias")]
        self.sent[:] = self.sent[0] if np.isfinite(self.sent[0]) else 0.0
        self.state[STATES.index("tau")] = self.sent[0]

    def _notice_rails(self, rails: np.ndarray, read: np.ndarray, v: float) -> None:
        """Write the offset of the rails here into the table of the gear behind."""
        offset, direction = self._measure(read[2] - self.state[-1], read[1], v)
        place = int((self._seen[model.X] - (self._behind + _RAIL_LAG) * v - self._start) / _GRID + 0.5)
        if 0 < place < rails.shape[1]:
            rails[0, place : place + round(_RAIL_AHEAD / _GRID)] = offset
            rails[1, place] = direction

    def _track_ahead(self, speed: float, acceleration: float) -> tuple[np.ndarray, np.ndarray]:
        """Curvature (1/m), offset (m) and direction (-) of the rails here; and ahead, shape (11, steps + 1), the known
        inputs in the middle of each step and the set point at its end."""
        t = self._times
        driven = np.minimum(t, speed / -acceleration) if acceleration < 0 else t
        p = self._seen[model.X] - self._behind * speed + (speed + acceleration / 2 * driven) * driven
        place = np.minimum(np.maximum((p - self._start) / _GRID, 0.0), self._ahead.shape[1] - 1.001)
        index = place.astype(int)
        columns = self._ahead.take(index, axis=1)
        columns += (place - index) * (self._ahead.take(index + 1, axis=1) - columns)
        kappa, dkappa, phi, dphi, heading, apart, y_ref, slope, *bent, rail, turned = columns[:, 1:]
        v = speed + acceleration * driven[1:]
        side = self._vehicle.gravity * phi - v**2 * kappa
        set_point = y_ref + rail + self.period / 2 * v * (slope + turned)
        known = side, v**2 * dkappa, v * dphi, heading, v * apart, rail, v * turned, *bent
        return columns[[0, -2, -1], 0], np.array([*known, set_point])


class _RailOffset:
    """Offset of the rails from the track by the part of the yaw angle that the yaw rate does not explain.

    It counts as far as its power exceeds what noise makes of it, so that the gear does not follow ideal rails.
    """

    def __init__(self, period: float):
        self._period, self._count, self._slow = period, 0, [0.0, 0.0, 0.0]
        self._turned, self._offset, self._power = 0.0, 0.0, 0.0

    def __call__(self, yaw_rate: float, yaw: float, v: float) -> tuple[float, float]:
        """Offset (m) and direction (-) from yaw rate (rad/s), yaw angle as read (rad) and speed (m/s)."""
        h = self._period
        self._turned += h * yaw_rate
        direction = self._turned - yaw
        self._count += 1
        quick, slow = (max(h / (h + lag), 1 / self._count) for lag in (_RAIL_LAG, _RAIL_FADE))  # means at first
        fine, coarse, drift = self._slow
        fine += quick * (direction - fine)
        coarse += slow * (fine - coarse)
        drift += slow * (fine - coarse - drift)  # of the gyro, which leaves a constant part
        self._slow[:] = fine, coarse, drift
        direction = fine - coarse - drift
        self._offset += h * (v * direction - self._offset / _RAIL_FADE)
        self._power += h / (h + _RAIL_FADE) * (direction**2 - self._power)
        share = min(max(self._power / _RAIL_NOISE**2 - 1, 0.0), 1.0)
        return share * self._offset, share * direction


_READ = [STATES.index(name) for name in READ]
_RAIL_OFFSET = KNOWN.index("rail_offset")


def _apparent_slip(vehicle: Vehicle) -> Callable[[np.ndarray], np.ndarray]:
    """Slip that a wheel of the nominal radius seems to have when it rolls, negative, over its shift (m)."""
    frame = contact_table(vehicle.contact.profile, vehicle).frame
    shift, change = frame["shift_m"].to_numpy(), frame["rolling_radius_m"].to_numpy() / vehicle.wheel.radius - 1
    return lambda at: np.interp(at, shift, change)


def _table(route: Route, partner: float, bent: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """The track along the route every `_GRID`, shape (13, n).

    Curvature and its slope (1/m, 1/m2), cant angle and its slope (rad, rad/m), heading and curvature at the gear less
    those at the car body (rad, 1/m), set point and its slope (m, -), `shifts` of the profile there (m),
    offset of the rails and its slope (m, -), which are 0 at first.
    """
    p = np.arange(route.start, route.start + CELL * len(route.cells), _GRID)
    (psi, kappa, phi, dphi, *_), there = route.track_at(p), route.track_at(p + partner)
    dkappa = route.rows_at(p)[:, INDEX["dkappa"]]
    apart = (psi - there[0]) / 2, (kappa - there[1]) / 2
    y_ref, slope = route.reference_at(p)
    return np.ascontiguousarray([kappa, dkappa, phi, dphi, *apart, y_ref, slope, *bent(y_ref), 0 * p, 0 * p])
