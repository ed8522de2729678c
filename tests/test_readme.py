"""README is short, its numbers and those of the guide are those of the tables, its links lead somewhere."""

import re

import pandas as pd
import pytest
import yaml

from railrepro import __version__, paths

README = (paths.ROOT / "README.md").read_text()
GUIDE = paths.NOTEBOOKS / "book"
CASES = {"T1": "curve_entry_T1", "T2": "curve_entry_T2", "T3": "curve_entry_T3", "T4": "curve_entry_T4"}
CASES |= {"sine, 400 km/h": "sine_tracking"}
TABLES = {"Fig. 6": "fig06_curve_entry", "Fig. 7": "fig07_sine_tracking", "Fig. 8": "fig08_adhesion_loss"}
TABLES |= {"Fig. 9": "fig09_braking"}


def of_the_paper(figure):
    """RMSE (mm) of each run of a figure by car, for braking with the distance (m); the highest speed of several."""
    table = pd.read_csv(paths.FIGURES / f"{TABLES[figure]}.csv").query("setting == 'paper'")
    if "speed_kmh" in table:
        table = table[table["speed_kmh"] == table["speed_kmh"].max()]
    found = {}
    for (car, *_), rows in table.groupby([key for key in ("car", "controller", "case") if key in table], sort=False):
        if "rmse_mm" in rows:
            error = rows["rmse_mm"].iloc[0]
        else:
            error = 1e3 * ((rows["y_m"] - rows["y_ref_m"]) ** 2).mean() ** 0.5
        found.setdefault(car, []).extend([error, rows["p_m"].iloc[-1]] if figure == "Fig. 9" else [error])
    return found["uncalibrated"] + found["calibrated"]


def test_readme_changelog_and_citation_name_this_version():
    citation = yaml.safe_load((paths.ROOT / "CITATION.cff").read_text())
    assert citation["version"] == __version__ and f"*railrepro* {__version__}, " in README
    newest = re.search(r"^## (\S+), (\S+)$", (paths.ROOT / "CHANGELOG.md").read_text(), re.M)
    assert newest.groups() == (__version__.partition(".dev")[0], str(citation["date-released"]))


def test_files_that_the_readme_links_are_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert len(links) > 20 and [link for link in links if not (paths.ROOT / link).exists()] == []


@pytest.mark.parametrize("figure", TABLES)
def test_results_of_the_paper_stand_beside_ours(figure):
    here = re.search(rf"^\| \[{re.escape(figure)}\].*?\|.*?\|(.*)\|$", README, re.M).group(1)
    said = [float(number) for number in re.findall(r"(\d+\.\d+) m", here)]
    tolerance = 0.051 if figure == "Fig. 9" else 5.1e-3
    assert said == pytest.approx(of_the_paper(figure), abs=tolerance)


def test_the_first_program_prints_the_number_of_the_table(capsys):
    program = re.search(r"^```python\n(from railrepro import .*?)^```", README, re.M | re.S).group(1)
    exec(program, {})
    printed = float(capsys.readouterr().out.split()[-1])
    row = re.search(r"^\| \[Fig\. 6\].*?\|.*?\|(.*)\|$", README, re.M).group(1)
    uncalibrated = float(re.search(r"(\d+\.\d+) mm", row).group(1))
    assert 1e3 * printed == pytest.approx(uncalibrated, abs=5.1e-3)


def test_the_verdicts_are_counted():
    claims = pd.read_csv(paths.ROOT / "data/results/claims.csv").query("kind == 'statement'")
    found = claims[claims["setting"].isna() | (claims["setting"] == "paper")]["judged"]
    said = re.search(
        r"Of (\d+) statements, (\d+) are reproduced .*?, (\d+) fragile .*?, (\d+) partly, (\d+) not\.", README
    ).groups()
    kinds = ("reproduced", "fragile", "partly", "not reproduced")
    assert [int(number) for number in said] == [len(found), *((found == kind).sum() for kind in kinds)]


@pytest.mark.parametrize("row", CASES)
def test_errors_of_ours_and_of_the_best_other(row):
    found = pd.read_csv(paths.ROOT / "data/results/creep_mpc_metrics.csv")
    found = found[(found["form"] == "lateral") & (found["metric"] == "rmse_y") & (found["scenario"] == CASES[row])]
    page = (GUIDE / "benchmark.md").read_text()
    line = re.search(rf"^\| {re.escape(row)}: RMSE of y \(mm\) \|(.*)\|$", page, re.M)
    said = [float(cell) for cell in line.group(1).split("|")]
    measured = []
    for setting in ("equal", "loop"):
        values = 1e3 * found[found["setting"] == setting].set_index("controller")["value"]
        measured += [values.drop("creep_mpc").min(), values["creep_mpc"]]
    assert said == pytest.approx(measured, abs=5.1e-4)
