"""Vehicles whose numbers other people published come out of our car."""

import pandas as pd
import published
import pytest

from railrepro import paths


def test_published_vehicles_have_their_published_numbers_and_those_of_the_committed_table():
    """The lab wheelset by Routh's condition at 48.558 m/s; the bogie at 68.66 m/s, not the 66.61 often cited."""
    found = published.comparison()
    committed = pd.read_csv(paths.source("data/results/published_vehicles.csv"))
    assert found.iloc[:, :2].equals(committed.iloc[:, :2])
    assert found["published"].tolist() == pytest.approx([49.027, 26.272, 48.558, 26.133, 68.66], rel=2e-5)
    assert found["ours"].tolist() == pytest.approx(committed["ours"].tolist(), rel=1e-6)
    assert ((found["ours"] / found["published"] - 1).abs() < found["limit"]).all()
