"""Stability margins of the designs of LqgPreview against the linear car: gain, delay, disk.

The loop is broken at the torque. What the filter believes of the torque is what was sent, so the break lies behind it.
The filter for ideal rails and that for rough ones give the same margins to four digits: the gyro feels a torque, and
rails do not turn the gyro.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from railrepro.clock import CONTROL_PERIOD
from railrepro.estimation.sensors import Loop
from railrepro.own.gear_model import STATES
from railrepro.own.lqg import Design, LqgSettings
from railrepro.vehicle.parameters import Vehicle

FREQUENCIES = np.geomspace(0.05, 490.0, 1200)
"""At which a loop is evaluated (Hz)."""


def loop_gain(design: Design) -> np.ndarray:
    """Complex gain of the open loop with the filter for rough rails over `FREQUENCIES`, for negative feedback."""
    n, sent, model = len(STATES), design.sent, len(design.a)
    gain, *_ = design.kalman(design.rails[-1])
    feedback, _ = design.regulator()
    free = len(gain)
    read = design.read
    torque = np.concatenate([feedback[:model], np.zeros(free - model)])
    of_state = torque @ (np.eye(free) - gain @ read)
    step = np.eye(free)
    step[:model, :model] = design.a
    found = np.empty(len(FREQUENCIES), dtype=complex)
    for i, z in enumerate(np.exp(2j * np.pi * CONTROL_PERIOD * FREQUENCIES)):
        acts = design.b * z**-design.late
        own = np.concatenate([acts, np.zeros(free - model)])
        # the filter's state from readings and from the torque sent, and the torque from both
        inputs = np.column_stack([step @ gain, own])
        states = np.linalg.solve(z * np.eye(free) - step @ (np.eye(free) - gain @ read), inputs)
        past = 1 - (1 + feedback[model]) / z - sum(feedback[model + k] * z ** -(k + 1) for k in range(1, sent))
        answer = (of_state @ states[:, :3] + torque @ gain) / (past - of_state @ states[:, 3])
        car = np.linalg.solve(z * np.eye(n) - design.a[:n, :n], acts[:n])
        found[i] = -answer @ car[[STATES.index(name) for name in ("y", "psi", "r")]]
    return found


def margins(gain: np.ndarray) -> dict[str, float]:
    """Factors of gain down and up, delay (ms) and disk margin that a stable loop bears.

    Source: Seiler, Packard and Gahinet 2020, An introduction to disk margins, IEEE Control Systems 40(5).
    """
    real = np.nonzero((np.diff(np.sign(gain.imag)) != 0) & (gain.real[1:] < 0))[0]
    factors = -1 / gain.real[real]
    crossed = np.nonzero(np.diff(np.sign(np.abs(gain) - 1)))[0]
    delays = np.mod(np.angle(gain[crossed]) + np.pi, 2 * np.pi) / (2 * np.pi * FREQUENCIES[crossed])
    return {
        "gain_down": factors[factors < 1].max(initial=0.0),
        "gain_up": factors[factors > 1].min(initial=np.inf),
        "delay_ms": 1e3 * delays.min(initial=np.inf),
        "disk": 2 / np.abs((1 - gain) / (1 + gain)).max(),
    }


def table(vehicle: Vehicle, loop: Loop, settings: LqgSettings, speeds: np.ndarray) -> pd.DataFrame:
    """Margins of the designs at some speeds (m/s), one row each."""
    designs = [Design(vehicle, float(speed), settings, loop) for speed in speeds]
    return pd.DataFrame([{"speed_kmh": 3.6 * design.speed} | margins(loop_gain(design)) for design in designs])
