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
from typing import Protocol

import casadi as ca
import numpy as np

from railrepro.errors import InputError
from railrepro.model.control_model import STATES, THETA
from railrepro.schema import above, is_number, require
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle

LONGEST_PERIOD = 1.0
"""Longest period of a slower controller (s)."""
GEAR = (*STATES, "xddot", "held")
"""What a 1 kHz law knows of its gear (SI): measured states, acceleration by the base torque, held torque (N m)."""
ROAD = (*(name for name in THETA if name != "m_CB"), "ddpsi_dp", "y_ref", "dy_ref", "ddy_ref", "dddy_ref")
"""What it knows of the road where the gear is (SI): track, set point, and their derivatives over the coordinate."""
MODEL = ("J_eff", "k_sz", "k_dz", "J_Wy", "r_0", "b", "gamma", "tan_delta", "m_x_eff", "tau_max")
"""What it knows of the nominal vehicle (SI)."""
SHORT = {"y": "y_TrAx", "psi": "psi_TrAx", "yaw_rate": "psidot_Ax", "v": "xdot"}
"""Short names of measured states."""
MEANING = {
    "x": ("m", "coordinate along the track"),
    "psi_Ax": ("rad", "heading of the running gear"),
    "xdot": ("m/s", "speed"),
    "psidot_Ax": ("rad/s", "yaw rate of the running gear"),
    "y_TrAx": ("m", "lateral displacement from the track, to the right"),
    "psi_TrAx": ("rad", "yaw angle against the track, to the right"),
    "xddot": ("m/s2", "acceleration by the base torque"),
    "held": ("N m", "torque that a slower controller gave last"),
    "psi_Tr": ("rad", "heading of the track"),
    "dpsi_dp": ("1/m", "curvature of the track"),
    "phi_Tr": ("rad", "superelevation angle"),
    "dphi_dp": ("rad/m", "its derivative along the track"),
    "eps_Tr": ("rad", "gradient"),
    "deps_dp": ("rad/m", "its derivative along the track"),
    "psi_CB": ("rad", "heading of the car body"),
    "dpsi_dp_CB": ("1/m", "its derivative along the track"),
    "ddpsi_dp": ("1/m2", "derivative of the curvature along the track"),
    "y_ref": ("m", "set point of the lateral displacement"),
    "dy_ref": ("-", "its first derivative along the track"),
    "ddy_ref": ("1/m", "its second derivative"),
    "dddy_ref": ("1/m2", "its third derivative"),
    "J_eff": ("kg m2", "effective yaw inertia of a running gear"),
    "k_sz": ("N m/rad", "yaw stiffness of the suspension"),
    "k_dz": ("N m s/rad", "yaw damping of the suspension"),
    "J_Wy": ("kg m2", "spin inertia of a wheel"),
    "r_0": ("m", "wheel radius"),
    "b": ("m", "distance of the contact points"),
    "gamma": ("rad/m", "roll angle per lateral displacement"),
    "tan_delta": ("-", "slope of the wheel's cone"),
    "m_x_eff": ("kg", "effective longitudinal mass"),
    "tau_max": ("N m", "torque limit"),
}
"""Unit and meaning of what a 1 kHz law may use, by name."""
_GROUPS = ("gear", "track_ahead", "memory", "gain", "model")


class LateralLaw(Protocol):
    """A guidance law of the 1 kHz exchange.

    In its short form it has `torque` alone, which asks by the names of its arguments for what it wants of `MEANING`,
    `SHORT`, its memory and gains, and may return the torque alone; `memory` and `gains` are added where it needs them.
    """

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of its own states, per gear; all are 0 at the start."""

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

    One that has a filter of its own has `read(readings, delay)`: with sensors it is called before `plan` with the
    displacement (m), yaw angle against the track (rad) and yaw rate (rad/s) as they were read, and the time from the
    reading to the moment when a torque acts (s).

    One that learns from the gear in front also has `follow(leader)`, which is called once, before the first sample,
    with that gear's controller; in each sample the front gear plans first.

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
        return _full(guidance), factory
    if factory is None or hasattr(guidance, "torque"):
        raise InputError(
            f"guidance {guidance!r}: an object with gains(), memory and torque(), or a factory (vehicle, route, gear) "
            "of objects with period and plan(), is needed"
        )
    return Held(), factory


def _full(law) -> LateralLaw:
    """A law in its full form."""
    whole = hasattr(law, "memory") and hasattr(law, "gains") and _takes(law.torque, len(_GROUPS))
    names = set(inspect.signature(law.torque).parameters) if whole else set()
    return law if whole and not names & {*MEANING, *SHORT, *law.memory} else _ByName(law)


class _ByName:
    """The full form of a law whose `torque` asks for quantities by the names of its arguments."""

    def __init__(self, law):
        self._law, self.owner = law, type(law).__name__
        self.memory, self.gains = getattr(law, "memory", ()), getattr(law, "gains", dict)
        if not callable(law.torque):
            raise InputError(f"lateral law {self.owner}: torque is {reprlib.repr(law.torque)}, a method is needed")
        self._wanted = list(inspect.signature(law.torque).parameters)

    def torque(self, *groups: dict) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        gear, track_ahead, memory, gain, model = groups
        known = dict(zip(_GROUPS, groups, strict=True)) | model | track_ahead | gear
        known |= {short: gear[name] for short, name in SHORT.items()} | dict(gain) | memory
        missing = [name for name in self._wanted if name not in known]
        if missing:
            raise InputError(f"lateral law {self.owner}: torque() asks for {missing[0]!r}; there are {list(known)}")
        answer = self._law.torque(**{name: known[name] for name in self._wanted})
        return answer if isinstance(answer, tuple) else (answer, {})


def _takes(call: Callable, count: int) -> bool:
    """Whether something can be called with so many arguments; without a signature it counts as one that can."""
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
    for name, count in {"plan": 2, "notice": 2, "read": 2, "follow": 1}.items():
        method = getattr(controller, name, max)
        if not (callable(method) and _takes(method, count)):
            needed = "a method of one argument" if count == 1 else "a method of two arguments"
            raise InputError(f"{owner}: {name} is {reprlib.repr(method)}, {needed} is needed")
    require(f"{owner}: period", getattr(controller, "period", None), above(0.0, LONGEST_PERIOD, "s"))


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
    owner = getattr(law, "owner", type(law).__name__)
    gains = law.gains() if callable(getattr(law, "gains", None)) else None
    if not isinstance(gains, dict):
        raise InputError(f"lateral law {owner}: gains() gives {gains!r}, a table of numbers by name is needed")
    if not isinstance(getattr(law, "memory", None), tuple | list):
        raise InputError(f"lateral law {owner}: memory is {getattr(law, 'memory', None)!r}, a tuple of names is needed")
    if not _takes(law.torque, 5):
        raise InputError(
            f"lateral law {owner}: torque() cannot be called with (gear, track_ahead, memory, gain, model)"
        )
    memory = tuple(law.memory)
    if len(set(memory)) < len(memory):
        raise InputError(f"lateral law {owner}: memory is {list(memory)}, each name once is needed")
    for name, value in gains.items():
        if not is_number(value):
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
    if expression.is_constant() and not np.isfinite(ca.evalf(expression).full()).all():
        raise InputError(f"lateral law {owner}: its {what} is {value!r}, a finite number is needed")
    if expression.shape != (1, 1):
        raise InputError(
            f"lateral law {owner}: its {what} is an expression of shape {expression.shape}, a scalar is needed"
        )
    return ca.densify(expression)
