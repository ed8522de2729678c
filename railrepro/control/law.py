"""The control law of the 1 kHz control cycle as one function: measurement, adhesion law, lateral law, integration rule.

Without sensors the controllers get the car's true states; with sensors, the estimates of `railrepro.estimation`. All
gains are run-time inputs, so one compiled object serves every scenario and tuning of one signature. Serves the paper's
Fig. 4 and sections Adhesion Control and Integration Approach.
"""

from __future__ import annotations

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
"""Speed (m/s) below which the differential torque fades in proportion to the speed, to 0 at standstill."""
_SHARE = between(0.0, 1.0, "-")


@dataclass(frozen=True)
class LawGains:
    """Run-time numbers of the law (SI). `LawSignature.Gains` knows the gains of its lateral law by name."""

    lateral: Annotated[list[Scalar], ()]
    adhesion: AdhesionSettings
    fixed_share: Annotated[Scalar, _SHARE, "share of the torque limit reserved for the differential torque"]
    nominal_load: Annotated[Scalar, above(0.0, 1e8, "N"), "load of a wheel at rest"]
    model: ModelInputs
    drive: Drive
    limit: interface.Limits


@dataclass(frozen=True)
class SensedGains(LawGains):
    """`LawGains` with sensors."""

    front: SensorGains
    rear: SensorGains
    filter: observers.FilterGains


@dataclass(frozen=True)
class GearMemory:
    """States of the law of one running gear. `LawSignature.Memory` knows the states of its lateral law by name."""

    u: Annotated[Scalar, "N m", "base torque"]
    adhesion: AdhesionMemory
    lateral: Annotated[list[Scalar], ()]


@dataclass(frozen=True)
class SensedGearMemory(GearMemory):
    """`GearMemory` with sensors: also delay lines, states of the filter, last estimated states and last readings."""

    sensor: SensorMemory
    filter: observers.FilterState
    estimated: States
    read: interface.ReadGear


@dataclass(frozen=True)
class LawMemory:
    """States of the law."""

    ticks: Annotated[Scalar, "ms", "control cycles since the start"]
    front: GearMemory
    rear: GearMemory


@dataclass(frozen=True)
class LawRecords:
    """What is logged in one control cycle."""

    front: interface.Record
    rear: interface.Record


@dataclass(frozen=True)
class SensedRecords(LawRecords):
    """`LawRecords` with sensors: also what the controllers get."""

    front_estimated: Annotated[interface.EstimatedRecord, "front.estimated"]
    rear_estimated: Annotated[interface.EstimatedRecord, "rear.estimated"]


@dataclass(frozen=True)
class LawSignature:
    """Structure of the 1 kHz law of both gears, without values of gains. Equal signatures share compiled code."""

    lateral: lateral.Signature
    sensed: bool = False
    """Whether sensors and filter stand between the car and the controllers."""

    @cached_property
    def Gains(self) -> type[LawGains]:
        """`LawGains`, or `SensedGains` with sensors, whose entries of `lateral` have the names of the lateral law's
        gains."""
        kind = SensedGains if self.sensed else LawGains
        return reannotated(kind, lateral=Annotated[list[Scalar], self.lateral.gains])

    @cached_property
    def Memory(self) -> type[LawMemory]:
        """`LawMemory`. Its fields `front` and `rear` are `GearMemory`, or `SensedGearMemory` with sensors, whose
        entries of `lateral` have the names of the lateral law's states."""
        kind = SensedGearMemory if self.sensed else GearMemory
        gear = reannotated(kind, lateral=Annotated[list[Scalar], self.lateral.memory])
        return reannotated(LawMemory, front=gear, rear=gear)

    @property
    def Records(self) -> type[LawRecords]:
        """`LawRecords`, or `SensedRecords` with sensors."""
        return SensedRecords if self.sensed else LawRecords

    @property
    def memory(self) -> tuple[str, ...]:
        """Names of the states of the law in the order of `Memory`, such as `front.u`."""
        return names(self.Memory)

    @property
    def record(self) -> tuple[str, ...]:
        """Names of the logged columns in the order of `Records`, such as `front.du`; with sensors also
        `front.estimated.y_TrAx`."""
        return names(self.Records)


@dataclass(frozen=True)
class ControlLaw:
    """The 1 kHz law of both gears with its numbers.

    Attributes:
        signature (LawSignature): Structure of the law, argument of `function`.
        gains (ndarray): Run-time numbers in the order of `signature.Gains` (SI).
    """

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
    """Make the 1 kHz law of both gears. InputError if an argument has a wrong type or value, see `lateral.signature`.

    Args:
        vehicle (Vehicle): Vehicle parameters that the controllers assume.
        guidance (LateralLaw, optional): Lateral law; default `ZeroOrderHold`.
        adhesion (AdhesionSettings, optional): Default `AdhesionSettings()`, with sensors those of
            `sensors.loop.adhesion`.
        fixed_share (float): Share of the torque limit reserved for the differential torque (-), see `allocate`.
        sensors (Readings, optional): Sensors and latencies between car and controllers; default none.
        lateral_limit (float): A run ends when |lateral displacement| of a gear exceeds it (m).
        track_end (float): A run ends when the front gear reaches this track coordinate (m).
        stop_speed (float): A run ends when the speed of the front gear falls to it (m/s).
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


@lru_cache
def _shared(of_lateral: lateral.Signature, sensed: bool) -> LawSignature:
    """One object for equal signatures, whose dataclasses are made once."""
    return LawSignature(of_lateral, sensed)


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
    """The 1 kHz law of both gears as a CasADi function of vectors (SI).

    Its inputs are:
    - y: measured quantities in the order of `interface.Measured`;
    - rows: row of the route at the front and at the rear gear, shape (len(COLUMNS), 2);
    - held: last torque of the slower controller of the front and of the rear gear (N m), shape (2,);
    - gains, memory: in the order of `signature.Gains` and `signature.Memory`.

    Its outputs are:
    - command: motor torques (N m) in the order of `WHEELS`, shape (4,);
    - memory_next, record, margins: in the order of `signature.Memory`, `signature.Records` and `interface.Margins`.
    """
    y, measured = symbols(interface.Measured, "y")
    gains, gain = symbols(signature.Gains, "gains")
    old, memory = symbols(signature.Memory, "memory")
    rows, held = ca.SX.sym("rows", len(COLUMNS), len(GEARS)), ca.SX.sym("held", len(GEARS))
    gears = [_gear(g, measured, rows[:, g], gain, memory) for g in range(len(GEARS))]
    lateral_law = ca.Function.deserialize(signature.lateral.text)
    given = zip(gears, _tracks(gears), ca.vertsplit(held), strict=True)
    torques, memories, records, estimated, distances = zip(*(_cycle(lateral_law, *one) for one in given), strict=True)
    command, following = [*torques[0], *torques[1]], signature.Memory(memory.ticks + 1, *memories)
    record = signature.Records(*records, *(estimated if signature.sensed else ()))
    truth, limit = gears[0].truth, gain.limit
    ends = limit.track_end - truth.x, truth.xdot - limit.stop_speed
    margins = interface.Margins(distances[0], distances[1], *ends)
    outputs = {"command": command, "memory_next": pack(following), "record": pack(record), "margins": pack(margins)}
    return ca.Function(
        "control_law",
        [y, rows, held, gains, old],
        [ca.densify(ca.vertcat(*entries)) for entries in outputs.values()],
        ["y", "rows", "held", "gains", "memory"],
        list(outputs),
        {"cse": True},
    )


@dataclass(frozen=True)
class _Sensing:
    """Sensors of a running gear in one control cycle: their run-time numbers, states, readings, next delay lines of the
    readings; control cycles since the start."""

    gain: SensorGains
    memory: SensedGearMemory
    readings: Signals
    lines: dict[str, list]
    ticks: ca.SX

    @property
    def commands(self) -> list[list]:
        """Torques sent to [left, right] wheel before this cycle (N m), newest first."""
        return [line[:-1] for line in (self.memory.sensor.tau_le, self.memory.sensor.tau_ri)]


@dataclass(frozen=True)
class _Gear:
    """A running gear in one control cycle, before the law acts: true states; left and right wheel; row of the route;
    run-time numbers and states of the law; sensors, None without them."""

    truth: States
    wheels: list[interface.MeasuredWheel]
    cell: dict[str, ca.SX]
    gain: LawGains
    memory: GearMemory
    sensing: _Sensing | None

    @property
    def position(self) -> ca.SX:
        """Track coordinate for the controllers (m): with sensors it is predicted to the time when a torque acts."""
        if not self.sensing:
            return self.truth.x
        readings = self.sensing.readings
        return readings.p + CONTROL_PERIOD * self.sensing.gain.command * readings.v


def _gear(g: int, measured: interface.Measured, row: ca.SX, gain: LawGains, memory: LawMemory) -> _Gear:
    """Running gear `g` (0 front, 1 rear) on its `row` of the route."""
    truth, of_gear = States(*pack(getattr(measured, GEARS[g]))), (memory.front, memory.rear)[g]
    wheels, cell = [getattr(measured, wheel) for wheel in WHEELS[2 * g : 2 * g + 2]], named(COLUMNS, row)
    sensing = None
    if isinstance(gain, SensedGains) and isinstance(of_gear, SensedGearMemory):
        sensor = (gain.front, gain.rear)[g]
        read = sense(_exact(truth, wheels, cell, sensor.base), memory.ticks, g, sensor, of_gear.sensor)
        sensing = _Sensing(sensor, of_gear, *read, memory.ticks)
    return _Gear(truth, wheels, cell, gain, of_gear, sensing)


def _exact(truth: States, wheels: list[interface.MeasuredWheel], cell: dict[str, ca.SX], base: ca.SX) -> Signals:
    """What perfect sensors read; `base` is the distance of the two planes of lateral sensors (m)."""
    rail, rail_yaw = irregularity_in(cell, "lateral", truth.x)
    offset = truth.y_TrAx - rail
    lever = base / 2 * (truth.psi_TrAx - rail_yaw)
    left, right = wheels
    return Signals(offset + lever, offset - lever, truth.psidot_Ax, left.w, right.w, truth.xdot, truth.x)


def _tracks(gears: list[_Gear]) -> list[TrackInputs]:
    """Track and set point at both running gears."""
    tracks = [track_in(gear.cell, gear.position) for gear in gears]
    # heading and curvature at the car body are the mean of those at its gears
    body = [(front + rear) / 2 for front, rear in zip(*tracks, strict=True)][:2]
    found = []
    for gear, track in zip(gears, tracks, strict=True):
        cell, set_point = gear.cell, reference_in(gear.cell, gear.position)
        found.append(unpack(TrackInputs, [*track, *body, cell["dkappa"], *set_point, cell["dddy_ref"]]))
    return found


def _known(gear: _Gear, track: TrackInputs) -> tuple[States, list, list, Any]:
    """What the controllers of a running gear get, true or estimated: states; adhesion and slip of [left, right] wheel.
    Last, the `FilterState` of the estimation, None without sensors."""
    if not (sensing := gear.sensing):
        return gear.truth, [wheel.adhesion for wheel in gear.wheels], [wheel.sx for wheel in gear.wheels], None
    found, filtered = observers.observe(
        sensing.readings, sensing.commands, track, sensing.ticks, sensing.gain, gear.gain, sensing.memory.filter
    )
    heading = track.psi_Tr + found.psi_TrAx
    state = States(gear.position, heading, found.xdot, found.psidot_Ax, found.y_TrAx, found.psi_TrAx)
    return state, found.f, found.s, filtered


def _cycle(lateral_law: ca.Function, gear: _Gear, track: TrackInputs, held: ca.SX) -> tuple:
    """Adhesion law, lateral law and integration rule of a running gear. `held` is the last torque of a slower
    controller (N m). Returns torques of [left, right] motor (N m), next `GearMemory`, `Record`, with sensors
    `EstimatedRecord` else None, and `GearMargin`."""
    gain, model, old = gear.gain, gear.gain.model, gear.memory
    state, f, s, filtered = _known(gear, track)
    f_star = gear.cell["force"] / (2 * gain.nominal_load)
    tau_max = gain.drive.limit(state.xdot / model.r_0)
    inputs = AdhesionInputs(f, s, f_star, state.xdot, old.u, gain.nominal_load, tau_max, model.r_0)
    u_d, adhesion, segment = gain.adhesion.base_torque(inputs, old.adhesion)

    xddot = 2 * u_d / (model.r_0 * model.m_x_eff)
    groups = [*pack(state), xddot, held], pack(track), old.lateral, gain.lateral, [*pack(model), tau_max]
    du, following = lateral_law(*(ca.vertcat(*entries) for entries in groups))
    y, y_ref = gear.truth.y_TrAx, reference_in(gear.cell, gear.truth.x)[0]  # at the true position
    margin = interface.GearMargin(gain.limit.lateral - ca.fabs(y), ca.fabs(du) < np.inf)
    du *= ca.fmin(ca.fmax(state.xdot / GUIDANCE_FADE, 0), 1)
    *torques, tau_long, du = allocate(u_d, du, tau_max, gain.fixed_share)
    record = interface.Record(u_d, du, tau_long, f_star, segment, y_ref)
    memory = {"u": u_d, "adhesion": adhesion, "lateral": ca.vertsplit(following)}
    if not (sensing := gear.sensing):
        return torques, type(old)(**memory), record, None, margin
    lines = [[torque, *line] for torque, line in zip(torques, sensing.commands, strict=True)]
    memory["sensor"] = SensorMemory(**sensing.lines, tau_le=lines[0], tau_ri=lines[1])
    memory["filter"] = observers.advance(filtered, lines, track, sensing.gain, gain)
    memory |= {"estimated": state, "read": _read(sensing.readings, sensing.gain.base)}
    estimated = unpack(interface.EstimatedRecord, [*pack(state), *f, *s, track.y_ref])
    received = [received_torque(line, sensing.gain) for line in lines]
    return received, type(old)(**memory), record, estimated, margin


def _read(readings: Signals, base: ca.SX) -> interface.ReadGear:
    """States from readings; `base` is as in `_exact`."""
    ahead, behind = readings.y_ahead, readings.y_behind
    return interface.ReadGear((ahead + behind) / 2, (ahead - behind) / base, readings.psidot_Ax)
