"""The open benchmark: one suite of runs scores a controller, a registered one or that of a user, from 0 to 100 points.

The cost of a run is

    J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1).

For the front gear e is the RMS lateral error (with sensors: relative to the irregular rails), T the RMS differential
torque, A its part above 5 Hz. u is the adhesion utilisation where the demand exceeds the adhesion limit, else 1. s is
the larger of Y/Q over 0.8 and the track shifting force over its limit. With q = 1 / (1 + J) the points of a run are

    100 (q - q_0) / (q_l - q_0), between 0 and 100,

with q_0 of a car without guidance in the same run (0 where that derails) and q_l of the limit (`ends_of_the_scale`). A
failed run has no points. The runs with more delay or a slower drive count as one. The score is the mean over runs, then
over settings. A seed determines sensor noise, irregularities and cars. The published seed is for development; a file is
ranked by seeds that follow from its content (`ranked_seeds`).
"""

import hashlib
import multiprocessing
import runpy
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import __version__, data, paths
from railrepro.control import lateral
from railrepro.control.registry import CONTROLLERS, INVERSIONS, LOOP, NOTHING, PAPER, SETTINGS, SHOWN, Controller
from railrepro.data import InputError
from railrepro.estimation.sensors import Loop, readings
from railrepro.evidence.uncertainty import limit as bound
from railrepro.simulation.ride import Y_OVER_Q_LIMIT
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.simulation.simulate import Run
from railrepro.studies import store
from railrepro.studies.executor import ordered_map, work
from railrepro.studies.experiment import Experiment
from railrepro.track.irregularity import CHANNELS
from railrepro.track.route import INDEX, Route
from railrepro.tuning.cost import evaluate
from railrepro.tuning.task import load_task
from railrepro.vehicle.parameters import load_vehicle, sample_ranges

MISMATCH = ("body.mass", "gear.mass", "gear.inertia_z", "wheel.spin_inertia", "suspension.k_x")
MISMATCH += ("suspension.c_x", "suspension.k_y", "drive.lag")
"""Parameters of the car that its controller does not know, drawn from their ranges in data/vehicle.toml."""
MARGINS = "margins"
"""Group of the runs with more delay or a slower drive, which count as one run."""
PUBLISHED, RANKED = 1001, (1277232150, 1310670857, 1121027952, 785067208, 1683094607)
"""The seed for development, and the seeds that rank the controllers of this project, which were not tuned on them."""
_SALT = b"railrepro benchmark 3"
"""Hashed before the content of a file, see `ranked_seeds`; a new suite of runs gets another one."""
ALL = "all"
"""Scenario, and setting, of the rows of a summary."""
LEADERBOARD = "data/results/leaderboard.csv"
_PATCH = ((0.0, 0.0), (299.5, 0.0), (300.5, 1.0), (499.5, 1.0), (500.5, 0.0))
_WALKS, _ACTIVITIES = (220.0, 20.0), (20.0, 50.0, 115.0, 500.0)
"""Random walks of force and moment in the quietest run (N/s^0.5, N m/s^0.5); torques above 5 Hz to try (N m)."""
_MODULE = "railrepro_own_controller"
LIMIT = 600.0
"""Time limit of a run of a user's file (s)."""
METRICS = {"error": "m", "limit": "m", "effort_du": "N m", "activity_du": "N m", "utilisation": "-"}
METRICS |= {"stopping_distance": "m", "comfort": "-", "y_over_q": "-", "sum_y_over_limit": "-", "wheel_unloading": "-"}
"""Metric of a run -> unit; `limit` is the bound of the error, `comfort` the largest N_MV."""
_LARGEST = ("y_over_q", "sum_y_over_limit", "wheel_unloading")
"""Metrics of which a summary has the largest value; of the others it has the mean."""


def cases(seed: int, names: Sequence[str] | None = None) -> list[Experiment]:
    """Make the runs of the suite, as experiments without guidance into which `drive` puts a controller. Each run occurs
    in both settings: in "paper" with exact measurements, in "loop" with sensors. `seed` (0 to 2^31) determines sensor
    noise and biases, irregularities and, in two runs, parameters of the car (`MISMATCH`). `names` selects runs by name,
    as "curve_T3" (default all); InputError for an unknown one. Labels of an experiment are scenario (name of the run),
    setting and group; runs of one group count as one in the score."""
    suite, runs = [], _runs(seed)
    known = [name for name, *_ in runs]
    chosen = known if names is None else names
    if not chosen or set(chosen) - set(known):
        raise InputError(f"benchmark: the names of the runs are {[*chosen]}, one or more of {known} are needed")
    for setting, (name, group, draw, scenario, more) in product(SETTINGS, runs):
        if name in chosen:
            delay = more.get("sensors", {})
            sensors = {"seed": draw} if setting == LOOP else {"perfect": True} if delay else {}
            label, around = {"scenario": name, "setting": setting, "group": group}, more | {"sensors": sensors | delay}
            suite.append(Experiment(scenario, NOTHING, label, {}, setting=setting, ride=True, **around))
    return suite


def _runs(seed: int) -> list[tuple[str, str, int, Scenario, dict]]:
    """Name, group and sensor seed of each run, its scenario and further fields of `Experiment`."""
    ends = {"T1": 200.0, "T2": 600.0, "T3": 600.0, "T4": 700.0}
    runs = {f"curve_{name}": load_scenario(f"curve_entry_{name}").but(end_m=end) for name, end in ends.items()}
    sine = load_scenario("sine_tracking")
    for speed, end in {100: 400.0, 250: 600.0, 400: 800.0}.items():
        runs[f"sine_{speed}"] = sine.but(speed_kmh=float(speed), end_m=end)
    pulled = sine.but(track="T3", speed_kmh=280.0, end_m=600.0, force_kN=((0.0, 17.0),))
    runs["loss_one_side"] = pulled.but(poor_share_left=_PATCH)
    runs["loss_both_sides"] = pulled.but(poor_share=_PATCH)
    runs["braking_patch"] = load_scenario("braking").but(poor_share=_PATCH, end_m=1450.0)
    changed: dict[str, dict] = {"irregular": {"irregular": {"spectrum": "en_B_300", "seed": seed}}}
    changed["cone"] = {"plant": {"contact.profile": "cone"}}
    ranges = sample_ranges()
    lows, highs = np.array([ranges[name] for name in MISMATCH]).T
    for number in (1, 2):
        drawn = lows + np.random.default_rng((seed, number)).random(len(MISMATCH)) * (highs - lows)
        changed[f"mismatch_{number}"] = {"plant": dict(zip(MISMATCH, drawn.tolist(), strict=True))}
    runs |= dict.fromkeys(changed, runs["curve_T3"].but(end_m=500.0))
    suite = [(name, name, seed, run, changed.get(name, {})) for name, run in runs.items()]
    slower = {f"lag_{ms}ms": {"plant": {"drive.lag": 1e-3 * ms}} for ms in (20, 30, 40, 50)}
    slower |= {f"delay_{ms}ms": {"sensors": {"inverter.delay": 1e-3 * ms}} for ms in (3, 6, 9, 12)}
    rails = {"dry": "sine_tracking", "poor": "adhesion_loss"}
    for number, (rail, change) in enumerate(product(rails, slower), seed + 1):
        short = load_scenario(rails[rail]).but(end_m=400.0)
        suite.append((f"{change}_{rail}", MARGINS, number % 2**31, short, slower[change]))
    return suite


def entry(controller: str) -> str | Path:
    """Check the controller to score: a name in `registry.CONTROLLERS` is returned as it is, the path of a Python file
    is resolved; InputError for all else."""
    if controller in CONTROLLERS:
        return controller
    file, known = data.location(controller), [*CONTROLLERS]
    if not file.is_file():
        raise InputError(f"controller {controller!r} is neither a file nor a registered controller; there are {known}")
    return file.resolve()


def ranked_seeds(of: str | Path) -> tuple[int, ...]:
    """Seeds whose scores rank a controller (`of` is a result of `entry`): the five `RANKED` for a registered name; for
    a file five from its SHA-256, so that nobody can tune to them (any change but of line endings gives others)."""
    if isinstance(of, str):
        return RANKED
    digest = hashlib.sha256(_SALT + of.read_bytes().replace(b"\r\n", b"\n")).digest()
    return tuple(int.from_bytes(digest[4 * i : 4 * i + 4], "big") // 2 for i in range(len(RANKED)))


def name_of(of: str | Path | type) -> str:
    """Name of a controller in tables: a registered name as it is, the name of a class, or a file's name with suffix."""
    return of if isinstance(of, str) else getattr(of, "__name__", None) or of.name


def load_class(file: Path) -> type:
    """Run a Python file and return its only class with a method `torque` or `plan`; InputError for none or several."""
    content = runpy.run_path(str(file), run_name=_MODULE).values()
    classes = [each for each in content if isinstance(each, type) and each.__module__ == _MODULE]
    fitting = [each for each in classes if hasattr(each, "torque") or hasattr(each, "plan")]
    if len(fitting) != 1:
        names = [each.__name__ for each in fitting]
        raise InputError(f"one class with `torque` or with `plan` is needed, found {names}")
    return fitting[0]


def make_guidance(controller: type, settings: Mapping[str, float]) -> lateral.Guidance:
    """Make the guidance for `simulate.run` from a user's controller class and its keyword arguments `settings`: the
    object controller(**settings), or for a class with `plan` a factory, which makes one object controller(vehicle,
    route, gear, **settings) per gear, on a route without irregularities and poor adhesion (`known_route`)."""
    if not hasattr(controller, "plan"):
        return controller(**settings)
    return lambda vehicle, route, gear: controller(vehicle, known_route(route), gear, **settings)


def known_route(route: Route) -> Route:
    """Return a copy of a route in which rails are smooth and nowhere poor. A scored controller gets this copy, because
    irregularities and stretches of poor adhesion must be unknown to it."""
    cells, hidden = np.array(route.cells), (*CHANNELS, "poor_le", "poor_ri")
    cells[:, [i for name, i in INDEX.items() if name in hidden or name.lstrip("d") in hidden]] = 0.0
    return Route(cells, route.length)


def drive(of: str | Path | type, case: Experiment) -> dict:
    """Simulate a run of `cases`; returns its row, a dict. `of` is a key of `registry.CONTROLLERS`, a class, or the path
    of a Python file. The row has the labels of the run, controller (name), failure (one sentence, "" for a good run)
    and metrics (SI). Of the front gear: error, RMS of y - y* (with sensors y from the irregular rails); effort_du, RMS
    differential torque; activity_du, its part above 5 Hz; utilisation of the adhesion limit, only with a force demand;
    stopping_distance, NaN unless the stop speed is reached. Of all wheels: y_over_q, largest wheel force ratio Y/Q;
    sum_y_over_limit, largest track shifting force over its limit; wheel_unloading. comfort: index N_MV, less is better.
    A failed run lacks most of them, or they are NaN; one whose controller raises an error has none. InputError when a
    file ended its process or took over 600 s, if `executor.ordered_map` starts the run with apart=True."""
    head = case.label | {"controller": name_of(of), "failure": ""}
    if isinstance(of, Path):
        run = f"{of.name}: its run {case.label['scenario']} in the setting {case.setting}"
        try:
            return head | work(_driven, of, case, limit=LIMIT)
        except TimeoutError as error:
            raise InputError(f"{run} was given up after {LIMIT:g} s, the time limit") from error
        except BrokenExecutor as error:
            raise InputError(f"{run} ended its process: it exited, crashed or was killed") from error
    if not isinstance(of, str):
        return head | _driven(of, case)
    fields = {"controller": of, "parameters": {} if of == NOTHING else None, "options": CONTROLLERS[of].quick}
    try:
        return head | replace(case, **fields).measured(_row)[0]
    except ArithmeticError as error:
        return head | {"failure": str(error)}


def _driven(of: Path | type, case: Experiment) -> dict:
    """Metrics of a run under a user's controller; a dict with the key failure alone if it raises an error."""
    try:
        controller = load_class(of) if isinstance(of, Path) else of
        tuned = getattr(controller, "tuned", {})
        if set(tuned) - {*SETTINGS}:
            raise InputError(f"{controller.__name__}: `tuned` has the settings {[*tuned]}, there are {[*SETTINGS]}")
        run = replace(case, controller=_registered(controller), parameters=tuned.get(case.setting, {}))
        return _row(run.run(), run)[0]
    except BaseException as error:  # a user's controller may raise anything
        if isinstance(error, KeyboardInterrupt) and multiprocessing.parent_process() is None:
            raise  # Ctrl-C, which does not reach the processes of a study
        lines = [each.lineno for each in traceback.extract_tb(error.__traceback__) if each.filename == str(of)]
        where = f"{name_of(of)}, line {lines[-1]}" if lines else name_of(of)
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        return {"failure": f"{where}: {kind}{' '.join(str(error).split())}".rstrip(": ")[:300]}


def _registered(controller: type) -> str:
    """Enter a user's class into the registry of this process; returns its key there."""
    name = f"own {controller.__name__}"
    CONTROLLERS[name] = Controller(partial(make_guidance, controller), dict, False)
    return name


def _row(run: Run, of: Experiment) -> store.Entry:
    row = {key: value for key, value in of.values(run).items() if isinstance(value, float | int)}
    row["failure"] = run.ended if run.failed else ""
    if not run.ended.startswith("stop"):
        row["stopping_distance"] = float("nan")
    row["comfort"] = max((row[k] for k in row if k.startswith("n_mv_")), default=float("nan"))
    row["error"] = row.get("followed_rmse_y" if of.setting == LOOP else "rmse_y", float("nan"))
    return row, None


def cost(row: dict) -> float:
    """Cost J >= 0 (-, less is better) of a run that did not fail: error / 1 mm + effort_du / 4 kN m + max(0,
    activity_du / 0.5 kN m - 1) + 2 (1 - utilisation) + 10 max(0, s - 1), s the larger of y_over_q / 0.8 and
    sum_y_over_limit. `row` from `drive` has these metrics: error, RMS lateral error (m); effort_du, RMS differential
    torque, and activity_du, its part above 5 Hz (N m); utilisation, used share of the adhesion limit (counts as 1 if
    above or missing); y_over_q, largest wheel force ratio Y/Q; sum_y_over_limit, largest track shifting force over its
    limit. inf if J is not finite."""
    unused = 1 - min(row["utilisation"], 1.0) if np.isfinite(row.get("utilisation", np.nan)) else 0.0
    unsafe = max(row["y_over_q"] / Y_OVER_Q_LIMIT, row["sum_y_over_limit"])
    value = row["error"] / 1e-3 + row["effort_du"] / 4e3 + max(0.0, row["activity_du"] / 500 - 1)
    value += 2 * unused + 10 * max(0.0, unsafe - 1)
    return float(value) if np.isfinite(value) else float("inf")


def points(row: dict) -> float:
    """Points of a run, 0 (cost `nothing`, or failed) to 100 (cost `best`). `row` is its row of `drive` together with
    the entries of its `ends_of_the_scale`."""
    if row["failure"]:
        return 0.0
    q, nothing, best = (1 / (1 + value) for value in (cost(row), row["nothing"], row["best"]))
    return float(np.clip(100 * (q - nothing) / (best - nothing), 0.0, 100.0)) if best > nothing else 0.0


def ends_of_the_scale(case: Experiment) -> dict[str, float]:
    """Compute the costs J (-) that are worth 0 and 100 points in a run of `cases`, and the least error; a dict.
    nothing: cost of the run without guidance, worth 0; inf if it fails. best: cost worth 100. limit: least possible RMS
    lateral error (m). With exact measurements best is 0 and limit NaN. With sensors `uncertainty.limit` computes, for
    dry rail, weak disturbances and the lowest speed of the run, the least error of any causal law whose differential
    torque has an RMS of 20, 50, 115 or 500 N m after a high-pass at 5 Hz. limit is the smallest of the four errors,
    best the smallest of the four sums error / 1 mm + this torque / 4 kN m."""
    row = drive(NOTHING, case)
    ends = {"nothing": float("inf") if row["failure"] else cost(row), "best": 0.0, "limit": float("nan")}
    if case.setting == PAPER:
        return ends
    scenario, loop = case.scenario, readings(**case.sensors).loop
    # the limit grows with speed
    speed = scenario.speed if scenario.stop_kmh is None else max(scenario.stop_speed, 10.0)
    route = scenario.route()
    slopes = route.reference_at(np.arange(0.0, scenario.end_m or route.length))[1]
    key = store.key(__name__, "limit", loop, speed, _WALKS, _ACTIVITIES, load_vehicle())
    errors = store.entry(key, lambda: work(_bounds, loop, speed))[0]["errors"]
    least = [bound.at_true_position(error, slopes, loop) for error in errors]
    best = min(error / 1e-3 + torque / 4e3 for error, torque in zip(least, _ACTIVITIES, strict=True))
    return ends | {"limit": min(least), "best": best}


def _bounds(loop: Loop, speed: float) -> store.Entry:
    return {"errors": [bound.limit(load_vehicle(), loop, speed, _WALKS, activity=a) for a in _ACTIVITIES]}, None


def score(
    of: str | Path | type, seeds: Sequence[int], names: Sequence[str] | None = None, quiet: bool = False
) -> pd.DataFrame:
    """Score a controller on the suite: one row per run and seed. `of` is a key of `registry.CONTROLLERS`, a class or a
    file, `seeds` are seeds of `cases`, each a suite of its own, `names` are names of runs (default all). `quiet` shows
    no progress bars. Columns: scenario (name of the run), setting ("paper": exact measurements, "loop": sensors),
    group, seed, controller, failure ("" for a good run), the metrics of `drive` (SI), above all error, effort_du,
    activity_du (RMS lateral error, RMS differential torque, its part above 5 Hz), points (0 to 100), and nothing, best,
    limit of `ends_of_the_scale`."""
    drawn = [replace(case, label=case.label | {"seed": seed}) for seed in seeds for case in cases(seed, names)]
    ends = ordered_map(ends_of_the_scale, drawn, "limits", quiet)
    rows = ordered_map(partial(drive, of), drawn, f"score {name_of(of)}", quiet, apart=isinstance(of, Path))
    both = [row | end for row, end in zip(rows, ends, strict=True)]
    return pd.DataFrame([row | {"points": points(row)} for row in both])


def card(table: pd.DataFrame) -> pd.DataFrame:
    """Summarise a table of `score`, whose runs have 0 to 100 points each. Returns a row per seed, controller, setting
    and metric. Columns: scenario (always "all"), controller, metric, value, unit, setting, seed. The setting is "paper"
    (exact measurements), "loop" (sensors), or "all", which has only the metric score, the mean of the scores of "paper"
    and "loop". Metrics of "paper" and "loop": score, mean points, where the group of runs with more delay or a slower
    drive counts as one run; margins, mean points in this group; cases, number of runs, where the group counts as one;
    of the runs outside of the group failures, number of failed runs, and each key of `METRICS`: the largest value of
    y_over_q, sum_y_over_limit and wheel_unloading, the mean of others."""
    rows = []
    for (seed, name), draw in table.groupby(["seed", "controller"], sort=False):
        sums = {setting: _sums(part) for setting, part in draw.groupby("setting", sort=False)}
        sums[ALL] = {"score": float(np.mean([values["score"] for values in sums.values()]))}
        for setting, values in sums.items():
            rows += [(ALL, name, key, value, METRICS.get(key, "-"), setting, seed) for key, value in values.items()]
    return pd.DataFrame(rows, columns=["scenario", "controller", "metric", "value", "unit", "setting", "seed"])


def _sums(rows: pd.DataFrame) -> dict[str, float]:
    groups = rows.groupby("group")["points"].mean()
    sums = {"score": float(groups.mean())} | ({MARGINS: float(groups[MARGINS])} if MARGINS in groups else {})
    rows = rows[rows["group"] != MARGINS]
    sums |= {"failures": float((rows["failure"] != "").sum()), "cases": float(len(groups))}
    for name in METRICS:
        values = rows[name].dropna().astype(float) if name in rows else pd.Series(dtype=float)
        if len(values):
            sums[name] = float(values.max() if name in _LARGEST else values.mean())
    return sums


def ranking(cards: pd.DataFrame) -> pd.DataFrame:
    """Rank controllers by their `card` tables, one below the other: one row per controller (index), the best first.
    Values are means over seeds, without the seed 1001, which is published for development: controllers may be tuned on
    it. Columns: "paper" and "loop", points (0 to 100) with exact measurements and with sensors; "ranked", the mean of
    both; "spread", standard deviation of ranked over the seeds; "margins", points in runs with more delay or a slower
    drive; "runs failed", number of failed runs of both settings per seed; "error (mm), loop", "limit (mm), loop" and
    "torque (N m), loop", RMS lateral error, its lower bound and RMS differential torque with sensors."""
    cards = cards[cards["seed"] != PUBLISHED]
    totals = cards[(cards["setting"] == ALL) & (cards["metric"] == "score")].groupby("controller")["value"]
    mean = cards.pivot_table(index="controller", columns=["metric", "setting"], values="value")
    columns = {"ranked": totals.mean(), "spread": totals.std()} | {name: mean["score", name] for name in SETTINGS}
    columns |= {"margins": mean[MARGINS].mean(axis=1), "runs failed": mean["failures"].sum(axis=1)}
    columns |= {f"{name} (mm), loop": 1e3 * mean.get((name, LOOP), np.nan) for name in ("error", "limit")}
    columns["torque (N m), loop"] = mean.get(("effort_du", LOOP), np.nan)
    return pd.DataFrame(columns).sort_values("ranked", ascending=False, kind="stable")


def tuning_cost(of: type, setting: str, runs: Sequence[str]) -> Callable[[list[dict], list[float]], list[float]]:
    """Make the cost function with which `swarm.minimise` tunes a controller class `of`. `runs` are names of runs in
    data/tuning.toml for the `setting`, "paper" (exact measurements) or "loop" (sensors). The function takes a list of
    dicts of gains and a limit of the cost for each, and returns a list with the mean cost over the runs (-) for each,
    or at least that of a failed run if the stability margin is too small. A cost above its limit is a lower bound."""
    name, task = _registered(of), load_task(setting=setting)
    chosen = replace(task, runs={each: task.runs[each] for each in task.runs if each in runs})
    return lambda sets, limits: [evaluate(name, chosen, *pair)[0] for pair in zip(sets, limits, strict=True)]


def main(controller: str, seed: int = PUBLISHED, ranked: bool = False) -> None:
    """Command `score`: score a controller with one seed, print its `card` and write its table to build/score.
    `controller` is a registered name or a Python file. With `ranked` it is scored with `ranked_seeds` in place of
    `seed`, and its row of `ranking` is printed. A file runs in processes of its own, but with all rights of the user; a
    line says so before it starts. InputError for an unknown controller or seed, one that ends its process or takes over
    600 s for a run, or one that cannot drive at all."""
    of, begin = entry(controller), time.perf_counter()
    data.require("seed", seed, data.between(0, 2**31), whole=True)
    seeds = ranked_seeds(of) if ranked else (seed,)
    if isinstance(of, Path):
        warning = f"{of}: its code runs as you, with all your rights; score only what you would run yourself"
        print(warning, file=sys.stderr, flush=True)
    first = cases(seed, ["curve_T3"])
    short = [replace(case, scenario=load_scenario("curve_entry_T3").but(end_m=30.0)) for case in first]
    for row in ordered_map(partial(drive, of), short, "check", True, apart=isinstance(of, Path)):
        if "rmse_y" not in row:
            raise InputError(row["failure"])
    table = score(of, seeds)
    file = paths.BUILD / f"score/{name_of(of)}-{'ranked' if ranked else seed}.csv"
    units = {name: f"{name} ({unit})" for name, unit in METRICS.items()}
    data.write(file, table.rename(columns=units).to_csv(index=False, float_format="%.6g"))
    for _, row in table[table["failure"] != ""].iterrows():
        print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
    sums = card(table)
    if ranked:
        line = {"version": __version__, "seeds": " ".join(map(str, seeds))} | ranking(sums).round(2).iloc[0].to_dict()
        print("\n".join([name_of(of), *(f"{key:24}{value}" for key, value in line.items())]))
        print(f"written: {file}; it took {time.perf_counter() - begin:.0f} s")
        return
    print(sums.pivot_table(index=["metric", "unit"], columns="setting", values="value", sort=False).to_string())
    print(f"score over both settings: {sums[sums['setting'] == ALL]['value'].item():.1f} of 100")
    print(f"seed {seed}; written: {file}")


def leaderboard() -> None:
    """Command `leaderboard`: score the controllers of the library, a car without guidance and two examples of own
    controllers (examples/only_y.py, pid.py) with six seeds each. Writes data/results/leaderboard.csv, a row per
    controller, seed, setting and metric (columns of `card`), and prints the `ranking`. In both settings a particle
    swarm found the poles of nonlinear dynamic inversion, as it found the weights of NMPC."""
    shown = [f"{name}_swarm" if name in INVERSIONS else name for name in SHOWN]
    entries = [*shown, NOTHING, *(paths.ROOT / f"examples/{name}.py" for name in ("only_y", "pid"))]
    cards = pd.concat([card(score(of, (PUBLISHED, *RANKED))) for of in entries], ignore_index=True)
    data.write(paths.product(LEADERBOARD), cards.to_csv(index=False, float_format="%.6g"))
    print(ranking(cards).round(1).to_string())
