"""Adhesion control: one law for regular operation and for seeking the adhesion maximum, in traction and braking.

The law moves the base torque by a fixed step each millisecond. Segment I (adhesion below the set point, stable branch):
raise; segment II (inside the corridor): hold; segment III (adhesion above the set point, or any wheel past its
maximum): lower. It knows estimates of adhesion and slip, nothing of the contact law. Serves the paper's section
Adhesion Control.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import casadi as ca

from railrepro.clock import CONTROL_PERIOD
from railrepro.data import between, check_fields
from railrepro.quantities import SIDES, Scalar

_STEP = Annotated[float, between(0.0, 1e9, "N m per ms")]
SLOWEST = 1.0
"""Speed (m/s) below which the dead zone grows no more as the speed falls."""


@dataclass(frozen=True)
class AdhesionInputs:
    """Inputs of the adhesion law for one running gear; lists are [left, right] wheel."""

    f: Annotated[list[Scalar], SIDES, "adhesion (-), traction-positive"]
    s: Annotated[list[Scalar], SIDES, "slip (v - w r)/v (-)"]
    f_star: Annotated[Scalar, "-", "set point of the adhesion, traction-positive"]
    v: Annotated[Scalar, "m/s", "speed"]
    u: Annotated[Scalar, "N m", "base torque of the cycle before"]
    nominal_load: Annotated[Scalar, "N", "load of a wheel at rest"]
    tau_max: Annotated[Scalar, "N m", "torque limit"]
    r_0: Annotated[Scalar, "m", "wheel radius"]


@dataclass(frozen=True)
class AdhesionMemory:
    """States of the adhesion law for one running gear; lists are [left, right] wheel."""

    f: Annotated[list[Scalar], SIDES, "low-pass filtered adhesion (-)"]
    s: Annotated[list[Scalar], SIDES, "low-pass filtered slip (-)"]


@dataclass(frozen=True)
class AdhesionSettings:
    """Parameters of the adhesion law. InputError for a value of another type or beyond its range."""

    raise_step: _STEP = 2.0
    """Increase of the base torque while adhesion is below the corridor, segment I (N m per ms), the paper's p1."""
    lower_step: _STEP = 5.0
    """Decrease of the base torque while adhesion is above the corridor (N m per ms), the paper's p2."""
    drop_step: _STEP = 100.0
    """Decrease of the base torque when a wheel is past its adhesion maximum, segment III (N m per ms)."""
    corridor: Annotated[float, between(0.0, 1.0)] = 0.003
    """Half width of the tolerance corridor around the set point of adhesion (-)."""
    filter_time: Annotated[float, between(0.0, 10.0, "s")] = 5e-3
    """Time constant of the low-pass filters of adhesion and slip, from which their rates are taken (s)."""
    dead_zone: Annotated[float, between(0.0, 1e9, "1/s")] = 2e-3
    """Slip rate (1/s) below which no wheel counts as past its adhesion maximum."""
    noise_speed: Annotated[float, between(0.0, 1e3, "m/s")] = 0.0
    """Speed (m/s) below which the dead zone grows as 1/v, as the noise of a slip computed from speeds; 0: constant."""
    active: bool = True
    """False: no slip control; the base torque follows the demand, changing by at most `raise_step` (N m) per ms."""

    def __post_init__(self) -> None:
        check_fields(self)

    def base_torque(self, q: AdhesionInputs, memory: AdhesionMemory) -> tuple:
        """One cycle (1 ms) of the adhesion law for one running gear. Arguments are numbers or CasADi expressions.

        Adhesion and slip are turned to be positive in the direction of the demand. With the sign of s that the paper
        prints, f' s' < 0 would mark the stable branch in traction. Source: eqs. (21), (22), (23), (25).

        Args:
            q (AdhesionInputs): Inputs of this cycle.
            memory (AdhesionMemory): Filter states after the previous cycle.

        Returns:
            tuple: Base torque per wheel (N m); next `AdhesionMemory`; segment: 1 raise, 2 hold, 3 lower.
        """
        sign = ca.if_else(q.f_star < 0, -1, 1)
        pole = CONTROL_PERIOD / (self.filter_time + CONTROL_PERIOD)
        dead_zone = self.dead_zone * ca.fmax(1, self.noise_speed / ca.fmax(q.v, SLOWEST))
        filtered = AdhesionMemory([], [])
        unstable = 0
        for f, s, old_f, old_s in zip(q.f, q.s, memory.f, memory.s, strict=True):
            filtered.f.append(old_f + pole * (f - old_f))
            filtered.s.append(old_s + pole * (s - old_s))
            f_rate = sign * (filtered.f[-1] - old_f) / CONTROL_PERIOD
            s_rate = -sign * (filtered.s[-1] - old_s) / CONTROL_PERIOD
            falling = ca.logic_and(f_rate * s_rate < 0, ca.fabs(s_rate) > dead_zone)
            unstable = ca.logic_or(unstable, ca.logic_and(falling, sign * s < 0))
        error = sign * (q.f_star - (q.f[0] + q.f[1]) / 2)
        above, below = error < -self.corridor, error > self.corridor
        regular = ca.if_else(below, self.raise_step, ca.if_else(above, -self.lower_step, 0))
        along = sign * q.u
        # Letting go of a wheel ends at zero torque and never pushes it the other way.
        released = ca.fmax(along - self.drop_step, 0)
        moved = ca.if_else(ca.logic_and(unstable, along > 0), released, along + regular)
        seeking = sign * ca.fmin(ca.fmax(moved, -q.tau_max), q.tau_max)

        direct = q.f_star * (q.nominal_load * q.r_0)
        ramp = q.u + ca.fmin(ca.fmax(direct - q.u, -self.raise_step), self.raise_step)
        follow = ca.fmin(ca.fmax(ramp, -q.tau_max), q.tau_max)
        u = ca.if_else(self.active, seeking, follow)
        segment = ca.if_else(ca.logic_or(unstable, above), 3, ca.if_else(below, 1, 2))
        return u, filtered, segment
