"""The lateral controllers by name: from a set of tuning parameters to what `simulate.run` takes.

A new controller is one entry in `CONTROLLERS`; nothing else in the library knows their names. Serves the paper's
section Multi-Body Simulation Results (which methods are compared).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial

from railrepro.control.ltv_mpc import LTVMPC
from railrepro.control.ndi import NDISettings
from railrepro.control.nmpc import NMPC
from railrepro.control.problem import MPCSettings
from railrepro.errors import InputError

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
    """

    build: Callable
    settings: Callable
    preview: bool
    information: str


def mpc_settings(parameters: dict) -> MPCSettings:
    """MPC settings from tuning parameters q_psi_TrAx, q_psidot_Ax, r, q_terminal, period_ms, horizon_s."""
    p = dict(parameters)
    period = 1e-3 * p.pop("period_ms")
    steps = min(max(round(p.pop("horizon_s") / period), LEAST_STEPS), MOST_STEPS)
    weights = (0.0, 0.0, 0.0, p.pop("q_psidot_Ax"), 1.0, p.pop("q_psi_TrAx"))
    return MPCSettings(q_diag=weights, period=period, steps=steps, **p)


@dataclass(frozen=True)
class Predictive:
    """Factory of a predictive controller per gear; picklable."""

    kind: type
    settings: MPCSettings
    options: tuple = ()

    def __call__(self, vehicle, way, gear: int):
        return self.kind(vehicle, way, gear, self.settings, **dict(self.options))


def _inversion(settings: NDISettings) -> NDISettings:
    return settings


_STATE = "states of its own gear, track at its position"
_AHEAD = _STATE + ", track and set point over the horizon"
CONTROLLERS = {
    "nmpc": Controller(partial(Predictive, NMPC), mpc_settings, True, _AHEAD),
    "ltv_mpc": Controller(partial(Predictive, LTVMPC), mpc_settings, True, _AHEAD),
    "ltv_mpc_printed": Controller(
        partial(Predictive, LTVMPC, options=(("printed", True),)), mpc_settings, True, _AHEAD
    ),
    "ndi": Controller(_inversion, lambda p: NDISettings(**p), False, _STATE + ", set point now"),
    "ndi_feedforward": Controller(
        _inversion, lambda p: NDISettings(**p, derivatives=3), False, _STATE + ", set point and its rates now"
    ),
    "ndi_integral": Controller(_inversion, lambda p: NDISettings(**p), False, _STATE + ", set point now"),
}


def guidance(name: str, parameters: dict, options: dict | None = None, **changes):
    """A guidance law for `simulate.run`.

    Parameters
    ----------
    name : str
        Key of `CONTROLLERS`.
    parameters : dict
        Tuning parameters, see data/tuning.toml.
    options : dict, optional
        Further arguments of a predictive controller, for example {"solver": "rti"}.
    changes : optional
        Fields of the settings to change afterwards (`MPCSettings`, `NDISettings`).

    Returns
    -------
    NDISettings or callable
    """
    if name not in CONTROLLERS:
        raise InputError(f"controller {name!r} is not known; there are {sorted(CONTROLLERS)}")
    controller = CONTROLLERS[name]
    settings = controller.settings(parameters)
    unknown = set(changes) - {field.name for field in fields(settings)}
    if unknown:
        raise InputError(f"controller {name}: setting {min(unknown)!r} is not known")
    built = controller.build(settings=replace(settings, **changes))
    if options:
        built = replace(built, options=(*built.options, *options.items()))
    return built
