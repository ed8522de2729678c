"""Ratio of two gains of a controller, which with the creep angle of the wheels gives its steady error in a curve.

The wheels carry the unbalanced side force by rolling at an angle to the track. A controller whose model rolls ideally
takes the angle for a motion and steers against it, until its position error demands as much torque the other way:
y - y_ref = -(k1 / k0) v psi_creep.
"""

from __future__ import annotations

import numpy as np

from railrepro.control.ndi import NDI
from railrepro.control.registry import tuned
from railrepro.model.control_model import PSI_AX, PSI_TRAX, STATES, XDOT, X, Y
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle


def gain_ratio(controller: str, setting: str, speed: float) -> float:
    """Return k1 / k0 (s) of a tuned controller at a speed (m/s): torque per lateral rate over torque per displacement.

    `controller` is NDI, which has these gains, or a predictive one: k1 and k0 follow from the torques that it first
    plans for a turned and for a displaced running gear. `setting` ("paper", "equal" or "loop") chooses its tuned set.
    """
    guidance = tuned(controller, setting=setting)
    if isinstance(guidance, NDI):
        return guidance.gains()["k1"] / guidance.gains()["k0"]
    straight = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=3.6 * speed)
    asked, centred, small = guidance(load_vehicle(), straight.route(), 0), np.zeros(len(STATES)), 1e-4
    centred[[X, XDOT]] = 100.0, speed
    displaced, turned = centred.copy(), centred.copy()
    displaced[Y] = turned[PSI_AX] = turned[PSI_TRAX] = small
    return asked.plan(turned, 0.0) / asked.plan(displaced, 0.0) / speed
