"""Template of a controller of your own: a PID on the lateral error, as a law at 1 kHz.

`make score CONTROLLER=examples/pid.py` scores it. The file holds one class; what its expressions may use of running
gear, track and nominal vehicle is listed in railrepro/control/lateral.py.
"""

import casadi as ca

PERIOD = 1e-3  # s


class PID:
    """Differential torque from error, its integral and its rate, with the yaw rate for damping."""

    memory = ("integral",)  # starts at 0
    tuned = {  # keyword arguments per setting of comparison: paper (perfect measurements), loop (behind sensors)
        "paper": {"pole": 20.0, "share": 0.05},
        "loop": {"pole": 15.0, "share": 0.05},
    }

    def __init__(self, pole=20.0, share=0.05):
        self.pole, self.share = pole, share  # rad/s; integral over proportional gain, relative to the pole

    def gains(self):
        return {"pole": self.pole, "share": self.share}

    def torque(self, q):
        v, w = q.v, q.pole
        error = q.y_ref - q.y  # m
        rate = v * (q.dy_ref - q.psi)  # m/s
        turning = q.yaw_rate - v * q.dpsi_dp  # rad/s, against the track
        jerk = w**3 * (error + q.share * w * q.integral) + 3 * w**2 * rate - 3 * w * v * turning
        du = q.r_0 / q.b * q.J_eff * jerk / v  # N m
        free = ca.fabs(du) < q.tau_max  # at the limit of the motor the integral rests, or it would wind up
        return du, {"integral": q.integral + ca.if_else(free, PERIOD * error, 0)}
