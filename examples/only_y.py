"""The smallest entry: one class with one method, which reads nothing but position and set point.

Error, its integral and two filtered derivatives; arguments of `torque` are names of `python -m railrepro score
--describe` and of its own memory, which starts at 0 and is returned anew each millisecond.
"""


class OnlyPosition:
    memory = ("total", "slow", "slower")

    def torque(self, y, y_ref, total, slow, slower):
        w, error = 12.0, y_ref - y  # rad/s, m
        rate = 300 * (error - slow)
        bend = 300 * (rate - slower)
        du = 12 * (0.1 * w**4 * total + w**3 * error + 3 * w**2 * rate + 3 * w * bend)  # N m
        return du, {"total": total + 1e-3 * error, "slow": slow + 1e-3 * rate, "slower": slower + 1e-3 * bend}
