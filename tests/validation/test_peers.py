"""Compiled peers find the optimum of our recursion."""

import numpy as np
import peers
import pytest

from railrepro.control.problem import MPCSettings
from railrepro.evidence.bench import speed
from railrepro.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def short():
    """Two problems with a short horizon in the paper's discretisation, and the same with bounds that act."""
    vehicle, settings = load_vehicle(), MPCSettings(r=1e-9, steps=5, discretisation="euler")
    plain = speed.record("curve_entry_T3", settings, vehicle, 2)
    return vehicle, [plain, speed.tightened(plain)]


@pytest.mark.parametrize("which", [0, 1])
def test_compiled_peers_and_our_recursion_find_the_same_optimum(short, which):
    vehicle, recordings = short
    table = peers.compare(recordings[which], vehicle, rounds=1).set_index("solver")
    assert list(table.index) == [peers.OURS, *peers.PEERS]
    assert (table["missed"] == 0).all() and table["error_du"].max() < peers.SAME
    assert table["ratio_to_ours"][peers.OURS] == 1 and (table["ratio_to_ours"] > 0).all()
    plan, _ = peers.Peer("sqp_qrqp", recordings[which].problems[0].settings).solve(recordings[which].problems[0])
    bound = recordings[which].problems[0].bound
    assert np.abs(plan).max() > 10 and (np.abs(plan).max() > 0.999 * bound) == bool(which)
