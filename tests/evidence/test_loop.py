"""The table of the closed loop: its rows, their means, and the limit next to them."""

import numpy as np
import pytest

from railrepro.evidence.uncertainty import loop
from railrepro.tuning.task import load_task


def test_tuning_has_neither_the_seeds_nor_the_held_out_runs():
    task = load_task(setting="loop")
    assert not {run.sensors["seed"] for run in task.runs.values()} & set(loop.SEEDS) and len(set(loop.SEEDS)) == 24
    tuned = [(run.scenario.but(end_m=1.0), run.plant, run.irregular) for run in task.runs.values()]
    for one in loop.experiments():
        known = (one.scenario.but(end_m=1.0), one.plant, one.irregular) in tuned
        assert one.label["kind"] != "held out" or not known
        assert one.label["kind"] != "irregular" or one.irregular["seed"] == one.sensors["seed"]


def test_errors_are_root_mean_squares_over_the_seeds_and_sensors_alone_would_leave_less(monkeypatch):
    """A bias of 0.2 mm is observable: the contact does not centre the running gear by itself."""
    monkeypatch.setattr(loop, "COMPARED", ("ndi_feedforward",))
    monkeypatch.setattr(loop, "SEEDS", (201, 202))
    runs = loop.row("loop", "short", "sine_tracking", {"end_m": 40.0})
    found = loop.table(runs).iloc[0]
    rows = [run.measured(loop.followed)[0] for run in runs]
    errors, rear = ([row[name] for row in rows] for name in ("error_mm", "rear_mm"))
    assert found["rear_mm"] == pytest.approx(np.sqrt(np.mean(np.square(rear))))
    assert found["error_mm"] == pytest.approx(np.sqrt(np.mean(np.square(errors)))) and found["seeds"] == 2
    assert found["spread_mm"] == pytest.approx(np.std(errors, ddof=1)) and errors[0] != errors[1]
    assert found["failed"] == 0 and 0.03 < found["limit_at_believed_place_mm"] < found["limit_mm"] < 0.2
    assert not loop.limit_of(loop.row("loop", "poor rail", "adhesion_loss", {})[0])
