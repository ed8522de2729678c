"""What stands at both ends of the scale of a case: no guidance at all, and the limit of physics and sensors."""

from __future__ import annotations

from dataclasses import replace

from railrepro.evidence.runs import store
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.score import card, suite
from railrepro.evidence.score.entry import NOTHING, Entry
from railrepro.evidence.score.trial import Trial
from railrepro.simulation.simulate import Run


def nothing(case: suite.Case) -> float:
    """Cost J of a case that nobody guides, inf where a gear leaves the rail."""
    undelayed = replace(case, delay=0.0)
    row, _ = Trial(Entry(NOTHING), undelayed).experiment([]).measured(_cost)
    return row["cost"]


def _cost(run: Run, experiment: Experiment) -> store.Entry:
    row = experiment.values(run) | {"setting": experiment.setting}
    return {"cost": float("inf") if run.failed else card.cost(row)}, None


def error_limit(case: suite.Case) -> float:
    """RMS lateral error that no causal controller can undercut in a case (m); nan where it is not known."""
    return float("nan")


def anchors(case: suite.Case) -> dict:
    """Both ends of the scale of a case: `nothing` (J) and `limit` (m)."""
    return {"nothing": nothing(case), "limit": error_limit(case)}
