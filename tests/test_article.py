"""The article: no number of its own, no placeholder left, the report's verdicts; the figure of what matching leaves."""

import re

import numpy as np
import pandas as pd
import pytest

from railrepro import paths
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal, Results
from railrepro.evidence.report import article, claims, region, text
from railrepro.evidence.runs.pso import Dimension
from railrepro.evidence.uncertainty import matching

pytestmark = pytest.mark.skipif(
    not (paths.ROOT / "data/results/braking_front.csv").exists(), reason="data/results is not made yet (make figures)"
)


@pytest.fixture(scope="module")
def shown(table, nominal):
    return article.render(table, nominal)


def test_nothing_is_left_unfilled(shown):
    bare = re.sub(r"\$\$?[^$]+\$\$?|\[@[^]]*\]|\{#refs\}", "", shown)
    assert not re.search(r"[{}]|(?<!\\)\[\[|\bn/a\b|@\w", bare)


def test_each_link_leads_somewhere(shown):
    targets = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", shown)
    assert len(targets) > 200
    assert [target for target in targets if not (paths.ROOT / target).exists()] == []
    inside = set(re.findall(r"\]\(#([^)]+)\)", shown))
    assert inside == {*(f"article-{name}" for name in re.findall(r"\(figures/(\w+)\.png\)", shown))}


def test_each_number_of_the_prose_is_a_link_to_a_table(shown):
    prose = "\n".join(line for line in shown.splitlines() if not line.startswith(("|", "**Table")))
    prose = prose[: prose.index("## References")]
    prose = re.sub(r"\[[^\]]*\]\([^)]*\)", "", re.sub(r"\[@[^]]*\]", "", prose))
    allowed = (
        r"\$\$?[^$]+\$\$?",
        r"\*\*Figure \d\.\*\*",
        r"^\d+\. ",
        r"\bFigs?\. \d( (?:and|to) \d)?",
        r"\bT\d\b",
        r"[Ss]1002",
        r"\bC\d\d\b",
        "y = 0",
    )
    prose = re.sub("|".join([*allowed, r"R x 10\b", r"0\.71 of"]), "", prose, flags=re.M)
    assert re.findall(r"\S*\d\S*", prose) == []


def test_the_counts_are_those_of_the_table(shown):
    stored = pd.read_csv(paths.ROOT / "data/results/claims.csv", keep_default_na=False)
    own = stored[(stored["kind"] == "statement") & stored["setting"].isin(("", "paper"))]
    for where, rows in own.groupby(own["setting"] == "paper"):
        said = re.search(rf"{len(rows)} statements {'are compared in' if where else 'need no'} [^:]*: ([^.]*)\.", shown)
        assert said and sum(int(number) for number in re.findall(r"\d+", said[1])) == len(rows)
        for verdict, number in rows["judged"].value_counts().items():
            assert re.search(rf"\b{number} {verdict}\b", said[1]), verdict


SAID = {
    "reproduced": "C05 C10 C11 C18 C20 C21 C25 C26 C34 C42",
    "fragile": "C30 C36",
    "partly": "C06 C14 C17 C39",
    "not reproduced": "C07 C13 C24 C28 C41 C46 C50",
}
"""Verdicts on `paper` that sentences of the article rest on: who changes one reads the sentence again."""


def test_sentences_say_what_the_verdicts_say(table, shown):
    found = claims.verdicts(table)
    assert {i: found[i] for ids in SAID.values() for i in ids.split()} == {
        i: verdict for verdict, ids in SAID.items() for i in ids.split()
    }
    said = set(re.findall(r"\[(C\d\d)\]\(\S+\): ", shown))
    assert said == {i for ids in SAID.values() for i in ids.split()}


def test_sentences_say_what_the_numbers_say(nominal):
    errors = {
        t: {c: nominal.evidence(t)("curve_entry_T3", c, "rmse_y") for c in ("nmpc", "ndi")} for t in nominal.settings()
    }
    assert errors["paper"]["nmpc"] < errors["paper"]["ndi"]
    assert errors["equal"]["ndi"] < errors["equal"]["nmpc"]
    assert 0.67 < errors["loop"]["ndi"] / errors["loop"]["nmpc"] < 1.5
    equal = nominal.evidence("equal")
    paper = nominal.evidence("paper")
    assert paper("curve_entry_T3", "ltv_mpc_printed", "rmse_y") < errors["paper"]["nmpc"]
    assert equal("adhesion_loss", "ndi", "rmse_y") < equal("adhesion_loss", "nmpc", "rmse_y")
    assert 0 < statements.find("C46", paper).value < 0.9, "the sweep of R dominates in part"
    for name in ("nmpc", "no slip control"):
        assert paper("adhesion_loss", name, "rmse_y") > 2 * paper("adhesion_loss", "nothing", "rmse_y")


def rendered(line, table, nominal, monkeypatch, tmp_path):
    """A template of one line."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data/article_page.md").write_text(line)
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    return article.render(table, nominal)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("{poll_cross}", r"line 1: \{poll_cross\}: is no number of the prose; there are .*pole_follows"),
        ("{fair: curve_entry_T3/nmpc/rmse_y mm}", r"line 1: .*'fair' is no setting; there are paper, equal, loop$"),
        ("{equal: curve_entry_T3/nmcp/rmse_y mm}", r"line 1: .*nmcp/rmse_y mm\}: the results do not have it$"),
        ("{printed: speed in Fig. 66}", "line 1: .*paper_numbers.csv has no such number$"),
        ("{C99}", "line 1: .*claims.toml has no such statement$"),
        ("{fig06_curve_entry}", "line 1: .*the article does not show this figure$"),
        ("![fig99_nothing] Caption", "line 1: figures has no fig99_nothing"),
        ("[[statement]]", r"line 1: \[\[statement\]\] is no block; there are conditions, headline"),
        ("[@Nobody1999]", "line 1: .*references.bib has no such work"),
        ("the error is 2.26 mm", "line 1: has the number '2.26', typed"),
        ("the error is `2.26 mm`", "line 1: has the number '`2.26', typed"),
        ("half of $3 \\cdot e$", r"line 1: has the number '\$3', typed"),
    ],
)
def test_what_is_wrong_in_the_template_is_told_in_a_sentence(line, sentence, table, nominal, monkeypatch, tmp_path):
    with pytest.raises(InputError, match=f"^article_page.md {sentence}"):
        rendered(line, table, nominal, monkeypatch, tmp_path)


def test_a_number_is_a_link_to_its_table(table, nominal, monkeypatch, tmp_path):
    found = rendered("{equal: curve_entry_T3/nmpc/rmse_y mm} $k_1$ {C05}", table, nominal, monkeypatch, tmp_path)
    value = 1e3 * nominal.evidence("equal")("curve_entry_T3", "nmpc", "rmse_y")
    link = f"[{value:.3g} mm](data/results/nominal_metrics.csv)"
    assert found == f"{link} $k_1$ [C05](REPLICATION.md#C05): {claims.verdicts(table)['C05']}\n"


class Studied(Results):
    """Results beside those of robustness and matching that were made up."""

    TABLES = {
        "robustness_samples": pd.DataFrame({"number": [0]}),
        "robustness_claims": pd.DataFrame(
            {
                "id": ["C05", "C05", "C10"], "setting": ["paper", "loop", "equal"], "share": [0.25, 0.1, 0.9],
                "low": 0.1, "high": 0.95, "samples": 32, "cone": 0.5, "s1002": 0.5,
                "decided_by": ["wheel.radius", "", ""],
            }
        ),
        "matching_waves": pd.DataFrame(
            {"points": [128, 128], "surviving_share": [0.5, 0.021], "allowed": [0, 1], "most_statements": [9, 11],
             "statements": [20, 20]}
        ),
    }  # fmt: skip

    def optional(self, name):
        return self.TABLES[name].copy() if name in self.TABLES else super().optional(name)


@pytest.fixture(scope="module")
def plain():
    """Verdicts on the nominal case alone."""
    return claims.evaluate(Nominal(Unstudied()))


class Unstudied(Results):
    """Results without those of robustness and matching."""

    def optional(self, name):
        return None if name.startswith(("robustness", "matching")) else super().optional(name)


def test_article_and_report_show_shares_and_the_matching_when_they_are_there(plain, monkeypatch):
    monkeypatch.setattr(text, "region_figure", lambda: "fig31_margins")
    monkeypatch.setattr(claims, "shares", lambda table: Studied.TABLES["robustness_claims"])
    shares = {"judged": "fragile", "verdict": "partly", "share": 0.25, "share_low": 0.1, "share_high": 0.95}
    fragile = (plain["id"] == "C05") & (plain["setting"] == "paper")
    table = plain.assign(**{column: plain[column].mask(fragile, value) for column, value in shares.items()})
    made, report = article.render(table, Nominal(Studied())), text.render(table, Nominal(Studied()))
    assert "| ✓? |" in made and re.search(r"\| ✓\? 0\.3[23]\d*; 25 \[10, 95\] \|", report)
    assert "Fragile, by rule, are [C05]" in made and "[C05](REPLICATION.md#C05): fragile" in made
    for page in (made, report):
        where, most = "(data/results/robustness_claims.csv)", "Statements that hold in more than half of the samples: "
        counted = f"[0 of 1]{where} on `paper`, [1 of 1]{where} on `equal`, [0 of 1]{where} on `loop`."
        assert f"{most}{counted} Decisive on `paper`: wheel.radius for C05." in page and "1 fragile" in page
        assert "[256](data/results/matching_waves.csv) runs, at best [11 of 20]" in page
        assert "1. Which rails did the runs have" in page
    assert "**Figure 5.** Non-implausible region" in made and "Vernon" in made


def test_without_the_studies_both_read_well(plain):
    nominal = Nominal(Unstudied())
    made, report = article.render(plain, nominal), text.render(plain, nominal)
    for page in (made, report):
        assert "has not run with these rules and this car yet" in page
        assert "History matching has not run yet: `python -m railrepro matching`" in page


def test_the_book_has_the_article_with_its_pdf(shown):
    page = article.for_the_book(shown)
    assert "{download}`As a PDF <article.pdf>`" in page
    assert page.count("```{figure} figures/") == shown.count("![Figure")
    assert '<a href="REPLICATION.html#C05">C05</a>' in page and "REPLICATION.md" not in page
    assert "{cite:p}`Polach1999,Polach2005`" in page and "See the {doc}`bibliography`." in page
    assert not re.search(r"\[@|refs", page)


def test_the_pdf_has_equal_bytes_and_few_pages(shown):
    pytest.importorskip("typst", reason="the packages of the book are installed by `make article`")
    pytest.importorskip("pypandoc")
    made = article.pdf(shown)
    assert made.startswith(b"%PDF") and made == article.pdf(shown)
    pages = int(re.search(rb"/Count (\d+)", made)[1])
    assert 4 <= pages <= 8


def test_the_article_in_latex_has_its_figures_citations_and_no_links_to_files(shown):
    pytest.importorskip("pypandoc", reason="the packages of the book are installed by `make article`")
    files = article.latex(shown)
    content = files["content.tex"].decode()
    drawn = re.findall(r"\\includegraphics\[[^]]*\]\{(\w+\.pdf)\}", content)
    assert drawn and set(drawn) == {name for name in files if name.endswith(".pdf")}
    assert r"\citep{Ewering2023}" in content and "data/results" not in content.replace(r"\_", "_")
    assert not re.search("[✓✗◐]", content) and r"\section{Introduction}" in content


def test_the_abstract_has_no_links(shown):
    said = article.abstract(shown)
    assert said.startswith("We replicate") and "](" not in said and "[@" not in said and "Introduction" not in said


def test_without_the_packages_of_the_book_the_pdf_is_refused(shown, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "typst", None)
    with pytest.raises(InputError, match="needs the packages of the group `book`; `make article` installs them"):
        article.pdf(shown)


DIMENSIONS = (Dimension("pole", 10, 100, "log"), Dimension("delay", 0.0, 5e-3), Dimension("profile", 0, 1, "integer"))


def left(count=40):
    u = np.random.default_rng(1).random((count, 3))
    return pd.DataFrame({d.name: [d.value(0.5 * x) for x in u[:, i]] for i, d in enumerate(DIMENSIONS)})


def narrowing(*names):
    return pd.DataFrame({"what": names, "narrowing": np.linspace(0.9, 0.1, len(names))})


def test_the_region_is_drawn_against_the_whole_prior():
    figure, data = region.draw(
        left(400), narrowing("pole", "profile", "delay"), DIMENSIONS, {"best": {"pole": 20.0}}, 2
    )
    assert list(data) == ["pole", "profile"]
    axes = [axis for axis in figure.axes if axis.get_visible()]
    assert len(axes) == 3
    pair = next(axis for axis in axes if len(axis.lines) == 1 and axis.get_ylabel() == "profile")
    assert pair.get_xlim() == (10, 100) and pair.get_ylim() == (-0.5, 1.5) and pair.get_xscale() == "log"
    assert [tick.get_text() for tick in pair.get_yticklabels()] == ["0", "1"], "a choice has its places only"
    density = next(axis for axis in axes if axis.patches)
    values = density.patches[0].get_data().values
    assert values.mean() == pytest.approx(1.0) and values[-5:].sum() == 0
    assert values[:5] == pytest.approx(2.0, abs=0.6), "uniform in the dimension's own scale"


def test_a_region_without_points_or_with_a_strange_direction_is_told():
    with pytest.raises(InputError, match="the non-implausible region is empty"):
        region.draw(left().iloc[:0], narrowing("pole"), DIMENSIONS)
    with pytest.raises(InputError, match="direction 'mass', which prior or survivors do not have"):
        region.draw(left(), narrowing("pole", "mass"), DIMENSIONS)


def test_matching_keeps_points_of_the_region_and_the_figure_reads_them():
    def run(points):
        return [{"C05": 0.5 - dict(point)["delay"] / 5e-3} for point in points]

    problem = matching.Problem(DIMENSIONS, run)
    matched = matching.match(problem, waves=2, count=32, candidates=2**9)
    made = matching.tables(problem, matched)
    assert len(made["survivors"]) == min(len(matched.survivors), matching.SHOWN)
    assert made["survivors"]["delay"].max() < 4.2e-3
    figure, _ = region.draw(
        made["survivors"], made["region"], DIMENSIONS, {"best run": matching.best(problem, matched)["values"]}
    )
    assert figure.legends[0].texts[-1].get_text() == "best run"


def test_no_statement_hides_from_the_article(shown):
    for identity, statement in statements.load().items():
        assert (f"[{identity}](REPLICATION.md#{identity}) | {statement.statement} |" in shown) == (
            statement.kind == "statement"
        )
