"""Vehicle data as frozen, validated dataclasses; the numbers live in data/vehicle.toml only.

Serves the paper's sections Control-Oriented Model and Simulation Environment, which print none of them.
"""

from __future__ import annotations

import math
import reprlib
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from pydantic_core import core_schema

from railrepro import data, paths
from railrepro.data import InputError


@data.table
class Entry:
    """Table of one parameter in a file such as data/vehicle.toml: symbol in formulas, value, unit and source.

    `confidence` is VV read in the source and reproduced, V read there, D derived, R recalled from the literature, A
    assumed; `range` is "fixed" or [low, high] around the value, in its unit: what robustness studies sample.
    """

    symbol: str
    value: Any
    unit: str
    source: str
    confidence: Literal["VV", "V", "D", "R", "A"]
    range: Any


@dataclass(frozen=True)
class Parameter(data.Quantity):
    """Unit and permitted range of a field whose value a file gives as an `Entry` with the same unit."""

    def __get_pydantic_core_schema__(self, source, handler):
        value = super().__get_pydantic_core_schema__(source, handler) if source is float else handler(source)
        stated = core_schema.no_info_plain_validator_function(self._stated)
        return core_schema.chain_schema([handler.generate_schema(Entry), stated, value])

    def _stated(self, entry: Entry):
        if entry.unit != self.unit:
            raise ValueError(f"has the unit {entry.unit!r}, {self.unit!r} is needed")
        numbers = [*entry.range, entry.value] if isinstance(entry.range, list) else []
        around = len(numbers) == 3 and all(map(data.is_number, numbers)) and numbers[0] <= numbers[2] <= numbers[1]
        if entry.range != "fixed" and not around:
            raise ValueError(
                f'= {reprlib.repr(entry.value)} with range {reprlib.repr(entry.range)}, "fixed" or numbers [low, high] '
                "around the value are needed"
            )
        return entry.value


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
    """Car body: mass (kg), inertia_x, inertia_y, inertia_z in roll, pitch and yaw about its centre of gravity (kg m2).

    cg_height and floor_height are above the top of the rails, gear_spacing lies between the two running gears, length
    is that of the body (all in m).
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
    """Running gear, a wheel carrier with two wheels: mass (kg), inertia (kg m2), contact_base, axle_damping.

    mass, inertia_x (roll) and inertia_z (yaw) contain the wheels, inertia_y (pitch) leaves out their spin_inertia.
    contact_base is the lateral distance b of the two contacts (m), axle_damping the torque between the wheels over the
    difference of their speeds (N m s/rad), 0 for independent wheels.
    """

    mass: Mass
    inertia_x: Inertia
    inertia_y: Inertia
    inertia_z: Inertia
    contact_base: Annotated[float, Parameter(0.5, 3.0, "m")]
    axle_damping: Annotated[float, _from_zero(1e8, "N m s/rad")]


@data.table
class Wheel:
    """One independently rotating wheel with its motor: nominal rolling radius r_0 (m), moments of inertia (kg m2).

    spin_inertia, about the axle, contains the rotor of the motor; diametral_inertia is about a diameter. cone_angle
    delta_0 (rad) is that of the control model, and of the car's wheels only where the profile is "cone".
    """

    radius: Annotated[float, Parameter(0.1, 1.0, "m")]
    spin_inertia: Inertia
    diametral_inertia: Inertia
    cone_angle: Annotated[float, _from_zero(0.2, "rad")]


@data.table
class Suspension:
    """Suspension of the car body on a running gear: lengths (m), stiffness (N/m, N m/rad), damping (N s/m, N m s/rad).

    Two springs with dampers at half_spacing to each side and at a height above the rails, each with k_x, c_x along x,
    likewise y and z; a longitudinal traction link, a torsion bar against roll, rods against pitch under motor torque.
    Stops in yaw beyond yaw_stop_angle (rad) and in lateral deflection beyond bump_clearance (m), to either side.
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
    """Motor of one wheel: torque_limit, of either sign (N m), and lag, the time constant of its torque (s)."""

    torque_limit: Annotated[float, Parameter(0.0, 1e5, "N m")]
    lag: Annotated[float, Parameter(0.0, 1.0, "s")]

    def limit(self, wheel_speed):
        """Torque limit of either sign (N m) at a wheel speed (rad/s; number, array or SX): always `torque_limit`.

        Car and controllers ask here, so that a limit that depends on speed is stated once.
        """
        return self.torque_limit


@data.table
class WheelRail:
    """Wheel-rail contact: young, shear_modulus (Pa), poisson (-) of the material; wheel profile "cone" or "s1002".

    The normal force is k q^1.5 (1 + d dq/dt) at a penetration q (m), with k normal_stiffness (N/m^1.5) and d
    normal_damping (s/m). Contact ellipses are tabulated at nominal_load (N). Creepages are sliding speeds over
    sqrt(v^2 + rest_speed^2) (m/s), so that they are finite at standstill.
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
    """Polach's creep law: reduction factors k_a, k_s (-) in the areas of adhesion and slip, and falling friction.

    Friction at a slip speed w (m/s) is mu0 ((1 - a_ratio) exp(-b_decay w) + a_ratio), with b_decay in s/m. Creep
    stiffness at rest is (k_a + k_s)/2 of Kalker's; a k_s above k_a counts as k_a.
    """

    k_a: Annotated[float, Parameter(0.0, 1.0, "-")]
    k_s: Annotated[float, Parameter(0.0, 1.0, "-")]
    mu0: Annotated[float, _from_zero(1.0, "-")]
    a_ratio: Annotated[float, _from_zero(1.0, "-")]
    b_decay: Annotated[float, _from_zero(10.0, "s/m")]


@data.table
class Environment:
    """Surroundings: `gravity`, the gravitational acceleration (m/s2)."""

    gravity: Annotated[float, Parameter(0.0, 20.0, "m/s2")]


@data.table
class Vehicle:
    """All data of the car, whose running gears, wheels and motors are alike; the class of each group states the units.

    `adhesion` has sets by name, in data/vehicle.toml "dry", "poor", "very_poor" and "wet".
    """

    body: CarBody
    gear: Gear
    wheel: Wheel
    suspension: Suspension
    drive: Drive
    contact: WheelRail
    adhesion: Annotated[dict[str, AdhesionSet], AfterValidator(lambda sets: dict(sorted(sets.items())))]
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
        """Roll of the axle per lateral displacement on cones, Gamma (rad/m). Source: paper, eqs. (10), (11)."""
        return self.roll_per_shift(math.tan(self.wheel.cone_angle))

    def roll_per_shift(self, slope: float) -> float:
        """Roll of the axle per lateral displacement (rad/m) where the tangent of the contact angle is `slope` (-)."""
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
    """Read and check vehicle data.

    Args:
        path (path, optional): A TOML file like data/vehicle.toml, the default.
        overrides: Changed values (SI) by dotted key, as `load_vehicle(**{"wheel.radius": 0.43, "adhesion.poor.mu0":
            0.12})`.

    Raises:
        InputError: For a wrong file, key or value: one sentence with file, key, what was found and what is allowed.
    """
    vehicle = loaded(Vehicle, data.location(path, paths.source("data/vehicle.toml")), overrides)[0]
    if "wheel.cone_angle" in overrides and vehicle.contact.profile != "cone":
        warnings.warn(
            "wheel.cone_angle changes the control model only: the wheels of the car are no cones", stacklevel=2
        )
    return vehicle


def loaded(kind: type, file: Path, overrides: dict) -> tuple[Any, dict[str, dict]]:
    """Instance of `kind`, a `data.table` class, from a file of `Entry` tables; and dotted key -> `Entry` as a dict.

    `overrides` replace values of the file (SI) by dotted key such as "wheel.radius"; their range becomes "fixed".
    """
    content = data.read(file)
    built, entries = data.build(kind, content, file.name), dict(_entries(content))
    for key, value in overrides.items():
        if key not in entries:
            raise InputError(f"override {key!r} is not a key of {file.name}; there are {', '.join(entries)}")
        entries[key].update(value=value, range="fixed")
    return data.build(kind, content, file.name) if overrides else built, entries


def _entries(content: dict, place: str = "") -> Iterator[tuple[str, dict]]:
    for key, table in content.items():
        yield from [(place + key, table)] if "value" in table else _entries(table, f"{place}{key}.")


def sample_ranges() -> dict[str, tuple[float, float]]:
    """Dotted key -> (low, high), bounds (SI) of each parameter in data/vehicle.toml that is not fixed, for studies."""
    entries = loaded(Vehicle, paths.source("data/vehicle.toml"), {})[1]
    return {key: tuple(entry["range"]) for key, entry in entries.items() if entry["range"] != "fixed"}
