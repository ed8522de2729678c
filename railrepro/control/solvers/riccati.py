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
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from railrepro.compile import codegen
from railrepro.compile.lanes import lanes_header, lanes_text
from railrepro.control.problem import TUNING, MPCSettings, dynamics, torque_limit
from railrepro.control.solvers.recursion import barrier, recursion
from railrepro.model import forecast
from railrepro.model.control_model import STATES, THETA
from railrepro.track.route import CELL, COLUMNS, Route

_N = len(STATES)
_FAULTS = {1: "a value is not finite", 2: "no minimiser was found"}
MOST_SETS = 8
"""Number of active sets tried per quadratic problem before the interior point method takes over."""
_SOURCES = [Path(__file__).with_name(name).read_text() for name in ("riccati.c", "interior.c", "planner.c")]


@lru_cache
def functions(variant: str, discretisation: str) -> tuple[ca.Function, ...]:
    """CasADi functions that the C of `c_text` calls: `forecast.functions`, `recursion`, `barrier`, `torque_limit`."""
    return *forecast.functions(), *recursion(variant, discretisation), *barrier(variant, discretisation), torque_limit()


def _sizes(variant: str, discretisation: str) -> dict[str, int]:
    """Numbers of states, track parameters, columns of a cell, entries of the matrix A, and bounds of a stage."""
    entries = dynamics(variant, discretisation).nnz_out(1)
    return {"N": _N, "N_THETA": len(THETA), "N_CELL": len(COLUMNS), "N_A": entries, "BOUNDS": 4}


@codegen.stored
def _lanes(variant: str, discretisation: str) -> str:
    """C of the model along a trajectory, several stages at a time."""
    return lanes_text(dynamics(variant, discretisation), common=("u_d", "par", "T", "affine"))


def c_text(variant: str, discretisation: str) -> str:
    """C text of riccati.c, interior.c and planner.c with array sizes, to follow call.h and the C of `functions`."""
    names = {"STATE": STATES, "TUNING": TUNING, "THETA": THETA}
    extra = lanes_header()
    extra += "".join(codegen.enumeration(f"{kind}_{name}" for name in entries) for kind, entries in names.items())
    extra += codegen.enumeration(f"{name} = {size}" for name, size in _sizes(variant, discretisation).items())
    extra += codegen.defines({"CELL_STEP": CELL})
    return extra + _lanes(variant, discretisation) + "".join(_SOURCES)


@lru_cache
def _compiled(variant: str, discretisation: str) -> tuple[ctypes.CDLL, Any, Any]:
    """The shared object, and `horizon_t` and `stage_t` of riccati.c."""
    loaded = codegen.library(functions(variant, discretisation), codegen.PREAMBLE + c_text(variant, discretisation))
    loaded.planner_plan.restype = loaded.planner_take.restype = ctypes.c_double
    sizes = _sizes(variant, discretisation)
    return loaded, *(codegen.structure(name, _SOURCES[0], sizes) for name in ("horizon_t", "stage_t"))


class Horizon:
    """Problem, trajectory and compiled solver of one predictive controller; arrays are views of its memory in C (SI).

    Active sets are kept from one problem to the next. `nominal` (3,) as `railrepro.model.forecast.NOMINAL`,
    `parameters` (14,) as `railrepro.model.parameters.PARAMETERS`.

    Attributes
    ----------
    x_d, theta : ndarray, shape (L + 1, 6) and (L + 1, 9)
        Forecast of desired states and track parameters.
    x, u : ndarray, shape (L + 1, 6) and (L,)
        Trajectory: states and differential torques; `x[0]` may differ from the measured state `x_hat` (6,).
    x_next, a, b : ndarray, shape (L, 6), (L, nonzeros of A), (L, 6)
        Model along the trajectory: next state, A without its zeros, B.
    dx, du : ndarray, shape (L + 1, 6) and (L,)
        Steps of `x` and `u` that minimise the last quadratic problem.
    fixed, side : ndarray, shape (L,) and (L + 1,)
        Active bounds of torques and lateral positions: 1 upper, -1 lower, 0 none.
    plan : ndarray, shape (L,)
        Differential torques of the plan (N m).
    c : ctypes.Structure
        `horizon_t` of riccati.c, with base torque and bound of the differential torque (N m), too.
    pointer : ctypes pointer
        Pointer to `c`, the argument of the functions of `library`.
    library : ctypes.CDLL
        The functions of riccati.c and planner.c.
    """

    def __init__(self, settings: MPCSettings, nominal: np.ndarray, parameters: np.ndarray, route: Route):
        self.settings, cells = settings, np.ascontiguousarray(route.cells)
        self.library, of_horizon, of_stage = _compiled(settings.variant, settings.discretisation)
        stages = np.zeros(settings.steps + 1, of_stage)
        self.x_d, self.theta, self.x, self.dx, self.side = (
            stages[name] for name in ("x_d", "theta", "x", "dx", "side")
        )
        self.u, self.du, self.fixed, self.plan = (stages[name][:-1] for name in ("u", "du", "fixed", "plan"))
        self.x_next, self.a, self.b = (stages[name][:-1] for name in ("x_next", "a", "b"))
        tables = {"nominal": nominal.astype(float), "par": parameters.astype(float), "tuning": settings.tuning()}
        tables |= {"cells": cells, "stage": stages}
        self._tables = tables  # C has their addresses
        self.c = of_horizon(
            steps=settings.steps, most_sets=MOST_SETS, n_cells=len(cells), cell_start=route.start, affine=1.0,
            yielding=settings.yielding, informed=settings.informed, observer=settings.observer,
            **{name: table.ctypes.data for name, table in tables.items()},
        )  # fmt: skip
        self.x_hat, self.pointer = codegen.arrays(self.c)["x_hat"], ctypes.byref(self.c)

    def sample(self, x_hat: np.ndarray, u_d: float, bound: float) -> None:
        """Set measured state (6,), base torque (N m) and bound of the differential torque (N m) of the next problem."""
        self.x_hat[:], self.c.u_d, self.c.bound = x_hat, u_d, bound

    def forecast(self) -> None:
        """Fill `x_d` and `theta` by the forecast from the measured state and base torque of `sample`."""
        self.library.horizon_forecast(self.pointer)

    def linearise(self) -> None:
        """Fill `x_next`, `a` and `b` with the model and its derivatives along `x`, `u`."""
        self.library.horizon_linearise(self.pointer)

    def solve(self) -> None:
        """Fill `dx`, `du` with the minimiser of the quadratic problem about the linearised trajectory.

        Raises
        ------
        ArithmeticError
            When a value is not finite or no minimiser is found.
        """
        if code := self.library.horizon_solve(self.pointer):
            raise ArithmeticError(f"horizon: {_FAULTS[code]}")
