"""The store of results: a result is read again exactly as long as the code and data that made it are the same."""

import math
import os
from dataclasses import replace
from operator import call

import pandas as pd
import pytest

from railrepro import code, paths
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.registry import CONTROLLERS
from railrepro.evidence.claims import probe
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies import executor as executors
from railrepro.studies import store
from railrepro.studies.executor import executor, ordered_map
from railrepro.studies.experiment import Experiment
from railrepro.track.alignment import alignments
from railrepro.tuning.cost import evaluate
from railrepro.tuning.task import load_task

POLES = {"pole": 20.0, "frequency": 20.0, "damping": 1.0}
SHORT = Experiment(load_scenario("curve_entry_T3").but(end_m=8.0), "ndi", stride=100)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty store."""
    monkeypatch.setenv("RAILREPRO_STORE", str(tmp_path / "store"))
    return tmp_path / "store"


@pytest.fixture
def runs(monkeypatch):
    """Experiments that were simulated, not read."""
    seen, run = [], Experiment.run
    monkeypatch.setattr(Experiment, "run", lambda self: seen.append(self) or run(self))
    return seen


def test_a_row_is_read_again_to_the_last_bit_unless_the_store_is_off(folder, runs, monkeypatch):
    first, series = SHORT()
    again, stored = SHORT()
    assert len(runs) == 1 and len(list(folder.rglob("*.json"))) == 1 and repr(first) == repr(again)
    pd.testing.assert_frame_equal(series, stored, check_exact=True)
    monkeypatch.setenv("RAILREPRO_STORE", "off")
    SHORT()
    assert len(runs) == 2 and len(list(folder.rglob("*.json"))) == 1


SCENARIO = SHORT.scenario
CHANGES = [
    {"scenario": SCENARIO.but(speed_kmh=279.0)},
    {"scenario": SCENARIO.but(track="T4")},
    {"scenario": SCENARIO.but(set_point=SCENARIO.set_point | {"amplitude_mm": 2.9})},
    {"setting": "loop"},
    {"vehicle": {"suspension.c_y": 2e4}},
    {"plant": {"contact.profile": "cone"}},
    {"sensors": {"seed": 1}},
    {"sensors": {"seed": 2}},
    {"irregular": {"seed": 1}},
    {"irregular": {"seed": 1}, "preview": {"share": 0.5}},
    {"alignment": alignments()["T4"]},
    {"controller": "ndi_feedforward"},
    {"parameters": POLES},
    {"adhesion": AdhesionSettings(active=False)},  # this and the next one leave this run as it is
    {"alignment": alignments()["T3"]},
]


def test_whatever_a_run_reads_and_what_chooses_the_last_digits_is_in_its_key_and_no_label(monkeypatch):
    keys, before = [replace(SHORT, **change).key(probe.following) for change in CHANGES], SHORT.key(probe.following)
    assert len({*keys, before, SHORT.key(probe.braked)} - {None}) == len(CHANGES) + 2
    assert replace(SHORT, label={"n": 1}).key(probe.following) == before
    monkeypatch.setattr(store, "machine", store.machine.__wrapped__)
    for name in ("RAILREPRO_CFLAGS", "OPENBLAS_CORETYPE", "GLIBC_TUNABLES"):
        monkeypatch.setenv(name, "other")
        assert before != (before := SHORT.key(probe.following))


def driven(experiment):
    """Numbers and key of a run into the curve."""
    run = replace(experiment, scenario=experiment.scenario.but(end_m=40.0))
    return run.run().series.to_numpy().tobytes(), run.key(probe.following)


@pytest.mark.parametrize("change", CHANGES[:-2])
def test_a_run_follows_what_changes_between_runs_of_a_process(change):
    before, changed = driven(SHORT), driven(replace(SHORT, **change))
    assert driven(SHORT) == before and len({*before, *changed}) == 4


EDITS = [
    ("vehicle.toml", "value = 3000.0", "value = 2999.0", {}),
    ("tracks.toml", "straight_m = 25", "straight_m = 2", {}),
    ("irregularities.toml", "level_mm = 0.40", "level_mm = 0.4000001", {"irregular": {"spectrum": "en_A_300"}}),
    ("sensors.toml", "value = 0.004", "value = 0.0041", {"sensors": {"seed": 1}}),
]


@pytest.mark.parametrize(("file", "old", "new", "change"), EDITS)
def test_a_run_follows_a_file_that_is_edited_between_runs_of_a_process(file, old, new, change, tmp_path, monkeypatch):
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    text, own, run = (paths.DATA / file).read_text(), tmp_path / "data" / file, replace(SHORT, **change)
    own.parent.mkdir()
    before, *edited = [own.write_text(each) and driven(run) for each in (text, text.replace(old, new), text)]
    assert edited[1] == before and len({*before, *edited[0]}) == 4


def test_a_run_follows_a_track_file_and_a_dict_that_are_edited_between_runs_of_a_process(tmp_path):
    file, found = tmp_path / "own.csv", []
    run = replace(SHORT, scenario=SCENARIO.but(track=str(file)), plant={"wheel.radius": 0.46})
    for curvature in (2e-4, 1e-4):
        file.write_text(f"p_m,dpsi_dp_1pm\n0,{curvature}\n900,{curvature}\n")
        found.append(driven(run))
    run.plant["wheel.radius"] = 0.45
    assert len({*found[0], *found[1], *driven(run)}) == 6


@pytest.mark.parametrize(
    "broken",
    [
        lambda whole: b"",
        lambda whole: whole[: len(whole) // 2],
        lambda whole: whole.replace(b'"rmse_y": 0.0', b'"rmse_y": 0.1'),
    ],
)
def test_broken_entries_are_computed_anew(broken, folder, runs):
    row, _ = SHORT()
    [file] = folder.rglob("*.json")
    whole = file.read_bytes()
    file.write_bytes(broken(whole))
    assert file.read_bytes() != whole and repr(SHORT()[0]) == repr(row) and len(runs) == 2
    assert file.read_bytes() == whole


def test_an_edit_just_after_a_key_keeps_a_result_from_the_store(folder, monkeypatch):
    key, result = SHORT.key(probe.following), ({"fade": 1.0}, None)
    monkeypatch.setattr(code, "_edited", False)
    monkeypatch.setitem(code._SIGNATURES, code.__file__, None)
    assert code.unchanged(within=60.0) and store.entry(key, lambda: result) == result and not folder.exists()
    assert SHORT.key(probe.following) is None


def test_the_runs_of_an_evaluation_are_stored_one_by_one(folder, runs):
    task = load_task()
    run = replace(task.runs["T3"], scenario=task.runs["T3"].scenario.but(end_m=20.0))
    task = replace(task, runs={"T3": run, "seen": replace(run, sensors={"seed": 1})})
    cost = evaluate("ndi", task, POLES)
    next(file for file in folder.rglob("*.json") if b"rmse_y" in file.read_bytes()).unlink()  # others are margins
    assert evaluate("ndi", task, POLES) == cost and math.isfinite(cost[0]) and len(runs) == 3


def test_what_a_worker_computes_is_stored_by_who_asked_and_asked_of_no_worker_again(folder, monkeypatch):
    """The worker has no folder, as one on another machine."""
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    executors._processes.cache_clear()
    with monkeypatch.context() as elsewhere, executor() as pool:
        elsewhere.setenv("RAILREPRO_STORE", "off")
        pool.submit(os.getpid).result()
    experiments = [replace(SHORT, label={"n": n}, scenario=SCENARIO.but(end_m=8.0 + n)) for n in range(2)]
    first = ordered_map(call, experiments, "elsewhere", quiet=True)
    with executor() as pool:
        monkeypatch.setattr(pool, "submit", lambda *_: pytest.fail("a worker was asked"))
    again = ordered_map(call, experiments, "again", quiet=True)
    assert repr([row for row, _ in again]) == repr([row for row, _ in first]) and again[1][0]["n"] == 1


def test_a_controller_of_a_users_file_is_not_stored(folder, monkeypatch):
    entry = replace(CONTROLLERS["ndi"], build=lambda settings: settings)
    monkeypatch.setitem(CONTROLLERS, "own", entry)
    assert replace(SHORT, controller="own").key(probe.following) is None
