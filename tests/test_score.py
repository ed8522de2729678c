"""The benchmark: a stranger's fault is a line of its own, points follow their formula, a seed draws what it should."""

import os

import numpy as np
import pandas as pd
import pytest

from railrepro import __main__ as command
from railrepro import paths
from railrepro.control.registry import CONTROLLERS
from railrepro.errors import InputError
from railrepro.evidence.score import card, leaderboard, page, run, suite, trial
from railrepro.evidence.score.entry import Entry, entry
from railrepro.evidence.score.trial import Trial
from railrepro.simulation.scenarios import load_scenario
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
    def torque(self, gear, track_ahead, memory, gain, model):
        {}
"""
BOTH = SLOW.format("return 0.0") + LAW.format("return 0, {}").replace("Mine", "Other")
DEAF = """
        while True:
            try: time.sleep(9)
            except BaseException: pass"""
FAULTS = {
    "no python": ("this is no code", "own.py, line 1: SyntaxError: invalid syntax"),
    "throws at import": ("x = 1\nraise ValueError('no\\n  reason')\n", "own.py, line 2: ValueError: no reason"),
    "exits at import": ("import sys\nsys.exit(3)\n", "own.py, line 2: SystemExit: 3"),
    "module that is missing": ("import nothing_like_it\n", "own.py, line 1: ModuleNotFoundError: No module named"),
    "no class": ("x = 1\n", "own.py: one class with `torque` or with `plan` is needed, found none"),
    "two classes": (BOTH, "found ['Mine', 'Other']"),
    "throws": (SLOW.format("return 1 / 0"), "own.py, line 8: ZeroDivisionError: division by zero"),
    "gives NaN": (SLOW.format("return float('nan')"), "controller of the front gear returned nan at t = 0.000 s"),
    "gives a text": (SLOW.format("return 'much'"), "plan() returned 'much', a number (N m) is needed"),
    "gives nothing": (SLOW.format("pass"), "plan() returned None, a number (N m) is needed"),
    "no period": (SLOW.format("return 0.0").replace("period =", "rhythm ="), "period is None, a number of seconds"),
    "loops for ever": (SLOW.format("while True: pass"), "took more than 1 s of the processor"),
    "swallows what stops it": (SLOW.format(DEAF), "took more than 4 s"),
    "ends the process": (SLOW.format("os._exit(0)"), "ended the process"),
    "crashes": (SLOW.format("os.kill(os.getpid(), signal.SIGSEGV)"), "ended the process by signal SIGSEGV"),
    "law without its symbol": (LAW.format("return gear['height'], {}"), "there is no gear state 'height'"),
    "law that is NaN": (LAW.format("return float('nan') * gear['held'], {}"), "times no finite number; "),
    "constructor wants more": (SLOW.format("return 0.0").replace("gear)", "gear, more)"), "missing 1 required"),
    "leaves the rail": (SLOW.format("return 3000.0"), "gear left the rail, |y| = 30."),
}  # fmt: skip
CASE = suite.Case("short", "equal", load_scenario("curve_entry_T3").but(end_m=60.0))
PID = str(paths.ROOT / "examples/pid.py")


@pytest.mark.parametrize("what", FAULTS)
def test_a_fault_is_a_line_and_no_points(what, tmp_path):
    text, said = FAULTS[what]
    file = tmp_path / "own.py"
    file.write_text(text)
    row = Trial(Entry("own", str(file)), CASE, processor=1.0, wall=4.0 if "sleep(9)" in text else 100.0)()
    assert said in row["failure"] and "\n" not in row["failure"]
    table = card.judged([row])
    assert table["points"].tolist() == [0.0]
    assert page.html("own", table, card.tidy(table, 1), 1).count("<td>") > 10


@pytest.fixture(scope="module")
def pid():
    """Row of the template on the short run."""
    return Trial(entry(PID), CASE)()


def test_the_template_is_driven_with_the_numbers_of_its_setting(pid):
    loop = Trial(entry(PID), suite.Case("short", "loop", CASE.scenario, sensors={"seed": 1}))()
    assert (pid["failure"], loop["failure"]) == ("", "")
    assert loop["rmse_y"] > 1.2 * pid["rmse_y"]
    assert 0 < pid["sample_median"] < 1e-3
    assert pid["sample_median"] <= pid["sample_p99"] <= pid["sample_max"]
    assert not [name for name in CONTROLLERS if name.startswith("own")]  # it was entered in the copy only


def test_a_slow_controller_is_timed_and_told_what_it_wants(tmp_path):
    file = tmp_path / "own.py"
    wanted = (
        "assert self.told\n        time.sleep(0.002)\n        return 0.0\n    def notice(self, *what): self.told = what"
    )
    file.write_text(SLOW.format(wanted))
    row = Trial(Entry("own", str(file)), suite.Case("short", "equal", CASE.scenario.but(end_m=10.0)))()
    assert row["failure"] == "" and row["sample_median"] > 0.002


def test_points_follow_their_formula(pid):
    row = pid | {"rmse_y": 2e-3, "effort_du": 1000.0, "activity_du": 750.0, "utilisation": 0.9}
    row |= {"y_over_q": 0.2, "sum_y_over_limit": 1.1}
    cost = 2 + 0.25 + 0.5 + 0.2 + 1.0
    assert card.judged([row])["points"][0] == pytest.approx(100 / (1 + cost))
    margins = {"scenario": "margins", "setting": "loop", "controller": "own", "failure": ""}
    margins |= {"delay_survived": 5e-3, "lag_survived": 0.1}
    assert card.judged([margins])["points"][0] == pytest.approx(75.0)


def test_the_score_is_the_mean_over_cases_and_settings():
    head = {"controller": "own", "scenario": "a", "failure": "left"}
    full = {"rmse_y": 0.0, "followed_rmse_y": 0.0, "effort_du": 0.0, "activity_du": 0.0, "y_over_q": 0.0}
    full |= {"sum_y_over_limit": 0.0, "failure": ""}
    rows = [head | {"setting": "equal"}, head | {"setting": "equal"} | full, head | {"setting": "loop"} | full]
    long = card.tidy(card.judged(rows), 7)
    scores = long[(long["metric"] == "score") & (long["scenario"] == card.ALL)].set_index("setting")["value"]
    assert scores.to_dict() == {"equal": 50.0, "loop": 100.0, "all": 75.0}
    assert (long["seed"] == 7).all() and long["unit"].notna().all()
    assert long[long["metric"] == "failures"]["value"].tolist() == [1.0, 0.0]


def test_a_seed_draws_noise_irregularity_and_mismatch():
    first, same, other = suite.cases(1), suite.cases(1), suite.cases(2)
    assert first == same
    changed = {(a.name, a.setting) for a, b in zip(first, other, strict=True) if a != b}
    drawn = {"irregular", "mismatch_1", "mismatch_2"}
    assert changed == {(case.name, case.setting) for case in first if case.setting == "loop" or case.name in drawn}
    ranges = sample_ranges()
    for case in first:
        load_vehicle(**case.plant)
        for key in suite.MISMATCH if case.name.startswith("mismatch") else ():
            assert ranges[key][0] <= case.plant[key] <= ranges[key][1]
        case.scenario.route()
    assert {case.setting for case in first} == {"equal", "loop"} and len(first) == 28


def test_margins_are_the_smallest_over_the_rails(monkeypatch):
    breaks = {"delay": 3.5e-3, "lag": 0.03}
    monkeypatch.setattr(
        Trial, "_fails", lambda self, what, rail: lambda value: value > breaks[what] * (1 + (rail == "dry"))
    )
    found = Trial(entry(PID), "equal")()
    assert found["delay_survived"] == pytest.approx(3e-3) and found["lag_survived"] == pytest.approx(0.03)
    monkeypatch.setattr(Trial, "_fails", lambda self, what, rail: lambda value: True)
    assert Trial(entry(PID), "equal")()["delay_survived"] == 0.0


def test_what_cannot_be_driven_at_all_is_not_driven_through_the_suite(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    file = tmp_path / "mine.py"
    file.write_text("import nothing_like_it\n")
    command.main(["score", str(file)])
    table = pd.read_csv(tmp_path / "score/mine.csv")
    scores = table[table["metric"] == "score"]["value"]
    assert (scores == 0).all() and len(scores) == 3
    said = capsys.readouterr().out
    assert said.count("does not import: mine.py, line 1: ModuleNotFoundError") == 30
    assert "<script" not in (tmp_path / "score/mine.html").read_text()


def test_the_leaderboard_ranks_all_that_are_asked(monkeypatch, tmp_path):
    def scored(entry, seed, names, quiet=False):
        points = {"good": 80.0, "bad": 10.0}[entry.name]
        rows = [
            {"scenario": "a", "setting": setting, "controller": entry.name, "failure": "", "points": points}
            for setting in ("equal", "loop")
        ]
        return pd.DataFrame(rows)

    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(leaderboard, "score", scored)
    table = leaderboard.table([Entry("bad"), Entry("good")])
    assert list(table.columns) == ["scenario", "controller", "metric", "value", "unit", "setting", "seed"]
    ranked = card.ranking(table)
    assert list(ranked.index) == ["good", "bad"] and ranked["all"].tolist() == [80.0, 10.0]
    assert not table["metric"].str.startswith("sample").any()
    assert leaderboard.markdown(table).split("\n")[2:] == [
        "| `good` | 80.0 | 80.0 | 80.0 | 0 | – | – | – |", "| `bad` | 10.0 | 10.0 | 10.0 | 0 | – | – | – |"
    ]  # fmt: skip


@pytest.mark.parametrize("wrong", ["nobody", "examples", "examples/nobody.py"])
def test_what_is_no_controller_is_refused(wrong):
    with pytest.raises(InputError, match="is neither a file nor a registered controller"):
        entry(wrong)


def test_a_small_score_writes_card_and_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(suite, "QUICK", ("sine_400",))
    command.main(["score", PID, "--small", "--seed", "5"])
    table = pd.read_csv(tmp_path / "score/pid.csv")
    assert set(table["seed"]) == {5} and set(table["setting"]) == {"equal", "loop", "all"}
    html = (tmp_path / "score/pid.html").read_text()
    assert html.count("data:image/png") == 1 and "http" not in html.replace("http-equiv", "")
    assert "score over both settings" in capsys.readouterr().out
    assert np.isfinite(table["value"]).all() and os.path.getsize(tmp_path / "score/pid.html") < 1e6


def test_names_of_no_run_are_refused():
    with pytest.raises(InputError, match="there is no run of the names"):
        run.score(entry(PID), names=("nowhere",))


@pytest.fixture
def board(monkeypatch, tmp_path):
    """The leaderboard in a folder of its own, with a list of those that were really scored."""
    asked = []

    def scored(entry, seed, names, quiet=False):
        asked.append(entry.name)
        rows = [
            {"scenario": "a", "setting": t, "controller": entry.name, "failure": "", "points": 50.0, "error": 1.25e-3}
            for t in ("equal", "loop")
        ]
        return pd.DataFrame(rows)

    monkeypatch.setattr(paths, "BUILD", tmp_path / "build")
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    monkeypatch.setattr(leaderboard, "LEADERBOARD", "data/results/board.csv")
    monkeypatch.setattr(leaderboard, "score", scored)
    monkeypatch.setenv("RAILREPRO_STORE", str(tmp_path / "store"))
    monkeypatch.setattr(leaderboard.sources, "closure", lambda _: {"library": "this one"})
    (tmp_path / leaderboard.PAGE).parent.mkdir(parents=True)
    (tmp_path / leaderboard.PAGE).write_text(f"before\n\n{leaderboard.BEGIN}\nold\n{leaderboard.END}\n\nafter\n")
    (tmp_path / "mine.py").write_text(LAW.format("return 0, {}"))
    return asked


def test_a_finished_controller_of_the_leaderboard_is_not_scored_again(board, tmp_path, monkeypatch):
    mine = str(tmp_path / "mine.py")
    leaderboard.main(["ndi", mine])
    whole = (tmp_path / "data/results/board.csv").read_bytes()
    leaderboard.main(["ndi", mine])
    assert board == ["ndi", "mine"] and (tmp_path / "data/results/board.csv").read_bytes() == whole
    (tmp_path / "mine.py").write_text(LAW.format("return 1, {}"))
    leaderboard.main(["ndi", mine])
    assert board == ["ndi", "mine", "mine"]
    for file in (tmp_path / "store").rglob("*.npz"):
        file.write_bytes(file.read_bytes()[:-40])
    leaderboard.main(["ndi"])
    assert board[3:] == ["ndi"]
    monkeypatch.setattr(leaderboard.sources, "closure", lambda _: {"library": "another one"})
    leaderboard.main(["ndi"])
    assert board[4:] == ["ndi"]


def test_a_named_controller_is_entered_beside_those_that_are_there(board, tmp_path):
    leaderboard.main(["ndi"])
    leaderboard.main([str(tmp_path / "mine.py")])
    table = pd.read_csv(tmp_path / "data/results/board.csv")
    assert list(dict.fromkeys(table["controller"])) == ["ndi", "mine"]
    assert not table.duplicated(["scenario", "controller", "metric", "setting"]).any()
    text = (tmp_path / leaderboard.PAGE).read_text()
    assert text.startswith("before\n") and text.endswith("\nafter\n") and "old" not in text
    assert "| `mine` | 50.0 | 50.0 | 50.0 | 0 | 1.25 | – | – |" in text


def test_a_page_without_a_place_for_the_leaderboard_is_refused_and_nothing_is_written(board, tmp_path):
    (tmp_path / leaderboard.PAGE).write_text("nothing\n")
    with pytest.raises(InputError, match=r"benchmark.md: the lines .* are missing"):
        leaderboard.main(["ndi"])
    assert not (tmp_path / "data/results/board.csv").exists()


def test_the_page_shows_the_committed_leaderboard():
    text, file = (paths.ROOT / leaderboard.PAGE).read_text(), paths.ROOT / page.LEADERBOARD
    if not file.exists():
        assert f"{leaderboard.BEGIN}\n{leaderboard.END}\n" in text  # `make leaderboard` fills it
    else:
        assert leaderboard.in_page(text, pd.read_csv(file)) == text


@pytest.mark.parametrize("name", ["nmpc", "creep_mpc"])
def test_the_times_of_a_slower_controller_are_the_least_of_all_drives(name, monkeypatch):
    drives = []
    monkeypatch.setattr(trial.time, "process_time", lambda: 0.0)
    original = trial.Experiment.run

    def run(experiment):
        found = original(experiment)
        drives.append(len(drives))
        for number, solve in enumerate(solve for controller in found.controllers for solve in controller.stats):
            object.__setattr__(solve, "seconds", 1.0 + (number % 3 != drives[-1] % 3))
        return found

    monkeypatch.setattr(trial.Experiment, "run", run)
    short = suite.Case("short", "equal", CASE.scenario.but(end_m=10.0))
    row = Trial(entry(name), short, processor=1e3, wall=1e4)._run()
    assert len(drives) == trial.DRIVES and row["failure"] == ""
    assert row["sample_median"] == row["sample_max"] == 1.0
    monkeypatch.setattr(trial.time, "process_time", lambda: 500.0)
    assert Trial(entry(name), short, processor=1e3, wall=1e4)._run()["sample_max"] == 2.0
