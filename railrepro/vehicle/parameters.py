"""Vehicle data as frozen, validated dataclasses; the numbers live in data/vehicle.toml only. Serves the paper's
sections Control-Oriented Model and Simulation Environment, which print none of them."""

from __future__ import annotations

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
from railrepro.data import InputError


@data.table
class Entry:
    """Table of one parameter in a file such as data/vehicle.toml; `symbol` is its name in formulas.

    `confidence`: VV read in the source and reproduced, V read there, D derived, R recalled from the literature, A
    assumed. `range`: "fixed", or [low, high] in the unit of the value, from which robustness studies sample.
    """

    symbol: str
    value: Any
    unit: str
    source: str
    confidence: Literal["VV", "V", "D", "R", "A"]
    range: Any


@dataclass(frozen=True)
class Parameter(data.Quantity):
    """Unit and permitted range of a field whose value stands in a file as an `Entry` with the same unit. A constructor
    takes the value itself."""

    def __get_pydantic_core_schema__(self, source, handler):
        value = super().__get_pydantic_core_schema__(source, handler) if source is float else handler(source)

        def stated(given, entry, info):
            return self._stated(entry(given)) if info.context else given

        return core_schema.chain_schema(
            [core_schema.with_info_wrap_validator_function(stated, handler.generate_schema(Entry)), value]
        )

    def _stated(self, entry: Entry):
        if entry.unit != self.unit:
            raise ValueError(f"has the unit {entry.unit!r}, {self.unit!r} is needed")
        if entry.range != "fixed" and not self._around(entry.value, entry.range):
            raise ValueError(
                f'= {reprlib.repr(entry.value)} with range {reprlib.repr(entry.range)}, "fixed" or [low, high] around '
                f"the value is needed, each {self.described()}"
            )
        return entry.value

    def _around(self, value, ends) -> bool:
        """Whether `ends` are two permitted numbers around a value: studies sample up to both."""
        try:
            low, high = ends
            self.check(low)
            self.check(high)
            return low <= value <= high
        except (TypeError, ValueError):
            return False


def _from_zero(high: float, unit: str) -> Parameter:
    return Parameter(0.0, high, unit, closed=True)


Mass = Annotated[float, Parameter(100.0, 1e6, "kg")]
Inertia = Annotated[float, Parameter(0.0, 1e8, "kg m2")]
Stiffness = Annotated[float, _from_zero(1e9, "N/m")]
Damping = Annotated[float, _from_zero(1e8, "N s/m")]
AngularStiffness = Annotated[float, _from_zero(1e9, "N m/rad")]
AngularDamping = Annotated[float, _from_zero(1e8, "N m s/rad")]


@data.table
class CarBody:
    """Data of the car body.

    Attributes:
        mass, inertia_x, inertia_y, inertia_z: Mass (kg); roll, pitch, yaw inertia about the centre of gravity (kg m2).
        cg_height, floor_height: Height of centre of gravity and of floor above the top of the rails (m).
        gear_spacing, length: Distance between the two running gears; length of the body (m).
    """

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
    """Data of a running gear: a wheel carrier with two wheels.

    Attributes:
        mass, inertia_x, inertia_z: Mass (kg), roll and yaw inertia (kg m2), all including the wheels.
        inertia_y: Pitch inertia (kg m2), including the mass of the wheels but not their `spin_inertia`.
        contact_base: Lateral distance b of the two contacts (m).
        axle_damping: Torque between the wheels over the difference of their speeds (N m s/rad); 0: independent wheels.
    """

    mass: Mass
    inertia_x: Inertia
    inertia_y: Inertia
    inertia_z: Inertia
    contact_base: Annotated[float, Parameter(0.5, 3.0, "m")]
    axle_damping: Annotated[float, _from_zero(1e8, "N m s/rad")]


@data.table
class Wheel:
    """Data of one independently rotating wheel with its motor.

    Attributes:
        radius: Nominal rolling radius r_0 (m).
        spin_inertia, diametral_inertia: Inertia about the axle, including the rotor, and about a diameter (kg m2).
        cone_angle: Cone angle delta_0 in the control model (rad); that of the car's wheels only for the profile "cone".
    """

    radius: Annotated[float, Parameter(0.1, 1.0, "m")]
    spin_inertia: Inertia
    diametral_inertia: Inertia
    cone_angle: Annotated[float, _from_zero(0.2, "rad")]


@data.table
class Suspension:
    """Suspension between the car body and one running gear: stiffness (N/m, N m/rad), damping (N s/m, N m s/rad).

    A spring with a damper stands `half_spacing` (m) to each side, `height` (m) above the rails; each has the stiffness
    k_x and the damping c_x along x, likewise y and z. A traction link acts lengthwise, a torsion bar against roll, rods
    against pitch under motor torque. Stops act in yaw beyond yaw_stop_angle (rad) and sideways beyond bump_clearance
    (m).
    """

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
    yaw_stop_stiffness: Annotated[float, _from_zero(1e10, "N m/rad")]
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
    """Data of the motor of a wheel: `torque_limit` for both signs (N m); `lag`, time constant of the torque (s)."""

    torque_limit: Annotated[float, Parameter(0.0, 1e5, "N m")]
    lag: Annotated[float, Parameter(0.0, 1.0, "s")]

    def limit(self, wheel_speed):
        """Torque limit for both signs (N m) at a wheel speed (rad/s): at present `torque_limit` at any speed. The speed
        is a number, array or SX. Car and controllers ask here, so that a limit that depends on speed is stated once."""
        return self.torque_limit


@data.table
class WheelRail:
    """Data of the wheel-rail contact.

    Attributes:
        young, shear_modulus, poisson: Moduli (Pa) and Poisson's ratio (-) of the material.
        nominal_load: Normal force at which contact ellipses are tabulated (N).
        normal_stiffness, normal_damping: k (N/m^1.5) and d (s/m) of the normal force k q^1.5 (1 + d dq/dt) at a
            penetration q.
        rest_speed: Creepages are sliding speeds over sqrt(v^2 + rest_speed^2), finite also at standstill (m/s).
        profile: Wheel profile, "cone" or "s1002".
    """

    young: Annotated[float, Parameter(1e9, 1e12, "Pa")]
    poisson: Annotated[float, _from_zero(0.5, "-")]
    shear_modulus: Annotated[float, Parameter(1e9, 1e12, "Pa")]
    nominal_load: Annotated[float, Parameter(0.0, 1e6, "N")]
    normal_stiffness: Annotated[float, Parameter(0.0, 1e13, "N/m^1.5")]
    normal_damping: Annotated[float, _from_zero(1e3, "s/m")]
    rest_speed: Annotated[float, Parameter(0.0, 1.0, "m/s")]
    profile: Annotated[str, Field(pattern="^(cone|s1002)$"), Parameter(0.0, 0.0, "-")]


@data.table
class AdhesionSet:
    """Adhesion set: parameters of Polach's creep law for one state of the rail.

    Attributes:
        k_a, k_s: Reduction factors in the areas of adhesion and of slip (-); a k_s above k_a counts as k_a. The creep
            stiffness at rest is (k_a + k_s)/2 of Kalker's.
        mu0, a_ratio, b_decay: Friction (-) is mu0 ((1 - a_ratio) exp(-b_decay w) + a_ratio) at a slip speed w (m/s).
    """

    k_a: Annotated[float, Parameter(0.0, 1.0, "-")]
    k_s: Annotated[float, Parameter(0.0, 1.0, "-")]
    mu0: Annotated[float, _from_zero(1.0, "-")]
    a_ratio: Annotated[float, _from_zero(1.0, "-")]
    b_decay: Annotated[float, _from_zero(10.0, "s/m")]


@data.table
class Environment:
    """Data of the surroundings: `gravity`, the gravitational acceleration (m/s2)."""

    gravity: Annotated[float, Parameter(0.0, 20.0, "m/s2")]


@data.table
class Vehicle:
    """All data of the car. Both running gears are alike, and so are the wheels and the motors. `adhesion` is a dict of
    adhesion sets by name; data/vehicle.toml has "dry", "poor", "very_poor" and "wet"."""

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
            whole, wheels = getattr(self.gear, name), 2 * self.wheel.diametral_inertia
            if whole <= wheels:
                raise ValueError(
                    f"gear.{name} = {whole:g} kg m2 contains those of the wheels, more than {wheels:g} kg m2 is needed"
                )

    @property
    def gravity(self) -> float:
        """Gravitational acceleration (m/s2)."""
        return self.environment.gravity

    @property
    def gamma(self) -> float:
        """Roll angle of the axle per lateral displacement on cones, Gamma (rad/m). Source: paper, eqs. (10), (11)."""
        return self.roll_per_shift(math.tan(self.wheel.cone_angle))

    def roll_per_shift(self, slope: float) -> float:
        """Roll angle of the axle per lateral displacement (rad/m). `slope` (-) is the tangent of the contact angle."""
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
    """Read and check vehicle data. InputError for a wrong file, key or value.

    Args:
        path (path, optional): A TOML file like data/vehicle.toml, the default.
        overrides: Values (SI) that replace those of the file, by dotted key, as in `load_vehicle(**{"wheel.radius":
            0.43, "adhesion.poor.mu0": 0.12})`.
    """
    vehicle = loaded(Vehicle, data.location(path, paths.source("data/vehicle.toml")), overrides)[0]
    if "wheel.cone_angle" in overrides and vehicle.contact.profile != "cone":
        warnings.warn(
            "wheel.cone_angle changes the control model only: the wheels of the car are no cones", stacklevel=2
        )
    return vehicle


def loaded(kind: type, file: Path, overrides: dict) -> tuple[Any, dict[str, dict]]:
    """Read a file of `Entry` tables. Returns a pair: instance of the `data.table` class `kind`; dict of all entries.

    The dict maps a dotted key such as "wheel.radius" to its `Entry` as a dict. `overrides` replace values of the file
    (SI) by dotted key; the range of such a parameter becomes "fixed". InputError for a wrong file, key or value.
    """
    content = data.read(file)
    entries = dict(_entries(content))
    for key, value in overrides.items():
        if key not in entries:
            raise InputError(f"override {key!r} is not a key of {file.name}; there are {', '.join(entries)}")
        entries[key].update(value=value, range="fixed")
    return data.build(kind, content, file.name), entries


def _entries(table: Any, key: str = "") -> Iterator[tuple[str, dict]]:
    """Entries of a table and of those in it, by dotted key; what is no table is left to `data.build`."""
    if isinstance(table, dict) and "value" in table:
        yield key, table
    elif isinstance(table, dict):
        for name, part in table.items():
            yield from _entries(part, f"{key}.{name}".lstrip("."))


def sample_ranges() -> dict[str, tuple[float, float]]:
    """Ranges of the parameters in data/vehicle.toml that are not fixed, as a dict: dotted key -> (low, high) (SI)."""
    entries = loaded(Vehicle, paths.source("data/vehicle.toml"), {})[1]
    return {key: tuple(entry["range"]) for key, entry in entries.items() if entry["range"] != "fixed"}
