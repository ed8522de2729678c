"""The optimal control problem of nonlinear and linear time-variant MPC, stated once: all solvers are derived from it.

Minimise over the differential torques du_0 … du_(L-1) of one running gear
sum T |x_k - x_d,k|_Q^2 + T R du_k^2 + T |x_L - x_d,L|_QL^2 with QL = Q diag(0,0,0,0,q,q), with the states of the
prediction model, torques within their limits, and the lateral position within a bound that is soft (a quadratic cost on
the slack), so that no state makes it infeasible.

The costs are expressions: they take numbers or CasADi symbols, and `Tuning` names what they weigh with. Serves
eqs. (31) and (32) of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile.codegen import stored
from railrepro.compile.reciprocals import share_reciprocals
from railrepro.data import InputError, above, between, check_fields, require
from railrepro.model.control_model import (
    INPUTS,
    PSI_TRAX,
    STATES,
    TAU_LE,
    TAU_RI,
    THETA,
    Y,
    control_model,
    discretise,
)
from railrepro.model.forecast import Forecast
from railrepro.model.parameters import PARAMETERS
from railrepro.quantities import symbols
from railrepro.vehicle.parameters import Drive

_WEIGHTS = ("q_x", "q_psi_Ax", "q_xdot", "q_psidot_Ax", "q_y_TrAx", "q_psi_TrAx")
TUNING = (*_WEIGHTS, "r", "q_terminal", "period", "lateral_bound", "bound_weight")
"""Names of the entries of a tuning vector: those fields of `MPCSettings` that weigh costs or bound states."""
LARGEST_WEIGHT = 1e9
"""Largest weight of a state over that of y (1/m^2)."""
WEIGHTS = dict.fromkeys(_WEIGHTS, between(0.0, LARGEST_WEIGHT)) | {"q_y_TrAx": above(0.0, LARGEST_WEIGHT)}
"""Range of each weight of a state, by its name in `TUNING`."""


class Tuning(NamedTuple):
    """Weights and bounds of the optimal control problem, as numbers or CasADi expressions. The fields are those of
    `MPCSettings` with the same names; `q` (6,) is its `q_diag`."""

    q: Any
    r: Any
    q_terminal: Any
    period: Any
    lateral_bound: Any
    bound_weight: Any

    @classmethod
    def of(cls, vector) -> Tuning:
        """`Tuning` from a vector in the order of `TUNING`."""
        return cls(vector[: len(STATES)], *(vector[i] for i in range(len(STATES), len(TUNING))))


def stage_cost(x, x_d, slack, t: Tuning):
    """Cost (s) of a state before the last one, with the weights `t`; the torque is not included. Source: eq. (31). `x`
    and `x_d` are state and desired state, shape (6,) (SI); `slack` (m) is the excess over the lateral bound."""
    return ca.dot(t.q * t.period, (x - x_d) ** 2) + slack_cost(slack, t)


def terminal_cost(x, x_d, slack, t: Tuning):
    """Cost (s) of the last state: only y and psi_TrAx count. Arguments as in `stage_cost`. Source: eq. (32)."""
    weighed = [t.q[i] * t.period * t.q_terminal * (x[i] - x_d[i]) ** 2 for i in (Y, PSI_TRAX)]
    return sum(weighed) + slack_cost(slack, t)


def effort_cost(du, t: Tuning):
    """Cost (s) of a differential torque `du` (N m) over one time step, with the weights `t`. Source: eq. (31)."""
    return t.r * t.period * du**2


def slack_cost(slack, t: Tuning):
    """Cost (s: a number per second times the time step) of exceeding the lateral bound by `slack` (m) at one state."""
    return t.bound_weight * t.q[Y] * t.period * slack**2


def lateral_excess(x, t: Tuning) -> tuple:
    """Excess of y over the upper and the lower lateral bound of `t` at a state x (6,): (y - bound, -y - bound) (m)."""
    return x[Y] - t.lateral_bound, -x[Y] - t.lateral_bound


def slack_on(side, x, t: Tuning):
    """Slack (m) at a state x (6,): for `side` 1 (upper bound) y - bound, for -1 (lower) -y - bound, for 0 (none) 0."""
    return side * (x[Y] - side * t.lateral_bound)


@stored
def dynamics(variant: str, discretisation: str) -> ca.Function:
    """CasADi function of one time step of the prediction model with its derivatives (SI).

    It maps (state x[6], differential torque du, base torque u_d, theta[9], par[14], step T, affine) to the next state
    x_next[6], its derivative A by x, sparse (6, 6), and its derivative B by du [6]. With affine = 1, x_next is the next
    state of the model. With affine = 0 it is A x + B u, the printed linear model without affine term (D6).

    Args:
        variant, discretisation (str): As in `MPCSettings`.
    """
    step = discretise(control_model(variant), discretisation)
    x, du, u_d, affine = ca.SX.sym("x", len(STATES)), ca.SX.sym("du"), ca.SX.sym("u_d"), ca.SX.sym("affine")
    theta, par, period = ca.SX.sym("theta", len(THETA)), ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("T")
    torques = {"tau_ri": u_d - du, "tau_le": u_d + du}
    x_next, a, by_torque = step(x, ca.vertcat(*(torques[name] for name in INPUTS)), theta, par, period)
    by_ri, by_le = by_torque[:, TAU_RI], by_torque[:, TAU_LE]
    b, common = ca.densify(by_le - by_ri), by_ri + by_le
    linear = ca.mtimes(a, x) + b * du + common * u_d
    reported = ca.densify(affine * x_next + (1 - affine) * linear)
    inputs = [x, du, u_d, theta, par, period, affine]
    names = ["x", "du", "u_d", "theta", "par", "T", "affine"], ["x_next", "A", "B"]
    return share_reciprocals(ca.Function("prediction", inputs, [reported, a, b], *names, {"cse": True}))


@stored
def torque_limit() -> ca.Function:
    """CasADi function (speed (m/s), par in the order of `PARAMETERS`, fields of `Drive` (SI)) -> torque limit (N m)."""
    speed, par = ca.SX.sym("speed"), ca.SX.sym("par", len(PARAMETERS))
    numbers, drive = symbols(Drive, "drive")
    limit = drive.limit(speed / par[PARAMETERS.index("r_0")])
    return ca.Function("torque_limit", [speed, par, numbers], [ca.SX(limit)])


@dataclass(frozen=True)
class MPCSettings:
    """Settings of a predictive controller: weights, horizon, prediction model, bounds. InputError for a wrong value."""

    q_diag: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    """Diagonal of Q, 6 numbers in the order of the states (1/m^2, 1/rad^2, s^2/m^2, s^2/rad^2, 1/m^2, 1/rad^2)."""
    r: Annotated[float, above(0.0, 1e9, "1/(N m)^2")] = 1e-11
    """Weight R of du^2 (1/(N m)^2)."""
    q_terminal: Annotated[float, between(0.0, 1e9)] = 1.0
    """Factor q of the terminal cost (-)."""
    period: Annotated[float, above(0.0, 1.0, "s")] = 0.010
    """Time step T and sampling time (s), a whole number of ms."""
    steps: Annotated[int, between(2, 1000)] = 30
    """Horizon length L, number of time steps."""
    discretisation: str = "rk4"
    """Integration method: "euler", "midpoint" or "rk4", see `railrepro.model.control_model.discretise`."""
    variant: str = "corrected"
    """Variant of prediction model and forecast, see `railrepro.model.control_model.control_model`."""
    lateral_bound: Annotated[float, above(0.0, 1.0, "m")] = 8e-3
    """Soft bound of |y_TrAx| (m)."""
    bound_weight: Annotated[float, between(0.0, 1e9)] = 100.0
    """Weight of the squared slack of the lateral bound over the weight of y (-)."""
    yielding: bool = True
    """True: |du| may use the whole motor torque, and the base torque yields, as in `allocate`. False: |du| is limited
    to what the base torque leaves, as printed, which is nothing when the base torque is at its limit (D10)."""
    informed: bool = True
    """Whether forecast and prediction model know the base torque; False: they take it as 0."""
    observer: Annotated[float, between(0.0, 1.0)] = 0.0
    """Gain of the offset observer (-). It estimates the angle between axle and direction of motion (creep, rad): each
    sample adds gain * (y - predicted y)/(v T). 0: no such estimate, as in the paper, and the prediction drifts."""

    def __post_init__(self) -> None:
        check_fields(self)
        if self.period < CONTROL_PERIOD or not round(self.period / CONTROL_PERIOD, 6).is_integer():
            raise InputError(f"MPCSettings: period is {self.period:g} s, a whole number of ms is needed")
        q = self.q_diag
        if not isinstance(q, tuple | list) or len(q) != len(STATES):
            raise InputError(f"MPCSettings: q_diag is {q!r}, {len(STATES)} weights are needed")
        for weight, (name, allowed) in zip(q, WEIGHTS.items(), strict=True):
            require(f"MPCSettings: q_diag, {name}", weight, allowed)

    def tuning(self) -> np.ndarray:
        """These settings as a vector in the order of `TUNING`, in the units of the fields."""
        rest = (getattr(self, name) for name in TUNING[len(STATES) :])
        return np.array([*self.q_diag, *rest], dtype=float)


@dataclass(frozen=True)
class Problem:
    """One optimal control problem with all its numbers, so that any solver can solve it again.

    Attributes:
        settings (MPCSettings): Weights, horizon, bounds.
        x_hat (ndarray, shape (6,)): Measured state (SI).
        u_d (float): Base torque per wheel (N m).
        ahead (Forecast): Desired states and track over the horizon.
        parameters (ndarray, shape (14,)): In the order of `model.parameters.PARAMETERS` (SI).
        tau_max (float): Torque limit of a motor (N m).
    """

    settings: MPCSettings
    x_hat: np.ndarray
    u_d: float
    ahead: Forecast
    parameters: np.ndarray
    tau_max: float

    @property
    def bound(self) -> float:
        """Largest |du| (N m): `tau_max`, or without `yielding` tau_max - |u_d|, at least 0. Source: eq. (31)."""
        return self.tau_max if self.settings.yielding else max(self.tau_max - abs(self.u_d), 0.0)
