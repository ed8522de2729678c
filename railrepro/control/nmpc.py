"""Nonlinear MPC: the Ipopt reference as in the paper, a converged Gauss-Newton path, and real-time iteration.

Serves the paper's section Nonlinear Model Predictive Control.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.control.condensed import UNIT
from railrepro.control.horizon import model_function
from railrepro.control.mpc import MPCSettings, PredictiveController, Solve
from railrepro.derivation import PARAMETERS
from railrepro.errors import InputError
from railrepro.model import THETA, Y

SOLVERS = ("gauss_newton", "rti", "ipopt")
TOLERANCE = 1e-4
"""Converged when no torque moves by more than this (N m)."""
ITERATIONS = 30
_SCALE = np.array([1.0, 1e-2, 1.0, 1e-2, 1e-3, 1e-3])
_COST = 1e6


@dataclass
class NMPC(PredictiveController):
    """NMPC of one running gear.

    `solver` is "gauss_newton" (converged, default), "rti" (one iteration per sample on the shifted trajectory, prepared
    before the state is measured) or "ipopt" (reference); all minimise the same cost.
    """

    solver: str = "gauss_newton"

    def __post_init__(self):
        super().__post_init__()
        if self.solver not in SOLVERS:
            raise InputError(f"NMPC solver {self.solver!r} is not known; there are {SOLVERS}")
        self._reference = _ipopt(self.settings) if self.solver == "ipopt" else None
        self._started = False

    def solve(self, du: np.ndarray) -> tuple[np.ndarray, int]:
        """See `PredictiveController.solve`."""
        self._shift()
        if self.solver == "ipopt":
            return self._with_ipopt(du)
        self.horizon.x[0], self.horizon.u[:] = self.horizon.x_hat, du
        return self._iterate(1 if self.solver == "rti" else ITERATIONS)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """See `PredictiveController.plan`; real-time iteration does all but the last quadratic problem beforehand."""
        if self.solver != "rti" or self.recorded is not None:
            return super().plan(x_hat, u_d)
        begin = time.perf_counter()
        x_hat, u_d = self.observed(x_hat), self.told(u_d)
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
            horizon.u[:], horizon.x[1] = horizon.u.clip(-bound, bound), x_hat
            self._started = False
        self.plan_du = horizon.u.copy()
        ready = time.perf_counter()
        expected = self.expected_state().copy()
        self._expected_y = float(expected[Y]) if self._started else None
        self._prepare(expected, u_d)
        self.stats.append(Solve(ready - begin, 1, not self._started, time.perf_counter() - ready))
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
        s, steps, horizon = self.settings, self.settings.steps, self.horizon
        x_d, bound = horizon.x_d, horizon.bound / UNIT
        deviation = (horizon.x - x_d) / _SCALE
        start = np.concatenate([deviation.ravel(), du / UNIT, np.zeros(steps)])
        initial = (horizon.x_hat - x_d[0]) / _SCALE
        free = np.full(6 * steps, np.inf)
        low = np.concatenate([initial, -free, np.full(steps, -bound), np.zeros(steps)])
        high = np.concatenate([initial, free, np.full(steps, bound), np.full(steps, np.inf)])
        p = np.concatenate(
            [x_d.ravel(), horizon.theta[:-1].ravel(), self.parameters, s.q_diag]
            + [[s.r, s.q_terminal, s.period, horizon.u_d, s.lateral_bound, s.soft_weight / s.period]]
        )
        defects = np.zeros(6 * steps)
        found = self._reference(
            x0=start, p=p, lbx=low, ubx=high,
            lbg=np.concatenate([defects, np.full(2 * steps, -np.inf)]), ubg=np.zeros(8 * steps),
        )  # fmt: skip
        stats = self._reference.stats()
        if not stats["success"]:
            self._started = False
            raise ArithmeticError(f"Ipopt ended with {stats['return_status']}")
        solution = np.array(found["x"]).ravel()
        horizon.x[:] = x_d + solution[: 6 * (steps + 1)].reshape(steps + 1, 6) * _SCALE
        self._started = True
        return UNIT * solution[6 * (steps + 1) :][:steps], stats["iter_count"]


@lru_cache
def _ipopt_cached(variant: str, discretisation: str, steps: int) -> ca.Function:
    """Multiple-shooting NLP; states as scaled deviations from the desired ones, torques in kN m, slacks in mm."""
    step = model_function(variant, discretisation)
    z, du, slack = ca.MX.sym("z", 6, steps + 1), ca.MX.sym("du", steps), ca.MX.sym("slack", steps)
    x_d, theta = ca.MX.sym("x_d", 6, steps + 1), ca.MX.sym("theta", len(THETA), steps)
    par, q, rest = ca.MX.sym("par", len(PARAMETERS)), ca.MX.sym("q", 6), ca.MX.sym("rest", 6)
    r, q_terminal, period, u_d, bound, soft = ca.vertsplit(rest)
    states = x_d + ca.repmat(ca.DM(_SCALE), 1, steps + 1) * z
    cost, defects, sides = 0, [], []
    for k in range(steps):
        torque = UNIT * du[k]
        x_next, *_ = step(states[:, k], torque, u_d, theta[:, k], par, period, 1)
        defects.append((x_next - states[:, k + 1]) / _SCALE)
        error = states[:, k + 1] - x_d[:, k + 1]
        weight = q * ca.vertcat(0, 0, 0, 0, q_terminal, q_terminal) if k == steps - 1 else q
        cost += period * (ca.dot(weight, error**2) + r * torque**2 + soft * (1e-3 * slack[k]) ** 2)
        y = states[Y, k + 1]
        sides += [1e3 * (y - bound) - slack[k], 1e3 * (-y - bound) - slack[k]]
    problem = {
        "x": ca.vertcat(ca.vec(z), du, slack),
        "p": ca.vertcat(ca.vec(x_d), ca.vec(theta), par, q, rest),
        "f": _COST * cost,
        "g": ca.vertcat(*defects, *sides),
    }
    quiet = {"print_time": False, "expand": True, "error_on_fail": False}
    quiet |= {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.bound_relax_factor": 0.0}
    return ca.nlpsol("nmpc", "ipopt", problem, quiet)


def _ipopt(settings: MPCSettings) -> ca.Function:
    return _ipopt_cached(settings.variant, settings.discretisation, settings.steps)
