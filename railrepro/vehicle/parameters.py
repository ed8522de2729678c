"""Vehicle data as frozen, validated dataclasses; the numbers live in data/vehicle.toml only.

Serves the paper's sections Control-Oriented Model and Simulation Environment, which print none of them.
"""

from __future__ import annotations

import dataclasses
import math
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from railrepro import paths
from railrepro.errors import InputError


def _parameter(unit: str, low: float = 0.0, high: float = math.inf):
    """Field with its unit and the physically possible range (exclusive low, inclusive high)."""
    return dataclasses.field(metadata={"unit": unit, "low": low, "high": high})


_MASS, _INERTIA = ("kg", 0.0, 1e6), ("kg m2", 0.0, 1e8)
_NOT_NEGATIVE = -1e-300


@dataclass(frozen=True)
class CarBody:
    """Car body: mass, inertia about its centre of gravity, height above the rails, distance of the running gears."""

    mass: float = _parameter(*_MASS)
    inertia_x: float = _parameter(*_INERTIA)
    inertia_y: float = _parameter(*_INERTIA)
    inertia_z: float = _parameter(*_INERTIA)
    cg_height: float = _parameter("m", 0.0, 5.0)
    gear_spacing: float = _parameter("m", 1.0, 40.0)
    length: float = _parameter("m", 1.0, 60.0)


@dataclass(frozen=True)
class Gear:
    """Wheel carrier with two wheels; inertia_x and inertia_z contain the wheels, inertia_y not their spin."""

    mass: float = _parameter(*_MASS)
    inertia_x: float = _parameter(*_INERTIA)
    inertia_y: float = _parameter(*_INERTIA)
    inertia_z: float = _parameter(*_INERTIA)
    contact_base: float = _parameter("m", 0.5, 3.0)


@dataclass(frozen=True)
class Wheel:
    """One independently rotating wheel with its motor."""

    radius: float = _parameter("m", 0.1, 1.0)
    spin_inertia: float = _parameter(*_INERTIA)
    diametral_inertia: float = _parameter(*_INERTIA)
    cone_angle: float = _parameter("rad", _NOT_NEGATIVE, 0.2)


@dataclass(frozen=True)
class Suspension:
    """Stage between car body and one carrier; k and c belong to each of the two springs."""

    half_spacing: float = _parameter("m", 0.1, 2.0)
    height: float = _parameter("m", 0.0, 3.0)
    k_x: float = _parameter("N/m", _NOT_NEGATIVE, 1e9)
    c_x: float = _parameter("N s/m", _NOT_NEGATIVE, 1e8)
    k_y: float = _parameter("N/m", _NOT_NEGATIVE, 1e9)
    c_y: float = _parameter("N s/m", _NOT_NEGATIVE, 1e8)
    k_z: float = _parameter("N/m", 0.0, 1e9)
    c_z: float = _parameter("N s/m", _NOT_NEGATIVE, 1e8)
    link_stiffness: float = _parameter("N/m", 0.0, 1e10)
    link_damping: float = _parameter("N s/m", _NOT_NEGATIVE, 1e8)
    antiroll_stiffness: float = _parameter("N m/rad", _NOT_NEGATIVE, 1e9)
    antiroll_damping: float = _parameter("N m s/rad", _NOT_NEGATIVE, 1e8)
    pitch_stiffness: float = _parameter("N m/rad", 0.0, 1e9)
    pitch_damping: float = _parameter("N m s/rad", _NOT_NEGATIVE, 1e8)
    yaw_stop_angle: float = _parameter("rad", 0.0, 0.5)
    yaw_stop_stiffness: float = _parameter("N m/rad", _NOT_NEGATIVE, 1e10)
    bump_clearance: float = _parameter("m", 0.0, 1.0)
    bump_stiffness: float = _parameter("N/m", _NOT_NEGATIVE, 1e9)

    @property
    def yaw_stiffness(self) -> float:
        """k_sz of one running gear (N m/rad)."""
        return 2 * self.k_x * self.half_spacing**2

    @property
    def yaw_damping(self) -> float:
        """k_dz of one running gear (N m s/rad)."""
        return 2 * self.c_x * self.half_spacing**2

    @property
    def roll_stiffness(self) -> float:
        """k_sx of one running gear (N m/rad)."""
        return 2 * self.k_z * self.half_spacing**2 + self.antiroll_stiffness

    @property
    def roll_damping(self) -> float:
        """k_dx of one running gear (N m s/rad)."""
        return 2 * self.c_z * self.half_spacing**2 + self.antiroll_damping


@dataclass(frozen=True)
class Drive:
    """Wheel motor."""

    torque_limit: float = _parameter("N m", 0.0, 1e5)
    power_limit: float = _parameter("W", 0.0, 1e8)
    power_limited: bool = _parameter("-")
    lag: float = _parameter("s", 0.0, 1.0)


@dataclass(frozen=True)
class WheelRail:
    """Material and regularisation of the wheel-rail contact; `profile` is "cone" or "s1002"."""

    young: float = _parameter("Pa", 1e9, 1e12)
    poisson: float = _parameter("-", _NOT_NEGATIVE, 0.5)
    shear_modulus: float = _parameter("Pa", 1e9, 1e12)
    nominal_load: float = _parameter("N", 0.0, 1e6)
    normal_stiffness: float = _parameter("N/m^1.5", 0.0, 1e13)
    normal_damping: float = _parameter("s/m", _NOT_NEGATIVE, 1e3)
    rest_speed: float = _parameter("m/s", 0.0, 1.0)
    profile: str = _parameter("-")


@dataclass(frozen=True)
class AdhesionSet:
    """Parameters of Polach's creep law: reduction factors, friction at rest, its ratio and decay with slip speed."""

    k_a: float = _parameter("-", 0.0, 1.0)
    k_s: float = _parameter("-", 0.0, 1.0)
    mu0: float = _parameter("-", _NOT_NEGATIVE, 1.0)
    a_ratio: float = _parameter("-", _NOT_NEGATIVE, 1.0)
    b_decay: float = _parameter("s/m", _NOT_NEGATIVE, 10.0)


@dataclass(frozen=True)
class Environment:
    """Surroundings."""

    gravity: float = _parameter("m/s2", 0.0, 20.0)


@dataclass(frozen=True)
class Vehicle:
    """All data of the car; see the groups for units."""

    body: CarBody
    gear: Gear
    wheel: Wheel
    suspension: Suspension
    drive: Drive
    contact: WheelRail
    adhesion: dict[str, AdhesionSet]
    environment: Environment

    @property
    def gravity(self) -> float:
        """Gravitational acceleration (m/s2)."""
        return self.environment.gravity

    @property
    def gamma(self) -> float:
        """Roll of the axle per lateral displacement, Gamma (rad/m). Source: paper, eq. (z_and_phi)."""
        slope = math.tan(self.wheel.cone_angle)
        return slope / (self.gear.contact_base / 2 - self.wheel.radius * slope)

    @property
    def longitudinal_mass(self) -> float:
        """m_x = m + m_CB/2 (kg)."""
        return self.gear.mass + self.body.mass / 2

    @property
    def effective_longitudinal_mass(self) -> float:
        """m_x with the spin inertia of both wheels, m_x + 2 J_Wy/r0^2 (kg)."""
        return self.longitudinal_mass + 2 * self.wheel.spin_inertia / self.wheel.radius**2

    @property
    def residual_yaw_inertia(self) -> float:
        """J_Ax_z without the wheels' own diametral inertia (kg m2)."""
        return self.gear.inertia_z - 2 * self.wheel.diametral_inertia

    @property
    def residual_roll_inertia(self) -> float:
        """J_Ax_x without the wheels' own diametral inertia (kg m2)."""
        return self.gear.inertia_x - 2 * self.wheel.diametral_inertia

    @property
    def effective_yaw_inertia(self) -> float:
        """J_eff: yaw inertia with the differential spin of the wheels (kg m2)."""
        return self.gear.inertia_z + self.wheel.spin_inertia * self.gear.contact_base**2 / 2 / self.wheel.radius**2


_GROUPS = {
    "body": CarBody,
    "gear": Gear,
    "wheel": Wheel,
    "suspension": Suspension,
    "drive": Drive,
    "contact": WheelRail,
    "environment": Environment,
}
_ENTRY = {"symbol", "value", "unit", "source", "confidence", "range"}
_CONFIDENCE = ("VV", "V", "D", "R", "A")
PROFILES = ("cone", "s1002")


def load_vehicle(path: Path | str | None = None, **overrides) -> Vehicle:
    """Read and check vehicle data.

    Parameters
    ----------
    path : path, optional
        A TOML file like data/vehicle.toml, the default.
    overrides
        Values by dotted key, `load_vehicle(**{"wheel.radius": 0.43, "adhesion.poor.mu0": 0.12})` (SI units).

    Returns
    -------
    Vehicle

    Raises
    ------
    InputError
        One sentence naming file, key, what was found and what is allowed.
    """
    file, entries = _entries(path)
    values = {key: entry["value"] for key, entry in entries.items()}
    for key, value in overrides.items():
        if key not in values:
            raise InputError(f"override {key!r} is not a key of {file.name}; the group has {_siblings(key, values)}")
        values[key] = value
    groups = {name: _group(kind, name, values, file) for name, kind in _GROUPS.items()}
    names = sorted({key.split(".")[1] for key in values if key.startswith("adhesion.")})
    adhesion = {name: _group(AdhesionSet, f"adhesion.{name}", values, file) for name in names}
    if groups["contact"].profile not in PROFILES:
        raise InputError(f"{file.name}: contact.profile is {groups['contact'].profile!r}, allowed are {PROFILES}")
    return Vehicle(adhesion=adhesion, **groups)


def describe(path: Path | str | None = None) -> pd.DataFrame:
    """Table of all parameters: key, symbol, value, unit, source, confidence, low, high (nan where fixed)."""
    _, entries = _entries(path)
    rows = []
    for key, entry in entries.items():
        low, high = (math.nan, math.nan) if entry["range"] == "fixed" else entry["range"]
        rows.append({"key": key, **{k: v for k, v in entry.items() if k != "range"}, "low": low, "high": high})
    return pd.DataFrame(rows)


def sample_ranges(path: Path | str | None = None) -> dict[str, tuple[float, float]]:
    """Ranges that a robustness study samples, by dotted key (SI)."""
    return {key: tuple(entry["range"]) for key, entry in _entries(path)[1].items() if entry["range"] != "fixed"}


def _siblings(key: str, values: dict) -> list[str]:
    group = key.rsplit(".", 1)[0]
    found = sorted(k for k in values if k.rsplit(".", 1)[0] == group)
    return found or sorted({k.rsplit(".", 1)[0] for k in values})


def _entries(path: Path | str | None) -> tuple[Path, dict[str, dict]]:
    """Checked entries of a file by dotted key."""
    file = Path(path) if path else paths.source("data/vehicle.toml")
    try:
        content = tomllib.loads(file.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{file.name}: cannot be read as TOML ({error})") from error
    unknown = set(content) - set(_GROUPS) - {"adhesion"}
    if unknown:
        raise InputError(f"{file.name}: unknown group [{min(unknown)}]; allowed are {sorted({*_GROUPS, 'adhesion'})}")
    entries = {}
    for group, body in content.items():
        for name, entry in body.items():
            if group == "adhesion":
                entries |= {f"adhesion.{name}.{key}": value for key, value in entry.items()}
            else:
                entries[f"{group}.{name}"] = entry
    for key, entry in entries.items():
        _check_entry(file, key, entry)
    return file, entries


def _check_entry(file: Path, key: str, entry) -> None:
    kind = AdhesionSet if key.startswith("adhesion.") else _GROUPS[key.split(".")[0]]
    known = {f.name: f for f in dataclasses.fields(kind)}
    name = key.rsplit(".", 1)[1]
    if name not in known:
        raise InputError(f"{file.name}: unknown key {key}; the group allows {sorted(known)}")
    if not isinstance(entry, dict) or set(entry) != _ENTRY:
        found = sorted(entry) if isinstance(entry, dict) else entry
        raise InputError(f"{file.name}: {key} needs exactly the fields {sorted(_ENTRY)}, found {found}")
    unit = known[name].metadata["unit"]
    if entry["unit"] != unit:
        raise InputError(f"{file.name}: {key} has the unit {entry['unit']!r}, {unit!r} is needed")
    if entry["confidence"] not in _CONFIDENCE:
        raise InputError(f"{file.name}: {key} has the confidence {entry['confidence']!r}, allowed are {_CONFIDENCE}")
    limits = entry["range"]
    if limits != "fixed" and not (isinstance(limits, list) and len(limits) == 2 and _inside(entry["value"], *limits)):
        raise InputError(
            f'{file.name}: {key} = {entry["value"]!r} with range {limits}, "fixed" or numbers [low, high] around the '
            "value are needed"
        )


def _inside(value, low, high) -> bool:
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (value, low, high))
    return numbers and low <= value <= high


def _group(kind: type, name: str, values: dict, file: Path):
    """One dataclass from dotted values, with every number checked."""
    chosen = {}
    for f in dataclasses.fields(kind):
        key = f"{name}.{f.name}"
        if key not in values:
            raise InputError(f"{file.name}: the key {key} is missing")
        chosen[f.name] = _checked(file, key, values[key], f)
    return kind(**chosen)


def _checked(file: Path, key: str, value, f: dataclasses.Field):
    if f.type in ("bool", "str"):
        if type(value).__name__ != f.type:
            raise InputError(f"{file.name}: {key} is {value!r}, a {f.type} is needed")
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{file.name}: {key} is {value!r}, a number in {f.metadata['unit']} is needed")
    low, high = f.metadata["low"], f.metadata["high"]
    if not low < value <= high:
        floor = "0 or more" if low == _NOT_NEGATIVE else f"more than {low:g}"
        raise InputError(
            f"{file.name}: {key} = {value!r} {f.metadata['unit']} is impossible, {floor} up to {high:g} is allowed"
        )
    return float(value)
