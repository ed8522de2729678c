"""Adhesion control: one law for regular operation and for seeking the adhesion maximum, in traction and braking.

The law moves the base torque by a fixed step each millisecond. Segment I (adhesion below the set point, stable branch):
raise; segment II (inside the corridor): hold; segment III (adhesion above the set point, or any wheel past its
maximum): lower. It knows estimates of adhesion and slip, nothing of the contact law.

Serves the paper's section Adhesion Control.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from railrepro.clock import CONTROL_PERIOD
from railrepro.data import Quantity, between, require

_RANGES: dict[str, Quantity | type] = {
    **dict.fromkeys(("raise_step", "lower_step", "drop_step"), between(0.0, 1e9, "N m per ms")),
    "corridor": between(0.0, 1.0),
    "filter_time": between(0.0, 10.0, "s"),
    "dead_zone": between(0.0, 1e9, "1/s"),
    "noise_speed": between(0.0, 1e3, "m/s"),
    "active": bool,
}
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

    Attributes
    ----------
    raise_step : float
        Step up in segment I, the paper's p1 (N m per ms).
    lower_step : float
        Step down above the corridor, the paper's p2 (N m per ms).
    drop_step : float
        Step down in segment III past the maximum (N m per ms).
    corridor : float
        Half width of the tolerance corridor around the set point (-).
    filter_time : float
        Time constant of the derivative filters (s).
    dead_zone : float
        Slip rate below which the switching function is ignored (1/s).
    noise_speed : float
        Speed below which the dead zone grows as 1/v, as the noise of a slip made of speeds does (m/s); 0: constant.
    active : bool
        False gives the baseline without slip control: the torque follows the demand with `raise_step`.

    Raises
    ------
    InputError
        When a value is of another kind or beyond its range.
    """

    raise_step: float = 2.0
    lower_step: float = 5.0
    drop_step: float = 15.0
    corridor: float = 0.003
    filter_time: float = 5e-3
    dead_zone: float = 1e-3
    noise_speed: float = 0.0
    active: bool = True
    memory: ClassVar[tuple[str, ...]] = ("u", "f_0", "f_1", "s_0", "s_1")
    """Names of the states of the law, see `base_torque`."""

    def __post_init__(self) -> None:
        for name, allowed in _RANGES.items():
            require(f"AdhesionSettings: {name}", getattr(self, name), allowed)

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        return {f"adhesion.{name}": float(getattr(self, name)) for name in _RANGES}

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
