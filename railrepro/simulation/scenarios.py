"""Experiments as data: a scenario names track, speed, adhesion, set point and demand, and lays its route.

Serves the paper's section Test Tracks and the captions of Figs. 6 to 9.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from railrepro import paths
from railrepro.errors import InputError
from railrepro.track import route
from railrepro.track.table import load_track

_SET_POINTS = {
    "none": (),
    "sine": ("amplitude_mm", "period_m", "start_m"),
    "sweep": ("amplitude_mm", "period_start_m", "period_end_m", "start_m", "end_m"),
}


@dataclass(frozen=True)
class Scenario:
    """One experiment; see the head of data/scenarios.toml for the fields and their units."""

    name: str
    track: str
    speed_kmh: float
    end_m: float
    paper: str = ""
    good: str = "dry"
    poor: str = "poor"
    poor_share: tuple = ()
    poor_share_left: tuple = ()
    poor_share_right: tuple = ()
    force_kN: tuple = ()
    set_point: dict = field(default_factory=lambda: {"kind": "none"})
    stop_kmh: float | None = None

    @property
    def speed(self) -> float:
        """Initial speed (m/s)."""
        return self.speed_kmh / 3.6

    @property
    def stop_speed(self) -> float:
        """Speed below which the run ends (m/s); a negative number means never."""
        return -1.0 if self.stop_kmh is None else self.stop_kmh / 3.6

    @property
    def poor_shares(self) -> tuple[tuple, tuple]:
        """[p_m, share of the poor set] points of the left and right rail; one point at least."""
        both = self.poor_share or ((0.0, 0.0),)
        return self.poor_share_left or both, self.poor_share_right or both

    def but(self, **changes) -> Scenario:
        """A copy with some fields changed, checked like a file."""
        changed = replace(self, **changes)
        _check(changed, "scenario")
        return changed

    def route(self, irregularities=None) -> route.Route:
        """Lay set point, adhesion and demand along the track (`railrepro.track.route.Route`)."""
        left, right = self.poor_shares
        way = route.lay(
            load_track(self.track),
            reference=self._reference(),
            poor=(_ramps(left), _ramps(right)),
            force=_steps(self.force_kN),
            irregularities=irregularities,
        )
        if self.end_m > way.length:
            raise InputError(
                f"scenario {self.name}: end_m = {self.end_m} lies beyond track {self.track} ({way.length} m)"
            )
        return replace(way, length=self.end_m)

    def _reference(self):
        point = self.set_point
        extra = {"fade": point["fade_m"]} if "fade_m" in point else {}
        if point["kind"] == "sine":
            end = point.get("end_m", np.inf)
            return route.sine(1e-3 * point["amplitude_mm"], point["period_m"], point["start_m"], end, **extra)
        if point["kind"] == "sweep":
            period = point["period_start_m"], point["period_end_m"]
            return route.sweep(1e-3 * point["amplitude_mm"], *period, point["start_m"], point["end_m"], **extra)
        return None


def _ramps(points):
    table = np.array(points, dtype=float)
    return lambda p: np.interp(p, table[:, 0], table[:, 1])


def _steps(points):
    table = np.array([[-np.inf, 0.0], *points], dtype=float)
    return lambda p: 1e3 * table[np.searchsorted(table[:, 0], p, side="right") - 1, 1]


def load_scenarios(path: Path | str | None = None) -> dict[str, Scenario]:
    """All scenarios of a file by name.

    Parameters
    ----------
    path : path, optional
        A TOML file; default data/scenarios.toml.

    Raises
    ------
    InputError
        One sentence naming file, scenario, key, what was found and what is allowed.
    """
    file = Path(path) if path else paths.source("data/scenarios.toml")
    try:
        content = tomllib.loads(file.read_text())
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{file.name}: cannot be read as TOML ({error})") from error
    known = {f.name for f in fields(Scenario)} - {"name"}
    scenarios = {}
    for name, entry in content.items():
        unknown, missing = set(entry) - known, {"track", "speed_kmh", "end_m"} - set(entry)
        if unknown:
            raise InputError(f"{file.name}: [{name}] has the unknown key {min(unknown)!r}; allowed are {sorted(known)}")
        if missing:
            raise InputError(f"{file.name}: [{name}] lacks the key {min(missing)!r}")
        lists = {key: tuple(map(tuple, value)) for key, value in entry.items() if isinstance(value, list)}
        scenarios[name] = Scenario(name, **entry | lists)
        _check(scenarios[name], f"{file.name}: [{name}]")
    return scenarios


def load_scenario(name: str, path: Path | str | None = None) -> Scenario:
    """One scenario by name; InputError lists the known names otherwise."""
    scenarios = load_scenarios(path)
    if name not in scenarios:
        raise InputError(f"scenario {name!r} is not known; there are {sorted(scenarios)}")
    return scenarios[name]


def _check(scenario: Scenario, where: str) -> None:
    numbers = {"speed_kmh": (0.5, 450.0), "end_m": (1.0, 1e5)}
    for key, (low, high) in numbers.items():
        value = getattr(scenario, key)
        if not isinstance(value, int | float) or not low <= value <= high:
            raise InputError(f"{where}: {key} = {value!r}, a number from {low} to {high} is needed")
    for key in ("poor_share", "poor_share_left", "poor_share_right"):
        points = np.array(getattr(scenario, key) or [[0, 0]], dtype=float)
        if points.ndim != 2 or points.shape[1] != 2 or (np.diff(points[:, 0]) <= 0).any():
            raise InputError(f"{where}: {key} needs [p_m, share] pairs with increasing p_m")
        if not ((points[:, 1] >= 0) & (points[:, 1] <= 1)).all():
            raise InputError(f"{where}: {key} has a share outside 0 to 1")
    kind = scenario.set_point.get("kind")
    if kind not in _SET_POINTS:
        raise InputError(f"{where}: set_point kind {kind!r} is not known; there are {sorted(_SET_POINTS)}")
    needed, optional = set(_SET_POINTS[kind]), {"kind", "fade_m", "end_m"}
    for key in needed - set(scenario.set_point):
        raise InputError(f"{where}: set_point of kind {kind!r} lacks {key!r}")
    for key in set(scenario.set_point) - needed - optional:
        raise InputError(f"{where}: set_point of kind {kind!r} has the unknown key {key!r}")
