"""What stands at both ends of the scale of a case: no guidance at all, and the limit of physics and sensors.

With sensors the limit is the linear-quadratic-Gaussian bound of the creep model
(`railrepro.evidence.uncertainty.limit`) with the noise, latency and biases of the loop, at the speed of the case, on
dry rail and for disturbances that wander as slowly as in the quietest run: what disturbs more raises it. It holds for
the mean over draws; the bias of one draw may be kinder. With perfect measurements only the drive limits the error,
which no case comes near, and the limit is 0.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from railrepro.estimation.sensors import Loop, readings
from railrepro.evidence.runs import store
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import NOTHING, Entry
from railrepro.evidence.score.trial import Trial
from railrepro.evidence.uncertainty import limit as bound
from railrepro.simulation.simulate import Run
from railrepro.vehicle.parameters import load_vehicle

WALKS = (220.0, 20.0)
"""Walks of lateral force and yaw moment in the quietest of the runs (N/s^0.5, N m/s^0.5)."""
_ACTIVITIES = (20.0, 50.0, 115.0, 500.0)
"""Torque above 5 Hz among which the least cost is sought; beyond the last the cost of a case counts it twice (N m)."""


def anchors(case: suite.Case) -> dict:
    """Both ends of the scale of a case: J of `nothing` and of the `best` possible, and the `limit` of the error (m)."""
    found = {"nothing": nothing(case), "best": 0.0, "limit": float("nan")}
    return found if case.setting == suite.EQUAL else found | limits(case)


def nothing(case: suite.Case) -> float:
    """Cost J of a case without guidance, inf where a running gear derails."""
    undelayed = replace(case, delay=0.0)
    row, _ = Trial(Entry(NOTHING), undelayed).experiment().measured(_cost)
    return row["cost"]


def _cost(run: Run, experiment: Experiment) -> store.Entry:
    row = experiment.values(run) | {"setting": experiment.setting}
    return {"cost": float("inf") if run.failed else card.cost(row)}, None


def limits(case: suite.Case) -> dict[str, float]:
    """RMS lateral error that no causal controller undercuts with sensors (m), and the least J with its torque."""
    scenario, loop = case.scenario, readings(**case.sensors).loop
    speed = scenario.speed if scenario.stop_kmh is None else max(scenario.stop_speed, _SLOWEST)
    route = scenario.route()
    slopes = route.reference_at(np.arange(0.0, scenario.end_m or route.length))[1]
    errors = {a: bound.with_place(error, slopes, loop) for a, error in _errors(loop, speed).items()}
    return {"limit": min(errors.values()), "best": min(e / 1e-3 + a / 4e3 for a, e in errors.items())}


_SLOWEST = 10.0
"""Speed at which the bound of a braking car is taken (m/s); it grows with speed."""


@lru_cache(maxsize=64)
def _errors(loop: Loop, speed: float) -> dict[float, float]:
    """Bound of the error (m) by the torque above 5 Hz (N m)."""

    def compute() -> store.Entry:
        found = [bound.limit(load_vehicle(), loop, speed, WALKS, activity=a).error for a in _ACTIVITIES]
        return {"errors": found}, None

    row, _ = store.entry(store.key(__name__, "limit", loop, speed, WALKS, _ACTIVITIES, load_vehicle()), compute)
    return dict(zip(_ACTIVITIES, row["errors"], strict=True))
