"""Nonlinear and linear time-variant model predictive control of one running gear. A sample is compiled code,
`planner.c`, which the closed loop calls without Python. Only the reference solver, Ipopt, is called from Python. Serves
the paper's sections Nonlinear and Linear Time-Variant Model Predictive Control."""

import ctypes
import time
from dataclasses import dataclass, field

import numpy as np

from railrepro.compile import codegen
from railrepro.control import lateral
from railrepro.control.problem import MPCSettings, Problem
from railrepro.control.solvers import ipopt
from railrepro.control.solvers.riccati import Horizon
from railrepro.data import InputError, between, require
from railrepro.model.control_model import XDOT, kept_as_printed, parameter_vector
from railrepro.model.forecast import nominal_values
from railrepro.quantities import pack
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

LINEAR, REAL_TIME, CONVERGED = range(3)
"""Modes of planner.c: one linear time-variant QP, one real-time iteration, or Newton iterations until convergence."""
SOLVERS = {"gauss_newton": CONVERGED, "rti": REAL_TIME, "ipopt": CONVERGED}


@dataclass
class PredictiveController:
    """Predictive controller of one gear (0 front, 1 rear), base of `NMPC` and `LTVMPC`. Each sample it optimises the
    differential torque over a horizon ahead.

    When a problem cannot be solved, the controller follows the plan of the sample before, and `fallbacks` counts it.

    Attributes:
        stats (list of tuple): Processor time (s) and iterations of each call of `plan`.
        period (float): Sampling time (s).
        plan_du (ndarray, shape (L,)): Differential torques of the last plan (N m), L = `settings.steps`.
        horizon (Horizon): Problem, trajectory and solver in compiled code.
        nominal (ndarray, shape (3,)): Vehicle data of the forecast in the order of `model.forecast.NOMINAL` (SI).
        c (ctypes.Structure): Memory in C, `horizon_t` of riccati.c.
        drive (ndarray): Fields of `vehicle.parameters.Drive` (SI), which determine the torque limit.
    """

    mode = CONVERGED  # one of the modes of planner.c; without annotation, as it is no argument

    vehicle: Vehicle
    route: Route
    gear: int
    settings: MPCSettings = field(default_factory=MPCSettings)

    def __post_init__(self) -> None:
        require("MPC: settings", self.settings, MPCSettings)
        lateral.check_arguments(type(self).__name__, self.vehicle, self.route, self.gear)
        self.stats: list[tuple[float, int]] = []
        s, self.period = self.settings, self.settings.period
        self.parameters = parameter_vector(self.vehicle)
        self.nominal = nominal_values(self.vehicle, self.gear, printed="D4" in kept_as_printed(s.variant))
        self.horizon = Horizon(s, self.nominal, self.parameters, self.route)
        self.plan_du, self._measured = self.horizon.plan, np.zeros_like(self.horizon.x_hat)
        self.c, self._library, self._pointer = self.horizon.c, self.horizon.library, self.horizon.pointer
        self.drive = np.array(pack(self.vehicle.drive), dtype=float)
        self.c.drive, self.c.mode = self.drive.ctypes.data, self.mode

    @property
    def fallbacks(self) -> int:
        """Number of samples so far whose problem could not be solved."""
        return self.c.fallbacks

    def problem(self, x_hat: np.ndarray, u_d: float) -> Problem:
        """The nonlinear optimal control `Problem` of a sample at a measured state (6,) (SI) and a base torque per wheel
        (N m), to inspect or compare solvers. `plan` solves it, or with LTV-MPC or one iteration approximates it. With
        `MPCSettings.observer` above 0 `plan` starts from another state: it adds the observed creep angle, between
        heading and motion, to the measured yaw angle."""
        x_hat, u_d = self._checked(x_hat, u_d if self.settings.informed else 0.0)
        limit = self.vehicle.drive.limit(x_hat[XDOT] / self.vehicle.wheel.radius)
        return Problem(self.settings, x_hat, u_d, self.horizon.forecast(x_hat, u_d), self.parameters, limit)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Solve one sample and return the differential torque (N m) to hold until the next sample. `x_hat` (6,) is the
        measured state (SI) in the order of `control_model.STATES`, `u_d` the base torque per wheel (N m). InputError
        unless they are finite."""
        begin = time.thread_time()
        self._measured[:], u_d = self._checked(x_hat, u_d)
        torque = self._torque(ctypes.c_void_p(self._measured.ctypes.data), ctypes.c_double(u_d))
        self.stats.append((time.thread_time() - begin, self.c.iterations))
        return torque

    def compiled(self, _loop: object, _leader: object = None) -> tuple[int, int] | None:
        """Addresses of the C function of a sample and of the memory `c` of this controller, so that the compiled loop
        needs no Python; the arguments are ignored. None with Ipopt, which is called from Python, and for a derived
        class, whose `plan` may differ: then the loop calls `plan`."""
        if type(self) not in (NMPC, LTVMPC) or (isinstance(self, NMPC) and self.solver == "ipopt"):
            return None
        return ctypes.cast(self._library.planner_sample, ctypes.c_void_p).value or 0, ctypes.addressof(self.c)

    def _checked(self, x_hat: np.ndarray, u_d: float) -> tuple[np.ndarray, float]:
        owner = type(self).__name__
        require(f"{owner}: u_d", u_d, between(-1e9, 1e9, "N m"))
        return codegen.for_c(f"{owner}: x_hat", x_hat, self._measured.shape), u_d

    def _torque(self, measured: ctypes.c_void_p, u_d: ctypes.c_double) -> float:
        return self._library.planner_sample(self._pointer, measured, None, u_d)


@dataclass
class NMPC(PredictiveController):
    """Nonlinear MPC of one running gear. All solvers minimise the same cost. `solver` is "gauss_newton" (default),
    Newton iterations until convergence; "rti", real-time iteration: one Newton iteration per sample, prepared before
    the state is measured; or "ipopt", the slow reference."""

    solver: str = "gauss_newton"

    def __post_init__(self) -> None:
        if not isinstance(self.solver, str) or self.solver not in SOLVERS:
            raise InputError(f"NMPC solver {self.solver!r} is not known; there are {tuple(SOLVERS)}")
        self.mode = SOLVERS[self.solver]
        super().__post_init__()

    def _torque(self, measured: ctypes.c_void_p, u_d: ctypes.c_double) -> float:
        if self.solver != "ipopt":
            return super()._torque(measured, u_d)
        self._library.planner_begin(self._pointer, measured, u_d)
        iterations = ipopt.solve(self.horizon)
        self.c.iterations = iterations or 0
        return self._library.planner_take(self._pointer, iterations is None)


@dataclass
class LTVMPC(PredictiveController):
    """Linear time-variant MPC of one running gear: one QP per sample, with the model linearised along the forecast. By
    default the model is linearised about centred riding along the track and keeps its affine term. With `printed` it is
    linearised about a yaw angle of zero and has no affine term, as in the paper (erratum D6)."""

    printed: bool = False
    mode = LINEAR

    def __post_init__(self) -> None:
        require("LTVMPC: printed", self.printed, bool)
        super().__post_init__()
        self.c.affine = 0.0 if self.printed else 1.0
