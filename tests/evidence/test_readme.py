"""README, report and notation: they agree with the tables, their links and names exist, the first program runs."""

import json
import pkgutil
import re

import pandas as pd
import pytest
import yaml

import railrepro
from railrepro import FACADE, __version__, paths
from railrepro.evidence.report import claims
from railrepro.evidence.report import page as page_

README = (paths.ROOT / "README.md").read_text()
WORDS = set(re.findall(r"\w+", "\n".join(file.read_text() for file in (paths.ROOT / "railrepro").rglob("*.py"))))


def test_readme_changelog_and_citation_name_this_version():
    citation = yaml.safe_load((paths.ROOT / "CITATION.cff").read_text())
    described = json.loads((paths.ROOT / "codemeta.json").read_text())["version"]
    assert citation["version"] == described == __version__ and f"*railrepro* {__version__}, " in README
    newest = re.search(r"^## (\S+), (\S+)$", (paths.ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest.groups() == (__version__.partition(".dev")[0], str(citation["date-released"]))


def test_files_that_the_readme_links_are_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert len(links) > 20 and [link for link in links if not (paths.ROOT / link).exists()] == []


def test_the_committed_report_is_that_of_the_tables(table, tmp_path, monkeypatch):
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tmp_path))
    monkeypatch.setattr(claims, "evaluate", lambda _: table)
    assert page_.main() == 0
    for file in ("data/results/claims.csv", "REPLICATION.md", "figures/README.md", "codecheck.yml", "README.md"):
        assert (tmp_path / file).read_bytes() == (paths.ROOT / file).read_bytes()


def test_the_first_program_draws_and_prints_the_numbers_of_the_table(monkeypatch, tmp_path):
    program = re.search(r"^```python\n(from railrepro import .*?)^```", README, re.M | re.S).group(1)
    monkeypatch.chdir(tmp_path)
    exec(program, names := {})
    errors = re.search(r"^\| \[Fig\. 6\].*: (\S+ / \S+ / \S+) mm", README, re.M).group(1)
    assert list(names["runs"]["rmse_mm"]) == pytest.approx([float(one) for one in errors.split(" / ")], abs=5.1e-3)
    assert (tmp_path / "first.png").stat().st_size > 10_000


def test_all_names_of_the_package_are_documented_and_exported():
    page = (paths.NOTEBOOKS / "book/api.md").read_text()
    assert FACADE.items() <= set(re.findall(r"`(\w+) <(railrepro\.[\w.]+)>`", page))
    assert all(f"`{name}`" in railrepro.__doc__ for name in FACADE)
    stub = (paths.ROOT / "railrepro/__init__.pyi").read_text().partition("__all__")[2]
    assert set(re.findall(r'"(\w+)"', stub)) == {*railrepro.__all__}


def known(name):
    """Whether a name of the library exists, or all words of another name, such as a column of a run, occur in it."""
    if not name.startswith("railrepro."):
        return set(name.split(".")) <= WORDS
    home, _, last = name.rpartition(".")
    owner = pkgutil.resolve_name(home)
    return hasattr(owner, last) or last in getattr(owner, "__annotations__", {})


def test_every_python_name_of_the_notation_exists():
    cells = pd.read_csv(paths.DATA / "notation.csv", keep_default_na=False)["python"]
    names = {entry.rpartition(" ")[2] for cell in cells for entry in re.split("[,;] ", cell)}
    assert len(names) > 100 and [name for name in sorted(names) if not known(name)] == []
