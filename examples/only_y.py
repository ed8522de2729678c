"""The smallest controller: one class whose only method uses only position and set point.

It feeds back the error, its integral and two filtered derivatives. `q` has the memory of the law, which starts at 0,
and the quantities that `railrepro/control/lateral.py` lists. Each millisecond the law returns the differential torque
and the next memory.
"""


class OnlyPosition:
    memory = ("total", "slow", "slower")

    def torque(self, q):
        w, error = 12.0, q.y_ref - q.y  # rad/s, m
        rate = 300 * (error - q.slow)
        bend = 300 * (rate - q.slower)
        du = 12 * (0.1 * w**4 * q.total + w**3 * error + 3 * w**2 * rate + 3 * w * bend)  # N m
        return du, {"total": q.total + 1e-3 * error, "slow": q.slow + 1e-3 * rate, "slower": q.slower + 1e-3 * bend}
