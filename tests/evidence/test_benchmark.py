"""The benchmark: an error in a user's file is one line, points follow their formula, a seed draws what it should."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from railrepro import __main__ as command
from railrepro import __version__, paths
from railrepro.evidence import benchmark
from railrepro.evidence.benchmark import NOTHING, cases, drive, known_route
from railrepro.track.route import INDEX, Route
from railrepro.vehicle.parameters import sample_ranges

SLOW = """
class Mine:
    period = 0.005
    def __init__(self, *given): pass
    def plan(self, x_hat, u_d):
        {}
"""
LAW = """
class Own:
    def torque(self, q):
        {}
"""
FAULTS = {
    "no python": ("this is no code", "own.py: SyntaxError: invalid syntax (own.py, line 1)"),
    "throws at import": ("x = 1\nraise ValueError('no\\n  reason')\n", "own.py, line 2: ValueError: no reason"),
    "exits at import": ("import sys\nsys.exit(3)\n", "own.py, line 2: SystemExit: 3"),
    "two classes": (SLOW.format("return 0.0") + LAW.format("return 0"), "found ['Mine', 'Own']"),
    "throws": (SLOW.format("return 1 / 0"), "own.py, line 6: ZeroDivisionError: division by zero"),
    "law without its symbol": (LAW.format("return q.height"), "own.py, line 4: lateral law Own: torque() asks for"),
    "wrong setting": (LAW.format("return 0") + "    tuned = {'equal': {}}", "has the settings ['equal'], there"),
    "derails": (SLOW.format("return 3000.0"), "gear derailed, |y| = 30."),
}


def short(setting, seed=1, end_m=60.0, **sensors):
    """A case of the suite that ends early."""
    (case,) = (case for case in cases(seed, ["curve_T3"]) if case.setting == setting)
    return replace(case, scenario=case.scenario.but(end_m=end_m), sensors=case.sensors | sensors)


ENDS = {"nothing": float("inf"), "best": 0.0, "limit": 0.0}
PID = str(paths.ROOT / "examples/pid.py")


@pytest.mark.parametrize(("text", "said"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_a_line_and_no_points(text, said, tmp_path):
    file = tmp_path / "own.py"
    file.write_text(text)
    row = drive(file, replace(short("paper"), plant={"contact.profile": "cone"}))  # no flange holds it
    assert said in row["failure"] and "\n" not in row["failure"]
    assert benchmark.points(row | ENDS) == 0.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (SLOW.format("__import__('ctypes').string_at(0)"), "its run curve_T3 in the setting paper ended its process"),
        ("while True:\n    pass", "its run curve_T3 in the setting paper was given up after 3 s"),
        (SLOW.format("raise KeyboardInterrupt"), "line 6: KeyboardInterrupt"),
    ],
    ids=["crash", "endless", "interrupt"],
)
def test_a_file_harms_nothing_but_its_own_process(text, said, tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    monkeypatch.setattr(benchmark, "LIMIT", 3.0 if "while" in text else 600.0)
    file = tmp_path / "own.py"
    file.write_text(text)
    assert command.main(["score", str(file)]) == 1
    first, *rest = capfd.readouterr().err.splitlines()
    assert first.startswith(f"{file}: its code runs as you")
    assert len(rest) == 1 and rest[0].startswith("error: own.py") and said in rest[0]


def test_a_class_gets_the_numbers_of_its_setting():
    class Constant:
        tuned = {"paper": {"du": 50.0}}

        def __init__(self, du=0.0):
            self.du = du

        def torque(self, q):
            return self.du

    paper, loop = (drive(Constant, short(setting))["effort_du"] for setting in ("paper", "loop"))
    assert paper == pytest.approx(50.0, rel=0.1) and loop == 0.0


def test_a_controller_knows_neither_friction_nor_irregularities():
    route = short("paper").scenario.route()
    full = np.ones_like(route.cells)
    full[:, INDEX["p"]] = route.cells[:, INDEX["p"]]
    cells = known_route(Route(full, route.length)).cells
    hidden = ["lateral", "ddvertical", "gauge", "poor_le", "poor_ri"]
    for name in (*hidden, "force", "y_ref", "kappa"):
        assert cells[:, INDEX[name]].any() == (name not in hidden), name


def test_points_go_from_no_guidance_to_the_limit():
    row = {"failure": "", "error": 2e-3, "effort_du": 1000.0, "activity_du": 750.0, "utilisation": 0.9}
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


def test_nothing_gets_no_points_and_no_controller_undercuts_the_limit():
    """Without the biases, of which one draw may be kind; three seeds at 280 km/h, within the tolerance of 10 %."""
    quiet = {"lateral.bias": 0.0, "gyro.bias": 0.0}
    draws = [short("loop", k, 300.0, **quiet) for k in (1, 2, 3)]
    least = benchmark.ends_of_the_scale(draws[0])
    assert benchmark.points(drive(NOTHING, draws[0]) | least) == pytest.approx(0.0, abs=1e-6)
    for name in ("ndi_feedforward", "ndi_integral"):
        rows = [drive(name, case) for case in draws]
        assert np.sqrt(np.mean([row["error"] ** 2 for row in rows])) > 0.9 * least["limit"] > 1e-5
        assert np.mean([benchmark.cost(row) for row in rows]) > least["best"]
    for factor, worse in {1.2: quiet | {"lateral.noise": 2e-3}, 1.1: {}}.items():
        assert benchmark.ends_of_the_scale(short("loop", 1, 300.0, **worse))["limit"] > factor * least["limit"]


def test_the_score_is_the_mean_over_groups_of_cases_and_settings():
    head = {"controller": "own", "scenario": "a", "seed": 7, "failure": "left", "points": 0.0}
    full = {"failure": "", "points": 100.0, "y_over_q": 0.5}
    places = {("paper", "a"): [head], ("paper", "b"): [head | full], ("loop", "a"): [head | full]}
    places["loop", "margins"] = [head | full, head]
    rows = [row | {"setting": setting, "group": group} for (setting, group), of in places.items() for row in of]
    long = benchmark.card(pd.DataFrame(rows))
    whole = long.pivot_table(index="metric", columns="setting", values="value")
    assert whole.loc["score"].to_dict() == {"paper": 50.0, "loop": 75.0, "all": 62.5}
    assert whole.loc["margins", "loop"] == 50.0 and whole.loc["y_over_q", "loop"] == 0.5
    assert long[long["metric"] == "failures"]["value"].tolist() == [1.0, 0.0] and (long["seed"] == 7).all()


def test_a_seed_draws_noise_irregularity_and_mismatch():
    first, other, ranges = cases(1), cases(2), sample_ranges()
    assert first == cases(1) and len(first) == 2 * (14 + 16)
    margins = [case for case in first if case.setting == "loop" and case.label["group"] == "margins"]
    seeds = {case.sensors["seed"] for case in margins}
    assert len(seeds) == len(margins) == 16 and 1 not in seeds
    assert {round(1e3 * case.sensors.get("inverter.delay", 0.0)) for case in margins} == {0, 3, 6, 9, 12}
    for one, another in zip(first, other, strict=True):
        name = one.label["scenario"]
        drawn = name == "irregular" or name.startswith("mismatch")
        assert (one != another) == (one.setting == "loop" or drawn)
        assert one.setting == "loop" or not one.sensors or one.sensors["perfect"]
        for key in benchmark.MISMATCH if name.startswith("mismatch") else ():
            assert ranges[key][0] <= one.plant[key] <= ranges[key][1]


def test_the_leaderboard_ranks_by_the_ranked_draws():
    row = {"scenario": "a", "failure": "", "limit": 1e-3, "error": 2e-3, "effort_du": 5.0}
    draws = ((benchmark.PUBLISHED, 0.0), (7, 12.0), (8, 14.0), (9, 16.0))
    rows = [
        row | {"controller": name, "setting": setting, "seed": seed, "points": best - less, "group": group}
        for (name, best), (seed, less) in product((("ndi", 80.0), ("nmpc", 90.0)), draws)
        for setting, group in product(("paper", "loop"), ("a", "margins"))
    ]
    ranked = benchmark.ranking(benchmark.card(pd.DataFrame(rows)))
    assert list(ranked.index) == ["nmpc", "ndi"] and ranked["ranked"].tolist() == [76.0, 66.0]
    assert ranked["margins"].tolist() == [76.0, 66.0] and ranked["limit (mm), loop"].tolist() == [1.0, 1.0]
    assert ranked["spread"].tolist() == pytest.approx([2.0] * 2)


def test_a_score_writes_its_card_and_what_cannot_be_driven_is_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("RAILREPRO_WORKERS", "1")
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(benchmark, "cases", lambda seed, _: cases(seed, ["sine_400"]))
    (tmp_path / "mine.py").write_text(SLOW.format("return None"))
    assert command.main(["score", str(tmp_path / "mine.py")]) == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("error: mine.py: ArithmeticError: the lateral")
    assert command.main(["score", PID, "--seed", "5"]) == 0
    table = pd.read_csv(tmp_path / "score/pid.py-5.csv")
    assert set(table["seed"]) == {5} and set(table["setting"]) == {"paper", "loop"}
    assert np.isfinite(table["points"]).all() and (table["failure"].isna()).all()
    assert "score over both settings" in capsys.readouterr().out


def test_ranked_seeds_of_a_file_follow_from_its_content(tmp_path):
    text, file, seeds = Path(PID).read_bytes(), tmp_path / "mine.py", []
    for content in (text, text.replace(b"\n", b"\r\n"), text.replace(b"20.0", b"20.1")):
        file.write_bytes(content)
        seeds.append(benchmark.ranked_seeds(file))
    one, windows, other = seeds
    assert one == windows == benchmark.ranked_seeds(Path(PID))
    assert not set(one) & {*other, *benchmark.RANKED, benchmark.PUBLISHED}
    assert len(set(one)) == 5 == len(set(other)) and min(one) >= 0 and 2**28 < max(one) < 2**31
    assert benchmark.ranked_seeds("nmpc") == benchmark.RANKED


@pytest.mark.parametrize("metrics", [{"error": 2e-3, "effort_du": 5.0}, {}], ids=["driven", "all runs raised"])
def test_an_entry_has_version_seeds_and_points(metrics, tmp_path, monkeypatch, capsys):
    def quick(of, seeds):
        head = {"controller": of.name, "scenario": "a", "failure": "", "limit": 1e-3} | metrics
        rows = pd.DataFrame(product(seeds, ("paper", "loop"), ("a", "margins")), columns=["seed", "setting", "group"])
        return rows.assign(**head, points=rows["seed"] % 50)

    monkeypatch.setattr(paths, "BUILD", tmp_path)
    monkeypatch.setattr(benchmark, "score", quick)
    assert command.main(["score", PID, "--ranked"]) == 0
    name, *lines, last = capsys.readouterr().out.splitlines()
    found, seeds = {line[:24].strip(): line[24:] for line in lines}, benchmark.ranked_seeds(Path(PID))
    assert name == "pid.py" and last.startswith("written: ")
    assert found["version"] == __version__ and found["seeds"] == " ".join(map(str, seeds))
    assert float(found["ranked"]) == pytest.approx(np.mean([seed % 50 for seed in seeds]), abs=0.01)
    assert set(pd.read_csv(tmp_path / "score/pid.py-ranked.csv")["seed"]) == set(seeds)
