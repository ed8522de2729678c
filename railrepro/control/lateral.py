"""Lateral guidance of a running gear: laws at 1 kHz, and slower controllers, whose torque is held between samples. A 1
kHz law such as NDI is written in CasADi expressions and becomes part of the compiled loop. Its gains are run-time
numbers, so one compiled object serves all tunings of a law. Serves the paper's Fig. 4."""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Annotated, Any, Protocol

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.data import InputError, above, between, is_number, require
from railrepro.quantities import GEARS, Scalar, names
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle


@dataclass(frozen=True)
class GearInputs:
    """Inputs of a 1 kHz law (`LateralLaw`) about its running gear: its six states (`x` to `psi`); `xddot`, acceleration
    along the track by the base torque, the torque that both wheels have in common; `held`, the last differential torque
    of a slower controller such as NMPC, 0 without one."""

    x: Annotated[Scalar, "m", "coordinate along the track"]
    psi_Ax: Annotated[Scalar, "rad", "heading of the running gear"]
    v: Annotated[Scalar, "m/s", "speed"]
    yaw_rate: Annotated[Scalar, "rad/s", "yaw rate of the running gear"]
    y: Annotated[Scalar, "m", "lateral displacement from the track, to the right"]
    psi: Annotated[Scalar, "rad", "yaw angle against the track, to the right"]
    xddot: Annotated[Scalar, "m/s2", "acceleration by the base torque"]
    held: Annotated[Scalar, "N m", "last torque of the slower controller"]


@dataclass(frozen=True)
class TrackInputs:
    """Inputs of a 1 kHz law at the position of its gear: heading `psi_Tr`, superelevation `phi_Tr` and gradient
    `eps_Tr` of the track, heading `psi_CB` of the car body, set point `y_ref` of the lateral displacement. dX_dp is the
    derivative of X by the track coordinate p; dy_ref, ddy_ref and dddy_ref are the first three derivatives of y_ref by
    p. `psi_CB` is not measured: it is the mean heading of the track at both gears, `dpsi_dp_CB` its mean curvature."""

    psi_Tr: Annotated[Scalar, "rad", "heading of the track"]
    dpsi_dp: Annotated[Scalar, "1/m", "curvature of the track"]
    phi_Tr: Annotated[Scalar, "rad", "superelevation angle"]
    dphi_dp: Annotated[Scalar, "rad/m", "its derivative along the track"]
    eps_Tr: Annotated[Scalar, "rad", "gradient"]
    deps_dp: Annotated[Scalar, "rad/m", "its derivative along the track"]
    psi_CB: Annotated[Scalar, "rad", "heading of the car body"]
    dpsi_dp_CB: Annotated[Scalar, "1/m", "its derivative along the track"]
    ddpsi_dp: Annotated[Scalar, "1/m2", "derivative of the curvature along the track"]
    y_ref: Annotated[Scalar, "m", "set point of the lateral displacement"]
    dy_ref: Annotated[Scalar, "-", "its first derivative along the track"]
    ddy_ref: Annotated[Scalar, "1/m", "its second derivative"]
    dddy_ref: Annotated[Scalar, "1/m2", "its third derivative"]


@dataclass(frozen=True)
class ModelInputs:
    """Inputs of a 1 kHz law about the nominal vehicle: inertias, yaw suspension and wheel geometry of a gear. `J_eff`
    is its yaw inertia J_z with counter-rotating wheels, J_z + J_Wy b^2/(2 r_0^2); `m_x_eff` its mass m with half the
    car body and the spin of its wheels, m + m_CB/2 + 2 J_Wy/r_0^2; `b` the distance from left to right contact."""

    J_eff: Annotated[Scalar, "kg m2", "effective yaw inertia of a running gear"]
    k_sz: Annotated[Scalar, "N m/rad", "yaw stiffness of the suspension"]
    k_dz: Annotated[Scalar, "N m s/rad", "yaw damping of the suspension"]
    J_Wy: Annotated[Scalar, "kg m2", "spin inertia of a wheel"]
    r_0: Annotated[Scalar, "m", "wheel radius"]
    b: Annotated[Scalar, "m", "distance of the contact points"]
    gamma: Annotated[Scalar, "rad/m", "roll angle per lateral displacement"]
    tan_delta: Annotated[Scalar, "-", "slope of the wheel's cone"]
    m_x_eff: Annotated[Scalar, "kg", "effective longitudinal mass"]


GEAR, ROAD, MODEL = names(GearInputs), names(TrackInputs), (*names(ModelInputs), "tau_max")
"""Names of the inputs of a 1 kHz law about its running gear, about track and set point, and about the vehicle."""


class Quantities(SimpleNamespace, GearInputs, TrackInputs, ModelInputs):
    """Argument `q` of `LateralLaw.torque`: scalar CasADi symbols (SI) of the running gear, the track and set point at
    its position, and the nominal vehicle. Each state and each gain of the law is a further attribute."""

    tau_max: Annotated[Scalar, "N m", "torque limit of a motor at this speed; the base torque yields to du"]

    def __getattr__(self, name: str) -> ca.SX:
        raise AttributeError(f"torque() asks for q.{name}; there are {list(vars(self))}", name=name, obj=self)


class LateralLaw(Protocol):
    """Lateral guidance law that is evaluated every millisecond: an object with a method `torque(q)`. Four members are
    optional. `memory` is a tuple with the names of the states of the law, which each gear has for itself and which
    start at 0. `gains()` returns a dict from name to value of numbers that can change without compiling again.
    `ranges()` returns a dict from name of a gain to its `data.Quantity` (unit, lowest and highest value); the law
    exported as C or FMU refuses a gain out of its range. `alike = True` in the body of a class states that `torque`
    depends on q only; then `torque` of one object is called for all objects of the class."""

    def torque(self, q: Quantities) -> ca.SX | tuple[ca.SX, dict[str, ca.SX]]:
        """Differential torque (N m, positive steers to the right), a CasADi expression of the attributes of q. A law
        with `memory` returns a pair: the torque, and a dict from the name of each state to its next value."""


class SlowController(Protocol):
    """Lateral controller of one running gear that is sampled once per `period` (s), a multiple of 1 ms. Two further
    methods are optional. `read(readings, delay)` is called before `plan` in a run with sensors. `readings` are lateral
    displacement (m), yaw angle against the track (rad) and yaw rate (rad/s) from the sensors. `delay` is the time from
    reading to torque (s). `compiled(loop, leader=None)` of a controller in compiled C is called once before a run.
    `loop` has errors and delays of sensors and inverters (`Loop`), None for exact states; `leader`, for the rear gear,
    is the front controller. The two addresses that it returns are those of a C function (memory, states (6,) of `plan`,
    readings (3,) of `read`, base torque (N m)) -> differential torque (N m), and of its memory; with None the run calls
    `plan`."""

    period: float
    """Sampling time (s), a multiple of 1 ms, the same for both gears."""

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Differential torque (N m) to hold until the next sample. Not needed if `compiled` returns addresses. `x_hat`,
        shape (6,), is the measured or estimated state of the gear: track coordinate (m), heading (rad), speed (m/s),
        yaw rate (rad/s), lateral displacement (m), yaw angle against the track (rad). `u_d` is the base torque (N m),
        the torque of each wheel for traction or braking."""


Factory = Callable[[Vehicle, Route, int], Any]
"""Function (vehicle, route, gear) -> `SlowController`; gear is 0 (front) or 1 (rear)."""
Guidance = LateralLaw | Factory


@dataclass(frozen=True)
class ZeroOrderHold:
    """1 kHz law that applies the last differential torque of a slower controller such as NMPC."""

    alike = True

    def torque(self, q: Quantities) -> ca.SX:
        """Differential torque (N m): `q.held`, the last one of the slower controller."""
        return q.held


def split(guidance) -> tuple[LateralLaw, Factory | None]:
    """Split a guidance into its 1 kHz law and the `Factory` that makes its slower controllers, None if it has none. A
    guidance with a method `torque` is itself the law, and if callable, also the factory. Any other callable is the
    factory, and the law is `ZeroOrderHold`. InputError for anything else, such as a class in place of its object."""
    if isinstance(guidance, type) and hasattr(guidance, "torque"):
        name = guidance.__name__
        raise InputError(f"guidance {name} is a class, an object of it is needed: {name}(), with its arguments if any")
    factory = guidance if callable(guidance) else None
    if hasattr(guidance, "torque"):
        return guidance, factory
    if factory is None:
        needed = "an object with torque(q), or a factory (vehicle, route, gear) of objects with period and plan(), is"
        raise InputError(f"guidance {guidance!r}: {needed} needed")
    return ZeroOrderHold(), factory


def controllers(factory: Factory, vehicle: Vehicle, route: Route) -> tuple:
    """Make the slower controllers of the front and the rear gear. InputError unless they are two objects, each with
    `plan` or `compiled`, and have the same period, a whole number of ms."""
    made = tuple(factory(vehicle, route, gear) for gear in range(len(GEARS)))
    for controller in made:
        owner = f"lateral controller {type(controller).__name__}"
        if not (hasattr(controller, "plan") or hasattr(controller, "compiled")):
            raise InputError(f"{owner}: has no plan(x_hat, u_d)")
        require(f"{owner}: period", getattr(controller, "period", None), above(0.0, 1.0, "s"))
    if made[0] is made[1]:
        raise InputError(f"{owner}: is one object for both gears, a factory that makes one for each is needed")
    periods = {round(controller.period / CONTROL_PERIOD, 6) for controller in made}
    if len(periods) != 1 or not float(min(periods)).is_integer() or min(periods) < 1:
        raise InputError(f"lateral controllers need one period, a whole number of ms; found {sorted(periods)} ms")
    return made


def check_arguments(controller: str, vehicle: Vehicle, route: Route, gear: int) -> None:
    """InputError, which names `controller`, unless vehicle, route and gear (0 or 1) are valid to make a controller."""
    require(f"{controller}: vehicle", vehicle, Vehicle)
    require(f"{controller}: route", route, Route)
    require(f"{controller}: gear", gear, between(0, len(GEARS) - 1), whole=True)


@dataclass(frozen=True)
class Signature:
    """Equations of a 1 kHz law without the values of its gains. `text` is a serialised CasADi function of vectors (SI):
    (gear, track, memory, gains, model) -> (differential torque du, next memory). Their entries have the order of
    `GEAR`, `ROAD`, the fields `memory` and `gains`, and `MODEL`. `gains` and `memory` are the names of gains and
    states. Laws with equal signatures share compiled code."""

    text: str
    gains: tuple[str, ...]
    memory: tuple[str, ...]


_alike: dict[tuple, Signature] = {}
"""Signatures of classes whose objects are `alike`, see `LateralLaw`. The particles of a swarm differ in gains only."""


def gains_of(law: LateralLaw) -> dict[str, float]:
    """Gains of a law as a dict from name to value, empty without gains. InputError unless all are finite numbers."""
    gains = getattr(law, "gains", dict)
    gains = gains() if callable(gains) else gains
    require(f"{_owner(law)}: gains", gains, dict)
    for name, value in gains.items():
        if not is_number(value):
            raise InputError(f"{_owner(law)}: gain {name!r} is {value!r}, a finite number is needed")
    return gains


def signature(law: LateralLaw) -> Signature:
    """Make the `Signature` of a 1 kHz law: its equations as text, and the names of its gains and states. The equations
    come from one call of `law.torque(q)` with CasADi symbols. InputError if a gain is not a finite number, a gain or
    state is called as another quantity in `q`, the torque or a next state is no scalar expression, the states that the
    law returns are not those of `memory`, or the law uses a symbol that is not in `q`."""
    owner, memory, gains = _owner(law), tuple(getattr(law, "memory", ())), tuple(gains_of(law))
    equations = type(law), getattr(type(law), "torque", None), memory, gains
    if equations in _alike:
        return _alike[equations]
    groups = {"gear": GEAR, "track": ROAD, "memory": memory, "gains": gains, "model": MODEL}
    vectors = {group: ca.SX.sym(group, len(entries)) for group, entries in groups.items()}
    known: dict[str, ca.SX] = {}
    for group, entries in groups.items():
        for name, symbol in zip(entries, ca.vertsplit(vectors[group]), strict=True):
            if name in known:
                raise InputError(f"{owner}: {name!r} of its {group} is the name of another quantity already")
            known[name] = symbol
    du, following = answer(law, Quantities(**known))
    if set(following) != set(memory):
        raise InputError(f"{owner}: torque() gave memory {sorted(following)}, declared is {list(memory)}")
    states = [_scalar(following[name], f"memory {name!r}", owner) for name in memory]
    results = [_scalar(du, "torque", owner), ca.vertcat(*states)]
    function = ca.Function("lateral", list(vectors.values()), results, {"allow_free": True})
    if function.has_free():
        raise InputError(f"{owner}: the symbols {function.get_free()} are not given to torque()")
    result = Signature(function.serialize(), gains, memory)
    if vars(type(law)).get("alike"):  # a class that inherits it may have another torque
        _alike[equations] = result
    return result


def _owner(law: LateralLaw) -> str:
    return f"lateral law {type(law).__name__}"


def answer(law: LateralLaw, q: Quantities) -> tuple[ca.SX, dict[str, ca.SX]]:
    """Call `law.torque(q)` and return the differential torque (N m) with a dict from state to next value, empty without
    memory. InputError if the law uses an attribute that `q` lacks, compares expressions by `if`, `min` or `max`, or
    returns neither a torque nor a pair (torque, dict)."""
    owner = _owner(law)
    try:
        result = law.torque(q)
    except AttributeError as error:
        if error.obj is not q:
            raise
        # the traceback shows the line of the law
        raise InputError(f"{owner}: {error}").with_traceback(error.__traceback__) from None
    except RuntimeError as error:
        if "truth value" not in str(error):  # CasADi raises it for `if` and `max` on expressions
            raise
        needed = "casadi.if_else takes the place of if, casadi.fmin and casadi.fmax that of min and max"
        raise InputError(f"{owner}: torque() compares expressions; {needed}") from None
    pair = result if isinstance(result, tuple) else (result, {})
    if len(pair) != 2 or not isinstance(pair[1], dict):
        raise InputError(f"{owner}: torque() gave {pair!r}, a torque or a pair (torque, dict) is needed")
    return pair


def _scalar(value, what: str, owner: str) -> ca.SX:
    try:
        expression = ca.SX(value)
    except NotImplementedError:
        expression = None
    if expression is None or expression.shape != (1, 1):
        raise InputError(f"{owner}: its {what} is {value!r}, a scalar expression is needed")
    return ca.densify(expression)
