"""Nonlinear dynamic inversion of the lateral running-gear dynamics, the comparison controller of the paper. The lateral
position has relative degree three: y' = v psi_r, psi_r' = psi_Ax' - v kappa, and the yaw equation contains the
differential torque du. The inverse of the corrected control model computes du from the desired third derivative of y.
It knows the track at the present position and has no preview. Serves the paper's section Multi-Body Simulation Results
(comparison after Grether 2018 and Heckmann 2020)."""

from typing import Annotated

import casadi as ca
from pydantic import StrictBool

from railrepro.clock import CONTROL_PERIOD
from railrepro.control import lateral
from railrepro.data import Quantity, above, between, table


@table
class NDI:
    """Lateral law by dynamic inversion, which `simulate.run` takes as it is: its method `torque` gives the lateral
    error linear third-order dynamics with chosen poles.

    Attributes:
        pole (float): Magnitude of the real pole of the error dynamics (rad/s).
        frequency, damping (float): Natural frequency (rad/s) and damping ratio (-) of the pair of complex poles.
        integral (float): Relative gain ki/(k0 `pole`) of the integrated error (-). 0: no integral action.
        rates (bool): Whether the first three derivatives of the set point are fed forward; as we read the paper, not.
    """

    pole: Annotated[float, above(0.0, 1e4, "rad/s")] = 30.0
    frequency: Annotated[float, above(0.0, 1e4, "rad/s")] = 30.0
    damping: Annotated[float, above(0.0, 1e4)] = 1.0
    integral: Annotated[float, between(0.0, 1e4)] = 0.0
    rates: StrictBool = False

    alike = True
    memory = ("integral",)
    """Names of the states: integral of the lateral error y* - y (m s)."""

    def gains(self) -> dict[str, float]:
        """Gains of the law by name: k0 (1/s^3), k1 (1/s^2), k2 (1/s), ki (1/s^4), ff (-). The error has the
        characteristic polynomial s^3 + k2 s^2 + k1 s + k0. ki is the integral gain. ff is 1 with `rates`, else 0."""
        w, z, a = self.frequency, self.damping, self.pole
        k0, k1, k2 = a * w**2, w**2 + 2 * z * w * a, 2 * z * w + a
        return {"k0": k0, "k1": k1, "k2": k2, "ki": self.integral * a * k0, "ff": float(self.rates)}

    @staticmethod
    def ranges() -> dict[str, Quantity]:
        """Permitted range of each gain by name, for an exported controller, from the ranges of the fields."""
        most = NDI(1e4, 1e4, 1e4, 1e4, rates=True).gains()
        return {name: (between if name in ("ki", "ff") else above)(0.0, most[name], "") for name in most}

    def torque(self, q: lateral.Quantities) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Differential torque before its limit (N m), and the next integral of the error as a dict, from the symbols
        `q` of gear, track and vehicle. The integral stays constant while the torque is beyond the limit `q.tau_max`."""
        du = inverse(wanted_jerk(q), q)
        free = ca.fabs(du) < q.tau_max
        return du, {"integral": q.integral + ca.if_else(free, CONTROL_PERIOD * (q.y_ref - q.y), 0)}


def wanted_jerk(q: lateral.Quantities) -> ca.SX:
    """Third time derivative of the lateral displacement y (m/s^3) that the gains of `NDI` demand, as an expression of
    the symbols `q` of gear, track, vehicle and gains."""
    psidot_r = q.yaw_rate - q.v * q.dpsi_dp
    ydot = q.v * q.psi
    yddot = q.v * psidot_r + q.xddot * q.psi
    ref1 = q.v * q.dy_ref
    ref2 = q.v**2 * q.ddy_ref + q.xddot * q.dy_ref
    ref3 = q.v**3 * q.dddy_ref + 3 * q.v * q.xddot * q.ddy_ref
    return (
        q.k0 * (q.y_ref - q.y)
        + q.k1 * (q.ff * ref1 - ydot)
        + q.k2 * (q.ff * ref2 - yddot)
        + q.ff * ref3
        + q.ki * q.integral
    )


def inverse(jerk: ca.SX, q: lateral.Quantities) -> ca.SX:
    """Differential torque (N m) at which y has the third time derivative `jerk` (m/s^3), as an expression of the
    symbols `q` of gear, track and vehicle. The yaw equation is that of the corrected control model to first order
    (`railrepro.model.derivation`). It neglects the yaw stiffness by gravity, which is 1 % of the stiffness of the
    springs, and the yaw moment of the base torque on unequal rolling radii or a rolled axle."""
    ydot, psidot_r = q.v * q.psi, q.yaw_rate - q.v * q.dpsi_dp
    psiddot_r = (jerk - 2 * q.xddot * psidot_r) / ca.fmax(q.v, 1.0)
    psiddot = psiddot_r + q.ddpsi_dp * q.v**2 + q.dpsi_dp * q.xddot
    roll_rate = q.dphi_dp * q.v - q.gamma * ydot
    moment = (
        q.J_eff * psiddot
        + q.k_sz * (q.psi_Ax - q.psi_CB)
        + q.k_dz * (q.yaw_rate - q.v * q.dpsi_dp_CB)
        - 2 * q.J_Wy * q.v / q.r_0 * roll_rate
        + q.J_Wy * q.b * q.v * q.tan_delta / q.r_0**3 * ydot
    )
    return q.r_0 / q.b * moment
