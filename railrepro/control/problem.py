"""What nonlinear and linear time-variant MPC minimise: settings and the optimal control problem.

Minimised over the differential torques du_0 … du_(L-1) of one running gear:
sum T |x_k - x_d,k|_Q^2 + T R du_k^2 + T |x_L - x_d,L|_QL^2 with QL = Q diag(0,0,0,0,q,q), torques within their limits,
lateral position within a bound that is soft (quadratic slack), so that no state makes it infeasible.

Serves eqs. (constraints) and (terminal_cost) of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from railrepro.control.solvers.riccati import model_function
from railrepro.errors import InputError
from railrepro.model.control_model import Y
from railrepro.model.forecast import Forecast


@dataclass(frozen=True)
class MPCSettings:
    """Tuning of a predictive controller.

    Attributes
    ----------
    q_diag : tuple of 6 floats
        Diagonal of Q in the order of the states (1/m^2, 1/rad^2, …).
    r : float
        Weight R on du^2 (1/(N m)^2).
    q_terminal : float
        Factor q of the terminal cost (-).
    period : float
        Time step T = sampling time (s).
    steps : int
        Horizon length L.
    discretisation : str
        See `railrepro.model.control_model.discretise`.
    variant : str
        Prediction model and forecast, see `railrepro.model.control_model.control_model`.
    lateral_bound : float
        Bound of |y_TrAx| (m).
    bound_weight : float
        Weight of its violation relative to the weight of y (-).
    yielding : bool
        The differential torque may use the whole motor torque and the base torque yields, as the integration rule has
        it. False bounds it by what the base torque leaves, as printed, which is nothing when the base torque is at its
        limit (D10).
    informed : bool
        The base torque is known to the forecast and the model; False leaves it out.
    observer : float
        Share of the prediction error of y per sample that is taken for a constant angle between where the axle points
        and where it goes (creep); 0 is the paper's controller, which drifts.
    """

    q_diag: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    r: float = 1e-11
    q_terminal: float = 1.0
    period: float = 0.010
    steps: int = 30
    discretisation: str = "rk4"
    variant: str = "corrected"
    lateral_bound: float = 8e-3
    bound_weight: float = 100.0
    yielding: bool = True
    informed: bool = True
    observer: float = 0.0

    def __post_init__(self):
        if len(self.q_diag) != 6 or min(self.q_diag) < 0 or self.q_diag[Y] <= 0 or self.r <= 0:
            raise InputError(
                f"MPC weights: q_diag = {self.q_diag}, r = {self.r}; six weights not below 0, those of y and du above, "
                "are needed"
            )
        if self.steps < 2 or self.period <= 0:
            raise InputError(f"MPC horizon: {self.steps} steps of {self.period} s; 2 or more above 0 s are needed")

    def weights(self) -> np.ndarray:
        """State weights T Q of the stages 1 … L, terminal cost included, shape (L, 6)."""
        stage = np.tile(self.q_diag, (self.steps, 1)) * self.period
        stage[-1] *= (0.0, 0.0, 0.0, 0.0, self.q_terminal, self.q_terminal)
        return stage

    @property
    def soft_weight(self) -> float:
        """Weight of the squared violation of the lateral bound in a stage (s/m^2)."""
        return self.bound_weight * self.q_diag[Y] * self.period

    def torque_bound(self, u_d: float, tau_max: float) -> float:
        """Largest |du| (N m) at a base torque and a torque limit (N m), see `yielding`."""
        return tau_max if self.yielding else max(tau_max - abs(u_d), 0.0)


@dataclass(frozen=True)
class Problem:
    """One optimal control problem, self-contained so that it can be recorded and solved again by another solver."""

    settings: MPCSettings
    x_hat: np.ndarray
    u_d: float
    ahead: Forecast
    parameters: np.ndarray
    tau_max: float

    @property
    def bound(self) -> float:
        """Largest |du| allowed (N m)."""
        return self.settings.torque_bound(self.u_d, self.tau_max)

    def cost(self, states: np.ndarray, du: np.ndarray) -> float:
        """Cost of predicted states (L + 1, 6) and torques (L,), without the constant stage 0."""
        s = self.settings
        error = (states - self.ahead.x_d)[1:]
        over = np.maximum(np.abs(states[1:, Y]) - s.lateral_bound, 0)
        soft = s.soft_weight * np.sum(over**2)
        return float(np.sum(s.weights() * error**2) + s.r * s.period * np.sum(du**2) + soft)

    def roll_out(self, du: np.ndarray) -> np.ndarray:
        """Predicted states under torques (L,) from the measured state, shape (L + 1, 6)."""
        s = self.settings
        step, states = model_function(s.variant, s.discretisation), [self.x_hat]
        for torque, theta in zip(du, self.ahead.theta[:-1], strict=True):
            x_next, *_ = step(states[-1], torque, self.u_d, theta, self.parameters, s.period, 1.0)
            states.append(np.array(x_next).ravel())
        return np.array(states)
