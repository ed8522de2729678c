"""Linear time-variant MPC: the model linearised in centred riding along the forecast, one QP per sample.

By default the linearisation is about the track direction and keeps its affine term; the printed one (psi_Ax = 0, no
affine term, D6) is selectable. Serves the paper's section Linear Time-Variant Model Predictive Control.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from railrepro.control.predictive import PredictiveController


@dataclass
class LTVMPC(PredictiveController):
    """LTV-MPC of one running gear; `printed` keeps discrepancy D6."""

    printed: bool = False

    def __post_init__(self):
        super().__post_init__()
        self.horizon.affine = 0.0 if self.printed else 1.0

    def expected_state(self) -> np.ndarray:
        """See `PredictiveController.expected_state`."""
        return self.horizon.x[1] + self.horizon.dx[1]

    def solve(self, du: np.ndarray) -> tuple[np.ndarray, int]:
        """See `PredictiveController.solve`; the start does not matter."""
        horizon = self.horizon
        horizon.x[:], horizon.u[:] = 0.0, 0.0
        horizon.x[:, 0], horizon.x[:, 2] = horizon.x_d[:, 0], horizon.x_d[:, 2]
        if not self.printed:
            horizon.x[:, 1], horizon.x[:, 3] = horizon.theta[:, 0], horizon.theta[:, 1] * horizon.x_d[:, 2]
        horizon.linearise()
        horizon.solve()
        return horizon.du.copy(), 1
