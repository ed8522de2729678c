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
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.control.adhesion import LongitudinalLaw
from railrepro.data import above, between, check_fields, require
from railrepro.quantities import group

_LEVEL = Annotated[float, above(0.0, 1.0)]
_TIME = Annotated[float, above(0.0, 100.0, "s")]
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
SlipMemory = group("SlipMemory", "demand N m, limit -, f -, s -, mean_f -, mean_s -, s_s -, s_f -")
"""States of the law: demand, limit of slip, filtered adhesion and slip in the direction of the demand, their means,
variance of slip and its covariance with adhesion."""


@dataclass(frozen=True)
class SlipSettings(LongitudinalLaw):
    """Parameters of the law.

    Raises
    ------
    InputError
        When a value is of another kind or beyond its range, or the range of the limit is empty.
    """

    raise_step: Annotated[float, between(0.0, 1e9, "N m per ms")] = 2.0
    """Largest change of the demanded torque; the limit itself acts at once."""
    rate: Annotated[float, above(0.0, 1e3, "1/s")] = 15.0
    """k, how fast slip follows its limit."""
    elasticity: Annotated[float, between(0.0, 1.0)] = 0.14
    """Wanted elasticity of adhesion over slip at the limit (-)."""
    seek: Annotated[float, between(0.0, 1e3, "1/s")] = 5.0
    """How fast the limit moves, relative to itself per elasticity."""
    start: _LEVEL = 0.012
    least: _LEVEL = 0.004
    most: _LEVEL = 0.05
    """First limit of slip, and its range (-)."""
    swing: Annotated[float, between(0.0, 0.5)] = 0.1
    """Amplitude of the limit's swing relative to the limit (-)."""
    swing_frequency: Annotated[float, between(0.0, 100.0, "Hz")] = 4.0
    mean_time: _TIME = 0.15
    """Time constant of the means from which deviations are counted."""
    forget: _TIME = 0.2
    """Time constant of the least squares."""
    filter_time: Annotated[float, between(0.0, 10.0, "s")] = 5e-3
    """Time constant of the low-pass of the estimates."""
    Memory: ClassVar[type] = SlipMemory

    def __post_init__(self) -> None:
        check_fields(self)
        require("SlipSettings: least", self.least, between(0.0, self.most))
        require("SlipSettings: start", self.start, between(self.least, self.most))

    def base_torque(self, q: Any, memory: Any) -> tuple:
        """Next base torque, see `LongitudinalLaw.base_torque`.

        Segment 1 follows the demand, 2 holds the limit of slip, 3 lowers the limit.
        """
        h, sign = CONTROL_PERIOD, ca.if_else(q.f_star < 0, -1, 1)
        along_f, along_s = [sign * value for value in q.f], [-sign * value for value in q.s]
        quick, passing, slow = (h / (time + h) for time in (self.filter_time, self.mean_time, self.forget))
        f, s = (old + quick * (sum(along) / 2 - old) for old, along in ((memory.f, along_f), (memory.s, along_s)))
        mean_f, mean_s = memory.mean_f + passing * (f - memory.mean_f), memory.mean_s + passing * (s - memory.mean_s)

        limit = ca.if_else(memory.limit > 0, memory.limit, self.start)
        swing = self.swing * ca.sin(2 * np.pi * self.swing_frequency * h * q.ticks)
        force = q.r_0 * q.nominal_load
        stiffness = self.rate * q.J_Wy * ca.fmax(q.v, _LEAST_SPEED) / q.r_0
        gaining = 2 * q.J_Wy / (q.r_0**2 * q.m_x_eff) * sign * q.u  # the wheel's own inertia
        unsure = 1 + _UNSURE * ca.fmax(1 - s / limit, 0)  # far from the limit the load of a gear need not be known
        held = force * f * unsure + gaining + stiffness * (limit * (1 + swing) - s)
        held -= stiffness * sum(ca.fmax(each - _SINGLE * limit, 0) for each in along_s)
        wanted = ca.fmin(ca.fmax(force * q.f_star, -q.tau_max), q.tau_max) - memory.demand
        demand = memory.demand + ca.fmin(ca.fmax(wanted, -self.raise_step), self.raise_step)

        along = sign * demand
        holds = ca.logic_and(held < along, along > 0)
        # least squares that forget, as long as the limit holds
        s_s = memory.s_s + holds * slow * ((s - mean_s) ** 2 - memory.s_s)
        s_f = memory.s_f + holds * slow * ((s - mean_s) * (f - mean_f) - memory.s_f)
        elasticity = _elasticity(s_f * mean_s / ca.fmax(mean_f, _LEAST_ADHESION), s_s, self.elasticity)
        moved = limit * (1 + h * self.seek * (elasticity - self.elasticity))
        moved = ca.fmin(ca.fmax(moved, self.least), self.most)
        u = sign * ca.if_else(holds, ca.fmax(held, 0), along)
        segment = 1 + holds * (1 + (elasticity < self.elasticity))
        return u, SlipMemory(demand, ca.if_else(holds, moved, limit), f, s, mean_f, mean_s, s_s, s_f), segment


def _elasticity(swung, variance, wanted) -> ca.SX:
    """Elasticity of adhesion (-): `swung` over the variance of slip, near `wanted` where slip hardly varied."""
    return ca.fmin(ca.fmax((swung + _PRIOR * wanted) / (variance + _PRIOR), -1), 1)
