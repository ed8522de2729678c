"""Nonlinear dynamic inversion of the lateral running-gear dynamics, the comparison controller of the paper.

The lateral position has relative degree three: y' = v psi_r, psi_r' = psi_Ax' - v kappa, and the yaw equation contains
the differential torque. The inverse of the corrected control model turns a wanted third derivative of y into du. The
track geometry at the present position is known to it (as to the MPC), preview is not.

Serves the paper's section Multi-Body Simulation Results (comparison after Grether 2018 and Heckmann 2020).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.errors import InputError
from railrepro.schema import is_number


@dataclass(frozen=True)
class NDI:
    """The inversion and the error dynamics it gives, a `railrepro.control.lateral.LateralLaw`.

    Attributes
    ----------
    pole : float
        Real pole, the integrator's and the fastest of the chain (rad/s).
    frequency, damping : float
        Complex pair of the chain: natural frequency (rad/s) and damping ratio (-).
    integral : float
        Gain of the position integral relative to `pole` (-); 0 switches integral action off.
    derivatives : int
        How many derivatives of the set point are fed forward, 0 (reading of the paper) to 3.
    """

    pole: float = 30.0
    frequency: float = 30.0
    damping: float = 1.0
    integral: float = 0.0
    derivatives: int = 0

    memory = ("integral",)
    """Integral of y* - y (m s)."""

    def __post_init__(self) -> None:
        for name in ("pole", "frequency", "damping", "integral"):
            value, low = getattr(self, name), 0.0
            if not (is_number(value) and (value > low or (name == "integral" and value == low)) and value <= 1e4):
                allowed = "from 0" if name == "integral" else "above 0"
                raise InputError(f"NDI: {name} = {value!r}, a number {allowed} and up to 10000 is needed")
        if self.derivatives not in (0, 1, 2, 3) or isinstance(self.derivatives, bool):
            raise InputError(f"NDI: derivatives = {self.derivatives!r}, one of 0, 1, 2, 3 is needed")

    def gains(self) -> dict[str, float]:
        """Coefficients k0, k1, k2 (1/s^3, 1/s^2, 1/s), integral gain (1/s^4) and feed-forward switches."""
        w, z, a = self.frequency, self.damping, self.pole
        k0 = a * w**2
        return {
            "k0": k0,
            "k1": w**2 + 2 * z * w * a,
            "k2": 2 * z * w + a,
            "ki": self.integral * self.pole * k0,
            **{f"ff{i}": float(self.derivatives >= i) for i in (1, 2, 3)},
        }

    def torque(
        self, gear: dict, track_ahead: dict, memory: dict, gain: dict, model: dict
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Differential torque that gives the lateral error its wanted third-order dynamics; see `LateralLaw.torque`.

        The integral rests while the torque is beyond its limit.
        """
        du = inverse(wanted_jerk(gear, track_ahead, memory["integral"], gain), gear, track_ahead, model)
        free = ca.fabs(du) < model["tau_max"]
        error = track_ahead["y_ref"] - gear["y_TrAx"]
        return du, {"integral": memory["integral"] + ca.if_else(free, EXCHANGE_PERIOD * error, 0)}


def wanted_jerk(gear: dict, track_ahead: dict, integral, gain: dict):
    """Third derivative of y (m/s^3) that the error dynamics ask for.

    Parameters
    ----------
    gear, track_ahead : dict of SX
        See `railrepro.control.lateral.GEAR` and `ROAD`.
    integral : SX
        Integral of y* - y (m s).
    gain : dict of SX
        See `NDI.gains`.
    """
    v, vdot, psi_r = gear["xdot"], gear["xddot"], gear["psi_TrAx"]
    psidot_r = gear["psidot_Ax"] - v * track_ahead["dpsi_dp"]
    ydot = v * psi_r
    yddot = v * psidot_r + vdot * psi_r
    ref1 = v * track_ahead["dy_ref"]
    ref2 = v**2 * track_ahead["ddy_ref"] + vdot * track_ahead["dy_ref"]
    ref3 = v**3 * track_ahead["dddy_ref"] + 3 * v * vdot * track_ahead["ddy_ref"]
    return (
        gain["k0"] * (track_ahead["y_ref"] - gear["y_TrAx"])
        + gain["k1"] * (gain["ff1"] * ref1 - ydot)
        + gain["k2"] * (gain["ff2"] * ref2 - yddot)
        + gain["ff3"] * ref3
        + gain["ki"] * integral
    )


def inverse(jerk, gear: dict, track_ahead: dict, model: dict):
    """Differential torque (N m) under which y has a third derivative (m/s^3); see `wanted_jerk`.

    The weight's yaw stiffness, one hundredth of the spring's, and the yaw moment of a base torque on unequal rolling
    radii are left out.

    Source: corrected yaw equation to first order (`railrepro.evidence.bench.linearised`).
    """
    v, vdot = gear["xdot"], gear["xddot"]
    ydot, psidot_r = v * gear["psi_TrAx"], gear["psidot_Ax"] - v * track_ahead["dpsi_dp"]
    psiddot_r = (jerk - 2 * vdot * psidot_r) / ca.fmax(v, 1.0)
    psiddot = psiddot_r + track_ahead["ddpsi_dp"] * v**2 + track_ahead["dpsi_dp"] * vdot
    roll_rate = track_ahead["dphi_dp"] * v - model["gamma"] * ydot
    moment = (
        model["J_eff"] * psiddot
        + model["k_sz"] * (gear["psi_Ax"] - track_ahead["psi_CB"])
        + model["k_dz"] * (gear["psidot_Ax"] - v * track_ahead["dpsi_dp_CB"])
        - 2 * model["J_Wy"] * v / model["r_0"] * roll_rate
        + model["J_Wy"] * model["b"] * v * model["tan_delta"] / model["r_0"] ** 3 * ydot
    )
    return model["r_0"] / model["b"] * moment
