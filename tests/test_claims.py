"""Claims and report: complete, evaluated from results, verdicts changed on purpose only; a small robustness study."""

import re

import pandas as pd
import pytest

from railrepro import paths
from railrepro.errors import InputError
from railrepro.report import claims
from railrepro.report.text import render
from railrepro.studies import robustness

RESULTS = paths.ROOT / "data/results"
needs_results = pytest.mark.skipif(
    not (RESULTS / "braking_front.csv").exists(), reason="data/results is not made yet (make figures)"
)


def test_every_claim_has_a_function_and_every_function_a_claim():
    known = claims.load_claims()
    assert set(known) == set(claims.MEASURES)
    assert len(known) >= 25
    assert {claim["kind"] for claim in known.values()} >= {"value", "ratio", "ordering", "trend", "behaviour"}


def test_evidence_exists():
    for identity, claim in claims.load_claims().items():
        if claim["evidence"].startswith("fig"):
            assert (paths.FIGURES / f"{claim['evidence']}.png").exists(), identity
        elif claim["evidence"]:
            assert (paths.ROOT / claim["evidence"]).exists(), identity
        if claim["notebook"]:
            assert (paths.NOTEBOOKS / f"{claim['notebook']}.ipynb").exists(), identity


@needs_results
def test_a_click_leads_from_claim_to_cell_and_data():
    table = claims.evaluate()
    text = render(table, claims.load_claims())
    links = re.findall(r"\]\(([^)#]+)(?:#cell-id=(\w+))?\)", text)
    for target, cell in links:
        assert (paths.ROOT / target).exists(), target
        assert not cell or f'"id": "{cell}"' in (paths.ROOT / target).read_text(), (target, cell)
    judged = table.query("kind != 'not testable' and data != ''")
    assert len(judged) >= 35
    assert all(f"[{path.rsplit('/', 1)[-1]}]({path})" in text for data in judged["data"] for path in data.split())


@needs_results
def test_verdicts_are_those_that_were_stored_on_purpose():
    table = claims.evaluate()
    assert claims.changed(table) == []
    assert set(table["verdict"]) <= set(claims.VERDICTS)


@needs_results
def test_a_changed_result_changes_the_verdict(monkeypatch):
    class Turned(claims.Results):
        @property
        def curve(self):
            table = super().curve.copy()
            table["rmse_y"] = 1 / table["rmse_y"]
            return table

    claim = claims.load_claims()["C06"]
    before = claims.MEASURES["C06"](claims.Results(), claim)
    after = claims.MEASURES["C06"](Turned(), claim)
    assert before.value != after.value


@needs_results
def test_report_names_every_claim_and_discrepancy():
    known = claims.load_claims()
    text = render(claims.evaluate(), known)
    assert all(claim["statement"] in text for claim in known.values())
    assert all(f"| D{i} |" in text for i in range(1, 11))
    assert (paths.ROOT / "REPLICATION.md").read_text() == text


def test_missing_results_are_told_in_one_sentence(monkeypatch):
    with pytest.raises(InputError, match=r"nothing.csv: is missing; `make figures` makes it"):
        claims.Results()["nothing"]


def test_samples_cover_the_ranges_and_are_reproducible():
    samples = robustness.draw(16)
    assert samples == robustness.draw(16)
    radii = [dict(s.vehicle)["wheel.radius"] for s in samples]
    assert 0.43 <= min(radii) < 0.45 and 0.48 < max(radii) <= 0.5
    assert {s.profile for s in samples} == {"cone", "s1002"}


def test_a_sample_answers_the_claims():
    samples = robustness.draw(2)[:1]
    table = pd.DataFrame([robustness.evaluate(s) for s in samples])
    found = robustness.verdicts(table, samples)
    assert {"C05", "C06", "C19", "C30"} <= set(found["id"])
    assert set(found["id"]) <= set(claims.MEASURES)
    assert found["share"].between(0, 1).all()
