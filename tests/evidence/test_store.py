"""The store of results: no stored row outlives the code and data that made it, and none is lost without a reason."""

import math
import os
from dataclasses import replace
from operator import call

import numpy as np
import pandas as pd
import pytest

from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.registry import CONTROLLERS
from railrepro.data import InputError
from railrepro.evidence.claims import probe
from railrepro.evidence.runs import executor as executors
from railrepro.evidence.runs import swarm, tuning
from railrepro.evidence.runs.executor import executor, ordered_map
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.alignment import alignments

SHORT = Experiment(load_scenario("curve_entry_T3").but(end_m=8.0), "ndi", stride=100)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A store of one's own."""
    monkeypatch.setenv("RAILREPRO_STORE", str(tmp_path / "store"))
    return tmp_path / "store"


@pytest.fixture
def runs(monkeypatch):
    """Experiments that were really simulated."""
    seen, run = [], Experiment.run
    monkeypatch.setattr(Experiment, "run", lambda self: seen.append(self) or run(self))
    return seen


def test_a_row_is_read_again_to_the_last_bit_unless_the_store_is_off(folder, runs, monkeypatch):
    first, series = SHORT()
    again, stored = SHORT()
    assert len(runs) == 1 and len(list(folder.rglob("*.json"))) == 1
    assert repr(first) == repr(again)
    pd.testing.assert_frame_equal(series, stored, check_exact=True)
    monkeypatch.setenv("RAILREPRO_STORE", "off")
    SHORT()
    assert len(runs) == 2 and len(list(folder.rglob("*.json"))) == 1


CHANGES = {
    "speed": lambda e: replace(e, scenario=e.scenario.but(speed_kmh=279.0)),
    "track": lambda e: replace(e, scenario=e.scenario.but(track="T4")),
    "set point": lambda e: replace(e, scenario=e.scenario.but(set_point=e.scenario.set_point | {"amplitude_mm": 2.9})),
    "rail": lambda e: replace(e, scenario=e.scenario.but(good="wet")),
    "tuned set": lambda e: replace(e, setting="loop"),
    "vehicle": lambda e: replace(e, vehicle={"suspension.c_y": 2e4}),
    "plant": lambda e: replace(e, plant={"contact.profile": "cone"}),
    "sensors": lambda e: replace(e, sensors={"seed": 1}),
    "seed": lambda e: replace(e, sensors={"seed": 2}),
    "irregular rails": lambda e: replace(e, irregular={"seed": 1}),
    "substeps": lambda e: replace(e, substeps=2),
    "adhesion law": lambda e: replace(e, adhesion=AdhesionSettings(active=False)),
    "share": lambda e: replace(e, fixed_share=0.1),
    "alignment": lambda e: replace(e, alignment=alignments()["T3"]),
    "other alignment": lambda e: replace(e, alignment=alignments()["T4"]),
    "series": lambda e: replace(e, stride=50),
    "controller": lambda e: replace(e, controller="ndi_feedforward"),
}


def test_whatever_a_run_reads_is_in_its_key():
    keys = {name: change(SHORT).key(probe.following) for name, change in CHANGES.items()}
    assert len({*keys.values(), SHORT.key(probe.following), SHORT.key(probe.braked)}) == len(CHANGES) + 2
    assert None not in keys.values()


def test_the_points_of_a_wheel_profile_are_in_the_key(tmp_path):
    across, file = np.linspace(-45.0, 45.0, 400), tmp_path / "wheel.csv"
    table = pd.DataFrame({"part": "wheel", "lateral_mm": across, "height_mm": across / 40})
    table.to_csv(file, index=False)
    one = replace(SHORT, plant={"contact.profile": str(file)})
    before = one.key(probe.following)
    assert before is not None
    table.assign(height_mm=across / 20).to_csv(file, index=False)
    assert one.key(probe.following) != before
    file.unlink()
    with pytest.raises(InputError, match="wheel.csv"):
        one.key(probe.following)


@pytest.mark.parametrize("content", [b"", b"3", b"junk" * 100, None])
def test_broken_entries_are_computed_anew(content, folder, runs):
    row, _ = SHORT()
    (file,) = folder.rglob("*.json")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if content is None else content)
    assert repr(SHORT()[0]) == repr(row) and len(runs) == 2
    assert file.read_bytes() == whole


def test_stored_experiments_start_no_worker(folder):
    experiments = [replace(SHORT, label={"n": n}, scenario=SHORT.scenario.but(end_m=8.0 + n)) for n in range(2)]
    first = [one() for one in experiments]

    class NoPool:
        def submit(self, *_):
            pytest.fail("a worker was asked")

    results = ordered_map(NoPool(), call, experiments, "again", quiet=True)
    assert repr([row for row, _ in results]) == repr([row for row, _ in first]) and results[1][0]["n"] == 1


def test_the_runs_of_an_evaluation_are_stored_one_by_one(folder, runs):
    task = tuning.load_task()
    run = replace(task.runs["T3"], scenario=task.runs["T3"].scenario.but(end_m=20.0))
    evaluation = swarm.Evaluation("ndi", replace(task, runs={"T3": run, "seen": replace(run, sensors={"seed": 1})}))
    poles = {"pole": 20.0, "frequency": 20.0, "damping": 1.0}
    cost = evaluation(poles)
    next(folder.rglob("*.json")).unlink()
    assert evaluation(poles) == cost and math.isfinite(cost[0]) and len(runs) == 3


def test_what_a_worker_computes_is_stored_by_who_asked(folder, monkeypatch):
    """The worker has no folder, as one on another machine."""
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    executors._processes.cache_clear()
    with monkeypatch.context() as elsewhere:
        elsewhere.setenv("RAILREPRO_STORE", "off")
        with executor() as pool:
            pool.submit(os.getpid).result()
    with executor() as pool:
        ((row, _),) = ordered_map(pool, call, [SHORT], "elsewhere", quiet=True)
    monkeypatch.setattr(Experiment, "run", lambda self: pytest.fail("it is stored"))
    assert repr(SHORT()[0]) == repr(row)


def test_a_controller_of_a_users_file_is_not_stored(folder, monkeypatch):
    entry = replace(CONTROLLERS["ndi"], build=lambda settings: settings)
    monkeypatch.setitem(CONTROLLERS, "own", entry)
    assert replace(SHORT, controller="own").key(probe.following) is None
