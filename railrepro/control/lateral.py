"""What guides a running gear: laws of the 1 kHz exchange, and slower controllers whose torque is held between samples.

A 1 kHz law is written in CasADi expressions and becomes part of the compiled exchange; its gains are run-time numbers,
so that one compiled object serves all tunings of a law. NDI is one, and `Held`, which applies what a slower controller
such as NMPC hands in, is another. Serves the paper's Fig. 4.
"""

from __future__ import annotations

import inspect
import reprlib
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite
from typing import Protocol

import casadi as ca
import numpy as np

from railrepro.errors import InputError
from railrepro.model.control_model import STATES, THETA
from railrepro.schema import between, require
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

GEAR = (*STATES, "xddot", "held")
"""What a 1 kHz law knows of its gear (SI): measured states, acceleration by the base torque, held torque (N m)."""
ROAD = (*(name for name in THETA if name != "m_CB"), "ddpsi_dp", "y_ref", "dy_ref", "ddy_ref", "dddy_ref")
"""What it knows of the road where the gear is (SI): track, set point, and their derivatives over the coordinate."""
MODEL = ("J_eff", "k_sz", "k_dz", "J_Wy", "r_0", "b", "gamma", "tan_delta", "m_x_eff", "tau_max")
"""What it knows of the nominal vehicle (SI): effective yaw inertia, yaw stiffness and damping, spin inertia, wheel
radius, contact base, roll per displacement, cone's slope, effective longitudinal mass, torque limit."""


class LateralLaw(Protocol):
    """A guidance law of the 1 kHz exchange.

    Attributes
    ----------
    memory : tuple of str
        Names of its own states, per gear; all are 0 at the start.
    """

    memory: tuple[str, ...]

    def gains(self) -> dict[str, float]:
        """Its run-time numbers by name."""

    def torque(
        self, gear: dict, track_ahead: dict, memory: dict, gain: dict, model: dict
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Differential torque (N m) and next memory from symbols by name, see `GEAR`, `ROAD`, `MODEL`."""


class SlowController(Protocol):
    """A guidance law of one running gear that runs slower than the exchange.

    One that wants to know how its wheels slip also has `notice(adhesion, slip)`, which is called before `plan` with the
    estimates of the adhesion law, each of left and right wheel, shape (2,), adhesion traction positive (-).

    One that has a filter of its own has `read(readings, delay)`: behind sensors it is called before `plan` with the
    displacement (m), yaw angle against the track (rad) and yaw rate (rad/s) as they were read, and the time from the
    reading to the moment when a torque acts (s).

    Attributes
    ----------
    period : float
        Sampling time, a whole number of exchanges (s).
    """

    period: float

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """Differential torque (N m) from the measured states (6,) and the base torque per wheel (N m)."""


Factory = Callable[[Vehicle, Route, int], SlowController]
Guidance = LateralLaw | Factory


@dataclass(frozen=True)
class Held:
    """The differential torque that a slower controller handed in last."""

    memory = ()

    def gains(self) -> dict[str, float]:
        """See `LateralLaw.gains`."""
        return {}

    def torque(self, gear: dict, track_ahead: dict, memory: dict, gain: dict, model: dict) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        return gear["held"], {}


def split(guidance: Guidance) -> tuple[LateralLaw, Factory | None]:
    """The 1 kHz law of a guidance and the factory of its slower controllers; an object may be both.

    Raises
    ------
    InputError
        When it is neither.
    """
    factory = guidance if callable(guidance) else None
    if factory is not None and not isinstance(guidance, type) and not _takes(factory, 3):
        raise InputError(f"guidance {guidance!r}: cannot be called with (vehicle, route, gear)")
    if hasattr(guidance, "torque") and not isinstance(guidance, type):
        return guidance, factory
    if factory is None or hasattr(guidance, "torque"):
        raise InputError(
            f"guidance {guidance!r}: an object with gains(), memory and torque(), or a factory (vehicle, route, gear) "
            "of objects with period and plan(), is needed"
        )
    return Held(), factory


def _takes(call: Callable, count: int) -> bool:
    """Whether something can be called with so many arguments; what tells nothing of its own counts as one that can."""
    try:
        inspect.signature(call).bind(*range(count))
    except TypeError:
        return False
    except ValueError:
        return True
    return True


def check_controller(controller: SlowController) -> None:
    """Refuse what is no slower controller (InputError)."""
    owner = f"lateral controller {type(controller).__name__}"
    if not callable(getattr(controller, "plan", None)):
        raise InputError(f"{owner}: has no plan(x_hat, u_d)")
    require(f"{owner}: period", getattr(controller, "period", None), between(-inf, inf, "s"))


def planned(torque) -> float:
    """The torque that a slower controller gave (N m); InputError when that is no number."""
    try:
        if np.ndim(torque) or isinstance(torque, bool | str | bytes):
            raise TypeError
        return float(torque)
    except (TypeError, ValueError):
        raise InputError(f"plan() returned {reprlib.repr(torque)}, a number (N m) is needed") from None


@dataclass(frozen=True)
class Kind:
    """A 1 kHz law without its numbers: laws of one kind share one compiled object.

    Attributes
    ----------
    text : str
        The serialised function of `function`.
    gains, memory : tuple of str
        Names of its gains and states.
    """

    text: str
    gains: tuple[str, ...]
    memory: tuple[str, ...]

    @property
    def function(self) -> ca.Function:
        """(gear, track_ahead, memory, gains, model) -> du, memory_next; vectors in the order of the names."""
        return ca.Function.deserialize(self.text)


class _Named(dict):
    """Symbols by name; an unknown name is refused."""

    def __init__(self, names: tuple[str, ...], owner: str, what: str):
        self.vector = ca.SX.sym(what, len(names))
        self._refusal = f"lateral law {owner}: there is no {what} {{!r}}; there are {list(names)}"
        super().__init__(zip(names, ca.vertsplit(self.vector), strict=True))

    def __missing__(self, name):
        raise InputError(self._refusal.format(name))


def kind(law: LateralLaw) -> Kind:
    """The kind of a 1 kHz law.

    Raises
    ------
    InputError
        When its gains are not finite, its torque or memory is not a scalar expression, or it uses what it did not
        declare or is not given.
    """
    owner, gains = type(law).__name__, law.gains() if callable(getattr(law, "gains", None)) else None
    if not isinstance(gains, dict):
        raise InputError(f"lateral law {owner}: gains() gives {gains!r}, a table of numbers by name is needed")
    if not isinstance(getattr(law, "memory", None), tuple | list):
        raise InputError(f"lateral law {owner}: memory is {getattr(law, 'memory', None)!r}, a tuple of names is needed")
    if not _takes(law.torque, 5):
        raise InputError(
            f"lateral law {owner}: torque() cannot be called with (gear, track_ahead, memory, gain, model)"
        )
    memory = tuple(law.memory)
    for name, value in gains.items():
        if not isinstance(value, int | float) or not isfinite(value):
            raise InputError(f"lateral law {owner}: gain {name!r} is {value!r}, a finite number is needed")
    groups = {"gear state": GEAR, "road entry": ROAD, "memory": memory, "gain": tuple(gains), "model parameter": MODEL}
    named = [_Named(names, owner, what) for what, names in groups.items()]
    result = law.torque(*named)
    if not isinstance(result, tuple) or len(result) != 2 or not isinstance(result[1], dict):
        raise InputError(f"lateral law {owner}: torque() returned {result!r}, a pair (du, memory by name) is needed")
    du, following = result
    if set(following) != set(memory):
        raise InputError(f"lateral law {owner}: torque() gave memory {sorted(following)}, declared is {list(memory)}")
    states = [_scalar(following[name], f"memory {name!r}", owner) for name in memory]
    results = [_scalar(du, "torque", owner), ca.vertcat(*states)]
    function = ca.Function("lateral", [group.vector for group in named], results, {"allow_free": True})
    if function.has_free():
        raise InputError(f"lateral law {owner}: the symbols {function.get_free()} are not given to torque()")
    return Kind(function.serialize(), tuple(gains), memory)


def _scalar(value, what: str, owner: str) -> ca.SX:
    try:
        expression = ca.SX(value)
    except NotImplementedError:
        raise InputError(f"lateral law {owner}: its {what} is {value!r}, a scalar expression is needed") from None
    if expression.shape != (1, 1):
        raise InputError(
            f"lateral law {owner}: its {what} is an expression of shape {expression.shape}, a scalar is needed"
        )
    return ca.densify(expression)
