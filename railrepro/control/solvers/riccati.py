"""The compiled horizon: forecast, linearisation and Riccati recursion of one sample, without Python between stages.

One optimal control problem needs one call. The time grows linearly with the horizon; torque limits and the soft lateral
bound are active sets around the recursion. `riccati.c` drives the functions generated here; without a C compiler the
condensed problem of `condensed` gives the same minimisers.

Source: Rao, Wright and Rawlings 1998 (recursion); Hintermueller, Ito and Kunisch 2002 (primal-dual active sets).
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro.compile import codegen
from railrepro.control.solvers import condensed
from railrepro.model import forecast
from railrepro.model.control_model import STATES, THETA, Y, control_model, sensitivities
from railrepro.model.derivation import PARAMETERS
from railrepro.track import route

_N = len(STATES)
_UNSETTLED, _DIVERGED = 2, 3
MOST_SETS = 30
"""Active sets tried per quadratic problem before it is handed to a general QP solver."""
_FIELDS = ("x_d", "theta", "x", "u", "x_next", "a", "b", "cost_matrix", "cost_vector")
_FIELDS += ("feedback", "feedforward", "dx", "du", "slope", "fixed", "side")


class _Horizon(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_longlong) for name in ("steps", "n_cell", "n_cells", "most_sets")),
        *((name, ctypes.c_double) for name in ("cell_start", "cell_step")),
        ("cells", ctypes.c_void_p),
        *((name, codegen.Call) for name in ("place", "preview", "terminal", "backward", "forward")),
        *((name, ctypes.c_void_p) for name in ("x_hat", "believed", "par")),
        *((name, ctypes.c_double) for name in ("u_d", "period", "affine")),
        ("weight", ctypes.c_void_p),
        *((name, ctypes.c_double) for name in ("effort", "bound", "y_bound", "soft")),
        *((name, ctypes.c_void_p) for name in _FIELDS),
    ]


@lru_cache
def model_function(variant: str, discretisation: str) -> ca.Function:
    """One step of the prediction model with derivatives.

    Returns
    -------
    casadi.Function
        (x[6], du, u_d, theta[9], par, T, affine) -> x_next[6], A (sparse), B[6]. With affine = 0, x_next is the printed
        linear model A x + B u, which drops the affine term (D6).
    """
    step = sensitivities(control_model(variant), discretisation)
    x, du, u_d, affine = ca.SX.sym("x", _N), ca.SX.sym("du"), ca.SX.sym("u_d"), ca.SX.sym("affine")
    theta, par, period = ca.SX.sym("theta", len(THETA)), ca.SX.sym("par", len(PARAMETERS)), ca.SX.sym("T")
    x_next, a, by_torque = step(x, ca.vertcat(u_d - du, u_d + du), theta, par, period)
    b, common = ca.densify(by_torque[:, 1] - by_torque[:, 0]), by_torque[:, 0] + by_torque[:, 1]
    linear = ca.mtimes(a, x) + b * du + common * u_d
    reported = ca.densify(affine * x_next + (1 - affine) * linear)
    inputs = [x, du, u_d, theta, par, period, affine]
    names = ["x", "du", "u_d", "theta", "par", "T", "affine"], ["x_next", "A", "B"]
    return ca.Function("prediction", inputs, [reported, a, b], *names, {"cse": True})


def _state_cost(x, x_d, weight, side, y_bound, soft):
    """Hessian and gradient (both halved) of |x - x_d|_W^2 + soft (y - side y_bound)^2 where `side` is not 0."""
    hessian, gradient = ca.diag(weight), weight * (x - x_d)
    beyond = soft * side**2
    hessian[Y, Y] += beyond
    gradient[Y] += beyond * (x[Y] - side * y_bound)
    return ca.densify(hessian), gradient


@lru_cache
def recursion(variant: str, discretisation: str) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Last stage, one stage backward and one stage forward of the Riccati recursion about a trajectory."""
    n, sparsity = _N, model_function(variant, discretisation).sparsity_out(1)
    names = ("p", "x_plus", "x_next", "b", "x", "x_d", "weight", "dx", "feedback")
    v = {name: ca.SX.sym(name, n) for name in names}
    names = ("u", "effort", "fixed", "to_bound", "side", "y_bound", "soft", "ff")
    s = {name: ca.SX.sym(name) for name in names}
    matrix, a = ca.SX.sym("P", n, n), ca.SX.sym("A", sparsity)
    state = [v["x"], v["x_d"], v["weight"], s["side"], s["y_bound"], s["soft"]]
    hessian, gradient = _state_cost(*state)
    terminal = ca.Function("riccati_terminal", state, [hessian, gradient], {"cse": True})

    gap = v["x_next"] - v["x_plus"]
    free = 1 - s["fixed"] ** 2
    pb, ahead = ca.mtimes(matrix, v["b"]), ca.mtimes(matrix, gap) + v["p"]
    curvature = s["effort"] + ca.dot(v["b"], pb)
    coupling = ca.mtimes(a.T, pb)
    feedback = -free * coupling / curvature
    feedforward = -free * (s["effort"] * s["u"] + ca.dot(v["b"], ahead)) / curvature + (1 - free) * s["to_bound"]
    cost = hessian + ca.mtimes(a.T, ca.mtimes(matrix, a)) + ca.mtimes(coupling, feedback.T)
    cost = ca.densify(ca.triu2symm(ca.triu(cost)))
    vector = ca.densify(gradient + ca.mtimes(a.T, ahead + pb * feedforward))
    inputs = [matrix, v["p"], v["x_plus"], v["x_next"], a, v["b"]]
    inputs += [s["u"], s["effort"], s["fixed"], s["to_bound"], *state]
    backward = ca.Function("riccati_backward", inputs, [cost, vector, ca.densify(feedback), feedforward], {"cse": True})

    du = ca.dot(v["feedback"], v["dx"]) + s["ff"]
    dx_next = ca.densify(ca.mtimes(a, v["dx"]) + v["b"] * du + gap)
    slope = s["effort"] * (s["u"] + du) + ca.dot(v["b"], ca.mtimes(matrix, dx_next) + v["p"])
    inputs = [v["dx"], v["feedback"], s["ff"], v["x_next"], v["x_plus"], a, v["b"], matrix, v["p"], s["u"], s["effort"]]
    forward = ca.Function("riccati_forward", inputs, [dx_next, du, slope], {"cse": True})
    return terminal, backward, forward


@lru_cache
def _functions(variant: str, discretisation: str) -> tuple[ca.Function, ...]:
    return *forecast.functions(), *recursion(variant, discretisation)


@lru_cache
def _library(variant: str, discretisation: str) -> ctypes.CDLL | None:
    headers, model = Path(codegen.__file__), model_function(variant, discretisation)
    extra = "".join(headers.with_name(name).read_text() for name in ("call.h", "lanes.h"))
    extra += f"enum {{ N = {_N}, N_THETA = {len(THETA)}, N_A = {model.nnz_out(1)} }};\n"
    extra += codegen.lanes_text(model, common=("u_d", "par", "T", "affine"))
    extra += Path(__file__).with_name("riccati.c").read_text()
    return codegen.library(_functions(variant, discretisation), extra)


class PlainHorizon:
    """The horizon of one controller without compiled code: the same problem, condensed and solved densely.

    Attributes
    ----------
    x_d, theta : ndarray, shape (L + 1, 6) and (L + 1, 9)
        Forecast.
    x, u : ndarray, shape (L + 1, 6) and (L,)
        Trajectory; `x[0]` may differ from the measured state `x_hat`, where the solution starts.
    x_next, matrices, b : ndarray, shape (L, 6), (L, 6, 6) and (L, 6)
        Model along the trajectory: next state, A and B.
    dx, du : ndarray
        Steps of the last quadratic problem.
    """

    def __init__(self, settings, believed: np.ndarray, parameters: np.ndarray, way: route.Route):
        steps = settings.steps
        self.settings, self.way, self._believed, self._parameters = settings, way, believed, parameters
        self._model = model_function(settings.variant, settings.discretisation).map(steps)
        self.x_hat, self.u_d, self.bound, self.affine = np.zeros(_N), 0.0, 0.0, 1.0
        self.x_d, self.x = np.zeros((2, steps + 1, _N))
        self.theta, self.u = np.zeros((steps + 1, len(THETA))), np.zeros(steps)
        self.x_next, self.b, self.matrices = None, None, None

    def sample(self, x_hat: np.ndarray, u_d: float, bound: float) -> None:
        """Take the measured state, the base torque and the bound of the differential torque (N m)."""
        self.x_hat[:], self.u_d, self.bound = x_hat, u_d, bound

    def forecast(self) -> None:
        """Fill `x_d` and `theta` from `x_hat` and the base torque."""
        s = self.settings
        ahead = forecast.forecast(self.way, self._believed, self.x_hat, self.u_d, s.period, s.steps)
        self.x_d[:], self.theta[:] = ahead.x_d, ahead.theta

    def linearise(self) -> None:
        """Model and derivatives along `x`, `u`."""
        steps, constant = self.settings.steps, [self.settings.period, self.affine]
        par = np.tile(self._parameters[:, None], steps)
        wide = [np.full((1, steps), value) for value in constant]
        u_d = np.full((1, steps), self.u_d)
        found = self._model(self.x[:-1].T, self.u[None, :], u_d, self.theta[:-1].T, par, *wide)
        self.x_next, a, b = (np.array(value.full()) for value in found)
        self.x_next, self.b = self.x_next.T, b.T
        self.matrices = a.reshape(_N, steps, _N).transpose(1, 0, 2)

    def solve(self) -> None:
        """Minimiser `dx`, `du` of the quadratic problem about the linearised trajectory.

        Raises
        ------
        ArithmeticError
            When a value is not finite.
        """
        self.dx, self.du = condensed.solve(self)
        if not (np.isfinite(self.dx).all() and np.isfinite(self.du).all()):
            raise ArithmeticError("horizon: a value is not finite")

    def apply(self) -> None:
        """Take the steps `dx`, `du`; torques stay within their bound."""
        self.x += self.dx
        self.u[:] = np.clip(self.u + self.du, -self.bound, self.bound)

    def iterate(self, most: int, tolerance: float) -> int:
        """Newton iterations on `x`, `u` until no torque moves by more than `tolerance` (N m); their number.

        Raises
        ------
        ArithmeticError
            When a value is not finite or, with more than one iteration allowed, when they do not converge.
        """
        for iteration in range(1, most + 1):
            self.linearise()
            self.solve()
            gap = np.abs(self.x_next - self.x[1:]).max()
            moved = np.abs(self.du).max()
            self.apply()
            if moved < tolerance and gap < 1e-9:
                return iteration
        if most > 1:
            raise ArithmeticError("horizon: no convergence")
        return most


class Horizon(PlainHorizon):
    """The same on compiled code. Torques and stages on their bounds stay known from one problem to the next."""

    def __init__(self, settings, believed: np.ndarray, parameters: np.ndarray, way: route.Route):
        self.settings, steps, cells = settings, settings.steps, way.cells
        functions = _functions(settings.variant, settings.discretisation)
        library = _library(settings.variant, settings.discretisation)
        self._calls = [codegen.CompiledFunction(library, function) for function in functions]
        matrix = model_function(settings.variant, settings.discretisation).sparsity_out(1)
        self._sparsity = [np.array(index) for index in matrix.get_triplet()]
        n_a = self._sparsity[0].size
        shapes = {"x_d": (steps + 1, _N), "theta": (steps + 1, len(THETA)), "x": (steps + 1, _N), "u": (steps,)}
        shapes |= {"x_next": (steps, _N), "a": (steps, n_a), "b": (steps, _N), "du": (steps,)}
        shapes |= {"cost_matrix": (steps + 1, _N**2), "cost_vector": (steps + 1, _N)}
        shapes |= {"feedback": (steps, _N), "feedforward": (steps,), "dx": (steps + 1, _N)}
        shapes |= {"slope": (steps,), "fixed": (steps,), "side": (steps + 1,)}
        self.weight = np.ascontiguousarray(np.vstack([np.zeros(_N), settings.weights()]))
        self.x_hat, self.cells = np.zeros(_N), np.ascontiguousarray(cells)
        self._inputs = believed.astype(float), parameters.astype(float)
        for name in _FIELDS:
            setattr(self, name, np.zeros(shapes[name]))
        self.c = _Horizon(
            steps, len(route.COLUMNS), len(cells), MOST_SETS,
            cells[0, 0], route.CELL, self.cells.ctypes.data, *(function.call for function in self._calls),
            self.x_hat.ctypes.data, *(array.ctypes.data for array in self._inputs), 0.0, settings.period, 1.0,
            self.weight.ctypes.data, settings.r * settings.period, 0.0, settings.lateral_bound,
            settings.soft_weight,
            *(getattr(self, name).ctypes.data for name in _FIELDS),
        )  # fmt: skip
        self._pointer = ctypes.byref(self.c)
        self._library, self._iterations = library, ctypes.c_longlong()
        self._count = ctypes.byref(self._iterations)

    def sample(self, x_hat: np.ndarray, u_d: float, bound: float) -> None:
        """See `PlainHorizon.sample`."""
        self.x_hat[:], self.c.u_d, self.c.bound = x_hat, u_d, bound

    u_d = property(lambda self: self.c.u_d)
    bound = property(lambda self: self.c.bound)

    @property
    def affine(self) -> float:
        """1 for the model itself, 0 for the printed linear one."""
        return self.c.affine

    @affine.setter
    def affine(self, value: float) -> None:
        self.c.affine = value

    @property
    def matrices(self) -> np.ndarray:
        """A of all stages, dense, shape (L, 6, 6)."""
        row, column = self._sparsity
        dense = np.zeros((self.settings.steps, _N, _N))
        dense[:, row, column] = self.a
        return dense

    def forecast(self) -> None:
        """See `PlainHorizon.forecast`."""
        self._check(self._library.horizon_forecast(self._pointer))

    def linearise(self) -> None:
        """See `PlainHorizon.linearise`."""
        self._library.horizon_linearise(self._pointer)

    def solve(self) -> None:
        """See `PlainHorizon.solve`."""
        code = self._library.horizon_solve(self._pointer)
        if code == _UNSETTLED:
            self.dx[:], self.du[:] = condensed.solve(self)
        else:
            self._check(code)

    def apply(self) -> None:
        """See `PlainHorizon.apply`."""
        self._library.horizon_apply(self._pointer)

    def iterate(self, most: int, tolerance: float) -> int:
        """See `PlainHorizon.iterate`."""
        arguments = ctypes.c_longlong(most), ctypes.c_double(tolerance)
        code = self._library.horizon_iterate(self._pointer, *arguments, self._count)
        if code == _UNSETTLED:
            return super().iterate(most, tolerance)
        self._check(code)
        return self._iterations.value

    def _check(self, code: int) -> None:
        if code:
            self.fixed[:], self.side[:] = 0.0, 0.0
            raise ArithmeticError("horizon: " + ("no convergence" if code == _DIVERGED else "a value is not finite"))


def horizon(settings, believed: np.ndarray, parameters: np.ndarray, way: route.Route) -> PlainHorizon:
    """The fastest horizon that this machine can run."""
    kind = PlainHorizon if codegen.compiler() is None else Horizon
    return kind(settings, believed, parameters, way)
