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


def given(**answers):
    return {
        key: value for each in answered(**answers).values() for key, value in zip(each.sets, each.answer, strict=True)
    }


def test_answers_reach_the_car_the_controllers_and_the_experiments():
    world = setup(
        given(friction=[0.11], poles=[42.0, 42.0], sweep=[4.0, 160.0, 70.0], profile=["s1002"], r_brake=[5.0, 4.0])
        | given(brake_sweep=[3.0, 100.0, 20.0])
    )
    assert world.car().adhesion["poor"].mu0 == 0.11 and world.car().contact.profile == "s1002"
    assert world.parameters["ndi"]["pole"] == world.parameters["ndi"]["frequency"] == 42.0
    assert (world.amplitude_mm, world.period_start_m, world.period_end_m) == (4.0, 160.0, 70.0)
    assert (world.r_brake, world.r_second) == (5.0, 4.0) and world.braking().set_point["period_end_m"] == 20.0
    assert world.parameters["nmpc"] == tuning.load("nmpc", "paper")["parameters"], "what is not answered stays"
    nmpc = world.parameters["nmpc"]
    assert setup({"ltv_mpc_printed.r": 3.0}).parameters["ltv_mpc_printed"] == with_r_times(nmpc, 3.0)
    triple = setup({"ndi.pole": 40.0}).parameters["ndi"]
    assert triple == {"pole": 40.0, "frequency": 40.0, "damping": 1.0}
    equal = setup({}, given(tuning_runs=["equal"])["setting"])
    assert equal.parameters == {name: tuning.load(name, "equal")["parameters"] for name in PAPER_TRIO}


def test_each_question_sets_what_there_is():
    of_probe = {field.name: field.default for field in fields(probe.ProbeSetup)}
    for question in flips.load().values():
        for target in set(question.sets) - {"setting"}:
            setup({target: of_probe.get(target, 0.5)}).car()


def test_only_what_depends_on_an_answer_is_driven(monkeypatch):
    driven = []
    monkeypatch.setattr(probe, "probe", lambda world, parts: driven.append((world, parts)) or [])
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


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("answer = []", "answer = [1.0, 2.0]", "tuning_runs has 2 answers, 1 or 1 are needed"),
        ('parts = ["loss"]', 'parts = ["lost"]', "r_loss has the part 'lost', allowed are curve"),
        ("asks = ", "ask = ", "tuning_runs.*ask"),
    ],
)
def test_a_wrong_file_is_told_in_a_sentence(old, new, sentence, tmp_path):
    text = (paths.ROOT / "data/answers.toml").read_text()
    (tmp_path / "mine.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=f"^mine.toml: {sentence}"):
        flips.load(tmp_path / "mine.toml")


def test_an_answer_that_nothing_has_or_the_car_refuses_is_told_before_anything_runs():
    for wrong in ("colour", "pid:gain", "vehicle:drive.lag"):
        with pytest.raises(InputError, match="which nothing has"):
            setup({wrong: 1.0})
    with pytest.raises(InputError, match=r"drive\.torque"):
        setup({"drive.torque": 1.0}).car()


def test_the_command_prints_what_flips(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(probe, "probe", lambda world, parts: [])
    text = (paths.ROOT / "data/answers.toml").read_text()
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert command.main(["probe", str(file)]) == 1 and "mine.toml: has no answer" in capsys.readouterr().err
    file.write_text(text.replace("answer = []", 'answer = ["paper"]', 1))
    assert command.main(["probe", str(file)]) == 0 and "1 answers, " in capsys.readouterr().out
    assert command.main(["probe", str(file), "paper"]) == 1
