"""The compiled horizon: forecast, linearisation and Riccati recursion of one sample in C. An active-set method finds
the torques and positions at their bounds. Where it does not converge, an interior point method on the same recursion
takes over, which limits the time of a sample. Source: Rao, Wright and Rawlings 1998 (recursion, interior points);
Mehrotra 1992 (their steps); Hintermueller, Ito and Kunisch 2002 (active sets)."""

import ctypes
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from railrepro.compile import codegen
from railrepro.compile.lanes import lanes_header, lanes_text
from railrepro.control.problem import TUNING, MPCSettings, dynamics, torque_limit
from railrepro.control.solvers.recursion import recursion
from railrepro.model import forecast
from railrepro.model.control_model import STATES, THETA
from railrepro.track.route import CELL, COLUMNS, Route

MOST_SETS = 8
"""Largest number of active sets tried in one quadratic problem before the interior point method solves it."""
_FILES = ("riccati.c", "interior.c", "planner.c")
_SOURCES = [Path(__file__).with_name(name).read_text(encoding="utf-8") for name in _FILES]


@lru_cache
def functions(variant: str, discretisation: str) -> tuple[ca.Function, ...]:
    """CasADi functions, to be written as C before the text of `c_text`, which calls them by name: preview_position and
    preview_stage of the forecast, riccati_terminal, riccati_backward and riccati_forward of the recursion,
    torque_limit. `variant` ("corrected", "printed" or errata to keep, as "D1,D3") and `discretisation` ("euler",
    "midpoint", "rk4") are those of the prediction model."""
    return *forecast.functions(), *recursion(variant, discretisation), torque_limit()


def _sizes(variant: str, discretisation: str) -> dict[str, int]:
    """Sizes of the arrays in C, by name."""
    entries = dynamics(variant, discretisation).nnz_out(1)
    return {"N": len(STATES), "N_THETA": len(THETA), "N_CELL": len(COLUMNS), "N_A": entries, "BOUNDS": 4}


@codegen.stored
def _lanes(variant: str, discretisation: str) -> str:
    """C of the prediction model for several stages at a time."""
    return lanes_text(dynamics(variant, discretisation), common=("u_d", "par", "T", "affine"))


def c_text(variant: str, discretisation: str) -> str:
    """C text of the compiled solver (riccati.c, interior.c, planner.c), to be placed after call.h and the C of
    `functions`, with the same arguments."""
    extra = lanes_header()
    for prefix, entries in {"STATE": STATES, "TUNING": TUNING, "THETA": THETA}.items():
        extra += codegen.enumeration(f"{prefix}_{name}" for name in entries)
    extra += codegen.enumeration(f"{name} = {size}" for name, size in _sizes(variant, discretisation).items())
    return extra + codegen.defines({"CELL_STEP": CELL}) + _lanes(variant, discretisation) + "".join(_SOURCES)


@lru_cache
def _compiled(variant: str, discretisation: str) -> tuple[ctypes.CDLL, Any, Any]:
    """The shared object, and the ctypes classes of `horizon_t` and `stage_t` of riccati.c."""
    loaded = codegen.library(functions(variant, discretisation), codegen.PREAMBLE + c_text(variant, discretisation))
    loaded.planner_sample.restype = loaded.planner_take.restype = ctypes.c_double
    sizes = _sizes(variant, discretisation)
    return loaded, *(codegen.structure(name, _SOURCES[0], sizes) for name in ("horizon_t", "stage_t"))


class Horizon:
    """Problem, trajectory and compiled solver of one predictive controller over L = `settings.steps` time steps. The
    arguments `nominal` (3,) and `parameters` (14,) are vehicle data in the order of `model.forecast.NOMINAL` and
    `model.parameters.PARAMETERS`. Arrays are views of the memory in C (SI). Each problem starts from the active sets of
    the problem before.

    Attributes:
        x_hat (ndarray, shape (6,)): State at which the problem starts: the measured one, with an observer its yaw
            angle plus the observed creep angle (between heading and motion).
        x_d, theta (ndarray, shapes (L + 1, 6), (L + 1, 9)): Forecast of desired states and track parameters.
        x, u (ndarray, shapes (L + 1, 6), (L,)): States and torques about which the model is linearised. After a solved
            sample of LTV-MPC: a ride along the centre line, y = 0 (not y*), u = 0. Of "gauss_newton", "ipopt": the
            solution, x[0] = x_hat. Of "rti": that one step later; x[0] and x_hat are the state predicted for it.
        plan (ndarray, shape (L,)): Differential torques that solve the problem (N m); plan[0] is applied. Without a
            solution it is the plan of the sample before, one step later.
        stages (ndarray, shape (L + 1,)): All stages as a structured array, `stage_t` of riccati.c.
        c (ctypes.Structure), pointer: `horizon_t` of riccati.c, and a pointer to it for calls of `library`.
        library (ctypes.CDLL): The functions of riccati.c and planner.c.
    """

    def __init__(self, settings: MPCSettings, nominal: np.ndarray, parameters: np.ndarray, route: Route):
        self.settings, cells = settings, route.cells
        self.library, of_horizon, of_stage = _compiled(settings.variant, settings.discretisation)
        self.stages = np.zeros(settings.steps + 1, of_stage)
        self.x_d, self.theta, self.x = (self.stages[name] for name in ("x_d", "theta", "x"))
        self.u, self.plan = (self.stages[name][:-1] for name in ("u", "plan"))
        # C gets the addresses of these arrays
        self.tables = {"nominal": nominal.astype(float), "par": parameters.astype(float), "tuning": settings.tuning()}
        self.tables |= {"cells": cells, "stage": self.stages}
        self.c = of_horizon(
            steps=settings.steps, most_sets=MOST_SETS, n_cells=len(cells), cell_start=route.start, affine=1.0,
            yielding=settings.yielding, informed=settings.informed, previewed=settings.previewed,
            observer=settings.observer, **{name: table.ctypes.data for name, table in self.tables.items()},
        )  # fmt: skip
        self.x_hat, self.pointer = codegen.arrays(self.c)["x_hat"], ctypes.byref(self.c)

    def forecast(self, x_hat: np.ndarray, u_d: float) -> forecast.Forecast:
        """Compute `x_d` and `theta`, and return copies of them, for a measured state (6,) (SI) and a base torque per
        wheel (N m), which is constant over the horizon."""
        self.x_hat[:], self.c.u_d = x_hat, u_d
        self.library.horizon_forecast(self.pointer)
        return forecast.Forecast(self.x_d.copy(), self.theta.copy())
