"""The lateral controllers by name, and their tuned parameters. A new one is an entry of `CONTROLLERS`. data/tuned has
tuned parameters, by setting ("paper": exact measurements, "loop": sensors) and controller; data/tuning.toml has those
that a designer chose. Serves the paper's section Multi-Body Simulation Results."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from pkgutil import resolve_name

from railrepro import data, paths
from railrepro.control.lateral import ZeroOrderHold
from railrepro.control.mpc import LTVMPC, NMPC
from railrepro.control.ndi import NDI
from railrepro.control.problem import LARGEST_WEIGHT, MPCSettings
from railrepro.data import InputError, above, require
from railrepro.model.control_model import STATES

TUNED = "data/tuned"
SETTINGS = ("paper", "loop")
"""The settings in which controllers are tuned and compared. "paper": perfect measurements, dry rail. "loop": sensors,
rails of all kinds. In both all controllers have the same least stability margin, see data/tuning.toml."""
PAPER, LOOP = SETTINGS


@dataclass(frozen=True)
class Controller:
    """Entry of `CONTROLLERS`: how a lateral controller is made from its tuning parameters. `settings` makes a settings
    object, such as `MPCSettings` or `NDI`, from a dict of tuning parameters, of which `needed` have no default. `build`
    makes from this object what `simulate.run` takes: a law that is called every ms, or a factory, a function of
    vehicle, route and gear that makes a slower controller such as MPC. `preview` says whether the controller knows set
    point and track ahead. `quick` has constructor arguments of MPC for studies, as {"solver": "rti"}, a faster solver
    with nearly equal torques."""

    build: Callable
    settings: Callable
    preview: bool
    quick: dict = field(default_factory=dict)
    needed: tuple[str, ...] = ()


_RANGES = dict.fromkeys(("q_psi_TrAx", "q_psidot_Ax"), above(0.0, LARGEST_WEIGHT))
_RANGES |= {"period_ms": above(0.0, 1e3, "ms"), "horizon_s": above(0.0, 100.0, "s")}
_MPC = (*_RANGES, "r", "q_terminal")


def mpc_settings(parameters: dict) -> MPCSettings:
    """Make `MPCSettings` from tuning parameters (dict): weights q_psi_TrAx (1/rad^2) and q_psidot_Ax (s^2/rad^2); the
    sampling time period_ms; horizon_s, limited to 5 to 100 steps; other fields of `MPCSettings`, such as r. The weight
    of y_TrAx is 1/m^2, that of other states 0."""
    p = dict(parameters)
    for name, allowed in _RANGES.items():
        require(f"MPC: {name}", p[name], allowed)
    period = 1e-3 * p.pop("period_ms")
    steps = min(max(round(p.pop("horizon_s") / period), 5), 100)
    weights = {"psidot_Ax": p.pop("q_psidot_Ax"), "y_TrAx": 1.0, "psi_TrAx": p.pop("q_psi_TrAx")}
    return MPCSettings(tuple(weights.get(name, 0.0) for name in STATES), period=period, steps=steps, **p)


@dataclass(frozen=True)
class Predictive:
    """Factory of predictive controllers: called with vehicle, route, gear (0 front, 1 rear), it makes an object of the
    class `controller` with the same `settings` for both gears. `options` are more arguments, pairs (name, value)."""

    controller: type
    settings: MPCSettings
    options: tuple = ()

    def __call__(self, vehicle, route, gear: int):
        return self.controller(vehicle, route, gear, self.settings, **dict(self.options))


def _predictive(kind: type, quick: dict | None = None, **options) -> Controller:
    build = partial(Predictive, kind, options=tuple(options.items()))
    return Controller(build, mpc_settings, True, quick or {}, _MPC)


def _inversion(*more: str, **fixed) -> Controller:
    needed = ("pole", "frequency", "damping", *more)
    return Controller(lambda settings: settings, lambda given: NDI(**given, **fixed), False, needed=needed)


def _lqg(parameters: dict):
    """`LqgPreview`, imported on demand, because the paper's controllers must not depend on this one."""
    return resolve_name("railrepro.own.lqg:LqgPreview")(**parameters)


NOTHING = "nothing"
"""Name of the controller whose differential torque is always 0, the baseline of scores. It has no parameters."""
OURS = "lqg_preview"
"""Name of the controller of this project. The paper does not have it, so no statement is judged with it."""
CONTROLLERS = {
    "nmpc": _predictive(NMPC, {"solver": "rti"}),
    "nmpc_observer": replace(_predictive(NMPC, {"solver": "rti"}), needed=(*_MPC, "observer")),
    "ltv_mpc": _predictive(LTVMPC),
    "ltv_mpc_printed": _predictive(LTVMPC, printed=True),
    "ndi": _inversion(),
    "ndi_feedforward": _inversion(rates=True),
    "ndi_integral": _inversion("integral", rates=True),
    OURS: Controller(lambda settings: settings, _lqg, True, needed=("change",)),
    NOTHING: Controller(lambda settings: ZeroOrderHold(), dict, False),
}
INVERSIONS = ("ndi", "ndi_feedforward", "ndi_integral")
BY_SWARM = tuple(f"{name}_swarm" for name in INVERSIONS)
"""The inversions with poles found by particle swarm. With sensors (setting "loop") the `INVERSIONS` have such poles."""
CONTROLLERS |= {f"{name}_swarm": CONTROLLERS[name] for name in INVERSIONS}
REPLICATED = ("nmpc", "nmpc_observer", "ltv_mpc", "ltv_mpc_printed", *INVERSIONS)
"""The paper's methods and their variants, in the order in which chapters show them."""
SHOWN = (*REPLICATED, OURS)
PAPER_TRIO = ("nmpc", "ltv_mpc_printed", "ndi")
"""The three methods of the paper, LTV-MPC as printed."""
OBSERVER = 0.05
"""Gain with which "nmpc_observer" observes the creep angle between heading and motion, `MPCSettings.observer`."""
EMPHASIS = 10.0
"""Factor on the weight R of NMPC where the longitudinal task has priority (Fig. 8)."""


def with_r_times(parameters: dict, factor: float) -> dict:
    """Copy of tuning parameters of a predictive controller, its weight "r" of the torque multiplied by `factor`."""
    return parameters | {"r": factor * parameters["r"]}


def guidance(name: str, parameters: dict, options: dict | None = None, **changes):
    """Make a lateral controller for `simulate.run`: a 1 kHz law, or a factory of slower controllers such as MPC.
    InputError for an unknown name or argument. `name` is a key of `CONTROLLERS`, such as "nmpc", `parameters` a dict of
    its tuning parameters, as from `registry.parameters`. `options` are further constructor arguments of MPC, such as
    {"solver": "rti"}; `changes` are fields of `MPCSettings` or `NDI` with values that replace tuned ones."""
    require("controller", name, str)
    if name not in CONTROLLERS:
        raise InputError(f"controller {name!r} is not known; there are {sorted(CONTROLLERS)}")
    require(f"controller {name}: parameters", parameters, dict)
    require(f"controller {name}: options", {} if options is None else options, dict)
    controller = CONTROLLERS[name]
    for each in controller.needed:
        if each not in parameters:
            raise InputError(f"controller {name}: the parameter {each!r} is missing; found {sorted(parameters)}")
    try:
        settings = controller.settings(parameters)
        built = controller.build(settings=replace(settings, **changes) if changes else settings)
        return replace(built, options=(*built.options, *options.items())) if options else built
    except (TypeError, AttributeError, ArithmeticError) as error:
        raise InputError(f"controller {name}: takes no such parameters, options or changes ({error})") from error


def read(controller: str, setting: str = PAPER, folder: Path | None = None) -> dict:
    """Read <controller>.json from `folder`, by default data/tuned/<setting>. `setting` says in which conditions the
    controller was tuned, "paper" (exact measurements) or "loop" (sensors, delays). Returns a dict with the keys
    "controller", "setting" and "parameters", and with the origin of the parameters. InputError if the file is missing,
    has no "parameters", or names another controller or setting."""
    file = (folder or paths.source(f"{TUNED}/{setting}")) / f"{controller}.json"
    if not file.exists():
        raise InputError(f"{setting}/{file.name}: there is no tuned set for {controller!r}; `make tune` makes it")
    content = data.read(file)
    parameters = content.get("parameters") if isinstance(content, dict) else None
    data.build(dict[str, data.Plain], parameters, f"{file.name}: parameters")
    data.build(dict[str, data.Free], content, file.name)
    found = content.get("controller"), content.get("setting")
    if found != (controller, setting):
        raise InputError(f"{file.name}: holds a tuned set of {found[0]!r} in the setting {found[1]!r}")
    return content


def tuned_set(controller: str, setting: str = PAPER) -> dict:
    """Tuned parameters of a controller in a setting, "paper" (exact signals) or "loop" (sensors, delays): a dict with
    "controller", "setting" and "parameters" (name -> value; the function `parameters` returns only these). Parameters
    that a swarm or rule found are read from a file of data/tuned; its other entries, such as "cost", are in the dict,
    too. Parameters that a person chose are read from data/tuning.toml. InputError for an unknown setting or without
    parameters."""
    require("controller", controller, str)
    require("setting", setting, str)
    if setting not in SETTINGS:
        raise InputError(f"setting {setting!r} is not known; there are {sorted(SETTINGS)}")
    designed = data.read(paths.source("data/tuning.toml"))["setting"][setting].get("designed", {})
    if controller not in designed:
        stored = controller.removesuffix("_swarm") if setting == LOOP else controller
        return read(stored, setting) | {"controller": controller}
    return {"controller": controller, "setting": setting, "parameters": designed[controller]}


def parameters(controller: str, setting: str = PAPER) -> dict:
    """Tuned parameters of a controller in a setting, "paper" (exact signals) or "loop" (sensors, delays): a dict from
    name to value for `guidance`. InputError if there are none."""
    return tuned_set(controller, setting)["parameters"]


def tuned(controller: str, options: dict | None = None, setting: str = PAPER, **changes):
    """Make a lateral controller, a key of `CONTROLLERS`, for `simulate.run`, with the parameters tuned in the `setting`
    "paper" (exact signals) or "loop" (sensors, delays). `options` are further constructor arguments of MPC, such as
    {"solver": "rti"}; `changes` are fields of `MPCSettings` or `NDI` that replace tuned ones."""
    return guidance(controller, parameters(controller, setting), options, **changes)
