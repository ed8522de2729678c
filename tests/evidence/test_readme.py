"""README: its numbers are those of the tables, its links lead somewhere, its first program runs."""

import re

import pytest
import yaml

from railrepro import __version__, paths
from railrepro.evidence.report import claims
from railrepro.evidence.report import page as page_

README = (paths.ROOT / "README.md").read_text()


def test_readme_changelog_and_citation_name_this_version():
    citation = yaml.safe_load((paths.ROOT / "CITATION.cff").read_text())
    assert citation["version"] == __version__ and f"*railrepro* {__version__}, " in README
    newest = re.search(r"^## (\S+), (\S+)$", (paths.ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest.groups() == (__version__.partition(".dev")[0], str(citation["date-released"]))


def test_files_that_the_readme_links_are_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert len(links) > 20 and [link for link in links if not (paths.ROOT / link).exists()] == []


def test_verdicts_that_changed_are_written_on_purpose_only(table, tmp_path, monkeypatch):
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    monkeypatch.setattr(claims, "evaluate", lambda _: table)
    monkeypatch.setattr(claims, "changed", lambda _: ["C05"])
    assert page_.main() == 1 and not list(tmp_path.rglob("*.*"))
    assert page_.main(accept=True) == 0
    for file in ("data/results/claims.csv", "REPLICATION.md", "figures/README.md", "README.md"):
        assert (tmp_path / file).read_bytes() == (paths.ROOT / file).read_bytes()


def test_an_outcome_sums_up_what_holds():
    words = {"R": "reproduced", "F": "fragile", "P": "partly", "T": "tie", "N": "not reproduced"}
    page = page_.Page.__new__(page_.Page)
    for verdicts, outcome in {"RF": "yes", "RR": "yes", "RN": "partly", "FP": "partly", "PN": "no", "TN": "no"}.items():
        page.verdicts = {f"C{i}": words[letter] for i, letter in enumerate(verdicts)}
        assert page.outcome(list(page.verdicts)) == outcome, verdicts


def test_the_first_program_prints_the_number_of_the_table(capsys):
    program = re.search(r"^```python\n(from railrepro import .*?)^```", README, re.M | re.S).group(1)
    exec(program, {})
    printed = float(capsys.readouterr().out.split()[-1])
    nmpc = re.search(r"^\| \[Fig\. 6\].*\| (\d+\.\d+) /", README, re.M).group(1)
    assert 1e3 * printed == pytest.approx(float(nmpc), abs=5.1e-3)
