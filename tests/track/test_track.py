"""Tracks: Table I, exact interpolation, frames, own tracks."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from railrepro.track import route
from railrepro.track.alignment import alignments, superelevation
from railrepro.track.table import Track, build_table, load_track, read_table, write_table

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


@pytest.mark.parametrize(("name", "printed"), [("T1", 0.108), ("T2", 0.168), ("T3", 0.151), ("T4", 0.123)])
def test_superelevations_of_table_one(name, printed):
    angle = alignments()[name].segments[-1].phi[0]
    assert round(superelevation(angle), 3) == printed


def test_rails_of_an_own_track_differ_in_height_by_the_stated_superelevation(hill):
    """The rails are 1.5 m apart along the sleeper; in a left-hand curve the left one is lower."""
    _, _, roll, *_ = hill.interpolate(200.0)[:, 0]
    sleeper = Rotation.from_euler("X", roll).apply([0.0, 1.5, 0.0])  # from left to right, z down
    assert sleeper[2] == pytest.approx(-0.10, rel=1e-9)


def test_turn_rate_of_the_track_frame_matches_differentiated_rotations(hill):
    """Curvature, cant ramp and gradient at once: R^T R' must be the plant's turn rate per metre."""
    h = 1e-5
    for p in (60.0, 90.2, 120.7):
        psi, kappa, phi, dphi, eps, deps = hill.interpolate(p)[:, 0]

        def rotation(s):
            a, _, c, _, e, _ = hill.interpolate(s)[:, 0]
            return Rotation.from_euler("ZYX", [a, e, c]).as_matrix()

        spin = rotation(p).T @ (rotation(p + h) - rotation(p - h)) / (2 * h)
        expected = [
            dphi - np.sin(eps) * kappa,
            np.cos(phi) * deps + np.sin(phi) * np.cos(eps) * kappa,
            -np.sin(phi) * deps + np.cos(phi) * np.cos(eps) * kappa,
        ]
        assert np.allclose([spin[2, 1], spin[0, 2], spin[1, 0]], expected, atol=1e-8)


def test_position_is_the_integral_of_the_tangent(hill):
    p = np.linspace(1.0, 229.0, 301)
    h = 1e-3
    psi, _, _, _, eps, _ = hill.interpolate(p)
    tangent = np.array([np.cos(eps) * np.cos(psi), np.cos(eps) * np.sin(psi), -np.sin(eps)])
    assert np.allclose((hill.position(p + h) - hill.position(p - h)) / (2 * h), tangent, atol=1e-8)


def test_a_track_of_points_is_that_of_its_segments(tmp_path):
    """Against 10^5 steps of the integrals of curvature and heading, which begin at the first coordinate."""
    phi = -np.arcsin(0.08)
    rows = [(0, 0, 0), (100, 0, 0), (300, -1 / 1500, phi), (2800, -1 / 1500, phi), (3000, 0, 0), (3100, 0, 0)]
    frame = pd.DataFrame(rows, columns=["p_m", "dpsi_dp_1pm", "phi_rad"])
    frame.assign(p_m=12000 + frame["p_m"], eps_rad=0.01).to_csv(tmp_path / "mine.csv", index=False)
    table = load_track(tmp_path / "mine.csv").table
    s = np.linspace(0.0, 3100.0, 100_001)
    kappa = np.interp(s, frame["p_m"], frame["dpsi_dp_1pm"])
    heading = np.concatenate([[0.0], np.cumsum((kappa[1:] + kappa[:-1]) / 2 * np.diff(s))])
    ends = [np.cos(0.01) * np.trapezoid(turned, s) for turned in (np.cos(heading), np.sin(heading))]
    assert table["psi_rad"].iloc[-1] == pytest.approx(-2700 / 1500) == pytest.approx(heading[-1])
    assert table[["x_m", "y_m"]].iloc[-1].tolist() == pytest.approx(ends, abs=1e-5)
    assert table["z_m"].iloc[-1] == pytest.approx(-3100 * np.sin(0.01), rel=1e-12)
    assert 1.5 * np.sin(table["phi_rad"].min()) == pytest.approx(-0.12)
    assert table["dphi_dp_1pm"].abs().max() == pytest.approx(np.arcsin(0.08) / 200)


def test_a_track_begins_with_the_heading_of_its_first_row(tmp_path):
    table = load_track("T1").table
    write_table(table.assign(psi_rad=table["psi_rad"] + 0.4), tmp_path / "turned.csv")
    turned = read_table(tmp_path / "turned.csv")
    assert np.allclose(turned["psi_rad"], table["psi_rad"] + 0.4, rtol=0, atol=1e-9)
    others = table.columns.drop(["psi_rad", "x_m", "y_m"])
    assert np.allclose(turned[others], table[others], rtol=0, atol=1e-9)
    assert np.hypot(turned["x_m"], turned["y_m"]).iloc[-1] == pytest.approx(np.hypot(*table[["x_m", "y_m"]].iloc[-1]))


def test_a_set_point_comes_and_goes_over_its_fade_without_a_jump_of_three_derivatives():
    way = route.lay(load_track("T5"), route.sine(2e-3, 150.0, start=100.0, end=480.0, fade=40.0))
    shape = way.cells[:, [route.INDEX[name] for name in ("y_ref", "dy_ref", "ddy_ref", "dddy_ref")]]
    place = way.cells[:, route.INDEX["p"]]
    assert np.abs(shape[(place <= 100) | (place >= 480)]).max() < 1e-15
    for lower, higher in zip(shape.T[:-1], shape.T[1:], strict=True):
        assert np.abs(np.diff(lower)).max() < 1.1 * route.CELL * np.abs(higher).max()
    inside = (place >= 140) & (place <= 440)
    assert shape[inside, 0] == pytest.approx(2e-3 * np.sin(2 * np.pi * (place[inside] - 100) / 150), abs=1e-15)
    assert way.reference_at(120.0)[0, 0] == pytest.approx(1e-3 * np.sin(2 * np.pi * 20 / 150))
