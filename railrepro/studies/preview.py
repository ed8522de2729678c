"""A controller's knowledge of the irregularities ahead, and the line that it plans with it (the paper's outlook)."""

import casadi as ca
import numpy as np
import pandas as pd
import scipy

from railrepro.data import InputError, above, between, require


def known(frame: pd.DataFrame, amplitude_error: float = 0.0, localisation_error_m: float = 0.0) -> pd.DataFrame:
    """Irregularities as a controller knows them, in a table with the columns of `frame`. `frame` has the true ones, as
    from `rough_track`: evenly spaced p_m (m) and any channels. `amplitude_error` is relative: with 0.1 irregularities
    are known 10 % too large. With `localisation_error_m` (m) a feature at p is known at p + error. What would come from
    beyond the ends of `frame` is zero."""
    p, channels = frame["p_m"].to_numpy(), frame.drop(columns="p_m")
    true_p = p - localisation_error_m
    inside = (true_p >= p[0]) & (true_p <= p[-1])
    true = scipy.interpolate.CubicSpline(p, channels.to_numpy())(np.clip(true_p, p[0], p[-1]))
    values = (1 + amplitude_error) * inside[:, None] * true
    return pd.DataFrame({"p_m": p} | dict(zip(channels, values.T, strict=True)))


def plan(
    frame: pd.DataFrame,
    share: float = 1.0,
    smoothing_m: float = 3.0,
    limit: float = 5e-3,
    amplitude_error: float = 0.0,
    localisation_error_m: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Plan the lateral set point between the ideal line and the rails, within the flangeway.

    It minimises sum (y - share lateral)^2 + smoothing_m^4 sum (y'')^2 subject to |y - lateral| <= limit + gauge / 2 at
    every row, and y = 0, the ideal line, in the first two and the last two rows. InputError if no line does, so in
    these four rows |lateral_m| must be at most limit + gauge_m / 2.

    `frame` has the true irregularities (`rough_track`): p_m, lateral_m, gauge_m (m). A `share` of 0 follows the ideal
    line, 1 the middle between the rails. The line is smoothed over `smoothing_m` (m); 0 for none. `limit` is the
    lateral play of a wheel pair to either side between rails of nominal gauge (m). The controller knows irregularities
    too large by `amplitude_error` (relative, -) and too far ahead by `localisation_error_m` (m). Returns track
    coordinates p (m), shape (n,), and set point (m) with its three derivatives (-, 1/m, 1/m^2) at p, shape (4, n).
    """
    frame = known(frame, amplitude_error, localisation_error_m)
    require("planned line: share", share, between(0.0, 1.0))
    require("planned line: smoothing_m", smoothing_m, between(0.0, 1e5, "m"))
    require("planned line: limit", limit, above(0.0, 1.0, "m"))
    p, lateral = frame["p_m"].to_numpy(), frame["lateral_m"].to_numpy()
    play = limit + frame["gauge_m"].to_numpy() / 2
    low, high = lateral - play, lateral + play
    ends = [0, 1, -2, -1]
    if (play <= 0).any() or (low[ends] > 0).any() or (high[ends] < 0).any():
        raise InputError(f"planned line: limit {limit:g} m leaves no line that begins and ends on the ideal one")
    low[ends] = high[ends] = 0.0
    line = _smoothest(share * lateral, low, high, (smoothing_m / np.diff(p).mean()) ** 2)
    spline = scipy.interpolate.CubicSpline(p, line, bc_type="clamped")
    return p, np.array([spline(p, order) for order in range(4)])


def _smoothest(target: np.ndarray, low: np.ndarray, high: np.ndarray, weight: float) -> np.ndarray:
    """Minimiser y of |y - target|^2 + |weight second difference of y|^2 within bounds (m), shape (n,)."""
    n, unit = target.size, 1e-3  # the solver works in millimetres, so that its tolerances are nanometres
    # Bending has unknowns of its own: with the weight squared in the Hessian rounding would exceed the tolerance.
    y, bend = ca.SX.sym("y", n), ca.SX.sym("bend", n - 2)
    problem = {
        "x": ca.vertcat(y, bend),
        "f": ca.sumsqr(y - target / unit) + ca.sumsqr(bend),
        "g": bend - weight * (y[:-2] - 2 * y[1:-1] + y[2:]),
    }
    ipopt = {"print_level": 0, "sb": "yes", "tol": 1e-9, "bound_relax_factor": 0.0, "nlp_scaling_method": "none"}
    ipopt |= {"hessian_constant": "yes", "jac_c_constant": "yes"}
    solver = ca.nlpsol("line", "ipopt", problem, {"print_time": False, "error_on_fail": True, "ipopt": ipopt})
    free = np.full(n - 2, np.inf)
    start = np.concatenate([np.clip(target, low, high) / unit, np.zeros(n - 2)])
    solution = solver(x0=start, lbx=np.append(low / unit, -free), ubx=np.append(high / unit, free), lbg=0.0, ubg=0.0)
    return np.array(solution["x"]).ravel()[:n] * unit
