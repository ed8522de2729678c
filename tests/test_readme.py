"""Numbers that the README tells are those of the tables."""

import re

import pandas as pd
import pytest

from railrepro import paths

CASES = {"T1": "curve_entry_T1", "T2": "curve_entry_T2", "T3": "curve_entry_T3", "T4": "curve_entry_T4"}
CASES |= {"sine, 400 km/h": "sine_tracking"}


@pytest.mark.parametrize("row", CASES)
def test_errors_of_ours_and_of_the_best_other(row):
    found = pd.read_csv(paths.ROOT / "data/results/creep_mpc_metrics.csv")
    found = found[(found["form"] == "lateral") & (found["metric"] == "rmse_y") & (found["scenario"] == CASES[row])]
    line = re.search(rf"^\| {re.escape(row)}: RMSE of y \(mm\) \|(.*)\|$", (paths.ROOT / "README.md").read_text(), re.M)
    said = [float(cell) for cell in line.group(1).split("|")]
    measured = []
    for setting in ("equal", "loop"):
        values = 1e3 * found[found["setting"] == setting].set_index("controller")["value"]
        measured += [values.drop("creep_mpc").min(), values["creep_mpc"]]
    assert said == pytest.approx(measured, abs=5.1e-4)
