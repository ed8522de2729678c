"""Adhesion control: one law for regular operation and for seeking the adhesion maximum, in traction and braking. The
law changes the base torque by a fixed step each millisecond. In segment I the adhesion is below a corridor around the
set point, and the torque rises. In segment II it is inside the corridor, and the torque stays. In segment III it is
above, or a wheel is past its adhesion maximum, and the torque falls. The law gets estimates of adhesion and slip and
does not know the creep law. Serves the paper's section Adhesion Control."""

from dataclasses import dataclass
from typing import Annotated

import casadi as ca
from pydantic import StrictBool

from railrepro.clock import CONTROL_PERIOD
from railrepro.data import between, table
from railrepro.quantities import SIDES, Scalar

_STEP = Annotated[float, between(0.0, 1e9, "N m per ms")]
SLOWEST = 1.0
"""Speed (m/s) below which the dead zone no longer grows."""


@dataclass(frozen=True)
class AdhesionInputs:
    """Inputs of the adhesion law of one running gear: adhesion `f` and slip `s` of its [left, right] wheel, set point
    `f_star`, speed `v` of the gear along the track, base torque `u` of the cycle before, and data of the vehicle. The
    base torque, which left and right wheel have in common, is the result of this law."""

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
    """What the adhesion law keeps from cycle to cycle: filtered adhesion and slip of the [left, right] wheel."""

    f: Annotated[list[Scalar], SIDES, "low-pass filtered adhesion (-)"]
    s: Annotated[list[Scalar], SIDES, "low-pass filtered slip (-)"]


@table
class AdhesionSettings:
    """Parameters of the adhesion law, which changes the base torque (common to both wheels) of a running gear every ms.

    Attributes:
        raise_step (float): Rise of the base torque below the corridor (N m per ms), p1 of eq. (23) and p2 of eq. (25).
        lower_step (float): Fall of the base torque above the corridor (N m per ms), p2 of eq. (25).
        drop_step (float): Fall of the base torque past the adhesion maximum of a wheel (N m per ms), p1 of eq. (23).
        corridor (float): Half width of the corridor around the set point of the adhesion (-).
        filter_time (float): Time constant of the low-pass filters of adhesion and slip (s); the law uses their rates.
        dead_zone (float): Rate of the slip (1/s) below which no wheel counts as past its adhesion maximum.
        noise_speed (float): Speed (m/s) below which the dead zone grows as 1/v, like the noise of a slip computed from
            sensors. 0, for exact slip: the dead zone is constant.
        active (bool): False: no slip control. The base torque moves towards set point x static wheel load x wheel
            radius (N m), by at most `raise_step` per ms.
    """

    raise_step: _STEP = 2.0
    lower_step: _STEP = 5.0
    drop_step: _STEP = 100.0
    corridor: Annotated[float, between(0.0, 1.0)] = 0.003
    filter_time: Annotated[float, between(0.0, 10.0, "s")] = 5e-3
    dead_zone: Annotated[float, between(0.0, 1e9, "1/s")] = 2e-3
    noise_speed: Annotated[float, between(0.0, 1e3, "m/s")] = 0.0
    active: StrictBool = True

    def base_torque(self, q: AdhesionInputs, memory: AdhesionMemory) -> tuple:
        """Compute a cycle (1 ms) of the adhesion law of a running gear, with numbers or CasADi expressions. A wheel is
        past its adhesion maximum if its filtered adhesion f and slip s, both positive in the direction of the demand,
        change in opposite senses, f' s' < 0, with |s'| above the dead zone, and its slip is above 0. (With the sign of
        s that the paper prints, this would hold before the maximum in traction.) Returns a tuple: the base torque per
        wheel (N m), if not `active` that without slip control; the next `AdhesionMemory`; and the segment, also if not
        `active`: 1 adhesion below the corridor, 2 inside, 3 above it or a wheel past its maximum. Source: eqs. (21),
        (22), (23), (25)."""
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
        # a drop ends at zero torque and does not reverse it
        released = ca.fmax(along - self.drop_step, 0)
        moved = ca.if_else(ca.logic_and(unstable, along > 0), released, along + regular)
        seeking = sign * ca.fmin(ca.fmax(moved, -q.tau_max), q.tau_max)

        direct = q.f_star * (q.nominal_load * q.r_0)
        ramp = q.u + ca.fmin(ca.fmax(direct - q.u, -self.raise_step), self.raise_step)
        follow = ca.fmin(ca.fmax(ramp, -q.tau_max), q.tau_max)
        u = ca.if_else(self.active, seeking, follow)
        segment = ca.if_else(ca.logic_or(unstable, above), 3, ca.if_else(below, 1, 2))
        return u, filtered, segment
