"""Integration rule: lateral and longitudinal demands share the limited motor torque of a running gear.

Serves the paper's section Integration Approach. Torques are traction-positive; du > 0 drives the left wheel harder and
steers to the right.
"""

from __future__ import annotations

import casadi as ca


def allocate(u_d, du, tau_max, fixed_share=0.0):
    """Motor torques of one running gear from base torque and differential torque.

    The differential torque is kept whole and the longitudinal torque takes the remainder, so a sharp change of `u_d`
    between two lateral updates cannot disturb the guidance.

    Args:
        u_d, du (SX or float): Base and differential torque per wheel (N m).
        tau_max (SX or float): Torque limit of a motor, used for both signs (N m).
        fixed_share (SX or float): 0 for the variable allocation of the paper; a share in (0, 1) reserves that part of
            the limit for `du` and the rest for `u_d`, as used before variable allocation.

    Returns:
        tau_le, tau_ri, tau_long, du (SX): Commands of left and right motor, their common longitudinal part, limited
            differential torque (N m).

    Source: eqs. (41), (42) of the paper.
    """
    fixed = fixed_share > 0
    du_limit = ca.if_else(fixed, fixed_share * tau_max, tau_max)
    du = ca.fmin(ca.fmax(du, -du_limit), du_limit)
    room = ca.if_else(fixed, (1 - fixed_share) * tau_max, tau_max - ca.fabs(du))
    tau_long = ca.if_else(u_d > 0, ca.fmin(u_d, room), ca.fmax(u_d, -room))
    return tau_long + du, tau_long - du, tau_long, du
