"""The compiled horizon: forecast, linearisation and Riccati recursion of one sample, without Python between stages.

One optimal control problem needs one call. The time grows linearly with the horizon; torque limits and the soft lateral
bound are active sets around the recursion. Where these do not settle, an interior point method on the same recursion
finds them, so that a sample has a largest time. `riccati.c` and `interior.c` drive the functions of `recursion`; where
there is no C compiler the condensed problem of `condensed` gives the same minimisers.

Source: Rao, Wright and Rawlings 1998 (recursion, interior points); Mehrotra 1992 (their steps); Hintermueller, Ito and
Kunisch 2002 (primal-dual active sets).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro.compile import codegen
from railrepro.control.problem import TUNING, MPCSettings, dynamics
from railrepro.control.solvers import condensed
from railrepro.control.solvers.recursion import barrier, recursion
from railrepro.model import forecast
from railrepro.model.control_model import STATES, THETA
from railrepro.track.route import CELL, COLUMNS, INDEX, Route

_N = len(STATES)
UNSETTLED, _DIVERGED = 2, 3
MOST_SETS = 8
"""Active sets tried per quadratic problem before the interior point method takes over."""
_OF_BOUNDS = ("inner", "room", "force", "room_step", "force_step", "target")
_FIELDS = (
    *("x_d", "theta", "x", "u", "x_next", "a", "b", "cost_matrix", "cost_vector", "feedback", "feedforward", "dx"),
    *("du", "slope", "fixed", "side", *_OF_BOUNDS, "stands", "passes"),
)
_CALLS = (
    *("place", "preview", "terminal", "backward", "forward"),
    *("barrier_stiffness", "barrier_terminal", "barrier_backward", "barrier_again"),
)


class _Horizon(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_longlong) for name in ("steps", "n_cells", "most_sets")),
        *((name, ctypes.c_double) for name in ("cell_start", "cell_step")),
        ("cells", ctypes.c_void_p),
        *((name, codegen.Call) for name in _CALLS),
        *((name, ctypes.c_void_p) for name in ("x_hat", "nominal", "par", "tuning")),
        *((name, ctypes.c_double) for name in ("u_d", "bound", "affine")),
        *((name, ctypes.c_void_p) for name in _FIELDS),
    ]


@lru_cache
def functions(variant: str, discretisation: str) -> tuple[ca.Function, ...]:
    """The functions behind a horizon, in the order of `_CALLS`."""
    return *forecast.functions(), *recursion(variant, discretisation), *barrier(variant, discretisation)


def _enum(names: Iterable[str]) -> str:
    """C constants that count from 0."""
    return f"enum {{ {', '.join(names)} }};\n"


@codegen.stored
def _lanes(variant: str, discretisation: str) -> str:
    """C of the model along a trajectory, several stages at a time."""
    return codegen.lanes_text(dynamics(variant, discretisation), common=("u_d", "par", "T", "affine"))


def c_text(variant: str, discretisation: str) -> str:
    """Hand-written C around the generated functions, to stand after `codegen.source_text` and call.h."""
    model = dynamics(variant, discretisation)
    names = {"STATE": STATES, "TUNING": TUNING, "THETA": THETA}
    extra = codegen.lanes_header()
    extra += "".join(_enum(f"{kind}_{name}" for name in entries) for kind, entries in names.items())
    extra += f"enum {{ N = {_N}, N_THETA = {len(THETA)}, N_CELL = {len(COLUMNS)}, N_A = {model.nnz_out(1)} }};\n"
    extra += _lanes(variant, discretisation)
    written = "riccati.c", "interior.c", "planner.c"
    return extra + "".join(Path(__file__).with_name(name).read_text() for name in written)


@lru_cache
def _library(variant: str, discretisation: str) -> ctypes.CDLL | None:
    extra = Path(codegen.__file__).with_name("call.h").read_text() + c_text(variant, discretisation)
    return codegen.library(functions(variant, discretisation), extra)


class PlainHorizon:
    """The horizon of one controller without compiled code: the same problem, condensed and solved densely.

    Attributes
    ----------
    x_d, theta : ndarray, shape (L + 1, 6) and (L + 1, 9)
        Forecast.
    x, u : ndarray, shape (L + 1, 6) and (L,)
        Trajectory; `x[0]` may differ from the measured state `x_hat`, where the solution starts.
    x_next, b : ndarray, shape (L, 6)
        Model along the trajectory: next state and B; A are the `matrices`.
    dx, du : ndarray
        Steps of the last quadratic problem.
    """

    x_next: np.ndarray
    b: np.ndarray
    dx: np.ndarray
    du: np.ndarray

    def __init__(self, settings: MPCSettings, nominal: np.ndarray, parameters: np.ndarray, route: Route):
        steps = settings.steps
        self.settings, self.route, self._nominal, self._parameters = settings, route, nominal, parameters
        self._model = dynamics(settings.variant, settings.discretisation).map(steps)
        self.x_hat, self.u_d, self.bound, self.affine = np.zeros(_N), 0.0, 0.0, 1.0
        self.x_d, self.x = np.zeros((2, steps + 1, _N))
        self.theta, self.u = np.zeros((steps + 1, len(THETA))), np.zeros(steps)

    def sample(self, x_hat: np.ndarray, u_d: float, bound: float) -> None:
        """Take the measured state, the base torque and the bound of the differential torque (N m)."""
        self.x_hat[:], self.u_d, self.bound = x_hat, u_d, bound

    def forecast(self) -> None:
        """Fill `x_d` and `theta` from `x_hat` and the base torque."""
        s = self.settings
        ahead = forecast.forecast(self.route, self._nominal, self.x_hat, self.u_d, s.period, s.steps)
        self.x_d[:], self.theta[:] = ahead.x_d, ahead.theta

    def linearise(self) -> None:
        """Model and derivatives along `x`, `u`."""
        steps, constant = self.settings.steps, [self.settings.period, self.affine]
        par = np.tile(self._parameters[:, None], steps)
        wide = [np.full((1, steps), value) for value in constant]
        u_d = np.full((1, steps), self.u_d)
        found = self._model(self.x[:-1].T, self.u[None, :], u_d, self.theta[:-1].T, par, *wide)
        x_next, a, b = (np.array(value.full()) for value in found)
        self.x_next, self.b = x_next.T, b.T
        self._matrices = a.reshape(_N, steps, _N).transpose(1, 0, 2)

    @property
    def matrices(self) -> np.ndarray:
        """A of all stages, dense, shape (L, 6, 6)."""
        return self._matrices

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

    a: np.ndarray
    fixed: np.ndarray
    side: np.ndarray

    def __init__(
        self, library: ctypes.CDLL, settings: MPCSettings, nominal: np.ndarray, parameters: np.ndarray, route: Route
    ):
        self.settings, steps, cells = settings, settings.steps, route.cells
        self._calls = [
            codegen.CompiledFunction(library, function)
            for function in functions(settings.variant, settings.discretisation)
        ]
        matrix = dynamics(settings.variant, settings.discretisation).sparsity_out(1)
        self._sparsity = [np.array(index) for index in matrix.get_triplet()]
        n_a = self._sparsity[0].size
        shapes = {"x_d": (steps + 1, _N), "theta": (steps + 1, len(THETA)), "x": (steps + 1, _N), "u": (steps,)}
        shapes |= {"x_next": (steps, _N), "a": (steps, n_a), "b": (steps, _N), "du": (steps,)}
        shapes |= {"cost_matrix": (steps + 1, _N**2), "cost_vector": (steps + 1, _N)}
        shapes |= {"feedback": (steps, _N), "feedforward": (steps,), "dx": (steps + 1, _N)}
        shapes |= {"slope": (steps,), "fixed": (steps,), "side": (steps + 1,), "passes": (1,)}
        shapes |= dict.fromkeys(_OF_BOUNDS, (4, steps)) | {"stands": (steps + 1, 4)}
        self.x_hat, self.cells = np.zeros(_N), np.ascontiguousarray(cells)
        self._inputs = nominal.astype(float), parameters.astype(float), settings.tuning()
        for name in _FIELDS:
            setattr(self, name, np.zeros(shapes[name]))
        self.c = _Horizon(
            steps, len(cells), MOST_SETS,
            cells[0, INDEX["p"]], CELL, self.cells.ctypes.data, *(function.call for function in self._calls),
            self.x_hat.ctypes.data, *(array.ctypes.data for array in self._inputs), 0.0, 0.0, 1.0,
            *(getattr(self, name).ctypes.data for name in _FIELDS),
        )  # fmt: skip
        self._pointer = ctypes.byref(self.c)
        self.library, self._iterations = library, ctypes.c_longlong()
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
        """See `PlainHorizon.matrices`."""
        row, column = self._sparsity
        dense = np.zeros((self.settings.steps, _N, _N))
        dense[:, row, column] = self.a
        return dense

    def forecast(self) -> None:
        """See `PlainHorizon.forecast`."""
        self._check(self.library.horizon_forecast(self._pointer))

    def linearise(self) -> None:
        """See `PlainHorizon.linearise`."""
        self.library.horizon_linearise(self._pointer)

    def solve(self) -> None:
        """See `PlainHorizon.solve`."""
        code = self.library.horizon_solve(self._pointer)
        if code == UNSETTLED:
            self.dx[:], self.du[:] = condensed.solve(self)
        else:
            self._check(code)

    def apply(self) -> None:
        """See `PlainHorizon.apply`."""
        self.library.horizon_apply(self._pointer)

    def iterate(self, most: int, tolerance: float) -> int:
        """See `PlainHorizon.iterate`."""
        arguments = ctypes.c_longlong(most), ctypes.c_double(tolerance)
        code = self.library.horizon_iterate(self._pointer, *arguments, self._count)
        if code == UNSETTLED:
            return super().iterate(most, tolerance)
        self._check(code)
        return self._iterations.value

    def _check(self, code: int) -> None:
        if code:
            self.fixed[:], self.side[:] = 0.0, 0.0
            raise ArithmeticError("horizon: " + ("no convergence" if code == _DIVERGED else "a value is not finite"))


def horizon(settings: MPCSettings, nominal: np.ndarray, parameters: np.ndarray, route: Route) -> PlainHorizon:
    """The fastest horizon that this machine can run."""
    library = _library(settings.variant, settings.discretisation)
    if library is None:
        return PlainHorizon(settings, nominal, parameters, route)
    return Horizon(library, settings, nominal, parameters, route)
