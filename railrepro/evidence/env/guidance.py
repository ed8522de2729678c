"""Guidance of both running gears as a Gymnasium environment: every 5 ms two differential torques.

Observation, `Box(29,)`, float32, about one in size; per gear (front, rear) 14 numbers, and the speed over 100 m/s:
lateral error y* - y over 1 mm; slope of the set point less yaw against the track over 1 mrad; yaw rate against the
track over 10 mrad/s; torque given last over its limit; set point less y over 1 mm at the five times `AHEAD`; unbalanced
lateral acceleration there over 1 m/s2.
Action, `Box(2,)` in [-1, 1]: differential torque of front and rear gear over the torque limit, positive steers right.
Reward of a step: -T min(`WORST`, mean over the gears of (error / 1 mm)^2 + EFFORT (torque / 1 kN m)^2), T = 5 ms. When
a gear derails, which is the only termination, the step costs `WORST` for all the time that the episode could
still have lasted: no early end is better than any way on. The end of the scenario, or of `duration`, truncates.
Info of every step: `error` (m) and `torque` (N m) of both gears, shape (2,), `p` (m), `v` (m/s), `time` (s), and
`margins`, the distances to the limits by name: `front.lateral` and `rear.lateral` (m, at 0 the gear derails),
`track_end` (m), `stop_speed` (m/s). That of `reset` is the same without `margins`.
A seed draws where the gears stand at the start, and noise and biases of the sensors where there are some.

`gymnasium.make("railrepro.evidence.env.guidance:railrepro/Guidance-v0", scenario="curve_entry_T3")` makes one,
`gymnasium.make_vec(the same, num_envs=2, vectorization_mode="async")` several in processes of their own. `learn` tunes
a policy with it. It has no counterpart in the paper.
"""

from __future__ import annotations

import math
import warnings

import gymnasium
import numpy as np

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.control import lateral
from railrepro.control.law import GEARS, LawSettings
from railrepro.errors import InputError
from railrepro.estimation.sensors import readings
from railrepro.evidence.env.observation import SIZE, Sight
from railrepro.model.control_model import XDOT, X
from railrepro.schema import between, require
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.vehicle.parameters import load_vehicle

EXCHANGES = 5
"""Exchanges of 1 ms in a step."""
EFFORT, WORST = 0.1, 100.0
"""Weight of the torque; largest cost of a second, that of an error of 10 mm."""
OFFSET = 1e-3
"""Largest lateral displacement at the start (m)."""
_UNUSUAL = 10.0
"""Actions beyond it are warned of; all beyond 1 act as 1."""
_SLOWER, _BRAKED = 1.25, 5.0
"""Longest episode over the time at initial speed, also where the scenario brakes."""


class GuidanceEnv(gymnasium.Env):
    """The environment; see the module.

    Parameters
    ----------
    scenario : str or Scenario
    sensors : bool
        Whether the observation comes from sensors with noise, latency and filter, or is exact.

    Attributes
    ----------
    states : ndarray, shape (2, 6)
        Measured states of both gears (SI), in the order of `control_model.STATES`.
    route : Route
    vehicle : Vehicle
    duration : float
        Longest episode (s).
    """

    metadata = {"render_modes": []}

    def __init__(self, scenario: str | Scenario = "curve_entry_T3", sensors: bool = False, render_mode=None):
        if render_mode is not None:
            raise InputError(f"environment: render_mode is {render_mode!r}, there is none")
        require("environment: sensors", sensors, bool)
        self.scenario = load_scenario(scenario) if isinstance(scenario, str) else scenario
        require("environment: scenario", self.scenario, Scenario)
        self.vehicle, self._sensors = load_vehicle(), sensors
        self.route = simulate.checked_route(self.scenario, self.vehicle)
        slower = _BRAKED if self.scenario.force_kN else _SLOWER
        self.duration = slower * self.route.length / self.scenario.speed
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (len(GEARS) * SIZE + 1,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(GEARS),), np.float32)
        self._sight, self._exchange = Sight(self.route, self.vehicle), None

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Start again; see `gymnasium.Env.reset`. There are no options."""
        if options:
            raise InputError(f"environment: options are {options!r}, there are none")
        if seed is not None:
            require("environment: seed", seed, between(0, math.inf), whole=True)
        super().reset(seed=seed)
        seen = readings(seed=int(self.np_random.integers(2**31))) if self._sensors else None
        settings = LawSettings(sensors=seen)
        self._exchange = simulate.start(self.scenario, lateral.Held(), self.route, self.vehicle, self.vehicle, settings)
        names = self._exchange.car.model.states
        for gear in GEARS:
            self._exchange.state[names.index(f"{gear}.y")] += self.np_random.uniform(-OFFSET, OFFSET)
        self._exchange.measure()
        observation, info = self._observed()
        return observation, {name: value for name, value in info.items() if name != "margins"}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Hold two torques for 5 ms; see `gymnasium.Env.step`."""
        exchange = self._exchange
        if exchange is None or exchange.ended or self.duration - exchange.time < _STEP / 2:
            raise InputError("environment: reset() is needed before a step")
        torque = _numbers(action)
        if torque.shape != (len(GEARS),) or not np.isfinite(torque).all():
            raise InputError(f"environment: the action is {action!r}, two numbers from -1 to 1 are needed")
        if np.abs(torque).max() > _UNUSUAL:
            said = "is unusual, -1 to 1 of the torque limit are usual: is it in N m?"
            warnings.warn(f"environment: the action {action!r} {said}", stacklevel=2)
        left = self.duration - exchange.time
        exchange.held[:] = np.clip(torque, -1.0, 1.0) * self.vehicle.drive.torque_limit
        exchange.run(EXCHANGES)
        exchange.measure()
        observation, info = self._observed()
        margins, broken = info["margins"], not np.isfinite(observation).all()
        on_rail = all(margins[f"{gear}.lateral"] > 0 for gear in GEARS) and not broken
        if not on_rail:
            return np.nan_to_num(observation, posinf=0.0, neginf=0.0), -WORST * left, True, False, info
        cost = np.mean((1e3 * info["error"]) ** 2 + EFFORT * (1e-3 * exchange.held) ** 2)
        truncated = exchange.ended or self.duration - exchange.time < _STEP / 2
        return observation, -_STEP * min(float(cost), WORST), False, bool(truncated), info

    @property
    def states(self) -> np.ndarray:
        """Measured states of both gears (SI)."""
        if self._exchange is None:
            raise InputError("environment: reset() is needed before there are states")
        return self._exchange.measured_states()

    def _observed(self) -> tuple[np.ndarray, dict]:
        """Observation and info."""
        exchange, x = self._exchange, self.states
        with np.errstate(invalid="ignore"):
            seen = self._sight.seen(x, exchange.held)
        info = {"error": 1e-3 * seen[:, 0], "torque": exchange.held.copy(), "p": float(x[0, X])}
        info |= {"v": float(x[0, XDOT]), "time": exchange.time, "margins": dict(exchange.margins)}
        return np.append(seen, x[0, XDOT] / 100).astype(np.float32), info


_STEP = EXCHANGES * EXCHANGE_PERIOD


def _numbers(action) -> np.ndarray:
    """An action as an array; an empty one when it holds anything but real numbers."""
    try:
        found = np.asarray(action)
    except ValueError:  # lists of different length
        return np.empty(0)
    return found.astype(float) if found.dtype.kind in "iuf" else np.empty(0)


gymnasium.register("railrepro/Guidance-v0", "railrepro.evidence.env.guidance:GuidanceEnv")
