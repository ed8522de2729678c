"""The peers of our recursion: Ipopt, fatrop, SQP with HPIPM, DAQP, OSQP and qrqp, on the same problem.

All get the optimal control problem stage by stage with its functions as compiled C, the Hessian of the costs, the same
start (the solution before, one sample later) and tolerances that lead to the same optimum, which `compare` measures.
What is timed is one call without Python objects in between, of the processor, each problem several times in turn with
the others; the least counts. `python tests/validation/peers.py` writes data/results/peer_times.csv. Serves the paper's
section Evaluation of Lateral Control (computation times).
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import pandas as pd
from tqdm import tqdm

from railrepro import paths
from railrepro.compile import cache, codegen
from railrepro.control import problem as ocp
from railrepro.control.problem import TUNING, MPCSettings, Problem, Tuning
from railrepro.control.registry import mpc_settings
from railrepro.control.solvers.ipopt import COST, SCALE, SLACK, UNIT
from railrepro.data import write
from railrepro.evidence.bench import speed
from railrepro.evidence.commands import report_errors
from railrepro.evidence.runs import tuning
from railrepro.model.control_model import STATES, THETA
from railrepro.model.parameters import PARAMETERS
from railrepro.vehicle.parameters import Vehicle, load_vehicle

OURS = "recursion"
SAME = 1e-5
"""Plans are the same when no torque differs by more than this part of the torque limit."""
_REGULAR = 1e-6
"""Curvature that is added to what has none, which some plugins need; the optimum is not moved by it."""
_QUIET = {"print_time": False, "error_on_fail": False, "calc_lam_p": False}
_SQP = {"print_header": False, "print_iteration": False, "print_status": False}
_SQP |= {"tol_pr": 1e-8, "tol_du": 1e-6, "max_iter": 20}
_HPIPM = {"mode": "speed", "iter_max": 100} | dict.fromkeys(("res_g_max", "res_b_max", "res_d_max", "res_m_max"), 1e-8)
_OSQP = {"osqp.verbose": False, "osqp.eps_abs": 1e-9, "osqp.eps_rel": 1e-9, "osqp.max_iter": 1000, "osqp.polish": True}
_QRQP = {"print_iter": False, "print_header": False, "print_info": False}
_N = len(STATES)


def _sqp(plugin: str, **options) -> tuple[str, dict]:
    return "sqpmethod", _SQP | {"qpsol": plugin, "qpsol_options": {"error_on_fail": False} | options}


PEERS = {
    "ipopt": ("ipopt", {"ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-9, "ipopt.bound_relax_factor": 0.0}),
    "fatrop": ("fatrop", {"structure_detection": "auto", "fatrop.print_level": 0, "fatrop.tolerance": 1e-9}),
    "sqp_hpipm": _sqp("hpipm", inf=1e4, hpipm=_HPIPM),
    "sqp_daqp": _sqp("daqp"),
    "sqp_osqp": _sqp("osqp", **_OSQP),
    "sqp_qrqp": _sqp("qrqp", **_QRQP),
}
"""Plugin and options of each peer inside CasADi."""


class Stages(NamedTuple):
    """The nonlinear program in the order that stage-wise solvers want: x_0, u_0, x_1, u_1 …"""

    program: dict
    """Variables x, parameters p, objective f, constraints g (MX); states are scaled deviations from the desired."""
    equality: np.ndarray
    """Which constraints are equations; the others are at most zero."""
    states: np.ndarray
    """Where they stand in x, shape (L + 1, 6)."""
    torques: np.ndarray
    """Shape (L,)."""
    slacks: np.ndarray
    """Shape (L + 1,)."""


def _model(settings: MPCSettings) -> ca.Function:
    """The next state, called in the C and not written out for every stage; only state and torque have derivatives."""
    step = ocp.dynamics(settings.variant, settings.discretisation)
    sizes = {"x": _N, "du": 1, "u_d": 1, "theta": len(THETA), "par": len(PARAMETERS), "T": 1}
    inputs = [ca.SX.sym(name, size) for name, size in sizes.items()]
    following, *_ = step(*inputs, 1)
    options = {"never_inline": True, "cse": True, "is_diff_in": [name in ("x", "du") for name in sizes]}
    return ca.Function("next_state", inputs, [following], options)


def _places(steps: int) -> tuple[list[int], np.ndarray, np.ndarray, np.ndarray]:
    """Sizes of the pieces of x, and where states, torques and slacks stand.

    The slack of the last state is a state of the last stage, for HPIPM has no controls there; it follows from the one
    before.
    """
    sizes: list[int] = []
    states, torques, slacks = [], [], []
    for k in range(steps + 1):
        begin = sum(sizes)
        states.append(np.arange(begin, begin + _N))
        controls = (k < steps) + (k > 0) + (k == steps - 1)
        sizes += [_N] + [1] * controls
        own = list(range(begin + _N, begin + _N + controls))
        if k < steps:
            torques.append(own.pop(0))
        slacks += own
    return sizes, np.array(states), np.array(torques), np.array(slacks)


def stages(settings: MPCSettings, sign: int = 1) -> Stages:
    """The program of some settings; `sign` of the equations, +1 as fatrop has them or -1 as HPIPM."""
    steps, following = settings.steps, _model(settings)
    sizes, states, torques, slacks = _places(steps)
    parts = [_N, _N * (steps + 1), len(THETA) * steps, len(PARAMETERS), len(TUNING), 1]
    p, x = ca.MX.sym("p", sum(parts)), ca.MX.sym("x", sum(sizes))
    first, x_d, theta, par, tuning, u_d = ca.vertsplit(p, np.cumsum([0, *parts]).tolist())
    x_d, theta, t = ca.reshape(x_d, _N, steps + 1), ca.reshape(theta, len(THETA), steps), Tuning.of(tuning)
    at = dict(zip(np.cumsum([0, *sizes[:-1]]).tolist(), ca.vertsplit(x, np.cumsum([0, *sizes]).tolist()), strict=True))
    z, slack = [at[row[0]] for row in states.tolist()], [at[i] for i in slacks.tolist()]
    cost, constraints, equality = 0, [], []

    def add(values, equations: bool) -> None:
        constraints.append(values)
        equality.extend([equations] * values.numel())

    for k in range(steps + 1):
        state = x_d[:, k] + ca.DM(SCALE) * z[k]
        if k < steps:
            torque = UNIT * at[int(torques[k])]
            reached = following(state, torque, u_d, theta[:, k], par, t.period)
            add(sign * (z[k + 1] - (reached - x_d[:, k + 1]) / SCALE), True)
            cost += ocp.effort_cost(torque, t)
        if k == steps - 1:
            add(sign * (slack[-1] - slack[-2]), True)
        if k == 0:
            add(z[0] - first, True)
            continue
        own = slack[-1] if k == steps else slack[k - 1]
        of_state = ocp.terminal_cost if k == steps else ocp.stage_cost
        cost += of_state(state, x_d[:, k], SLACK * own, t)
        for excess in ocp.lateral_excess(state, t):
            add(excess / SLACK - own, False)
    program = {"x": x, "p": p, "f": COST * cost, "g": ca.vertcat(*constraints)}
    return Stages(program, np.array(equality), states, torques, slacks)


def _derivatives(program: dict, function: ca.Function, regular: float) -> ca.Function:
    """A function that a plugin asks for, with the Hessian of the costs in place of that of the Lagrangian."""
    x, p, f, g = (program[name] for name in "xpfg")
    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", g.numel())
    hessian = ca.triu(lam_f * ca.hessian(f, x)[0] + regular * ca.DM.eye(x.numel()))
    slope = ca.densify(ca.gradient(lam_f * f + ca.dot(lam_g, g), x))
    known = {"f": f, "g": g, "grad_gamma_x": slope, "grad_gamma_p": ca.MX.zeros(p.numel())}
    known |= {"triu_hess_gamma_x_x": hessian, "hess_gamma_x_x": ca.triu2symm(hessian)}
    names = function.name_in(), function.name_out()
    return ca.Function(function.name(), [x, p, lam_f, lam_g], [known[name] for name in names[1]], *names)


@lru_cache
def solver(name: str, settings: MPCSettings) -> tuple[ca.Function, Stages]:
    """A peer on the problem of some settings, its functions compiled, and the program that it solves."""
    plugin, options = PEERS[name]
    options = _QUIET | options
    stated = stages(settings, -1 if plugin == "sqpmethod" else 1)
    if plugin == "fatrop":
        options = options | {"equality": stated.equality.tolist()}
    program = stated.program
    plain = ca.nlpsol("peer", plugin, program, options)
    functions = [ca.Function("nlp", [program["x"], program["p"]], [program["f"], program["g"]], ["x", "p"], ["f", "g"])]
    for key in plain.get_function():
        found = plain.get_function(key)
        replaced = key in ("nlp_hess_l", "nlp_grad")
        regular = 0.0 if plugin == "ipopt" else _REGULAR
        functions.append(_derivatives(program, found, regular) if replaced else found)
    functions = list({function.name(): function for function in functions}.values())
    return ca.nlpsol("peer", plugin, str(cache.build(codegen.source_text(functions))), options), stated


class Peer:
    """A peer that solves problem after problem, from the solution before, one sample later."""

    def __init__(self, name: str, settings: MPCSettings):
        function, self._stated = solver(name, settings)
        self._buffer, self._function = function.buffer()
        self._given = {key: np.zeros(function.nnz_in(key)) for key in function.name_in()}
        self._found = {key: np.zeros(function.nnz_out(key)) for key in function.name_out()}
        for i, array in enumerate(self._given.values()):
            self._buffer.set_arg(i, memoryview(array))
        for i, array in enumerate(self._found.values()):
            self._buffer.set_res(i, memoryview(array))
        self._started = False

    def solve(self, problem: Problem) -> tuple[np.ndarray, float]:
        """Torques (L,) (N m) and the time of the processor (s); the data are put in place before."""
        self._prepare(problem)
        begin = time.thread_time()
        try:
            self._function()
        except RuntimeError:  # reported by CasADi
            return np.full(problem.settings.steps, np.nan), time.thread_time() - begin
        spent = time.thread_time() - begin
        self._started = all(np.isfinite(self._found[name]).all() for name in ("x", "lam_x", "lam_g"))
        return UNIT * self._found["x"][self._stated.torques], spent

    def _prepare(self, problem: Problem) -> None:
        given, found, at, x_d = self._given, self._found, self._stated, problem.ahead.x_d
        first = (problem.x_hat - x_d[0]) / SCALE
        track_ahead = [x_d.ravel(), problem.ahead.theta[:-1].ravel(), problem.parameters]
        given["p"][:] = np.concatenate([first, *track_ahead, problem.settings.tuning(), [problem.u_d]])
        given["lbx"][:], given["ubx"][:] = -np.inf, np.inf
        given["lbx"][at.torques], given["ubx"][at.torques] = -problem.bound / UNIT, problem.bound / UNIT
        given["lbx"][at.slacks] = 0.0
        given["lbg"][:], given["ubg"][:] = np.where(at.equality, 0.0, -np.inf), 0.0
        for name, result in (("x0", "x"), ("lam_x0", "lam_x"), ("lam_g0", "lam_g")):
            given[name][:] = found[result] if self._started else 0.0
        start = given["x0"]
        if self._started:
            start[at.states[:-1]], start[at.torques[:-1]] = start[at.states[1:]], start[at.torques[1:]]
            start[at.states[-1]] = 0.0
        start[at.states[0]] = first


class Own:
    """Our recursion in the same frame: whole samples of NMPC until it has converged, with their forecast."""

    def __init__(self, vehicle: Vehicle, recording):
        self._controller = speed.controller("gauss_newton", recording, vehicle)

    def solve(self, problem: Problem) -> tuple[np.ndarray, float]:
        """See `Peer.solve`."""
        self._controller.plan(problem.x_hat, problem.u_d)
        return self._controller.plan_du.copy(), self._controller.stats[-1].seconds


def compare(recording, vehicle: Vehicle, names: Sequence[str] = tuple(PEERS), rounds: int = 3) -> pd.DataFrame:
    """All solvers on one recording, in turn at each problem (contract of data/results/peer_times.csv).

    Each problem is solved `rounds` times by each solver; the least time counts. `error_du` is the largest difference
    from the torques of Ipopt or, without it, from ours, relative to the torque limit; `missed` counts the problems
    where it is above `SAME`.
    """
    settings = recording.problems[0].settings
    everybody = (OURS, *names)
    seconds = np.empty((len(everybody), rounds, len(recording.problems)))
    plans: dict[str, list[np.ndarray]] = {}
    for turn in range(rounds):
        solvers = [Own(vehicle, recording), *(Peer(name, settings) for name in names)]
        plans = {name: [] for name in everybody}
        for i, problem in enumerate(recording.problems):
            for j in np.roll(np.arange(len(everybody)), i + turn):
                torques, seconds[j, turn, i] = solvers[j].solve(problem)
                plans[everybody[j]].append(torques)
    least, reference = seconds.min(axis=1), np.array(plans["ipopt" if "ipopt" in names else OURS])
    rows = []
    for name, times in zip(everybody, least, strict=True):
        error = np.nan_to_num(np.abs(np.array(plans[name]) - reference).max(axis=1), nan=np.inf)
        error /= vehicle.drive.torque_limit
        row = {"solver": name, "scenario": recording.scenario, "discretisation": settings.discretisation}
        row |= {"steps": settings.steps, "period_ms": 1e3 * settings.period, "n": len(times)}
        row |= {"median_ms": 1e3 * np.median(times), "p95_ms": 1e3 * np.percentile(times, 95)}
        row |= {"max_ms": 1e3 * times.max(), "ratio_to_ours": np.median(times) / np.median(least[0])}
        rows.append(row | {"error_du": error.max(), "missed": int((error > SAME).sum())})
    return pd.DataFrame(rows)


def main(_names: list[str], count: int = 6) -> None:
    """Compare on the curve entry, print the table and write it.

    The problems are those of our tuned set, and of the paper's setting with the paper's discretisation, each with
    bounds far and near.
    """
    vehicle = load_vehicle()
    tuned = [mpc_settings(tuning.load("nmpc", name)["parameters"]) for name in ("equal", "paper")]
    chosen = tuned[0], replace(tuned[1], discretisation="euler")
    plain = [speed.record("curve_entry_T3", settings, vehicle, count) for settings in chosen]
    recordings = [recording for one in plain for recording in (one, speed.tightened(one))]
    table = pd.concat([compare(recording, vehicle) for recording in tqdm(recordings, desc="peers")], ignore_index=True)
    table["machine"] = speed.machine()
    write(paths.product("data/results/peer_times.csv"), table.to_csv(index=False, float_format="%.4g"))
    print(table.drop(columns="machine").to_string(index=False))


if __name__ == "__main__":
    sys.exit(report_errors(lambda: main(sys.argv[1:])))
