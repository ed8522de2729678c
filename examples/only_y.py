"""The smallest entry: one class with one method, which reads nothing but position and set point.

Error, its integral and two filtered derivatives. `q` has the quantities that `railrepro/control/lateral.py`
lists, and the law's own memory, which starts at 0 and is returned anew each millisecond.
"""


class OnlyPosition:
    memory = ("total", "slow", "slower")

    def torque(self, q):
        w, error = 12.0, q.y_ref - q.y  # rad/s, m
        rate = 300 * (error - q.slow)
        bend = 300 * (rate - q.slower)
        du = 12 * (0.1 * w**4 * q.total + w**3 * error + 3 * w**2 * rate + 3 * w * bend)  # N m
        return du, {"total": q.total + 1e-3 * error, "slow": q.slow + 1e-3 * rate, "slower": q.slower + 1e-3 * bend}
