r"""Lower bound of the lateral error with sensors: a linear-quadratic-Gaussian (LQG) controller.

The creep model of a running gear (`railrepro.own.gear_model`), with disturbances and biases as slow Gauss-Markov
processes, is a linear system under white noise (`System`). For it no causal law, linear or not, has a smaller
q E[y^2] + rho E[(du_k - du_(k-1))^2]  than the feedback L of the states that a Kalman filter estimates. Estimates and
their errors are uncorrelated, so

    E[y^2] = c (Sigma + P) c',    Sigma = (A - B L) Sigma (A - B L)' + K S K'

with covariance P of the errors, gain K of the filter and innovation covariance S. Track and set point are known and
cost nothing. rho trades error for torque: the bound belongs to a given activity of the torque above 5 Hz.

Source: Anderson and Moore 1990, Optimal Control, ch. 8 (separation); Anderson and Moore 1979, Optimal Filtering, ch. 4.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are, solve_discrete_lyapunov
from scipy.optimize import brentq
from scipy.signal import cont2discrete

from railrepro.clock import CONTROL_PERIOD
from railrepro.estimation.sensors import Loop
from railrepro.own.gear_model import STATES, UNITS, UNKNOWN, lateral_model
from railrepro.vehicle.parameters import Vehicle

BIASES = ("y", "psi", "r")  # readings with a bias each
MEMORY = 30.0
"""Time constant of biases and disturbances (s), longer than any run: their decay gives no information."""
ACTIVITY = 115.0
"""Torque above 5 Hz (N m, RMS) of the tuned controllers on dry rail, for which the bound is stated."""
_CUT, _ORDER = 5.0, 4  # high-pass of `railrepro.simulation.metrics.activity`: frequency (Hz) and order, applied twice
_QUIET = 1e-9  # process noise of each state in a period, in its unit, which keeps the equations regular
Y, TORQUE = STATES.index("y"), len(STATES) + len(UNKNOWN) + len(BIASES)
"""Indices of the displacement and of the newest torque command among the states of a `System`."""


class System(NamedTuple):
    """Linear system of a running gear with sensors: x_(k+1) = a x_k + b (du_k - du_(k-1)) + w_k, z_k = c x_k + v_k.

    The period is 1 ms, states x are in multiples of `units`, w and v are white noise.

    Attributes:
        a (ndarray, shape (n, n)): Transition matrix A.
        b (ndarray, shape (n,)): Input vector B of the change of differential torque in a period (per N m).
        c (ndarray, shape (3, n)): Output matrix C: readings of y, psi, yaw rate r in units of their noise (RMS).
        q (ndarray, shape (n, n)): Covariance of w per period; the covariance of v is the unit matrix.
        units (ndarray, shape (n,)): SI value of one unit of each state; 100 N m for a torque.
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    q: np.ndarray
    units: np.ndarray


def system(vehicle: Vehicle, loop: Loop, speed: float, walks: tuple[float, float]) -> System:
    """Build the linear system of a running gear at a speed (m/s) with the sensors `loop`. `walks` are the random walks
    of lateral force (N/s^0.5) and yaw moment (N m/s^0.5). States: displacement y and lateral velocity vy; yaw angle psi
    and yaw rate r against the track; half the difference E of wheel speeds; differential torque tau; force and moment;
    biases of y, psi, r; the last d + 1 torque commands, newest first; d is the delay (ms, at least 1)."""
    h, n = CONTROL_PERIOD, len(STATES)
    rates, du, _, unknown = lateral_model(vehicle, speed)
    inputs = np.column_stack([du, unknown])
    transition, response, *_ = cont2discrete((rates, inputs, np.zeros((1, n)), np.zeros((1, inputs.shape[1]))), h)
    delays = max(round((loop.latency.measurement + loop.latency.command) / h), 1)
    size = TORQUE + delays + 1
    a, b, c = np.zeros((size, size)), np.zeros(size), np.zeros((len(BIASES), size))
    a[:n, :n], a[:n, n : n + len(UNKNOWN)] = transition, response[:, 1:]
    a[:n, -1] = response[:, 0]  # the last torque of the chain acts
    a[n:TORQUE, n:TORQUE] = np.exp(-h / MEMORY) * np.eye(TORQUE - n)
    a[TORQUE, TORQUE] = b[TORQUE] = 1.0
    a[TORQUE + 1 :, TORQUE:-1] = np.eye(delays)
    for row, name in enumerate(BIASES):
        c[row, STATES.index(name)] = c[row, n + len(UNKNOWN) + row] = 1.0
    noise, spread = loop.lateral_errors()
    noise, spread = np.maximum(noise, 1e-9), np.maximum(spread, 1e-12)
    variances = np.concatenate([np.square(walks) * h, (1 - np.exp(-2 * h / MEMORY)) * spread**2])
    units = np.concatenate([UNITS, np.sqrt(variances / h), np.full(delays + 1, 100.0)])
    q = np.diag((_QUIET * units) ** 2)
    q[n:TORQUE, n:TORQUE] += np.diag(variances)
    # the walk within the period
    q[:n, :n] += response[:, 1:] @ np.diag(variances[: len(UNKNOWN)]) @ response[:, 1:].T / 3
    scale = units / units[:, None]
    return System(a * scale, b / units, c * units / noise[:, None], q / np.outer(units, units), units)


def limit(vehicle: Vehicle, loop: Loop, speed: float, walks: tuple[float, float], activity: float = ACTIVITY) -> float:
    """Compute the lower bound of the lateral error (m) of all causal laws with a given torque above 5 Hz. The error is
    the standard deviation of y from the set point at the measured track coordinate. `activity` is this torque (RMS, N
    m), `loop` are the sensors, `speed` is in m/s, `walks` are the intensities of the random walks of lateral force
    (N/s^0.5) and yaw moment (N m/s^0.5). ValueError if no weight of the torque (`at_weight`) gives the activity."""
    plant = system(vehicle, loop, speed, walks)
    log_weight = brentq(lambda log: np.log(at_weight(plant, 10.0**log)[2] / activity), -10.0, 0.0, xtol=1e-3)
    return at_weight(plant, 10.0**log_weight)[0]


def at_weight(plant: System, weight: float) -> tuple[float, float, float]:
    """Compute standard deviations under the optimal law (`feedback`) for a `weight` (mm^2/(N m)^2) of the torque
    change per sample: y (m); error of the Kalman filter (m), which no torque removes; torque above 5 Hz (N m)."""
    p, m = np.zeros_like(plant.a), TORQUE  # the torques are known
    p[:m, :m] = solve_discrete_are(plant.a[:m, :m].T, plant.c[:, :m].T, plant.q[:m, :m], np.eye(len(plant.c)))
    innovation = plant.c @ p @ plant.c.T + np.eye(len(plant.c))
    gain = p @ plant.c.T @ np.linalg.inv(innovation)
    error, driven = p - gain @ plant.c @ p, gain @ innovation @ gain.T
    closed = plant.a - np.outer(plant.b, feedback(plant, weight))
    filtered = solve_discrete_lyapunov(closed, (driven + driven.T) / 2)
    known, whole, unit = error[Y, Y], filtered[Y, Y] + error[Y, Y], plant.units[Y]
    torque = plant.units[TORQUE] * _above(closed, gain @ np.linalg.cholesky(innovation), TORQUE)
    return float(unit * np.sqrt(whole)), float(unit * np.sqrt(known)), float(torque)


def feedback(plant: System, weight: float) -> np.ndarray:
    """Compute the gain L (N m), shape (n,), of the optimal law du_k - du_(k-1) = -L x, x in `System.units`. L minimises
    E[y^2] + weight E[(du_k - du_(k-1))^2] with y in mm, `weight` in mm^2/(N m)^2."""
    cost, unit = np.zeros_like(plant.a), plant.units[TORQUE]
    cost[Y, Y] = 1.0
    b = plant.b[:, None] * unit  # in units of the torque the equation is well scaled
    p = solve_discrete_are(plant.a, b, cost, np.array([[weight * unit**2]]))
    return unit * (b.T @ p @ plant.a)[0] / float(weight * unit**2 + (b.T @ p @ b)[0, 0])


def at_true_position(error: float, slopes: np.ndarray, loop: Loop) -> float:
    """Convert a bound `error` (m) from the set point at the measured track coordinate to one at the true coordinate:
    the root of the sum of squares of `error` and of the bias of the measured coordinate (standard deviation, m) times
    the RMS of `slopes` dy*/dp. The noise of the coordinate does not enter."""
    return float(np.hypot(error, loop.position.bias / np.sqrt(3) * np.sqrt(np.mean(np.square(slopes)))))


def _above(closed: np.ndarray, noise: np.ndarray, state: int) -> float:
    """Compute the deviation above 5 Hz of a state of x_(k+1) = closed x_k + noise e_k with white e of variance 1."""
    h, n = CONTROL_PERIOD, len(closed)
    f = np.geomspace(_CUT / 4, 0.5 / h, 300)
    passed = 1 / (1 + (np.tan(np.pi * _CUT * h) / np.tan(np.minimum(np.pi * f * h, 1.57))) ** (2 * _ORDER))
    resolvent = np.linalg.inv(np.exp(2j * np.pi * f * h)[:, None, None] * np.eye(n) - closed)
    power = (np.abs(resolvent[:, state] @ noise) ** 2).sum(axis=1)
    return float(np.sqrt(2 * h * np.trapezoid(passed**2 * power, f)))
