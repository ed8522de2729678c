"""Irregular rails in the cells of a route: as given, without kinks."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import route
from railrepro.track.irregularity import CHANNELS, irregularities
from railrepro.track.table import load_track


def named(rows):
    return dict(zip(route.COLUMNS, rows.T, strict=True))


def test_cells_meet_the_rows_and_have_no_kinks():
    rough = irregularities(np.arange(0.0, 200.0, route.CELL), "en_B_300")
    cells = route.lay(load_track("T5"), irregularities=rough).cells
    cell, following = named(cells[:-1]), named(cells[1:])
    inside = (cell["p"] >= 0) & (cell["p"] < 200)
    for channel, column in CHANNELS.items():
        assert np.allclose(cell[channel][inside], rough[column], rtol=0, atol=1e-15)
        end = route.irregularity_in(cell, channel, following["p"])
        start = route.irregularity_in(following, channel, following["p"])
        assert np.allclose(end, start, rtol=0, atol=1e-14)
        assert (cell[channel][~inside] == 0).all() and (end[1][~inside] == 0).all()
        assert np.abs(end[1]).max() > 1e-4


@pytest.mark.parametrize(("rows", "error"), [(0.5, 5e-3), (0.25, 3.2e-3)])
def test_the_shortest_wave_is_that_of_the_formula_between_the_rows(rows, error):
    """3 m: the cubic of a cell misses h^4 k^4 / 384 = 0.31 %, a spline through rows each half metre 0.2 % more."""
    p = np.arange(0.0, 120.0 + rows / 2, rows)
    frame = irregularities(p).assign(**dict.fromkeys(CHANNELS.values(), 0.0))
    frame["vertical_m"] = 5e-3 * np.sin(2 * np.pi * p / 3.0)
    way = route.lay(load_track("T5"), irregularities=frame)
    at = np.arange(20.0, 100.0, 0.07)
    found = route.irregularity_in(named(way.rows_at(at)), "vertical", at)
    assert np.allclose(found[0] / 5e-3, np.sin(2 * np.pi * at / 3.0), rtol=0, atol=error)
    assert np.allclose(found[1] / 5e-3 * 3 / (2 * np.pi), np.cos(2 * np.pi * at / 3.0), rtol=0, atol=4 * error)


def test_ride_figures_on_irregular_rails_take_two_steps_a_millisecond():
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, end_m=40)
    usual = Experiment(scenario, "ndi", parameters={"pole": 20.0, "frequency": 20.0, "damping": 1.0})
    for rough, ride_too, substeps in (({}, True, 1), ({"seed": 1}, False, 1), ({"seed": 1}, True, 2)):
        experiment = replace(usual, irregular=rough, ride=ride_too)
        assert experiment.run().series.equals(replace(experiment, substeps=substeps).run().series)
        assert not experiment.run().series.equals(replace(experiment, substeps=3).run().series)
