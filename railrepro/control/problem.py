"""The optimal control problem of nonlinear and linear time-variant MPC, stated once for all solvers.

Minimise over the differential torques du_0 … du_(L-1) of one running gear
sum T |x_k - x_d,k|_Q^2 + T R du_k^2 + T |x_L - x_d,L|_QL^2 with QL = Q diag(0,0,0,0,q,q).
The states x_k obey the prediction model, and torques stay within their limits. The bound of the lateral position is
soft: exceeding it costs the square of the slack, so no state makes the problem infeasible. The functions for costs take
numbers or CasADi expressions. Source: eqs. (31) and (32) of the paper.
"""

from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, Self

import casadi as ca
import numpy as np
from pydantic import StrictBool

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile.codegen import stored
from railrepro.compile.reciprocals import share_reciprocals
from railrepro.data import above, between, require, table
from railrepro.model.control_model import PSI_TRAX, STATES, TAU_LE, TAU_RI, THETA, Y, control_model, discretise
from railrepro.model.forecast import Forecast
from railrepro.model.parameters import PARAMETERS
from railrepro.quantities import symbols
from railrepro.vehicle.parameters import Drive

LARGEST_WEIGHT = 1e9
WEIGHTS = {f"q_{name}": (above if name == "y_TrAx" else between)(0.0, LARGEST_WEIGHT) for name in STATES}
"""Range of the weight of each state by its name, such as "q_x". The weight of y_TrAx must be above 0."""
TUNING = (*WEIGHTS, "r", "q_terminal", "period", "lateral_bound", "bound_weight")
"""Names of the entries of a tuning vector: weights of the states, then fields of `MPCSettings`."""


class Tuning(NamedTuple):
    """Weights and bounds of the optimal control problem, as numbers or CasADi expressions, with names, meanings and
    units of fields of `MPCSettings`; only `q`, shape (6,), is called `q_diag` there."""

    q: Any
    r: Any
    q_terminal: Any
    period: Any
    lateral_bound: Any
    bound_weight: Any

    @classmethod
    def of(cls, vector) -> Self:
        """Make a `Tuning` from a vector of numbers or symbols, such as from `MPCSettings.tuning`."""
        return cls(vector[: len(STATES)], *(vector[i] for i in range(len(STATES), len(TUNING))))


def stage_cost(x, x_d, slack, t: Tuning):
    """Cost of a state x (6,) before the last one, without the torque: weighted squares of its deviations from the
    desired state x_d (6,) and of the excess `slack` (m) over the lateral bound, times the time step T. As the weights
    cancel the units of the squares, the cost is in s. Source: eq. (31)."""
    return ca.dot(t.q * t.period, (x - x_d) ** 2) + slack_cost(slack, t)


def terminal_cost(x, x_d, slack, t: Tuning):
    """Cost (s) of the last state x (6,): weighted squares of the deviations of y and psi_TrAx from x_d (6,), the
    desired state, and of the excess `slack` (m) over the lateral bound, times the time step. Source: eq. (32)."""
    weighted = [t.q[i] * t.period * t.q_terminal * (x[i] - x_d[i]) ** 2 for i in (Y, PSI_TRAX)]
    return sum(weighted) + slack_cost(slack, t)


def effort_cost(du, t: Tuning):
    """Cost r T du^2 (s) of a differential torque du (N m) over a time step T; r is in 1/(N m)^2. Source: eq. (31)."""
    return t.r * t.period * du**2


def slack_cost(slack, t: Tuning):
    """Cost bound_weight q_y slack^2 T (s) of an excess of `slack` (m) over the lateral bound at one state, with the
    weight q_y (1/m^2) of y, the time step T (s). A square in place of a hard limit keeps every problem feasible."""
    return t.bound_weight * t.q[Y] * t.period * slack**2


def lateral_excess(x, t: Tuning) -> tuple:
    """Excess (m) of y over the upper and over the lower lateral bound at a state x (6,): (y - bound, -y - bound)."""
    return x[Y] - t.lateral_bound, -x[Y] - t.lateral_bound


def slack_on(side, x, t: Tuning):
    """Excess (m) of y over a lateral bound at a state x (6,), negative inside. `side`: 1 upper, -1 lower, 0 none."""
    return side * (x[Y] - side * t.lateral_bound)


@stored
def dynamics(variant: str, discretisation: str) -> ca.Function:
    """Make one time step T of the prediction model as a CasADi function (SI), for a `variant` of the model
    ("corrected", "printed" or errata to keep, as "D1,D3") and a `discretisation` ("euler", "midpoint", "rk4"). It maps
    (x[6], differential torque du, base torque u_d, theta[9], par[14], T, affine) to the next state x_next[6] and its
    derivatives A by x, sparse (6, 6), and B by du [6]. Orders: x `control_model.STATES` (x, psi_Ax, …, psi_TrAx);
    theta, track at the gear, `control_model.THETA` (heading, curvature, …); par, the vehicle,
    `model.parameters.PARAMETERS` (masses, inertias, …). With affine = 1, x_next is the next state of the model. With
    affine = 0, x_next is A x plus each torque, du and u_d, times its derivative: the printed linear model without
    affine term (erratum D6)."""
    step = discretise(control_model(variant), discretisation)
    x, du, u_d, affine = ca.SX.sym("x", len(STATES)), ca.SX.sym("du"), ca.SX.sym("u_d"), ca.SX.sym("affine")
    theta, par, period = ca.SX.sym("theta", len(THETA)), ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("T")
    x_next, a, by_torque = step(x, ca.vertcat(u_d - du, u_d + du), theta, par, period)  # right wheel, left wheel
    by_ri, by_le = by_torque[:, TAU_RI], by_torque[:, TAU_LE]
    b, common = ca.densify(by_le - by_ri), by_ri + by_le
    linear = ca.mtimes(a, x) + b * du + common * u_d
    reported = ca.densify(affine * x_next + (1 - affine) * linear)
    inputs = [x, du, u_d, theta, par, period, affine]
    names = ["x", "du", "u_d", "theta", "par", "T", "affine"], ["x_next", "A", "B"]
    return share_reciprocals(ca.Function("prediction", inputs, [reported, a, b], *names, {"cse": True}))


@stored
def torque_limit() -> ca.Function:
    """Make a CasADi function for the torque limit of a motor (N m). Its inputs are the speed (m/s), the parameters of
    the control model (`PARAMETERS`) and the fields of the motor's data (`Drive`)."""
    speed, par = ca.SX.sym("speed"), ca.SX.sym("par", len(PARAMETERS))
    numbers, drive = symbols(Drive, "drive")
    limit = drive.limit(speed / par[PARAMETERS.index("r_0")])
    return ca.Function("torque_limit", [speed, par, numbers], [ca.SX(limit)])


@table
class MPCSettings:
    """Settings of a predictive controller: weights, horizon, prediction model, soft bound of |y|.

    Attributes:
        q_diag (tuple of 6 float): Weights of the squared deviations of x, psi_Ax, xdot, psidot_Ax, y_TrAx, psi_TrAx,
            each in 1 over the square of its unit (m, rad, m/s, rad/s, m, rad).
        r (float): Weight R of du^2, the squared differential torque (1/(N m)^2).
        q_terminal (float): Factor on the weights of y_TrAx and psi_TrAx at the end of the horizon, where no other state
            counts (-).
        period, steps (float, int): Time step T and sampling time, a whole number of ms (s); number of steps of the
            horizon.
        discretisation (str): Integration method of the prediction model: "euler", "midpoint" or "rk4".
        variant (str): "corrected", "printed" (all errata of the paper) or the errata to keep, as "D1,D3".
        lateral_bound, bound_weight (float): Soft bound of |y_TrAx| (m); weight of its squared excess over the weight of
            y (-).
        yielding (bool): Whether |du| may use the whole motor torque. False: only what the base torque (common to both
            wheels) leaves, as printed, which is 0 at the base torque's limit (erratum D10).
        informed (bool): Whether the forecast knows the base torque. False: it assumes 0.
        previewed (bool): Whether the forecast knows the lateral set point ahead. False: it keeps the present one. The
            track ahead is always known.
        observer (float): Gain of an offset observer (-); 0, as in the paper, is none. Wheels that carry side force roll
            at a creep angle to their heading. The model lacks this angle, which leaves a steady error of y. The
            observer estimates the angle: each sample adds gain (y - predicted y)/(v T) (rad). The controller adds it to
            the measured yaw angle.
    """

    q_diag: tuple[Any, ...] = (0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    r: Annotated[float, above(0.0, 1e9, "1/(N m)^2")] = 1e-11
    q_terminal: Annotated[float, between(0.0, 1e9)] = 1.0
    period: Annotated[float, above(0.0, 1.0, "s")] = 0.010
    steps: Annotated[int, between(2, 1000)] = 30
    discretisation: str = "rk4"
    variant: str = "corrected"
    lateral_bound: Annotated[float, above(0.0, 1.0, "m")] = 8e-3
    bound_weight: Annotated[float, between(0.0, 1e9)] = 100.0
    yielding: StrictBool = True
    informed: StrictBool = True
    previewed: StrictBool = True
    observer: Annotated[float, between(0.0, 1.0)] = 0.0

    def __post_init__(self) -> None:
        if self.period < CONTROL_PERIOD or not round(self.period / CONTROL_PERIOD, 6).is_integer():
            raise ValueError(f"period is {self.period:g} s, a whole number of ms is needed")
        if len(self.q_diag) != len(STATES):
            raise ValueError(f"q_diag is {self.q_diag}, {len(STATES)} weights are needed")
        for weight, (name, allowed) in zip(self.q_diag, WEIGHTS.items(), strict=True):
            require(f"q_diag, {name}", weight, allowed)

    def tuning(self) -> np.ndarray:
        """Weights and bounds as a vector for compiled solvers: the fields of `Tuning` in their order and units."""
        rest = (getattr(self, name) for name in TUNING[len(STATES) :])
        return np.array([*self.q_diag, *rest], dtype=float)


@dataclass(frozen=True)
class Problem:
    """One optimal control problem in numbers (SI): settings; `x_hat`, measured state (6,); `u_d`, base torque per
    wheel; forecast `ahead`; parameters (14,) in the order of `model.parameters.PARAMETERS`; `tau_max`, torque limit of
    a motor."""

    settings: MPCSettings
    x_hat: np.ndarray
    u_d: float
    ahead: Forecast
    parameters: np.ndarray
    tau_max: float

    @property
    def bound(self) -> float:
        """Largest |du| (N m), eq. (31): the motor's limit if the base torque gives way to du, else what it leaves."""
        return self.tau_max if self.settings.yielding else max(self.tau_max - abs(self.u_d), 0.0)
