"""Template of an own controller: a PID on the lateral error, as a law of the 1 kHz exchange.

`make score CONTROLLER=examples/pid.py` scores it. The file holds one class; what its expressions may use of gear, road
and nominal vehicle is listed in railrepro/control/lateral.py.
"""

EXCHANGE = 1e-3  # s


class PID:
    """Differential torque from error, its integral and its rate, with the yaw rate for damping."""

    memory = ("integral",)  # starts at 0
    tuned = {  # keyword arguments per setting of comparison: equal (perfect measurements), loop (behind sensors)
        "equal": {"pole": 20.0, "share": 0.05},
        "loop": {"pole": 15.0, "share": 0.05},
    }

    def __init__(self, pole=20.0, share=0.05):
        self.pole, self.share = pole, share  # rad/s; integral over proportional gain, relative to the pole

    def gains(self):
        return {"pole": self.pole, "share": self.share}

    def torque(self, gear, track_ahead, memory, gain, model):
        v, w = gear["xdot"], gain["pole"]
        error = track_ahead["y_ref"] - gear["y_TrAx"]  # m
        rate = v * (track_ahead["dy_ref"] - gear["psi_TrAx"])  # m/s
        turning = gear["psidot_Ax"] - v * track_ahead["dpsi_dp"]  # rad/s, against the track
        jerk = w**3 * (error + gain["share"] * w * memory["integral"]) + 3 * w**2 * rate - 3 * w * v * turning
        du = model["r_0"] / model["b"] * model["J_eff"] * jerk / v  # N m
        return du, {"integral": memory["integral"] + EXCHANGE * error}
