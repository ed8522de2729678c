"""The compiled horizon: forecast, linearisation and Riccati recursion of one sample, without Python between stages.

One optimal control problem needs one call. The time grows linearly with the horizon; torque limits and the soft lateral
bound are active sets around the recursion. Where these do not settle, an interior point method on the same recursion
finds them, so that a sample has a largest time. `riccati.c` and `interior.c` drive the functions of `recursion`,
`planner.c` a whole sample.

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
from railrepro.compile.lanes import lanes_header, lanes_text
from railrepro.control.problem import TUNING, MPCSettings, dynamics, torque_limit
from railrepro.control.solvers.recursion import barrier, recursion
from railrepro.model import forecast
from railrepro.model.control_model import STATES, THETA
from railrepro.track.route import CELL, COLUMNS, INDEX, Route

_N = len(STATES)
_FAULTS = {1: "a value is not finite", 2: "no minimiser was found"}
MOST_SETS = 8
"""Active sets tried per quadratic problem before the interior point method takes over."""
_OF_BOUNDS = ("inner", "slack", "multiplier", "slack_step", "multiplier_step", "target")
_FIELDS = (
    *("x_d", "theta", "x", "u", "x_next", "a", "b", "cost_matrix", "cost_vector", "feedback", "feedforward", "dx"),
    *("du", "slope", "fixed", "side", *_OF_BOUNDS, "barrier", "passes"),
)
_CALLS = (
    *("position", "preview", "terminal", "backward", "forward"),
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
    return lanes_text(dynamics(variant, discretisation), common=("u_d", "par", "T", "affine"))


def c_text(variant: str, discretisation: str) -> str:
    """Hand-written C around the generated functions, to stand after `codegen.source_text` and call.h."""
    model = dynamics(variant, discretisation)
    names = {"STATE": STATES, "TUNING": TUNING, "THETA": THETA}
    extra = lanes_header()
    extra += "".join(_enum(f"{kind}_{name}" for name in entries) for kind, entries in names.items())
    extra += f"enum {{ N = {_N}, N_THETA = {len(THETA)}, N_CELL = {len(COLUMNS)}, N_A = {model.nnz_out(1)} }};\n"
    extra += _lanes(variant, discretisation)
    written = "riccati.c", "interior.c", "planner.c"
    return extra + "".join(Path(__file__).with_name(name).read_text() for name in written)


@lru_cache
def _library(variant: str, discretisation: str) -> ctypes.CDLL:
    extra = codegen.PREAMBLE + c_text(variant, discretisation)
    loaded = codegen.library([*functions(variant, discretisation), torque_limit()], extra)
    loaded.planner_plan.restype = loaded.planner_take.restype = ctypes.c_double
    return loaded


class Horizon:
    """Problem, trajectory and solver of one controller.

    Torques and stages on their bounds stay known from one problem to the next.

    Attributes
    ----------
    x_d, theta : ndarray, shape (L + 1, 6) and (L + 1, 9)
        Forecast.
    x, u : ndarray, shape (L + 1, 6) and (L,)
        Trajectory; `x[0]` may differ from the measured state `x_hat`, where the solution starts.
    x_next, a, b : ndarray, shape (L, 6), (L, nonzeros of A), (L, 6)
        Model along the trajectory: next state, A without its zeros, B.
    dx, du : ndarray
        Steps of the last quadratic problem.
    passes : ndarray, shape (1,)
        Recursions that it took.
    c : ctypes.Structure
        `horizon_t` of riccati.c, which holds the base torque and the bound (N m), too.
    library : ctypes.CDLL
        The functions of riccati.c and planner.c.
    """

    x_d: np.ndarray
    theta: np.ndarray
    x: np.ndarray
    u: np.ndarray

    def __init__(self, settings: MPCSettings, nominal: np.ndarray, parameters: np.ndarray, route: Route):
        self.settings, steps, cells = settings, settings.steps, route.cells
        self.library = _library(settings.variant, settings.discretisation)
        self._calls = [
            codegen.CompiledFunction(self.library, function)
            for function in functions(settings.variant, settings.discretisation)
        ]
        n_a = dynamics(settings.variant, settings.discretisation).nnz_out(1)
        shapes = {"x_d": (steps + 1, _N), "theta": (steps + 1, len(THETA)), "x": (steps + 1, _N), "u": (steps,)}
        shapes |= {"x_next": (steps, _N), "a": (steps, n_a), "b": (steps, _N), "du": (steps,)}
        shapes |= {"cost_matrix": (steps + 1, _N**2), "cost_vector": (steps + 1, _N)}
        shapes |= {"feedback": (steps, _N), "feedforward": (steps,), "dx": (steps + 1, _N)}
        shapes |= {"slope": (steps,), "fixed": (steps,), "side": (steps + 1,), "passes": (1,)}
        shapes |= dict.fromkeys(_OF_BOUNDS, (4, steps)) | {"barrier": (steps + 1, 4)}
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

    def sample(self, x_hat: np.ndarray, u_d: float, bound: float) -> None:
        """Take the measured state, the base torque and the bound of the differential torque (N m)."""
        self.x_hat[:], self.c.u_d, self.c.bound = x_hat, u_d, bound

    def forecast(self) -> None:
        """Fill `x_d` and `theta` from `x_hat` and the base torque."""
        self.library.horizon_forecast(self._pointer)

    def linearise(self) -> None:
        """Model and derivatives along `x`, `u`."""
        self.library.horizon_linearise(self._pointer)

    def solve(self) -> None:
        """Minimiser `dx`, `du` of the quadratic problem about the linearised trajectory.

        Raises
        ------
        ArithmeticError
            When a value is not finite or no minimiser is found.
        """
        if code := self.library.horizon_solve(self._pointer):
            raise ArithmeticError(f"horizon: {_FAULTS[code]}")
