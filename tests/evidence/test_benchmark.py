"""The benchmark: a stranger's fault is a line of its own, points follow their formula, a seed draws what it should."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from railrepro import __main__ as command
from railrepro import paths
from railrepro.evidence import benchmark
from railrepro.evidence.benchmark import NOTHING, drive, entry, known
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.route import INDEX, Route
from railrepro.vehicle.parameters import sample_ranges

SLOW = """
class Mine:
    period = 0.005
    def __init__(self, vehicle, route, gear):
        pass
    def plan(self, x_hat, u_d):
        {}
"""
LAW = """
class Own:
    def torque(self, q):
        {}
"""
FAULTS = {
    "no python": ("this is no code", "own.py, line 1: SyntaxError: invalid syntax"),
    "throws at import": ("x = 1\nraise ValueError('no\\n  reason')\n", "own.py, line 2: ValueError: no reason"),
    "exits at import": ("import sys\nsys.exit(3)\n", "own.py, line 2: SystemExit: 3"),
    "no class": ("x = 1\n", "own.py: one class with `torque` or with `plan` is needed, found none"),
    "two classes": (SLOW.format("return 0.0") + LAW.format("return 0"), "found ['Mine', 'Own']"),
    "throws": (SLOW.format("return 1 / 0"), "own.py, line 7: ZeroDivisionError: division by zero"),
    "gives nothing": (SLOW.format("pass"), "returned None at t = 0.000 s, p = 0.0 m; a finite number"),
    "no period": (SLOW.format("return 0.0").replace("period =", "rhythm ="), "Mine: period is None, a number"),
    "law that is NaN": (LAW.format("return float('nan') * q.held"), "the lateral law of the front gear gave no finite"),
    "law that becomes NaN": (LAW.format("return (q.held - 1) ** 0.5"), "gave no finite torque at t = 0.000 s"),
    "law without its symbol": (LAW.format("return q.height"), "own.py, line 4: lateral law Own: torque() asks for"),
    "wrong setting": (LAW.format("return 0 * q.held") + "    tuned = {'paper': {}}", "`tuned` has ['paper']"),
    "derails": (SLOW.format("return 3000.0"), "gear derailed, |y| = 30."),
}


def short(setting, seed=1, end_m=60.0, **sensors):
    """A case of the suite that ends early."""
    case = benchmark.case("short", setting, seed, load_scenario("curve_entry_T3").but(end_m=end_m), {}, {})
    return dataclasses.replace(case, sensors=case.sensors | sensors)


CASE = short("equal")
ENDS = {"nothing": float("inf"), "best": 0.0, "limit": 0.0}
PID = str(paths.ROOT / "examples/pid.py")


@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_is_a_line_and_no_points(what, tmp_path):
    text, said = FAULTS[what]
    file = tmp_path / "own.py"
    file.write_text(text)
    cone = {"contact.profile": "cone"}  # no flange holds it
    row = drive(file, dataclasses.replace(CASE, plant=cone))
    assert said in row["failure"] and "\n" not in row["failure"]
    assert benchmark.points(row | ENDS) == 0.0


@pytest.fixture(scope="module")
def pid():
    """Row of the template on the short run."""
    return drive(entry(PID), CASE)


def test_the_template_is_driven_with_the_numbers_of_its_setting(pid):
    loop = drive(entry(PID), short("loop"))
    assert (pid["failure"], loop["failure"]) == ("", "")
    assert loop["rmse_y"] > 1.2 * pid["rmse_y"]


def test_a_controller_knows_neither_friction_nor_irregularities():
    route = load_scenario("braking").but(poor_share=((0.0, 0.0), (300.0, 0.0), (301.0, 1.0)), end_m=700.0).route()
    rough = Route(np.ones_like(route.cells), route.length)
    hidden = ["lateral", "ddvertical", "gauge", "poor_le", "poor_ri"]
    for name in (*hidden, "force", "y_ref", "kappa"):
        assert known(rough).cells[:, INDEX[name]].any() == (name not in hidden), name


def test_points_go_from_no_guidance_to_the_limit(pid):
    row = pid | {"error": 2e-3, "effort_du": 1000.0, "activity_du": 750.0, "utilisation": 0.9}
    row |= {"y_over_q": 0.2, "sum_y_over_limit": 1.1}
    cost = 2 + 0.25 + 0.5 + 0.2 + 1.0

    def points(**more):
        return benchmark.points(row | ENDS | more)

    assert benchmark.cost(row) == pytest.approx(cost)
    assert points() == pytest.approx(100 / (1 + cost))
    assert points(nothing=cost) == pytest.approx(0.0) and points(nothing=cost / 2) == 0.0
    assert points(best=cost) == pytest.approx(100.0) == points(best=2 * cost)
    between = (1 / (1 + cost) - 1 / 11) / (1 / 2 - 1 / 11)
    assert points(nothing=10.0, best=1.0) == pytest.approx(100 * between)
    assert points(failure="left") == 0.0


def test_no_controller_undercuts_the_limit():
    """Without the biases, of which one draw may be kind; three seeds at 280 km/h, within the tolerance of 10 %."""
    quiet = {"lateral.bias": 0.0, "gyro.bias": 0.0}
    cases = [short("loop", k, 300.0, **quiet) for k in (1, 2, 3)]
    least = benchmark.ends_of_the_scale(cases[0])
    for name in ("ndi_feedforward", "ndi_integral"):
        rows = [drive(entry(name), case) for case in cases]
        assert np.sqrt(np.mean([row["error"] ** 2 for row in rows])) > 0.9 * least["limit"] > 1e-5
        assert np.mean([benchmark.cost(row) for row in rows]) > least["best"]
    for factor, worse in {1.2: quiet | {"lateral.noise": 2e-3}, 1.1: {}}.items():
        assert benchmark.ends_of_the_scale(short("loop", 1, 300.0, **worse))["limit"] > factor * least["limit"]


def test_nothing_gets_no_points():
    for case in (CASE, short("loop")):
        row = drive(entry(NOTHING), case) | benchmark.ends_of_the_scale(case)
        assert benchmark.points(row) == pytest.approx(0.0, abs=1e-6)


def test_the_score_is_the_mean_over_groups_of_cases_and_settings():
    head = {"controller": "own", "scenario": "a", "group": "a", "failure": "left"} | ENDS
    full = {"error": 0.0, "effort_du": 0.0, "activity_du": 0.0, "y_over_q": 0.0}
    full |= {"sum_y_over_limit": 0.0, "failure": ""}
    margin = {"setting": "loop", "group": "margins"}
    rows = [head | {"setting": "equal"}, head | {"setting": "equal", "group": "b"} | full]
    rows += [head | {"setting": "loop"} | full, *[head | margin | full] * 2, *[head | margin] * 2]
    long = benchmark.card(pd.DataFrame([row | {"seed": 7, "points": benchmark.points(row)} for row in rows]))
    whole = long.pivot_table(index="metric", columns="setting", values="value")
    assert whole.loc["score"].to_dict() == {"equal": 50.0, "loop": 75.0, "all": 62.5}
    assert whole.loc["margins", "loop"] == 50.0 and whole.loc["cases"].dropna().to_dict() == {"equal": 2.0, "loop": 2.0}
    assert (long["seed"] == 7).all() and long["unit"].notna().all()
    assert long[long["metric"] == "failures"]["value"].tolist() == [1.0, 0.0]


def test_a_seed_draws_noise_irregularity_and_mismatch():
    first, same, other = benchmark.cases(1), benchmark.cases(1), benchmark.cases(2)
    assert first == same and len(first) == 2 * (14 + 16)
    late = {case.label["scenario"] for case in first if "inverter.delay" in case.sensors}
    assert late == {f"delay_{ms}ms_{rail}" for ms in (3, 6, 9, 12) for rail in ("dry", "poor")}
    margins = [case for case in first if case.setting == "loop" and case.label["group"] == "margins"]
    seeds = {case.sensors["seed"] for case in margins}
    assert len(seeds) == len(margins) == 16 and 1 not in seeds
    drawn = {"irregular", "mismatch_1", "mismatch_2"}
    for one, another in zip(first, other, strict=True):
        assert (one != another) == (one.setting == "loop" or one.label["scenario"] in drawn)
        assert one.setting == "loop" or not one.sensors or one.sensors["perfect"]
        one.car(), one.scenario.route()
        for key in benchmark.MISMATCH if one.label["scenario"].startswith("mismatch") else ():
            low, high = sample_ranges()[key]
            assert low <= one.plant[key] <= high


def test_what_cannot_be_driven_at_all_is_one_sentence_and_exit_code_1(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    file = tmp_path / "mine.py"
    file.write_text(SLOW.format("return None"))
    assert command.main(["score", str(file)]) == 1
    captured = capsys.readouterr()
    assert captured.out == "checking controller mine.py\n"
    said = "error: mine.py: ArithmeticError: the lateral controller of the front gear returned None at t = 0.000 s"
    assert captured.err.startswith(said) and len(captured.err.splitlines()) == 1
    assert not (tmp_path / "score").exists()


def test_cases_that_draws_have_in_common_are_driven_once(monkeypatch):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    driven = []

    def drive(_, case):
        driven.append(case)
        return case.label | {"controller": "pid.py", "failure": "left"}

    monkeypatch.setattr(benchmark, "drive", drive)
    monkeypatch.setattr(benchmark, "ends_of_the_scale", lambda _: dict(ENDS))
    table = benchmark.score(entry(PID), (1, 2), ("curve_T3", "irregular"))
    assert len(driven) == 7 and len(table) == 8 and table["seed"].tolist() == [1] * 4 + [2] * 4


def test_the_leaderboard_ranks_by_the_ranked_draws():
    less = dict(zip((1001, 7, 8, 9, 10, 11), (0, 12, 14, 16, 18, 20), strict=True))
    row = {"scenario": "a", "group": "a", "failure": "", "error": 1.25e-3, "limit": 1e-3}
    rows = [
        row | {"controller": name, "setting": setting, "seed": seed, "points": points - off}
        for name, points in (("ndi", 80.0), ("nmpc", 90.0))
        for seed, off in less.items()
        for setting in ("equal", "loop")
    ]
    table = pd.DataFrame(rows)
    cards = pd.concat([benchmark.card(each) for _, each in table.groupby("controller")])
    assert list(cards.columns) == ["scenario", "controller", "metric", "value", "unit", "setting", "seed"]
    ranked = benchmark.ranking(cards)
    assert list(ranked.index) == ["nmpc", "ndi"] and ranked["ranked"].tolist() == [74.0, 64.0]
    assert ranked["published"].tolist() == [90.0, 80.0] and ranked["limit (mm), loop"].tolist() == [1.0, 1.0]
    assert ranked["spread"].tolist() == pytest.approx([np.std([78, 76, 74, 72, 70], ddof=1)] * 2)


def test_a_small_score_writes_its_card(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(benchmark, "QUICK", ("sine_400",))
    command.main(["score", PID, "--small", "--seed", "5"])
    table = pd.read_csv(tmp_path / "score/pid.py-5.csv")
    assert set(table["seed"]) == {5} and set(table["setting"]) == {"equal", "loop"}
    assert "score over both settings" in capsys.readouterr().out
    assert np.isfinite(table["points"]).all() and (table["failure"].isna()).all()
