"""Runs side by side: each has the bits of the run alone, whatever its neighbours, their lengths and their ends."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.compile import codegen
from railrepro.control.ndi import NDI
from railrepro.control.tuned import tuned
from railrepro.errors import InputError
from railrepro.estimation.sensors import readings
from railrepro.evidence.runs import executor
from railrepro.simulation import lanes, simulate
from railrepro.simulation.scenarios import load_scenarios
from railrepro.track.rough import rough_track
from railrepro.vehicle.parameters import load_vehicle, sample_ranges

pytestmark = pytest.mark.skipif(codegen.compiler() is None, reason="there is no C compiler")
SCENARIOS = load_scenarios()


CONE = {"contact.profile": "cone"}  # no flange: some leave the rails
KEYS = ("gear.mass", "wheel.cone_angle", "suspension.c_y", "contact.normal_stiffness", "adhesion.poor.mu0")


def experiments(number, seed):
    """Random runs: scenario, length, controller, car, sensors, steps of the car, rails; some derail."""
    rng, drawn = np.random.default_rng(seed), []
    rough, ranges = rough_track(np.arange(0.0, 400.0, 0.25), seed=1), sample_ranges()
    laws = tuned("ndi"), tuned("ndi_feedforward"), NDI(pole=1e3, frequency=500.0, damping=0.01)
    for _ in range(number):
        scenario = SCENARIOS[str(rng.choice(["curve_entry_T3", "sine_tracking", "adhesion_loss", "braking"]))]
        predictive = tuned("nmpc", {"solver": "rti"}) if rng.random() < 0.5 else tuned("ltv_mpc")
        guidance = laws[int(rng.choice(3, p=[0.7, 0.15, 0.15]))]
        drawn.append({
            "scenario": replace(scenario, end_m=float(rng.uniform(20, 90))),
            "guidance": guidance if rng.random() < 0.7 else predictive,
            "plant_vehicle": load_vehicle(**CONE | {key: float(rng.uniform(*ranges[key])) for key in KEYS}),
            "sensors": readings() if rng.random() < 0.2 else None,
            "substeps": int(rng.choice([1, 2], p=[0.8, 0.2])),
            "irregularities": rough if rng.random() < 0.3 else None,
        })  # fmt: skip
    return drawn


def drive(arguments):
    """A run by its arguments; no arguments are a fault."""
    if arguments is None:
        raise InputError("nothing to drive")
    return simulate.run(**arguments)


def same(one, other):
    """Whether two runs have the same bits."""
    bits = [run.series.to_numpy().tobytes() + run.state.tobytes() for run in (one, other)]
    return bits[0] == bits[1] and (one.ended, one.failed, one.memory) == (other.ended, other.failed, other.memory)


def check(drawn, monkeypatch):
    """Every run equals the run alone, and some went side by side."""
    beside, run = [], lanes.SideBySide.run
    monkeypatch.setattr(lanes.SideBySide, "run", lambda self, n: beside.append(len(self.exchanges)) or run(self, n))
    found = lanes.together(drive, drawn)
    assert max(beside) == lanes.LANES
    number = len(beside)
    for arguments, run_beside in zip(drawn, found, strict=True):
        assert same(drive(arguments), run_beside), arguments
    assert len(beside) == number
    return found


def test_runs_side_by_side_have_the_bits_of_runs_alone(monkeypatch):
    found = check(experiments(24, seed=31), monkeypatch)
    assert any(run.failed for run in found) and not all(run.failed for run in found)


@pytest.mark.slow
def test_two_hundred_runs_have_the_bits_of_runs_alone(monkeypatch):
    check(experiments(200, seed=3131), monkeypatch)


def test_a_fault_of_one_task_is_told_and_ends_the_others():
    drawn = experiments(6, seed=5)
    with pytest.raises(InputError, match="nothing to drive"):
        lanes.together(drive, [*drawn[:3], None, *drawn[3:]])
    assert same(lanes.together(drive, drawn[:1])[0], drive(drawn[0]))


def test_runs_of_the_executor_go_side_by_side(monkeypatch):
    calls = []
    monkeypatch.setattr(
        executor.lanes, "together", lambda task, batch: calls.append(len(batch)) or list(map(task, batch))
    )
    assert executor._here(abs, [-1, -2], True)[0] == executor._here(abs, [-1, -2], False)[0] == [1, 2]
    assert calls == [2]


def test_a_car_that_is_no_number_ends_without_its_neighbours():
    vehicle, scenario = load_vehicle(), SCENARIOS["sine_tracking"]
    route = simulate.checked_route(scenario, vehicle)
    one, lost, other = (simulate.start(scenario, tuned("ndi"), route, vehicle, vehicle) for _ in range(3))
    lost.state[0] = np.nan
    rows = lanes.SideBySide([lost, one]).run(30)
    assert (len(rows[0]), lost.ended, lost.exchanges) == (1, True, 0)
    assert rows[1].tobytes() == other.run(30).tobytes() and one.exchanges == 30 and not one.ended


def test_tasks_fill_their_lanes_and_leave_no_worker_idle():
    sizes = [executor._batch(number, 2, True, True) for number in (0, 1, 6, 8, 15, 24, 100, 1000)]
    assert sizes == [1, 1, 1, 4, 8, 8, 25, 32]
    assert executor._batch(100, 2, True, False) == 1 and executor._batch(6, 2, False, True) == 2
