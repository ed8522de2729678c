"""Template for your own controller: a PID law for the lateral error at 1 kHz.

`make score CONTROLLER=examples/pid.py` scores it. The file contains one class. `railrepro/control/lateral.py` lists the
quantities of running gear, track and nominal vehicle that the law may use.
"""

import casadi as ca

PERIOD = 1e-3  # s


class PID:
    """Differential torque from the error, its integral and its rate, with damping by the yaw rate."""

    memory = ("integral",)  # starts at 0
    tuned = {  # keyword arguments per setting: "paper" has perfect measurements, "loop" has sensors
        "paper": {"pole": 20.0, "share": 0.05},
        "loop": {"pole": 15.0, "share": 0.05},
    }

    def __init__(self, pole=20.0, share=0.05):
        self.pole, self.share = pole, share  # rad/s; integral gain / (proportional gain * pole)

    def gains(self):
        return {"pole": self.pole, "share": self.share}

    def torque(self, q):
        v, w = q.v, q.pole
        error = q.y_ref - q.y  # m
        rate = v * (q.dy_ref - q.psi)  # m/s
        turning = q.yaw_rate - v * q.dpsi_dp  # rad/s, relative to the track
        jerk = w**3 * (error + q.share * w * q.integral) + 3 * w**2 * rate - 3 * w * v * turning
        du = q.r_0 / q.b * q.J_eff * jerk / v  # N m
        free = ca.fabs(du) < q.tau_max  # anti-windup: the integral is constant at the torque limit
        return du, {"integral": q.integral + ca.if_else(free, PERIOD * error, 0)}
