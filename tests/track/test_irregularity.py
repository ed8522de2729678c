"""Irregularities: spectra, quality, defects, preview and planned lines, cells of a route."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from railrepro.data import InputError
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies.experiment import Experiment
from railrepro.studies.preview import known, plan
from railrepro.track import route
from railrepro.track.irregularity import CHANNELS, D1, irregularities, irregularity_spectrum, track_quality
from railrepro.track.rough import rough_track
from railrepro.track.table import load_track


@pytest.fixture(scope="module")
def rough():
    return irregularities(np.arange(0, 600, 0.5), "erri_low", seed=3)


@pytest.mark.parametrize(("length", "period"), [(1000, 4096), (9000, 16384)])
def test_realisations_are_the_stated_sum_of_cosines(length, period):
    """Evaluated directly at places off the grid of the synthesis and far from the ends, at which they are faded out."""
    places = np.array([40.123, 517.25, length - 99.23])
    rows = irregularities(np.sort(np.append(np.arange(0, length, 1.0), places)), "erri_high", 5)
    ends = period / 100, period / 3
    wave = np.arange(round(ends[0]), round(ends[1]) + 1)
    width = np.ones(wave.size)
    width[[0, -1]] = wave[0] + 0.5 - ends[0], ends[1] - wave[-1] + 0.5
    for i, (channel, column) in enumerate(CHANNELS.items()):
        phase = np.random.default_rng((5, i)).uniform(0, 2 * np.pi, wave.size)
        density = 2 * np.pi * irregularity_spectrum("erri_high", channel, 2 * np.pi * wave / period)
        direct = np.cos(2 * np.pi * np.outer(places, wave / period) + phase) @ np.sqrt(2 * density * width / period)
        assert np.allclose(rows.set_index("p_m")[column][places], direct, rtol=0, atol=1e-7 * rows[column].std())
        assert np.abs(rows[column].iloc[[0, 1, -2, -1]]).max() < 1e-3 * rows[column].std()


@pytest.mark.parametrize("spectrum", ["en_A_300", "en_D_300", "en_C_120"])
def test_rails_have_the_standard_deviation_of_their_quality_class(spectrum):
    """The variance of a rail is that of the track centre plus that of half the gauge or cross level."""
    wavenumber = 2 * np.pi / np.linspace(D1[1], D1[0], 20_001)
    variance = {c: np.trapezoid(irregularity_spectrum(spectrum, c, wavenumber), wavenumber) for c in CHANNELS}
    quality = track_quality()[spectrum]
    level = variance["vertical"] + 0.75**2 * variance["crosslevel"]
    alignment = variance["lateral"] + variance["gauge"] / 4
    assert 1e6 * level == pytest.approx(quality.level_mm**2, rel=1e-4)
    assert 1e6 * alignment == pytest.approx(quality.alignment_mm**2, rel=1e-4)


def test_a_quality_named_as_a_built_in_spectrum_is_refused(monkeypatch):
    quality = {"level_mm": 2.0, "alignment_mm": 1.0, "confidence": "A"}
    monkeypatch.setattr("railrepro.data.read", lambda file: {"erri_low": quality})
    with pytest.raises(InputError, match=r"irregularities\.toml: erri_low is a built-in spectrum, another name"):
        irregularities(np.arange(9.0), "erri_low")


def test_defects_are_added_to_random_irregularities():
    p = np.arange(0.0, 200.0, 0.25)
    dip = {"kind": "dip", "start": 40.0, "length": 10.0, "depth": 8e-3, "rail": "le"}
    fault = {"kind": "alignment_fault", "start": 60.0, "length": 20.0, "amplitude": -5e-3}
    offset = {"kind": "lateral_offset", "start": 100.0, "length": 60.0, "offset": 4e-3, "transition": 15.0}
    added = rough_track(p, seed=3, defects=[dip, fault, offset]) - irregularities(p, seed=3)
    assert (added[["p_m", "gauge_m"]] == 0).all(axis=None)
    left, right = (added["vertical_m"] + side * 0.75 * added["crosslevel_rad"] for side in (-1, 1))
    versine = np.interp(p, [40.0, 42.5, 45.0, 47.5, 50.0], [0.0, 4e-3, 8e-3, 4e-3, 0.0])
    assert left[::10].to_numpy() == pytest.approx(versine[::10], abs=1e-17)
    assert np.abs(right).max() < 1e-17
    known_at = {60.0: 0.0, 65.0: -2.5e-3, 70.0: -5e-3, 80.0: 0.0, 107.5: 2e-3, 115.0: 4e-3, 145.0: 4e-3, 160.0: 0.0}
    lateral = added["lateral_m"].to_numpy()
    assert np.interp([*known_at], p, lateral) == pytest.approx([*known_at.values()], abs=1e-15)
    bend = np.diff(lateral[p >= 90], 2) / 0.25**2
    assert np.abs(np.diff(bend)).max() < 0.2 * np.abs(bend).max()


def test_known_irregularities_are_shifted_and_scaled_exactly(rough):
    preview, columns = known(rough, amplitude_error=0.1, localisation_error_m=2.0), list(CHANNELS.values())
    assert np.allclose(preview[columns].iloc[4:], 1.1 * rough[columns].iloc[:-4], rtol=0, atol=1e-15)
    assert (preview[columns].iloc[:4] == 0).all(axis=None) and preview["p_m"].equals(rough["p_m"])
    unfaded = known(rough.assign(lateral_m=1e-3), localisation_error_m=-2.0)["lateral_m"]
    assert np.allclose(unfaded, np.where(rough["p_m"] <= 597.5, 1e-3, 0.0), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("share", "smoothing", "limit"), [(0.0, 10.0, 2e-3), (0.5, 5.0, 1.5e-3), (1.0, 20.0, 3e-3)])
def test_a_planned_line_keeps_the_limit_and_is_a_spline(rough, share, smoothing, limit):
    p, line = plan(rough, share, smoothing, limit)
    apart, play = np.abs(line[0] - rough["lateral_m"]), limit + rough["gauge_m"] / 2
    assert (apart <= play + 1e-12).all() and (line[:2, [0, -1]] == 0).all()
    assert (apart > play - 1e-8).any(), "the limit is not active, so the test shows nothing"
    assert np.allclose(route._cubic(line[:, :-1], np.diff(p)), line[:3, 1:], rtol=0, atol=1e-15)


@pytest.mark.parametrize("length", [20.0, 60.0])
def test_a_planned_line_keeps_a_share_of_a_wave_where_the_limit_is_far(length):
    p, number = np.arange(0.0, 600.0, 0.5), 2 * np.pi / length
    rails = pd.DataFrame({"p_m": p, "lateral_m": 1e-3 * np.sin(number * p) * np.sin(np.pi * p / 600.0), "gauge_m": 0.0})
    _, line = plan(rails, 0.8, 5.0, 5e-3)
    kept = np.ptp(line[0, 500:700]) / np.ptp(rails["lateral_m"][500:700])
    assert kept == pytest.approx(0.8 / (1 + (5.0 * number) ** 4), rel=1e-2)


def test_cells_meet_the_rows_without_kinks_and_the_shortest_wave_in_between():
    """A cubic has an error of h^4 k^4 / 384 = 0.3 % in a wave of 3 m, a spline through rows every 0.5 m 0.2 % more."""
    p = np.arange(0.0, 200.0, route.CELL)
    rough = irregularities(p, "en_B_300").assign(vertical_m=5e-3 * np.sin(2 * np.pi * p / 3.0))
    way = route.lay(load_track("T5"), irregularities=rough)
    cell, following = (dict(zip(route.COLUMNS, rows.T, strict=True)) for rows in (way.cells[:-1], way.cells[1:]))
    inside = (cell["p"] >= 0) & (cell["p"] < 200)
    for channel, column in CHANNELS.items():
        assert np.allclose(cell[channel][inside], rough[column], rtol=0, atol=1e-15)
        end = route.irregularity_in(cell, channel, following["p"])
        start = route.irregularity_in(following, channel, following["p"])
        assert np.allclose(end, start, rtol=0, atol=1e-14)
        assert (cell[channel][~inside] == 0).all() and (end[1][~inside] == 0).all()
    at = np.arange(20.0, 100.0, 0.07)
    cell = dict(zip(route.COLUMNS, way.rows_at(at).T, strict=True))
    found = route.irregularity_in(cell, "vertical", at)
    assert np.allclose(found[0] / 5e-3, np.sin(2 * np.pi * at / 3.0), rtol=0, atol=5e-3)
    assert np.allclose(found[1] / 5e-3 * 3 / (2 * np.pi), np.cos(2 * np.pi * at / 3.0), rtol=0, atol=0.02)


def test_ride_figures_on_irregular_rails_take_two_steps_a_millisecond():
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, end_m=40)
    usual = Experiment(scenario, "ndi", parameters={"pole": 20.0, "frequency": 20.0, "damping": 1.0})
    for rough, ride_too, substeps in (({}, True, 1), ({"seed": 1}, False, 1), ({"seed": 1}, True, 2)):
        experiment = replace(usual, irregular=rough, ride=ride_too)
        assert experiment.run().series.equals(replace(experiment, substeps=substeps).run().series)
        assert not experiment.run().series.equals(replace(experiment, substeps=3).run().series)
