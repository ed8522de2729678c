r"""Gains of a lateral controller on the creep-aware model: linear-quadratic feedback with preview, and Kalman filter.

Time runs with the readings: a torque that is chosen now acts after the age of the readings and the way of a command.

With dy = y - y* and the change of the differential torque from step to step, the cost over an infinite horizon is

    sum_k  q dy_k^2 + rho (du_k - du_(k-1))^2

so that any du that a curve needs costs nothing as long as it is held. What the road brings is known over a preview and
constant behind it; disturbances are constant. The optimum is linear in all of them.

Source: Anderson and Moore 1990, Optimal Control, ch. 2 and 4 (tracking, known disturbances).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import copysign, log

import numpy as np
from scipy.linalg import solve_discrete_are

from railrepro.data import InputError, between, require
from railrepro.own.creep_model import LEAST_SPEED, STATES, UNKNOWN, Creep, lateral_model
from railrepro.vehicle.parameters import Vehicle

READ = ("y", "psi", "r")
"""States that are measured."""
SPEEDS = np.geomspace(LEAST_SPEED, 125.0, 31)
"""Speeds at which gains are computed (m/s); in between they are interpolated over the logarithm."""
_LOG_SPEEDS, _PLACES = np.log(SPEEDS), np.arange(len(SPEEDS))
FAST = 400 / 3.6
"""Speed at which the weight of a change of torque is stated (m/s)."""
ALERT = 4
"""Steps of alertness from quiet to awake, see `Schedule`."""
_PRIOR = 1e-4
"""Slip that the ratio of adhesion and slip has anyway, so that it exists without traction (-)."""
_TOLERANCE, _SPEED_NOISE = 5e-4, 0.015
"""Slip beyond that of the linear range that a rolling wheel may show by its radius (-), and the noise of low-passed
sliding speeds, three standard deviations (m/s)."""
_APART = 2e-3
"""Slip against each other that rolling wheels may show (-): profiles off their middle, a yaw rate that is not known."""
_SOFTNESS_STEP, _ADHESION_STEP = 0.15, 0.01
"""Steps of the logarithm of the secant stiffness and of the used adhesion (-), to which both are rounded."""
_KNEE, _LEAST_SLOPE = 3e-3, 0.03
"""Slip at which the slope of the longitudinal creep force is half its secant, and least ratio of both (-): rounded from
Polach's law, for which this slip is 0.0015 to 0.006 on dry to very poor rails at 40 to 400 km/h."""
_SHARE_STEP = 0.0625
"""Step to which the share of a torque that arrives is rounded (-)."""
_STIFF = 0.2, 0.3
"""Secant stiffness of a wheel over that of one that rolls: up to the first both wheels slide, from the second on this
one holds the gear (-)."""
_UNITS = (1e-3, 1e-2, 1e-3, 1e-2, 1e-2, 100.0, 1e-2, 1e-2, 1e-3, 1e-2)
"""Usual sizes of the states (SI)."""
_SLIGHT = 1e-12
"""Variance per step of states that no noise drives (SI), which keeps the filter's equation regular."""


@dataclass(frozen=True)
class CreepSettings:
    """Tuning of the creep-aware predictive controller.

    Attributes
    ----------
    period : float
        Sampling time, a whole number of milliseconds (s).
    preview : float
        How far ahead road and set point are known (s).
    error, change : float
        Weights q of the lateral error (1/m2) and rho of a change of the differential torque (1/(N m)2).
    speed_power : float
        Power with which `change` grows over the speed where wheels roll; at `FAST` it is what it says (-).
    slip_factor : float
        Factor on `change` where wheels slip so much that they have no stiffness left, at all speeds (-).
    force_rate, moment_rate : float
        Random walks of the disturbances, standard deviation after one second (N, N m).
    quiet, quiet_change : float
        Factors on both walks and on `change` while wheels roll and innovations are white, see `Schedule` (-).
    y_noise, psi_noise, r_noise : float
        Standard deviations of what is read (m, rad, rad/s).
    r_drift : float
        Random walk of the bias of the yaw rate that is read, standard deviation after one second (rad/s).
    uses_adhesion, uses_slip, uses_rails, uses_bend : bool
        Whether the gains depend on the measured adhesion and on the measured slip, whether the rear gear has
        the offset of the rails that the front gear measures with sensors, and whether the model knows how the profile
        bends, see `creep_model.shifts`. False shows what each is worth.

    Raises
    ------
    InputError
        When a value is not a number in its range.
    """

    period: float = 1e-3
    preview: float = 0.6
    error: float = 1e7
    change: float = 1e-3
    speed_power: float = 0.0
    slip_factor: float = 1.0
    force_rate: float = 3e4
    moment_rate: float = 1e4
    quiet: float = 1.0
    quiet_change: float = 1.0
    y_noise: float = 1e-5
    psi_noise: float = 1e-5
    r_noise: float = 1e-4
    r_drift: float = 1e-6
    uses_adhesion: bool = True
    uses_slip: bool = True
    uses_rails: bool = True
    uses_bend: bool = True

    def __post_init__(self) -> None:
        ranges = {"period": between(1e-3, 0.1, "s"), "preview": between(0.0, 5.0, "s")}
        ranges |= {"error": between(1e-3, 1e12, "1/m2"), "change": between(1e-9, 1e6, "1/(N m)2")}
        ranges |= {"speed_power": between(-5.0, 5.0), "slip_factor": between(1e-6, 1e6)}
        ranges |= {"quiet": between(1e-6, 1.0), "quiet_change": between(1e-6, 1e3)}
        ranges |= {"force_rate": between(1e-3, 1e8, "N"), "moment_rate": between(1e-3, 1e8, "N m")}
        ranges |= {"y_noise": between(1e-9, 1.0, "m"), "psi_noise": between(1e-9, 1.0, "rad")}
        ranges |= {name: between(1e-9, 10.0, "rad/s") for name in ("r_noise", "r_drift")}
        for name, allowed in ranges.items():
            require(f"CreepSettings: {name}", getattr(self, name), allowed)
        for name in ("uses_adhesion", "uses_slip", "uses_rails", "uses_bend"):
            require(f"CreepSettings: {name}", getattr(self, name), bool)

    @property
    def steps(self) -> int:
        """Number of previewed steps, one at least."""
        return max(round(self.preview / self.period), 1)


@dataclass(frozen=True)
class Gains:
    """What the controller needs at one speed and creep.

    Attributes
    ----------
    step : ndarray, shape (10, 10 + 2 + 2 + 10)
        States after a period (exact) from states, disturbances, the differential torque that acts last, the one before
        it, and known inputs.
    read : ndarray, shape (13, 3)
        Kalman gain from readings (y, psi, r) to states, disturbances and the bias of r.
    change : ndarray, shape (10 + 2 + 1 + sent + 11 * (steps + 1),)
        Factors of a change of torque (N m): of states, disturbances, bias and the torques that were sent, the last one
        first; of each known input during each previewed step; of the set point after each of them. Those of the last
        step stand for all that follow.
    """

    step: np.ndarray
    read: np.ndarray
    change: np.ndarray


@dataclass(frozen=True)
class Delay:
    """Time between a reading and the torque that answers it, in periods.

    Attributes
    ----------
    whole : int
    rest : float
        Share of a period, below 1.
    """

    whole: int
    rest: float

    @property
    def sent(self) -> int:
        """How many of the last torques are under way, that which acts now among them; at least one."""
        return max(self.whole + (self.rest > 0), 1)


def delay_of(seconds: float, settings: CreepSettings) -> Delay:
    """A time (s) in periods, to a thousandth."""
    periods = round(seconds / settings.period, 3)
    return Delay(int(periods), periods - int(periods))


def gains(vehicle: Vehicle, speed: float, creep: Creep, settings: CreepSettings, delay: float = 0.0) -> Gains:
    """Gains of a gear at a speed (m/s) with a delay (s) from reading to torque; see `Gains`."""
    model, late = lateral_model(vehicle, speed, creep), delay_of(delay, settings)
    whole = model.discrete(settings.period)
    last = model.discrete((1 - late.rest) * settings.period)
    before = whole.b - last.b  # of the torque that acts during the rest of the delay
    step = np.column_stack([whole.a, whole.d, last.b, before, whole.e])
    return Gains(step, _kalman(whole, settings), _tracking(whole, last.b, before, late, settings))


class Schedule:
    """Gains over speed, used adhesion, slip and alertness, computed when they are needed first (some ms).

    Alertness 0 is for wheels that roll as the model says: disturbances hardly walk, so the filter averages for longer,
    and what it finds is quiet enough for a controller that changes its torque more freely. At `ALERT` walks and weight
    are those of the settings; in between they are interpolated geometrically.

    Parameters
    ----------
    vehicle : Vehicle
    settings : CreepSettings
    creep : Creep
        Of wheels that hardly slip.
    delay : float
        From reading to torque (s).
    """

    def __init__(self, vehicle: Vehicle, settings: CreepSettings, creep: Creep, delay: float = 0.0):
        self._vehicle, self._settings, self._creep, self._delay = vehicle, settings, creep, delay
        self._nodes: dict[tuple[int, ...], Gains] = {}

    def around(self, speed: float, adhesion: float, slip: float, alert: int = ALERT) -> tuple[Gains, Gains, float]:
        """Gains at the speeds below and above a speed (m/s), and the share of the latter.

        Parameters
        ----------
        speed : float
        adhesion, slip : float or ndarray
            Used adhesion and slip of all wheels or each, traction positive (-). Wheels that slip in opposite directions
            are as soft as if both did in one. Where one slides alone, the other carries what both share.
        alert : int
            Alertness, 0 to `ALERT`; wheels that slip keep the filter awake.
        """
        place = float(np.interp(np.log(max(speed, SPEEDS[0])), _LOG_SPEEDS, _PLACES))
        node = min(int(place), len(SPEEDS) - 2)
        wheels, slips = np.atleast_1d(adhesion).tolist(), np.atleast_1d(slip).tolist()
        linear = [self._vehicle.wheel_load * abs(one) / self._creep.across + _PRIOR for one in wheels]
        middle = sum(slips) / len(slips)
        against = [copysign(max(abs(one - middle) - _APART, 0.0), one - middle) for one in slips]
        unsure = _TOLERANCE + _SPEED_NOISE / max(speed, SPEEDS[0])
        beyond = [max(abs(middle + b) - a - unsure, 0.0) for a, b in zip(linear, against, strict=True)]
        soft = [a / (a + b) for a, b in zip(linear, beyond, strict=True)]
        softness, stiff = sum(soft) / len(soft), max(soft)
        arrives = 1 - np.interp(stiff, _STIFF, (0.0, 1.0)) * (1 - softness / stiff)
        level = round(log(softness) / _SOFTNESS_STEP)
        share = round(arrives / _SHARE_STEP)
        used = round(sum(wheels) / len(wheels) / _ADHESION_STEP)
        each = round(sum(map(abs, wheels)) / len(wheels) / _ADHESION_STEP)
        key = level, share, used, each, alert if level == 0 else ALERT
        return self._node(node, *key), self._node(node + 1, *key), place - node

    def _node(self, node: int, level: int, share: int, used: int, each: int, alert: int) -> Gains:
        key = node, level, share, used, each, alert
        if key not in self._nodes:
            softness, adhesion = float(np.exp(_SOFTNESS_STEP * level)), _ADHESION_STEP * used
            across = softness * self._creep.across
            slip = self._vehicle.wheel_load * _ADHESION_STEP * each / across
            along = softness * self._creep.along * max(1 / (1 + (slip / _KNEE) ** 2), _LEAST_SLOPE)
            arrives = max(_SHARE_STEP * share, 0.5)
            creep = Creep(along, across, adhesion, self._creep.spin.times(softness), arrives)
            settings = self._settings_at(float(SPEEDS[node]), softness, 1 - alert / ALERT)
            self._nodes[key] = gains(self._vehicle, float(SPEEDS[node]), creep, settings, self._delay)
        return self._nodes[key]

    def _settings_at(self, speed: float, rolling: float, quiet: float) -> CreepSettings:
        """Settings with the weight and the walks of a node.

        `rolling` is 1 where wheels roll and falls to 0 as they soften, `quiet` is 1 minus the alertness.
        """
        own = self._settings
        walks, fast = own.quiet**quiet, (speed / FAST) ** own.speed_power
        change = own.change * own.quiet_change**quiet * fast**rolling * own.slip_factor ** (1 - rolling)
        return replace(own, change=change, force_rate=walks * own.force_rate, moment_rate=walks * own.moment_rate)


_SHARED: dict[tuple, Schedule] = {}
_MOST_SHARED = 8


def schedule(vehicle: Vehicle, settings: CreepSettings, creep: Creep, delay: float = 0.0) -> Schedule:
    """A `Schedule`, that of an earlier gear or run where it is the same."""
    key = repr(vehicle), settings, creep, delay
    if key not in _SHARED and len(_SHARED) >= _MOST_SHARED:
        del _SHARED[next(iter(_SHARED))]
    return _SHARED.setdefault(key, Schedule(vehicle, settings, creep, delay))


def _kalman(model, settings: CreepSettings) -> np.ndarray:
    n, m = len(STATES), len(UNKNOWN)
    a = np.eye(n + m + 1)
    a[:n, :n], a[:n, n : n + m] = model.a, model.d
    c = np.eye(n + m + 1)[[STATES.index(name) for name in READ]]
    c[READ.index("r"), -1] = 1.0
    walks = [settings.force_rate, settings.moment_rate, settings.r_drift]
    wander = np.full(n + m + 1, _SLIGHT)
    wander[n:] = settings.period * np.square(walks)
    noise = np.diag(np.square([settings.y_noise, settings.psi_noise, settings.r_noise]))
    p = _riccati(a.T, c.T, np.diag(wander), noise, 1 / np.array([*_UNITS, *walks]))
    return p @ c.T @ np.linalg.inv(c @ p @ c.T + noise)


def _tracking(model, last: np.ndarray, before: np.ndarray, late: Delay, settings: CreepSettings) -> np.ndarray:
    """Factors of a change of torque, see `Gains.change`.

    The torques that were sent are states, the change of the newest is the input; the costate of what is known is summed
    backwards in time through the closed loop.
    """
    n, sent = len(STATES), late.sent
    size = n + sent
    a, b = np.zeros((size, size)), np.zeros((size, 1))
    a[:n, :n], a[n, n], b[n] = model.a, 1.0, 1.0
    for k in range(1, sent):
        a[n + k, n + k - 1] = 1.0
    for age, column in ((late.whole, last), (late.whole + 1, before)):
        if age == 0:  # the torque that is chosen now acts at once: the last one and its change
            a[:n, n] += column
            b[:n, 0] += column
        elif age <= sent:
            a[:n, n + age - 1] += column
    weight = np.zeros((size, size))
    weight[STATES.index("y"), STATES.index("y")] = settings.error
    units = np.array([*_UNITS, *(_UNITS[STATES.index("tau")] for _ in range(sent))])
    p = _riccati(a, b, weight, np.array([[settings.change]]), units)
    size_u = settings.change + float(b[:, 0] @ p @ b[:, 0])
    feedback = b[:, 0] @ p @ a / size_u
    closed = (a - b * feedback).T
    known, unknown = p[:, :n] @ model.e, p[:, :n] @ model.d

    row = np.empty((settings.steps + 1, size))
    row[0] = b[:, 0] / size_u
    done, power = 1, closed  # rows by doubling: those that are there times closed to the power of their number
    while done <= settings.steps:
        more = min(done, settings.steps + 1 - done)
        row[done : done + more] = row[:more] @ power
        done, power = done + more, power @ power
    rest = np.linalg.inv(np.eye(size) - closed)
    row[-1] = row[-1] @ rest
    state = np.concatenate([-feedback[:n], -row[0] @ rest @ unknown, [0.0], -feedback[n:]])
    ahead = np.column_stack([-row @ known, row @ weight[:, STATES.index("y")]]).T
    return np.concatenate([state, ahead.ravel()])


def _riccati(a, b, q, r, units) -> np.ndarray:
    """Stabilising solution of the discrete Riccati equation, found with states and weights in units of like size."""
    inputs = 1 / np.sqrt(np.diag(r))
    scale = np.outer(units, units)
    try:
        found = solve_discrete_are(a * units / units[:, None], b * inputs / units[:, None], q * scale, np.eye(len(r)))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise InputError(
            f"CreepSettings: the Riccati equation has no usable solution ({error}); weights, noises or random walks "
            "nearer to the defaults are needed"
        ) from error
    return found / scale
