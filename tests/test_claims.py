"""Report: statements are judged in their settings, verdicts change on purpose only, each number leads to its table."""

import re

import numpy as np
import pandas as pd
import pytest

from railrepro import paths
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.report import claims, reasons
from railrepro.evidence.report.evidence import Nominal, Results, best, seeds_spread
from railrepro.evidence.report.text import render

RESULTS = paths.ROOT / "data/results"
needs_results = pytest.mark.skipif(
    not (RESULTS / "braking_front.csv").exists(), reason="data/results is not made yet (make figures)"
)


def test_every_statement_has_a_predicate_and_every_predicate_a_statement():
    known = statements.load()
    assert {i for i, s in known.items() if s.kind == "statement"} == set(statements.VALUES)
    assert all(statement.notebook for statement in known.values())
    for statement in known.values():
        assert (paths.NOTEBOOKS / f"{statement.notebook}.ipynb").exists()


def test_what_may_fail_says_why():
    """Whoever is not reproduced has a reason and a condition ready."""
    settled = ("reproduced", "no verdict", "not testable")
    stored = {i: s for i, s in statements.load().items() if s.verdict not in settled}
    assert stored
    assert [i for i, s in stored.items() if not (s.why and s.holds_if)] == []


@needs_results
def test_the_contract_of_the_table(table):
    head = "id paper_ref statement kind setting paper_value measured_value unit verdict share share_low share_high"
    assert list(table.columns[:14]) == [*head.split(), "why", "evidence"]
    assert set(table["verdict"]) <= set(statements.VERDICTS)
    assert set(table["setting"]) <= {"", "paper", "equal", "loop"}
    assert set(table["id"]) == set(statements.load())


@needs_results
def test_verdicts_are_those_that_were_stored_on_purpose(table):
    assert claims.changed(table) == []


@needs_results
def test_a_click_leads_from_statement_to_figure_cell_and_table(table, nominal):
    text = render(table, nominal)
    for target, cell in re.findall(r"\]\(([^)#]+)(?:#cell-id=(\w+))?\)", text):
        assert (paths.ROOT / target).exists(), target
        assert not cell or f'"id": "{cell}"' in (paths.ROOT / target).read_text(), (target, cell)
    judged = table.query("verdict != 'not testable'")
    assert (judged["data"] != "").all(), "also where nobody stayed on the rail"
    assert all(f"]({path})" in text for data in judged["data"] for path in data.split())


@needs_results
def test_a_run_that_failed_leads_to_the_table_that_says_so(nominal):
    for identity in ("C24", "C28", "C50"):
        found, files = nominal.traced(lambda name=identity: statements.find(name, nominal.evidence("paper", False)))
        assert not np.isfinite(found.value) and files == ["data/results/settings_metrics.csv"]
    value, files = nominal.traced(lambda: nominal.evidence("equal")("curve_entry_T3", "nmpc", "rmse_y"))
    assert files == ["data/results/curve_entry_metrics.csv"], "a run that did not fail is no source"


@needs_results
def test_whoever_is_not_reproduced_or_fragile_says_why_and_when_it_would_hold(table, nominal):
    text = render(table, nominal)
    known = statements.load()
    for identity, verdict in claims.verdicts(table).items():
        rows = table[table["id"] == identity]
        if verdict in (statements.REPRODUCED, claims.NO_VERDICT):
            continue
        reasons_given = text.partition(f"- **{identity}**, why: ")[2].split("\n- **")[0]
        assert reasons.filled(known[identity].why, nominal, linked=True) in reasons_given, identity
        assert len(reasons_given) > 40 and "\n  Would hold if " in reasons_given, identity
        sentences = re.split(r"(?<=\.) (?=[A-Z`])", reasons_given.partition("\n")[0])
        assert len(sentences) == len(set(sentences)), f"{identity} says something twice"
        assert (rows[rows["verdict"] != "reproduced"]["why"] != "").all(), identity


@needs_results
def test_the_summary_is_a_page_with_one_table(table, nominal):
    summary = render(table, nominal).partition("## Summary\n")[2].partition("\n## ")[0]
    rows = [line for line in summary.splitlines() if line.startswith("|")]
    assert sum(line.startswith("|---") for line in rows) == 1
    words = re.sub(r"\]\([^)]*\)", "]", "\n".join(line for line in summary.splitlines() if line not in rows)).split()
    assert 250 <= len(words) <= 350
    bare, links = re.subn(r"\[[\d.]+\]\(data/results/\w+\.csv\)", "", "\n".join(rows))
    assert links > 20 and not re.search(r"\d\.\d", bare), "each number of the table is a link"


@needs_results
@pytest.mark.parametrize(("key", "sentence"), [("{poll}", "is no number of the prose"), ("[[poll]]", "is no block")])
def test_a_wrong_key_of_the_page_is_told_with_its_line(key, sentence, table, nominal, monkeypatch, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/replication_page.md").write_text(f"# Title\n{key}\n")
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    with pytest.raises(InputError, match=f"^replication_page.md line 2: .*{sentence}; there are "):
        render(table, nominal)


@needs_results
def test_the_page_is_generated_whole(table, nominal):
    text = render(table, nominal)
    assert all(statement.statement in text for statement in statements.load().values())
    assert all(f"| D{i} |" in text for i in range(1, 11))
    assert (paths.ROOT / "REPLICATION.md").read_text() == text
    assert not re.search(r"\{\w+", text), "a placeholder is left"


HEAD = ["scenario", "controller", "metric", "value", "unit", "setting", "swarm", "seed"]
SCHEMA = [
    ("curve_entry_T3", "ndi", "rmse_y", 1.0, "m", "loop", 4, 101),
    ("curve_entry_T3", "ndi", "rmse_y", 3.0, "m", "loop", 4, 102),
    ("curve_entry_T3", "ndi", "rmse_y", 4.0, "m", "loop", 7, 101),
    ("curve_entry_T3", "nmpc", "failed", 0.0, "-", "loop", 4, 101),
    ("curve_entry_T3", "nmpc", "failed", 1.0, "-", "loop", 4, 102),
]


def test_the_best_swarm_counts_and_a_run_that_failed_makes_all_fail():
    rows = pd.DataFrame(SCHEMA, columns=HEAD)
    found = best(rows, "loop")
    assert found["curve_entry_T3", "ndi", "rmse_y"] == 2.0
    assert found["curve_entry_T3", "nmpc", "failed"] == 1.0


def test_the_spread_is_over_swarms_and_noise():
    found = seeds_spread(pd.DataFrame(SCHEMA, columns=HEAD))
    assert found["curve_entry_T3", "ndi", "rmse_y"] == pytest.approx(1.3863, abs=1e-4)
    assert found["curve_entry_T3", "nmpc", "rmse_y"] == float("inf")


class Handed(Results):
    """Results with a table of setting that was handed in, in the form of notebook 14."""

    def __init__(self, rows):
        super().__init__()
        self._rows = rows

    def optional(self, name):
        return pd.DataFrame(self._rows, columns=HEAD) if name == "settings_metrics" else None


def on_setting(nmpc, printed, ndi, *more):
    rows = []
    for setting in ("paper", "equal", "loop"):
        for name, value in (("nmpc", nmpc), ("ltv_mpc_printed", printed), ("ndi", ndi)):
            for swarm, factor in ((1, 1.0), (2, 1.05)):
                rows.append(("curve_entry_T3", name, "rmse_y", factor * value[setting], "m", setting, swarm, 0))
    return [*rows, *more]


VALUES = {"paper": 1e-3, "equal": 1e-3, "loop": 1e-3}


@needs_results
def test_statements_that_compare_are_judged_on_each_setting():
    rows = on_setting(VALUES, VALUES, {"paper": 2e-3, "equal": 5e-4, "loop": 1.02e-3})
    nominal = Nominal(Handed(rows))
    statement = statements.load()["C05"]
    assert claims.judged_on("C05", statement, nominal) == ["paper", "equal", "loop"]
    assert claims.judged_on("C13", statements.load()["C13"], nominal) == [""]
    found = {}
    for setting in ("paper", "loop"):
        finding = statements.find("C05", nominal.evidence(setting))
        found[setting] = statement.judge(finding), statement.tied(finding)
    assert found == {"paper": ("reproduced", False), "loop": ("partly", True)}


@needs_results
def test_where_a_run_left_the_rail_it_counts_as_failed():
    rows = [("curve_entry_T3", "nmpc", "failed_at_m", 90.0, "m", "loop", 1, 0)]
    rows += [r for r in on_setting(VALUES, VALUES, VALUES) if (r[1], r[5]) != ("nmpc", "loop")]
    evidence = Nominal(Handed(rows)).evidence("loop")
    assert evidence("curve_entry_T3", "nmpc", "rmse_y") == float("inf")


def rows(*verdicts, nominal=None, kind="statement"):
    table = pd.DataFrame({"setting": ["paper", "equal", "loop"][: len(verdicts)], "verdict": verdicts, "kind": kind})
    return table.assign(nominal=nominal or list(verdicts))


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (rows("reproduced", "reproduced", "reproduced"), "reproduced"),
        (rows("reproduced", "not reproduced", "reproduced"), "reproduced in setting paper, loop"),
        (rows("partly", "not reproduced", nominal=["reproduced", "not reproduced"]), "fragile"),
        (rows("partly", "not reproduced"), "partly"),
        (rows("not reproduced"), "not reproduced"),
        (rows("not testable"), "not testable"),
        (rows("not testable", kind="calibrated"), "no verdict"),
    ],
)
def test_the_verdict_over_all_settings(table, expected):
    assert claims.overall(table) == expected


def test_missing_results_are_told_in_one_sentence():
    with pytest.raises(InputError, match=r"nothing.csv: is missing; `make figures` makes it"):
        Results()("nothing")


@needs_results
def test_numbers_in_the_prose_come_from_tables(nominal):
    text = reasons.filled("{equal: curve_entry_T3/nmpc/rmse_y mm}, {equal: nowhere/nmpc/rmse_y}", nominal)
    value = 1e3 * nominal.evidence("equal")("curve_entry_T3", "nmpc", "rmse_y")
    assert text == f"{value:.3g} mm, n/a"
    assert all(
        re.match(r"^[\d.e+-]+( \w+| %| \(.*\)|( mm, .* m))?$|^n/a$", found(nominal)) for found in reasons.NAMED.values()
    )
