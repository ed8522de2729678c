"""Whole runs do not depend on where the track points to, nor on which side is left."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.control.registry import CONTROLLERS, OURS, SHOWN, tuned
from railrepro.simulation import metrics, scenarios, simulate
from railrepro.track.route import INDEX

ODD = ("psi", "kappa", "dkappa", "phi", "dphi", "y")
ODD += tuple(f"{order}{name}" for name in ("lateral", "crosslevel", "y_ref") for order in ("", "d", "dd", "ddd"))


def turned(route, angle=0.1):
    """The route with its whole track turned about its origin."""
    cells, xy = route.cells.copy(), [INDEX["x"], INDEX["y"]]
    cells[:, INDEX["psi"]] += angle
    cells[:, xy] = cells[:, xy] @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    return replace(route, cells=cells)


def mirrored(route):
    """The route with left and right exchanged."""
    cells, sides = route.cells.copy(), [INDEX["poor_le"], INDEX["poor_ri"]]
    cells[:, [INDEX[name] for name in ODD]] *= -1
    cells[:, sides] = cells[:, sides[::-1]]
    return replace(route, cells=cells)


def drive(name, change):
    """T3's first 150 m under a controller, with a route that was changed."""
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=150.0)
    return simulate.run(scenario, tuned(name, CONTROLLERS[name].quick), route=change(scenario.route())).series


@pytest.mark.parametrize("name", SHOWN)
def test_heading_of_the_track_does_not_matter_but_to_the_printed_linearisation(name):
    """The printed LTV-MPC linearises at psi_Ax = 0 (D6), so it must change."""
    straight, turn = (metrics.rmse(drive(name, change)) for change in (lambda route: route, turned))
    change = abs(turn / straight - 1)
    assert change > 1e-2 if name == "ltv_mpc_printed" else change < 1e-6


def mirror(name):
    """Name of the same quantity on the other side of the track and its sign there."""
    odd = {"y", "psi", "phi", "vy", "wx", "wz", "psi_Ax", "psi_TrAx", "psidot_Ax", "yaw_to_body", "y_ref", "du"}
    odd |= {"Fy", "nu_y", "spin", "M_spin", "rail_y", "sway", "ay"}
    other = name.replace("_le", "_*").replace("_ri", "_le").replace("_*", "_ri")
    return other, -1 if name.split(".")[-1] in odd else 1


@pytest.mark.parametrize("name", ["nmpc", "ndi_integral", OURS])
def test_a_closed_loop_run_on_the_mirrored_track_is_its_mirror_image(name):
    right, left = (drive(name, change) for change in (lambda route: route, mirrored))
    assert right["front.y"].abs().max() > 1e-3
    for column in right:
        other, sign = mirror(column)
        scale = right[column].abs().max()
        assert np.abs(right[column] - sign * left[other]).max() <= 1e-7 * scale + 1e-10, column
