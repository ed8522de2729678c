"""The table of the closed loop: its rows, its means, and the walks and limits beside them."""

import numpy as np
import pandas as pd
import pytest

from railrepro.control.registry import OURS
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.executor import executor
from railrepro.evidence.uncertainty import loop


def test_seeds_and_held_out_kinds_are_none_of_tuning():
    task = tuning.load_task(setting="loop")
    assert not {run.sensors["seed"] for run in task.runs.values()} & set(loop.SEEDS) and len(set(loop.SEEDS)) == 24
    tuned = [(run.scenario.but(end_m=1.0), run.plant, run.irregular) for run in task.runs.values()]
    for one in loop.experiments():
        known = (one.scenario.but(end_m=1.0), one.plant, one.irregular) in tuned
        assert one.label["kind"] != "held out" or not known or "gyro.dropout" in one.sensors
        assert one.label["kind"] != "irregular" or one.irregular["seed"] == one.sensors["seed"]


def test_errors_are_root_mean_squares_over_the_seeds(monkeypatch):
    monkeypatch.setattr(loop, "COMPARED", ("ndi_feedforward",))
    monkeypatch.setattr(loop, "SEEDS", (201, 202))
    runs = loop.row("loop", "short", "sine_tracking", {"end_m": 40.0})
    with executor() as pool:
        table = loop.table(runs, pool)
    rows = [run.measured(loop.followed)[0] for run in runs]
    errors, rear = ([row[name] for row in rows] for name in ("error_mm", "rear_mm"))
    assert table["rear_mm"].item() == pytest.approx(np.sqrt(np.mean(np.square(rear))))
    assert table["error_mm"].item() == pytest.approx(np.sqrt(np.mean(np.square(errors)))) and table["seeds"].item() == 2
    assert table["spread_mm"].item() == pytest.approx(np.std(errors, ddof=1)) and errors[0] != errors[1]
    assert table["failed"].item() == 0


def test_rows_that_are_not_led_stand_first_and_who_leaves_the_rail_does_not_lead():
    cases = {"led": (0, 0.1), "close": (0, 0.21), "led not": (0, 0.3), "lost": (1, 0.1)}
    rows = [("loop", case, OURS, *found, 0.02, 0.05) for case, found in cases.items()]
    rows += [("loop", case, name, 0, error, 0.02, 0.05) for case in cases for name, error in (("a", 0.2), ("b", 0.4))]
    rows.append(("loop", "led", "c", 3, 0.01, 0.02, 0.05))
    names = ["kind", "case", "controller", "failed", "error_mm", "spread_mm", "limit_mm"]
    stood = loop.standing(pd.DataFrame(rows, columns=names))
    assert stood["standing"].droplevel("kind").to_dict() == {
        "led not": "behind", "lost": "behind", "close": "tied", "led": "ahead"
    }  # fmt: skip
    assert stood.index.get_level_values("case").tolist() == ["led not", "lost", "close", "led"]
    assert (stood["other"] == "a").all() and stood["over_limit"].iloc[0] == pytest.approx(6.0)


def test_sensors_alone_bound_the_loop_from_below():
    """A bias of .2 mm can be told from the gear, which the contact does not hold in the middle by itself."""
    limits = [loop.limit_of(run) for run in loop.row("loop", "sine", "sine_tracking", {"end_m": 250.0})[:1]]
    assert 0.03 < limits[0]["limit_at_believed_place_mm"] < limits[0]["limit_mm"] < 0.2
    assert not loop.limit_of(loop.row("loop", "poor rail", "adhesion_loss", {})[0])
