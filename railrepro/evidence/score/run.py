"""All cases of the benchmark driven by one controller, and both ends of their scale: no guidance, and the limit.

With sensors the limit is the linear-quadratic-Gaussian bound of the creep model
(`railrepro.evidence.uncertainty.limit`) with the noise, latency and biases of the loop, at the speed of the case, on
dry rail and for disturbances that wander as slowly as in the quietest run: what disturbs more raises it. It holds for
the mean over draws; the bias of one draw may be kinder. With perfect measurements only the drive limits the error,
which no case comes near, and the limit is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.compile.codegen import CompilerError
from railrepro.control.registry import CONTROLLERS, guidance
from railrepro.data import InputError, between, require, write
from railrepro.estimation.sensors import Loop, readings
from railrepro.evidence.runs import store
from railrepro.evidence.runs.executor import executor, ordered_map, work
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import NOTHING, Entry, description, entry, fault, load_class, made, register
from railrepro.evidence.uncertainty import limit as bound
from railrepro.simulation.scenarios import load_scenario
from railrepro.simulation.simulate import Run
from railrepro.vehicle.parameters import load_vehicle

FIRST_LOOK = 30.0
"""Distance that shows whether a controller works at all (m)."""
WALKS = (220.0, 20.0)
"""Walks of lateral force and yaw moment in the quietest of the runs (N/s^0.5, N m/s^0.5)."""
_ACTIVITIES = (20.0, 50.0, 115.0, 500.0)
"""Torque above 5 Hz among which the least cost is sought; beyond the last the cost of a case counts it twice (N m)."""
_SLOWEST = 10.0
"""Speed at which the bound of a braking car is taken (m/s); it grows with speed."""


def drive(of: Entry, case: suite.Case, own: type | None = None) -> dict:
    """Row of metrics of a case, whatever the controller does: `failure` is a sentence, empty when all went well.

    A class that is given takes the place of that of a file.
    """
    head = {"scenario": case.name, "setting": case.setting, "group": case.group or case.name}
    head |= {"controller": of.name, "failure": ""}
    try:
        own = load_class(Path(of.file)) if of.file else own
        return head | _measured(case, experiment(of, case, own))
    except (InputError, ArithmeticError, CompilerError) as error:
        said = fault(error, Path(of.file), own) if of.file else str(error)
    except (Exception, SystemExit) as error:  # the file of a user may raise whatever it likes
        if not of.file:
            raise
        said = fault(error, Path(of.file), own)
    return head | {"failure": said}


def experiment(of: Entry, case: suite.Case, own: type | None = None) -> Experiment:
    """The run of a case, with the class of a controller's file when it has one."""
    if own is not None:
        written = suite.counted(made(own, case.setting))
        name, parameters, options = register(f"own {of.name}", lambda settings: written), {}, {}
    else:
        name, parameters = of.enter(case.setting)
        options = CONTROLLERS[name].quick
    if case.delay:
        inner = guidance(name, parameters, options)
        name = register(f"delayed {of.name}", lambda settings: suite.delayed(inner, case.delay))
        parameters, options = {}, {}
    around = {"irregular": case.irregular, "plant": case.plant, "sensors": case.sensors, "ride": True}
    return Experiment(case.scenario, name, parameters=parameters, options=options, setting=case.setting, **around)


def _measured(case: suite.Case, of: Experiment) -> dict:
    run = of.run()
    row = {key: value for key, value in of.row(run).items() if isinstance(value, float | int)}
    lost = sum(count for name, count in run.memory.items() if name.endswith(f".lateral.{suite.LOST}"))
    ended = f"torque() returned NaN or Inf {lost:.0f} times; {run.ended}" if lost else run.ended
    row |= {"failure": ended if run.failed or lost else "", "way": float(run.series["front.p"].iloc[-1])}
    if case.scenario.stop_kmh is None:
        row.pop("stopping_distance")
    elif not run.ended.startswith("stop"):
        row["stopping_distance"] = float("nan")
    row["comfort"] = max((row[k] for k in row if k.startswith("n_mv_")), default=float("nan"))
    return row


def check(of: Entry) -> None:
    """Drive a controller through some metres in both settings; InputError when it fails but for derailment."""
    scenario = load_scenario("curve_entry_T3").but(end_m=FIRST_LOOK)
    for setting in suite.JUDGED_ON:
        sensors = {"seed": suite.draws().published} if setting == suite.LOOP else {}
        row = drive(of, suite.Case("check", setting, scenario, sensors=sensors))
        if "way" not in row:
            raise InputError(row["failure"])


def score(
    of: Entry, seeds: int | Sequence[int], names: tuple[str, ...] | None = None, quiet: bool = False
) -> pd.DataFrame:
    """Judged rows of the suite, for one or several draws.

    Parameters
    ----------
    of : Entry
    seeds : int or sequence of int
        See `suite.cases`; a case that two draws have in common is driven once.
    names : tuple of str, optional
        Runs of a small suite, without margins; default all.
    quiet : bool
        No progress bar.

    Returns
    -------
    DataFrame
        See `card.judged`, with the column `seed`.
    """
    draws = (seeds,) if isinstance(seeds, int) else tuple(seeds)
    for seed in draws:
        require("seed", seed, between(0, 2**31), whole=True)
    wanted = [(seed, case) for seed in draws for case in suite.cases(seed, names)]
    if not wanted:
        raise InputError(f"score: there is no run of the names {names}")
    different: list[suite.Case] = []
    for _, case in wanted:
        if case not in different:
            different.append(case)
    with executor() as pool:
        ends = ordered_map(pool, anchors, different, "limits", quiet)
        rows = ordered_map(pool, lambda case: work(drive, of, case), different, f"score {of.name}", quiet)
    places = [different.index(case) for _, case in wanted]
    found = [rows[k] | ends[k] | {"seed": seed} for k, (seed, _) in zip(places, wanted, strict=True)]
    return card.judged(found)


def anchors(case: suite.Case) -> dict:
    """Both ends of the scale of a case: J of `nothing` and of the `best` possible, and the `limit` of the error (m)."""
    undelayed = replace(case, delay=0.0)
    key = experiment(Entry(NOTHING), undelayed).key(_cost)
    row, _ = store.entry(key, lambda: work(_unguided, undelayed))  # the registry of a worker does not have it
    found = {"nothing": row["cost"], "best": 0.0, "limit": float("nan")}
    return found if case.setting == suite.EQUAL else found | limits(case)


def _unguided(case: suite.Case) -> store.Entry:
    of = experiment(Entry(NOTHING), case)
    return _cost(of.run(), of)


def _cost(run: Run, of: Experiment) -> store.Entry:
    """Cost J of a run, inf where a running gear derails."""
    row = of.values(run) | {"setting": of.setting}
    return {"cost": float("inf") if run.failed else card.cost(row)}, None


def limits(case: suite.Case) -> dict[str, float]:
    """RMS lateral error that no causal controller undercuts with sensors (m), and the least J with its torque."""
    scenario, loop = case.scenario, readings(**case.sensors).loop
    speed = scenario.speed if scenario.stop_kmh is None else max(scenario.stop_speed, _SLOWEST)
    route = scenario.route()
    slopes = route.reference_at(np.arange(0.0, scenario.end_m or route.length))[1]
    errors = {a: bound.with_place(error, slopes, loop) for a, error in _errors(loop, speed).items()}
    return {"limit": min(errors.values()), "best": min(e / 1e-3 + a / 4e3 for a, e in errors.items())}


@lru_cache(maxsize=64)
def _errors(loop: Loop, speed: float) -> dict[float, float]:
    """Bound of the error (m) by the torque above 5 Hz (N m)."""
    key = store.key(__name__, "limit", loop, speed, WALKS, _ACTIVITIES, load_vehicle())
    row, _ = store.entry(key, lambda: work(_bounds, loop, speed))
    return dict(zip(_ACTIVITIES, row["errors"], strict=True))


def _bounds(loop: Loop, speed: float) -> store.Entry:
    found = [bound.limit(load_vehicle(), loop, speed, WALKS, activity=a).error for a in _ACTIVITIES]
    return {"errors": found}, None


def main(controller: str | None = None, seed: int | None = None, small: bool = False, describe: bool = False) -> None:
    """Score one controller on the published draw, or on that of a seed, and print its card.

    `small` takes the quick runs only, and no margins; `describe` prints what a law may use.
    """
    if describe:
        print(description())
        return
    if controller is None:
        raise InputError("score: a Python file with one controller class, or a registered name, is needed")
    chosen, draw = entry(controller), suite.draws().published if seed is None else seed
    print(f"checking controller {chosen.name}", flush=True)
    check(chosen)
    table = score(chosen, draw, suite.QUICK if small else None)
    long, file = card.tidy(table, draw), paths.BUILD / "score" / f"{chosen.name}-{draw}.csv"
    write(file, long.to_csv(index=False, float_format="%.6g"))
    for _, row in table[table["failure"] != ""].iterrows():
        print(f"failed: {row['scenario']} in the setting {row['setting']}: {row['failure']}")
    print(card.text(long))
    print(f"seed {draw}; written: {file}")
