"""A film shows the runs and nothing else: its numbers, friction bound, page and movie; knobs and their sliders."""

import json
import re

import numpy as np
import pandas as pd
import pytest
from matplotlib import animation

from railrepro import __main__ as command
from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.errors import InputError
from railrepro.evidence.chain import weblinks
from railrepro.evidence.film import knobs, movie, page, scene
from railrepro.evidence.film.knobs import Parameters
from railrepro.evidence.runs.tuning import tuned
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle


class HandsOff:
    """No differential torque, ever."""

    memory = ()

    def gains(self):
        return {}

    def torque(self, gear, track_ahead, memory, gain, model):
        return 0.0, {}


@pytest.fixture(scope="module")
def driven():
    """Loss of adhesion up to where the wheels slide, under two inversions."""
    scenario = load_scenario("adhesion_loss").but(end_m=380.0)
    return scenario, {name: simulate.run(scenario, tuned(name)) for name in ("ndi", "ndi_feedforward")}


@pytest.fixture(scope="module")
def film(driven):
    scenario, runs = driven
    return scene.compose(scenario, runs, load_vehicle(), 50, "a test")


def shown(text):
    """What a page draws."""
    return json.loads(re.search(r'<script type="application/json" id="film">(.*?)</script>', text, re.S).group(1))


def test_the_numbers_of_the_page_are_those_of_the_run(driven, film):
    content, run = shown(page.html(film)), driven[1]["ndi_feedforward"]
    frame = 17
    row = run.series.iloc[round(1e3 * content["t_s"][frame])]
    drawn = {name: column[frame] for name, column in content["shots"][1]["columns"].items()}
    assert content["t_s"][frame] == pytest.approx(row["t_s"])
    assert drawn["front.y_mm"] == pytest.approx(1e3 * row["front.y"], abs=6e-4)
    assert drawn["rear.psi_mrad"] == pytest.approx(1e3 * row["rear.psi_TrAx"], abs=6e-4)
    assert drawn["rear_ri.Fx_kN"] == pytest.approx(1e-3 * row["rear_ri.Fx"], abs=6e-4)
    assert drawn["front_le.Fy_kN"] == pytest.approx(1e-3 * row["front_le.Fy"], abs=6e-4)
    assert drawn["front_le.tau_Nm"] == pytest.approx(row["front_le.tau"], abs=0.6)
    assert drawn["v_kmh"] == pytest.approx(3.6 * row["front.v"], abs=0.06)


def test_set_point_and_rails_of_the_way_are_those_of_the_scenario():
    scenario = load_scenario("adhesion_loss").but(end_m=60.0, poor_share_left=[[0, 0], [40, 1]])
    way = scene._way(scenario.route()).set_index("p_m")
    assert way.loc[30.0, ["poor_le", "poor_ri"]].tolist() == pytest.approx([0.75, 1.0])
    fade = scenario.route().reference_at(30.0)[0][0]
    assert way.loc[30.0, "y_ref_mm"] == pytest.approx(1e3 * fade) and abs(fade) > 1e-4


def test_a_creep_force_never_leaves_its_circle(film):
    for shot in film.shots:
        for wheel in scene.WHEELS:
            force = np.hypot(shot.table[f"{wheel}.Fx_kN"], shot.table[f"{wheel}.Fy_kN"])
            assert (force <= 1.0005 * shot.table[f"{wheel}.bound_kN"]).all()


def test_a_spinning_wheel_is_at_its_bound_on_each_rail():
    vehicle = load_vehicle(**{"drive.torque_limit": 2e4})
    scenario = load_scenario("sine_tracking").but(poor_share_left=[[0, 1]], poor_share_right=[[0, 0.9]], speed_kmh=100)
    route = scenario.route()
    car, rows = SteppedCar(route, scenario.speed, vehicle), []
    for _ in range(10):
        car.step([2e4] * 4, exchanges=20)
        rows.append(car.outputs)
    spinning = pd.DataFrame(rows[5:])
    for wheel in scene.WHEELS:
        assert (spinning[f"{wheel}.sx"] < -0.1).all()
        bound = scene.friction_bound(spinning, wheel, scenario, route, vehicle)
        used = np.hypot(spinning[f"{wheel}.Fx"], spinning[f"{wheel}.Fy"]) / bound
        assert used.between(0.95, 1.0005).all()


def test_the_adhesion_gauge_is_full_where_the_law_seeks_the_maximum(film):
    sought = [shot.table[[f"{wheel}.adhesion_percent" for wheel in scene.WHEELS]].to_numpy() for shot in film.shots]
    assert all(90 < used.max() < 103 for used in sought) and sought[0][0].max() < 20


def test_the_page_asks_no_network_for_anything(film, tmp_path):
    text = page.html(film)
    (tmp_path / "film.html").write_text(text)
    assert weblinks.faults(tmp_path) == []
    assert not re.search(r"https?:|//[a-z]|@import|\bsrc=|\bhref=|fetch\(|XMLHttp|WebSocket", text)
    assert "{{" not in text and "</script" not in page.frame(film)


def test_a_run_that_ends_early_stays_where_it_ended():
    scenario = load_scenario("curve_entry_T3").but(end_m=150.0)
    cone = load_vehicle(**{"contact.profile": "cone"})  # no flange holds it
    runs = {"ndi": simulate.run(scenario, tuned("ndi")), "nmpc": simulate.run(scenario, HandsOff(), vehicle=cone)}
    found = scene.compose(scenario, runs, load_vehicle(), 40, "one derails")
    rows = [len(shot.table) for shot in found.shots]
    assert runs["nmpc"].failed and rows[1] < rows[0] == found.times.size and found.still() < rows[1]
    assert "derailed" in found.shots[1].summary and found.scales["y_mm"] == scene.WIDEST
    assert len(shown(page.html(found))["shots"][1]["columns"]["front.y_mm"]) == rows[1]


def test_a_file_is_filmed_beside_a_registered_controller(tmp_path, monkeypatch, capsys):
    short = load_scenario("curve_entry_T3").but(end_m=30.0)
    monkeypatch.setattr(scene, "load_scenario", lambda _: short)
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    mine = str(paths.ROOT / "examples/only_y.py")
    assert command.main(["film", "curve_entry_T3", "ndi", mine, "--no-movie"]) == 0
    shots = shown((tmp_path / "film/curve_entry_T3-ndi-only_y.py.html").read_text())["shots"]
    assert [shot["label"] for shot in shots] == ["NDI", "only_y.py"] and shots[0]["color"] != shots[1]["color"]
    (tmp_path / "mine.py").write_text("class Mine:\n    period = 0.005\n    def plan(self, x): return 0.0\n")
    assert command.main(["film", "curve_entry_T3", "ndi", str(tmp_path / "mine.py"), "--no-movie"]) == 1
    assert capsys.readouterr().err.startswith("error: mine.py, line 3 (Mine.plan): TypeError: ")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["curve_entry_T9"], "scenario 'curve_entry_T9' is not known; there are"),
        (["braking", "nmpc", "pid"], "controller 'pid' is neither a file nor a registered controller; there are"),
        (["braking", "nmpc"], "two different controllers, found ['nmpc']"),
        (["braking", "ndi", "ndi"], "two different controllers, found ['ndi', 'ndi']"),
        (["braking", "ndi", "nmpc", "--setting", "fair"], "setting 'fair' is not known; there are"),
    ],
)
def test_wrong_names_are_one_sentence(arguments, sentence, capsys):
    assert command.main(["film", *arguments]) == 1
    said = capsys.readouterr().err
    assert sentence in said and len(said.splitlines()) == 1


def test_a_movie_is_written_with_pillow(film, tmp_path, monkeypatch):
    image = pytest.importorskip("PIL.Image")
    monkeypatch.setattr(movie, "PICTURES", 3)
    monkeypatch.setattr(movie, "coder", lambda: ("gif", "pillow"))
    with image.open(movie.save(film, tmp_path, "short")) as found:
        assert found.n_frames == 3
    assert [file.name for file in tmp_path.iterdir()] == ["short.gif"]


def test_without_a_coder_the_movie_is_refused_in_one_sentence(monkeypatch):
    monkeypatch.setattr(animation.writers, "is_available", lambda name: False)
    with pytest.raises(InputError, match="neither ffmpeg nor Pillow"):
        movie.coder()


class Counting:
    """Torque that counts the exchanges, 1 N m each."""

    memory = ("count",)

    def gains(self):
        return {}

    def torque(self, gear, track_ahead, memory, gain, model):
        return memory["count"], {"count": memory["count"] + 1}


@pytest.mark.parametrize("delay", [0.0, 3.0, 2.5])
def test_a_delayed_torque_is_the_same_later(delay):
    scenario = load_scenario("sine_tracking").but(end_m=4.0)
    du = simulate.run(scenario, knobs.delayed(Counting(), 1e-3 * delay)).series["front.du"].to_numpy()
    count = np.arange(du.size)
    expected = count - delay if delay == int(delay) else (np.maximum(count - 2, 0) + np.maximum(count - 3, 0)) / 2
    assert du == pytest.approx(np.maximum(expected, 0))


def test_knobs_at_rest_change_nothing_and_friction_mixes_the_rails():
    scenario = load_scenario("curve_entry_T3").but(end_m=60.0)
    found = knobs.turned(scenario, Parameters())
    for name in knobs.CONTROLLERS:
        plain = simulate.run(scenario, tuned(name)).series
        assert np.array_equal(found[name].series["rear.y"], plain["rear.y"])
    slippery, grippy = (load_vehicle().adhesion[name].mu0 for name in (scenario.poor, scenario.good))
    for friction in (slippery, 0.45, grippy):
        share = Parameters(friction=friction, speed_kmh=200.0).scenario(scenario).poor_share[0][1]
        assert share * slippery + (1 - share) * grippy == pytest.approx(friction)
    base, turned = (Parameters(r=r, horizon=h).parameters("nmpc", "paper") for r, h in ((1, 1), (10, 0.5)))
    assert turned == base | {"r": 10 * base["r"], "horizon_s": 0.5 * base["horizon_s"]}


@pytest.mark.parametrize(
    ("wrong", "name"),
    [({"r": 0.0}, "r"), ({"delay_ms": 21.0}, "delay_ms"), ({"friction": 0.6}, "friction")],
)
def test_a_parameter_beyond_its_range_is_refused(wrong, name):
    with pytest.raises(InputError, match=f"parameter {name}"):
        Parameters(**wrong).scenario(load_scenario("curve_entry_T3"))


def test_a_slider_drives_both_again_and_tells_what_is_wrong():
    from railrepro.evidence.film.panel import curves, panel

    drawn = []

    def draw(runs):
        drawn.append(runs)
        return curves(runs)

    scenario = load_scenario("curve_entry_T3").but(end_m=40.0)
    sliders, said, _ = panel(scenario, "equal", draw).children
    poles = next(slider for slider in sliders.children if "poles" in slider.description)
    poles.value = 0.5
    assert len(drawn) == 2 and "end of the run" in said.value
    first, second = (runs["ndi"].series["front.y"].to_numpy() for runs in drawn)
    assert first.size == second.size and np.abs(first - second).max() > 1e-6
