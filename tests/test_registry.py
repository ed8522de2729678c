"""Names of controllers and set-ups: one home, known to figures, tables and studies."""

import pandas as pd

from railrepro import paths
from railrepro.control import registry
from railrepro.report import figures


def test_groups_are_made_of_registered_controllers_in_their_order():
    order = list(registry.CONTROLLERS)
    for group in (registry.PREDICTIVE, registry.INVERSIONS, registry.PAPER_TRIO, registry.TRIO, registry.COMPARED):
        assert list(group) == sorted(group, key=order.index)
    assert set(registry.PREDICTIVE) | set(registry.INVERSIONS) == set(order)


def test_every_controller_has_a_look_of_its_own():
    looks = [str(figures.CONTROLLER_STYLE[name]) for name in (*registry.CONTROLLERS, registry.WITH_OBSERVER)]
    assert len(set(looks)) == len(looks)


def test_set_up_of_the_adhesion_experiment_is_called_the_same_in_its_table():
    cases = pd.read_csv(paths.source("data/results/adhesion_metrics.csv"))["case"]
    assert registry.r_times(registry.EMPHASIS, "NMPC") in set(cases)


def test_emphasis_multiplies_the_weight_of_the_torque_only():
    tuned = {"r": 2.0, "q_terminal": 3.0}
    assert registry.with_r_times(tuned, 10.0) == {"r": 20.0, "q_terminal": 3.0}
    assert registry.r_times(0.01) == "R x 0.01"
