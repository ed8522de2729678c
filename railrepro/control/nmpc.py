"""Nonlinear MPC: the Ipopt reference as in the paper, a converged Gauss-Newton path, and real-time iteration.

Serves the paper's section Nonlinear Model Predictive Control.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.control.mpc import (
    UNIT,
    MPCSettings,
    PredictiveController,
    Predictor,
    Problem,
    _single_step,
    condense,
    solve,
)
from railrepro.derivation import PARAMETERS
from railrepro.errors import InputError
from railrepro.model import THETA

SOLVERS = ("gauss_newton", "rti", "ipopt")
TOLERANCE = 1e-7
"""Converged when no torque moves by more than this (kN m)."""
ITERATIONS = 30
_SCALE = np.array([1.0, 1e-2, 1.0, 1e-2, 1e-3, 1e-3])
_COST = 1e6


@dataclass
class NMPC(PredictiveController):
    """NMPC of one running gear.

    `solver` is "gauss_newton" (converged, default), "rti" (one iteration per sample on the shifted trajectory) or
    "ipopt" (reference); all minimise the same cost.
    """

    solver: str = "gauss_newton"

    def __post_init__(self):
        super().__post_init__()
        if self.solver not in SOLVERS:
            raise InputError(f"NMPC solver {self.solver!r} is not known; there are {SOLVERS}")
        self._predictor = None if self.solver == "ipopt" else Predictor(self.settings)
        self._reference = _ipopt(self.settings) if self.solver == "ipopt" else None
        self._states = None

    def optimise(self, problem: Problem, du: np.ndarray) -> tuple[np.ndarray, int]:
        """See `PredictiveController.optimise`."""
        if self.solver == "ipopt":
            return self._with_ipopt(problem, du)
        return self._with_gauss_newton(problem, du, 1 if self.solver == "rti" else ITERATIONS)

    def _with_gauss_newton(self, problem: Problem, du: np.ndarray, most: int) -> tuple[np.ndarray, int]:
        states = problem.ahead.x_d.copy() if self._states is None else self._shifted(problem)
        iteration = 0
        while iteration < most:
            iteration += 1
            self._predictor(states[:, :-1], du, problem)
            gaps = self._predictor.x_next - states[:, 1:].T
            qp = condense(problem, self._predictor, states, du, gaps)
            step = solve(qp, np.zeros(du.size))
            states[:, 1:] += (qp.sensitivity @ step + qp.drift).T
            states[:, 0] = problem.x_hat
            du = du + UNIT * step
            if np.abs(step).max() < TOLERANCE and np.abs(gaps).max() < 1e-9:
                break
        else:
            if most > 1:
                self._states = None
                raise ArithmeticError("Gauss-Newton did not converge")
        self._states = states
        return du, iteration

    def _shifted(self, problem: Problem) -> np.ndarray:
        """Previous trajectory one sample later; its end follows the desired state."""
        states = np.empty_like(self._states)
        states[:, :-1], states[:, -1] = self._states[:, 1:], problem.ahead.x_d[:, -1]
        states[:, 0] = problem.x_hat
        return states

    def _with_ipopt(self, problem: Problem, du: np.ndarray) -> tuple[np.ndarray, int]:
        s, steps = problem.settings, problem.settings.steps
        x_d, bound = problem.ahead.x_d, problem.bound / UNIT
        if self._states is None:
            self._states = np.zeros((6, steps + 1))
        start = np.concatenate([self._states.T.ravel(), du / UNIT, np.zeros(steps)])
        initial = (problem.x_hat - x_d[:, 0]) / _SCALE
        free = np.full(6 * steps, np.inf)
        low = np.concatenate([initial, -free, np.full(steps, -bound), np.zeros(steps)])
        high = np.concatenate([initial, free, np.full(steps, bound), np.full(steps, np.inf)])
        p = np.concatenate(
            [x_d.T.ravel(), problem.ahead.theta[:, :-1].T.ravel(), problem.parameters, s.q_diag]
            + [[s.r, s.q_terminal, s.period, problem.u_d, s.lateral_bound, s.bound_weight * s.q_diag[4]]]
        )
        defects = np.zeros(6 * steps)
        found = self._reference(
            x0=start, p=p, lbx=low, ubx=high,
            lbg=np.concatenate([defects, np.full(2 * steps, -np.inf)]), ubg=np.zeros(8 * steps),
        )  # fmt: skip
        stats = self._reference.stats()
        if not stats["success"]:
            self._states = None
            raise ArithmeticError(f"Ipopt ended with {stats['return_status']}")
        solution = np.array(found["x"]).ravel()
        self._states = solution[: 6 * (steps + 1)].reshape(steps + 1, 6).T
        return UNIT * solution[6 * (steps + 1) :][:steps], stats["iter_count"]


@lru_cache
def _ipopt_cached(variant: str, discretisation: str, steps: int) -> ca.Function:
    """Multiple-shooting NLP; states as scaled deviations from the desired ones, torques in kN m, slacks in mm."""
    step = _single_step(variant, discretisation)
    z, du, slack = ca.MX.sym("z", 6, steps + 1), ca.MX.sym("du", steps), ca.MX.sym("slack", steps)
    x_d, theta = ca.MX.sym("x_d", 6, steps + 1), ca.MX.sym("theta", len(THETA), steps)
    par, q, rest = ca.MX.sym("par", len(PARAMETERS)), ca.MX.sym("q", 6), ca.MX.sym("rest", 6)
    r, q_terminal, period, u_d, bound, soft = ca.vertsplit(rest)
    states = x_d + ca.repmat(ca.DM(_SCALE), 1, steps + 1) * z
    cost, defects, sides = 0, [], []
    for k in range(steps):
        torque = UNIT * du[k]
        x_next = step(states[:, k], ca.vertcat(u_d - torque, u_d + torque), theta[:, k], par, period)
        defects.append((x_next - states[:, k + 1]) / _SCALE)
        error = states[:, k + 1] - x_d[:, k + 1]
        weight = q * ca.vertcat(0, 0, 0, 0, q_terminal, q_terminal) if k == steps - 1 else q
        cost += period * (ca.dot(weight, error**2) + r * torque**2 + soft * (1e-3 * slack[k]) ** 2)
        y = states[4, k + 1]
        sides += [1e3 * (y - bound) - slack[k], 1e3 * (-y - bound) - slack[k]]
    problem = {
        "x": ca.vertcat(ca.vec(z), du, slack),
        "p": ca.vertcat(ca.vec(x_d), ca.vec(theta), par, q, rest),
        "f": _COST * cost,
        "g": ca.vertcat(*defects, *sides),
    }
    quiet = {"print_time": False, "expand": True, "error_on_fail": False}
    quiet |= {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9}
    return ca.nlpsol("nmpc", "ipopt", problem, quiet)


def _ipopt(settings: MPCSettings) -> ca.Function:
    return _ipopt_cached(settings.variant, settings.discretisation, settings.steps)
