"""Adhesion control: one law for regular operation and for seeking the adhesion maximum, in traction and braking.

The law moves the base torque by a fixed step each millisecond. Segment I (adhesion below the set point, stable branch):
raise; segment II (inside the corridor): hold; segment III (adhesion above the set point, or any wheel past its
maximum): lower. It knows estimates of adhesion and slip, nothing of the contact law.

Serves the paper's section Adhesion Control.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

import casadi as ca

from railrepro.clock import CONTROL_PERIOD
from railrepro.data import between, check_fields

_STEP = Annotated[float, between(0.0, 1e9, "N m per ms")]
SLOWEST = 1.0
"""Speed below which the dead zone grows no more (m/s)."""


class LongitudinalLaw:
    """Settings of a law that gives the base torque of a running gear each millisecond."""

    memory: ClassVar[tuple[str, ...]]
    """Names of its states."""

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        raise NotImplementedError

    @staticmethod
    def law(f, s, f_star, v, ticks, memory: dict, gain, model) -> tuple:
        """Base torque per wheel (N m), next memory, and segment, as `base_torque` gives them.

        `ticks` counts the milliseconds; `model` has tau_max (N m), r_0 (m), J_Wy (kg m2) and m_x_eff (kg).
        """
        raise NotImplementedError


@dataclass(frozen=True)
class AdhesionSettings(LongitudinalLaw):
    """Parameters of the law.

    Raises
    ------
    InputError
        When a value is of another kind or beyond its range.
    """

    raise_step: _STEP = 2.0
    """Step up in segment I, the paper's p1."""
    lower_step: _STEP = 5.0
    """Step down above the corridor, the paper's p2."""
    drop_step: _STEP = 15.0
    """Step down in segment III past the maximum."""
    corridor: Annotated[float, between(0.0, 1.0)] = 0.003
    """Half width of the tolerance corridor around the set point (-)."""
    filter_time: Annotated[float, between(0.0, 10.0, "s")] = 5e-3
    """Time constant of the derivative filters."""
    dead_zone: Annotated[float, between(0.0, 1e9, "1/s")] = 1e-3
    """Slip rate below which the switching function is ignored."""
    noise_speed: Annotated[float, between(0.0, 1e3, "m/s")] = 0.0
    """Speed below which the dead zone grows as 1/v, as the noise of a slip made of speeds does; 0: constant."""
    active: bool = True
    """False gives the baseline without slip control: the torque follows the demand with `raise_step`."""
    memory: ClassVar[tuple[str, ...]] = ("u", "f_0", "f_1", "s_0", "s_1")
    """Names of the states of the law, see `base_torque`."""

    def __post_init__(self) -> None:
        check_fields(self)

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        return {f"adhesion.{name}": float(value) for name, value in vars(self).items()}

    @staticmethod
    def law(f, s, f_star, v, ticks, memory: dict, gain, model) -> tuple:
        """See `LongitudinalLaw.law`."""
        return base_torque(f, s, f_star, v, memory, gain, model["tau_max"])


def base_torque(f, s, f_star, v, memory: dict, gain, tau_max) -> tuple:
    """Next base torque of one running gear.

    Parameters
    ----------
    f, s : list of SX
        Estimated adhesion (traction-positive) and slip s = (v - w r)/v of the left and right wheel (-).
    f_star : SX
        Adhesion set point, traction-positive (-).
    v : SX
        Speed (m/s).
    memory : dict of SX
        u (N m), f_0, f_1, s_0, s_1: base torque and filtered estimates of the previous call.
    gain : mapping
        `AdhesionSettings.gains`.
    tau_max : SX
        Torque limit (N m).

    Returns
    -------
    u : SX
        Base torque per wheel (N m).
    memory : dict of SX
        Memory for the next call.
    segment : SX
        1, 2 or 3.

    Source: eqs. (MAC_switching_function), (MAC_control_law), (RAC_law); with s as printed, the stable branch in
    traction has f' s' < 0, so the law works with slip counted in the direction of the demand.
    """
    sign = ca.if_else(f_star < 0, -1, 1)
    pole = CONTROL_PERIOD / (gain["adhesion.filter_time"] + CONTROL_PERIOD)
    dead_zone = gain["adhesion.dead_zone"] * ca.fmax(1, gain["adhesion.noise_speed"] / ca.fmax(v, SLOWEST))
    filtered, unstable = {}, 0
    for i in range(2):
        filtered[f"f_{i}"] = memory[f"f_{i}"] + pole * (f[i] - memory[f"f_{i}"])
        filtered[f"s_{i}"] = memory[f"s_{i}"] + pole * (s[i] - memory[f"s_{i}"])
        f_rate = sign * (filtered[f"f_{i}"] - memory[f"f_{i}"]) / CONTROL_PERIOD
        s_rate = -sign * (filtered[f"s_{i}"] - memory[f"s_{i}"]) / CONTROL_PERIOD
        falling = ca.logic_and(f_rate * s_rate < 0, ca.fabs(s_rate) > dead_zone)
        unstable = ca.logic_or(unstable, ca.logic_and(falling, sign * s[i] < 0))
    error = sign * (f_star - (f[0] + f[1]) / 2)
    above, below = error < -gain["adhesion.corridor"], error > gain["adhesion.corridor"]
    regular = ca.if_else(below, gain["adhesion.raise_step"], ca.if_else(above, -gain["adhesion.lower_step"], 0))
    along = sign * memory["u"]
    # Letting go of a wheel ends at zero torque and never pushes it the other way.
    released = ca.fmax(along - gain["adhesion.drop_step"], 0)
    moved = ca.if_else(ca.logic_and(unstable, along > 0), released, along + regular)
    seeking = sign * ca.fmin(ca.fmax(moved, -tau_max), tau_max)

    direct = f_star * gain["adhesion.torque_per_adhesion"]
    step = gain["adhesion.raise_step"]
    ramp = memory["u"] + ca.fmin(ca.fmax(direct - memory["u"], -step), step)
    follow = ca.fmin(ca.fmax(ramp, -tau_max), tau_max)
    u = ca.if_else(gain["adhesion.active"], seeking, follow)
    segment = ca.if_else(ca.logic_or(unstable, above), 3, ca.if_else(below, 1, 2))
    return u, filtered | {"u": u}, segment
