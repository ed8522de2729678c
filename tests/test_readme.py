"""README is short, its numbers and those of the guide are those of the tables, its links lead somewhere."""

import re

import pandas as pd
import pytest

from railrepro import paths

README = (paths.ROOT / "README.md").read_text()
GUIDE = paths.NOTEBOOKS / "book"
CASES = {"T1": "curve_entry_T1", "T2": "curve_entry_T2", "T3": "curve_entry_T3", "T4": "curve_entry_T4"}
CASES |= {"sine, 400 km/h": "sine_tracking"}
ORDER = {
    "Fig. 6": [("curve_entry_T3", name, "rmse_y") for name in ("nmpc", "ltv_mpc_printed", "ndi")],
    "Fig. 7": [("sine_tracking 400", name, "rmse_y") for name in ("nmpc", "ltv_mpc_printed", "ndi")],
    "Fig. 8": [("adhesion_loss", "ndi", "rmse_y")],
    "Fig. 9": [("braking", name, metric) for name in ("nmpc", "nmpc, R x 100", "ndi")
               for metric in ("rmse_y", "stopping_distance")],
}  # fmt: skip


@pytest.fixture(scope="module")
def measured():
    """Of the setting `paper` with its best swarm."""
    table = pd.read_csv(paths.ROOT / "data/results/nominal_metrics.csv")
    chosen = table[(table["setting"] == "paper") & (table["swarm"] == 0)]
    return chosen.set_index(["scenario", "controller", "metric"])["value"]


def test_the_readme_has_at_most_900_words():
    assert len(README.split()) <= 900


def test_files_that_the_readme_links_are_there():
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert len(links) > 20 and [link for link in links if not (paths.ROOT / link).exists()] == []


@pytest.mark.parametrize("figure", ORDER)
def test_results_of_the_paper_stand_beside_ours(figure, measured):
    here = re.search(rf"^\| {re.escape(figure)}: .*\|(.*)\|$", README, re.M).group(1)
    said = [float(number) for number in re.findall(r"(\d+\.\d+) m", here)]
    values = [measured[key] * (1e3 if key[2] == "rmse_y" else 1.0) for key in ORDER[figure]]
    assert said == [pytest.approx(v, abs=5.1e-3 if key[2] == "rmse_y" else 0.051)
                    for v, key in zip(values, ORDER[figure], strict=True)]  # fmt: skip


def test_on_poor_rail_the_predictive_controller_derails_and_the_inversion_does_not(measured):
    assert measured["adhesion_loss", "nmpc", "failed"] == 1 and measured["adhesion_loss", "ndi", "failed"] == 0


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
