"""Guidance of both running gears as a Gymnasium environment: every 5 ms the agent sets two differential torques.

Install gymnasium, copy this file, and change observation and reward as you like:

    env = GuidanceEnv("curve_entry_T3", sensors=True)
    observation, info = env.reset(seed=1)
    observation, reward, terminated, truncated, info = env.step([0.02, -0.01])

Observation, `Box(21,)`, numbers of order one: ten numbers per running gear (front, rear) and the speed / (100 m/s). The
ten numbers are the lateral error (y* - y) / (1 mm), the slope of the set point minus the yaw angle to the track
/ (1 mrad), the yaw rate relative to the track / (10 mrad/s), the last torque / its limit, the set point minus y
/ (1 mm) at the three times `AHEAD`, and the unbalanced lateral acceleration / (1 m/s2) at the same times.
Action, `Box(2,)` in [-1, 1]: differential torques of the front and the rear running gear / torque limit; a positive
torque steers to the right.
Reward of a step: -T min(WORST, mean over running gears of (error / 1 mm)^2 + EFFORT (torque / 1 kN m)^2), T = 5 ms. A
step that derails costs WORST for the rest of the episode, so that an early end brings no advantage.
"""

from __future__ import annotations

import gymnasium
import numpy as np

from railrepro.car.outputs import GearStates
from railrepro.control import lateral
from railrepro.control.law import GEARS
from railrepro.data import InputError
from railrepro.estimation.sensors import readings
from railrepro.model.control_model import PSI_TRAX, PSIDOT_AX, STATES, XDOT, X, Y
from railrepro.quantities import names
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

CYCLES, STEP = 5, 0.005
"""Number of control cycles of 1 ms in a step, and its duration (s)."""
AHEAD = (0.1, 0.2, 0.4)
"""Times ahead at which track and set point are observed (s)."""
EFFORT, WORST = 0.1, 100.0
"""Weight of the torque; largest cost per second, equal to the cost of an error of 10 mm."""
OFFSET = 1e-3
"""Largest lateral displacement at the start (m)."""


class GuidanceEnv(gymnasium.Env):
    """The car in a scenario of data/scenarios.toml. With `sensors`: noise, latency and state estimation."""

    metadata = {"render_modes": []}

    def __init__(self, scenario="curve_entry_T3", sensors: bool = False):
        self.scenario = load_scenario(scenario) if isinstance(scenario, str) else scenario
        self.vehicle, self.sensors, self.loop = load_vehicle(), sensors, None
        self.route = self.scenario.route()
        slower = 5.0 if self.scenario.force_kN else 1.25
        self.duration = slower * self.route.length / self.scenario.speed  # of the longest episode (s)
        size = len(GEARS) * (4 + 2 * len(AHEAD)) + 1
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(GEARS),), np.float32)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Begin an episode. The seed determines the initial positions of the running gears and the sensor noise."""
        super().reset(seed=seed)
        noisy = readings(seed=int(self.np_random.integers(2**31))) if self.sensors else None
        cars = self.vehicle, self.vehicle
        self.loop = simulate.start(self.scenario, lateral.ZeroOrderHold(), self.route, *cars, sensors=noisy)
        states = self.loop.car.model.states
        for gear in GEARS:
            self.loop.state[states.index(f"{gear}.y")] += self.np_random.uniform(-OFFSET, OFFSET)
        self.loop.car.measure()
        self.time = 0.0
        return self._observation(), self._info()

    def step(self, action):
        """Apply two torques for 5 ms."""
        loop, torque = self.loop, np.asarray(action, dtype=float)
        if loop is None or self._over():
            raise InputError("reset() is needed before a step")
        if torque.shape != (len(GEARS),) or not np.isfinite(torque).all():
            raise InputError(f"the action is {action!r}, two numbers from -1 to 1 are needed")
        left = self.duration - self.time
        loop.held[:] = np.clip(torque, -1.0, 1.0) * self.vehicle.drive.torque_limit
        loop.run(CYCLES)
        loop.car.measure()
        self.time = round(self.time + STEP, 6)
        observation, info = self._observation(), self._info()
        if not np.isfinite(observation).all() or min(loop.margins[f"{gear}.lateral"] for gear in GEARS) <= 0:
            return np.nan_to_num(observation, posinf=0.0, neginf=0.0), -WORST * left, True, False, info
        cost = np.mean((1e3 * info["error"]) ** 2 + EFFORT * (1e-3 * loop.held) ** 2)
        return observation, -STEP * min(float(cost), WORST), False, self._over(), info

    def _over(self) -> bool:
        return bool(self.loop.ended or self.duration - self.time < STEP / 2)

    def _states(self) -> np.ndarray:
        """States of both running gears, shape (2, 6), SI. With sensors they are estimates, except at the start."""
        loop = self.loop
        if self.sensors and self.time:
            known = dict(zip(loop.control.signature.memory, loop.memory, strict=True))
            return np.array([[known[f"{gear}.estimated.{name}"] for name in STATES] for gear in GEARS])
        known = loop.car.outputs
        return np.array([[known[f"{gear}.{name}"] for name in names(GearStates)] for gear in GEARS])

    def _info(self) -> dict:
        """Lateral error (m) and torque (N m) of both running gears; front position (m), speed (m/s); time (s)."""
        x, torque = self._states(), self.loop.held.copy()
        error = np.array([self.route.reference_at(gear[X])[0].item() - gear[Y] for gear in x])
        return {"error": error, "torque": torque, "p": x[0, X], "v": x[0, XDOT], "time": self.time}

    def _observation(self) -> np.ndarray:
        limit, x = self.vehicle.drive.torque_limit, self._states()
        gears = [self._of_gear(*pair) for pair in zip(x, self.loop.held / limit, strict=True)]
        return np.append(gears, x[0, XDOT] / 100).astype(np.float32)

    def _of_gear(self, x, utilisation: float) -> np.ndarray:
        """The ten numbers of a running gear with state x (SI) and its last torque / torque limit."""
        ends = self.route.start, self.route.start + self.route.length
        places = np.clip(np.nan_to_num(x[X] + x[XDOT] * np.array([0.0, *AHEAD])), *ends)
        y_ref, slope, _ = self.route.reference_at(places)
        _, curvature, cant, *_ = self.route.track_at(places)
        error = 1e3 * (y_ref - x[Y])
        yaw, turning = slope[0] - x[PSI_TRAX], x[PSIDOT_AX] - x[XDOT] * curvature[0]
        unbalanced = self.vehicle.gravity * cant[1:] - x[XDOT] ** 2 * curvature[1:]
        return np.array([error[0], 1e3 * yaw, 1e2 * turning, utilisation, *error[1:], *unbalanced])
