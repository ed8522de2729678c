"""The control law of the 1 kHz exchange as one function: what is seen, adhesion law, lateral law, integration rule.

Without sensors the controllers see the car's own states; with them, what `railrepro.estimation` makes of readings.

The lateral law is a `railrepro.control.lateral.LateralLaw`. All gains are run-time inputs, so one compiled object
serves every scenario and tuning particle of one kind of law.

Serves the paper's Fig. 4 and sections Adhesion Control and Integration Approach.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.control import lateral, slip
from railrepro.control.adhesion import AdhesionSettings, base_torque
from railrepro.control.allocation import allocate
from railrepro.control.slip import SlipSettings
from railrepro.errors import InputError
from railrepro.estimation import observers
from railrepro.estimation.sensors import GAINS, LONGEST, MEMORY, Readings, arriving, sense, sent
from railrepro.model.control_model import STATES
from railrepro.schema import between, require
from railrepro.track.route import COLUMNS, irregularity_in, reference_in, track_in
from railrepro.vehicle.parameters import Vehicle

GEARS = ("front", "rear")
SIDES = ("le", "ri")
_OUTPUT = {"x": "p", "xdot": "v", "y_TrAx": "y"}
MEASURED_STATES = {gear: tuple(f"{gear}.{_OUTPUT.get(name, name)}" for name in STATES) for gear in GEARS}
"""Outputs of the car that are the states of each gear, in the order of the control model."""
MEASURED = (
    *(name for gear in GEARS for name in MEASURED_STATES[gear]),
    *(f"{gear}_{side}.{name}" for gear in GEARS for side in SIDES for name in ("fx", "sx", "w")),
)
"""Outputs of the car that the law measures."""
SEEN = tuple(f"seen.{name}" for name in STATES)
"""States of a gear as its controllers saw them last, in the memory of a law with sensors."""
READ = ("read.y_TrAx", "read.psi_TrAx", "read.psidot_Ax")
"""Displacement, yaw angle and yaw rate of a gear as sensors read them, in the memory of a law with sensors."""
LIMITS = ("lateral", "track_end", "stop_speed")
MARGINS = (*(f"{gear}.lateral" for gear in GEARS), "track_end", "stop_speed")
"""Distances to the limits of a run."""
Longitudinal = type[AdhesionSettings] | type[SlipSettings]
"""Which law gives the base torque."""
ESTIMATES = ("f_hat_0", "f_hat_1", "s_hat_0", "s_hat_1")
"""Adhesion and slip of left and right wheel, in the memory of a law, per gear."""
GUIDANCE_FADE = 1.0
"""Speed below which the differential torque fades (m/s): a wheel that stands cannot steer."""
_RECORDED = ("u_d", "du", "tau_long", "f_star", "segment", "y_ref")
"""The set point `y_ref` is that at the true place of the gear, from which errors are counted; controllers use the set
point at the place that they believe, which with sensors is recorded as `seen.y_ref`."""
RECORD = tuple(f"{gear}.{name}" for gear in GEARS for name in _RECORDED)


@dataclass(frozen=True)
class EstimateSettings:
    """Quality of the adhesion and slip estimates that the adhesion law sees.

    Attributes
    ----------
    noise_f, noise_s : float
        Standard deviation of white noise per exchange (-).
    bias_f, bias_s : float
        Relative error of scale (-).
    lag : float
        Time constant of a first-order lag (s).

    Raises
    ------
    InputError
        When a value is no number or beyond its range.
    """

    noise_f: float = 0.0
    noise_s: float = 0.0
    bias_f: float = 0.0
    bias_s: float = 0.0
    lag: float = 0.0

    def __post_init__(self):
        noise, bias = between(0.0, 10.0), between(-10.0, 10.0)
        ranges = {"noise_f": noise, "noise_s": noise, "bias_f": bias, "bias_s": bias, "lag": between(0.0, 100.0, "s")}
        for name, allowed in ranges.items():
            require(f"EstimateSettings: {name}", getattr(self, name), allowed)

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        return {f"estimate.{name}": float(value) for name, value in vars(self).items()}


@dataclass(frozen=True)
class ControlLaw:
    """The 1 kHz law with its numbers.

    Attributes
    ----------
    kind : lateral.Kind
        Lateral law without its numbers.
    gains : ndarray
        Run-time gains in the order of `gain_names`.
    sensed : bool
        Whether sensors and filter stand between the car and the controllers.
    along : type
        `AdhesionSettings` or `SlipSettings`: which law gives the base torque.
    """

    kind: lateral.Kind
    gains: np.ndarray
    sensed: bool = False
    longitudinal_law: Longitudinal = AdhesionSettings

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of the states of the law."""
        return memory_names(self.kind, self.sensed, self.longitudinal_law)

    @property
    def function(self) -> ca.Function:
        """See `function`."""
        return function(self.kind, self.sensed, self.longitudinal_law)

    @property
    def record(self) -> tuple[str, ...]:
        """Names of what is recorded in each exchange, see `record_names`."""
        return record_names(self.sensed)

    def library(self) -> ctypes.CDLL | None:
        """The law as a shared object; None without a C compiler."""
        return _library(self.kind, self.sensed, self.longitudinal_law)


def check_settings(adhesion=None, estimate=None, fixed_share=0.0, sensors=None) -> None:
    """Refuse settings of `control_law` that are of another kind or beyond their range (InputError)."""
    kinds = {
        "adhesion": (adhesion, (AdhesionSettings, SlipSettings)),
        "estimate": (estimate, EstimateSettings),
        "sensors": (sensors, Readings),
    }
    for name, (given, kind) in kinds.items():
        if given is not None:
            require(name, given, kind)
    require("fixed_share", fixed_share, between(0.0, 1.0))


def control_law(
    vehicle: Vehicle,
    guidance: lateral.LateralLaw | None = None,
    adhesion: AdhesionSettings | SlipSettings | None = None,
    estimate: EstimateSettings | None = None,
    fixed_share: float = 0.0,
    sensors: Readings | None = None,
    **limits: float,
) -> ControlLaw:
    """The 1 kHz law for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Nominal vehicle of the controllers.
    guidance : LateralLaw, optional
        Default: the held torque of a slower controller guides.
    adhesion, estimate : optional
        Settings of the paper's adhesion law (default: its own, or those that the sensors need) or of the slip control
        of our own, and of its estimates.
    fixed_share : float
        See `allocate`.
    sensors : Readings, optional
        Default: the controllers see the car's own states, and its adhesion as `estimate` says.
    limits : float
        lateral (m), track_end (m), stop_speed (m/s): where a run ends.

    Raises
    ------
    InputError
        When the lateral law is not well formed, see `lateral.kind`.
    """
    guidance = guidance or lateral.Held()
    if set(limits) != set(LIMITS):
        raise InputError(f"control law: the limits {sorted(limits)} are given, {sorted(LIMITS)} are needed")
    kind, sensed = lateral.kind(guidance), sensors is not None
    load = (vehicle.body.mass / 2 + vehicle.gear.mass) * vehicle.gravity / 2
    gains = {f"lateral.{name}": value for name, value in guidance.gains().items()}
    if adhesion is None:
        adhesion = AdhesionSettings(**({} if sensors is None else vars(sensors.loop.adhesion)))
    gains |= adhesion.gains() | (estimate or EstimateSettings()).gains()
    gains |= {"fixed_share": fixed_share, "nominal_load": load}
    gains["adhesion.torque_per_adhesion"] = load * vehicle.wheel.radius
    gains |= {
        "model.J_eff": vehicle.effective_yaw_inertia,
        "model.k_sz": vehicle.suspension.yaw_stiffness,
        "model.k_dz": vehicle.suspension.yaw_damping,
        "model.J_Wy": vehicle.wheel.spin_inertia,
        "model.r_0": vehicle.wheel.radius,
        "model.b": vehicle.gear.contact_base,
        "model.gamma": vehicle.gamma,
        "model.tan_delta": np.tan(vehicle.wheel.cone_angle),
        "model.m_x_eff": vehicle.effective_longitudinal_mass,
        "model.tau_max": vehicle.drive.torque_limit,
    }
    gains |= {f"limit.{name}": value for name, value in limits.items()}
    if sensed:
        for g, gear in enumerate(GEARS):
            gains |= {f"{gear}.sensor.{name}": value for name, value in sensors.gains(g).items()}
        gains |= {f"filter.{name}": value for name, value in observers.stationary_gains(vehicle, sensors.loop).items()}
    longitudinal_law = type(adhesion)
    numbers = [gains[name] for name in gain_names(kind, sensed, longitudinal_law)]
    return ControlLaw(kind, np.array(numbers, dtype=float), sensed, longitudinal_law)


def gain_names(
    kind: lateral.Kind, sensed: bool = False, longitudinal_law: Longitudinal = AdhesionSettings
) -> tuple[str, ...]:
    """Names of the run-time gains."""
    seeing = (*(f"{gear}.sensor.{n}" for gear in GEARS for n in GAINS), *(f"filter.{n}" for n in observers.GAINS))
    return (
        *(f"lateral.{name}" for name in kind.gains),
        *longitudinal_law().gains(),
        "adhesion.torque_per_adhesion",
        *EstimateSettings().gains(),
        *("fixed_share", "nominal_load"),
        *(f"model.{name}" for name in lateral.MODEL),
        *(f"limit.{name}" for name in LIMITS),
        *(seeing if sensed else ()),
    )


def memory_names(
    kind: lateral.Kind, sensed: bool = False, longitudinal_law: Longitudinal = AdhesionSettings
) -> tuple[str, ...]:
    """Names of the states of the law; `front.u` and `rear.u` are the base torques (N m).

    With sensors `front.seen.y_TrAx` and so on are the states that the controllers saw last.
    """
    own = (*longitudinal_law.memory, *ESTIMATES, *(f"lateral.{name}" for name in kind.memory))
    if sensed:
        own += (*(f"sensor.{n}" for n in MEMORY), *(f"filter.{n}" for n in observers.STATES), *SEEN, *READ)
    return ("ticks", *(f"{gear}.{name}" for gear in GEARS for name in own))


def record_names(sensed: bool = False) -> tuple[str, ...]:
    """`RECORD`; with sensors also states, adhesions and slips that the controllers see, as `front.seen.y_TrAx`, and the
    set point that they follow, `front.seen.y_ref`."""
    seen = (*SEEN, *(f"seen.{what}_{side}" for what in ("f", "s") for side in SIDES), "seen.y_ref")
    return (*RECORD, *(f"{gear}.{name}" for gear in GEARS for name in seen)) if sensed else RECORD


@lru_cache
def _library(kind: lateral.Kind, sensed: bool, longitudinal_law: Longitudinal) -> ctypes.CDLL | None:
    return codegen.library((function(kind, sensed, longitudinal_law),))


@codegen.stored
def function(
    kind: lateral.Kind, sensed: bool = False, longitudinal_law: Longitudinal = AdhesionSettings
) -> ca.Function:
    """The 1 kHz law as a function.

    Returns
    -------
    casadi.Function
        (measured, cells of both gears, held[2], gains, memory) -> command[4] (N m), memory, record, margins; a run goes
        on while all margins are positive.
    """
    names = {
        "y": MEASURED,
        "gains": gain_names(kind, sensed, longitudinal_law),
        "memory": memory_names(kind, sensed, longitudinal_law),
    }
    symbols = {name: ca.SX.sym(name, len(entries)) for name, entries in names.items()}
    y, gain, old = (_named(names[name], symbols[name]) for name in names)
    rows, held = ca.SX.sym("rows", len(COLUMNS), len(GEARS)), ca.SX.sym("held", len(GEARS))
    model = {name: gain[f"model.{name}"] for name in lateral.MODEL}
    states = {gear: dict(zip(STATES, (y[name] for name in MEASURED_STATES[gear]), strict=True)) for gear in GEARS}
    cells = {gear: _named(COLUMNS, rows[:, g]) for g, gear in enumerate(GEARS)}
    owns = {gear: _part(old, gear) for gear in GEARS}
    sights = {
        gear: _Sight(g, gear, states[gear], y, cells[gear], old["ticks"], owns[gear], gain) if sensed else None
        for g, gear in enumerate(GEARS)
    }
    places = {gear: sights[gear].place if sensed else states[gear]["x"] for gear in GEARS}
    roads = {gear: _track_ahead(cells[gear], places[gear]) for gear in GEARS}
    body = {name: (roads["front"][name] + roads["rear"][name]) / 2 for name in ("psi_Tr", "dpsi_dp")}

    new, record, command = {"ticks": old["ticks"] + 1}, {}, []
    for g, gear in enumerate(GEARS):
        own, sight = owns[gear], sights[gear]
        track_ahead = roads[gear] | {"psi_CB": body["psi_Tr"], "dpsi_dp_CB": body["dpsi_dp"]}
        if sensed:
            state, estimates = sight.look(track_ahead)
        else:
            state, estimates = states[gear], _estimates(gear, g, y, old["ticks"], own, gain)
        f_star = cells[gear]["force"] / (2 * gain["nominal_load"])
        f, s = ([estimates[f"{kind_}_hat_{i}"] for i in range(2)] for kind_ in ("f", "s"))
        if longitudinal_law is SlipSettings:
            u_d, stored, segment = slip.base_torque(f, s, f_star, state["xdot"], old["ticks"], own, gain, model)
        else:
            u_d, stored, segment = base_torque(f, s, f_star, state["xdot"], own, gain, model["tau_max"])

        state = state | {"xddot": 2 * u_d / (model["r_0"] * model["m_x_eff"]), "held": held[g]}
        wanted, following = _lateral(kind, state, track_ahead, own, gain, model)
        wanted *= _fade(state["xdot"], GUIDANCE_FADE)
        tau_le, tau_ri, tau_long, du = allocate(u_d, wanted, model["tau_max"], gain["fixed_share"])
        if sensed:
            tau_le, tau_ri = sight.send(tau_le, tau_ri, track_ahead)
            stored |= sight.stored
            record |= {f"{gear}.{name}": state[name.removeprefix("seen.")] for name in SEEN}
            record[f"{gear}.seen.y_ref"] = track_ahead["y_ref"]
            for what, values in (("f", f), ("s", s)):
                record |= {f"{gear}.seen.{what}_{side}": value for side, value in zip(SIDES, values, strict=True)}
        command += [tau_le, tau_ri]
        new |= {f"{gear}.{name}": value for name, value in (estimates | stored | following).items()}
        there = reference_in(cells[gear], states[gear]["x"])[0]  # where the gear is, not where it is believed to be
        values = (u_d, du, tau_long, f_star, segment, there)
        record |= {f"{gear}.{name}": value for name, value in zip(_RECORDED, values, strict=True)}
    margins = {f"{gear}.lateral": gain["limit.lateral"] - ca.fabs(states[gear]["y_TrAx"]) for gear in GEARS}
    margins["track_end"] = gain["limit.track_end"] - states["front"]["x"]
    margins["stop_speed"] = states["front"]["xdot"] - gain["limit.stop_speed"]
    results = {"command": command, "memory_next": [new[name] for name in names["memory"]]}
    results |= {
        "record": [record[name] for name in record_names(sensed)],
        "margins": [margins[name] for name in MARGINS],
    }
    return ca.Function(
        "control_law",
        [symbols["y"], rows, held, symbols["gains"], symbols["memory"]],
        [ca.densify(ca.vertcat(*entries)) for entries in results.values()],
        ["y", "rows", "held", "gains", "memory"],
        list(results),
        {"cse": True},
    )


class _Sight:
    """What a gear's controllers see through sensors and filter in one exchange, and how their torques get away."""

    def __init__(self, g: int, gear: str, truth: dict, y: dict, cell: dict, ticks: ca.SX, own: dict, gain: dict):
        self._gain = _part(gain, f"{gear}.sensor") | _part(gain, "filter") | {"nominal_load": gain["nominal_load"]}
        self._own, self._ticks = own, ticks
        rail, turned = irregularity_in(cell, "lateral", truth["x"])[:2]
        aside = truth["y_TrAx"] - rail
        lever = self._gain["base"] / 2 * (truth["psi_TrAx"] - turned)
        exact = {"y_ahead": aside + lever, "y_behind": aside - lever, "psidot_Ax": truth["psidot_Ax"]}
        exact |= {f"w_{side}": y[f"{gear}_{side}.w"] for side in SIDES} | {"v": truth["xdot"], "p": truth["x"]}
        self._readings, lines = sense(exact, ticks, g, self._gain, _part(own, "sensor"))
        self._lines = {f"sensor.{name}": value for name, value in lines.items()}
        until = EXCHANGE_PERIOD * self._gain["command"]
        self.place = self._readings["p"] + until * self._readings["v"]

    def look(self, track_ahead: dict) -> tuple[dict, dict]:
        """States by name, and estimates of adhesion and slip."""
        line, names = _part(self._own, "sensor"), range(LONGEST)
        sent_before = {side: [line[f"tau_{side}.{k}"] for k in names] for side in SIDES}
        seen, self._filter = observers.observe(
            self._readings, sent_before, track_ahead, self._ticks, self._gain, _part(self._own, "filter")
        )
        state = {name: seen[name] for name in ("xdot", "psidot_Ax", "y_TrAx", "psi_TrAx")}
        state |= {"x": self.place, "psi_Ax": track_ahead["psi_Tr"] + seen["psi_TrAx"]}
        self.stored = {f"seen.{name}": state[name] for name in STATES}
        planes = self._readings["y_ahead"], self._readings["y_behind"]
        self.stored |= {"read.y_TrAx": sum(planes) / 2, "read.psi_TrAx": (planes[0] - planes[1]) / self._gain["base"]}
        self.stored |= {"read.psidot_Ax": self._readings["psidot_Ax"]}
        sides = tuple(enumerate(SIDES))
        return state, {f"{what}_hat_{i}": seen[f"{what}_{side}"] for what in ("f", "s") for i, side in sides}

    def send(self, tau_le, tau_ri, track_ahead: dict) -> tuple:
        """Torques that arrive in this exchange (N m); what is kept for the next one is then in `kept`."""
        line = _part(self._own, "sensor")
        lines = {side: sent(tau, f"tau_{side}", line) for side, tau in (("le", tau_le), ("ri", tau_ri))}
        following = observers.advance(self._filter, lines, track_ahead, self._gain)
        self.stored |= self._lines | {f"filter.{name}": value for name, value in following.items()}
        self.stored |= {f"sensor.tau_{side}.{k}": tau for side, taus in lines.items() for k, tau in enumerate(taus)}
        return tuple(arriving(lines[side], self._gain) for side in SIDES)


def _part(values: dict, prefix: str) -> dict:
    """Entries below a dotted prefix, without it."""
    return {name.removeprefix(f"{prefix}."): v for name, v in values.items() if name.startswith(f"{prefix}.")}


def _named(names: tuple[str, ...], vector: ca.SX) -> dict[str, ca.SX]:
    return dict(zip(names, ca.vertsplit(vector), strict=True))


def _lateral(
    kind: lateral.Kind, state: dict, track_ahead: dict, own: dict, gain: dict, model: dict
) -> tuple[ca.SX, dict]:
    """Torque of the lateral law (N m) and its next memory."""
    memory = [f"lateral.{name}" for name in kind.memory]
    groups = ((state, lateral.GEAR), (track_ahead, lateral.ROAD), (own, memory))
    groups += ((gain, [f"lateral.{name}" for name in kind.gains]), (model, lateral.MODEL))
    du, following = kind.function(*(ca.vertcat(*(group[name] for name in names)) for group, names in groups))
    return du, dict(zip(memory, ca.vertsplit(following), strict=True))


def _fade(v: ca.SX, speed: float) -> ca.SX:
    """0 at rest, 1 from `speed` (m/s) on."""
    return ca.fmin(ca.fmax(v / speed, 0), 1)


def _track_ahead(cell: dict, p: ca.SX) -> dict:
    """Track and set point at a gear from its cell, but for the car body's heading; see `lateral.ROAD`."""
    psi, kappa, phi, dphi, eps, deps = track_in(cell, p)
    y_ref, dy_ref, ddy_ref = reference_in(cell, p)
    track = {"psi_Tr": psi, "dpsi_dp": kappa, "ddpsi_dp": cell["dkappa"]}
    track |= {"phi_Tr": phi, "dphi_dp": dphi, "eps_Tr": eps, "deps_dp": deps}
    return track | {"y_ref": y_ref, "dy_ref": dy_ref, "ddy_ref": ddy_ref, "dddy_ref": cell["dddy_ref"]}


def _estimates(gear: str, g: int, y: dict, ticks: ca.SX, own: dict, gain: dict) -> dict:
    """Adhesion and slip estimates of both wheels: scaled, noisy and lagging copies of the plant's values."""
    estimates = {}
    pole = EXCHANGE_PERIOD / (gain["estimate.lag"] + EXCHANGE_PERIOD)
    for i, side in enumerate(SIDES):
        for k, (name, short) in enumerate((("fx", "f"), ("sx", "s"))):
            exact = y[f"{gear}_{side}.{name}"] * (1 + gain[f"estimate.bias_{short}"])
            noise = gain[f"estimate.noise_{short}"] * white_noise(ticks, 1 + 4 * g + 2 * i + k)
            before = own[f"{short}_hat_{i}"]
            estimates[f"{short}_hat_{i}"] = before + pole * (exact + noise - before)
    return estimates


def white_noise(ticks: ca.SX, channel: int) -> ca.SX:
    """Deterministic noise of unit variance: sum of three hashed uniform numbers of the tick and channel."""
    total = 0
    for k in range(3):
        hashed = ca.sin(12.9898 * (ticks + 1) + 78.233 * (3 * channel + k)) * 43758.5453
        total += hashed - ca.floor(hashed) - 0.5
    return 2 * total
