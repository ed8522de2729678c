"""Linear time-variant MPC: the model linearised in centred riding along the forecast, one QP per sample.

By default the linearisation is about the track direction and keeps its affine term; the printed one (psi_Ax = 0, no
affine term, D6) is selectable. Serves the paper's section Linear Time-Variant Model Predictive Control.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from railrepro.control.mpc import UNIT, PredictiveController, Predictor, Problem, condense, solve


@dataclass
class LTVMPC(PredictiveController):
    """LTV-MPC of one running gear; `printed` keeps discrepancy D6."""

    printed: bool = False

    def __post_init__(self):
        super().__post_init__()
        self._predictor = Predictor(self.settings)

    def optimise(self, problem: Problem, du: np.ndarray) -> tuple[np.ndarray, int]:
        """See `PredictiveController.optimise`."""
        steps, x_d, theta = problem.settings.steps, problem.ahead.x_d, problem.ahead.theta
        states = np.zeros((6, steps + 1))
        states[0], states[2] = x_d[0], x_d[2]
        if not self.printed:
            states[1], states[3] = theta[0], theta[1] * x_d[2]
        still = np.zeros(steps)
        self._predictor(states[:, :-1], still, problem)
        if self.printed:
            gaps = self._linear_part(problem, states) - states[:, 1:].T
        else:
            gaps = self._predictor.x_next - states[:, 1:].T
        qp = condense(problem, self._predictor, states, still, gaps)
        return UNIT * solve(qp, du / UNIT), 1

    def _linear_part(self, problem: Problem, states: np.ndarray) -> np.ndarray:
        """A x_lin + B u_lin without the affine term, shape (L, 6). Source: eq. (lin_model)."""
        a, steps = self._predictor.a, problem.settings.steps
        linear = np.einsum("kij,jk->ki", a, states[:, :-1])
        base = self._base_torque_gain(problem, states, steps)
        return linear + base * problem.u_d

    def _base_torque_gain(self, problem: Problem, states: np.ndarray, steps: int) -> np.ndarray:
        """Derivative of the next state with respect to the common torque of both wheels (linear), shape (L, 6)."""
        here = self._predictor.x_next.copy()
        self._predictor(states[:, :-1], np.zeros(steps), replace(problem, u_d=problem.u_d + 1.0))
        gain = self._predictor.x_next - here
        self._predictor(states[:, :-1], np.zeros(steps), problem)
        return gain
