"""Routes that are turned or mirrored, and drives on them."""

from dataclasses import replace

import numpy as np

from railrepro.simulation import scenarios, simulate
from railrepro.track.route import INDEX

ODD = ("psi", "kappa", "dkappa", "phi", "dphi", "y")
ODD += tuple(f"{order}{name}" for name in ("lateral", "crosslevel", "y_ref") for order in ("", "d", "dd", "ddd"))


def turned(route, angle=0.1):
    """The route with its whole track turned about its origin."""
    cells = route.cells.copy()
    x, y = cells[:, INDEX["x"]].copy(), cells[:, INDEX["y"]].copy()
    cells[:, INDEX["psi"]] += angle
    cells[:, INDEX["x"]] = np.cos(angle) * x - np.sin(angle) * y
    cells[:, INDEX["y"]] = np.sin(angle) * x + np.cos(angle) * y
    return replace(route, cells=cells)


def mirrored(route):
    """The route with left and right exchanged."""
    cells = route.cells.copy()
    cells[:, [INDEX[name] for name in ODD]] *= -1
    sides = [INDEX["poor_le"], INDEX["poor_ri"]]
    cells[:, sides] = cells[:, sides[::-1]]
    return replace(route, cells=cells)


def drive_with(guidance, change, monkeypatch):
    """T3's first 150 m with a route that was changed."""
    scenario = scenarios.load_scenario("curve_entry_T3").but(end_m=150.0)
    original = type(scenario).route
    with monkeypatch.context() as patched:
        patched.setattr(type(scenario), "route", lambda self, *laid: change(original(self, *laid)))
        return simulate.run(scenario, guidance).series
