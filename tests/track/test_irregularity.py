"""Irregularities: spectra, quality, rails, measured files, defects, what a controller knows and plans."""

import numpy as np
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline

from railrepro.evidence.runs.preview import known, planned_line
from railrepro.track.irregularity import (
    CHANNELS,
    D1,
    irregularities,
    irregularity_spectrum,
    track_quality,
)
from railrepro.track.rough import AlignmentFault, Dip, LateralOffset, rough_track

COLUMNS = ["p_m", *CHANNELS.values()]


@pytest.fixture(scope="module")
def rough():
    return irregularities(np.arange(0, 600, 0.5), "erri_low", seed=3)


def test_realisations_are_the_stated_sum_of_cosines():
    """By hand at places off the grid of the synthesis, far from the fade."""
    places, period = np.array([40.123, 517.25, 900.77]), 4096
    rows = irregularities(np.sort(np.append(np.arange(0, 1000, 1.0), places)), "erri_high", 5)
    wave = np.arange(41, 1366)  # 4096 / 100 = 40.96 lies in the interval of wave 41, 4096 / 3 = 1365.33 in that of 1365
    width = np.ones(wave.size)
    width[[0, -1]] = 0.54, 4096 / 3 - 1364.5
    for i, (channel, column) in enumerate(CHANNELS.items()):
        phase = np.random.default_rng((5, i)).uniform(0, 2 * np.pi, wave.size)
        density = 2 * np.pi * irregularity_spectrum("erri_high", channel, 2 * np.pi * wave / period)
        by_hand = np.cos(2 * np.pi * np.outer(places, wave / period) + phase) @ np.sqrt(2 * density * width / period)
        assert np.allclose(rows.set_index("p_m")[column][places], by_hand, rtol=0, atol=1e-7 * rows[column].std())


def test_long_tracks_do_not_repeat_and_keep_the_spectrum():
    """Sixty kilometres: no stretch resembles another one a shorter period away, density within 4 % of the formula."""
    rows = irregularities(np.arange(0, 60e3, 1.0), seed=4)
    for channel, column in CHANNELS.items():
        values = rows[column].to_numpy()[1000:-1000]
        frequency, density = signal.welch(values, fs=1.0, nperseg=4096)
        band = (frequency > 0.015) & (frequency < 0.2)
        expected = 2 * np.pi * irregularity_spectrum("erri_low", channel, 2 * np.pi * frequency[band])
        assert np.mean(density[band] / expected) == pytest.approx(1.0, abs=0.04), channel
        padded = np.fft.rfft(values, 2**17)
        correlation = np.fft.irfft(np.abs(padded) ** 2)[: values.size // 2] / np.sum(values**2)
        assert np.abs(correlation[500:]).max() < 0.1, channel


def test_irregularities_begin_and_end_on_the_ideal_track(rough):
    assert (rough.iloc[[0, -1]].drop(columns="p_m") == 0).all(axis=None)
    assert np.abs(rough["lateral_m"].iloc[:3]).max() < 1e-5 < rough["lateral_m"].abs().max()


@pytest.mark.parametrize("spectrum", ["en_A_300", "en_D_300", "en_C_120"])
def test_rails_have_the_standard_deviation_of_their_quality_class(spectrum):
    """Variance of a rail: that of the track centre and that of half the gauge or of half the cross level."""
    wavenumber = 2 * np.pi / np.linspace(D1[1], D1[0], 20_001)
    variance = {c: np.trapezoid(irregularity_spectrum(spectrum, c, wavenumber), wavenumber) for c in CHANNELS}
    level, alignment = track_quality()[spectrum]
    assert variance["vertical"] + 0.75**2 * variance["crosslevel"] == pytest.approx(level**2, rel=1e-4)
    assert variance["lateral"] + variance["gauge"] / 4 == pytest.approx(alignment**2, rel=1e-4)


def test_dip_of_one_rail_leaves_the_other():
    p = np.arange(0, 100, 0.5)
    left = Dip(start=40.0, length=10.0, depth=8e-3, rail="le").at(p)
    depth = left["vertical_m"] - 0.75 * left["crosslevel_rad"]
    assert depth.max() == pytest.approx(8e-3)
    assert depth[p == 45.0].item() == pytest.approx(8e-3) and depth[p == 42.5].item() == pytest.approx(4e-3)
    assert (depth[(p <= 40) | (p >= 50)] == 0).all()
    assert np.abs(left["vertical_m"] + 0.75 * left["crosslevel_rad"]).max() < 1e-17
    assert (left[["lateral_m", "gauge_m"]] == 0).all(axis=None)
    both = Dip(40.0, 10.0, 8e-3).at(p)
    assert both["vertical_m"].max() == pytest.approx(8e-3)
    assert (both["crosslevel_rad"] == 0).all()


def test_alignment_fault_and_lateral_offset_move_both_rails():
    p = np.arange(0, 200, 0.25)
    fault = AlignmentFault(50.0, 20.0, -5e-3).at(p)
    assert fault["lateral_m"].min() == fault.loc[p == 60.0, "lateral_m"].item() == -5e-3
    offset = LateralOffset(100.0, 60.0, 4e-3, transition=15.0).at(p)
    assert np.allclose(offset.loc[(p >= 115) & (p <= 145), "lateral_m"], 4e-3)
    assert offset.loc[p == 107.5, "lateral_m"].item() == pytest.approx(2e-3)
    assert (offset.loc[(p <= 100) | (p >= 160), "lateral_m"] == 0).all()
    bend = np.diff(offset["lateral_m"], 2) / 0.25**2
    assert np.abs(np.diff(bend)).max() < 0.2 * np.abs(bend).max()
    for frame in (fault, offset):
        assert list(frame) == COLUMNS
        assert (frame[["vertical_m", "crosslevel_rad", "gauge_m"]] == 0).all(axis=None)


def test_known_irregularities_are_shifted_and_scaled_exactly(rough):
    believed = known(rough, amplitude_error=0.1, localisation_error_m=2.0)
    assert list(believed) == COLUMNS
    columns = list(CHANNELS.values())
    assert np.allclose(believed[columns].iloc[4:], 1.1 * rough[columns].iloc[:-4], rtol=0, atol=1e-15)
    assert (believed[columns].iloc[:4] == 0).all(axis=None)
    assert np.allclose(known(rough)[columns], rough[columns], rtol=0, atol=1e-18)
    unfaded = known(rough.assign(lateral_m=1e-3), localisation_error_m=-2.0)["lateral_m"]
    assert np.allclose(unfaded, np.where(rough["p_m"] <= 597.5, 1e-3, 0.0), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("share", "smoothing", "limit"), [(0.0, 10.0, 2e-3), (0.5, 5.0, 1.5e-3), (1.0, 20.0, 3e-3)])
def test_planned_line_keeps_the_limit(rough, share, smoothing, limit):
    line = planned_line(rough, share, smoothing, limit)
    play = limit + rough["gauge_m"] / 2
    apart = np.abs(line[0] - rough["lateral_m"])
    assert (apart <= play + 1e-12).all()
    assert (apart > play - 1e-8).any(), "the limit is not at work, so the test shows nothing"
    assert (line[:2, [0, -1]] == 0).all()


def test_planned_line_is_a_spline_whose_derivatives_belong_together(rough):
    p = rough["p_m"].to_numpy()
    line = planned_line(rough, 0.5, 5.0, 2e-3)
    assert line.shape == (4, p.size)
    d = np.diff(p)
    value, slope, bend, jerk = line[:, :-1]
    assert np.allclose(value + d * (slope + d * (bend / 2 + d * jerk / 6)), line[0, 1:], rtol=0, atol=1e-15)
    assert np.allclose(slope + d * (bend + d * jerk / 2), line[1, 1:], rtol=0, atol=1e-15)
    assert np.allclose(bend + d * jerk, line[2, 1:], rtol=0, atol=1e-15)


def test_planned_line_bends_before_a_fault_that_it_foresees():
    """Smoother than the rails that it may not leave, and off the ideal line ahead of the fault."""
    p = np.arange(0, 200, 0.5)
    fault = AlignmentFault(90.0, 20.0, 8e-3).at(p)
    line = planned_line(fault, 0.0, 10.0, 4e-3)
    rail = CubicSpline(p, fault["lateral_m"])(p, 2)
    assert line[0, p == 100.0].item() == pytest.approx(4e-3, rel=1e-3)
    assert line[0, p == 90.0].item() > 0.2e-3
    assert np.abs(line[2]).max() < 0.5 * np.abs(rail).max()


def test_defects_are_added_to_random_irregularities():
    p, fault = np.arange(0.0, 100.0), {"kind": "alignment_fault", "start": 40.0, "length": 20.0, "amplitude": 4e-3}
    found, alone = rough_track(p, seed=3, defects=[fault]), irregularities(p, seed=3)
    assert found["lateral_m"].iloc[50] == pytest.approx(alone["lateral_m"].iloc[50] + 4e-3)
    assert np.array_equal(found["p_m"], p) and found["vertical_m"].equals(alone["vertical_m"])
