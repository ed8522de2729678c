"""Runs as data for other programs: the unit of a figure drives the trajectory of its file."""

import pandas as pd
from units import Instance

from railrepro.evidence import release
from railrepro.export.car import INPUTS
from railrepro.simulation.scenarios import load_scenario


def test_the_unit_with_the_torques_of_a_file_gives_its_displacements(tmp_path, monkeypatch):
    end = {"end_m": 60.0}
    monkeypatch.setattr(release, "load_scenario", lambda name: load_scenario(name).but(**end))
    monkeypatch.setattr(release, "FIGURES", {"fig09": ("braking", ("ndi", "nmpc_r10"))})
    unit, *runs = release.write_runs(tmp_path / "runs")
    read = [pd.read_csv(file, float_precision="round_trip") for file in runs]
    for run in read:
        car = Instance(unit)
        for row in run.itertuples(index=False):
            assert car.get(["front.y", "rear.y"]) == [*row[-2:]]
            car.set(list(INPUTS), [*row[1:5]])
            car.step()
        assert abs(run["front.y"]).max() > 2e-4
    assert not read[0].equals(read[1])
