"""The control law of the 1 kHz control cycle as one function: measurement, adhesion law, lateral law, integration rule.

Without sensors the controllers see the car's own states; with them, what `railrepro.estimation` makes of readings.

The lateral law is a `railrepro.control.lateral.LateralLaw`. All gains are run-time inputs, so one compiled object
serves every scenario and tuning particle of one signature.

Serves the paper's Fig. 4 and sections Adhesion Control and Integration Approach.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import lateral
from railrepro.control.adhesion import AdhesionSettings, LongitudinalLaw
from railrepro.control.allocation import allocate
from railrepro.data import between, check_fields, require
from railrepro.estimation import observers
from railrepro.estimation.sensors import GAINS, LONGEST, MEMORY, Readings, arriving, sense, sent
from railrepro.model.control_model import STATES
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
ESTIMATED = tuple(f"estimated.{name}" for name in STATES)
"""States of a gear as its controllers saw them last, in the memory of a law with sensors."""
READ = ("read.y_TrAx", "read.psi_TrAx", "read.psidot_Ax")
"""Displacement, yaw angle and yaw rate of a gear as sensors read them, in the memory of a law with sensors."""
LIMITS = ("lateral", "track_end", "stop_speed")
MARGINS = (*(f"{gear}.lateral" for gear in GEARS), "track_end", "stop_speed")
"""Distances to the limits of a run."""
ESTIMATES = ("f_hat_0", "f_hat_1", "s_hat_0", "s_hat_1")
"""Adhesion and slip of left and right wheel, in the memory of a law, per gear."""
GUIDANCE_FADE = 1.0
"""Speed below which the differential torque fades (m/s): a wheel that stands cannot steer."""
_RECORDED = ("u_d", "du", "tau_long", "f_star", "segment", "y_ref")
"""The set point `y_ref` is that at the true position of the gear, from which errors are counted. With sensors the
controllers use the set point at the estimated position, recorded as `estimated.y_ref`."""
_OF_BODY = {"psi_CB": "psi_Tr", "dpsi_dp_CB": "dpsi_dp"}
"""Of `lateral.ROAD`, what holds at the car body, as the mean of what holds at its gears."""
RECORD = tuple(f"{gear}.{name}" for gear in GEARS for name in _RECORDED)


@dataclass(frozen=True)
class EstimateSettings:
    """Quality of the adhesion and slip estimates that the adhesion law sees.

    Raises
    ------
    InputError
        When a value is no number or beyond its range.
    """

    noise_f: Annotated[float, between(0.0, 10.0)] = 0.0
    """Standard deviation of white noise of the adhesion per control cycle (-)."""
    noise_s: Annotated[float, between(0.0, 10.0)] = 0.0
    """The same of the slip (-)."""
    bias_f: Annotated[float, between(-10.0, 10.0)] = 0.0
    """Relative error of scale of the adhesion (-)."""
    bias_s: Annotated[float, between(-10.0, 10.0)] = 0.0
    """The same of the slip (-)."""
    lag: Annotated[float, between(0.0, 100.0, "s")] = 0.0
    """Time constant of a first-order lag."""

    def __post_init__(self) -> None:
        check_fields(self)

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        return {f"estimate.{name}": float(value) for name, value in vars(self).items()}


@dataclass(frozen=True)
class LawSettings:
    """What surrounds the lateral law in the control cycle.

    Attributes
    ----------
    adhesion : LongitudinalLaw, optional
        The law of the base torque; default the paper's adhesion law with its own settings, or those that the sensors
        need.
    estimate : EstimateSettings, optional
        Quality of the estimates of adhesion and slip without sensors; default exact.
    fixed_share : float
        See `allocate` (-).
    sensors : Readings, optional
        What stands between the car and its controllers; default nothing.

    Raises
    ------
    InputError
        When one is of another kind or beyond its range.
    """

    adhesion: LongitudinalLaw | None = None
    estimate: EstimateSettings | None = None
    fixed_share: float = 0.0
    sensors: Readings | None = None

    def __post_init__(self) -> None:
        if self.adhesion is not None:
            require("adhesion", self.adhesion, LongitudinalLaw)
        if self.estimate is not None:
            require("estimate", self.estimate, EstimateSettings)
        if self.sensors is not None:
            require("sensors", self.sensors, Readings)
        require("fixed_share", self.fixed_share, between(0.0, 1.0))


PLAIN = LawSettings()
"""The paper's adhesion law and allocation, with perfect measurements."""


@dataclass(frozen=True)
class LawSignature:
    """A 1 kHz law without its numbers: laws of one signature share one compiled object.

    Attributes
    ----------
    lateral : lateral.Signature
    sensed : bool
        Whether sensors and filter stand between the car and the controllers.
    longitudinal_law : type
        Which law gives the base torque.
    """

    lateral: lateral.Signature
    sensed: bool = False
    longitudinal_law: type[LongitudinalLaw] = AdhesionSettings

    @property
    def gains(self) -> tuple[str, ...]:
        """Names of the run-time gains."""
        seeing = (*(f"{gear}.sensor.{n}" for gear in GEARS for n in GAINS), *(f"filter.{n}" for n in observers.GAINS))
        return (
            *(f"lateral.{name}" for name in self.lateral.gains),
            *self.longitudinal_law().gains(),
            "adhesion.torque_per_adhesion",
            *EstimateSettings().gains(),
            *("fixed_share", "nominal_load"),
            *(f"model.{name}" for name in lateral.MODEL),
            *(f"limit.{name}" for name in LIMITS),
            *(seeing if self.sensed else ()),
        )

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of the states of the law; `front.u` and `rear.u` are the base torques (N m).

        With sensors `front.estimated.y_TrAx` and so on are the states that the controllers saw last.
        """
        names = (*self.longitudinal_law.memory, *ESTIMATES, *(f"lateral.{name}" for name in self.lateral.memory))
        if self.sensed:
            names += (*(f"sensor.{n}" for n in MEMORY), *(f"filter.{n}" for n in observers.STATES), *ESTIMATED, *READ)
        return ("ticks", *(f"{gear}.{name}" for gear in GEARS for name in names))

    @property
    def record(self) -> tuple[str, ...]:
        """`RECORD`; with sensors also the states, adhesions, slips and set points that the controllers see, as
        `front.estimated.y_TrAx`.
        """
        estimated = (
            *ESTIMATED,
            *(f"estimated.{what}_{side}" for what in ("f", "s") for side in SIDES),
            "estimated.y_ref",
        )
        return (*RECORD, *(f"{gear}.{name}" for gear in GEARS for name in estimated)) if self.sensed else RECORD


@dataclass(frozen=True)
class ControlLaw:
    """The 1 kHz law with its numbers: `gains` in the order of `signature.gains`, SI."""

    signature: LawSignature
    gains: np.ndarray

    @property
    def function(self) -> ca.Function:
        """See `function`."""
        return function(self.signature)

    def library(self) -> ctypes.CDLL:
        """The law as a shared object."""
        return _library(self.signature)


def control_law(
    vehicle: Vehicle,
    guidance: lateral.LateralLaw | None = None,
    settings: LawSettings = PLAIN,
    *,
    lateral_limit: float,
    track_end: float,
    stop_speed: float,
) -> ControlLaw:
    """The 1 kHz law for a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Nominal vehicle of the controllers.
    guidance : LateralLaw, optional
        Default: the held torque of a slower controller guides.
    settings : LawSettings
    lateral_limit, track_end, stop_speed : float
        Where a run ends (m, m, m/s).

    Raises
    ------
    InputError
        When the lateral law is not well formed, see `lateral.signature`.
    """
    law, sensors = guidance or lateral.ZeroOrderHold(), settings.sensors
    adhesion = settings.adhesion or AdhesionSettings(**({} if sensors is None else vars(sensors.loop.adhesion)))
    gains = {f"lateral.{name}": value for name, value in lateral.gains_of(law).items()}
    gains |= adhesion.gains() | (settings.estimate or EstimateSettings()).gains()
    gains |= {"fixed_share": settings.fixed_share, "nominal_load": vehicle.wheel_load}
    gains["adhesion.torque_per_adhesion"] = vehicle.wheel_load * vehicle.wheel.radius
    gains |= {f"model.{name}": value for name, value in _model(vehicle).items()}
    limits = lateral_limit, track_end, stop_speed
    gains |= {f"limit.{name}": value for name, value in zip(LIMITS, limits, strict=True)}
    if sensors is not None:
        for g, gear in enumerate(GEARS):
            gains |= {f"{gear}.sensor.{name}": value for name, value in sensors.gains(g).items()}
        gains |= {f"filter.{name}": value for name, value in observers.stationary_gains(vehicle, sensors.loop).items()}
    signature = LawSignature(lateral.signature(law), sensors is not None, type(adhesion))
    return ControlLaw(signature, np.array([gains[name] for name in signature.gains], dtype=float))


def _model(vehicle: Vehicle) -> dict[str, float]:
    """Numbers of `lateral.MODEL`."""
    return {
        "J_eff": vehicle.effective_yaw_inertia,
        "k_sz": vehicle.suspension.yaw_stiffness,
        "k_dz": vehicle.suspension.yaw_damping,
        "J_Wy": vehicle.wheel.spin_inertia,
        "r_0": vehicle.wheel.radius,
        "b": vehicle.gear.contact_base,
        "gamma": vehicle.gamma,
        "tan_delta": np.tan(vehicle.wheel.cone_angle),
        "m_x_eff": vehicle.effective_longitudinal_mass,
        "tau_max": vehicle.drive.torque_limit,
    }


@lru_cache
def _library(signature: LawSignature) -> ctypes.CDLL:
    return codegen.library((function(signature),))


@codegen.stored
def function(signature: LawSignature) -> ca.Function:
    """The 1 kHz law as a function.

    Returns
    -------
    casadi.Function
        (measured, cells of both gears, held[2], gains, memory) -> command[4] (N m), memory, record, margins; a run goes
        on while all margins are positive.
    """
    names = {"y": MEASURED, "gains": signature.gains, "memory": signature.memory}
    symbols = {name: ca.SX.sym(name, len(entries)) for name, entries in names.items()}
    y, gain, old = (_named(names[name], symbols[name]) for name in names)
    rows, held = ca.SX.sym("rows", len(COLUMNS), len(GEARS)), ca.SX.sym("held", len(GEARS))
    sight = _Sensed if signature.sensed else _Exact
    gears = [sight(g, y, _named(COLUMNS, rows[:, g]), held[g], old, gain) for g in range(len(GEARS))]
    tracks = [_track_ahead(gear.cell, gear.position) for gear in gears]
    front, rear = tracks
    body = {to: (front[name] + rear[name]) / 2 for to, name in _OF_BODY.items()}

    new, command = {"ticks": old["ticks"] + 1}, []
    record: dict[str, ca.SX] = {}
    for gear, track_ahead in zip(gears, tracks, strict=True):
        torques, following, recorded = _cycle(signature, gear, track_ahead | body)
        command += torques
        new |= {f"{gear.name}.{name}": value for name, value in following.items()}
        record |= {f"{gear.name}.{name}": value for name, value in recorded.items()}
    margins = {f"{gear.name}.lateral": gain["limit.lateral"] - ca.fabs(gear.truth["y_TrAx"]) for gear in gears}
    margins["track_end"] = gain["limit.track_end"] - gears[0].truth["x"]
    margins["stop_speed"] = gears[0].truth["xdot"] - gain["limit.stop_speed"]
    results = {
        "command": command,
        "memory_next": [new[name] for name in names["memory"]],
        "record": [record[name] for name in signature.record],
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


def _cycle(signature: LawSignature, gear: _Exact, track_ahead: dict) -> tuple[list, dict, dict]:
    """Torques of both wheels of a gear (N m), its next memory, and what is recorded of it."""
    gain, own, model = gear.gain, gear.own, _part(gear.gain, "model")
    state, estimates = gear.look(track_ahead)
    f_star = gear.cell["force"] / (2 * gain["nominal_load"])
    f, s = ([estimates[f"{what}_hat_{i}"] for i in range(2)] for what in ("f", "s"))
    u_d, stored, segment = signature.longitudinal_law.law(f, s, f_star, state["xdot"], gear.ticks, own, gain, model)

    state = state | {"xddot": 2 * u_d / (model["r_0"] * model["m_x_eff"]), "held": gear.held}
    wanted, following = _lateral(signature.lateral, state, track_ahead, own, gain, model)
    wanted *= _fade(state["xdot"], GUIDANCE_FADE)
    tau_le, tau_ri, tau_long, du = allocate(u_d, wanted, model["tau_max"], gain["fixed_share"])
    torques, stored_next = gear.send(tau_le, tau_ri, track_ahead)
    there = reference_in(gear.cell, gear.truth["x"])[0]  # where the gear is, not where it is believed to be
    record = dict(zip(_RECORDED, (u_d, du, tau_long, f_star, segment, there), strict=True))
    record |= {name: state[name.removeprefix("estimated.")] for name in ESTIMATED} | {
        "estimated.y_ref": track_ahead["y_ref"]
    }
    for what, values in (("f", f), ("s", s)):
        record |= {f"estimated.{what}_{side}": value for side, value in zip(SIDES, values, strict=True)}
    return torques, estimates | stored | stored_next | following, record


class _Exact:
    """Symbols of one gear, and what its controllers know of it: its true states, its adhesion as well as is asked."""

    def __init__(self, g: int, y: dict, cell: dict, held: ca.SX, old: dict, gain: dict):
        self.index, self.name, self.y, self.cell, self.held, self.gain = g, GEARS[g], y, cell, held, gain
        self.truth = dict(zip(STATES, (y[name] for name in MEASURED_STATES[self.name]), strict=True))
        self.own, self.ticks, self.position = _part(old, self.name), old["ticks"], self.truth["x"]

    def look(self, track_ahead: dict) -> tuple[dict, dict]:
        """States by name, and estimates of adhesion and slip: scaled, noisy and lagging copies of the true values."""
        gain, estimates = self.gain, {}
        pole = CONTROL_PERIOD / (gain["estimate.lag"] + CONTROL_PERIOD)
        for i, side in enumerate(SIDES):
            for k, (name, short) in enumerate((("fx", "f"), ("sx", "s"))):
                exact = self.y[f"{self.name}_{side}.{name}"] * (1 + gain[f"estimate.bias_{short}"])
                noise = gain[f"estimate.noise_{short}"] * white_noise(self.ticks, 1 + 4 * self.index + 2 * i + k)
                before = self.own[f"{short}_hat_{i}"]
                estimates[f"{short}_hat_{i}"] = before + pole * (exact + noise - before)
        return self.truth, estimates

    def send(self, tau_le: ca.SX, tau_ri: ca.SX, track_ahead: dict) -> tuple[list, dict]:
        """Torques that arrive in this cycle (N m), and what is stored of what the controllers saw."""
        return [tau_le, tau_ri], {}


class _Sensed(_Exact):
    """The same through sensors and filter; torques arrive late."""

    def __init__(self, g: int, y: dict, cell: dict, held: ca.SX, old: dict, gain: dict):
        super().__init__(g, y, cell, held, old, gain)
        truth, gear = self.truth, self.name
        self._gain = _part(gain, f"{gear}.sensor") | _part(gain, "filter") | {"nominal_load": gain["nominal_load"]}
        self._line = _part(self.own, "sensor")
        rail, turned = irregularity_in(cell, "lateral", truth["x"])[:2]
        aside = truth["y_TrAx"] - rail
        lever = self._gain["base"] / 2 * (truth["psi_TrAx"] - turned)
        exact = {"y_ahead": aside + lever, "y_behind": aside - lever, "psidot_Ax": truth["psidot_Ax"]}
        exact |= {f"w_{side}": y[f"{gear}_{side}.w"] for side in SIDES} | {"v": truth["xdot"], "p": truth["x"]}
        self._readings, lines = sense(exact, self.ticks, g, self._gain, self._line)
        self._stored = {f"sensor.{name}": value for name, value in lines.items()}
        until = CONTROL_PERIOD * self._gain["command"]
        self.position = self._readings["p"] + until * self._readings["v"]

    def look(self, track_ahead: dict) -> tuple[dict, dict]:
        """See `_Exact.look`."""
        sent_before = {side: [self._line[f"tau_{side}.{k}"] for k in range(LONGEST)] for side in SIDES}
        estimated, self._filter = observers.observe(
            self._readings, sent_before, track_ahead, self.ticks, self._gain, _part(self.own, "filter")
        )
        state = {name: estimated[name] for name in ("xdot", "psidot_Ax", "y_TrAx", "psi_TrAx")}
        state |= {"x": self.position, "psi_Ax": track_ahead["psi_Tr"] + estimated["psi_TrAx"]}
        self._stored |= {f"estimated.{name}": state[name] for name in STATES}
        planes = self._readings["y_ahead"], self._readings["y_behind"]
        read = sum(planes) / 2, (planes[0] - planes[1]) / self._gain["base"], self._readings["psidot_Ax"]
        self._stored |= dict(zip(READ, read, strict=True))
        sides = tuple(enumerate(SIDES))
        return state, {f"{what}_hat_{i}": estimated[f"{what}_{side}"] for what in ("f", "s") for i, side in sides}

    def send(self, tau_le: ca.SX, tau_ri: ca.SX, track_ahead: dict) -> tuple[list, dict]:
        """See `_Exact.send`."""
        lines = {side: sent(tau, f"tau_{side}", self._line) for side, tau in (("le", tau_le), ("ri", tau_ri))}
        following = observers.advance(self._filter, lines, track_ahead, self._gain)
        stored = self._stored | {f"filter.{name}": value for name, value in following.items()}
        stored |= {f"sensor.tau_{side}.{k}": tau for side, taus in lines.items() for k, tau in enumerate(taus)}
        return [arriving(lines[side], self._gain) for side in SIDES], stored


def _part(values: dict, prefix: str) -> dict:
    """Entries below a dotted prefix, without it."""
    return {name.removeprefix(f"{prefix}."): v for name, v in values.items() if name.startswith(f"{prefix}.")}


def _named(names: tuple[str, ...], vector: ca.SX) -> dict[str, ca.SX]:
    return dict(zip(names, ca.vertsplit(vector), strict=True))


def _lateral(
    signature: lateral.Signature, state: dict, track_ahead: dict, own: dict, gain: dict, model: dict
) -> tuple[ca.SX, dict]:
    """Torque of the lateral law (N m) and its next memory."""
    memory, gains = ([f"lateral.{name}" for name in names] for names in (signature.memory, signature.gains))
    groups = state, track_ahead, own, gain, model
    orders = lateral.GEAR, lateral.ROAD, memory, gains, lateral.MODEL
    vectors = [ca.vertcat(*(group[name] for name in names)) for group, names in zip(groups, orders, strict=True)]
    du, following = signature.function(*vectors)
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


def white_noise(ticks: ca.SX, channel: int) -> ca.SX:
    """Deterministic noise of unit variance: sum of three hashed uniform numbers of the tick and channel."""
    total = ca.SX(0)
    for k in range(3):
        hashed = ca.sin(12.9898 * (ticks + 1) + 78.233 * (3 * channel + k)) * 43758.5453
        total += hashed - ca.floor(hashed) - 0.5
    return 2 * total
