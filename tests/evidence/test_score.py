"""The benchmark: a stranger's fault is a line of its own, points follow their formula, a seed draws what it should."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest

from railrepro import __main__ as command
from railrepro import code, paths
from railrepro.evidence.score import card, leaderboard, run, suite
from railrepro.evidence.score.entry import NOTHING, Entry, entry, known, load_class
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.route import INDEX, Route
from railrepro.vehicle.parameters import load_vehicle, sample_ranges

SLOW = """
import os, signal, sys, time
class Mine:
    period = 0.005
    def __init__(self, vehicle, route, gear):
        pass
    def plan(self, x_hat, u_d):
        {}
"""
LAW = """
class Mine:
    memory = ()
    def gains(self):
        return {{}}
    def torque(self, q):
        {}
"""
BOTH = SLOW.format("return 0.0") + LAW.format("return 0, {}").replace("Mine", "Other")
FAULTS = {
    "no python": ("this is no code", "own.py, line 1: SyntaxError: invalid syntax"),
    "throws at import": ("x = 1\nraise ValueError('no\\n  reason')\n", "own.py, line 2: ValueError: no reason"),
    "exits at import": ("import sys\nsys.exit(3)\n", "own.py, line 2: SystemExit: 3"),
    "module that is missing": ("import nothing_like_it\n", "own.py, line 1: ModuleNotFoundError: No module named"),
    "no class": ("x = 1\n", "own.py: one class with `torque` or with `plan` is needed, found none"),
    "two classes": (BOTH, "found ['Mine', 'Other']"),
    "throws": (SLOW.format("return 1 / 0"), "own.py, line 8 (Mine.plan): ZeroDivisionError: division by zero"),
    "gives NaN": (SLOW.format("return float('nan')"), "controller of the front gear returned nan at t = 0.000 s"),
    "gives a text": (SLOW.format("return 'much'"), "own.py, line 7 (Mine.plan): plan() returned 'much', a number"),
    "gives nothing": (SLOW.format("pass"), "plan() returned None, a number (N m) is needed"),
    "no period": (SLOW.format("return 0.0").replace("period =", "rhythm ="), "Mine: period is None, a number"),
    "law without its symbol": (LAW.format("return q.height, {}"), "own.py, line 7 (Mine.torque): lateral law "
                               "Mine: torque() asks for q.height"),
    "law that is NaN": (LAW.format("return float('nan') * q.held, {}"), "torque() returned NaN or Inf "),
    "law that becomes NaN": (LAW.format("return (q.held - 1) ** 0.5, {}"), "returned NaN or Inf "),
    "law with an if": (LAW.format("return 0 if q.held > 1 else 1, {}"), "casadi.if_else takes the place of if"),
    "law of a list": (LAW.format("return [q.held, 0], {}"), "line 6 (Mine.torque): lateral law Mine: its"),
    "law of a vector": (LAW.format("import casadi; return casadi.vertcat(q.held, 0), {}"), "of shape (2, 1)"),
    "law that gives nothing": (LAW.format("pass"), "Mine: its torque is None, a scalar"),
    "wrong use of CasADi": (LAW.format("import casadi; return casadi.fmin('a', q.held), {}"), "function 'fmin'."),
    "constructor wants more": (SLOW.format("return 0.0").replace("gear)", "gear, more)"), "missing 1 required"),
    "derails": (SLOW.format("return 3000.0"), "gear derailed, |y| = 30."),
}  # fmt: skip
CASE = suite.Case("short", "equal", load_scenario("curve_entry_T3").but(end_m=60.0), group="short")
ANCHORS = {"nothing": float("inf"), "best": 0.0, "limit": 0.0}
PID = str(paths.ROOT / "examples/pid.py")


@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_is_a_line_and_no_points(what, tmp_path):
    text, said = FAULTS[what]
    file = tmp_path / "own.py"
    file.write_text(text)
    cone = {"contact.profile": "cone"}  # no flange holds it
    row = run.drive(Entry("own.py", str(file)), dataclasses.replace(CASE, plant=cone))
    assert said in row["failure"] and "\n" not in row["failure"] and "Possible prototypes" not in row["failure"]
    table = card.judged([row | ANCHORS])
    assert table["points"].tolist() == [0.0]


@pytest.fixture(scope="module")
def pid():
    """Row of the template on the short run."""
    return run.drive(entry(PID), CASE)


def test_the_template_is_driven_with_the_numbers_of_its_setting(pid):
    loop = run.drive(entry(PID), suite.Case("short", "loop", CASE.scenario, sensors={"seed": 1}))
    assert (pid["failure"], loop["failure"]) == ("", "")
    assert loop["rmse_y"] > 1.2 * pid["rmse_y"]


def test_a_controller_knows_neither_friction_nor_irregularities():
    route = load_scenario("braking").but(poor_share=suite._PATCH, end_m=700.0).route()
    rough = Route(np.ones_like(route.cells), route.length)
    hidden = ["lateral", "ddvertical", "gauge", "poor_le", "poor_ri"]
    for name in (*hidden, "force", "y_ref", "kappa"):
        assert known(rough).cells[:, INDEX[name]].any() == (name not in hidden), name


def test_points_go_from_no_guidance_to_the_limit(pid):
    row = pid | {"rmse_y": 2e-3, "effort_du": 1000.0, "activity_du": 750.0, "utilisation": 0.9}
    row |= {"y_over_q": 0.2, "sum_y_over_limit": 1.1}
    cost = 2 + 0.25 + 0.5 + 0.2 + 1.0

    def points(**more):
        return card.judged([row | ANCHORS | more])["points"][0]

    assert card.cost(row) == pytest.approx(cost)
    assert points() == pytest.approx(100 / (1 + cost))
    assert points(nothing=cost) == pytest.approx(0.0) and points(nothing=cost / 2) == 0.0
    assert points(best=cost) == pytest.approx(100.0) == points(best=2 * cost)
    between = (1 / (1 + cost) - 1 / 11) / (1 / 2 - 1 / 11)
    assert points(nothing=10.0, best=1.0) == pytest.approx(100 * between)
    assert points(failure="left") == 0.0


def test_no_controller_undercuts_the_limit():
    """Without the biases, of which one draw may be kind; three seeds at 280 km/h, within the tolerance of 10 %."""
    quiet = {"lateral.bias": 0.0, "gyro.bias": 0.0}
    where = load_scenario("curve_entry_T3").but(end_m=300.0)
    cases = [suite.Case("short", "loop", where, sensors={"seed": k} | quiet) for k in (1, 2, 3)]
    least = run.limits(cases[0])
    for name in ("ndi_feedforward", "ndi_integral"):
        rows = [run.drive(entry(name), case) for case in cases]
        assert np.sqrt(np.mean([card.error(row) ** 2 for row in rows])) > 0.9 * least["limit"] > 1e-5
        assert np.mean([card.cost(row) for row in rows]) > least["best"]
    noisier = suite.Case("short", "loop", where, sensors={"seed": 1} | quiet | {"lateral.noise": 2e-3})
    assert run.limits(noisier)["limit"] > 1.2 * least["limit"]
    biased = run.limits(suite.Case("short", "loop", where, sensors={"seed": 1}))
    assert biased["limit"] > 1.1 * least["limit"]


def test_nothing_gets_no_points():
    for case in (CASE, suite.Case("short", "loop", CASE.scenario, sensors={"seed": 1}, group="short")):
        row = run.drive(entry(NOTHING), case) | run.anchors(case)
        assert card.judged([row])["points"].tolist() == [pytest.approx(0.0, abs=1e-6)]


def test_the_score_is_the_mean_over_groups_of_cases_and_settings():
    head = {"controller": "own", "scenario": "a", "group": "a", "failure": "left"} | ANCHORS
    full = {"rmse_y": 0.0, "followed_rmse_y": 0.0, "effort_du": 0.0, "activity_du": 0.0, "y_over_q": 0.0}
    full |= {"sum_y_over_limit": 0.0, "failure": ""}
    margin = {"setting": "loop", "group": "margins"}
    rows = [head | {"setting": "equal"}, head | {"setting": "equal", "group": "b"} | full]
    rows += [head | {"setting": "loop"} | full, *[head | margin | full] * 2, *[head | margin] * 2]
    long = card.tidy(card.judged(rows), 7)
    whole = long[long["scenario"] == card.ALL].pivot_table(index="metric", columns="setting", values="value")
    assert whole.loc["score"].to_dict() == {"equal": 50.0, "loop": 75.0, "all": 62.5}
    assert whole.loc["margins", "loop"] == 50.0 and whole.loc["cases"].dropna().to_dict() == {"equal": 2.0, "loop": 2.0}
    assert (long["seed"] == 7).all() and long["unit"].notna().all()
    assert long[long["metric"] == "failures"]["value"].tolist() == [1.0, 0.0]


def test_a_seed_draws_noise_irregularity_and_mismatch():
    first, same, other = suite.cases(1), suite.cases(1), suite.cases(2)
    assert first == same
    assert {case.name: case.delay for case in first if case.delay}.keys() == {
        f"delay_{ms}ms_{rail}" for ms in (3, 6, 9, 12) for rail in ("dry", "poor")
    }
    seeds = [case.sensors["seed"] for case in first if case.setting == "loop" and case.group == "margins"]
    assert len(set(seeds)) == len(seeds) == 16 and 1 not in seeds
    changed = {(a.name, a.setting) for a, b in zip(first, other, strict=True) if a != b}
    drawn = {"irregular", "mismatch_1", "mismatch_2"}
    assert changed == {(case.name, case.setting) for case in first if case.setting == "loop" or case.name in drawn}
    ranges = sample_ranges()
    for case in first:
        load_vehicle(**case.plant)
        for key in suite.MISMATCH if case.name.startswith("mismatch") else ():
            assert ranges[key][0] <= case.plant[key] <= ranges[key][1]
        case.scenario.route()
    assert {case.setting for case in first} == {"equal", "loop"} and len(first) == 2 * (14 + 16)


def driven(file, case):
    return run.experiment(entry(str(file)), case, load_class(file)).run()


def test_a_delay_without_sensors_is_that_of_the_torque(tmp_path):
    (tmp_path / "own.py").write_text(LAW.format("return 100 + 0 * q.y"))
    case = suite.Case("short", "equal", CASE.scenario.but(end_m=5.0), group="short", delay=3e-3)
    torque = driven(tmp_path / "own.py", case).series["front.du"]
    assert (torque[:3] == 0.0).all() and (torque[3:] == 100.0).all()


def test_what_cannot_be_driven_at_all_is_one_sentence_and_exit_code_1(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    file = tmp_path / "mine.py"
    file.write_text(SLOW.format("return None"))
    assert command.main(["score", str(file)]) == 1
    captured = capsys.readouterr()
    assert captured.out == "checking controller mine.py\n"
    assert captured.err == "error: mine.py, line 7 (Mine.plan): plan() returned None, a number (N m) is needed\n"
    assert not (tmp_path / "score").exists()


def test_cases_that_draws_have_in_common_are_driven_once(monkeypatch):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    driven = []

    def mapped(pool, task, arguments, title, quiet=False):
        driven.append(len(arguments))
        return [dict(ANCHORS) if task is run.anchors else task(case) for case in arguments]

    monkeypatch.setattr(run, "ordered_map", mapped)
    left = {"controller": "pid.py", "failure": "left"}
    monkeypatch.setattr(
        run, "drive", lambda _, case: left | {"scenario": case.name, "setting": case.setting, "group": case.group}
    )
    table = run.score(entry(PID), (1, 2), ("curve_T3", "irregular"))
    assert driven == [7, 7] and len(table) == 8 and table["seed"].tolist() == [1] * 4 + [2] * 4


def cards(names, seeds=(1001, 7, 8)):
    """Rows like those of the score: a controller's points are its name's, less the draw's."""

    def scored(entry, draws, chosen, quiet=False):
        points = names[entry.name]
        rows = [
            {"scenario": "a", "group": "a", "setting": setting, "controller": entry.name, "failure": "", "seed": seed}
            | {"points": points - (k > 0) * (10 + 2 * k), "error": 1.25e-3, "limit": 1e-3}
            for k, seed in enumerate(draws)
            for setting in ("equal", "loop")
        ]
        return pd.DataFrame(rows)

    return scored


def test_the_leaderboard_ranks_by_the_ranked_draws(monkeypatch, tmp_path):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(leaderboard, "check", lambda _: None)
    monkeypatch.setattr(leaderboard, "score", cards({"ndi": 80.0, "nmpc": 90.0}))
    monkeypatch.setattr(suite, "draws", lambda: suite.Draws(1001, (7, 8, 9, 10, 11)))
    table = leaderboard.table([Entry("ndi"), Entry("nmpc")])
    assert list(table.columns) == ["scenario", "controller", "metric", "value", "unit", "setting", "seed"]
    ranked = card.ranking(table, 1001)
    assert list(ranked.index) == ["nmpc", "ndi"] and ranked["ranked"].tolist() == [74.0, 64.0]
    assert ranked["published"].tolist() == [90.0, 80.0]
    assert ranked["spread"].tolist() == pytest.approx([np.std([78, 76, 74, 72, 70], ddof=1)] * 2)
    assert set(table["scenario"]) == {card.ALL}
    assert leaderboard.markdown(table).split("\n")[3] == "| `ndi` | 64 | 3.16 | 80 | 64 | 64 | – | 0 | 1.25 | 1 | – |"


def test_a_small_score_writes_its_card(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(suite, "QUICK", ("sine_400",))
    command.main(["score", PID, "--small", "--seed", "5"])
    table = pd.read_csv(tmp_path / "score/pid.py-5.csv")
    assert set(table["seed"]) == {5} and set(table["setting"]) == {"equal", "loop", "all"}
    assert "score over both settings" in capsys.readouterr().out
    assert np.isfinite(table["value"]).all()


def test_a_stored_score_is_of_all_data_that_a_run_can_read():
    reached = code.reached("from railrepro.evidence.score.run import score")
    named = (re.findall(r"data/(\w+)\.toml", (paths.ROOT / name).read_text()) for name in reached if name[-3:] == ".py")
    assert set().union(*named) == set(leaderboard._READ)
