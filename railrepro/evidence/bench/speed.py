"""Computation times of the solvers of the predictive controllers, and of the runs of a study, as ratios on one machine.
Serves the paper's section Evaluation of Lateral Control (computation times)."""

import platform
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
import pandas as pd
from tqdm import tqdm

from railrepro import paths
from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.problem import MPCSettings, Problem
from railrepro.control.registry import CONTROLLERS, LOOP, PAPER, SETTINGS, mpc_settings, parameters
from railrepro.data import write
from railrepro.model.control_model import Y
from railrepro.simulation import scenarios, simulate
from railrepro.simulation.closed_loop import ClosedLoop
from railrepro.studies.experiment import Experiment
from railrepro.track.route import Route
from railrepro.tuning.cost import driven
from railrepro.tuning.task import load_task
from railrepro.vehicle.parameters import Vehicle, load_vehicle

SCENARIOS = *(f"curve_entry_T{k}" for k in range(1, 5)), "sine_tracking", "adhesion_loss", "braking"
KINDS = ("ipopt", "gauss_newton", "rti", "ltv_mpc")


class Recording(NamedTuple):
    """Successive optimal control problems (`problems`) that NMPC had to solve for the front running gear in a simulated
    scenario, with the name of the scenario and its route."""

    scenario: str
    route: Route
    problems: tuple[Problem, ...]


class Recorder(NMPC):
    """NMPC that appends each optimal control problem to its list `problems` before it solves it, for `record`."""

    def __init__(self, *arguments) -> None:
        super().__init__(*arguments)
        self.problems: list[Problem] = []

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Record the problem for a gear with state `x_hat` (shape (6,), SI) and base torque `u_d` per wheel (N m), then
        solve it; returns the differential torque (N m)."""
        self.problems.append(self.problem(x_hat, u_d))
        return super().plan(x_hat, u_d)


def record(name: str, settings: MPCSettings, vehicle: Vehicle, count: int = 32) -> Recording:
    """Simulate a scenario under NMPC with `settings` and return `count` successive problems from the middle of the run
    on. `name` is the scenario in data/scenarios.toml; the run of "braking" ends at 500 m, before the car stops."""
    scenario = scenarios.load_scenario(name)
    if name == "braking":
        scenario = scenario.but(end_m=500.0)
    run = simulate.run(scenario, lambda v, w, g: Recorder(v, w, g, settings), vehicle=vehicle)
    problems = run.controllers[0].problems
    first = len(problems) // 2
    return Recording(name, scenario.route(), tuple(problems[first : first + count]))


def tightened(recording: Recording) -> Recording:
    """Copy of a recording in which bounds are active: |du| <= 60 N m, and softly |y| <= 0.6 max |set point of y|."""
    problems = recording.problems
    largest = max(np.abs(problem.ahead.x_d[:, Y]).max() for problem in problems)
    tight = replace(problems[0].settings, lateral_bound=0.6 * largest, yielding=True)
    hard = tuple(replace(problem, settings=tight, tau_max=60.0) for problem in problems)
    return Recording(f"{recording.scenario}, bounds active", recording.route, hard)


def solve_all(kind: str, recording: Recording, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Solve the n problems in order, each warm-started by the one before. `kind`, one of `KINDS`, is "gauss_newton"
    (Newton iterations of NMPC until convergence), "rti" (one of them), "ipopt" (NMPC by Ipopt) or "ltv_mpc" (one linear
    time-variant problem). Returns a tuple: planned differential torques over the L steps of the horizon (n, L) (N m);
    processor time per problem, with forecast and preparation (n,) (s); iterations (n,); number of unsolved problems."""
    first, torques = recording.problems[0], []
    limited = replace(vehicle, drive=replace(vehicle.drive, torque_limit=first.tau_max))
    given = limited, recording.route, 0, first.settings
    solver = LTVMPC(*given) if kind == "ltv_mpc" else NMPC(*given, solver=kind)
    for problem in recording.problems:
        solver.plan(problem.x_hat, problem.u_d)
        torques.append(solver.plan_du.copy())
    seconds, iterations = np.transpose(solver.stats)
    return np.array(torques), seconds, iterations, solver.fallbacks


def solve_times(vehicle: Vehicle, settings: MPCSettings) -> pd.DataFrame:
    """Compare the solvers `KINDS` on recorded problems: one row per solver and recording. Each of `SCENARIOS` is
    recorded under NMPC with `settings` and gives two recordings: as it is, and `tightened` (bounds active). Columns:
    solver; scenario; n, number of problems; median_ms, p95_ms and max_ms, time per problem (ms); iterations_median;
    ratio_to_ipopt, of the median times (-); failures, number of problems without a solution; largest_torque_difference,
    from the torques of ipopt over the torque limit (-)."""
    rows = []
    plain = [record(name, settings, vehicle) for name in SCENARIOS]
    recordings = [recording for one in plain for recording in (one, tightened(one))]
    for recording in tqdm(recordings, desc="solvers", unit="scenario"):
        solved = {kind: solve_all(kind, recording, vehicle) for kind in KINDS}
        exact, reference, *_ = solved["ipopt"]
        for kind, (du, seconds, iterations, failures) in solved.items():
            difference = np.abs(du - exact).max() / vehicle.drive.torque_limit
            row = {"solver": kind, "scenario": recording.scenario, "n": len(seconds)}
            row |= {"median_ms": 1e3 * np.median(seconds), "p95_ms": 1e3 * np.percentile(seconds, 95)}
            row |= {"max_ms": 1e3 * seconds.max(), "iterations_median": np.median(iterations)}
            row |= {"ratio_to_ipopt": np.median(seconds) / np.median(reference), "failures": failures}
            rows.append(row | {"largest_torque_difference": difference})
    return pd.DataFrame(rows)


def horizon_times(vehicle: Vehicle, settings: MPCSettings) -> pd.DataFrame:
    """Measure solution times on track T3 for horizons of 10 to 160 steps: a row per solver and length. `settings` are
    those of NMPC, except steps. Columns solver; steps; median_ms, time per problem (ms); iterations_median."""
    rows = []
    for steps in tqdm((10, 20, 40, 80, 160), desc="horizons", unit="length"):
        recording = record("curve_entry_T3", replace(settings, steps=steps), vehicle, count=12)
        for kind in ("gauss_newton", "rti", "ltv_mpc", "ipopt"):
            _, seconds, iterations, _ = solve_all(kind, recording, vehicle)
            row = {"solver": kind, "steps": steps, "median_ms": 1e3 * np.median(seconds)}
            rows.append(row | {"iterations_median": np.median(iterations)})
    return pd.DataFrame(rows)


def study_times(
    controllers: Sequence[str] = ("ndi", "nmpc"), settings: Sequence[str] = (PAPER, LOOP), repeats: int = 5
) -> pd.DataFrame:
    """Measure how long a run takes in tuning: one row per controller and setting, "paper" (exact measurements) or
    "loop" (sensors). Each run of data/tuning.toml for the setting is simulated anew `repeats` times, none is read from
    the store. Columns: setting; controller; run_ms, processor time of a whole run, and loop_ms, of the compiled closed
    loop in it (ms), each the median over repeats, then the mean over runs; ratio, run_ms / loop_ms (-)."""
    rows = []
    for setting, controller in product(settings, controllers):
        task, quick, tuned = load_task(setting=setting), CONTROLLERS[controller].quick, parameters(controller, setting)
        runs = [replace(run, controller=controller, parameters=tuned, options=quick) for run in task.runs.values()]
        times = [[_study_time(run) for run in runs] for _ in range(1 + repeats)][1:]  # the first fills caches
        of_run, of_loop = 1e3 * np.median(times, axis=0).mean(axis=0)
        rows.append([setting, controller, of_run, of_loop, of_run / of_loop])
    return pd.DataFrame(rows, columns=["setting", "controller", "run_ms", "loop_ms", "ratio"])


def _study_time(run: Experiment) -> tuple[float, float]:
    """Processor time of a run in a study, and of its compiled loop (s)."""
    inside, drive = [], ClosedLoop.run

    def timed(loop: ClosedLoop, n: int) -> np.ndarray:
        start = time.process_time()
        log = drive(loop, n)
        inside.append(time.process_time() - start)
        return log

    with patch.object(ClosedLoop, "run", timed):
        begin = time.process_time()
        run.key(driven)
        driven(run.run(), run)
        return time.process_time() - begin, sum(inside)


def machine() -> str:
    """Name of the processor, as "AMD EPYC 7763"; its architecture where the name is unknown."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def main() -> None:
    """Command `bench`: measure computation times and write two tables to data/results: solve_times.csv (columns of
    `solve_times`, setting, machine), once with the weights of NMPC tuned for exact measurements ("paper"), once with
    those for sensors ("loop"), and horizon_times.csv with the former. Prints both, and `study_times`."""
    vehicle, of = load_vehicle(), {name: mpc_settings(parameters("nmpc", name)) for name in SETTINGS}
    solvers = pd.concat([solve_times(vehicle, settings).assign(setting=name) for name, settings in of.items()])
    tables = {"solve_times": solvers, "horizon_times": horizon_times(vehicle, of[PAPER])}
    for name, table in tables.items():
        table["machine"] = machine()
        write(paths.product(f"data/results/{name}.csv"), table.to_csv(index=False, float_format="%.4g"))
        print(f"\n{name}\n{table.drop(columns='machine').to_string(index=False)}")
    print(f"\na run of a study over its compiled loop\n{study_times().to_string(index=False, float_format='%.3g')}")
