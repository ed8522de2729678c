"""The open benchmark: a controller of one's own, or a registered one, through one suite of runs to points of 100.

The cost of a run is

    J = e / 1 mm + T / 4 kN m + max(0, A / 0.5 kN m - 1) + 2 (1 - u) + 10 max(0, s - 1)

e: RMS lateral error (with sensors from the rails where they lie), T: RMS differential torque, A: its part above 5 Hz,
u: adhesion used of what there is, where the demand exceeds it (else 1), s: the larger of Y/Q over 0.8 and of the track
shifting force over its limit; e, T, A of the front gear. With q = 1 / (1 + J), points are

    100 (q - q_0) / (q_l - q_0), between 0 and 100,

q_0 of a car without guidance in the same run (0 where that derails), q_l of the limit (`ends_of_the_scale`). A run that
fails has no points. The runs with more delay or a slower drive count as one. The score is the mean over runs, and then
over settings. A seed draws sensors, irregularities and cars; the published one is for development.
"""

from __future__ import annotations

import runpy
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import data, paths
from railrepro.control import lateral
from railrepro.control.registry import CONTROLLERS, NOTHING, SHOWN, Controller
from railrepro.data import InputError
from railrepro.estimation.sensors import Loop, readings
from railrepro.evidence.runs import pso, store, swarm, tuning
from railrepro.evidence.runs.executor import executor, ordered_map, work
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.runs.tuning import EQUAL, LOOP
from railrepro.evidence.uncertainty import limit as bound
from railrepro.simulation.ride import Y_OVER_Q_LIMIT
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.simulation.simulate import Run
from railrepro.track.irregularity import CHANNELS
from railrepro.track.route import INDEX, Route
from railrepro.vehicle.parameters import load_vehicle, sample_ranges

MISMATCH = ("body.mass", "gear.mass", "gear.inertia_z", "wheel.spin_inertia", "suspension.k_x")
MISMATCH += ("suspension.c_x", "suspension.k_y", "drive.lag")
"""Parameters that the car has and its controller does not know, drawn over the ranges of data/vehicle.toml."""
QUICK = ("curve_T3", "braking_patch")
"""Runs of a small suite."""
MARGINS = "margins"
"""Group of the runs with more delay or a slower drive, which count as one together."""
PUBLISHED, RANKED = 1001, (1277232150, 1310670857, 1121027952, 785067208, 1683094607)
"""Seeds of noise, irregularities and cars: for development, and those whose mean ranks the leaderboard."""
ALL = "all"
"""Scenario, and setting, of the rows that sum up."""
LEADERBOARD = "data/results/leaderboard.csv"
EXAMPLES = ("only_y", "pid")
"""Controllers of examples/ on the leaderboard."""
_PATCH = ((0.0, 0.0), (299.5, 0.0), (300.5, 1.0), (499.5, 1.0), (500.5, 0.0))
_DELAYS, _LAGS, _MARGINS_END = (3, 6, 9, 12), (20, 30, 40, 50), 400.0
"""Delay of the command (ms) and time constant of the drive (ms), and where the runs with them end (m)."""
_WALKS, _ACTIVITIES = (220.0, 20.0), (20.0, 50.0, 115.0, 500.0)
"""Walks of lateral force and yaw moment in the quietest run (N/s^0.5, N m/s^0.5), and torques above 5 Hz among which
the least cost is sought (N m)."""
_SLOWEST = 10.0
"""Speed at which the limit of a braking car is taken (m/s); it grows with speed."""
_MODULE = "railrepro_own_controller"
METRICS = {
    "error": ("m", "mean"),
    "limit": ("m", "mean"),
    "effort_du": ("N m", "mean"),
    "activity_du": ("N m", "mean"),
    "utilisation": ("-", "mean"),
    "stopping_distance": ("m", "mean"),
    "comfort": ("-", "mean"),
    "y_over_q": ("-", "max"),
    "sum_y_over_limit": ("-", "max"),
    "wheel_unloading": ("-", "max"),
}
"""Metric of a run -> unit, and how runs are summed up; `limit` is that of the error, `comfort` the largest N_MV."""


# The suite.


def cases(seed: int, names: Sequence[str] | None = None) -> list[Experiment]:
    """Runs of the suite in the settings "equal" (exact measurements) and "loop" (sensors), without guidance.

    See `case`; noise and biases of sensors, irregularities and parameters `MISMATCH` follow from `seed` (0 to 2^31).
    With `names` only these runs, such as "curve_T3", without the group `MARGINS`; InputError when there are none.
    """
    data.require("seed", seed, data.between(0, 2**31), whole=True)
    found = []
    for setting in (EQUAL, LOOP):
        wanted = [each for each in _runs(seed).items() if names is None or each[0] in names]
        found += [case(name, setting, seed, *run) for name, run in wanted]
        found += _margins(setting, seed) if names is None else []
    if not found:
        raise InputError(f"benchmark: there is no run of the names {names}; there are {[*_runs(seed)]}")
    return found


def case(
    name: str, setting: str, seed: int, scenario: Scenario, irregular: dict, plant: dict,
    delay: dict | None = None, group: str = "",
) -> Experiment:  # fmt: skip
    """One run of the suite as an experiment without guidance, with the label scenario (`name`), setting, group.

    `setting`: "equal" (exact measurements) or "loop" (sensors, whose noise and biases follow from `seed`). `irregular`:
    arguments of `rough_track` besides p, {} for ideal rails. `plant`: parameters of the car that its controller does
    not know, by dotted key (SI). `delay`: changed values of `sensors.readings`, as {"inverter.delay": 0.003} (s). Runs
    of one `group` (default `name`) count as one in the score.
    """
    label = {"scenario": name, "setting": setting, "group": group or name}
    sensors = {"seed": seed} if setting == LOOP else {"perfect": True} if delay else {}
    around = {"irregular": irregular, "plant": plant, "sensors": sensors | (delay or {})}
    return Experiment(scenario, NOTHING, label, {}, setting=setting, ride=True, **around)


def _runs(seed: int) -> dict[str, tuple[Scenario, dict, dict]]:
    """Scenario, irregularities and unknown changes of the car, by name."""
    ends = {"T1": 200.0, "T2": 600.0, "T3": 600.0, "T4": 700.0}
    curves = {name: load_scenario(f"curve_entry_{name}") for name in ends}
    runs = {f"curve_{name}": (curves[name].but(end_m=end), {}, {}) for name, end in ends.items()}
    sine = load_scenario("sine_tracking")
    for speed, end in {100: 400.0, 250: 600.0, 400: 800.0}.items():
        runs[f"sine_{speed}"] = sine.but(speed_kmh=float(speed), end_m=end), {}, {}
    pulled = sine.but(track="T3", speed_kmh=280.0, end_m=600.0, force_kN=((0.0, 17.0),))
    runs["loss_one_side"] = pulled.but(poor_share_left=_PATCH), {}, {}
    runs["loss_both_sides"] = pulled.but(poor_share=_PATCH), {}, {}
    runs["braking_patch"] = load_scenario("braking").but(poor_share=_PATCH, end_m=1450.0), {}, {}
    curve = curves["T3"].but(end_m=500.0)
    runs["irregular"] = curve, {"spectrum": "en_B_300", "seed": seed}, {}
    runs["cone"] = curve, {}, {"contact.profile": "cone"}
    return runs | {f"mismatch_{k}": (curve, {}, mismatch(seed, k)) for k in (1, 2)}


def mismatch(seed: int, number: int) -> dict[str, float]:
    """Random values (SI) of the parameters `MISMATCH`, uniform over their ranges by (seed, number): name -> value."""
    shares, ranges = np.random.default_rng((seed, number)).random(len(MISMATCH)), sample_ranges()
    lows, highs = np.array([ranges[name] for name in MISMATCH]).T
    return dict(zip(MISMATCH, (lows + shares * (highs - lows)).tolist(), strict=True))


def _margins(setting: str, seed: int) -> list[Experiment]:
    """Runs at 400 km/h with a slower drive and with more delay; with sensors each has another draw of them."""
    found: list[Experiment] = []
    for rail, scenario in {"dry": "sine_tracking", "poor": "adhesion_loss"}.items():
        short = load_scenario(scenario).but(end_m=_MARGINS_END)
        changes = [(f"lag_{ms}ms", {"drive.lag": 1e-3 * ms}, {}) for ms in _LAGS]
        changes += [(f"delay_{ms}ms", {}, {"inverter.delay": 1e-3 * ms}) for ms in _DELAYS]
        for name, plant, delay in changes:
            draw = (seed + 1 + len(found)) % 2**31
            found.append(case(f"{name}_{rail}", setting, draw, short, {}, plant, delay, MARGINS))
    return found


# What is scored.


Entry = str | Path | type
"""A controller that is scored: key of `registry.CONTROLLERS`, a file, or a class of a chapter."""


def entry(controller: str) -> Entry:
    """Controller to score: the registered name itself, or the resolved path of a file; InputError for another text."""
    if controller in tuple(CONTROLLERS):
        return controller
    file = data.location(controller)
    if not file.is_file():
        known = [*CONTROLLERS]
        raise InputError(f"controller {controller!r} is neither a file nor a registered controller; there are {known}")
    return file.resolve()


def name_of(of: Entry) -> str:
    """Name of a controller in tables: its registered name, class name, or file name with suffix."""
    if isinstance(of, type):
        return of.__name__
    return of.name if isinstance(of, Path) else of


def load_class(file: Path) -> type:
    """Run a Python file and return its class with `torque` or `plan`; InputError unless there is exactly one."""
    defined = [thing for thing in runpy.run_path(str(file), run_name=_MODULE).values() if isinstance(thing, type)]
    found = [
        each for each in defined if each.__module__ == _MODULE and (hasattr(each, "torque") or hasattr(each, "plan"))
    ]
    if len(found) != 1:
        names = [each.__name__ for each in found]
        raise InputError(f"one class with `torque` or with `plan` is needed, found {names or 'none'}")
    return found[0]


def fault(error: BaseException, file: Path) -> str:
    """Describe an exception of a user's file in one line of at most 300 characters: file, line number, message."""
    lines = [each.lineno for each in traceback.extract_tb(error.__traceback__) if each.filename == str(file)]
    if isinstance(error, SyntaxError) and error.filename == str(file):
        lines.append(error.lineno)
    where = f"{file.name}, line {lines[-1]}" if lines else file.name
    kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
    return f"{where}: {kind}{' '.join(str(error).split())}"[:300]


def made(own: type, settings: Mapping[str, float]) -> lateral.Guidance:
    """Guidance for `simulate.run` from a controller class and its keyword arguments.

    For a class with `torque` an object of it, own(**settings); for a class with `plan` a factory (vehicle, route, gear)
    -> own(vehicle, `known` route, gear, **settings).
    """
    if not hasattr(own, "plan"):
        return own(**settings)
    return lambda vehicle, route, gear: own(vehicle, known(route), gear, **settings)


def known(route: Route) -> Route:
    """Copy of a route for a scored controller, which may not know irregularities and poor adhesion: these are zero."""
    cells = np.array(route.cells)
    hidden = (*CHANNELS, "poor_le", "poor_ri")
    names = [name for name in INDEX if name.lstrip("d") in hidden or name in hidden]
    cells[:, [INDEX[name] for name in names]] = 0.0
    return Route(cells, route.length)


def _enter(name: str, build: Callable) -> str:
    """Enter a controller into the registry of this process, settings -> guidance; its name."""
    CONTROLLERS[name] = Controller(build, dict, False, "own")
    return name


def description() -> str:
    """Text on how to write a 1 kHz law, with the name, unit and meaning of each quantity that its `torque` may use."""
    lines = [
        "A law is one class with torque(self, q); q has these quantities as attributes, for example q.y. It returns",
        "the differential torque (N m, positive steers right) as an expression of CasADi. With `memory`, a tuple of",
        "names of its own that q has, too, it returns (torque, next value of each by name). See examples/.",
        "",
    ]
    for title, names in (("running gear", lateral.GEAR), ("track here", lateral.ROAD), ("vehicle", lateral.MODEL)):
        lines.append(title)
        for name, (unit, meaning) in names.items():
            lines.append(f"  {name:22s}{unit:12s}{meaning}")
    return "\n".join(lines)


# Driving, and points.


def drive(of: Entry, case: Experiment) -> dict:
    """Simulate a run of `cases` under a controller; return a dict of its label, controller, failure and metrics (SI).

    `of`: from `entry`, or a class. `failure` is one sentence, empty for a good run; a controller that raises an error
    has no metrics. Runs of registered controllers are stored; a file is loaded and run in a worker process.
    """
    head = case.label | {"controller": name_of(of), "failure": ""}
    if isinstance(of, Path):
        return head | work(_driven_file, of, case)
    try:
        if isinstance(of, type):
            return head | _driven_class(of, case)
        known = {"controller": of, "parameters": {} if of == NOTHING else None, "options": CONTROLLERS[of].quick}
        return head | replace(case, **known).measured(_row)[0]
    except (InputError, ArithmeticError) as error:
        return head | {"failure": str(error)}


def _driven_file(file: Path, case: Experiment) -> dict:
    try:
        return _driven_class(load_class(file), case)
    except (Exception, SystemExit) as error:  # the file of a user may raise whatever it likes
        return {"failure": fault(error, file)}


def _driven_class(own: type, case: Experiment) -> dict:
    tables = getattr(own, "tuned", {})
    if set(tables) - {EQUAL, LOOP}:
        raise InputError(f"{own.__name__}: `tuned` has {sorted(tables)}, only {[EQUAL, LOOP]} are known")
    written = made(own, tables.get(case.setting, {}))
    asked = replace(case, controller=_enter(f"scored {own.__name__}", lambda settings: written))
    return _row(asked.run(), asked)[0]


def _row(run: Run, of: Experiment) -> store.Entry:
    row = {key: value for key, value in of.values(run).items() if isinstance(value, float | int)}
    row["failure"] = run.ended if run.failed else ""
    row["way"] = float(run.series["front.p"].iloc[-1])
    if of.scenario.stop_kmh is None:
        row.pop("stopping_distance")
    elif not run.ended.startswith("stop"):
        row["stopping_distance"] = float("nan")
    row["comfort"] = max((row[k] for k in row if k.startswith("n_mv_")), default=float("nan"))
    row["error"] = row.get("followed_rmse_y" if of.setting == LOOP else "rmse_y", float("nan"))
    return row, None


def cost(row: dict) -> float:
    """Cost J (-) of a row of `drive` that did not fail; inf when a metric is missing.

    error / 1 mm + effort_du / 4 kN m + max(0, activity_du / 500 N m - 1) + 2 (1 - utilisation, at most 1) +
    10 max(0, s - 1), s the larger of y_over_q / 0.8 and sum_y_over_limit.
    """
    unused = 1 - min(row["utilisation"], 1.0) if np.isfinite(row.get("utilisation", np.nan)) else 0.0
    unsafe = max(row["y_over_q"] / Y_OVER_Q_LIMIT, row["sum_y_over_limit"])
    value = row["error"] / 1e-3 + row["effort_du"] / 4e3 + max(0.0, row["activity_du"] / 500 - 1)
    value += 2 * unused + 10 * max(0.0, unsafe - 1)
    return float(value) if np.isfinite(value) else float("inf")


def points(row: dict) -> float:
    """Points (0 to 100) of a row of `drive` with `nothing` and `best` of `ends_of_the_scale` added; 0 for a failed run.

    Clipped 100 (q - q_nothing) / (q_best - q_nothing), q = 1 / (1 + cost) with the costs `cost(row)`, nothing, best.
    """
    if row["failure"]:
        return 0.0
    q, nothing, best = (1 / (1 + value) for value in (cost(row), row["nothing"], row["best"]))
    return float(np.clip(100 * (q - nothing) / (best - nothing), 0.0, 100.0)) if best > nothing else 0.0


def ends_of_the_scale(case: Experiment) -> dict[str, float]:
    """Costs J that give 0 and 100 points in a case, keys `nothing` and `best` (-), and the error `limit` (m).

    `nothing` is the cost without guidance, inf where the car derails. In the setting `loop` linear-quadratic-Gaussian
    bounds of the RMS error (`uncertainty.limit`: sensors of the case, dry rail, disturbances of the quietest run, mean
    over seeds) are computed for RMS torques above 5 Hz of 20 to 500 N m: `limit` is the least bound, `best` the least
    bound / 1 mm + torque / 4 kN m. With exact measurements best is 0, limit nan: only the drive limits the error.
    """
    row = drive(NOTHING, case)
    found = {"nothing": float("inf") if row["failure"] else cost(row), "best": 0.0, "limit": float("nan")}
    if case.setting == EQUAL:
        return found
    scenario, loop = case.scenario, readings(**case.sensors).loop
    speed = scenario.speed if scenario.stop_kmh is None else max(scenario.stop_speed, _SLOWEST)
    route = scenario.route()
    slopes = route.reference_at(np.arange(0.0, scenario.end_m or route.length))[1]
    errors = {a: bound.with_place(error, slopes, loop) for a, error in _errors(loop, speed).items()}
    best = min(error / 1e-3 + a / 4e3 for a, error in errors.items())
    return found | {"limit": min(errors.values()), "best": best}


@lru_cache(maxsize=64)
def _errors(loop: Loop, speed: float) -> dict[float, float]:
    """Bound of the error (m) by the torque above 5 Hz (N m)."""
    key = store.key(__name__, "limit", loop, speed, _WALKS, _ACTIVITIES, load_vehicle())
    row, _ = store.entry(key, lambda: work(_bounds, loop, speed))
    return dict(zip(_ACTIVITIES, row["errors"], strict=True))


def _bounds(loop: Loop, speed: float) -> dict:
    return {"errors": [bound.limit(load_vehicle(), loop, speed, _WALKS, activity=a).error for a in _ACTIVITIES]}, None


def score(of: Entry, seeds: Sequence[int], names: Sequence[str] | None = None, quiet: bool = False) -> pd.DataFrame:
    """Score a controller on the suite: one row per run and seed, as a DataFrame.

    `of` is from `entry`, or a class, which runs in this process because workers cannot import it. Columns scenario,
    setting, group, seed, controller, failure, the metrics of the run (SI, see `METRICS`), points (0 to 100), and
    nothing, best, limit of `ends_of_the_scale`. `names` restricts the runs, see `cases`; `quiet` hides progress bars.
    """
    drawn = [replace(case, label=case.label | {"seed": seed}) for seed in seeds for case in cases(seed, names)]
    with executor() as pool:
        ends = ordered_map(pool, ends_of_the_scale, drawn, "limits", quiet)
        rows = ordered_map(pool, lambda case: drive(of, case), drawn, f"score {name_of(of)}", quiet)
    both = [row | end for row, end in zip(rows, ends, strict=True)]
    return pd.DataFrame([row | {"points": points(row)} for row in both])


# Sums, ranking, page.


def card(table: pd.DataFrame) -> pd.DataFrame:
    """Summary of one controller's table from `score`, in long form.

    Columns scenario (always `ALL`), controller, metric, value, unit, setting (`ALL` for their mean score), seed.
    Metrics per setting: score, margins (points of the group `MARGINS`; both 0 to 100), cases (runs, the group counts as
    one); over the runs outside the group failures (number of failed ones) and each of `METRICS` (mean or largest).
    """
    rows = []
    for seed, draw in table.groupby("seed", sort=False):
        sums = {setting: _sums(part) for setting, part in draw.groupby("setting", sort=False)}
        sums[ALL] = {"score": float(np.mean([found["score"] for found in sums.values()]))}
        for setting, found in sums.items():
            units = {name: METRICS[name][0] if name in METRICS else "-" for name in found}
            rows += [(ALL, draw["controller"].iloc[0], name, found[name], units[name], setting, seed) for name in found]
    return pd.DataFrame(rows, columns=["scenario", "controller", "metric", "value", "unit", "setting", "seed"])


def _sums(rows: pd.DataFrame) -> dict[str, float]:
    groups = rows.groupby("group")["points"].mean()
    found = {"score": float(groups.mean())} | ({MARGINS: float(groups[MARGINS])} if MARGINS in groups else {})
    rows = rows[rows["group"] != MARGINS]
    found |= {"failures": float((rows["failure"] != "").sum()), "cases": float(len(groups))}
    for name, (*_, how) in METRICS.items():
        values = rows[name].dropna().astype(float) if name in rows else pd.Series(dtype=float)
        found |= {name: float(values.agg(how))} if len(values) else {}
    return found


def ranking(cards: pd.DataFrame) -> pd.DataFrame:
    """Rank controllers from their concatenated `card` tables: one row per controller, the best first.

    Columns ranked (mean score over all seeds but `PUBLISHED`), spread (standard deviation of this score between seeds),
    published (score with the seed `PUBLISHED`); then means over the ranked seeds, or of the published one where there
    is no other: equal, loop (score per setting), margins (all 0 to 100), "runs failed" (number per seed), and with
    sensors "error (mm), loop", "limit (mm), loop" and "torque (N m), loop" (RMS).
    """
    found = {}
    for name, rows in cards.groupby("controller", sort=False):
        total = rows[(rows["setting"] == ALL) & (rows["metric"] == "score")].set_index("seed")["value"]
        ranked = total.drop(PUBLISHED, errors="ignore")
        chosen = rows[rows["seed"].isin(ranked.index)] if len(ranked) else rows
        mean = chosen.groupby(["metric", "setting"])["value"].mean()
        failures = chosen[chosen["metric"] == "failures"].groupby("seed")["value"].sum().mean()
        row = {"ranked": ranked.mean(), "spread": ranked.std(), "published": total.get(PUBLISHED, np.nan)}
        row |= {setting: mean.get(("score", setting), np.nan) for setting in (EQUAL, LOOP)}
        row |= {"margins": chosen[chosen["metric"] == MARGINS]["value"].mean(), "runs failed": failures}
        row |= {f"{words} (mm), loop": 1e3 * mean.get((words, LOOP), np.nan) for words in ("error", "limit")}
        found[name] = row | {"torque (N m), loop": mean.get(("effort_du", LOOP), np.nan)}
    table = pd.DataFrame(found).T.rename_axis("controller")
    order = table["ranked"].fillna(table["published"]).sort_values(ascending=False, kind="stable").index
    return table.loc[order]


# A class of a chapter.


def tuning_cost(own: type, setting: str, runs: Sequence[str]) -> Callable[..., float]:
    """Cost function of the controller class `own`: (dict of gains, limit) -> mean of `swarm.run_cost` over `runs` (-).

    `runs` are names of runs in data/tuning.toml for the setting, unknown ones are ignored. Once the cost is above
    `limit` the remaining runs are skipped and the result is a lower bound.
    """
    name = _enter(f"own {own.__name__}", partial(made, own))
    task = tuning.load_task(setting=setting)
    chosen = {each: run for each, run in task.runs.items() if each in runs}
    return lambda gains, limit=float("inf"): swarm.evaluate(name, replace(task, runs=chosen), dict(gains), limit)[0]


def tune(
    own: type, setting: str, runs: Sequence[str], start: Mapping[str, float], particles: int, iterations: int
) -> pso.Swarm:
    """Swarm after minimising `tuning_cost` over the gains in `start`, each from 0.1 to 10 times its value (> 0)."""
    evaluate = tuning_cost(own, setting, runs)
    bounds = [pso.Dimension(name, value / 10, value * 10, "log") for name, value in start.items()]

    def costs(sets: list[dict], limits: list[float]) -> list[float]:
        return [evaluate(gains, limit) for gains, limit in zip(sets, limits, strict=True)]

    return pso.minimise(costs, bounds, particles, iterations, seed=1, start=dict(start))


def compare(controllers: Mapping[str, type | str], names: Sequence[str], seed: int = PUBLISHED) -> pd.DataFrame:
    """Points (0 to 100) of several controllers, one row per (setting, scenario), one column per heading.

    `controllers` maps headings to controller classes or keys of `registry.CONTROLLERS`; `names`: runs of `cases`.
    """
    found = {}
    for heading, one in controllers.items():
        found[heading] = score(one, [seed], names, quiet=True).set_index(["setting", "scenario"])["points"]
    return pd.DataFrame(found)


# Commands.


def check(of: Entry) -> None:
    """Raise InputError when a controller (see `entry`) raises an error on the first 30 m of T3 in "equal" or "loop"."""
    scenario = load_scenario("curve_entry_T3").but(end_m=30.0)
    for setting in (EQUAL, LOOP):
        row = drive(of, case("check", setting, PUBLISHED, scenario, {}, {}))
        if "way" not in row:
            raise InputError(row["failure"])


def main(controller: str | None = None, seed: int | None = None, small: bool = False, describe: bool = False) -> None:
    """Command `score`: score a registered controller or a file, print its card and write a CSV to build/score.

    `seed` is `PUBLISHED` by default; `small` takes the runs `QUICK` only; `describe` prints `description` instead.
    """
    if describe:
        print(description())
        return
    if controller is None:
        raise InputError("score: a Python file with one controller class, or a registered name, is needed")
    chosen, draw = entry(controller), PUBLISHED if seed is None else seed
    print(f"checking controller {name_of(chosen)}", flush=True)
    check(chosen)
    table = score(chosen, [draw], QUICK if small else None)
    head = ["scenario", "setting", "seed", "controller", "points", "failure"]
    units = {name: f"{name} ({unit})" for name, (unit, _) in METRICS.items() if name in table}
    file = paths.BUILD / "score" / f"{name_of(chosen)}-{draw}.csv"
    data.write(file, table[[*head, *units]].rename(columns=units).to_csv(index=False, float_format="%.6g"))
    for _, row in table[table["failure"] != ""].iterrows():
        print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
    sums = card(table)
    print(sums.pivot_table(index=["metric", "unit"], columns="setting", values="value", sort=False).to_string())
    print(f"score over both settings: {sums[sums['setting'] == ALL]['value'].item():.1f} of 100")
    print(f"seed {draw}; written: {file}")


def leaderboard() -> None:
    """Score the registered controllers and those of examples/ on all seeds, and write data/results/leaderboard.csv.

    Runs of registered controllers are stored, so an interrupted command resumes where it stopped.
    """
    cards = []
    for of in map(entry, [*SHOWN, NOTHING, *(str(paths.ROOT / f"examples/{name}.py") for name in EXAMPLES)]):
        check(of)
        cards.append(card(score(of, (PUBLISHED, *RANKED))))
    found = pd.concat(cards, ignore_index=True)
    data.write(paths.product(LEADERBOARD), found.to_csv(index=False, float_format="%.6g"))
    print(ranking(found).round(1).to_string())
