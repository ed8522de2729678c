"""Integration rule: lateral and longitudinal demands share the limited motor torque of a running gear. Serves the
paper's section Integration Approach."""

import casadi as ca


def allocate(u_d, du, tau_max, fixed_share=0.0):
    """Motor torques of one running gear (N m) from base torque `u_d` and differential torque `du` per wheel (N m); a
    positive `du` steers to the right. Numbers or CasADi expressions. The differential torque is limited first, and the
    longitudinal torque gets the rest of the limit `tau_max` (N m) of a motor. So a jump of `u_d` cannot disturb the
    guidance. With a `fixed_share` of the limit, in (0, 1), `du` is limited to this share and `u_d` to the rest; 0:
    none, as in the paper. Returns four torques: commands to the left and the right motor, their common longitudinal
    part, the limited differential torque. Source: eqs. (41), (42) of the paper."""
    fixed = fixed_share > 0
    du_limit = ca.if_else(fixed, fixed_share * tau_max, tau_max)
    du = ca.fmin(ca.fmax(du, -du_limit), du_limit)
    rest = ca.if_else(fixed, (1 - fixed_share) * tau_max, tau_max - ca.fabs(du))
    tau_long = ca.if_else(u_d > 0, ca.fmin(u_d, rest), ca.fmax(u_d, -rest))
    return tau_long + du, tau_long - du, tau_long, du
