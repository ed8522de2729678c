"""Answers to open questions reach the probe, and only the runs that depend on them are simulated."""

from dataclasses import fields, replace

import pytest

from railrepro import __main__ as command
from railrepro import paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.data import InputError
from railrepro.evidence.claims import probe
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.setup import ProbeSetup, setup
from railrepro.evidence.report import flips
from railrepro.tuning import sets


def answered(**given):
    """Questions of data/answers.toml with some answers."""
    return {name: replace(flips.load()[name], answer=tuple(values)) for name, values in given.items()}


def test_answers_reach_the_probe_which_drives_only_what_depends_on_them(monkeypatch):
    asked = []
    monkeypatch.setattr(probe, "probe", lambda world, parts: asked.append((world, parts)) or {})
    flips.flips(answered(friction=[0.11], poles=[42.0], sweep=[4.0, 160.0, 70.0]))
    flips.flips(answered(brake_sweep=[3.0, 100.0, 20.0], r_brake=[5.0, 4.0], ndi_search=["swarm"]))
    flips.flips(answered(r_loss=[10.0], r_brake=[2.0, 5.0]))
    (world, _), (searched, _), (_, parts) = asked
    assert world.car().adhesion["poor"].mu0 == 0.11 and world.parameters["ndi"]["frequency"] == 42.0
    assert (world.amplitude_mm, world.period_start_m, world.period_end_m, searched.r_second) == (4.0, 160.0, 70.0, 4.0)
    assert world.parameters["nmpc"] == sets.load("nmpc", "paper")["parameters"], "what is not answered stays"
    assert searched.scenario("braking").set_point["period_end_m"] == 20.0
    named = {name: "ndi_swarm" if name == "ndi" else name for name in PAPER_TRIO}
    assert searched.parameters == {name: sets.load(of)["parameters"] for name, of in named.items()}
    assert parts == ["loss", "brake"]


def test_each_question_sets_what_there_is():
    known = {field.name: field.default for field in fields(ProbeSetup)} | {"profile": "cone"}
    for target in {target for question in flips.load().values() for target in question.sets} - {"column"}:
        setup({target: known.get(target, 0.5)}).car()
    with pytest.raises(InputError, match="is no choice of the probe"):
        setup({"pid:gain": 1.0})


def test_which_verdicts_flip(monkeypatch, capsys, tmp_path):
    """The error of NDI on T3 is set to nearly zero; other verdicts stay."""
    metrics = Nominal().evidence("paper").metrics
    rows = {key: value for key, value in metrics.items() if key[0] == "curve_entry_T3"}
    monkeypatch.setattr(probe, "probe", lambda world, parts: rows)
    same = flips.flips(answered(sweep=[3.0, 150.0, 40.0])).set_index("id")
    assert (same["before"] == same["after"]).all() and {"C05", "C20", "C31"} <= set(same.index)
    rows["curve_entry_T3", "ndi", "rmse_y"] = 1e-5
    changed = flips.flips(answered(sweep=[3.0, 150.0, 40.0])).set_index("id")
    assert changed.loc["C05", ["before", "after"]].tolist() == ["reproduced", "not reproduced"]
    assert changed.loc["C18", ["before", "after"]].tolist() == ["reproduced", "reproduced"]
    text, file = (paths.ROOT / "data/answers.toml").read_text(), tmp_path / "mine.toml"
    file.write_text(text)
    assert command.main(["probe", str(file)]) == 1 and "mine.toml: has no answer" in capsys.readouterr().err
    file.write_text(text.replace("answer = []", 'answer = ["paper"]', 1))
    assert command.main(["probe", str(file)]) == 0 and "C05: reproduced -> not reproduced" in capsys.readouterr().out
