"""Nonlinear MPC: the Ipopt reference as in the paper, a converged Gauss-Newton path, and real-time iteration.

Serves the paper's section Nonlinear Model Predictive Control.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from railrepro.control.predictive import PredictiveController, Solve
from railrepro.control.solvers import ipopt
from railrepro.control.solvers.planner import planner
from railrepro.errors import InputError
from railrepro.model.control_model import Y

SOLVERS = ("gauss_newton", "rti", "ipopt")
TOLERANCE = 1e-4
"""Converged when no torque moves by more than this (N m)."""
ITERATIONS = 30


@dataclass
class NMPC(PredictiveController):
    """NMPC of one running gear.

    `solver` is "gauss_newton" (converged, default), "rti" (one iteration per sample on the shifted trajectory, prepared
    before the state is measured) or "ipopt" (reference); all minimise the same cost.
    """

    solver: str = "gauss_newton"

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise InputError(f"NMPC solver {self.solver!r} is not known; there are {SOLVERS}")
        super().__post_init__()
        self._started = False
        if self.solver == "rti":
            self._samples = planner(self.horizon, self.vehicle.drive.torque_limit, linear=False)

    def solve(self, du: np.ndarray) -> tuple[np.ndarray, int]:
        """See `PredictiveController.solve`."""
        self._shift()
        if self.solver == "ipopt":
            return self._with_ipopt(du)
        self.horizon.x[0], self.horizon.u[:] = self.horizon.x_hat, du
        return self._iterate(1 if self.solver == "rti" else ITERATIONS)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """See `PredictiveController.plan`; real-time iteration does all but the last quadratic problem beforehand."""
        if self.solver != "rti" or self.recorded is not None or self._samples is not None:
            return super().plan(x_hat, u_d)
        begin = time.thread_time()
        x_hat, u_d = self.observed(x_hat), self.known_base_torque(u_d)
        if not self._started:
            self._prepare(x_hat, u_d)
        horizon, bound = self.horizon, self.settings.torque_bound(u_d, self.vehicle.drive.torque_limit)
        horizon.sample(x_hat, u_d, bound)
        try:
            horizon.solve()
            horizon.apply()
            self._started = True
        except (ArithmeticError, np.linalg.LinAlgError):
            # The plan, already one sample later, serves; the next one starts afresh.
            horizon.u[:] = horizon.u.clip(-bound, bound)
            self._started = False
        self.plan_du = horizon.u.copy()
        ready = time.thread_time()
        self._expected_y = None
        if self._started:
            expected = self.expected_state().copy()
            self._expected_y = float(expected[Y])
            self._prepare(expected, u_d)
        self.stats.append(Solve(ready - begin, 1, not self._started, time.thread_time() - ready))
        return float(self.plan_du[0])

    def _prepare(self, x_expected: np.ndarray, u_d: float) -> None:
        """Forecast and linearise for the sample to come, where the state is expected to be `x_expected`."""
        horizon = self.horizon
        self.look_ahead(x_expected, u_d)
        self._shift()
        horizon.x[0] = x_expected
        horizon.u[:-1] = horizon.u[1:].copy()
        horizon.linearise()

    def _iterate(self, most: int) -> tuple[np.ndarray, int]:
        try:
            iterations = self.horizon.iterate(most, TOLERANCE)
        except ArithmeticError:
            self._started = False
            raise
        self._started = True
        return self.horizon.u.copy(), iterations

    def _shift(self) -> None:
        """Previous trajectory one sample later, its end on the desired state; the desired states at the start."""
        horizon = self.horizon
        if self._started:
            horizon.x[:-1], horizon.x[-1] = horizon.x[1:].copy(), horizon.x_d[-1]
        else:
            horizon.x[:] = horizon.x_d

    def _with_ipopt(self, du: np.ndarray) -> tuple[np.ndarray, int]:
        try:
            found = ipopt.solve(ipopt.solver(self.settings), self.horizon, self.parameters, du)
        except ArithmeticError:
            self._started = False
            raise
        self._started = True
        return found
