"""One driven wheel on a bare adhesion characteristic under the adhesion law: many cases at once.

The smallest system on which the law can be watched: wheel spin, speed of a quarter of the car, Polach's creep law,
1 kHz law. Serves the paper's Fig. 5 and section Adhesion Control.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from railrepro.car.equations import SLIP_FLOOR
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.contact.creep import polach
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionInputs, AdhesionMemory, AdhesionSettings
from railrepro.quantities import group, indices, names, pack, symbols
from railrepro.vehicle.parameters import AdhesionSet, Vehicle

_SUBSTEPS = 20


@dataclass(frozen=True)
class Case:
    """One simulated wheel: settings of its adhesion law, and the adhesion set (Polach's parameters) of its rail."""

    law: AdhesionSettings
    adhesion: AdhesionSet


@dataclass(frozen=True)
class Traces:
    """Time series of single-wheel simulations, each array of shape (time, cases), one row per ms.

    Attributes
    ----------
    adhesion, slip : ndarray
        Adhesion f_x, longitudinal force over wheel load, traction-positive (-); slip s_x = (v - w r)/v (-).
    torque : ndarray
        Motor torque on the wheel, traction-positive (N m).
    speed : ndarray
        Running speed (m/s).
    segment : ndarray
        Active segment I, II or III of the adhesion law, as 1, 2 or 3.
    """

    adhesion: np.ndarray
    slip: np.ndarray
    torque: np.ndarray
    speed: np.ndarray
    segment: np.ndarray


_State = group("State", "w rad/s, v m/s, u N m", {"law": AdhesionMemory})
_Wheel = group(
    "Wheel",
    "radius m, inertia kg m2, load N, gravity m/s2, tau_max N m, a m, b m, c11 -, c22 -, c23 -, c33 -, "
    "shear_modulus Pa",
)
_Numbers = group("Numbers", {"law": AdhesionSettings, "adhesion": AdhesionSet, "wheel": _Wheel})
"""Run-time numbers of a case."""


def _grip(w, v, case: Any, factor) -> tuple[ca.SX, ca.SX]:
    """Adhesion and slip of a wheel that turns with w (rad/s) at speed v (m/s)."""
    wheel, of = case.wheel, case.adhesion
    slip = (v - w * wheel.radius) / ca.fmax(v, SLIP_FLOOR)
    patch = wheel.a, wheel.b, wheel.c11, wheel.c22, wheel.c23, wheel.c33, wheel.shear_modulus
    creep = of.k_a, of.k_s, of.mu0 * factor, of.a_ratio, of.b_decay
    force, _ = polach(slip, 0.0, 0.0, wheel.load, *patch, *creep, ca.fabs(v - w * wheel.radius))
    return force / wheel.load, slip


@lru_cache
def _cycle() -> ca.Function:
    """One control cycle of one case: (state, demand, friction factor, case) -> state, outputs."""
    (state, x), (case_, case) = symbols(_State, "state"), symbols(_Numbers, "case")
    f_star, factor, wheel = ca.SX.sym("f_star"), ca.SX.sym("factor"), case.wheel
    f_now, s_now = _grip(x.w, x.v, case, factor)
    q = AdhesionInputs([f_now] * 2, [s_now] * 2, f_star, x.v, x.u, wheel.load, wheel.tau_max, wheel.radius)
    u, law, segment = case.law.base_torque(q, x.law)

    w_, v_, u_ = ca.SX.sym("w"), ca.SX.sym("v"), ca.SX.sym("u")
    f_, _ = _grip(w_, v_, case, factor)
    spin_up = (u_ - wheel.radius * wheel.load * f_) / wheel.inertia
    rate = ca.Function("rate", [w_, v_, u_, factor, case_], [spin_up, ca.jacobian(spin_up, w_), f_])
    w, v, h = x.w, x.v, CONTROL_PERIOD / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        faster, stiffness, f = rate(w, v, u, factor, case_)
        w, v = w + h * faster / (1 - h * stiffness), v + h * wheel.gravity * f
    new = _State(w, v, u, law)
    outputs = [f_now, s_now, u, x.v, segment]
    inputs = [state, f_star, factor, case_]
    return ca.Function("bare_wheel", inputs, [ca.vertcat(*pack(new)), ca.vertcat(*outputs)], {"cse": True})


def simulate(vehicle: Vehicle, cases: Sequence[Case], speed, demand, factor=1.0) -> Traces:
    """Simulate single driven wheels under the 1 kHz adhesion law and return `Traces`, a column per wheel.

    Wheels start rolling freely with zero torque. Each carries the nominal wheel load Q and accelerates a mass of Q/g.
    The torque limit is 1e5 N m, more than adhesion can transmit.

    Parameters
    ----------
    vehicle : Vehicle
        Source of wheel, load and contact patch.
    cases : sequence of Case
        Adhesion law and rail of each wheel.
    speed : float or array_like, shape (cases,)
        Initial running speeds (m/s).
    demand : array_like, shape (time,) or (time, cases)
        Adhesion set point f_x*, traction-positive, one row per ms (-).
    factor : array_like, scalar or of shape (time,) or (time, cases)
        Factor on the coefficient of friction at rest mu0 (-).
    """
    demand = np.asarray(demand, dtype=float)
    demand = np.ascontiguousarray(np.broadcast_to(demand.reshape(len(demand), -1), (len(demand), len(cases))))
    factor = np.asarray(factor, dtype=float)
    factor = np.ascontiguousarray(np.broadcast_to(factor.reshape(-1, 1) if factor.ndim == 1 else factor, demand.shape))
    a, b, kalker = middle_patch(vehicle)
    wheel = vehicle.wheel
    body = _Wheel(
        wheel.radius, wheel.spin_inertia, vehicle.wheel_load, vehicle.gravity, 1e5, a, b, *kalker,
        vehicle.contact.shear_modulus,
    )  # fmt: skip
    columns = [pack(_Numbers(c.law, c.adhesion, body)) for c in cases]
    call = codegen.compiled(_cycle().map("bare_wheels", "serial", len(cases), [], []))
    state, f_star, friction, case = call.arguments
    start, index = np.zeros((len(cases), len(names(_State)))), indices(_State)
    start[:, index.v] = speed
    start[:, index.w] = start[:, index.v] / wheel.radius
    state[:], case[:] = start.ravel(), np.array(columns, dtype=float).ravel()
    log = np.empty((len(demand), len(cases), len(fields(Traces))))
    for k in range(len(demand)):
        f_star[:], friction[:] = demand[k], factor[k]
        new, outputs = call()
        log[k] = outputs.reshape(len(cases), -1)
        state[:] = new
    return Traces(*(log[:, :, i] for i in range(len(fields(Traces)))))
