"""The lateral controllers by name, and the set-ups of the comparisons: from tuning parameters to guidance laws.

A new controller is one entry in `CONTROLLERS`, which is also the order in which they are shown. Serves the paper's
section Multi-Body Simulation Results (which methods are compared).
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from pkgutil import resolve_name

from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.ndi import NDI
from railrepro.control.problem import MPCSettings
from railrepro.errors import InputError
from railrepro.model.control_model import STATES
from railrepro.schema import above, is_number, require

MOST_STEPS, LEAST_STEPS = 100, 5
"""Range of the horizon length L in tuning."""


@dataclass(frozen=True)
class Controller:
    """How to build a lateral controller.

    Attributes
    ----------
    build : callable
        Settings -> guidance for `simulate.run`.
    settings : callable
        Tuning parameters by name -> settings.
    preview : bool
        Whether it sees the set point and the track ahead.
    information : str
        What it is given, one phrase.
    quick : dict
        Options of `guidance` for many runs: a faster way to nearly the same torques.
    """

    build: Callable
    settings: Callable
    preview: bool
    information: str
    quick: dict = field(default_factory=dict)


def mpc_settings(parameters: dict) -> MPCSettings:
    """MPC settings from tuning parameters q_psi_TrAx, q_psidot_Ax, r, q_terminal, period_ms, horizon_s, observer."""
    p = dict(parameters)
    period = 1e-3 * p.pop("period_ms")
    require("MPC: horizon_s", p["horizon_s"], above(0.0, 100.0, "s"))
    steps = min(max(round(p.pop("horizon_s") / period), LEAST_STEPS), MOST_STEPS)
    weights = {"psidot_Ax": p.pop("q_psidot_Ax"), "y_TrAx": 1.0, "psi_TrAx": p.pop("q_psi_TrAx")}
    return MPCSettings(tuple(weights.get(name, 0.0) for name in STATES), period=period, steps=steps, **p)


@dataclass(frozen=True)
class Predictive:
    """Factory of a predictive controller per gear; picklable."""

    kind: type
    settings: MPCSettings
    options: tuple = ()

    def __call__(self, vehicle, route, gear: int):
        return self.kind(vehicle, route, gear, self.settings, **dict(self.options))


def _inversion(settings: NDI) -> NDI:
    return settings


def _creep_mpc(settings):
    """CreepMPC is imported when it is asked for, so that the paper's controllers do not stand on ours."""
    return resolve_name("railrepro.own.creep_mpc:CreepMPC")(settings)


def _creep_settings(parameters: dict):
    return resolve_name("railrepro.own.creep_gains:CreepSettings")(**parameters)


_STATE = "states of its own gear, track at its position"
_AHEAD = _STATE + ", track and set point over the horizon"
CONTROLLERS = {
    "nmpc": Controller(partial(Predictive, NMPC), mpc_settings, True, _AHEAD, {"solver": "rti"}),
    "nmpc_observer": Controller(partial(Predictive, NMPC), mpc_settings, True, _AHEAD, {"solver": "rti"}),
    "ltv_mpc": Controller(partial(Predictive, LTVMPC), mpc_settings, True, _AHEAD),
    "ltv_mpc_printed": Controller(
        partial(Predictive, LTVMPC, options=(("printed", True),)), mpc_settings, True, _AHEAD
    ),
    "ndi": Controller(_inversion, lambda p: NDI(**p), False, _STATE + ", set point now"),
    "ndi_feedforward": Controller(
        _inversion, lambda p: NDI(**p, derivatives=3), False, _STATE + ", set point and its rates now"
    ),
    "ndi_integral": Controller(
        _inversion, lambda p: NDI(**p, derivatives=3), False, _STATE + ", set point and its rates now"
    ),
}
PREDICTIVE = tuple(name for name, controller in CONTROLLERS.items() if controller.preview)
INVERSIONS = tuple(name for name in CONTROLLERS if name not in PREDICTIVE)
PAPER_TRIO = ("nmpc", "ltv_mpc_printed", "ndi")
"""The three methods of the paper, LTV-MPC as printed."""
TRIO = ("nmpc", "ltv_mpc", "ndi")
"""The same with the LTV-MPC that keeps its affine term."""
COMPARED = ("nmpc", "ltv_mpc", "ltv_mpc_printed", "ndi")
"""The paper's methods with LTV-MPC in both readings."""
WITH_OBSERVER, OBSERVER = "nmpc_observer", 0.05
"""Name of the NMPC with an offset observer, and the observer's gain, see `MPCSettings.observer`."""
EMPHASIS = 10.0
"""Factor on R of NMPC where the longitudinal task counts more (Fig. 8)."""
OURS = "creep_mpc"
"""The controller that is not the paper's: shown under its own name, and no claim is judged with it."""
REGISTERED = CONTROLLERS | {
    OURS: Controller(_creep_mpc, _creep_settings, True, _AHEAD + "; adhesion and slip of its wheels")
}
"""All of them."""


def with_r_times(parameters: dict, factor: float) -> dict:
    """Tuning parameters or changes with R times a factor."""
    return parameters | {"r": factor * parameters["r"]}


def r_times(factor: float, controller: str = "") -> str:
    """Name of a set-up with R times a factor: "R x 10", or "NMPC, R x 10" for a controller called NMPC."""
    return (f"{controller}, " if controller else "") + f"R x {factor:g}"


def guidance(name: str, parameters: dict, options: dict | None = None, **changes):
    """A guidance law for `simulate.run`.

    Parameters
    ----------
    name : str
        Key of `REGISTERED`.
    parameters : dict
        Tuning parameters, see data/tuning.toml.
    options : dict, optional
        Further arguments of a predictive controller, for example {"solver": "rti"}.
    changes : optional
        Fields of the settings to change afterwards (`MPCSettings`, `NDI`).

    Returns
    -------
    LateralLaw or callable
        See `simulate.run`.
    """
    if name not in tuple(REGISTERED):
        raise InputError(f"controller {name!r} is not known; there are {sorted(REGISTERED)}")
    controller = REGISTERED[name]
    require(f"controller {name}: options", options or {}, dict)
    if not isinstance(parameters, dict):
        raise InputError(f"controller {name}: parameters are {reprlib.repr(parameters)}, a table of numbers is needed")
    wrong = [key for key, value in parameters.items() if not is_number(value)]
    if wrong:
        raise InputError(f"controller {name}: {wrong[0]} is {parameters[wrong[0]]!r}, a finite number is needed")
    try:
        settings = controller.settings(parameters)
    except KeyError as error:
        raise InputError(f"controller {name}: the parameter {error} is missing; found {sorted(parameters)}") from error
    except (TypeError, ZeroDivisionError, OverflowError) as error:
        raise InputError(
            f"controller {name}: parameters {sorted(parameters)} are not those it takes ({error})"
        ) from error
    unknown = set(changes) - ({field.name for field in fields(settings)} if is_dataclass(settings) else set())
    if unknown:
        raise InputError(f"controller {name}: setting {min(unknown)!r} is not known")
    built = controller.build(settings=replace(settings, **changes) if changes else settings)
    if options and not isinstance(built, Predictive):
        raise InputError(f"controller {name}: takes no options, {sorted(options)} are given")
    if options:
        known = {field.name for field in fields(built.kind) if field.init} - {"vehicle", "route", "gear", "settings"}
        if set(options) - known:
            odd = min(set(options) - known)
            raise InputError(f"controller {name}: option {odd!r} is not known; there are {sorted(known)}")
        built = replace(built, options=(*built.options, *options.items()))
    return built
