"""Peers of the recursion on the same problem: Ipopt, and sequential quadratic programming with qrqp.

Both get the nonlinear program of `solvers.ipopt` as compiled C, the Hessian of the costs, the same start (the last
solution, one sample later) and tolerances that lead to the same optimum, which `compare` measures. The least processor
time of several calls without Python objects in between counts. As a script it writes data/results/peer_times.csv.
Serves the paper's section Evaluation of Lateral Control (computation times)."""

import time
from dataclasses import replace
from functools import lru_cache
from unittest import mock

import casadi as ca
import numpy as np
import pandas as pd
from tqdm import tqdm

from railrepro import paths
from railrepro.compile import cache, codegen
from railrepro.control import problem
from railrepro.control.problem import MPCSettings, Problem
from railrepro.control.registry import mpc_settings, parameters
from railrepro.control.solvers import ipopt
from railrepro.control.solvers.ipopt import SCALE, UNIT
from railrepro.data import write
from railrepro.evidence.bench import speed
from railrepro.model.control_model import STATES
from railrepro.vehicle.parameters import Vehicle, load_vehicle

OURS = "recursion"
SAME = 1e-5  # plans are the same if no torque differs by more, relative to the torque limit
_QUIET = {"print_time": False, "error_on_fail": False, "calc_lam_p": False}
_IPOPT = {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.bound_relax_factor": 0.0}
_SQP = {"print_header": False, "print_iteration": False, "print_status": False}
_SQP |= {"tol_pr": 1e-8, "tol_du": 1e-6, "max_iter": 20, "qpsol": "qrqp"}
_SQP |= {"qpsol_options": {"error_on_fail": False, "print_iter": False, "print_header": False, "print_info": False}}
PEERS = {"ipopt": ("ipopt", _QUIET | _IPOPT), "sqp_qrqp": ("sqpmethod", _QUIET | _SQP)}  # plugins of CasADi, options
_REGULAR = {"ipopt": 0.0, "sqp_qrqp": 1e-6}  # added curvature, which qrqp needs; it does not move the optimum
_N, _DYNAMICS = len(STATES), problem.dynamics


def _dynamics(*model: str) -> ca.Function:
    """`problem.dynamics` as a C function and not inlined at every stage; only x and du have derivatives."""
    step = _DYNAMICS(*model)
    given = step.sx_in()
    following, *_ = step(*given[:-1], 1)
    options = {"never_inline": True, "cse": True, "is_diff_in": [i < 2 for i in range(len(given))]}
    return ca.Function("next_state", given, [following, 0], options)


def _derivatives(program: dict, function: ca.Function, regular: float) -> ca.Function:
    """A function that a plugin needs, with the Hessian of the costs in place of the Hessian of the Lagrangian."""
    x, p, f, g = (program[name] for name in "xpfg")
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
    hessian = ca.triu(lam_f * ca.hessian(f, x)[0] + regular * ca.DM.eye(x.numel()))
    slope = ca.densify(ca.gradient(lam_f * f + ca.dot(lam_g, g), x))
    known = {"f": f, "g": g, "grad_gamma_x": slope, "grad_gamma_p": ca.MX.zeros(p.numel())}
    known |= {"triu_hess_gamma_x_x": hessian, "hess_gamma_x_x": ca.triu2symm(hessian)}
    names = function.name_in(), function.name_out()
    return ca.Function(function.name(), [x, p, lam_f, lam_g], [known[name] for name in names[1]], *names)


@lru_cache
def solver(name: str, settings: MPCSettings) -> ca.Function:
    """Make a peer for the problem of some settings, with compiled functions."""
    plugin, options = PEERS[name]
    with mock.patch.object(problem, "dynamics", _dynamics):
        program = ipopt.program.__wrapped__(settings.variant, settings.discretisation, settings.steps)
    plain = ca.nlpsol("peer", plugin, program, options)
    functions = [ca.Function("nlp", [program["x"], program["p"]], [program["f"], program["g"]], ["x", "p"], ["f", "g"])]
    for key in plain.get_function():
        found = plain.get_function(key)
        replaced = key in ("nlp_hess_l", "nlp_grad")
        functions.append(_derivatives(program, found, _REGULAR[name]) if replaced else found)
    functions = list({function.name(): function for function in functions}.values())
    return ca.nlpsol("peer", plugin, str(cache.build(codegen.source_text(functions))), options)


def _prepare(given: dict, found: dict, of: Problem, started: bool) -> None:
    """Write the data of a problem and the last solution, one sample later, into the arguments."""
    steps, x_d = of.settings.steps, of.ahead.x_d
    states, torques, slacks = np.split(np.arange(given["x0"].size), [_N * (steps + 1), _N * (steps + 1) + steps])
    states, first = states.reshape(-1, _N), (of.x_hat - x_d[0]) / SCALE
    track_ahead = [x_d.ravel(), of.ahead.theta[:-1].ravel(), of.parameters]
    given["p"][:] = np.concatenate([*track_ahead, of.settings.tuning(), [of.u_d]])
    given["lbx"][:], given["ubx"][:] = -np.inf, np.inf
    given["lbx"][torques], given["ubx"][torques] = -of.bound / UNIT, of.bound / UNIT
    given["lbx"][slacks], given["lbx"][states[0]], given["ubx"][states[0]] = 0.0, first, first
    given["lbg"][:], given["ubg"][:] = 0.0, 0.0
    given["lbg"][_N * steps :] = -np.inf
    for name, result in (("x0", "x"), ("lam_x0", "lam_x"), ("lam_g0", "lam_g")):
        given[name][:] = found[result] if started else 0.0
    start = given["x0"]
    start[states[:-1]], start[torques[:-1]], start[states[-1]] = start[states[1:]], start[torques[1:]], 0.0
    start[states[0]] = first


def solve_all(name: str, recording: speed.Recording) -> tuple[np.ndarray, np.ndarray]:
    """Solve the problems of a recording in turn by a peer: torques (n, L) (N m) and processor times (n,) (s)."""
    function, plans, seconds, started = solver(name, recording.problems[0].settings), [], [], False
    buffer, call = function.buffer()
    given = {key: np.zeros(function.nnz_in(key)) for key in function.name_in()}
    found = {key: np.zeros(function.nnz_out(key)) for key in function.name_out()}
    for arrays, connect in ((given, buffer.set_arg), (found, buffer.set_res)):
        for i, array in enumerate(arrays.values()):
            connect(i, memoryview(array))
    for of in recording.problems:
        _prepare(given, found, of, started)
        begin = time.thread_time()
        call()
        seconds.append(time.thread_time() - begin)
        started = all(np.isfinite(found[key]).all() for key in ("x", "lam_x", "lam_g"))
        first = _N * (of.settings.steps + 1)
        plans.append(UNIT * found["x"][first : first + of.settings.steps])
    return np.array(plans), np.array(seconds)


def compare(recording: speed.Recording, vehicle: Vehicle, rounds: int = 3) -> pd.DataFrame:
    """Solve one recording by all solvers, `rounds` times: a row of data/results/peer_times.csv per solver. `error_du`
    is the largest difference from the torques of Ipopt over the torque limit; `missed` counts the problems with one
    above `SAME`."""
    settings, found = recording.problems[0].settings, {name: [] for name in (OURS, *PEERS)}
    for _ in range(rounds):
        found[OURS].append(speed.solve_all("gauss_newton", recording, vehicle)[:2])
        for name in PEERS:
            found[name].append(solve_all(name, recording))
    least = {name: np.min([seconds for _, seconds in solved], axis=0) for name, solved in found.items()}
    rows = []
    for name, times in least.items():
        error = np.abs(found[name][-1][0] - found["ipopt"][-1][0]).max(axis=1) / vehicle.drive.torque_limit
        row = {"solver": name, "scenario": recording.scenario, "discretisation": settings.discretisation}
        row |= {"steps": settings.steps, "period_ms": 1e3 * settings.period, "n": len(times)}
        row |= {"median_ms": 1e3 * np.median(times), "p95_ms": 1e3 * np.percentile(times, 95)}
        row |= {"max_ms": 1e3 * times.max(), "ratio_to_ours": np.median(times) / np.median(least[OURS])}
        rows.append(row | {"error_du": error.max(), "missed": int((error > SAME).sum())})
    return pd.DataFrame(rows)


if __name__ == "__main__":
    car = load_vehicle()
    tuned = [mpc_settings(parameters("nmpc", name)) for name in ("loop", "paper")]
    chosen = tuned[0], replace(tuned[1], discretisation="euler")  # that of the paper
    plain = [speed.record("curve_entry_T3", settings, car, 6) for settings in chosen]
    recordings = [recording for one in plain for recording in (one, speed.tightened(one))]
    table = pd.concat([compare(recording, car) for recording in tqdm(recordings, desc="peers")], ignore_index=True)
    table["machine"] = speed.machine()
    write(paths.product("data/results/peer_times.csv"), table.to_csv(index=False, float_format="%.4g"))
    print(table.drop(columns="machine").to_string(index=False))
