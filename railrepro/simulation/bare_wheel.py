"""One driven wheel on a bare adhesion characteristic under the adhesion law: many cases at once.

The smallest system on which the law can be watched: wheel spin, speed of a quarter of the car, Polach's creep law,
1 kHz law with estimates. Serves the paper's Fig. 5 and section Adhesion Control.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.car.equations import SLIP_FLOOR
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.contact.creep import polach
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionSettings, base_torque
from railrepro.control.law import EstimateSettings, white_noise
from railrepro.vehicle.parameters import AdhesionSet, Vehicle

_SUBSTEPS = 20
_STATE = ("w", "v", "u", "f_0", "f_1", "s_0", "s_1", "f_hat", "s_hat", "tick")
_PATCH = ("a", "b", "c11", "c22", "c23", "shear_modulus")
_CASE = (
    *AdhesionSettings().gains(),
    *EstimateSettings().gains(),
    *(f.name for f in fields(AdhesionSet)),
    *("radius", "inertia", "load", "gravity", "tau_max"),
    *_PATCH,
)
_OUTPUT = ("adhesion", "slip", "torque", "speed", "segment")


@dataclass(frozen=True)
class Case:
    """One wheel: law, estimates and adhesion."""

    law: AdhesionSettings
    adhesion: AdhesionSet
    estimate: EstimateSettings = EstimateSettings()


@dataclass(frozen=True)
class Traces:
    """Outcome of cases over time, each array of shape (time in ms, cases).

    Attributes
    ----------
    adhesion, slip : ndarray
        f_x (traction-positive) and s_x = (v - w r)/v (-).
    torque : ndarray
        Wheel torque (N m).
    speed : ndarray
        Running speed (m/s).
    segment : ndarray
        Segment of the law, 1, 2 or 3.
    """

    adhesion: np.ndarray
    slip: np.ndarray
    torque: np.ndarray
    speed: np.ndarray
    segment: np.ndarray


def _grip(w, v, case: dict, factor) -> tuple[ca.SX, ca.SX]:
    """Adhesion and slip of a wheel that turns with w (rad/s) at speed v (m/s)."""
    slip = (v - w * case["radius"]) / ca.fmax(v, SLIP_FLOOR)
    creep = case["k_a"], case["k_s"], case["mu0"] * factor, case["a_ratio"], case["b_decay"]
    sliding = ca.fabs(v - w * case["radius"])
    force, _ = polach(slip, 0.0, 0.0, case["load"], *(case[name] for name in _PATCH), *creep, sliding)
    return force / case["load"], slip


@lru_cache
def _cycle() -> ca.Function:
    """One control cycle of one case: (state, demand, friction factor, case) -> state, outputs."""
    state, case_ = ca.SX.sym("state", len(_STATE)), ca.SX.sym("case", len(_CASE))
    f_star, factor = ca.SX.sym("f_star"), ca.SX.sym("factor")
    x, case = (dict(zip(n, ca.vertsplit(v), strict=True)) for n, v in ((_STATE, state), (_CASE, case_)))
    f_now, s_now = _grip(x["w"], x["v"], case, factor)
    pole = CONTROL_PERIOD / (case["estimate.lag"] + CONTROL_PERIOD)
    estimated = {}
    for channel, (name, value) in enumerate((("f", f_now), ("s", s_now))):
        noise = case[f"estimate.noise_{name}"] * white_noise(x["tick"], channel)
        measured = value * (1 + case[f"estimate.bias_{name}"]) + noise
        estimated[name] = x[f"{name}_hat"] + pole * (measured - x[f"{name}_hat"])
    gain = case | {"adhesion.torque_per_adhesion": case["load"] * case["radius"]}
    f_hat, s_hat = ([estimated[name]] * 2 for name in ("f", "s"))
    u, stored, segment = base_torque(f_hat, s_hat, f_star, x["v"], x, gain, case["tau_max"])

    w_, v_, u_ = ca.SX.sym("w"), ca.SX.sym("v"), ca.SX.sym("u")
    f_, _ = _grip(w_, v_, case, factor)
    spin_up = (u_ - case["radius"] * case["load"] * f_) / case["inertia"]
    rate = ca.Function("rate", [w_, v_, u_, factor, case_], [spin_up, ca.jacobian(spin_up, w_), f_])
    w, v, h = x["w"], x["v"], CONTROL_PERIOD / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        faster, stiffness, f = rate(w, v, u, factor, case_)
        w, v = w + h * faster / (1 - h * stiffness), v + h * case["gravity"] * f
    new = stored | {"w": w, "v": v, "f_hat": estimated["f"], "s_hat": estimated["s"], "tick": x["tick"] + 1}
    outputs = ca.vertcat(f_now, s_now, u, x["v"], segment)
    inputs = [state, f_star, factor, case_]
    return ca.Function("bare_wheel", inputs, [ca.vertcat(*(new[name] for name in _STATE)), outputs], {"cse": True})


def simulate(vehicle: Vehicle, cases: Sequence[Case], speed, demand, factor=1.0) -> Traces:
    """Drive single wheels under the law; without a torque limit but that of the sign of the slip.

    Parameters
    ----------
    vehicle : Vehicle
    cases : sequence of Case
    speed : array_like, broadcast to (cases,)
        Initial speeds (m/s).
    demand : array_like, shape (time,) or (time, cases)
        Adhesion set point, traction-positive, one row per ms (-).
    factor : array_like, broadcast to the shape of `demand`
        Factor on the friction at rest (-).
    """
    demand = np.asarray(demand, dtype=float)
    demand = np.ascontiguousarray(np.broadcast_to(demand.reshape(len(demand), -1), (len(demand), len(cases))))
    factor = np.asarray(factor, dtype=float)
    factor = np.ascontiguousarray(np.broadcast_to(factor.reshape(-1, 1) if factor.ndim == 1 else factor, demand.shape))
    a, b, kalker = middle_patch(vehicle)
    wheel = vehicle.wheel
    body: tuple[float, ...] = (wheel.radius, wheel.spin_inertia, vehicle.wheel_load, vehicle.gravity, 1e5)
    body += (a, b, *kalker, vehicle.contact.shear_modulus)
    columns = [[*c.law.gains().values(), *c.estimate.gains().values(), *astuple(c.adhesion), *body] for c in cases]
    call = codegen.compiled(_cycle().map("bare_wheels", "serial", len(cases), [], []))
    state, f_star, friction, case = call.arguments
    start = np.zeros((len(cases), len(_STATE)))
    spin, running = _STATE.index("w"), _STATE.index("v")
    start[:, running] = speed
    start[:, spin] = start[:, running] / wheel.radius
    state[:], case[:] = start.ravel(), np.array(columns).ravel()
    log = np.empty((len(demand), len(cases), len(_OUTPUT)))
    for k in range(len(demand)):
        f_star[:], friction[:] = demand[k], factor[k]
        new, outputs = call()
        log[k] = outputs.reshape(len(cases), -1)
        state[:] = new
    return Traces(*(log[:, :, i] for i in range(len(_OUTPUT))))
