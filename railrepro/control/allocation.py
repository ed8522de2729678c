"""Integration rule: lateral and longitudinal demands share the limited motor torque of a running gear. Serves the
paper's section Integration Approach."""

import casadi as ca


def allocate(u_d, du, tau_max, fixed_share=0.0):
    """Motor torques of one running gear from base torque and differential torque, as numbers or CasADi expressions.

    The differential torque is limited first, and the longitudinal torque gets the rest of the limit. So a jump of `u_d`
    cannot disturb the guidance. Source: eqs. (41), (42) of the paper.

    Args:
        u_d, du: Base torque and differential torque per wheel (N m); du > 0 steers to the right.
        tau_max: Torque limit of a motor in both directions (N m).
        fixed_share: Share of the limit reserved for `du`, in (0, 1); `u_d` has the rest. 0: none, as in the paper.

    Returns:
        tau_le, tau_ri: Commands to the left and the right motor (N m).
        tau_long, du: Common longitudinal part of both commands, and limited differential torque (N m).
    """
    fixed = fixed_share > 0
    du_limit = ca.if_else(fixed, fixed_share * tau_max, tau_max)
    du = ca.fmin(ca.fmax(du, -du_limit), du_limit)
    rest = ca.if_else(fixed, (1 - fixed_share) * tau_max, tau_max - ca.fabs(du))
    tau_long = ca.if_else(u_d > 0, ca.fmin(u_d, rest), ca.fmax(u_d, -rest))
    return tau_long + du, tau_long - du, tau_long, du
