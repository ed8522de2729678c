"""Parameters of the vehicle as frozen, checked dataclasses; their values are in data/vehicle.toml. Serves the paper's
sections Control-Oriented Model and Simulation Environment, which print no values."""

import math
import reprlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from pydantic_core import core_schema

from railrepro import data, paths


@data.table
class Entry:
    """One parameter in a file such as data/vehicle.toml; `symbol` is its name in formulas. `confidence` in its `source`
    is VV read there and reproduced, V read there, D derived, R recalled from the literature, A assumed. `range` is
    "fixed", or [low, high] in the unit of the value, from which robustness studies sample."""

    symbol: str
    value: Any
    unit: str
    source: str
    confidence: Literal["VV", "V", "D", "R", "A"]
    range: Any


@dataclass(frozen=True)
class Parameter(data.Quantity):
    """Unit and permitted range of a number with a source, the annotation of a field: Parameter(low, high, unit) permits
    low < x <= high, with `closed` also x = low. In a file the number is a table, an `Entry`, with this unit; the
    constructor of the dataclass that has the field takes the value alone, as Wheel(radius=0.46, …)."""

    def __get_pydantic_core_schema__(self, source, handler):
        value = super().__get_pydantic_core_schema__(source, handler) if source is float else handler(source)

        def stated(given, entry, info):
            return self._stated(entry(given)) if info.context else given

        content = core_schema.with_info_wrap_validator_function(stated, handler.generate_schema(Entry))
        return core_schema.chain_schema([content, value])

    def _stated(self, entry: Entry):
        """Check the unit and range of an entry and return its value."""
        if entry.unit != self.unit:
            raise ValueError(f"has the unit {entry.unit!r}, {self.unit!r} is needed")
        if entry.range != "fixed" and not self._around(entry.value, entry.range):
            found = f"= {reprlib.repr(entry.value)} with range {reprlib.repr(entry.range)}"
            raise ValueError(f'{found}, "fixed" or [low, high] around the value is needed, each {self.described()}')
        return entry.value

    def _around(self, value, ends) -> bool:
        """Whether `ends` are two permitted numbers around a value."""
        try:
            low, high = ends
            self.check(low)
            self.check(high)
            return low <= value <= high
        except (TypeError, ValueError):
            return False


Mass = Annotated[float, Parameter(100.0, 1e6, "kg")]
Inertia = Annotated[float, Parameter(0.0, 1e8, "kg m2")]
Stiffness = Annotated[float, Parameter(0.0, 1e9, "N/m", closed=True)]
Damping = Annotated[float, Parameter(0.0, 1e8, "N s/m", closed=True)]
AngularStiffness = Annotated[float, Parameter(0.0, 1e9, "N m/rad", closed=True)]
AngularDamping = Annotated[float, Parameter(0.0, 1e8, "N m s/rad", closed=True)]


@data.table
class CarBody:
    """Car body: mass (kg); roll, pitch, yaw inertia about the centre of gravity (kg m2); heights of centre of gravity
    and floor above the rails, distance between the running gears, length (m)."""

    mass: Mass
    inertia_x: Inertia
    inertia_y: Inertia
    inertia_z: Inertia
    cg_height: Annotated[float, Parameter(0.0, 5.0, "m")]
    gear_spacing: Annotated[float, Parameter(1.0, 40.0, "m")]
    floor_height: Annotated[float, Parameter(0.0, 5.0, "m")]
    length: Annotated[float, Parameter(1.0, 60.0, "m")]


@data.table
class Gear:
    """Running gear: a wheel carrier with two wheels. Mass (kg), roll and yaw inertia (kg m2) include the wheels; pitch
    inertia includes their mass, but not their `spin_inertia`. `contact_base` is the lateral distance b of the contacts
    (m), `axle_damping` the torque between the wheels over the difference of their speeds (N m s/rad), 0 for none."""

    mass: Mass
    inertia_x: Inertia
    inertia_y: Inertia
    inertia_z: Inertia
    contact_base: Annotated[float, Parameter(0.5, 3.0, "m")]
    axle_damping: AngularDamping


@data.table
class Wheel:
    """Independently rotating wheel: nominal rolling radius r_0 (m); inertia about the axle, including the rotor of the
    motor, and about a diameter (kg m2); cone angle delta_0 of the control model (rad), which the wheels of the car have
    only with the profile "cone"."""

    radius: Annotated[float, Parameter(0.1, 1.0, "m")]
    spin_inertia: Inertia
    diametral_inertia: Inertia
    cone_angle: Annotated[float, Parameter(0.0, 0.2, "rad", closed=True)]


@data.table
class Suspension:
    """Suspension between the car body and one running gear: stiffness (N/m, N m/rad), damping (N s/m, N m s/rad). On
    each side, a spring with a damper is `half_spacing` (m) off centre and `height` (m) above the rails; it has the
    stiffness k_x and the damping c_x along x, likewise y and z. A traction link acts lengthwise, a torsion bar against
    roll, rods against pitch. Stops act in yaw beyond yaw_stop_angle (rad) and sideways beyond bump_clearance (m)."""

    half_spacing: Annotated[float, Parameter(0.1, 2.0, "m")]
    height: Annotated[float, Parameter(0.0, 3.0, "m")]
    k_x: Stiffness
    c_x: Damping
    k_y: Stiffness
    c_y: Damping
    k_z: Annotated[float, Parameter(0.0, 1e9, "N/m")]
    c_z: Damping
    link_stiffness: Annotated[float, Parameter(0.0, 1e10, "N/m")]
    link_damping: Damping
    antiroll_stiffness: AngularStiffness
    antiroll_damping: AngularDamping
    pitch_stiffness: Annotated[float, Parameter(0.0, 1e9, "N m/rad")]
    pitch_damping: AngularDamping
    yaw_stop_angle: Annotated[float, Parameter(0.0, 0.5, "rad")]
    yaw_stop_stiffness: Annotated[float, Parameter(0.0, 1e10, "N m/rad", closed=True)]
    bump_clearance: Annotated[float, Parameter(0.0, 1.0, "m")]
    bump_stiffness: Stiffness

    @property
    def yaw_stiffness(self) -> float:
        """Yaw stiffness k_sz between the car body and one running gear (N m/rad)."""
        return 2 * self.k_x * self.half_spacing**2

    @property
    def yaw_damping(self) -> float:
        """Yaw damping k_dz between the car body and one running gear (N m s/rad)."""
        return 2 * self.c_x * self.half_spacing**2

    @property
    def roll_stiffness(self) -> float:
        """Roll stiffness k_sx between the car body and one running gear (N m/rad)."""
        return 2 * self.k_z * self.half_spacing**2 + self.antiroll_stiffness

    @property
    def roll_damping(self) -> float:
        """Roll damping k_dx between the car body and one running gear (N m s/rad)."""
        return 2 * self.c_z * self.half_spacing**2 + self.antiroll_damping


@data.table
class Drive:
    """Motor of a wheel: torque limit for both signs (N m) and time constant of the torque (s)."""

    torque_limit: Annotated[float, Parameter(0.0, 1e5, "N m")]
    lag: Annotated[float, Parameter(0.0, 1.0, "s")]

    def limit(self, wheel_speed):
        """Torque limit for both signs (N m) at a wheel speed (rad/s; number, array or SX), here the same at all speeds.
        Car and controllers call this method, so a limit that depends on speed needs a change only here."""
        return self.torque_limit


@data.table
class WheelRail:
    """Contact of wheels with a `profile`, "cone" or "s1002", and rails of one material with two moduli (Pa) and
    Poisson's ratio (-). Contact ellipses are tabulated for the normal force `nominal_load` (N). At a penetration q the
    normal force is k q^1.5 (1 + d dq/dt) with k = `normal_stiffness` (N/m^1.5), d = `normal_damping` (s/m). Creepage is
    sliding speed / sqrt(v^2 + rest_speed^2), which is finite at standstill (speeds in m/s)."""

    young: Annotated[float, Parameter(1e9, 1e12, "Pa")]
    poisson: Annotated[float, Parameter(0.0, 0.5, "-", closed=True)]
    shear_modulus: Annotated[float, Parameter(1e9, 1e12, "Pa")]
    nominal_load: Annotated[float, Parameter(0.0, 1e6, "N")]
    normal_stiffness: Annotated[float, Parameter(0.0, 1e13, "N/m^1.5")]
    normal_damping: Annotated[float, Parameter(0.0, 1e3, "s/m", closed=True)]
    rest_speed: Annotated[float, Parameter(0.0, 1.0, "m/s")]
    profile: Annotated[str, Field(pattern="^(cone|s1002)$"), Parameter(0.0, 0.0, "-")]


@data.table
class AdhesionSet:
    """Adhesion set: parameters of Polach's creep law for one state of the rail. The reduction factors k_a in the area
    of adhesion and k_s in that of slip (-) make the creep stiffness at zero creepage (k_a + k_s)/2 times Kalker's; a
    k_s above k_a counts as k_a. The friction coefficient is mu0 ((1 - a_ratio) exp(-b_decay w) + a_ratio) at a slip
    speed w (m/s)."""

    k_a: Annotated[float, Parameter(0.0, 1.0, "-")]
    k_s: Annotated[float, Parameter(0.0, 1.0, "-")]
    mu0: Annotated[float, Parameter(0.0, 1.0, "-", closed=True)]
    a_ratio: Annotated[float, Parameter(0.0, 1.0, "-", closed=True)]
    b_decay: Annotated[float, Parameter(0.0, 10.0, "s/m", closed=True)]


@data.table
class Environment:
    """Surroundings of the car: gravitational acceleration (m/s2)."""

    gravity: Annotated[float, Parameter(0.0, 20.0, "m/s2")]


@data.table
class Vehicle:
    """All parameters of the car. All running gears, wheels and motors are alike. `adhesion` maps names to parameters of
    the creep law for a state of the rail; data/vehicle.toml has "dry", "poor", "very_poor" and "wet". InputError unless
    the gear's roll and yaw inertia exceed those of its wheels."""

    body: CarBody
    gear: Gear
    wheel: Wheel
    suspension: Suspension
    drive: Drive
    contact: WheelRail
    adhesion: Annotated[dict[str, AdhesionSet], AfterValidator(lambda sets: dict(sorted(sets.items())))] = field(
        hash=False
    )
    environment: Environment

    def __post_init__(self) -> None:
        for name in ("inertia_x", "inertia_z"):
            total, wheels = getattr(self.gear, name), 2 * self.wheel.diametral_inertia
            if total <= wheels:
                needed = f"more than the {wheels:g} kg m2 of the wheels, which it includes, is needed"
                raise ValueError(f"gear.{name} = {total:g} kg m2, {needed}")

    @property
    def gravity(self) -> float:
        """Gravitational acceleration (m/s2)."""
        return self.environment.gravity

    @property
    def gamma(self) -> float:
        """Roll angle of the axle per lateral displacement on cones, Gamma (rad/m). Source: eqs. (10), (11)."""
        return self.roll_per_shift(math.tan(self.wheel.cone_angle))

    def roll_per_shift(self, slope: float) -> float:
        """Roll angle of the axle per lateral displacement (rad/m) at the tangent `slope` of the contact angle (-)."""
        return slope / (self.gear.contact_base / 2 - self.wheel.radius * slope)

    @property
    def longitudinal_mass(self) -> float:
        """Mass of a running gear with half the car body, m_x = m + m_CB/2 (kg)."""
        return self.gear.mass + self.body.mass / 2

    @property
    def wheel_load(self) -> float:
        """Vertical force of one wheel on its rail at rest on straight level track (N)."""
        return self.longitudinal_mass * self.gravity / 2

    @property
    def effective_longitudinal_mass(self) -> float:
        """Longitudinal mass with the spin inertia of the two wheels of a running gear, m_x + 2 J_Wy/r_0^2 (kg)."""
        return self.longitudinal_mass + 2 * self.wheel.spin_inertia / self.wheel.radius**2

    @property
    def effective_yaw_inertia(self) -> float:
        """Yaw inertia J_eff = J_z + J_Wy b^2/(2 r_0^2) of a running gear with counter-rotating wheels (kg m2)."""
        return self.gear.inertia_z + self.wheel.spin_inertia * self.gear.contact_base**2 / 2 / self.wheel.radius**2


def load_vehicle(path: Path | str | None = None, **overrides) -> Vehicle:
    """Read the parameters of a vehicle in a TOML file, by default data/vehicle.toml. InputError for a wrong file, key
    or value. `overrides` replace values of the file (SI) by dotted key, as in `load_vehicle(**{"wheel.radius": 0.43,
    "adhesion.poor.mu0": 0.12})`. A warning tells that "wheel.cone_angle" does not change wheels with another profile
    than "cone"."""
    vehicle = loaded(Vehicle, data.location(path, paths.source("data/vehicle.toml")), overrides)[0]
    if "wheel.cone_angle" in overrides and vehicle.contact.profile != "cone":
        reason = f"the wheels of the car have the profile {vehicle.contact.profile}"
        warnings.warn(f"wheel.cone_angle changes the control model only: {reason}", stacklevel=2)
    return vehicle


def loaded(kind: type, file: Path, overrides: dict) -> tuple[Any, dict[str, dict]]:
    """Read a file of parameters with unit and source (`Entry`). Returns the values as an instance of the `data.table`
    class `kind`, and a dict: dotted key such as "wheel.radius" -> its entry as a dict. `overrides`, dotted key -> value
    (SI), replace values of the file; their range becomes "fixed". InputError for a wrong file, key or value."""
    content = data.read(file)
    entries = dict(_entries(content))
    for key, value in overrides.items():
        if key not in entries:
            raise data.InputError(f"override {key!r} is not a key of {file.name}; there are {', '.join(entries)}")
        entries[key].update(value=value, range="fixed")
    return data.build(kind, content, file.name), entries


def _entries(table: Any, key: str = "") -> Iterator[tuple[str, dict]]:
    """Dotted keys and entries in a table and its subtables. `data.build` refuses what is neither."""
    if isinstance(table, dict) and "value" in table:
        yield key, table
    elif isinstance(table, dict):
        for name, part in table.items():
            yield from _entries(part, f"{key}.{name}".lstrip("."))


def sample_ranges() -> dict[str, tuple[float, float]]:
    """Ranges for robustness studies in data/vehicle.toml: dotted key -> (low, high) (SI), without fixed parameters."""
    entries = loaded(Vehicle, paths.source("data/vehicle.toml"), {})[1]
    return {key: tuple(entry["range"]) for key, entry in entries.items() if entry["range"] != "fixed"}
