"""Nonlinear dynamic inversion of the lateral running-gear dynamics, the comparison controller of the paper.

The lateral position has relative degree three: y' = v psi_r, psi_r' = psi_Ax' - v kappa, and the yaw equation contains
the differential torque. The inverse of the corrected control model turns a wanted third derivative of y into du. The
track geometry at the present position is known to it (as to the MPC), the road ahead is not.

Serves the paper's section Multi-Body Simulation Results (comparison after Grether 2018 and Heckmann 2020).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True)
class NDISettings:
    """Error dynamics of the inversion.

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

    def gains(self) -> dict[str, float]:
        """Coefficients k0, k1, k2 (1/s^3, 1/s^2, 1/s), integral gain (1/s^4) and feed-forward switches."""
        w, z, a = self.frequency, self.damping, self.pole
        k0 = a * w**2
        return {
            "ndi.k0": k0,
            "ndi.k1": w**2 + 2 * z * w * a,
            "ndi.k2": 2 * z * w + a,
            "ndi.ki": self.integral * self.pole * k0,
            **{f"ndi.ff{i}": float(self.derivatives >= i) for i in (1, 2, 3)},
        }


def differential_torque(gear: dict, road: dict, integral, gain, model):
    """Differential torque that gives the lateral error its wanted third-order dynamics.

    Parameters
    ----------
    gear : dict of SX
        v, vdot, y, psi_r, psidot_Ax, psi_Ax of the running gear (SI).
    road : dict of SX
        psi_Tr, kappa, dkappa, dphi, psi_CB, kappa_CB at the gear, and y_ref with derivatives over p: y0, y1, y2, y3.
    integral : SX
        Integral of y* - y (m s).
    gain, model : mapping
        Gains of `NDISettings.gains`; model parameters J_eff, k_sz, k_dz, J_Wy, r0, b, gamma, tan_delta.

    Returns
    -------
    SX
        du (N m).

    Source: exact linearisation of the corrected yaw equation (`railrepro.model.derivation.linearised_yaw_equation`).
    """
    v, vdot = gear["v"], gear["vdot"]
    psi_r, psidot_r = gear["psi_r"], gear["psidot_Ax"] - v * road["kappa"]
    ydot = v * psi_r
    yddot = v * psidot_r + vdot * psi_r
    ref1 = v * road["y1"]
    ref2 = v**2 * road["y2"] + vdot * road["y1"]
    ref3 = v**3 * road["y3"] + 3 * v * vdot * road["y2"]
    wanted = (
        gain["ndi.k0"] * (road["y0"] - gear["y"])
        + gain["ndi.k1"] * (gain["ndi.ff1"] * ref1 - ydot)
        + gain["ndi.k2"] * (gain["ndi.ff2"] * ref2 - yddot)
        + gain["ndi.ff3"] * ref3
        + gain["ndi.ki"] * integral
    )
    psiddot_r = (wanted - 2 * vdot * psidot_r) / ca.fmax(v, 1.0)
    psiddot = psiddot_r + road["dkappa"] * v**2 + road["kappa"] * vdot
    roll_rate = road["dphi"] * v - model["gamma"] * ydot
    moment = (
        model["J_eff"] * psiddot
        + model["k_sz"] * (gear["psi_Ax"] - road["psi_CB"])
        + model["k_dz"] * (gear["psidot_Ax"] - v * road["kappa_CB"])
        - 2 * model["J_Wy"] * v / model["r0"] * roll_rate
        + model["J_Wy"] * model["b"] * v * model["tan_delta"] / model["r0"] ** 3 * ydot
    )
    return model["r0"] / model["b"] * moment
