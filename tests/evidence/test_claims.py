"""Report: statements are judged in their settings, sentences are true, each number leads to its table."""

import re

import jinja2
import numpy as np
import pandas as pd
import pytest

from railrepro import paths
from railrepro.control.registry import PAPER_TRIO
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import METRICS, Nominal, result
from railrepro.evidence.claims.setup import setting_of
from railrepro.evidence.report import claims
from railrepro.evidence.report import page as page_
from railrepro.evidence.report.page import Page


def test_each_sentence_of_summary_and_reasons_is_true_and_explains_a_statement(table, nominal):
    assert Page(table, nominal).refuted() == {}
    assert {identity for thesis in page_.theses().values() for identity in thesis.of} <= set(statements.load())


@pytest.mark.parametrize(
    ("holds", "said"), [("not holds('C05', 'paper')", []), ("holds('C05', 'paper')", [(["C04", "C05"], "NDI leads.")])]
)
def test_a_sentence_that_the_tables_refute_is_not_said(holds, said, table, nominal, monkeypatch):
    monkeypatch.setattr(page_, "theses", lambda: {"one": page_.Thesis("NDI leads.", (holds,), "why", ("C04", "C05"))})
    page = Page(table, nominal)
    assert page.sentences("why") == said and page.refuted() == ({} if said else {"one": [holds]})


@pytest.mark.parametrize(
    ("condition", "true"),
    [
        ("e('paper', 'nowhere', 'nmpc', 'rmse_y') < 1", False),
        ("table('nowhere').rmse_mm.min() > 1", False),
        ("holds('C05', 'paper')", True),
        ("holds('C05', 'swarm')", False),
        ("holds('C28', 'calibrated') and not holds('C28', 'paper')", True),
        ("cell('table1', 'printed_m', track='T2') == 0.168", True),
        ("cell('table1', 'printed_m', track='T9') == 0.168", False),
    ],
)
def test_a_condition_is_evaluated_on_the_tables(condition, true, table, nominal):
    assert Page(table, nominal).true(condition) == true


def test_a_number_in_a_sentence_is_that_of_its_table(table, nominal):
    value = 1e3 * nominal.evidence("swarm")("curve_entry_T3", "nmpc", "rmse_y")
    expression = "{{ q('swarm', 'curve_entry_T3', 'nmpc', 'rmse_y', 'mm') }}"
    assert Page(table, nominal).text(expression) == f"[{value:.3g} mm](data/results/nominal_metrics.csv)"


@pytest.mark.parametrize("condition", ["1 < poll", "tuned('ndi').pol > 1", "holds('C99', 'paper')"])
def test_a_condition_on_what_does_not_exist_is_an_error(condition, table, nominal):
    with pytest.raises((jinja2.UndefinedError, KeyError)):
        Page(table, nominal).true(condition)


def test_a_click_leads_from_statement_to_figure_chapter_and_table(table, nominal):
    page = Page(table, nominal).replication()
    for target in re.findall(r"\]\(([^)#]+)\)", page):
        assert (paths.ROOT / target).exists(), target
    judged = table.query("verdict != 'not testable'")
    assert (judged["data"] != "").all(), "also where nobody stayed on the rail"
    assert all(f"]({path})" in page for data in judged["data"] for path in data.split())


@pytest.mark.parametrize("name", sorted(set(statements.TABLES.values())))
def test_a_predicate_reads_its_own_setting_of_the_table_that_is_named(name, nominal):
    """Wrong values in rows of other settings change nothing, nor do other tables."""
    table, reading = result(name), [identity for identity, own in statements.TABLES.items() if own == name]
    for setting in ("", *nominal.settings()):
        own = setting if name == METRICS else setting_of(setting)
        wrong = table["setting"] != own if "setting" in table else pd.Series(False, table.index)
        masked = table.assign(**{c: table[c].mask(wrong, -7.0) for c in table.select_dtypes("number")})
        alone = statements.findings(Nominal({name: masked}.get).evidence(setting))
        found = statements.findings(nominal.evidence(setting))
        assert [repr(found.get(i)) for i in reading] == [repr(alone.get(i)) for i in reading]


def test_each_statement_that_is_not_reproduced_has_a_reason(table, nominal):
    page = Page(table, nominal)
    told = {identity for of, _ in page.sentences("why") for identity in of}
    assert told == {identity for identity, verdict in page.statements.items() if verdict != "reproduced"}
    contract = page.contract()
    rows = contract[contract["setting"].isin(("", "paper")) & (contract["kind"] == "statement")]
    assert ((rows["why"] == "") == (rows["judged"] == "reproduced")).all()
    assert not contract["why"].str.contains("](", regex=False).any()


T3 = "curve_entry_T3"


def handed(rows, **tables):
    """Results with rows of metrics, as the probe writes them."""
    columns = ["scenario", "controller", "metric", "value", "unit", "setting", "swarm", "seed"]
    return {"nominal_metrics": pd.DataFrame(rows, columns=columns), **tables}.get


def test_the_tuned_set_counts_and_a_run_that_failed_makes_all_fail():
    values = [("ndi", "rmse_y", 1.0, 0), ("ndi", "rmse_y", 3.0, 0), ("ndi", "rmse_y", 4.0, 1)]
    values += [("nmpc", "failed", 0.0, 0), ("nmpc", "failed", 1.0, 0)]
    rows = [(T3, name, metric, value, "m", "loop", swarm, 101) for name, metric, value, swarm in values]
    found = Nominal(handed(rows)).evidence("loop")
    assert found.metrics == {(T3, "ndi", "rmse_y"): 2.0, (T3, "nmpc", "failed"): 1.0}
    assert found.spread[T3, "ndi", "rmse_y"] == pytest.approx(np.log(4.0)), "over swarms and noise"
    assert found.spread[T3, "nmpc", "rmse_y"] == float("inf")


def on_setting(**ndi):
    """Errors in the settings: 1 mm for both MPC, as given for NDI; 5 % larger with another swarm."""
    return [
        (T3, name, "rmse_y", factor * (value if name == "ndi" else 1e-3), "m", setting, swarm, 0)
        for setting, value in ndi.items()
        for name in PAPER_TRIO
        for swarm, factor in ((0, 1.0), (1, 1.05))
    ]


def test_statements_that_compare_are_judged_on_each_setting():
    nominal = Nominal(handed(on_setting(paper=2e-3, swarm=5e-4, loop=1.02e-3)))
    found = claims.evaluate(nominal).set_index(["id", "setting"])["judged"]
    assert found["C05"].to_dict() == {"paper": "reproduced", "swarm": "not reproduced", "loop": "tie"}
    assert found["C13"].to_dict() == {"": "not testable"}


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [
        ({"paper": "reproduced", "swarm": "not reproduced"}, "reproduced"),
        ({"paper": "not reproduced", "swarm": "reproduced", "loop": "reproduced"}, "not reproduced"),
        ({"paper": "tie", "swarm": "reproduced"}, "tie"),
        ({"": "fragile"}, "fragile"),
        ({"swarm": "reproduced"}, "not testable"),
    ],
)
def test_the_headline_is_the_verdict_on_paper_and_never_the_best_of_three(verdicts, expected):
    rows = pd.DataFrame({"setting": verdicts.keys(), "judged": verdicts.values(), "kind": "statement"})
    assert claims.headline(rows) == expected
    assert claims.headline(rows.assign(kind="calibrated")) == "no verdict"


@pytest.mark.parametrize(
    ("held", "of", "expected"), [(90, 128, "reproduced"), (70, 128, "fragile"), (20, 128, "fragile"), (3, 3, "fragile")]
)
def test_a_verdict_is_fragile_where_the_interval_of_its_share_is_not_above_one_half(held, of, expected):
    metrics = {f"{T3}/nmpc/rmse_y": 1e-3, f"{T3}/ltv_mpc_printed/rmse_y": 1e-3}
    samples = pd.DataFrame({f"{T3}/ndi/rmse_y": held * [2e-3] + (of - held) * [5e-4], "number": range(of)})
    samples = samples.assign(setting="paper", profile="cone", ltv="ltv_mpc_printed", **metrics)
    table = claims.evaluate(Nominal(handed(on_setting(paper=2e-3), robustness_samples=samples)))
    row = table[(table["id"] == "C05") & (table["setting"] == "paper")].iloc[0]
    assert row["judged"] == expected and row["share"] == held / of
    assert row["verdict"] == {"fragile": "partly"}.get(expected, expected)
