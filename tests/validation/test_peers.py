"""Compiled peers find the optimum of our recursion."""

import numpy as np
import peers

from railrepro.control.problem import MPCSettings
from railrepro.evidence.bench import speed
from railrepro.vehicle.parameters import load_vehicle


def test_compiled_peers_and_our_recursion_find_the_same_optimum():
    """Two problems with a short horizon in the paper's discretisation, and the same with bounds that act."""
    vehicle, settings = load_vehicle(), MPCSettings(r=1e-9, steps=5, discretisation="euler")
    plain = speed.record("curve_entry_T3", settings, vehicle, 2)
    for recording in (plain, speed.tightened(plain)):
        table = peers.compare(recording, vehicle, rounds=1)
        assert list(table["solver"]) == [peers.OURS, *peers.PEERS]
        assert (table["missed"] == 0).all() and table["error_du"].max() < peers.SAME
        largest = np.abs(peers.solve_all("sqp_qrqp", recording)[0]).max()
        assert largest > 10 and (largest > 0.999 * recording.problems[0].bound) == (recording is not plain)
