"""Irregularities: spectra, quality, rails, measured files, defects, what a controller knows and plans."""

import numpy as np
import pandas as pd
import pytest
from scipy import signal
from scipy.interpolate import CubicSpline

from railrepro.evidence.runs.preview import known, planned_line
from railrepro.track.irregularity import (
    CHANNELS,
    D1,
    irregularities,
    irregularity_spectrum,
    rails,
    smooth_step,
    track_centre,
    track_quality,
)
from railrepro.track.rough import AlignmentFault, Dip, LateralOffset, read_irregularities, rough_track

COLUMNS = ["p_m", *CHANNELS.values()]


@pytest.fixture(scope="module")
def long_stretch():
    """A period of the sum of waves, so that a standard deviation is nearly free of chance."""
    return np.arange(0, 4096, 1.0)


@pytest.fixture(scope="module")
def rough():
    return irregularities(np.arange(0, 600, 0.5), "erri_low", seed=3)


def test_realisations_keep_the_numbers_of_the_published_runs():
    """The tolerance leaves room for another mathematical library only; the products depend on these numbers."""
    rows = irregularities(np.arange(0, 1000, 0.25))
    low = rows[["lateral_m", "vertical_m", "crosslevel_rad"]]
    assert np.allclose(low.std(), [1.5675924745273207e-3, 2.385275784103337e-3, 1.1751512189185148e-3], rtol=1e-9)
    high = irregularities(np.arange(0, 1000, 0.25), "erri_high", seed=7)[low.columns]
    assert np.allclose(high.std(), [3.1626830533657336e-3, 3.979427663119038e-3, 1.9353076019020087e-3], rtol=1e-9)


@pytest.mark.parametrize("spectrum", ["erri_low", "erri_high", "en_B_300"])
def test_irregularities_have_the_spectrum_they_claim(long_stretch, spectrum):
    rows = irregularities(long_stretch, spectrum, seed=4, longest=100.0)
    for channel, column in CHANNELS.items():
        frequency, density = signal.welch(rows[column].to_numpy(), fs=1.0, nperseg=1024)
        band = (frequency > 0.03) & (frequency < 0.2)
        expected = 2 * np.pi * irregularity_spectrum(spectrum, channel, 2 * np.pi * frequency[band])
        assert np.mean(density[band] / expected) == pytest.approx(1.0, abs=0.06), channel


def test_realisations_are_the_stated_sum_of_cosines():
    """By hand at places off the grid of the synthesis, far from the fade."""
    places, longest, shortest, period = np.array([40.123, 517.25, 900.77]), 80.0, 5.0, 4096
    rows = irregularities(np.sort(np.append(np.arange(0, 1000, 1.0), places)), "erri_high", 5, shortest, longest)
    wave = np.arange(51, 820)  # 4096 / 80 = 51.2 lies inside the interval of wave 51, 4096 / 5 = 819.2 in that of 819
    width = np.ones(wave.size)
    width[[0, -1]] = 0.3, 0.7
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


def test_same_seed_same_numbers_and_independent_channels(long_stretch):
    rows = irregularities(long_stretch, seed=4)
    assert rows.equals(irregularities(long_stretch, seed=4))
    assert not rows["lateral_m"].equals(irregularities(long_stretch, seed=5)["lateral_m"])
    correlation = rows[list(CHANNELS.values())].corr().to_numpy() - np.eye(4)
    assert np.abs(correlation).max() < 0.3


def test_irregularities_begin_and_end_on_the_ideal_track(rough):
    assert (rough.iloc[[0, -1]].drop(columns="p_m") == 0).all(axis=None)
    assert np.abs(rough["lateral_m"].iloc[:3]).max() < 1e-5 < rough["lateral_m"].abs().max()


def standard_deviation(frame):
    """Standard deviation of each channel in waves of 3 to 25 m, by a Fourier transform."""
    spacing = frame["p_m"].iloc[1] - frame["p_m"].iloc[0]
    values = frame.drop(columns="p_m")
    wavenumber = np.fft.rfftfreq(len(values), spacing)
    inside = (wavenumber > 1 / D1[1]) & (wavenumber < 1 / D1[0])
    power = 2 * np.abs(np.fft.rfft(values, axis=0)[inside]) ** 2 / len(values) ** 2
    return pd.Series(np.sqrt(power.sum(axis=0)), values.columns)


@pytest.mark.parametrize(("spectrum", "seed"), [("en_A_300", 1), ("en_D_300", 2), ("en_C_120", 3)])
def test_rails_have_the_standard_deviation_of_their_quality_class(long_stretch, spectrum, seed):
    """Within 3 %: 1 % between filter and ideal band, the rest is chance; both rails in the root mean square, in which
    the chance correlation of level and cross level, which makes one rail 2 % worse and the other better, falls out."""
    measured = standard_deviation(rails(irregularities(long_stretch, spectrum, seed=seed)))
    level, alignment = track_quality()[spectrum]
    assert np.hypot(*measured[["vertical_le_m", "vertical_ri_m"]]) / np.sqrt(2) == pytest.approx(level, rel=0.03)
    assert np.hypot(*measured[["lateral_le_m", "lateral_ri_m"]]) / np.sqrt(2) == pytest.approx(alignment, rel=0.03)


def test_rails_and_track_centre_are_inverse(rough):
    assert np.allclose(track_centre(rails(rough)), rough, rtol=0, atol=1e-15)


def test_signs_of_the_rails():
    """Wider gauge moves the right rail right and the left one left; positive cross level lowers the right rail."""
    frame = pd.DataFrame([[0.0, 1e-3, 2e-3, 4e-3, 6e-3]], columns=COLUMNS)
    offsets = rails(frame).iloc[0]
    assert offsets["lateral_ri_m"] == pytest.approx(4e-3)
    assert offsets["lateral_le_m"] == pytest.approx(-2e-3)
    assert offsets["vertical_ri_m"] == pytest.approx(5e-3)
    assert offsets["vertical_le_m"] == pytest.approx(-1e-3)


def test_measured_irregularities_are_read_as_written(tmp_path, rough):
    rough.to_csv(tmp_path / "measured.csv", index=False, float_format="%.17g")
    assert read_irregularities(tmp_path / "measured.csv", length=590.0).equals(rough)


def test_dip_of_one_rail_leaves_the_other():
    p = np.arange(0, 100, 0.5)
    offsets = rails(Dip(start=40.0, length=10.0, depth=8e-3, rail="le").at(p))
    assert offsets["vertical_le_m"].max() == pytest.approx(8e-3)
    assert offsets.loc[p == 45.0, "vertical_le_m"].item() == pytest.approx(8e-3)
    assert offsets.loc[p == 42.5, "vertical_le_m"].item() == pytest.approx(4e-3)
    assert (offsets.loc[(p <= 40) | (p >= 50), "vertical_le_m"] == 0).all()
    assert np.abs(offsets.drop(columns=["p_m", "vertical_le_m"])).to_numpy().max() < 1e-17
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


def test_measured_irregularities_begin_at_a_chainage(tmp_path):
    rows = pd.DataFrame({"p_m": 12000.0 + np.arange(101), "lateral_m": 1e-3 * np.sin(np.arange(101) / 5)})
    rows = rows.assign(vertical_m=0.0, crosslevel_rad=0.0, gauge_m=0.0)
    rows.to_csv(tmp_path / "mine.csv", index=False)
    found = rough_track(np.arange(0.0, 50.0), file=str(tmp_path / "mine.csv"), chainage=12040.0)
    assert found["lateral_m"].iloc[25] == pytest.approx(
        rows["lateral_m"].iloc[65] * smooth_step(np.array(24 / 30)).item()
    )
