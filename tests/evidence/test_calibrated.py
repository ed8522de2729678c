"""The calibrated car: its choices are documented, and the paper's statements hold on it together."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from railrepro import paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.evidence.claims import calibrated
from railrepro.tuning import sets

CHOICES = calibrated.load()


def test_the_uncalibrated_car_is_the_nominal_one_on_s1002_with_the_sets_of_paper():
    setup = calibrated.setup({})
    assert setup.car().contact.profile == "s1002" and not setup.vehicle and setup.r_loss == setup.r_brake == 1
    assert setup.parameters == {name: sets.load(name, "paper")["parameters"] for name in PAPER_TRIO}
    nominal = {name: choice.nominal for name, choice in CHOICES.items() if name != "ltv_mpc_printed.r"}
    as_given = calibrated.setup(nominal)
    assert replace(as_given, plant={}, vehicle={}, brake_sweep={}) == setup
    sweep = {"brake_sweep": {"amplitude_mm": 2.0, "end_m": 800.0}, "brake_sweep:end_m": 700.0}
    assert calibrated.setup(sweep).brake_sweep == {"amplitude_mm": 2.0, "end_m": 700.0}
    assert as_given.car() == setup.car() and as_given.scenario("braking") == setup.scenario("braking")


@pytest.mark.parametrize("size", calibrated.SIZES)
def test_perturbations_move_every_changed_number_and_nothing_else(size):
    draws = [calibrated.perturbed(CHOICES, size, draw) for draw in range(5)]
    assert draws[0] == calibrated.perturbed(CHOICES, size, 0) != draws[1]
    for name, choice in CHOICES.items():
        moved = [draw[name] for draw in draws]
        if not isinstance(choice.value, float) or choice.value == choice.nominal:
            assert all(value == choice.value for value in moved)
            continue
        ratios = np.array(moved) / choice.value
        assert 0.3 * size < np.abs(ratios - 1).max() <= size, name
        assert max(moved) <= 1 or name not in ("adhesion.poor.k_a", "adhesion.poor.k_s")


def test_one_choice_is_undone_and_all_others_stay(monkeypatch):
    monkeypatch.setattr(calibrated, "judged", lambda setup: pd.DataFrame({"setup": [setup]}))
    values = {name: choice.value for name, choice in CHOICES.items()}
    for name, choice in CHOICES.items():
        ((setup, undone),) = calibrated.undone(name).to_numpy()
        assert undone == name and setup == calibrated.setup(values | {name: choice.nominal})
        assert setup != calibrated.cars()["calibrated"]


def test_the_curve_entry_reproduces_the_paper():
    found = calibrated.judged(calibrated.cars()["calibrated"], parts=("curve",)).set_index("statement")
    assert set(found.index) == {"C04", "C05", "C06", "C07", "C08", "C09", "C10", "C11", "C12", "C42", "C51"}
    assert set(found.index[~found["holds"]]) == {"C04", "C07", "C51"}, "C07 is a tie by the spread of seeds"


@pytest.mark.slow
def test_most_statements_hold_with_one_r():
    setup = calibrated.cars()["calibrated"]
    assert setup.r_loss == setup.r_brake == 1
    found = calibrated.judged(setup).set_index("statement")
    assert set(found.index[~found["holds"]]) == {f"C{n:02d}" for n in (4, 7, 17, 20, 30, 32, 46, 51)}
    stored = pd.read_csv(paths.source("data/results/paper_like.csv")).set_index("statement")
    assert np.allclose(found["value"], stored.loc[found.index, "value"], rtol=2e-3, equal_nan=True)
