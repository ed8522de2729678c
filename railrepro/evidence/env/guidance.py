"""Guidance of both running gears as a Gymnasium environment: every 5 ms two differential torques.

Observation, `Box(29,)`, float32, about one in size; per gear (front, rear) 14 numbers, and the speed over 100 m/s:
lateral error y* - y over 1 mm; slope of the set point less yaw against the track over 1 mrad; yaw rate against the
track over 10 mrad/s; torque given last over its limit; set point less y over 1 mm at the five times `AHEAD`; unbalanced
lateral acceleration there over 1 m/s2.
Action, `Box(2,)` in [-1, 1]: differential torque of front and rear gear over the torque limit, positive steers right.
Reward of a step: -T (mean over the gears of (error / 1 mm)^2 + EFFORT (torque / 1 kN m)^2), T = 5 ms; `FAILURE` when a
gear leaves the rail, which is also the only termination. The end of the scenario truncates.
A seed draws where the gears stand at the start, and noise and biases of the sensors where there are some.

`gymnasium.make("railrepro.evidence.env.guidance:railrepro/Guidance-v0", scenario="curve_entry_T3")` makes one. It has
no counterpart in the paper.
"""

from __future__ import annotations

import gymnasium
import numpy as np

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.control import lateral
from railrepro.control.law import GEARS
from railrepro.errors import InputError
from railrepro.estimation.sensors import readings
from railrepro.model.control_model import PSI_TRAX, PSIDOT_AX, XDOT, X, Y
from railrepro.schema import require
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.track.route import CELL
from railrepro.vehicle.parameters import load_vehicle

EXCHANGES = 5
"""Exchanges of 1 ms in a step."""
AHEAD = (0.05, 0.1, 0.2, 0.3, 0.5)
"""Times ahead at which the road is seen (s)."""
EFFORT, FAILURE = 0.1, -100.0
OFFSET = 1e-3
"""Largest lateral displacement at the start (m)."""
_SIDEWAYS = 4 + len(AHEAD)
_SIZE = 2 * (4 + 2 * len(AHEAD)) + 1
"""Numbers of an observation."""
_PITCH = 4
"""Points of the table of the road ahead per metre."""


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
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (_SIZE,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(GEARS),), np.float32)
        self._track_ahead = self._table()
        self._exchange = None
        self._ahead = np.array((0.0, *AHEAD))

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        """Start again; see `gymnasium.Env.reset`. There are no options."""
        if options:
            raise InputError(f"environment: options are {options!r}, there are none")
        super().reset(seed=seed)
        seen = readings(seed=int(self.np_random.integers(2**31))) if self._sensors else None
        settings = None, None, 0.0, seen
        self._exchange = simulate.start(self.scenario, lateral.Held(), self.route, self.vehicle, self.vehicle, settings)
        names = self._exchange.car.model.states
        for gear in GEARS:
            self._exchange.state[names.index(f"{gear}.y")] += self.np_random.uniform(-OFFSET, OFFSET)
        self._exchange.measure()
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        """Hold two torques for 5 ms; see `gymnasium.Env.step`."""
        if self._exchange is None or self._exchange.ended:
            raise InputError("environment: reset() is needed before a step")
        torque = _numbers(action)
        if torque.shape != (len(GEARS),) or not np.isfinite(torque).all():
            raise InputError(f"environment: the action is {action!r}, two numbers from -1 to 1 are needed")
        exchange = self._exchange
        exchange.held[:] = np.clip(torque, -1.0, 1.0) * self.vehicle.drive.torque_limit
        exchange.run(EXCHANGES)
        exchange.measure()
        observation = self._observation()
        front, rear = float(observation[0]), float(observation[4 + 2 * len(AHEAD)])
        cost = (front**2 + rear**2) / 2 + EFFORT * (exchange.held @ exchange.held) / 2e6
        reward = -EXCHANGES * EXCHANGE_PERIOD * float(cost)
        if not exchange.ended:
            return observation, reward, False, False, {}
        margins = exchange.margins
        left = not all(margins[name] > 0 for name in margins if name.endswith("lateral"))
        broken = not np.isfinite(observation).all()
        failed = left or broken or not min(margins["track_end"], margins["stop_speed"]) <= 0
        if broken:
            observation = np.nan_to_num(observation, posinf=0.0, neginf=0.0)
        return observation, (FAILURE if failed else reward), failed, not failed, {"margins": margins}

    @property
    def states(self) -> np.ndarray:
        """Measured states of both gears (SI)."""
        if self._exchange is None:
            raise InputError("environment: reset() is needed before there are states")
        return self._exchange.measured_states()

    def _table(self) -> np.ndarray:
        """Set point, its slope, curvature, and gravity along the canted track (m/s2) along the route, shape (4, n)."""
        count = int(len(self.route.cells) * CELL * _PITCH)
        p = self.route.start + np.arange(count) / _PITCH
        _, curvature, cant, *_ = self.route.track_at(p)
        return np.stack([*self.route.reference_at(p), curvature, self.vehicle.gravity * cant])

    def _observation(self) -> np.ndarray:
        x, seen = self._exchange.measured_states(), np.empty(_SIZE, np.float32)
        gears, v = seen[:-1].reshape(len(GEARS), -1), x[:, XDOT, None]
        places = (x[:, X, None] + v * self._ahead - self.route.start) * _PITCH
        places = np.fmin(np.fmax(places, 0), self._track_ahead.shape[1] - 1).astype(int)
        y_ref, slope, curvature, lift = self._track_ahead[:, places]
        aside = 1e3 * (y_ref - x[:, Y, None])
        gears[:, 0], gears[:, 4:_SIDEWAYS] = aside[:, 0], aside[:, 1:]
        gears[:, 1] = 1e3 * (slope[:, 0] - x[:, PSI_TRAX])
        gears[:, 2] = 1e2 * (x[:, PSIDOT_AX] - v[:, 0] * curvature[:, 0])
        gears[:, 3] = self._exchange.held / self.vehicle.drive.torque_limit
        gears[:, _SIDEWAYS:] = lift[:, 1:] - v**2 * curvature[:, 1:]
        seen[-1] = x[0, XDOT] / 100
        return seen


def _numbers(action) -> np.ndarray:
    """An action as an array; an empty one when it holds anything but real numbers."""
    try:
        found = np.asarray(action)
    except ValueError:  # lists of different length
        return np.empty(0)
    return found.astype(float) if found.dtype.kind in "iuf" else np.empty(0)


gymnasium.register("railrepro/Guidance-v0", "railrepro.evidence.env.guidance:GuidanceEnv")
