"""What a policy sees of one running gear: 14 numbers of about one; see `guidance`."""

from __future__ import annotations

import numpy as np

from railrepro.model.control_model import PSI_TRAX, PSIDOT_AX, XDOT, X, Y
from railrepro.track.route import CELL, Route
from railrepro.vehicle.parameters import Vehicle

AHEAD = (0.05, 0.1, 0.2, 0.3, 0.5)
"""Times ahead at which track and set point are observed (s)."""
SIZE = 4 + 2 * len(AHEAD)
"""Numbers of a gear."""
_PITCH = 4
"""Points of the table of the track ahead per metre."""


class Sight:
    """Track and set point ahead as a table, and the observation of a state.

    Parameters
    ----------
    route : Route
    vehicle : Vehicle
        Nominal one.
    """

    def __init__(self, route: Route, vehicle: Vehicle):
        p = route.start + np.arange(int(len(route.cells) * CELL * _PITCH)) / _PITCH
        _, curvature, cant, *_ = route.track_at(p)
        # set point, its slope, curvature, and gravity along the canted track (m/s2), shape (4, n)
        self._table = np.stack([*route.reference_at(p), curvature, vehicle.gravity * cant])
        self._start, self._limit, self._ahead = route.start, vehicle.drive.torque_limit, np.array((0.0, *AHEAD))

    def seen(self, x: np.ndarray, torque: np.ndarray) -> np.ndarray:
        """Numbers of several gears, shape (n, SIZE), from their measured states (n, 6) and last torques (n,) (N m)."""
        found, v = np.empty((len(x), SIZE)), x[:, XDOT, None]
        places = (x[:, X, None] + v * self._ahead - self._start) * _PITCH
        places = np.fmin(np.fmax(places, 0), self._table.shape[1] - 1).astype(int)
        y_ref, slope, curvature, lift = self._table[:, places]
        aside = 1e3 * (y_ref - x[:, Y, None])
        found[:, 0], found[:, 4 : 4 + len(AHEAD)] = aside[:, 0], aside[:, 1:]
        found[:, 1] = 1e3 * (slope[:, 0] - x[:, PSI_TRAX])
        found[:, 2] = 1e2 * (x[:, PSIDOT_AX] - v[:, 0] * curvature[:, 0])
        found[:, 3] = torque / self._limit
        found[:, 4 + len(AHEAD) :] = lift[:, 1:] - v**2 * curvature[:, 1:]
        return found
