"""Tracks: interpolation, tracks from TOML and CSV, set points."""

import re
import warnings

import numpy as np
import pandas as pd
import pytest

from railrepro import paths
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import route
from railrepro.track.alignment import alignments
from railrepro.track.table import Track, build_table, load_track

TRACKS = """
hill.segments = [{ length_m = 50 },
  { length_m = 80, radius_m = -600, superelevation_m = -0.10, inclination_rad = 0.02 }, { length_m = 100 }]
[slow]
design_speed_kmh = 36
unbalanced_acceleration_mps2 = 0.5
radius_m = -1000
straight_m = 25
clothoid_m = 40
arc_m = 100
"""


def test_a_track_has_the_stated_cant_and_its_rates_are_the_slopes_of_its_angles(tmp_path):
    """The rails are 1.5 m apart along the sleeper; in a left-hand curve the left one is lower, with a negative roll."""
    (tmp_path / "tracks.toml").write_text(TRACKS)
    hill, slow = (Track(name, build_table(one)) for name, one in alignments(tmp_path / "tracks.toml").items())
    _, _, roll, *_ = hill.interpolate(200.0)[:, 0]
    assert 1.5 * np.sin(roll) == pytest.approx(-0.10, rel=1e-9)
    p, h = np.linspace(1.0, 229.0, 301), 1e-5
    slopes = (hill.interpolate(p + h) - hill.interpolate(p - h)) / (2 * h)
    assert np.allclose(hill.interpolate(p)[1::2], slopes[::2], rtol=0, atol=1e-8)
    _, curvature, roll, *_ = slow.interpolate(160.0)[:, 0]
    assert 10.0**2 * curvature - 9.81 * np.sin(roll) == pytest.approx(-0.5)  # unbalanced acceleration in a left curve


def test_a_track_of_points_is_that_of_its_segments(tmp_path):
    """Against integrals of curvature and heading in 10^5 steps."""
    phi = -np.arcsin(0.08)
    rows = [(0, 0, 0), (100, 0, 0), (300, -1 / 1500, phi), (2800, -1 / 1500, phi), (3000, 0, 0), (3100, 0, 0)]
    frame = pd.DataFrame(rows, columns=["p_m", "dpsi_dp_1pm", "phi_rad"])
    turned = np.cumsum(np.diff(frame["p_m"], prepend=0) * frame["dpsi_dp_1pm"].rolling(2).mean().fillna(0))
    columns = {"p_m": 12000 + frame["p_m"], "eps_rad": 0.01, "psi_rad": np.remainder(0.4 + turned, 2 * np.pi)}
    frame.assign(**columns).to_csv(tmp_path / "mine.csv", index=False)
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
    place, h = np.array([120.2, 205.3, 333.1]), 1e-3
    (y, *_), after, before = (way.reference_at(place + step) for step in (0.0, h, -h))
    numeric = (after[0] - before[0]) / (2 * h), (after[0] - 2 * y + before[0]) / h**2
    assert np.allclose(way.reference_at(place)[1:], numeric, rtol=1e-4, atol=0)


@pytest.fixture
def own(tmp_path):
    """Function that loads the track of a CSV with a given text."""

    def read(text):
        (tmp_path / "own.csv").write_text(text)
        return load_track(tmp_path / "own.csv")

    return read


@pytest.mark.parametrize("begin", [30.0, 30.25, 30.499])
def test_a_step_of_curvature_anywhere_gives_a_heading_without_a_jump(own, begin):
    """A turnout: the heading in the table and in the cells is the integral of the curvature."""
    track = own(f"p_m,dpsi_dp_1pm\n0,0\n{begin},0\n{begin + 1e-3},0.00526\n60.2,0.00526\n61.7,0\n100.3,0\n")
    assert track.length == 100.3
    at, step = np.linspace(0.0, 100.0, 10_001, retstep=True)
    last = np.clip((at - 60.2) / 1.5, 0, 1)
    heading = 0.00526 * (np.clip(at, begin + 5e-4, 60.2) - begin - 5e-4 + 1.5 * (last - last**2 / 2))
    assert np.allclose(track.interpolate(at)[0], heading, rtol=0, atol=2e-6)
    psi, kappa, *_ = route.lay(track).track_at(at)
    assert np.allclose(psi, heading, rtol=0, atol=0.00526 * route.CELL / 4)
    assert np.allclose(np.diff(psi), kappa[:-1] * step, rtol=0, atol=0.00526 * step**2)
    assert psi[-1] == pytest.approx(heading[-1], abs=1e-9)
    assert kappa.min() > -1e-12 and kappa.max() < 0.00526 + 1e-12


def test_cant_ramps_between_the_ends_of_cells_have_no_jump(own):
    way = route.lay(own("p_m,radius_m,cant_mm\n0,inf,0\n30.2,inf,0\n70.3,-800,-80\n100,-800,-80\n"))
    cells = dict(zip(route.COLUMNS, way.cells.T, strict=True))
    for name in ("phi", "eps"):
        assert (cells[name] + route.CELL * cells["d" + name])[:-1] == pytest.approx(cells[name][1:], abs=1e-15)


def test_the_chainage_of_a_file_is_kept_for_output(own):
    text = "p_m,radius_m\n{},inf\n{},600\n{},600\n"
    first, second = own(text.format(0, 100, 300)), own(text.format(245_300, 245_400, 245_600))
    assert (first.chainage, second.chainage) == (0.0, 245_300.0) and first.table.equals(second.table)


def test_radius_and_cant_in_the_units_of_the_field(own):
    """The file in the guide, and the same track in SI."""
    (text,) = re.findall(r"```text\n(.*?)```", (paths.NOTEBOOKS / "book/adding.md").read_text(), re.DOTALL)
    field = own(text).table
    cant = np.arcsin(0.1 / 1.5)
    si = own(f"p_m,phi_rad,dpsi_dp_1pm\n0,0,0\n100,0,0\n180,{cant},{1 / 600}\n400,{cant},{1 / 600}").table
    assert np.allclose(field, si, rtol=1e-15, atol=0) and field["y_m"].iloc[-1] > 50
    again, made = (load_track(name).table for name in (paths.DATA / "tracks/T2.csv", "T2"))
    assert np.allclose(again, made, rtol=1e-12, atol=1e-15)


BUILT = {
    "turnouts": "p_m,radius_m / 0,inf / 30,inf / 30.001,190 / 57,190 / 57.001,inf / 63,inf / 63.001,-190 / 90,-190",
    "reverse curve": "p_m,dpsi_dp_1pm / 0,.00526 / 9,.00526 / 9.001,-.00526 / 40,-.00526",
    "hump": "p_m,eps_rad,dpsi_dp_1pm / 0,.055,0 / 50,.055,0 / 67,-.065,0 / 90,-.065,0 / 90.001,-.02,.00667 / 160,0,0",
    "surveyed": "# 2026 / p_m , radius_m, x_m, y_m /  / 12000,800, 5e6, 300 / 12080, 800, 5000079.9,304.0",
    "smoothed": "p_m,dpsi_dp_1pm,phi_rad,dphi_dp_1pm / 0,0,0,0 / 50,0,0,.00025 / 90,1e-3,.02,.0005 / 99,1e-3,.02,0",
}


@pytest.mark.parametrize("text", BUILT.values(), ids=BUILT)
def test_tracks_that_railways_build_are_accepted_without_a_warning(own, text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert own(text.replace(" / ", "\n")).length >= 40


def test_cant_of_the_wrong_side_and_too_fast_a_curve_are_warned_of(own, tmp_path):
    curve = "p_m,radius_m,cant_mm\n0,inf,0\n30,inf,0\n90,600,{0}\n300,600,{0}"
    with pytest.warns(UserWarning, match="own: the cant lowers the outer rail at p = "):
        own(curve.format(-100))
    scenario = load_scenario("curve_entry_T3").but(track=str(tmp_path / "own.csv"), end_m=200.0, speed_kmh=120.0)
    own(curve.format(100))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenario.route()
    with pytest.warns(UserWarning, match="2.6 m/s2 remain unbalanced at p = 90 m and 160 km/h"):
        scenario.but(speed_kmh=160.0).route()
