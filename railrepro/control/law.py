"""The control law of the 1 kHz control cycle as one function: measurement, adhesion law, lateral law, integration rule.

Without sensors the controllers get the car's true states; with sensors, the estimates of `railrepro.estimation`. All
gains are run-time inputs, so one compiled object serves every scenario and tuning of one signature. Serves the paper's
Fig. 4 and sections Adhesion Control and Integration Approach.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Annotated, Any

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import interface, lateral
from railrepro.control.adhesion import AdhesionInputs, AdhesionMemory, AdhesionSettings
from railrepro.control.allocation import allocate
from railrepro.data import between, require
from railrepro.estimation import observers
from railrepro.estimation.sensors import Readings, SensorGains, SensorMemory, Signals, received_torque, sense
from railrepro.model.control_model import States
from railrepro.quantities import GEARS, WHEELS, group, listed, named, names, pack, symbols, unpack
from railrepro.track.route import COLUMNS, irregularity_in, reference_in, track_in
from railrepro.vehicle.parameters import Drive, Vehicle

GUIDANCE_FADE = 1.0
"""Speed (m/s) below which the differential torque fades in proportion to the speed, to 0 at standstill."""


@dataclass(frozen=True)
class LawSignature:
    """Structure of the 1 kHz law of both gears, without values of gains. Equal signatures share compiled code."""

    lateral: lateral.Signature
    sensed: bool = False
    """Whether sensors and filter stand between the car and the controllers."""

    @cached_property
    def Gains(self) -> Any:
        """Dataclass type that names all run-time numbers of the law (SI).

        Fields: `lateral`, `adhesion`, gains of the two laws; `fixed_share` (-), see `allocate`; `nominal_load` of a
        wheel (N); `model`, `drive`, parameters of the vehicle; `limit`, displacement, coordinate and speed at which a
        run ends. A law that reads sensors also has `front` and `rear`, the errors of each gear's sensors, and `filter`,
        the gains of the state estimation.
        """
        laws = {"lateral": listed(self.lateral.gains), "adhesion": AdhesionSettings}
        car = {"model": interface.Model, "drive": Drive, "limit": interface.Limits}
        sensed = {"front": SensorGains, "rear": SensorGains, "filter": observers.FilterGains} if self.sensed else {}
        return group("Gains", laws, "fixed_share -, nominal_load N", car, sensed)

    @cached_property
    def Memory(self) -> Any:
        """Dataclass type of the states of the law.

        Its fields are `ticks` (cycles since the start), `front` and `rear`. Each gear has base torque `u` (N m),
        `adhesion` and `lateral` (states of both laws). With sensors it also has `sensor` (delay lines), `filter`
        (filter states), `estimated` and `read` (last estimated states and readings).
        """
        laws = {"adhesion": AdhesionMemory, "lateral": listed(self.lateral.memory)}
        sensed = {
            "sensor": SensorMemory,
            "filter": observers.FilterState,
            "estimated": States,
            "read": interface.ReadGear,
        }
        gear = group("GearMemory", "u N m", laws, sensed if self.sensed else {})
        return group("Memory", "ticks ms", dict.fromkeys(GEARS, gear))

    @cached_property
    def Records(self) -> Any:
        """Dataclass type of what is logged in one control cycle. Its fields `front` and `rear` are `interface.Record`.
        With sensors `front_estimated` and `rear_estimated` are `interface.EstimatedRecord`."""
        shown = {f"{gear}_estimated": Annotated[interface.EstimatedRecord, f"{gear}.estimated"] for gear in GEARS}
        return group("Records", dict.fromkeys(GEARS, interface.Record), shown if self.sensed else {})

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
    require("fixed_share", fixed_share, between(0.0, 1.0))
    if sensors is not None:
        require("sensors", sensors, Readings)
    if adhesion is None:
        adhesion = AdhesionSettings(**({} if sensors is None else vars(sensors.loop.adhesion)))
    require("adhesion", adhesion, AdhesionSettings)
    law = guidance or lateral.ZeroOrderHold()
    signature = _shared(lateral.signature(law), sensors is not None)
    gains = {
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


def _model(vehicle: Vehicle) -> Any:
    """Numbers of `interface.Model`."""
    return interface.Model(
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


def _gear(g: int, sensed: bool, measured: Any, cell: dict[str, ca.SX], gain: Any, memory: Any) -> SimpleNamespace:
    """Quantities of gear `g` (0 front, 1 rear): `truth`, `wheels`, `memory`, `cell`, `position` (m) for its
    controllers, which with sensors is predicted to the time when a torque acts; with sensors also `sensor`, `readings`,
    `lines`, `ticks`."""
    truth = States(*pack(getattr(measured, GEARS[g])))
    left, right = wheels = [getattr(measured, wheel) for wheel in WHEELS[2 * g : 2 * g + 2]]
    of_gear = {"truth": truth, "wheels": wheels, "memory": getattr(memory, GEARS[g]), "cell": cell, "gain": gain}
    if not sensed:
        return SimpleNamespace(**of_gear, position=truth.x)
    sensor = getattr(gain, GEARS[g])
    rail, rail_yaw = irregularity_in(cell, "lateral", truth.x)
    offset = truth.y_TrAx - rail
    lever = sensor.base / 2 * (truth.psi_TrAx - rail_yaw)
    exact = Signals(offset + lever, offset - lever, truth.psidot_Ax, left.w, right.w, truth.xdot, truth.x)
    readings, lines = sense(exact, memory.ticks, g, sensor, of_gear["memory"].sensor)
    position = readings.p + CONTROL_PERIOD * sensor.command * readings.v
    return SimpleNamespace(
        **of_gear, position=position, sensor=sensor, readings=readings, lines=lines, ticks=memory.ticks
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
    cells = [named(COLUMNS, rows[:, g]) for g in range(len(GEARS))]
    gears = [_gear(g, signature.sensed, measured, cell, gain, memory) for g, cell in enumerate(cells)]
    given = zip(gears, _tracks(gears), ca.vertsplit(held), strict=True)
    results = [_cycle(signature, *of_gear) for of_gear in given]
    command = [torque for of_gear in results for torque in of_gear.torques]
    following = signature.Memory(memory.ticks + 1, *(of_gear.memory for of_gear in results))
    estimated = [of_gear.estimated for of_gear in results if signature.sensed]
    record = signature.Records(*(of_gear.record for of_gear in results), *estimated)
    truth, limit = gears[0].truth, gain.limit
    margins = interface.Margins(
        *(of_gear.margin for of_gear in results), limit.track_end - truth.x, truth.xdot - limit.stop_speed
    )
    outputs = {"command": command, "memory_next": pack(following), "record": pack(record), "margins": pack(margins)}
    return ca.Function(
        "control_law",
        [y, rows, held, gains, old],
        [ca.densify(ca.vertcat(*entries)) for entries in outputs.values()],
        ["y", "rows", "held", "gains", "memory"],
        list(outputs),
        {"cse": True},
    )


def _tracks(gears: list[SimpleNamespace]) -> list:
    """Track and set point at both gears, see `lateral.ROAD`."""
    tracks = [track_in(gear.cell, gear.position) for gear in gears]
    # heading and curvature at the car body are the mean of those at its gears
    body = [(front + rear) / 2 for front, rear in zip(*tracks, strict=True)][:2]
    return [
        interface.Track(
            *track, *body, gear.cell["dkappa"], *reference_in(gear.cell, gear.position), gear.cell["dddy_ref"]
        )
        for gear, track in zip(gears, tracks, strict=True)
    ]


def _cycle(signature: LawSignature, gear: SimpleNamespace, track: Any, held: ca.SX) -> SimpleNamespace:
    """What a gear of `_gear` does at its track: `torques`, next `memory`, `record`, `estimated` (with sensors) and
    `margin`."""
    gain, model, old, estimated = gear.gain, gear.gain.model, gear.memory, None
    state, f, s = gear.truth, [wheel.adhesion for wheel in gear.wheels], [wheel.sx for wheel in gear.wheels]
    if signature.sensed:
        sent = old.sensor.tau_le, old.sensor.tau_ri
        past = [line[:-1] for line in sent]
        found, filtered = observers.observe(gear.readings, past, track, gear.ticks, gear.sensor, gain, old.filter)
        heading, f, s = track.psi_Tr + found.psi_TrAx, found.f, found.s
        state = States(gear.position, heading, found.xdot, found.psidot_Ax, found.y_TrAx, found.psi_TrAx)
        estimated = unpack(interface.EstimatedRecord, [*pack(state), *f, *s, track.y_ref])
    f_star = gear.cell["force"] / (2 * gain.nominal_load)
    tau_max = gain.drive.limit(state.xdot / model.r_0)
    inputs = AdhesionInputs(f, s, f_star, state.xdot, old.u, gain.nominal_load, tau_max, model.r_0)
    u_d, adhesion, segment = gain.adhesion.base_torque(inputs, old.adhesion)

    xddot = 2 * u_d / (model.r_0 * model.m_x_eff)
    groups = [*pack(state), xddot, held], pack(track), old.lateral, gain.lateral, [*pack(model), tau_max]
    lateral_law = ca.Function.deserialize(signature.lateral.text)
    du, following = lateral_law(*(ca.vertcat(*entries) for entries in groups))
    y, y_ref = gear.truth.y_TrAx, reference_in(gear.cell, gear.truth.x)[0]  # at the true position
    margin = interface.GearMargin(gain.limit.lateral - ca.fabs(y), ca.fabs(du) < np.inf)
    du *= ca.fmin(ca.fmax(state.xdot / GUIDANCE_FADE, 0), 1)
    *torques, tau_long, du = allocate(u_d, du, tau_max, gain.fixed_share)
    stored = {"u": u_d, "adhesion": adhesion, "lateral": ca.vertsplit(following)}
    if signature.sensed:
        lines = [[torque, *line] for torque, line in zip(torques, past, strict=True)]
        torques = [received_torque(line, gear.sensor) for line in lines]
        stored["sensor"] = SensorMemory(**gear.lines, tau_le=lines[0], tau_ri=lines[1])
        stored["filter"] = observers.advance(filtered, lines, track, gear.sensor, gain)
        ahead, behind = gear.readings.y_ahead, gear.readings.y_behind
        read = (ahead + behind) / 2, (ahead - behind) / gear.sensor.base, gear.readings.psidot_Ax
        stored |= {"estimated": state, "read": interface.ReadGear(*read)}
    record = interface.Record(u_d, du, tau_long, f_star, segment, y_ref)
    kept = type(old)(**stored)
    return SimpleNamespace(torques=torques, memory=kept, record=record, estimated=estimated, margin=margin)
