"""Answers to open questions: slots reach the probe, only what depends on them is driven, wrong ones get a sentence."""

from dataclasses import fields, replace

import pytest

from railrepro import __main__ as command
from railrepro import paths
from railrepro.control.registry import PAPER_TRIO, with_r_times
from railrepro.data import InputError
from railrepro.evidence.claims import probe
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.setup import setup
from railrepro.evidence.report import flips
from railrepro.evidence.runs import tuning

T3 = "curve_entry_T3"


def answered(**given):
    """Questions of data/answers.toml with some answers."""
    questions = flips.load()
    return {name: replace(questions[name], answer=tuple(values)) for name, values in given.items()}


@pytest.fixture
def driven(monkeypatch):
    """Set-ups and parts that the probe is asked for."""
    found = []
    monkeypatch.setattr(probe, "probe", lambda world, parts: found.append((world, parts)) or [])
    return found


def test_answers_reach_the_car_the_controllers_and_the_experiments(driven):
    flips.flips(answered(friction=[0.11], poles=[42.0], sweep=[4.0, 160.0, 70.0], profile=["s1002"]))
    flips.flips(answered(brake_sweep=[3.0, 100.0, 20.0], r_brake=[5.0, 4.0], tuning_runs=["equal"]))
    world, equal = (world for world, _ in driven)
    assert world.car().adhesion["poor"].mu0 == 0.11 and world.car().contact.profile == "s1002"
    assert world.parameters["ndi"]["pole"] == world.parameters["ndi"]["frequency"] == 42.0
    assert (world.amplitude_mm, world.period_start_m, world.period_end_m) == (4.0, 160.0, 70.0)
    assert (equal.r_brake, equal.r_second) == (5.0, 4.0)
    nmpc = tuning.load("nmpc", "paper")["parameters"]
    assert world.parameters["nmpc"] == nmpc, "what is not answered stays"
    assert equal.braking().set_point["period_end_m"] == 20.0
    assert equal.parameters == {name: tuning.load(name, "equal")["parameters"] for name in PAPER_TRIO}
    assert setup({"ltv_mpc_printed.r": 3.0}).parameters["ltv_mpc_printed"] == with_r_times(nmpc, 3.0)


def test_each_question_sets_what_there_is():
    of_probe = {field.name: field.default for field in fields(probe.ProbeSetup)}
    for question in flips.load().values():
        for target in set(question.sets) - {"setting"}:
            setup({target: of_probe.get(target, 0.5)}).car()


def test_only_what_depends_on_an_answer_is_driven(driven):
    flips.flips(answered(sweep=[3.0, 150.0, 40.0]))
    flips.flips(answered(r_loss=[10.0], r_brake=[2.0, 5.0]))
    flips.flips(answered(torque=[4000.0]))
    assert [parts for _, parts in driven] == [["curve"], ["loss", "brake"], list(probe.PARTS)]
    assert driven[1][0].r_loss == 10.0 and driven[2][0].car().drive.torque_limit == 4000.0


def test_which_verdicts_flip():
    """NDI is driven to the front on T3 by hand; what was not driven keeps its verdict, fragile ones too."""
    nominal = Nominal().evidence("paper").metrics
    driven = [(*key, value) for key, value in dict(nominal).items() if key[0] == T3]
    same = flips.flips(answered(sweep=[3.0, 150.0, 40.0]), driven).set_index("id")
    assert (same["before"] == same["after"]).all() and {"C05", "C20", "C31"} <= set(same.index)
    assert "fragile" in set(same["before"])
    ahead = [(*row[:3], 1e-5) if row[1:3] == ("ndi", "rmse_y") else row for row in driven]
    found = flips.flips(answered(sweep=[3.0, 150.0, 40.0]), ahead).set_index("id")
    assert found.loc["C05", ["before", "after"]].tolist() == ["reproduced", "not reproduced"]
    assert found.loc["C20", "before"] == found.loc["C20", "after"] == "reproduced"


def test_an_answer_that_nothing_has_or_the_car_refuses_is_told_before_anything_runs():
    for wrong in ("colour", "pid:gain", "vehicle:drive.lag"):
        with pytest.raises(InputError, match="which nothing has"):
            setup({wrong: 1.0})
    with pytest.raises(InputError, match=r"drive\.torque"):
        setup({"drive.torque": 1.0}).car()


def test_the_command_prints_what_flips(driven, capsys, tmp_path):
    text = (paths.ROOT / "data/answers.toml").read_text()
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert command.main(["probe", str(file)]) == 1 and "mine.toml: has no answer" in capsys.readouterr().err
    file.write_text(text.replace("answer = []", 'answer = ["paper"]', 1))
    assert command.main(["probe", str(file)]) == 0 and "1 answers, " in capsys.readouterr().out
    assert command.main(["probe", str(file), "paper"]) == 1
