"""Six quadratic problems of the predictive controllers as files, and other solvers on them.

With `--write` the script drives the scenarios and writes the problems with their optimum into data/problems, whose
README describes a file. Without it all installed solvers solve these files (PIQP and Clarabel come with the group
`bench`), for data/results/qp_times.csv. Settings are given here and not in data/tuned, so that the problems do not
change with the tuning. Serves the paper's section Evaluation of Lateral Control (computation times)."""

import ctypes
import io
import sys
import time
import timeit
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec

import casadi as ca
import numpy as np
import pandas as pd
from scipy import sparse

from railrepro import paths
from railrepro.control.mpc import LTVMPC, NMPC, PredictiveController
from railrepro.control.problem import MPCSettings
from railrepro.control.solvers import ipopt
from railrepro.control.solvers.ipopt import SCALE, SLACK, UNIT
from railrepro.data import write
from railrepro.evidence.bench import speed
from railrepro.model.control_model import STATES, Y
from railrepro.simulation import scenarios, simulate
from railrepro.vehicle.parameters import load_vehicle

SETTINGS = MPCSettings((0.0, 0.0, 0.0, 1e-4, 1.0, 2e-3), r=1e-12, q_terminal=100.0, period=0.005)
"""Settings of all six, except for steps and lateral bound; near the tuned sets of the setting "paper"."""
OURS = "recursion"
_N = len(STATES)


@dataclass(frozen=True)
class Case:
    """One of the problems: the last sample of a controller in a scenario that ends early."""

    controller: type[PredictiveController]  # NMPC as real-time iteration, or LTVMPC
    scenario: str
    end_m: float
    steps: int
    before: int  # samples that the controller solved before; 0 is its first one, about the desired states
    torque_limit: float = 4000.0  # N m
    lateral_bound: float = SETTINGS.lateral_bound  # m, soft


CASES = {
    "nmpc_short": Case(NMPC, "curve_entry_T3", 150.0, 10, 20),
    "nmpc_long_bounds": Case(NMPC, "curve_entry_T3", 200.0, 60, 20, 150.0, 2.5e-3),
    "nmpc_first_bounds": Case(NMPC, "braking", 80.0, 30, 0, 50.0, 1.5e-3),
    "ltv_long": Case(LTVMPC, "curve_entry_T3", 150.0, 60, 20),
    "ltv_short_bounds": Case(LTVMPC, "braking", 185.0, 10, 20, 50.0, 2.5e-3),
    "ltv_first": Case(LTVMPC, "sine_tracking", 1.0, 30, 0),
}


def pose(case: Case) -> PredictiveController:
    """Drive the scenario under NMPC, and give the controller of a case the last sample without solving it."""
    vehicle, settings = load_vehicle(), replace(SETTINGS, steps=case.steps)
    scenario = scenarios.load_scenario(case.scenario).but(end_m=case.end_m)
    run = simulate.run(scenario, lambda *of: speed.Recorder(*of, settings))
    *past, last = run.controllers[0].problems[-1 - case.before :]
    limited = replace(vehicle, drive=replace(vehicle.drive, torque_limit=case.torque_limit))
    options = {"solver": "rti"} if case.controller is NMPC else {}
    controller = case.controller(
        limited, scenario.route(), 0, replace(settings, lateral_bound=case.lateral_bound), **options
    )
    for sample in past:
        controller.plan(sample.x_hat, sample.u_d)
    horizon, x_hat = controller.horizon, ctypes.c_void_p(last.x_hat.ctypes.data)
    horizon.library.planner_begin(horizon.pointer, x_hat, ctypes.c_double(last.u_d))
    return controller


def linearised(controller: PredictiveController) -> dict[str, np.ndarray]:
    """Linearise the nonlinear program of `solvers.ipopt` along the trajectory of a controller: P, q, A, l, u, dense,
    with the unknowns and units of that program."""
    h, s = controller.horizon, controller.settings
    program = ipopt.program(s.variant, s.discretisation, s.steps)
    x, p, f, g = (program[name] for name in "xpfg")
    hessian, slope = ca.hessian(f, x)
    slope = ca.substitute(slope, x, ca.DM.zeros(x.shape))
    evaluate = ca.Function("linearised", [x, p], [hessian, slope, g, ca.jacobian(g, x)])
    at = np.concatenate([((h.x - h.x_d) / SCALE).ravel(), h.u / UNIT, np.zeros(s.steps)])
    numbers = [h.x_d.ravel(), h.theta[:-1].ravel(), h.tables["par"], s.tuning(), [h.c.u_d]]
    cost, gradient, value, by = (np.array(ca.densify(one)) for one in evaluate(at, np.concatenate(numbers)))
    offset, bound, inf = value.ravel() - by @ at, h.c.bound / UNIT, np.inf
    first, rows = (h.x_hat - h.x_d[0]) / SCALE, np.eye(at.size)
    chosen = np.r_[:_N, at.size - 2 * s.steps : at.size]  # the measured state, torques, slacks
    low = [np.zeros(_N * s.steps) - offset[: _N * s.steps], np.full(2 * s.steps, -inf), first]
    return {
        "P": cost,
        "q": gradient.ravel(),
        "A": np.concatenate([by, rows[chosen]]),
        "l": np.concatenate([*low, np.full(s.steps, -bound), np.zeros(s.steps)]),
        "u": np.concatenate([-offset, first, np.full(s.steps, bound), np.full(s.steps, inf)]),
    }


def solution(controller: PredictiveController) -> np.ndarray:
    """Solve the problem by the recursion of the project, for the unknowns of `linearised`."""
    h, s = controller.horizon, controller.settings
    if h.library.horizon_solve(h.pointer):
        raise ArithmeticError("the recursion found no solution")
    x = h.x + h.stages["dx"]
    slack = np.maximum(np.abs(x[1:, Y]) - s.lateral_bound, 0)
    return np.concatenate([((x - h.x_d) / SCALE).ravel(), (h.u + h.stages["du"][:-1]) / UNIT, slack / SLACK])


def posed(name: str) -> dict[str, np.ndarray]:
    """Compute the arrays of a file, P and A as the three arrays of a compressed sparse column matrix each."""
    controller = pose(CASES[name])
    arrays = linearised(controller)
    x = solution(controller)
    packed = {"x": x, "objective": np.array(x @ arrays["P"] @ x / 2 + arrays["q"] @ x)}
    for key, value in arrays.items():
        if value.ndim == 1:
            packed[key] = value
        else:
            matrix = sparse.csc_matrix(value)
            packed |= {f"{key}_{part}": getattr(matrix, part) for part in ("data", "indices", "indptr")}
    return packed


def read(name: str) -> dict[str, np.ndarray]:
    """Read the arrays of a file of data/problems."""
    with np.load(paths.source(f"data/problems/{name}.npz")) as file:
        return dict(file)


def matrices(of: dict[str, np.ndarray]) -> tuple[sparse.csc_matrix, sparse.csc_matrix]:
    """Make the sparse matrices P (n, n) and A (m, n) of a problem."""
    shapes = {"P": (of["q"].size, of["q"].size), "A": (of["l"].size, of["q"].size)}
    parts = {key: tuple(of[f"{key}_{part}"] for part in ("data", "indices", "indptr")) for key in shapes}
    return sparse.csc_matrix(parts["P"], shapes["P"]), sparse.csc_matrix(parts["A"], shapes["A"])


def condensed(of: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Eliminate the states: dense cost P, q, inequalities A, l, u, and the matrix and the vector that give x back."""
    cost, rows = (matrix.toarray() for matrix in matrices(of))
    equal = of["l"] == of["u"]
    n = int(equal.sum())  # states come first, and the equalities determine them
    by = np.linalg.solve(rows[equal][:, :n], np.column_stack([-rows[equal][:, n:], of["l"][equal]]))
    back = np.concatenate([by[:, :-1], np.eye(cost.shape[0] - n)])
    given = np.concatenate([by[:, -1], np.zeros(cost.shape[0] - n)])
    left = rows[~equal]
    low, high = (of[side][~equal] - left @ given for side in "lu")
    return back.T @ cost @ back, back.T @ (of["q"] + cost @ given), left @ back, low, high, back, given


def daqp(of: dict[str, np.ndarray]) -> Callable[[], np.ndarray]:
    """Solve by DAQP (plugin of CasADi), which needs a regular Hessian: the states are eliminated beforehand."""
    *of_form, back, given = condensed(of)
    numbers = dict(zip(("h", "g", "a", "lba", "uba"), map(ca.DM, of_form), strict=True))
    dense = {key: ca.Sparsity.dense(*numbers[key].shape) for key in "ha"}
    solver = ca.conic("daqp", "daqp", dense, {"print_time": False})
    return lambda: back @ np.array(solver(**numbers)["x"]).ravel() + given


def piqp(of: dict[str, np.ndarray]) -> Callable[[], np.ndarray]:
    """Solve by PIQP, sparse, to nearly all digits."""
    import piqp

    cost, rows = matrices(of)
    equal = of["l"] == of["u"]
    sides = rows[~equal], of["l"][~equal], of["u"][~equal]

    def solve() -> np.ndarray:
        solver = piqp.SparseSolver()
        of_solver = solver.settings
        of_solver.iterative_refinement_always_enabled = True  # without it, ltv_first diverges
        of_solver.eps_abs = of_solver.eps_rel = of_solver.eps_duality_gap_rel = 1e-10
        of_solver.eps_duality_gap_abs = 1e-12
        solver.setup(cost, of["q"], rows[equal], of["l"][equal], *sides)
        solver.solve()
        return solver.result.x

    return solve


def clarabel(of: dict[str, np.ndarray]) -> Callable[[], np.ndarray]:
    """Solve by Clarabel, sparse; bounds are written as one side each."""
    import clarabel

    cost, rows = matrices(of)
    equal, low, high = of["l"] == of["u"], np.isfinite(of["l"]), np.isfinite(of["u"])
    low, high = low & ~equal, high & ~equal
    stacked = sparse.vstack([rows[equal], rows[high], -rows[low]], format="csc")
    limits = np.concatenate([of["u"][equal], of["u"][high], -of["l"][low]])
    cones = [clarabel.ZeroConeT(int(equal.sum())), clarabel.NonnegativeConeT(int(high.sum() + low.sum()))]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    given = sparse.triu(cost, format="csc"), of["q"], stacked, limits, cones, settings
    return lambda: np.array(clarabel.DefaultSolver(*given).solve().x)


SOLVERS = {"daqp": daqp, "piqp": piqp, "clarabel": clarabel}
INSTALLED = [solver for solver in SOLVERS if solver == "daqp" or find_spec(solver)]  # DAQP comes with CasADi


def apart(name: str, of: dict[str, np.ndarray], x: np.ndarray) -> tuple[float, float]:
    """Compare x with the stored optimum: largest difference of a torque (N m), relative one of the objective."""
    first = _N * (CASES[name].steps + 1)
    torques = slice(first, first + CASES[name].steps)
    objective = x @ matrices(of)[0] @ x / 2 + of["q"] @ x
    return UNIT * np.abs(x - of["x"])[torques].max(), abs(objective / of["objective"] - 1)


def _least_ms(call: Callable[[], object]) -> float:
    """Least processor time of 20 calls (ms)."""
    return 1e3 * min(timeit.repeat(call, number=1, repeat=20, timer=time.process_time))


def _recursion_ms(name: str) -> float:
    """Processor time of the recursion (ms), without active sets to start from."""
    horizon = pose(CASES[name]).horizon

    def solve() -> None:
        horizon.stages["fixed"] = horizon.stages["side"] = 0.0
        horizon.library.horizon_solve(horizon.pointer)

    return _least_ms(solve)


def compare() -> pd.DataFrame:
    """Solve the files by all installed solvers: a row of data/results/qp_times.csv per problem and solver. Times
    exclude what may be prepared before a state is measured, for `daqp` also the elimination of the states."""
    rows = []
    for name in CASES:
        of, ours = read(name), _recursion_ms(name)
        rows.append({"problem": name, "solver": OURS, "ms": ours, "ratio_to_ours": 1.0})
        for solver in INSTALLED:
            solve = SOLVERS[solver](of)
            difference, objective = apart(name, of, solve())
            ms = _least_ms(solve)
            row = {"problem": name, "solver": solver, "ms": ms, "ratio_to_ours": ms / ours}
            rows.append(row | {"difference_du_Nm": difference, "difference_objective": objective})
    return pd.DataFrame(rows)


if __name__ == "__main__" and sys.argv[1:] == ["--write"]:
    for problem in CASES:
        content = io.BytesIO()
        np.savez(content, **posed(problem))  # not compressed, as bits would then depend on the library
        write(paths.product(f"data/problems/{problem}.npz"), content.getvalue())
elif __name__ == "__main__":
    missing, table = [solver for solver in SOLVERS if solver not in INSTALLED], compare()
    print(table.to_string(index=False))
    if missing:
        print(f"no {' and '.join(missing)}: `make test-extras` installs them, then the table is written")
    else:
        text = table.assign(machine=speed.machine()).to_csv(index=False, float_format="%.4g")
        write(paths.product("data/results/qp_times.csv"), text)
