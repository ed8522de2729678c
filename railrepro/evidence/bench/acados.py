"""acados on the problem of the other peers: SQP with HPIPM on vector kernels, its functions generated and compiled.

It comes with `make test-extras` into `FOLDER`, apart from the other packages, for it brings a slim CasADi along; its
HPIPM clashes with the one inside CasADi, so a process of its own builds the solver and solves what it is sent. Serves
the paper's section Evaluation of Lateral Control (computation times).

Source: Verschueren and others 2022 (acados), Frison and Diehl 2020 (HPIPM).
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import io
import multiprocessing
import os
import sys
import tempfile
import time
from functools import lru_cache
from multiprocessing.connection import Connection
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro.control import problem as ocp
from railrepro.control.problem import MPCSettings, Problem, Tuning
from railrepro.control.solvers.condensed import COST, UNIT
from railrepro.control.solvers.ipopt import SCALE
from railrepro.errors import InputError
from railrepro.model.control_model import STATES, THETA, Y
from railrepro.model.parameters import PARAMETERS

NAME = "acados"
FOLDER = Path(sys.prefix) / "acados"
_INSTALLED = FOLDER / "acados" / "install"
_N = len(STATES)
_TOLERANCES = ("qp_solver_tol_stat", "qp_solver_tol_eq", "qp_solver_tol_ineq", "qp_solver_tol_comp")
_OPTIONS = {
    "integrator_type": "DISCRETE",
    "hessian_approx": "GAUSS_NEWTON",
    "nlp_solver_type": "SQP",
    "nlp_solver_max_iter": 20,
    "tol": 1e-6,
    "print_level": 0,
    "ext_fun_compile_flags": "-O3 -march=native",
    "qp_solver": "FULL_CONDENSING_HPIPM",
    "hpipm_mode": "SPEED",
    "qp_solver_iter_max": 100,
    "qp_solver_warm_start": 1,
    **dict.fromkeys(_TOLERANCES, 1e-8),
}
"""Tolerances of the other peers; full condensing, which was faster here than blocks of stages."""


def available() -> bool:
    """Whether acados is installed, see `FOLDER`."""
    return _INSTALLED.is_dir()


class Acados:
    """What `peers.Peer` is for plugins of CasADi: solves problem after problem, from the solution before.

    Raises
    ------
    InputError
        When its solver cannot be built here.
    """

    def __init__(self, settings: MPCSettings):
        self._worker = _worker(settings)
        self._asked(None)

    def solve(self, problem: Problem) -> tuple[np.ndarray, float]:
        """Torques (L,) (N m) and the time of the processor (s); the data are put in place before."""
        return self._asked(problem)

    def _asked(self, problem: Problem | None):
        try:
            self._worker.send(problem)
            return self._worker.recv()
        except (EOFError, OSError):
            raise InputError("acados: its solver cannot be built or ended; `make test-extras` installs it") from None


@lru_cache(maxsize=1)
def _worker(settings: MPCSettings) -> Connection:
    """Pipe to a process with the solver of some settings; without the pipe it ends."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    context.Process(target=_serve, args=(there, settings), daemon=True).start()
    there.close()
    return here


def _serve(pipe: Connection, settings: MPCSettings) -> None:
    """Solve what comes, until nothing more does; None begins afresh."""
    with tempfile.TemporaryDirectory() as folder, contextlib.suppress(EOFError):
        solver, started = _built(settings, Path(folder)), False
        while True:
            problem = pipe.recv()
            if problem is None:
                started = False
                pipe.send(None)
                continue
            _prepare(solver, problem, started)
            begin = time.thread_time()
            started = solver.solve() == 0
            spent = time.thread_time() - begin
            torques = [solver.get(k, "u")[0] if started else np.nan for k in range(settings.steps)]
            pipe.send((UNIT * np.array(torques), spent))


def _built(settings: MPCSettings, folder: Path):
    """Solver of acados, generated and compiled in a folder, with the stated problem stage by stage."""
    os.environ |= {"ACADOS_SOURCE_DIR": str(_INSTALLED), "TERA_PATH": str(_INSTALLED / "bin" / "t_renderer")}
    os.environ["ACADOS_PYTHON_INTERFACE_PATH"] = str(FOLDER / "acados" / "acados_template")
    sys.path.append(str(FOLDER / "acados"))
    os.chdir(folder)
    for name in ("blasfeo", "hpipm", "qpOASES_e", "acados"):
        ctypes.CDLL(str(_INSTALLED / "lib" / f"lib{name}.so"))
    template = importlib.import_module("acados_template")
    stated = template.AcadosOcp()
    stated.model, stated.dims.N = _model(template.AcadosModel(), settings), settings.steps
    stated.parameter_values = np.zeros(stated.model.p.numel())
    stated.acados_include_path, stated.acados_lib_path = str(_INSTALLED / "include"), str(_INSTALLED / "lib")
    _state(stated, settings)
    for name, value in (_OPTIONS | {"tf": float(settings.steps)}).items():
        setattr(stated.solver_options, name, value)
    with contextlib.redirect_stdout(io.StringIO()):
        return template.AcadosOcpSolver(stated, json_file="peer.json", verbose=False)


def _model(model, settings: MPCSettings):
    """One step of scaled deviations from the desired states; what changes from problem to problem is a parameter."""
    z, w, t = ca.SX.sym("z", _N), ca.SX.sym("w"), Tuning.of(ca.DM(settings.tuning()))
    sizes = {"x_d": _N, "x_d_next": _N, "theta": len(THETA), "par": len(PARAMETERS), "u_d": 1}
    p = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    x = p["x_d"] + ca.DM(SCALE) * z
    step = ocp.dynamics(settings.variant, settings.discretisation)
    reached, *_ = step(x, UNIT * w, p["u_d"], p["theta"], p["par"], t.period, 1)
    model.name, model.x, model.u, model.p = "peer", z, w, ca.vertcat(*p.values())
    model.disc_dyn_expr = (reached - p["x_d_next"]) / ca.DM(SCALE)
    return model


def _state(stated, settings: MPCSettings) -> None:
    """Costs, which acados halves, and bounds, of which that of y is soft."""
    weights = ocp.curvature(settings)
    by_state, by_last = (2 * COST * weights.states[k] * SCALE**2 for k in (0, -1))
    by_torque, by_slack = 2 * COST * weights.torque * UNIT**2, 2 * COST * weights.slack * SCALE[Y] ** 2
    cost, constraints = stated.cost, stated.constraints
    cost.cost_type = cost.cost_type_e = "LINEAR_LS"
    cost.W, cost.yref = np.diag([*by_state, by_torque]), np.zeros(_N + 1)
    cost.W_e, cost.yref_e = np.diag(by_last), np.zeros(_N)
    cost.Vx, cost.Vu, cost.Vx_e = np.eye(_N + 1, _N), np.eye(_N + 1)[:, _N:], np.eye(_N)
    constraints.x0, constraints.idxbu = np.zeros(_N), np.array([0])
    constraints.lbu, constraints.ubu = -np.ones(1), np.ones(1)
    for end in ("", "_e"):
        for name, value in (("lbx", -1.0), ("ubx", 1.0), ("idxbx", Y), ("idxsbx", 0)):
            setattr(constraints, name + end, np.array([value]))
        for name, value in (("zl", 0.0), ("zu", 0.0), ("Zl", by_slack), ("Zu", by_slack)):
            setattr(cost, name + end, np.array([value]))


def _prepare(solver, problem: Problem, started: bool) -> None:
    """Put a problem into the solver, and the solution before, one sample later, as start."""
    steps, x_d, theta = problem.settings.steps, problem.ahead.x_d, problem.ahead.theta
    first, bound = (problem.x_hat - x_d[0]) / SCALE, np.array([problem.bound / UNIT])
    x = [solver.get(k, "x") if started else np.zeros(_N) for k in range(1, steps + 1)]
    u = [solver.get(k, "u") if started else np.zeros(1) for k in range(steps)]
    for k in range(steps + 1):
        ahead = (x_d[k], x_d[min(k + 1, steps)], theta[min(k, steps - 1)], problem.parameters, [problem.u_d])
        solver.set(k, "p", np.concatenate(ahead))
        low, high = ((side * problem.settings.lateral_bound - x_d[k, Y : Y + 1]) / SCALE[Y] for side in (-1, 1))
        solver.constraints_set(k, "lbx", low if k else first)
        solver.constraints_set(k, "ubx", high if k else first)
        solver.set(k, "x", first if k == 0 else x[k] if k < steps else np.zeros(_N))
        if k < steps:
            solver.constraints_set(k, "lbu", -bound)
            solver.constraints_set(k, "ubu", bound)
            solver.set(k, "u", u[min(k + 1, steps - 1)])
