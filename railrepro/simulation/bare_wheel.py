"""One driven wheel under the 1 kHz adhesion law, with Polach's creep law and a quarter of the car as its mass. Serves
the paper's Fig. 5 and section Adhesion Control."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from railrepro.car.equations import SLIP_FLOOR
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.contact.creep import polach
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionInputs, AdhesionMemory, AdhesionSettings
from railrepro.quantities import Scalar, indices, names, pack, symbols
from railrepro.vehicle.parameters import AdhesionSet, Vehicle

_SUBSTEPS, _LIMIT = 20, 1e5  # Integration steps per control cycle; torque limit (N m), more than adhesion can transmit


@dataclass(frozen=True)
class Case:
    """One wheel for `simulate`: settings of its adhesion law (slip control), and the friction numbers of its rail."""

    law: AdhesionSettings
    adhesion: AdhesionSet


@dataclass(frozen=True)
class Traces:
    """Series of single wheels from `simulate`, a row per ms, a column per wheel. `segment`: 1 raises the torque
    (adhesion below its set point), 2 holds it (near), 3 lowers it (above, or past the maximum)."""

    adhesion: Annotated[Scalar, "-", "f_x, longitudinal force over wheel load, traction-positive"]
    slip: Annotated[Scalar, "-", "s_x = (v - w r)/v"]
    torque: Annotated[Scalar, "N m", "motor torque, traction-positive"]
    speed: Annotated[Scalar, "m/s", "running speed"]
    segment: Annotated[Scalar, "-", "active segment of the adhesion law, 1 to 3"]


@dataclass(frozen=True)
class _State:
    """State of one wheel."""

    w: Annotated[Scalar, "rad/s", "angular speed"]
    v: Annotated[Scalar, "m/s", "running speed"]
    u: Annotated[Scalar, "N m", "motor torque"]
    law: AdhesionMemory


def _cycle(vehicle: Vehicle) -> ca.Function:
    """Build one control cycle of one wheel: (state, set point of f_x, numbers of `Case`) -> state, `Traces`."""
    (state, x), (case_, case) = symbols(_State, "state"), symbols(Case, "case")
    a, b, kalker = middle_patch(vehicle)
    radius, load, creep = vehicle.wheel.radius, vehicle.wheel_load, case.adhesion

    def adhesion_and_slip(w: Any, v: Any) -> tuple[Any, Any]:
        slip = (v - w * radius) / ca.fmax(v, SLIP_FLOOR)
        friction = creep.k_a, creep.k_s, creep.mu0, creep.a_ratio, creep.b_decay
        law = a, b, *kalker, vehicle.contact.shear_modulus, *friction, ca.fabs(v - w * radius)
        force, *_ = polach(slip, 0.0, 0.0, load, *law)
        return force / load, slip

    f_star = ca.SX.sym("f_star")
    f_now, s_now = adhesion_and_slip(x.w, x.v)
    q = AdhesionInputs([f_now] * 2, [s_now] * 2, f_star, x.v, x.u, load, _LIMIT, radius)
    u, law, segment = case.law.base_torque(q, x.law)

    w_, v_, u_ = ca.SX.sym("w"), ca.SX.sym("v"), ca.SX.sym("u")
    f_, _ = adhesion_and_slip(w_, v_)
    acceleration = (u_ - radius * load * f_) / vehicle.wheel.spin_inertia
    rate = ca.Function("rate", [w_, v_, u_, case_], [acceleration, ca.jacobian(acceleration, w_), f_])
    w, v, h = x.w, x.v, CONTROL_PERIOD / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        w_dot, stiffness, f = rate(w, v, u, case_)
        w, v = w + h * w_dot / (1 - h * stiffness), v + h * vehicle.gravity * f
    outputs = ca.vertcat(*pack(_State(w, v, u, law))), ca.vertcat(f_now, s_now, u, x.v, segment)
    return ca.Function("bare_wheel", [state, f_star, case_], outputs, {"cse": True})


def simulate(vehicle: Vehicle, cases: Sequence[Case], speed, demand) -> Traces:
    """Simulate single driven wheels under the 1 kHz adhesion law (slip control), from free rolling with zero torque.
    Returns `Traces`: adhesion, slip, torque, speed and the active segment of the law over time. A wheel of `vehicle`
    with the load Q accelerates the mass Q/g. `cases` has the law and the rail of each wheel, `speed` the initial
    running speeds (m/s), one number or shape (wheels,). `demand` is the set point of the adhesion f_x (force over load,
    traction-positive), a value per ms: shape (ms,) or (ms, wheels)."""
    demand = np.asarray(demand, dtype=float).reshape(len(demand), -1)
    call = codegen.CompiledFunction(_cycle(vehicle).map("bare_wheels", "serial", len(cases), [], []))
    state, f_star, numbers = call.arguments
    numbers[:] = np.array([pack(case) for case in cases], dtype=float).ravel()
    start, index = np.zeros((len(cases), len(names(_State)))), indices(_State)
    start[:, index.v] = speed
    start[:, index.w] = start[:, index.v] / vehicle.wheel.radius
    state[:] = start.ravel()
    log = np.empty((len(demand), len(cases), len(names(Traces))))
    for k, set_point in enumerate(demand):
        f_star[:] = set_point
        state[:], outputs = call()
        log[k] = outputs.reshape(len(cases), -1)
    return Traces(*np.moveaxis(log, 2, 0))
