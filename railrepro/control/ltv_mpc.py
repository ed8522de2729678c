"""Linear time-variant MPC: the model linearised in centred riding along the forecast, one QP per sample.

By default the linearisation is about the track direction and keeps its affine term; the printed one (psi_Ax = 0, no
affine term, D6) is selectable. Serves the paper's section Linear Time-Variant Model Predictive Control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from railrepro.control.predictive import PredictiveController
from railrepro.control.solvers.planner import planner
from railrepro.model.control_model import DPSI_DP, PSI_AX, PSI_TR, PSIDOT_AX, XDOT, X
from railrepro.schema import require


@dataclass
class LTVMPC(PredictiveController):
    """LTV-MPC of one running gear; `printed` keeps discrepancy D6."""

    printed: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        require("LTVMPC: printed", self.printed, bool)
        self.horizon.affine = 0.0 if self.printed else 1.0
        self._samples = planner(self.horizon, self.vehicle.drive.torque_limit, linear=True)

    def expected_state(self) -> np.ndarray:
        """See `PredictiveController.expected_state`."""
        return self.horizon.x[1] + self.horizon.dx[1]

    def solve(self, du: np.ndarray) -> tuple[np.ndarray, int]:
        """See `PredictiveController.solve`; the start does not matter."""
        horizon = self.horizon
        x, x_d, theta = horizon.x, horizon.x_d, horizon.theta
        x[:], horizon.u[:] = 0.0, 0.0
        x[:, X], x[:, XDOT] = x_d[:, X], x_d[:, XDOT]
        if not self.printed:
            x[:, PSI_AX], x[:, PSIDOT_AX] = theta[:, PSI_TR], theta[:, DPSI_DP] * x_d[:, XDOT]
        horizon.linearise()
        horizon.solve()
        return horizon.du.copy(), 1
