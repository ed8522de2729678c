"""Report: statements are judged in their settings, verdicts change on purpose only, each number leads to its table."""

import re

import pandas as pd
import pytest

from railrepro import paths
from railrepro.data import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal, Results, best_swarms, seeds_spread
from railrepro.evidence.report import claims, prose
from railrepro.evidence.report.page import Page
from railrepro.evidence.report.prose import Prose

RESULTS = paths.ROOT / "data/results"
needs_results = pytest.mark.skipif(
    not (RESULTS / "nominal_metrics.csv").exists(), reason="data/results is not made yet (make figures)"
)


def test_every_statement_has_a_predicate_and_every_predicate_a_statement():
    known = statements.load()
    assert {i for i, s in known.items() if s.kind == "statement"} == set(statements.VALUES)
    assert all(statement.notebook for statement in known.values())
    for statement in known.values():
        assert (paths.NOTEBOOKS / f"{statement.notebook}.ipynb").exists()


@needs_results
def test_each_sentence_of_summary_and_reasons_is_true(nominal):
    assert Prose(nominal).refuted() == {}


@needs_results
def test_a_sentence_that_the_tables_refute_is_not_said(nominal, monkeypatch):
    thesis = prose.Thesis("NDI leads.", ("not holds('C05', 'paper')",), "why", ("C04",))
    monkeypatch.setattr(prose, "load", lambda: {"wrong": thesis})
    assert Prose(nominal).reasons("C04") == ""
    assert Prose(nominal).refuted() == {"wrong": ["not holds('C05', 'paper')"]}
    right = prose.Thesis("NDI leads.", ("holds('C05', 'paper')",), "why", ("C04",))
    monkeypatch.setattr(prose, "load", lambda: {"right": right})
    assert Prose(nominal).reasons("C04") == "NDI leads."


@needs_results
@pytest.mark.parametrize(
    ("condition", "true"),
    [
        ("1 < 2 < 1.5", False),
        ("e('paper', 'nowhere', 'nmpc', 'rmse_y') < 1", False),
        ("e('paper', 'nowhere', 'nmpc', 'rmse_y') > 1", False),
        ("table('nowhere').rmse_mm.min() > 1", False),
        ("e('paper', 'curve_entry_T3', 'nothing', 'rmse_y') < 0.003", True),
        ("20 < tuned('ndi').pole < 40", True),
        ("holds('C05', 'paper')", True),
        ("holds('C05', 'equal')", False),
        ("holds('C04', 'calibrated') and not holds('C04', 'paper')", True),
        ("cell('table1', 'printed_m', track='T2') == 0.168", True),
        ("cell('table1', 'printed_m', track='T9') == 0.168", False),
    ],
)
def test_a_condition_is_evaluated_on_the_tables(condition, true, nominal):
    assert Prose(nominal).true(condition) == true


@needs_results
@pytest.mark.parametrize(
    ("condition", "sentence"),
    [
        ("C05 holds", "chunk after expression"),
        ("1 < poll", "'poll' is undefined"),
        ("tuned('ndi').pol > 1", "no attribute 'pol'"),
        ("holds('C05', 'equl')", "'equl' is no setting; there are paper"),
        ("holds('C99', 'paper')", "C99"),
        ("e('paper', 'braking') > 1", "missing 2 required"),
    ],
)
def test_a_condition_that_cannot_be_evaluated_is_told(condition, sentence, nominal):
    with pytest.raises(InputError, match=sentence):
        Prose(nominal).true(condition)


@needs_results
def test_verdicts_are_those_that_were_stored_on_purpose(table):
    assert claims.changed(table) == []


@needs_results
def test_a_click_leads_from_statement_to_figure_cell_and_table(table, nominal):
    page = Page(table, nominal).replication()
    for target, cell in re.findall(r"\]\(([^)#]+)(?:#cell-id=(\w+))?\)", page):
        assert (paths.ROOT / target).exists(), target
        assert not cell or f'"id": "{cell}"' in (paths.ROOT / target).read_text(), (target, cell)
    judged = table.query("verdict != 'not testable'")
    assert (judged["data"] != "").all(), "also where nobody stayed on the rail"
    assert all(f"]({path})" in page for data in judged["data"] for path in data.split())


@needs_results
@pytest.mark.parametrize("identity", statements.VALUES)
def test_a_predicate_reads_the_table_that_is_named_and_no_other(identity, nominal):
    named = statements.TABLES[identity]

    class Named(Results):
        def __call__(self, name):
            assert name == named
            return super().__call__(name)

        def optional(self, name):
            return super().optional(name) if name == named else None

    for setting in claims.settings_of(identity, statements.load()[identity], nominal):
        found, alone = (statements.find(identity, n.evidence(setting)) for n in (nominal, Nominal(Named())))
        assert repr(found) == repr(alone)


@needs_results
def test_what_is_not_reproduced_says_why(table, nominal):
    page = Page(table, nominal)
    told = {identity for of, _ in page.explained("why") for identity in of}
    assert told == {identity for identity, verdict in page.statements.items() if verdict != "reproduced"}
    rows = table[
        (table["judged"] != "reproduced") & table["setting"].isin(("", "paper")) & (table["kind"] == "statement")
    ]
    assert (rows["why"] != "").all()
    assert set(table[table["judged"] == "reproduced"]["why"]) == {""}


@needs_results
@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("{{ poll }}", "'poll' is undefined"),
        ("{{ tuned('ndi').pol }}", "no attribute 'pol'"),
        ("{{ q('equl', 'braking', 'ndi', 'rmse_y') }}", "'equl' is no setting; there are paper"),
        ("{{ q('equal', 'nowhere', 'ndi', 'rmse_y') }}", "nowhere, ndi, rmse_y"),
        ("{% endfor %}", "unknown tag 'endfor'"),
    ],
)
def test_what_a_template_gets_wrong_is_told_with_its_line(key, sentence, table, nominal, monkeypatch, tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/replication.md.j2").write_text(f"# Title\n{key}\n")
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    with pytest.raises(InputError, match=f"^replication.md.j2 line 2: .*{sentence}"):
        Page(table, nominal).replication()


@needs_results
def test_the_page_is_generated_whole(table, nominal):
    page = Page(table, nominal).replication()
    assert all(statement.statement in page for statement in statements.load().values())
    assert all(f"| D{i} |" in page for i in range(1, 11))
    assert (paths.ROOT / "REPLICATION.md").read_text() == page
    assert "{{" not in page and "{%" not in page, "a placeholder is left"


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
    found = best_swarms(rows, "loop")
    assert found["curve_entry_T3", "ndi", "rmse_y"] == 2.0
    assert found["curve_entry_T3", "nmpc", "failed"] == 1.0


def test_the_spread_is_over_swarms_and_noise():
    found = seeds_spread(pd.DataFrame(SCHEMA, columns=HEAD))
    assert found["curve_entry_T3", "ndi", "rmse_y"] == pytest.approx(1.3863, abs=1e-4)
    assert found["curve_entry_T3", "nmpc", "rmse_y"] == float("inf")


class Handed(Results):
    """Results with a table of setting that was handed in, in the form of notebook 14."""

    def __init__(self, rows, **tables):
        super().__init__()
        self._tables = {"settings_metrics": pd.DataFrame(rows, columns=HEAD), **tables}

    def optional(self, name):
        return self._tables.get(name)


def on_setting(nmpc, printed, ndi, *more):
    rows = []
    for setting in ("paper", "equal", "loop"):
        for name, value in (("nmpc", nmpc), ("ltv_mpc_printed", printed), ("ndi", ndi)):
            for swarm, factor in ((1, 1.0), (2, 1.05)):
                rows.append(("curve_entry_T3", name, "rmse_y", factor * value[setting], "m", setting, swarm, 0))
    return [*rows, *more]


VALUES = {"paper": 1e-3, "equal": 1e-3, "loop": 1e-3}


@needs_results
def test_statements_that_compare_are_judged_on_each_setting(monkeypatch):
    monkeypatch.setattr("railrepro.evidence.claims.nominal.best_seed", lambda *_: 1)  # whatever the tuned sets say
    rows = on_setting(VALUES, VALUES, {"paper": 2e-3, "equal": 5e-4, "loop": 1.02e-3})
    nominal = Nominal(Handed(rows))
    statement = statements.load()["C05"]
    assert claims.settings_of("C05", statement, nominal) == ["paper", "equal", "loop"]
    assert claims.settings_of("C13", statements.load()["C13"], nominal) == [""]
    found = {}
    for setting in ("paper", "loop"):
        finding = statements.find("C05", nominal.evidence(setting))
        found[setting] = statement.judge(finding), statement.tied(finding)
    assert found == {"paper": ("reproduced", False), "loop": ("tie", True)}


@needs_results
@pytest.mark.parametrize("identity", [i for i, s in statements.load().items() if s.kind == "statement"])
def test_a_verdict_in_a_setting_reads_no_other_setting(identity, nominal):
    """Nonsense in the rows of the other settings changes nothing."""

    class Elsewhere(Results):
        def __call__(self, name):
            table = super().__call__(name)
            wrong = table["setting"] != "paper" if "setting" in table else pd.Series(False, table.index)
            return table.assign(**{c: table[c].mask(wrong, -7.0) for c in table.select_dtypes("number")})

        def optional(self, name):
            return self(name)

    for setting in claims.settings_of(identity, statements.load()[identity], nominal):
        if setting in ("", "paper"):
            found, other = (statements.find(identity, n.evidence(setting)) for n in (nominal, Nominal(Elsewhere())))
            assert repr(found) == repr(other)


@needs_results
def test_where_a_run_left_the_rail_it_counts_as_failed():
    rows = [("curve_entry_T3", "nmpc", "failed_at_m", 90.0, "m", "loop", 1, 0)]
    rows += [r for r in on_setting(VALUES, VALUES, VALUES) if (r[1], r[5]) != ("nmpc", "loop")]
    evidence = Nominal(Handed(rows)).evidence("loop")
    assert evidence("curve_entry_T3", "nmpc", "rmse_y") == float("inf")


def judged(kind="statement", **by_setting):
    """Rows of one statement; `any` for what needs no setting."""
    settings = ["" if setting == "any" else setting for setting in by_setting]
    return pd.DataFrame({"id": "C05", "setting": settings, "judged": by_setting.values(), "kind": kind})


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (judged(paper="reproduced", equal="not reproduced"), "reproduced"),
        (judged(paper="not reproduced", equal="reproduced", loop="reproduced"), "not reproduced"),
        (judged(paper="tie", equal="reproduced"), "tie"),
        (judged(paper="fragile"), "fragile"),
        (judged(any="partly"), "partly"),
        (judged(equal="reproduced"), "not testable"),
        (judged(kind="calibrated", any="not testable"), "no verdict"),
        (judged(kind="arithmetic", any="not testable"), "no verdict"),
    ],
)
def test_the_headline_is_the_verdict_on_paper_and_never_the_best_of_three(table, expected):
    assert claims.headline(table) == expected


@pytest.mark.parametrize(
    ("held", "of", "expected"), [(90, 128, "reproduced"), (70, 128, "fragile"), (20, 128, "fragile"), (3, 3, "fragile")]
)
def test_a_verdict_is_fragile_where_the_interval_of_its_share_is_not_above_one_half(held, of, expected):
    rows = on_setting(VALUES, VALUES, {setting: 2e-3 for setting in VALUES})
    metrics = {"curve_entry_T3/nmpc/rmse_y": 1e-3, "curve_entry_T3/ltv_mpc_printed/rmse_y": 1e-3}
    head = {"setting": "paper", "profile": "cone", "ltv": "ltv_mpc_printed"} | metrics
    ndi = [2e-3 if i < held else 5e-4 for i in range(of)]
    samples = pd.DataFrame([head | {"number": i, "curve_entry_T3/ndi/rmse_y": value} for i, value in enumerate(ndi)])
    table = claims.evaluate(Nominal(Handed(rows, robustness_samples=samples)))
    row = table[(table["id"] == "C05") & (table["setting"] == "paper")].iloc[0]
    assert row["judged"] == expected and row["share"] == held / of
    assert row["verdict"] == {"fragile": "partly"}.get(expected, expected)


@needs_results
def test_a_number_of_the_prose_is_that_of_its_table(nominal):
    value = 1e3 * nominal.evidence("equal")("curve_entry_T3", "nmpc", "rmse_y")
    place = "{{ q('equal', 'curve_entry_T3', 'nmpc', 'rmse_y', 'mm') }}"
    assert Prose(nominal, linked=False).text(place) == f"{value:.3g} mm"
    assert Prose(nominal).text(place) == f"[{value:.3g} mm](data/results/nominal_metrics.csv)"
