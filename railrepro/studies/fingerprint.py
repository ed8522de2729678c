"""Fingerprint of what simulations read: stored results belong to it and are refused, or made anew, for anything else.

It covers content, not files: a track or scenario that is not driven, a name, a comment changes nothing. Numbers that
are computed enter rounded, so that another mathematical library gives the same fingerprint.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from railrepro.model.control_model import control_model
from railrepro.simulation.scenarios import Scenario
from railrepro.track.irregularity import CHANNELS
from railrepro.track.route import COLUMNS, Route
from railrepro.vehicle.parameters import Vehicle

_MOMENTS = 4
_DERIVED = {f"{order}{channel}" for order in ("dd", "ddd") for channel in CHANNELS}
_COUNTED = [i for i, name in enumerate(COLUMNS) if name not in _DERIVED]
"""Columns of a route that count; the derived ones follow from values and slopes of neighbouring cells."""


def fingerprint(scenarios: Sequence[Scenario], vehicle: Vehicle, *more) -> str:
    """Hash of the control model and of all that runs of some scenarios read.

    Parameters
    ----------
    scenarios : sequence of Scenario
        Their routes as laid, speeds and adhesion sets count; names and where they appear in the paper do not.
    vehicle : Vehicle
        Without the adhesion sets that no scenario has.
    more : optional
        What else the result depends on; its `repr` counts.

    Returns
    -------
    str
        16 hexadecimal digits.

    Raises
    ------
    InputError
        When a scenario has no route, or an adhesion set that the vehicle lacks.
    """
    for scenario in scenarios:
        scenario.check(vehicle)
    sets = {name: vehicle.adhesion[name] for s in scenarios for name in (s.good, s.poor)}
    car = replace(vehicle, adhesion=dict(sorted(sets.items())))
    driven = [
        [s.speed, s.stop_speed, s.good, s.poor, s.second_profile, float(s.end_m), _moments(s.route())]
        for s in scenarios
    ]
    content = json.dumps([repr(car), _model(), driven, repr(more)])
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@lru_cache
def _model() -> list[str]:
    """Rates of the control model at one point."""
    rhs = control_model().rhs
    probe = [np.linspace(0.1, 1.0, rhs.nnz_in(i)).reshape(rhs.size_in(i)) for i in range(rhs.n_in())]
    return [f"{value:.9e}" for value in np.array(rhs(*probe)).ravel()]


def _moments(route: Route) -> list[list]:
    """Mean size of each column of a route, and its moments over the way in millionths of it."""
    cells = route.cells[:, _COUNTED]
    sizes = np.abs(cells).mean(axis=0)
    way = np.linspace(0.0, 1.0, len(cells))[:, None] ** np.arange(_MOMENTS)
    sizes = np.where(sizes < 1e-12, 0.0, sizes)  # what is left where zeros do not quite cancel
    shares = (way.T @ cells / len(cells) / np.where(sizes > 0, sizes, np.inf)).T
    return [[len(cells)]] + [
        [f"{size:.6e}", *(round(1e6 * share) for share in row)] for size, row in zip(sizes, shares, strict=True)
    ]
