r"""Slip control of our own: a base torque that holds a limit of slip, and a limit that seeks a place below the maximum.

A wheel with moment of inertia J that is commanded

    u = r_0 N f + J v'/r_0 + J v/r_0 k (sigma_lim - sigma)

follows its limit as sigma' = k (sigma_lim - sigma), whatever the friction is. The base torque of a gear is the demand,
or less where a wheel would slip more than its limit. Where the limit acts it swings a little, and the slope of adhesion
f over slip sigma, found by least squares that forget, moves it until the elasticity sigma f'/f is `elasticity`: 1 is
the linear range, 0 the maximum.

No counterpart in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.control.adhesion import LongitudinalLaw
from railrepro.data import above, between, require

_RANGES = {
    "raise_step": between(0.0, 1e9, "N m per ms"),
    "rate": above(0.0, 1e3, "1/s"),
    "elasticity": between(0.0, 1.0),
    "seek": between(0.0, 1e3, "1/s"),
    "start": above(0.0, 1.0),
    "least": above(0.0, 1.0),
    "most": above(0.0, 1.0),
    "swing": between(0.0, 0.5),
    "swing_frequency": between(0.0, 100.0, "Hz"),
    "mean_time": above(0.0, 100.0, "s"),
    "forget": above(0.0, 100.0, "s"),
    "filter_time": between(0.0, 10.0, "s"),
}


@dataclass(frozen=True)
class SlipSettings(LongitudinalLaw):
    """Parameters of the law.

    Attributes
    ----------
    raise_step : float
        Largest change of the demanded torque (N m per ms); the limit itself acts at once.
    rate : float
        k, how fast slip follows its limit (1/s).
    elasticity : float
        Wanted elasticity of adhesion over slip at the limit (-).
    seek : float
        How fast the limit moves, relative to itself per elasticity (1/s).
    start, least, most : float
        First limit, and its range (-).
    swing, swing_frequency : float
        Amplitude of the limit's swing relative to it, and its frequency (-, Hz).
    mean_time, forget : float
        Time constants of the means from which deviations are counted, and of the least squares (s).
    filter_time : float
        Time constant of the low-pass of the estimates (s).

    Raises
    ------
    InputError
        When a value is of another kind or beyond its range, or the range of the limit is empty.
    """

    raise_step: float = 2.0
    rate: float = 15.0
    elasticity: float = 0.14
    seek: float = 5.0
    start: float = 0.012
    least: float = 0.004
    most: float = 0.05
    swing: float = 0.1
    swing_frequency: float = 4.0
    mean_time: float = 0.15
    forget: float = 0.2
    filter_time: float = 5e-3
    memory: ClassVar[tuple[str, ...]] = ("u", "demand", "limit", "f", "s", "mean_f", "mean_s", "s_s", "s_f")
    """Names of the states of the law, see `base_torque`."""

    def __post_init__(self) -> None:
        for name, allowed in _RANGES.items():
            require(f"SlipSettings: {name}", getattr(self, name), allowed)
        require("SlipSettings: least", self.least, between(0.0, self.most))
        require("SlipSettings: start", self.start, between(self.least, self.most))

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        return {f"adhesion.{name}": float(getattr(self, name)) for name in _RANGES}

    @staticmethod
    def law(f, s, f_star, v, ticks, memory: dict, gain, model) -> tuple:
        """See `LongitudinalLaw.law`."""
        return base_torque(f, s, f_star, v, ticks, memory, gain, model)


_LEAST_SPEED = 12.0
"""Speed below which the gain of the limit stays (m/s)."""
_PRIOR = 2e-8
"""Variance of slip at which what was measured counts as much as the wanted elasticity, which leaves the limit alone."""
_SINGLE = 2.0
"""A single wheel may slip this much more than the mean of both."""
_UNSURE = 0.15
"""Share by which the wheel load of a gear may differ from its nominal one."""
_LEAST_ADHESION = 0.01
"""Adhesion below which there is no elasticity to speak of (-)."""


def base_torque(f, s, f_star, v, ticks, memory: dict, gain, model) -> tuple:
    """Next base torque of one running gear.

    Parameters
    ----------
    f, s : list of SX
        Estimated adhesion (traction-positive) and slip s = (v - w r)/v of the left and right wheel (-).
    f_star : SX
        Adhesion set point, traction-positive (-).
    v, ticks : SX
        Speed (m/s) and number of the control cycle.
    memory : dict of SX
        `SlipSettings.memory`: base torque and demand (N m), limit (-), filtered adhesion and slip in the direction of
        the demand, their means, variance of slip and covariance with adhesion.
    gain : mapping
        `SlipSettings.gains` and nominal_load (N).
    model : mapping
        Of the control model: tau_max (N m), r_0 (m), J_Wy (kg m2), m_x_eff (kg).

    Returns
    -------
    u : SX
        Base torque per wheel (N m).
    memory : dict of SX
        Memory for the next call.
    segment : SX
        1 follows the demand, 2 holds the limit of slip, 3 lowers the limit.
    """
    h, sign = CONTROL_PERIOD, ca.if_else(f_star < 0, -1, 1)
    along_f, along_s = [sign * value for value in f], [-sign * value for value in s]
    quick, passing, slow = (h / (gain[f"adhesion.{name}"] + h) for name in ("filter_time", "mean_time", "forget"))
    old = {name: memory[name] for name in SlipSettings.memory}
    new = {"f": old["f"] + quick * (sum(along_f) / 2 - old["f"]), "s": old["s"] + quick * (sum(along_s) / 2 - old["s"])}
    for name in ("f", "s"):
        new[f"mean_{name}"] = old[f"mean_{name}"] + passing * (new[name] - old[f"mean_{name}"])

    limit = ca.if_else(old["limit"] > 0, old["limit"], gain["adhesion.start"])
    swing = gain["adhesion.swing"] * ca.sin(2 * np.pi * gain["adhesion.swing_frequency"] * h * ticks)
    force = model["r_0"] * gain["nominal_load"]
    stiffness = gain["adhesion.rate"] * model["J_Wy"] * ca.fmax(v, _LEAST_SPEED) / model["r_0"]
    gaining = 2 * model["J_Wy"] / (model["r_0"] ** 2 * model["m_x_eff"]) * sign * old["u"]  # the wheel's own inertia
    unsure = 1 + _UNSURE * ca.fmax(1 - new["s"] / limit, 0)  # far from the limit the load of a gear need not be known
    held = force * new["f"] * unsure + gaining + stiffness * (limit * (1 + swing) - new["s"])
    held -= stiffness * sum(ca.fmax(each - _SINGLE * limit, 0) for each in along_s)
    wanted = ca.fmin(ca.fmax(force * f_star, -model["tau_max"]), model["tau_max"]) - old["demand"]
    new["demand"] = old["demand"] + ca.fmin(ca.fmax(wanted, -gain["adhesion.raise_step"]), gain["adhesion.raise_step"])

    along = sign * new["demand"]
    holds = ca.logic_and(held < along, along > 0)
    elasticity = _elasticity(old, new, holds * slow, gain["adhesion.elasticity"])
    moved = limit * (1 + h * gain["adhesion.seek"] * (elasticity - gain["adhesion.elasticity"]))
    moved = ca.fmin(ca.fmax(moved, gain["adhesion.least"]), gain["adhesion.most"])
    new["limit"] = ca.if_else(holds, moved, limit)
    new["u"] = sign * ca.if_else(holds, ca.fmax(held, 0), along)
    segment = 1 + holds * (1 + (elasticity < gain["adhesion.elasticity"]))
    return new["u"], new, segment


def _elasticity(old: dict, new: dict, share: ca.SX, wanted: ca.SX) -> ca.SX:
    """Elasticity of adhesion over slip by least squares, whose sums are renewed by a share; near the wanted one (-)
    where little was measured."""
    off_f, off_s = (new[name] - new[f"mean_{name}"] for name in ("f", "s"))
    for name, product in (("s_s", off_s**2), ("s_f", off_s * off_f)):
        new[name] = old[name] + share * (product - old[name])
    swung = new["s_f"] * new["mean_s"] / ca.fmax(new["mean_f"], _LEAST_ADHESION)
    return ca.fmin(ca.fmax((swung + _PRIOR * wanted) / (new["s_s"] + _PRIOR), -1), 1)
