"""The control law of the 1 kHz control cycle as one function: measurement, adhesion law, lateral law, integration rule.
The controllers get the true states of the car, or with sensors the estimates of `railrepro.estimation`. Gains are
run-time inputs, so laws that differ in numbers only share compiled code. Serves the paper's Fig. 4 and sections
Adhesion Control and Integration Approach."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import interface, lateral
from railrepro.control.adhesion import AdhesionInputs, AdhesionMemory, AdhesionSettings
from railrepro.control.allocation import allocate
from railrepro.control.lateral import ModelInputs, TrackInputs
from railrepro.data import above, between, require
from railrepro.estimation import observers
from railrepro.estimation.sensors import Readings, SensorGains, SensorMemory, Signals, received_torque, sense
from railrepro.model.control_model import States
from railrepro.quantities import GEARS, WHEELS, Scalar, named, names, pack, reannotated, symbols, unpack
from railrepro.track.route import COLUMNS, irregularity_in, reference_in, track_in
from railrepro.vehicle.parameters import Drive, Vehicle

GUIDANCE_FADE = 1.0
"""Speed (m/s) below which the differential torque is reduced in proportion to the speed, to 0 at standstill."""
_SHARE = between(0.0, 1.0, "-")


@dataclass(frozen=True)
class LawGains:
    """Numbers of the 1 kHz law that may change without compiling again (SI). `lateral` are the gains of the lateral
    law, whose names are in the subclass `LawSignature.Gains`; `adhesion` the settings of the adhesion law; `model` and
    `drive` the nominal vehicle and motor; `limit` the limits at which a run ends."""

    lateral: Annotated[list[Scalar], ()]
    adhesion: AdhesionSettings
    fixed_share: Annotated[Scalar, _SHARE, "share of the torque limit reserved for the differential torque"]
    nominal_load: Annotated[Scalar, above(0.0, 1e8, "N"), "load of a wheel at rest"]
    model: ModelInputs
    drive: Drive
    limit: interface.Limits


@dataclass(frozen=True)
class SensedGains(LawGains):
    """`LawGains` of a run with sensors: also delay and errors of the sensors per gear, and the gains of the filter."""

    front: SensorGains
    rear: SensorGains
    filter: observers.FilterGains


@dataclass(frozen=True)
class GearMemory:
    """What the 1 kHz law of one running gear keeps from cycle to cycle: base torque `u` (common to both wheels),
    filters of the adhesion law, states `lateral` of the lateral law (names in `LawSignature.Memory`)."""

    u: Annotated[Scalar, "N m", "base torque"]
    adhesion: AdhesionMemory
    lateral: Annotated[list[Scalar], ()]


@dataclass(frozen=True)
class SensedGearMemory(GearMemory):
    """`GearMemory` of a run with sensors. It also has `sensor`, readings and torque commands that a delay still holds
    back; `filter`, state of the filter that estimates states; `estimated` and `read`, last estimates and readings."""

    sensor: SensorMemory
    filter: observers.FilterState
    estimated: States
    read: Annotated[list[Scalar], interface.READ]


@dataclass(frozen=True)
class LawMemory:
    """What the 1 kHz law keeps from cycle to cycle: number of cycles since the start, states of both gears."""

    ticks: Annotated[Scalar, "ms", "control cycles since the start"]
    front: GearMemory
    rear: GearMemory


@dataclass(frozen=True)
class LawSignature:
    """What determines the compiled code of the 1 kHz law: equations of its lateral law, and whether it is `sensed`
    (gets estimates from sensors and a filter, not the true states), but no values of gains. Laws with equal signatures
    share compiled code."""

    lateral: lateral.Signature
    sensed: bool = False

    @cached_property
    def Gains(self) -> type[LawGains]:
        """Class of the gains: `LawGains`, with sensors `SensedGains`, in which gains of the lateral law have names."""
        gains = SensedGains if self.sensed else LawGains
        return reannotated(gains, lateral=Annotated[list[Scalar], self.lateral.gains])

    @cached_property
    def Memory(self) -> type[LawMemory]:
        """Class of the states: `LawMemory`, in which the states of the lateral law have names. Its fields `front` and
        `rear` are a `GearMemory`, with sensors a `SensedGearMemory`."""
        memory = SensedGearMemory if self.sensed else GearMemory
        gear = reannotated(memory, lateral=Annotated[list[Scalar], self.lateral.memory])
        return reannotated(LawMemory, front=gear, rear=gear)

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of the states of the law in the order of `Memory`, such as "front.u"."""
        return names(self.Memory)

    @property
    def record(self) -> tuple[str, ...]:
        """Names of the quantities that a run logs, front gear before rear: "front.u_d" to "front.y_ref"
        (`interface.RECORD`: torques, set point and segment of the adhesion law, lateral set point). With sensors
        "front.estimated.x" to "front.estimated.y_ref" follow (`interface.ESTIMATED`: what the controllers get)."""
        groups = {"": interface.RECORD} | ({"estimated.": interface.ESTIMATED} if self.sensed else {})
        return tuple(f"{gear}.{group}{name}" for group, of in groups.items() for gear in GEARS for name in of)


_shared = lru_cache(LawSignature)
"""`LawSignature`, one object for equal arguments, so that its dataclasses are made once."""


@dataclass(frozen=True)
class ControlLaw:
    """The 1 kHz law of both gears, as `control_law` makes it: its equations (`signature`) with the values of its
    `gains` (SI), shape (n,), in the order of `quantities.names(signature.Gains)`."""

    signature: LawSignature
    gains: np.ndarray


def control_law(
    vehicle: Vehicle,
    guidance: lateral.LateralLaw | None = None,
    adhesion: AdhesionSettings | None = None,
    fixed_share: float = 0.0,
    sensors: Readings | None = None,
    *,
    lateral_limit: float,
    track_end: float,
    stop_speed: float,
) -> ControlLaw:
    """Make the 1 kHz law of both gears. InputError if an argument has a wrong type or value.

    `vehicle` has the parameters that the controllers assume. `guidance` is the lateral law; by default it applies the
    torque of a slower controller (`ZeroOrderHold`). `sensors` has noise, delays and filter; None: controllers get exact
    states without delay. `adhesion` is by default `AdhesionSettings()`, with `sensors` changed by
    `sensors.loop.adhesion`. `fixed_share` (0 to 1) is the part of a motor's torque limit kept for the differential
    torque; the base torque gets the rest. With 0 the differential torque may use the whole limit, and the base torque
    gets what is left. A run ends when |lateral displacement| of a gear exceeds `lateral_limit` (m), or the front gear
    reaches `track_end` (m) or is as slow as `stop_speed` (m/s).
    """
    require("fixed_share", fixed_share, _SHARE)
    if sensors is not None:
        require("sensors", sensors, Readings)
    if adhesion is None:
        adhesion = AdhesionSettings(**({} if sensors is None else vars(sensors.loop.adhesion)))
    require("adhesion", adhesion, AdhesionSettings)
    law = guidance or lateral.ZeroOrderHold()
    signature = _shared(lateral.signature(law), sensors is not None)
    gains: dict[str, Any] = {
        "lateral": list(lateral.gains_of(law).values()),
        "adhesion": adhesion,
        "fixed_share": fixed_share,
        "nominal_load": vehicle.wheel_load,
        "model": _model(vehicle),
        "drive": vehicle.drive,
        "limit": interface.Limits(lateral_limit, track_end, stop_speed),
    }
    if sensors is not None:
        gains |= {gear: sensors.gains(g) for g, gear in enumerate(GEARS)}
        gains |= {"filter": observers.stationary_gains(vehicle, sensors.loop)}
    return ControlLaw(signature, np.array(pack(signature.Gains(**gains)), dtype=float))


def _model(vehicle: Vehicle) -> ModelInputs:
    return ModelInputs(
        J_eff=vehicle.effective_yaw_inertia,
        k_sz=vehicle.suspension.yaw_stiffness,
        k_dz=vehicle.suspension.yaw_damping,
        J_Wy=vehicle.wheel.spin_inertia,
        r_0=vehicle.wheel.radius,
        b=vehicle.gear.contact_base,
        gamma=vehicle.gamma,
        tan_delta=np.tan(vehicle.wheel.cone_angle),
        m_x_eff=vehicle.effective_longitudinal_mass,
    )


@codegen.stored
def function(signature: LawSignature) -> ca.Function:
    """Make the 1 kHz law of both gears, a CasADi function of vectors (SI). Inputs: y, the measured values in the order
    of `interface.Measured`; rows of the route at the front and the rear gear, shape (len(COLUMNS), 2); held, the last
    torques of both slower controllers; gains and memory in the order of the fields of `signature.Gains` and
    `signature.Memory`. Outputs: command, motor torques in the order of `WHEELS`; memory_next; record, the quantities to
    log, which `signature.record` names; margins, distances to the limits that end a run, in the order of
    `interface.MARGINS`."""
    y, measured = symbols(interface.Measured, "y")
    gains, gain = symbols(signature.Gains, "gains")
    old, memory = symbols(signature.Memory, "memory")
    rows, held = ca.SX.sym("rows", len(COLUMNS), len(GEARS)), ca.SX.sym("held", len(GEARS))
    gears = [_gear(g, measured, rows[:, g], gain, memory) for g in range(len(GEARS))]
    lateral_law = ca.Function.deserialize(signature.lateral.text)
    given = zip(gears, _tracks(gears), ca.vertsplit(held), strict=True)
    cycles = [_cycle(lateral_law, memory.ticks, *of_gear) for of_gear in given]
    torques, memories, records, estimated, margins = zip(*cycles, strict=True)
    front, limit = gears[0].truth, gain.limit
    outputs = {
        "command": [*torques[0], *torques[1]],
        "memory_next": pack(signature.Memory(memory.ticks + 1, *memories)),
        "record": [*records[0], *records[1], *estimated[0], *estimated[1]],
        "margins": [*margins[0], *margins[1], limit.track_end - front.x, front.xdot - limit.stop_speed],
    }
    vectors = [ca.densify(ca.vertcat(*entries)) for entries in outputs.values()]
    inputs = {"y": y, "rows": rows, "held": held, "gains": gains, "memory": old}
    return ca.Function("control_law", [*inputs.values()], vectors, [*inputs], [*outputs], {"cse": True})


@dataclass(frozen=True)
class _Gear:
    """A running gear before the law acts: true states, [left, right] wheel, row of the route, gains and states of the
    law, position. With sensors also their gains, their readings and the next delay lines of the readings."""

    truth: States
    wheels: list[interface.MeasuredWheel]
    cell: dict[str, ca.SX]
    gain: Any
    memory: Any
    position: ca.SX
    """Track coordinate for the controllers (m), with sensors predicted to the time when a torque acts."""
    sensor: Any = None
    readings: Any = None
    lines: Any = None
    commands: Any = None
    """Torques sent to [left, right] wheel before this cycle (N m), newest first; with sensors."""


def _gear(g: int, measured: interface.Measured, row: ca.SX, gain: LawGains, memory: LawMemory) -> _Gear:
    """Running gear `g` (0 front, 1 rear) on its `row` of the route."""
    truth, of_gear = States(*pack(getattr(measured, GEARS[g]))), (memory.front, memory.rear)[g]
    wheels, cell = [getattr(measured, wheel) for wheel in WHEELS[2 * g : 2 * g + 2]], named(COLUMNS, row)
    known = truth, wheels, cell, gain, of_gear
    if not isinstance(gain, SensedGains) or not isinstance(of_gear, SensedGearMemory):
        return _Gear(*known, truth.x)
    sensor = (gain.front, gain.rear)[g]
    rail, rail_yaw = irregularity_in(cell, "lateral", truth.x)
    offset, lever = truth.y_TrAx - rail, sensor.base / 2 * (truth.psi_TrAx - rail_yaw)
    speeds = wheels[0].w, wheels[1].w, truth.xdot
    exact = Signals(offset + lever, offset - lever, truth.psidot_Ax, *speeds, truth.x)
    readings, lines = sense(exact, memory.ticks, g, sensor, of_gear.sensor)
    position = readings.p + CONTROL_PERIOD * sensor.command * readings.v
    commands = [line[:-1] for line in (of_gear.sensor.tau_le, of_gear.sensor.tau_ri)]
    return _Gear(*known, position, sensor, readings, lines, commands)


def _tracks(gears: list[_Gear]) -> list[TrackInputs]:
    """Track and set point at both running gears."""
    tracks = [track_in(gear.cell, gear.position) for gear in gears]
    # heading and curvature at the car body are the mean of those at its gears
    body = [(front + rear) / 2 for front, rear in zip(*tracks, strict=True)][:2]
    result = []
    for gear, track in zip(gears, tracks, strict=True):
        cell, set_point = gear.cell, reference_in(gear.cell, gear.position)
        result.append(unpack(TrackInputs, [*track, *body, cell["dkappa"], *set_point, cell["dddy_ref"]]))
    return result


def _known(gear: _Gear, track: TrackInputs, ticks: ca.SX) -> tuple[States, list, list, Any]:
    """What the controllers of a running gear get, true or estimated: states, adhesion and slip of [left, right] wheel.
    Last, the `FilterState` of the estimation, None without sensors."""
    if not gear.sensor:
        return gear.truth, [wheel.adhesion for wheel in gear.wheels], [wheel.sx for wheel in gear.wheels], None
    estimates, filtered = observers.observe(
        gear.readings, gear.commands, track, ticks, gear.sensor, gear.gain, gear.memory.filter
    )
    heading = track.psi_Tr + estimates.psi_TrAx
    lateral_states = estimates.psidot_Ax, estimates.y_TrAx, estimates.psi_TrAx
    state = States(gear.position, heading, estimates.xdot, *lateral_states)
    return state, estimates.f, estimates.s, filtered


def _cycle(lateral_law: ca.Function, ticks: ca.SX, gear: _Gear, track: TrackInputs, held: ca.SX) -> tuple:
    """Adhesion law, lateral law and integration rule of a running gear. `ticks` counts the cycles since the start,
    `held` is the last torque of a slower controller (N m). Returns torques of [left, right] motor (N m), next
    `GearMemory`, entries of `interface.RECORD` and, with sensors, of `ESTIMATED`, and the margins of this gear."""
    gain, model, old = gear.gain, gear.gain.model, gear.memory
    state, f, s, filtered = _known(gear, track, ticks)
    f_star = gear.cell["force"] / (2 * gain.nominal_load)
    tau_max = gain.drive.limit(state.xdot / model.r_0)
    inputs = AdhesionInputs(f, s, f_star, state.xdot, old.u, gain.nominal_load, tau_max, model.r_0)
    u_d, adhesion, segment = gain.adhesion.base_torque(inputs, old.adhesion)

    xddot = 2 * u_d / (model.r_0 * model.m_x_eff)
    groups = [*pack(state), xddot, held], pack(track), old.lateral, gain.lateral, [*pack(model), tau_max]
    du, following = lateral_law(*(ca.vertcat(*entries) for entries in groups))
    y, y_ref = gear.truth.y_TrAx, reference_in(gear.cell, gear.truth.x)[0]  # at the true position
    margin = gain.limit.lateral - ca.fabs(y), ca.fabs(du) < np.inf
    du *= ca.fmin(ca.fmax(state.xdot / GUIDANCE_FADE, 0), 1)
    *torques, tau_long, du = allocate(u_d, du, tau_max, gain.fixed_share)
    record = [u_d, du, tau_long, f_star, segment, y_ref]
    memory = {"u": u_d, "adhesion": adhesion, "lateral": ca.vertsplit(following)}
    if not gear.sensor:
        return torques, type(old)(**memory), record, [], margin
    lines, readings = [[torque, *line] for torque, line in zip(torques, gear.commands, strict=True)], gear.readings
    memory["sensor"] = SensorMemory(**gear.lines, tau_le=lines[0], tau_ri=lines[1])
    memory["filter"] = observers.advance(filtered, lines, track, gear.sensor, gain)
    y, psi = (readings.y_ahead + readings.y_behind) / 2, (readings.y_ahead - readings.y_behind) / gear.sensor.base
    memory |= {"estimated": state, "read": [y, psi, readings.psidot_Ax]}
    received = [received_torque(line, gear.sensor) for line in lines]
    return received, type(old)(**memory), record, [*pack(state), *f, *s, track.y_ref], margin
