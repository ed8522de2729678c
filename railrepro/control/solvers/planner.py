"""Whole samples of a predictive controller in compiled code: forecast, linearisation, problem, torque, preparation.

What `planner.c` drives is what `railrepro.control.nmpc` (real-time iteration) and `ltv_mpc` do step by step, to the
bit.
"""

from __future__ import annotations

import ctypes

import numpy as np

from railrepro.control.solvers import condensed
from railrepro.control.solvers.riccati import UNSETTLED, Horizon, PlainHorizon


class _Planner(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("horizon", "x_hat", "plan")),
        *((name, ctypes.c_double) for name in ("observer", "torque_limit")),
        *((name, ctypes.c_longlong) for name in ("yielding", "informed", "linear")),
        *((name, ctypes.c_double) for name in ("offset", "expected_y")),
        *((name, ctypes.c_longlong) for name in ("started", "expected")),
    ]


class Planner:
    """The samples of one controller on a compiled horizon.

    Parameters
    ----------
    horizon : Horizon
        That of the controller; its settings hold.
    torque_limit : float
        Of one motor (N m).
    linear : bool
        Whether the problem is linearised about the forecast instead of the plan of before.

    Attributes
    ----------
    horizon : Horizon
    torques : ndarray, shape (L,)
        Differential torques of the last plan (N m).
    """

    def __init__(self, horizon: Horizon, torque_limit: float, linear: bool):
        s = horizon.settings
        self.horizon, self._measured, self.torques = horizon, np.zeros_like(horizon.x_hat), np.zeros(s.steps)
        places = ctypes.addressof(horizon.c), horizon.x_hat.ctypes.data, self.torques.ctypes.data
        self._c = _Planner(*places, s.observer, torque_limit, s.yielding, s.informed, linear)
        self._pointer, self._state = ctypes.byref(self._c), ctypes.c_void_p(self._measured.ctypes.data)
        self._solve, self._take = horizon.library.planner_solve, horizon.library.planner_take
        self._prepare, self._take.restype = horizon.library.planner_prepare, ctypes.c_double

    @property
    def offset(self) -> float:
        """Observed offset of the yaw angle (rad)."""
        return self._c.offset

    def plan(self, measured: np.ndarray, base: float) -> tuple[float, bool]:
        """Torque (N m) at a measured state (6,) and base torque (N m), and whether the plan of before had to serve."""
        self._measured[:] = measured
        code = self._solve(self._pointer, self._state, ctypes.c_double(base))
        if code == UNSETTLED:
            code = self._densely()
        return self._take(self._pointer, code), code != 0

    def prepare(self) -> None:
        """Do what of the next sample can be done before its state is measured."""
        self._prepare(self._pointer)

    def _densely(self) -> int:
        """The condensed problem where no active sets settle; not 0 when that fails, too."""
        horizon = self.horizon
        try:
            horizon.dx[:], horizon.du[:] = condensed.solve(horizon)
        except (ArithmeticError, np.linalg.LinAlgError):
            return UNSETTLED
        return 0 if np.isfinite(horizon.dx).all() and np.isfinite(horizon.du).all() else UNSETTLED


def planner(horizon: PlainHorizon, torque_limit: float, linear: bool) -> Planner | None:
    """Whole samples on a horizon; None where it is not compiled."""
    return Planner(horizon, torque_limit, linear) if isinstance(horizon, Horizon) else None
