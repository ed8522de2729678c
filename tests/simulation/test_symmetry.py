"""Whole runs do not depend on where the track points to, nor on which side is left."""

import numpy as np
import pytest
from symmetry import drive_with, mirrored, turned

from railrepro.control.registry import CONTROLLERS, OURS, SHOWN
from railrepro.evidence.runs.tuning import tuned
from railrepro.simulation import metrics


def drive(name, change, monkeypatch):
    return drive_with(tuned(name, CONTROLLERS[name].quick, "equal"), change, monkeypatch)


@pytest.mark.parametrize("name", SHOWN)
def test_heading_of_the_track_does_not_matter_but_to_the_printed_linearisation(name, monkeypatch):
    """The printed LTV-MPC linearises at psi_Ax = 0 (D6), so it must change."""
    straight, turn = (metrics.rmse(drive(name, change, monkeypatch)) for change in (lambda route: route, turned))
    if name == "ltv_mpc_printed":
        assert abs(turn / straight - 1) > 1e-2
    else:
        assert turn == pytest.approx(straight, rel=1e-6)


@pytest.mark.parametrize("name", ["nmpc", "ndi_integral", OURS])
def test_a_closed_loop_run_on_the_mirrored_track_is_its_mirror_image(name, monkeypatch):
    right, left = (drive(name, change, monkeypatch) for change in (lambda route: route, mirrored))
    for column in ("front.y", "front.du", "rear.du", "rear.psi_TrAx"):
        scale = right[column].abs().max()
        assert np.abs(right[column] + left[column]).max() < 1e-7 * scale
    assert np.abs(right["front_le.N"] - left["front_ri.N"]).max() < 1e-2
    assert right["front.y"].abs().max() > 1e-3
