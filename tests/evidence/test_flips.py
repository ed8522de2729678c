"""Answers to open questions: slots reach the probe, only what depends on them is driven, wrong ones get a sentence."""

from dataclasses import fields, replace

import pytest

from railrepro import __main__ as command
from railrepro import paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.data import InputError
from railrepro.evidence.claims import probe
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.setup import setup
from railrepro.evidence.report import flips
from railrepro.tuning import sets


def answered(**given):
    """Questions of data/answers.toml with some answers."""
    questions = flips.load()
    return {name: replace(questions[name], answer=tuple(values)) for name, values in given.items()}


@pytest.fixture
def driven(monkeypatch):
    """Set-ups and parts that the probe is asked for."""
    found = []
    monkeypatch.setattr(probe, "probe", lambda world, parts: found.append((world, parts)) or {})
    return found


def test_answers_reach_the_probe_which_drives_only_what_depends_on_them(driven):
    flips.flips(answered(friction=[0.11], poles=[42.0], sweep=[4.0, 160.0, 70.0]))
    flips.flips(answered(brake_sweep=[3.0, 100.0, 20.0], r_brake=[5.0, 4.0], ndi_search=["swarm"]))
    flips.flips(answered(r_loss=[10.0], r_brake=[2.0, 5.0]))
    (world, _), (searched, _), (_, parts) = driven
    assert world.car().adhesion["poor"].mu0 == 0.11 and world.parameters["ndi"]["frequency"] == 42.0
    assert (world.amplitude_mm, world.period_start_m, world.period_end_m, searched.r_second) == (4.0, 160.0, 70.0, 4.0)
    assert world.parameters["nmpc"] == sets.load("nmpc", "paper")["parameters"], "what is not answered stays"
    assert searched.scenario("braking").set_point["period_end_m"] == 20.0
    found = {name: "ndi_swarm" if name == "ndi" else name for name in PAPER_TRIO}
    assert searched.parameters == {name: sets.load(of)["parameters"] for name, of in found.items()}
    assert parts == ["loss", "brake"]


def test_each_question_sets_what_there_is():
    of_probe = {field.name: field.default for field in fields(probe.ProbeSetup)} | {"profile": "cone"}
    for question in flips.load().values():
        for target in set(question.sets) - {"column"}:
            setup({target: of_probe.get(target, 0.5)}).car()
    with pytest.raises(InputError, match="is no choice of the probe"):
        setup({"pid:gain": 1.0})


def test_which_verdicts_flip(monkeypatch, capsys, tmp_path):
    """NDI is driven to the front on T3 by hand; what was not driven keeps its verdict."""
    nominal = Nominal().evidence("paper").metrics
    rows = {key: value for key, value in nominal.items() if key[0] == "curve_entry_T3"}
    monkeypatch.setattr(probe, "probe", lambda world, parts: rows)
    same = flips.flips(answered(sweep=[3.0, 150.0, 40.0])).set_index("id")
    assert (same["before"] == same["after"]).all() and {"C05", "C20", "C31"} <= set(same.index)
    rows["curve_entry_T3", "ndi", "rmse_y"] = 1e-5
    found = flips.flips(answered(sweep=[3.0, 150.0, 40.0])).set_index("id")
    assert found.loc["C05", ["before", "after"]].tolist() == ["reproduced", "not reproduced"]
    assert found.loc["C18", "before"] == found.loc["C18", "after"] == "reproduced"
    text = (paths.ROOT / "data/answers.toml").read_text()
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert command.main(["probe", str(file)]) == 1 and "mine.toml: has no answer" in capsys.readouterr().err
    file.write_text(text.replace("answer = []", 'answer = ["paper"]', 1))
    assert command.main(["probe", str(file)]) == 0 and "C05: reproduced -> not reproduced" in capsys.readouterr().out
