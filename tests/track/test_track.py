"""Tracks: exact interpolation, own tracks, set points along them."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from railrepro.simulation.scenarios import load_scenario
from railrepro.track import route
from railrepro.track.alignment import alignments
from railrepro.track.table import Track, build_table, load_track

OWN = """
[hill]
segments = [
  { length_m = 50 },
  { length_m = 80, radius_m = -600, superelevation_m = -0.10, inclination_rad = 0.02 },
  { length_m = 100 },
]
"""


@pytest.fixture
def hill(tmp_path):
    file = tmp_path / "tracks.toml"
    file.write_text(OWN)
    return Track("hill", build_table(alignments(file)["hill"]))


def test_rails_of_an_own_track_differ_in_height_by_the_stated_superelevation(hill):
    """The rails are 1.5 m apart along the sleeper; in a left-hand curve the left one is lower."""
    _, _, roll, *_ = hill.interpolate(200.0)[:, 0]
    sleeper = Rotation.from_euler("X", roll).apply([0.0, 1.5, 0.0])  # from left to right, z down
    assert sleeper[2] == pytest.approx(-0.10, rel=1e-9)


def test_rates_of_the_track_are_the_slopes_of_its_angles(hill):
    p, h = np.linspace(1.0, 229.0, 301), 1e-5
    slopes = (hill.interpolate(p + h) - hill.interpolate(p - h)) / (2 * h)
    assert np.allclose(hill.interpolate(p)[1::2], slopes[::2], rtol=0, atol=1e-8)


def test_a_track_of_points_is_that_of_its_segments(tmp_path):
    """Against 10^5 steps of the integrals of curvature and heading, from the first coordinate and its heading on."""
    phi = -np.arcsin(0.08)
    rows = [(0, 0, 0), (100, 0, 0), (300, -1 / 1500, phi), (2800, -1 / 1500, phi), (3000, 0, 0), (3100, 0, 0)]
    frame = pd.DataFrame(rows, columns=["p_m", "dpsi_dp_1pm", "phi_rad"])
    frame.assign(p_m=12000 + frame["p_m"], eps_rad=0.01, psi_rad=0.4).to_csv(tmp_path / "mine.csv", index=False)
    table = load_track(tmp_path / "mine.csv").table
    s = np.linspace(0.0, 3100.0, 100_001)
    kappa = np.interp(s, frame["p_m"], frame["dpsi_dp_1pm"])
    heading = 0.4 + np.append(0.0, np.cumsum((kappa[1:] + kappa[:-1]) / 2 * np.diff(s)))
    ends = [np.cos(0.01) * np.trapezoid(turned, s) for turned in (np.cos(heading), np.sin(heading))]
    assert table["psi_rad"].iloc[-1] == pytest.approx(0.4 - 2700 / 1500) == pytest.approx(heading[-1])
    assert table[["x_m", "y_m"]].iloc[-1].tolist() == pytest.approx(ends, abs=1e-5)
    assert table["z_m"].iloc[-1] == pytest.approx(-3100 * np.sin(0.01), rel=1e-12)
    assert 1.5 * np.sin(table["phi_rad"].min()) == pytest.approx(-0.12)
    assert table["dphi_dp_1pm"].abs().max() == pytest.approx(np.arcsin(0.08) / 200)


def test_a_sweep_goes_from_period_to_period_and_fades_without_a_jump_of_three_derivatives():
    sweep = {"kind": "sweep", "amplitude_mm": 2.0, "period_start_m": 150.0, "period_end_m": 60.0}
    sweep |= {"start_m": 100.0, "end_m": 480.0, "fade_m": 40.0}
    way = load_scenario("sine_tracking").but(set_point=sweep).route()
    shape = way.cells[:, [route.INDEX[name] for name in ("y_ref", "dy_ref", "ddy_ref", "dddy_ref")]]
    place = way.cells[:, route.INDEX["p"]]
    assert np.abs(shape[(place <= 100) | (place >= 480)]).max() < 1e-15
    for lower, higher in zip(shape.T[:-1], shape.T[1:], strict=True):
        assert np.abs(np.diff(lower)).max() < 1.1 * route.CELL * np.abs(higher).max()
    inside = (place >= 140) & (place <= 440)
    turns = (place[inside] - 100) / 150 + (1 / 60 - 1 / 150) * (place[inside] - 100) ** 2 / (2 * 380)
    assert shape[inside, 0] == pytest.approx(2e-3 * np.sin(2 * np.pi * turns), abs=1e-15)
    assert way.reference_at(120.0)[0, 0] == pytest.approx(1e-3 * np.sin(2 * np.pi * (20 / 150 + 0.01 * 20**2 / 760)))
