"""The open benchmark: a controller of one's own, or a registered one, through one suite of runs to points of 100.

The cost of a run is

    J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1)

e: RMS lateral error (with sensors from the rails where they lie), T: RMS differential torque, A: its part above 5 Hz,
u: adhesion used of what there is, where the demand exceeds it (else 1), s: the larger of Y/Q over 0.8 and of the track
shifting force over its limit; e, T, A of the front gear. With q = 1 / (1 + J), points are

    100 (q - q_0) / (q_l - q_0), between 0 and 100,

q_0 of a car without guidance in the same run (0 where that derails), q_l of the limit (`ends_of_the_scale`). A run that
fails has no points. The runs with more delay or a slower drive count as one. The score is the mean over runs, and then
over settings. A seed draws sensors, irregularities and cars; the published one is for development, and a file is ranked
by seeds that follow from its own content (`ranked_seeds`).
"""

from __future__ import annotations

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
"""Parameters that the car has and its controller does not know, drawn over the ranges of data/vehicle.toml."""
MARGINS = "margins"
"""Group of the runs with more delay or a slower drive, which count as one together."""
PUBLISHED, RANKED = 1001, (1277232150, 1310670857, 1121027952, 785067208, 1683094607)
"""Seeds of noise, irregularities and cars: for development, and those whose mean ranks the entries of this project,
none of which was tuned on them."""
_SALT = b"railrepro benchmark 3"
"""Goes before the content of a file whose seeds are drawn; a new suite of runs gets another one."""
ALL = "all"
"""Scenario, and setting, of the rows that sum up."""
LEADERBOARD = "data/results/leaderboard.csv"
_PATCH = ((0.0, 0.0), (299.5, 0.0), (300.5, 1.0), (499.5, 1.0), (500.5, 0.0))
_WALKS, _ACTIVITIES = (220.0, 20.0), (20.0, 50.0, 115.0, 500.0)
"""Walks of force and moment in the quietest run (N/s^0.5, N m/s^0.5); torques above 5 Hz that are tried (N m)."""
_MODULE = "railrepro_own_controller"
LIMIT = 600.0
"""Time after which a run of a user's file is given up (s)."""
METRICS = {"error": "m", "limit": "m", "effort_du": "N m", "activity_du": "N m", "utilisation": "-"}
METRICS |= {"stopping_distance": "m", "comfort": "-", "y_over_q": "-", "sum_y_over_limit": "-", "wheel_unloading": "-"}
"""Metric of a run -> unit; `limit` is that of the error, `comfort` the largest N_MV."""
_LARGEST = ("y_over_q", "sum_y_over_limit", "wheel_unloading")
"""Metrics whose largest value counts; of all others it is the mean."""


def cases(seed: int, names: Sequence[str] | None = None) -> list[Experiment]:
    """Runs of the suite as experiments without guidance; `drive` puts the controller to be scored into them.

    Each run is there twice: in the setting "paper" with exact measurements, in "loop" with sensors. `seed` (0 to 2^31)
    determines sensor noise and biases, irregularities and the values of the parameters `MISMATCH`. `names` selects runs
    by name, as "curve_T3" (default all); InputError when no run has one of the names. The label of an experiment has
    the keys scenario (name of the run), setting and group; runs of one group count as one in the score.
    """
    found = []
    for setting, (name, group, draw, scenario, more) in product(SETTINGS, _runs(seed)):
        if names is not None and name not in names:
            continue
        delay = more.get("sensors", {})
        sensors = {"seed": draw} if setting == LOOP else {"perfect": True} if delay else {}
        label, around = {"scenario": name, "setting": setting, "group": group}, more | {"sensors": sensors | delay}
        found.append(Experiment(scenario, NOTHING, label, {}, setting=setting, ride=True, **around))
    if not found:
        raise InputError(f"benchmark: no run has one of the names {names}")
    return found


def _runs(seed: int) -> list[tuple[str, str, int, Scenario, dict]]:
    """Name, group and seed of the sensors of each run, its scenario and further fields of `Experiment`."""
    ends = {"T1": 200.0, "T2": 600.0, "T3": 600.0, "T4": 700.0}
    runs = {f"curve_{name}": load_scenario(f"curve_entry_{name}").but(end_m=end) for name, end in ends.items()}
    sine = load_scenario("sine_tracking")
    for speed, end in {100: 400.0, 250: 600.0, 400: 800.0}.items():
        runs[f"sine_{speed}"] = sine.but(speed_kmh=float(speed), end_m=end)
    pulled = sine.but(track="T3", speed_kmh=280.0, end_m=600.0, force_kN=((0.0, 17.0),))
    runs["loss_one_side"] = pulled.but(poor_share_left=_PATCH)
    runs["loss_both_sides"] = pulled.but(poor_share=_PATCH)
    runs["braking_patch"] = load_scenario("braking").but(poor_share=_PATCH, end_m=1450.0)
    more: dict[str, dict] = {"irregular": {"irregular": {"spectrum": "en_B_300", "seed": seed}}}
    more["cone"] = {"plant": {"contact.profile": "cone"}}
    ranges = sample_ranges()
    lows, highs = np.array([ranges[name] for name in MISMATCH]).T
    for number in (1, 2):
        shares = np.random.default_rng((seed, number)).random(len(MISMATCH))
        drawn = (lows + shares * (highs - lows)).tolist()
        more[f"mismatch_{number}"] = {"plant": dict(zip(MISMATCH, drawn, strict=True))}
    runs |= dict.fromkeys(more, runs["curve_T3"].but(end_m=500.0))
    found = [(name, name, seed, run, more.get(name, {})) for name, run in runs.items()]
    for rail, scenario in {"dry": "sine_tracking", "poor": "adhesion_loss"}.items():
        short = load_scenario(scenario).but(end_m=400.0)
        changes = {f"lag_{ms}ms": {"plant": {"drive.lag": 1e-3 * ms}} for ms in (20, 30, 40, 50)}
        changes |= {f"delay_{ms}ms": {"sensors": {"inverter.delay": 1e-3 * ms}} for ms in (3, 6, 9, 12)}
        for name, change in changes.items():
            draw = (seed + 1 + len(found) - len(runs)) % 2**31
            found.append((f"{name}_{rail}", MARGINS, draw, short, change))
    return found


def entry(controller: str) -> str | Path:
    """Controller to score: a registered name as it is, a file as resolved path; InputError for any other text."""
    if controller in CONTROLLERS:
        return controller
    file, known = data.location(controller), [*CONTROLLERS]
    if not file.is_file():
        raise InputError(f"controller {controller!r} is neither a file nor a registered controller; there are {known}")
    return file.resolve()


def ranked_seeds(of: str | Path) -> tuple[int, ...]:
    """Seeds that rank a controller of `entry`: `RANKED` for a registered name; for a file as many that follow from its
    SHA-256, so that they are not known before the last change. Ends of lines do not count."""
    if isinstance(of, str):
        return RANKED
    digest = hashlib.sha256(_SALT + of.read_bytes().replace(b"\r\n", b"\n")).digest()
    return tuple(int.from_bytes(digest[4 * i : 4 * i + 4], "big") // 2 for i in range(len(RANKED)))


def name_of(of: str | Path | type) -> str:
    """Name of a controller in tables: a registered name as it is, the name of a class, or a file's name with suffix."""
    return of if isinstance(of, str) else getattr(of, "__name__", None) or of.name


def load_class(file: Path) -> type:
    """Run a Python file and return its only class with a method `torque` or `plan`; InputError for none or several."""
    defined = [thing for thing in runpy.run_path(str(file), run_name=_MODULE).values() if isinstance(thing, type)]
    own = [each for each in defined if each.__module__ == _MODULE]
    found = [each for each in own if hasattr(each, "torque") or hasattr(each, "plan")]
    if len(found) != 1:
        raise InputError(f"one class with `torque` or with `plan` is needed, found {[each.__name__ for each in found]}")
    return found[0]


def made(own: type, settings: Mapping[str, float]) -> lateral.Guidance:
    """Make the guidance for `simulate.run` from a controller class `own` and its keyword arguments `settings`.

    A class without `plan` gives the object own(**settings). A class with `plan` gives a factory; it makes own(vehicle,
    route, gear, **settings) per gear, on a route without what the controller may not know (`known`).
    """
    if not hasattr(own, "plan"):
        return own(**settings)
    return lambda vehicle, route, gear: own(vehicle, known(route), gear, **settings)


def known(route: Route) -> Route:
    """Copy of a route with irregularities and poor adhesion set to zero, as a scored controller may not know them."""
    cells, hidden = np.array(route.cells), (*CHANNELS, "poor_le", "poor_ri")
    cells[:, [i for name, i in INDEX.items() if name in hidden or name.lstrip("d") in hidden]] = 0.0
    return Route(cells, route.length)


def drive(of: str | Path | type, case: Experiment) -> dict:
    """Simulate a run of `cases` under a controller; returns a dict.

    `of` is a key of `registry.CONTROLLERS`, a class or a file; a file is loaded and run by `executor.work`. Keys of the
    result: those of the run's label; controller (name); failure (one sentence, "" for a good run); the metrics (SI). A
    run whose controller raises an error has no metrics. InputError when a file ended its process or took longer than
    `LIMIT`; that needs `apart` of `executor.ordered_map`.
    """
    head = case.label | {"controller": name_of(of), "failure": ""}
    if isinstance(of, Path):
        run = f"{of.name}: its run {case.label['scenario']} in the setting {case.setting}"
        try:
            return head | work(_driven, of, case, limit=LIMIT)
        except TimeoutError as error:
            raise InputError(f"{run} was given up after {LIMIT:g} s, the limit of time") from error
        except BrokenExecutor as error:
            raise InputError(f"{run} ended its process: it exited, crashed or was killed") from error
    if not isinstance(of, str):
        return head | _driven(of, case)
    known = {"controller": of, "parameters": {} if of == NOTHING else None, "options": CONTROLLERS[of].quick}
    try:
        return head | replace(case, **known).measured(_row)[0]
    except ArithmeticError as error:
        return head | {"failure": str(error)}


def _driven(of: Path | type, case: Experiment) -> dict:
    try:
        own = load_class(of) if isinstance(of, Path) else of
        tables = getattr(own, "tuned", {})
        if set(tables) - {*SETTINGS}:
            raise InputError(f"{own.__name__}: `tuned` has the settings {sorted(tables)}, there are {[*SETTINGS]}")
        asked = replace(case, controller=_registered(own), parameters=tables.get(case.setting, {}))
        return _row(asked.run(), asked)[0]
    except BaseException as error:  # a user's controller may raise whatever it likes
        if isinstance(error, KeyboardInterrupt) and multiprocessing.parent_process() is None:
            raise  # Ctrl-C, which does not reach the processes of a study
        lines = [each.lineno for each in traceback.extract_tb(error.__traceback__) if each.filename == str(of)]
        where = f"{name_of(of)}, line {lines[-1]}" if lines else name_of(of)
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        return {"failure": f"{where}: {kind}{' '.join(str(error).split())}".rstrip(": ")[:300]}


def _registered(own: type) -> str:
    """Enter a class into the registry of this process; its name there."""
    name = f"own {own.__name__}"
    CONTROLLERS[name] = Controller(partial(made, own), dict, False)
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
    """Cost J (-) of a run that did not fail, from its row of `drive`; inf where a metric is not finite.

    J is the sum at the head of this module: lateral error, differential torque, unused adhesion, too large forces.
    """
    unused = 1 - min(row["utilisation"], 1.0) if np.isfinite(row.get("utilisation", np.nan)) else 0.0
    unsafe = max(row["y_over_q"] / Y_OVER_Q_LIMIT, row["sum_y_over_limit"])
    value = row["error"] / 1e-3 + row["effort_du"] / 4e3 + max(0.0, row["activity_du"] / 500 - 1)
    value += 2 * unused + 10 * max(0.0, unsafe - 1)
    return float(value) if np.isfinite(value) else float("inf")


def points(row: dict) -> float:
    """Points of a run (0 to 100) on a scale from no guidance to the limit; 0 for a failed run.

    `row` is a dict of `drive`, joined with the costs nothing and best of `ends_of_the_scale`.
    """
    if row["failure"]:
        return 0.0
    q, nothing, best = (1 / (1 + value) for value in (cost(row), row["nothing"], row["best"]))
    return float(np.clip(100 * (q - nothing) / (best - nothing), 0.0, 100.0)) if best > nothing else 0.0


def ends_of_the_scale(case: Experiment) -> dict[str, float]:
    """Costs J (-) worth 0 and 100 points in a run of `cases`, and a bound of the error: dict with three keys.

    nothing: cost of the run without guidance, inf if it fails. best: cost worth 100 points. limit: least bound of the
    RMS lateral error (m). With exact measurements best is 0 and limit NaN, as only the drive limits the error. With
    sensors `uncertainty.limit` bounds the error for each of four RMS torques above 5 Hz (20 to 500 N m), on dry rail
    with weak disturbances; best is the least sum of bound / 1 mm and torque / 4 kN m.
    """
    row = drive(NOTHING, case)
    found = {"nothing": float("inf") if row["failure"] else cost(row), "best": 0.0, "limit": float("nan")}
    if case.setting == PAPER:
        return found
    scenario, loop = case.scenario, readings(**case.sensors).loop
    # the limit grows with speed
    speed = scenario.speed if scenario.stop_kmh is None else max(scenario.stop_speed, 10.0)
    route = scenario.route()
    slopes = route.reference_at(np.arange(0.0, scenario.end_m or route.length))[1]
    key = store.key(__name__, "limit", loop, speed, _WALKS, _ACTIVITIES, load_vehicle())
    errors = store.entry(key, lambda: work(_bounds, loop, speed))[0]["errors"]
    least = [bound.at_true_position(error, slopes, loop) for error in errors]
    best = min(error / 1e-3 + torque / 4e3 for error, torque in zip(least, _ACTIVITIES, strict=True))
    return found | {"limit": min(least), "best": best}


def _bounds(loop: Loop, speed: float) -> store.Entry:
    return {"errors": [bound.limit(load_vehicle(), loop, speed, _WALKS, activity=a) for a in _ACTIVITIES]}, None


def _drive_all(of: str | Path | type, cases: Sequence[Experiment], title: str, quiet: bool) -> list[dict]:
    """Rows of `drive`; what a file does to its process harms no other one."""
    return ordered_map(partial(drive, of), cases, title, quiet, apart=isinstance(of, Path))


def score(
    of: str | Path | type, seeds: Sequence[int], names: Sequence[str] | None = None, quiet: bool = False
) -> pd.DataFrame:
    """Score a controller on the suite: one row per run and seed.

    Args:
        of (str, Path or class): Controller, as in `drive`.
        seeds (sequence of int): Seeds of `cases`, each a suite of its own.
        names (sequence of str, optional): Names of the runs wanted, see `cases`; default all.
        quiet (bool): Whether to show no progress bars.

    Returns:
        DataFrame: Columns scenario (name of the run), setting, group, seed, controller, failure ("" for a good run),
            metrics of the run (SI, see `METRICS`), points (0 to 100), and nothing, best, limit of `ends_of_the_scale`.
    """
    drawn = [replace(case, label=case.label | {"seed": seed}) for seed in seeds for case in cases(seed, names)]
    ends = ordered_map(ends_of_the_scale, drawn, "limits", quiet)
    rows = _drive_all(of, drawn, f"score {name_of(of)}", quiet)
    both = [row | end for row, end in zip(rows, ends, strict=True)]
    return pd.DataFrame([row | {"points": points(row)} for row in both])


def card(table: pd.DataFrame) -> pd.DataFrame:
    """Summary of one controller's table from `score`: one row per seed, setting and metric.

    Columns scenario (always "all"), controller, metric, value, unit, setting, seed. Runs with more delay or a slower
    drive (group `MARGINS`) count together as one run. Metrics: score, mean points of all runs; margins, mean points of
    the group `MARGINS`; cases, number of runs; failures, number of failed runs outside of this group; each of `METRICS`
    outside of this group, for wheel and track forces the largest value, else the mean. The setting "all" has only
    score, the mean of the scores of both settings.
    """
    rows = []
    for seed, draw in table.groupby("seed", sort=False):
        sums = {setting: _sums(part) for setting, part in draw.groupby("setting", sort=False)}
        sums[ALL] = {"score": float(np.mean([found["score"] for found in sums.values()]))}
        for setting, found in sums.items():
            name = draw["controller"].iloc[0]
            rows += [(ALL, name, key, value, METRICS.get(key, "-"), setting, seed) for key, value in found.items()]
    return pd.DataFrame(rows, columns=["scenario", "controller", "metric", "value", "unit", "setting", "seed"])


def _sums(rows: pd.DataFrame) -> dict[str, float]:
    groups = rows.groupby("group")["points"].mean()
    found = {"score": float(groups.mean())} | ({MARGINS: float(groups[MARGINS])} if MARGINS in groups else {})
    rows = rows[rows["group"] != MARGINS]
    found |= {"failures": float((rows["failure"] != "").sum()), "cases": float(len(groups))}
    for name in METRICS:
        values = rows[name].dropna().astype(float) if name in rows else pd.Series(dtype=float)
        if len(values):
            found[name] = float(values.max() if name in _LARGEST else values.mean())
    return found


def ranking(cards: pd.DataFrame) -> pd.DataFrame:
    """Rank controllers from their concatenated `card` tables: one row per controller, the best first.

    All values are means over the seeds other than `PUBLISHED`. Columns: ranked, score over both settings; spread,
    standard deviation of ranked between seeds; paper and loop, score per setting; margins (all 0 to 100); "runs
    failed", number per seed; with sensors "error (mm), loop", "limit (mm), loop" and "torque (N m), loop" (RMS).
    """
    cards = cards[cards["seed"] != PUBLISHED]
    totals = cards[(cards["setting"] == ALL) & (cards["metric"] == "score")].groupby("controller")["value"]
    mean = cards.pivot_table(index="controller", columns=["metric", "setting"], values="value")
    columns = {"ranked": totals.mean(), "spread": totals.std()} | {name: mean["score", name] for name in SETTINGS}
    columns |= {"margins": mean[MARGINS].mean(axis=1), "runs failed": mean["failures"].sum(axis=1)}
    columns |= {f"{name} (mm), loop": 1e3 * mean.get((name, LOOP), np.nan) for name in ("error", "limit")}
    columns["torque (N m), loop"] = mean.get(("effort_du", LOOP), np.nan)
    return pd.DataFrame(columns).sort_values("ranked", ascending=False, kind="stable")


def tuning_cost(own: type, setting: str, runs: Sequence[str]) -> Callable[[list[dict], list[float]], list[float]]:
    """Make the cost function with which `swarm.minimise` tunes a controller class `own`.

    `runs` are names of runs in data/tuning.toml for the `setting`. The function takes a list of dicts of gains and a
    list of limits, and returns per dict the mean of `run_cost` over the runs (-). Once a cost is above its limit
    the other runs are left out: it is then a lower bound.
    """
    name, task = _registered(own), load_task(setting=setting)
    chosen = replace(task, runs={each: task.runs[each] for each in task.runs if each in runs})
    return lambda sets, limits: [evaluate(name, chosen, *pair)[0] for pair in zip(sets, limits, strict=True)]


def main(controller: str, seed: int | None = None, ranked: bool = False) -> None:
    """Command `score`: score a controller with one seed, print its `card` and write its table to build/score.

    `controller` is a registered name or a Python file, `seed` is `PUBLISHED` by default. With `ranked` the seeds are
    those of `ranked_seeds`, and what is printed is its entry in the leaderboard. A file runs in processes of its own,
    but with all rights of the user, which is said before it starts. InputError when not a single run gives metrics, and
    as from `drive`.
    """
    if ranked and seed is not None:
        raise InputError("score: a seed and --ranked exclude each other, as ranked seeds follow from the file")
    of, seed, begin = entry(controller), PUBLISHED if seed is None else seed, time.perf_counter()
    data.require("seed", seed, data.between(0, 2**31), whole=True)
    seeds = ranked_seeds(of) if ranked else (seed,)
    if isinstance(of, Path):
        words = "its code runs as you, with all your rights; score only what you would run yourself"
        print(f"{of}: {words}", file=sys.stderr, flush=True)
    short = load_scenario("curve_entry_T3").but(end_m=30.0)  # what cannot be driven at all is refused at once
    for row in _drive_all(of, [replace(first, scenario=short) for first in cases(seed, ["curve_T3"])], "check", True):
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
    """Score `SHOWN`, no guidance and two of examples/ on 6 seeds; write `LEADERBOARD` (`card`), print the `ranking`.

    Inversions have the poles of the swarm in both settings, as the other controllers have its weights.
    """
    shown = [f"{name}_swarm" if name in INVERSIONS else name for name in SHOWN]
    entries = [*shown, NOTHING, *(paths.ROOT / f"examples/{name}.py" for name in ("only_y", "pid"))]
    found = pd.concat([card(score(of, (PUBLISHED, *RANKED))) for of in entries], ignore_index=True)
    data.write(paths.product(LEADERBOARD), found.to_csv(index=False, float_format="%.6g"))
    print(ranking(found).round(1).to_string())
