"""An optimised policy of the Gymnasium environment as an entry: 14 weights, found in a minute by evolution.

`python -m railrepro.evidence.env.learn` finds them, on the first 300 m of T3 with perfect measurements.
"""

import numpy as np

from railrepro.evidence.env.observation import Sight


class LinearPolicy:
    period = 0.005  # s
    weights = (0.02945, 0.2378, -0.05356, -0.003495, 0.008924, 0.02252, -0.02008, 0.009703, 0.001079)
    weights += (-0.0156, 0.004798, -0.01889, -0.01115, 0.001961)

    def __init__(self, vehicle, route, gear):
        self.sight, self.limit, self.torque = Sight(route, vehicle), vehicle.drive.torque_limit, 0.0

    def plan(self, x_hat, u_d):
        seen = self.sight.seen(x_hat[None, :], np.array([self.torque]))[0]
        self.torque = self.limit * float(np.clip(seen @ self.weights, -1, 1))
        return self.torque
