"""The receding horizon that nonlinear and linear time-variant MPC share."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from railrepro.control.problem import MPCSettings, Problem
from railrepro.control.solvers.planner import Planner
from railrepro.control.solvers.riccati import horizon
from railrepro.model import forecast
from railrepro.model.control_model import PSI_TRAX, XDOT, Y, control_model, kept_as_printed
from railrepro.model.forecast import Forecast
from railrepro.schema import between, require
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle


class Solve(NamedTuple):
    """Record of one sample.

    Attributes
    ----------
    seconds : float
        Time of the processor from measured state to torque, forecast included (s): others on the machine do not count.
    iterations : int
    fallback : bool
        Whether a shifted old plan had to serve.
    preparation : float
        The same after the torque was out, for the next sample (s).
    """

    seconds: float
    iterations: int
    fallback: bool
    preparation: float = 0.0


@dataclass
class PredictiveController:
    """Receding horizon around `solve`, with shifted warm starts, fallback and statistics; one running gear.

    Attributes
    ----------
    stats : list of Solve
        One record per sample.
    recorded : list of Problem or None
        Problems as they came, when recording is switched on.
    """

    vehicle: Vehicle
    route: Route
    gear: int
    settings: MPCSettings = field(default_factory=MPCSettings)
    recorded: list | None = None

    def __post_init__(self) -> None:
        require("MPC: vehicle", self.vehicle, Vehicle)
        require("MPC: route", self.route, Route)
        require("MPC: gear", self.gear, between(0, 1), whole=True)
        require("MPC: settings", self.settings, MPCSettings)
        self.stats: list[Solve] = []
        s = self.settings
        self.parameters = control_model(s.variant).parameter_vector(self.vehicle)
        nominal = forecast.nominal_values(self.vehicle, self.gear, printed="D4" in kept_as_printed(s.variant))
        self.horizon = horizon(s, nominal, self.parameters, self.route)
        self.plan_du = np.zeros(s.steps)
        self.offset = 0.0
        self._samples: Planner | None = None
        self._expected_y: float | None = None

    @property
    def period(self) -> float:
        """Sampling time (s)."""
        return self.settings.period

    def problem(self, x_hat: np.ndarray, u_d: float) -> Problem:
        """The optimal control problem at a measured state (6,) and base torque (N m)."""
        self.look_ahead(x_hat, self.known_base_torque(u_d))
        return self._problem_ahead()

    def look_ahead(self, x_hat: np.ndarray, u_d: float) -> None:
        """Put a state, a base torque and the forecast from there into the horizon."""
        self.horizon.sample(x_hat, u_d, self.settings.torque_bound(u_d, self.vehicle.drive.torque_limit))
        self.horizon.forecast()

    def _problem_ahead(self) -> Problem:
        h, tau_max = self.horizon, self.vehicle.drive.torque_limit
        ahead = Forecast(h.x_d.copy(), h.theta.copy())
        return Problem(self.settings, h.x_hat.copy(), h.u_d, ahead, self.parameters, tau_max)

    def optimise(self, problem: Problem, du: np.ndarray) -> tuple[np.ndarray, int]:
        """Torques (L,) that solve any problem from a start, and the number of iterations."""
        self.horizon.sample(problem.x_hat, problem.u_d, problem.bound)
        self.horizon.x_d[:], self.horizon.theta[:] = problem.ahead.x_d, problem.ahead.theta
        return self.solve(du)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Differential torque (N m) for now; a failing solver falls back on the shifted previous plan, counted."""
        if self._samples is not None and self.recorded is None:
            return self._plan_compiled(self._samples, x_hat, u_d)
        begin = time.thread_time()
        self.look_ahead(self.observed(x_hat), self.known_base_torque(u_d))
        if self.recorded is not None:
            self.recorded.append(self._problem_ahead())
        bound, start = self.horizon.bound, self.plan_du
        start[:-1] = start[1:]
        start = start.clip(-bound, bound)
        try:
            du, iterations = self.solve(start)
            fallback = not np.isfinite(du).all()
        except (ArithmeticError, np.linalg.LinAlgError):
            iterations, fallback = 0, True
        self.plan_du = start if fallback else du.clip(-bound, bound)
        self._expected_y = None if fallback else float(self.expected_state()[Y])
        self.stats.append(Solve(time.thread_time() - begin, iterations, fallback))
        return float(self.plan_du[0])

    def _plan_compiled(self, samples: Planner, x_hat: np.ndarray, u_d: float) -> float:
        """`plan` in compiled code; what of the next sample can be done is done when the torque is out."""
        begin = time.thread_time()
        torque, fallback = samples.plan(x_hat, u_d)
        ready = time.thread_time()
        samples.prepare()
        self.stats.append(Solve(ready - begin, 1, fallback, time.thread_time() - ready))
        self.plan_du, self.offset = samples.torques.copy(), samples.offset
        return torque

    def observed(self, x_hat: np.ndarray) -> np.ndarray:
        """Measured state with the yaw angle corrected by the observed offset, see `MPCSettings.observer`."""
        s = self.settings
        if s.observer <= 0:
            return x_hat
        if self._expected_y is not None and x_hat[XDOT] > 1.0:
            self.offset += s.observer * (x_hat[Y] - self._expected_y) / (x_hat[XDOT] * s.period)
        corrected = np.array(x_hat)
        corrected[PSI_TRAX] += self.offset
        return corrected

    def known_base_torque(self, u_d: float) -> float:
        """Base torque that forecast and model get to know (N m), see `MPCSettings.informed`."""
        return u_d if self.settings.informed else 0.0

    def expected_state(self) -> np.ndarray:
        """State that the plan predicts for the next sample, shape (6,)."""
        return self.horizon.x[1]

    def solve(self, du: np.ndarray) -> tuple[np.ndarray, int]:
        """Torques (L,) that solve the problem in the horizon from a start, and the number of iterations."""
        raise NotImplementedError
