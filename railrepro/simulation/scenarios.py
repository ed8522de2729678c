"""Experiments as data: a scenario names track, speed, adhesion, set point and demand, and lays its route.

Serves the paper's section Test Tracks and the captions of Figs. 6 to 9.
"""

from __future__ import annotations

from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import casadi as ca
import numpy as np
from pydantic import Field

from railrepro import data, paths
from railrepro.data import InputError, Number, above, between
from railrepro.paths import Entries
from railrepro.track import route
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import Vehicle

_AMPLITUDE = Annotated[Number, above(0.01, 20.0, "mm", signed=True)]
"""Up to beyond any flangeway (S1002 on 60E1 touches at 6 to 8 mm; a cone has none, but derails at 30 mm), and more than
what is stated in metres by mistake."""
FLANGEWAY = 8.0
"""Lateral displacement at which S1002 on 60E1 surely touches with its flange (mm)."""
_PERIOD = Annotated[Number, between(2 * route.CELL, 1e5, "m")]
_POSITION = Annotated[Number, between(-1e5, 1e5, "m")]
_FADE = Annotated[Number, above(0.0, 1e5, "m")]
_SHARES = Annotated[tuple[tuple[_POSITION, Annotated[Number, between(0.0, 1.0)]], ...], data.INCREASING]
_FORCES = Annotated[tuple[tuple[_POSITION, Annotated[Number, between(-500.0, 500.0, "kN")]], ...], data.INCREASING]


@data.table
class NoSetPoint:
    """The gear is to follow the centre line."""

    kind: Literal["none"]


@data.table
class Sine:
    """Sinusoidal set point, see `route.sine`."""

    kind: Literal["sine"]
    amplitude_mm: _AMPLITUDE
    period_m: _PERIOD
    start_m: _POSITION
    end_m: _POSITION | None = None
    fade_m: _FADE | None = None

    def __post_init__(self) -> None:
        _check_order(self.start_m, self.end_m)


@data.table
class Sweep:
    """Sine sweep, see `route.sweep`."""

    kind: Literal["sweep"]
    amplitude_mm: _AMPLITUDE
    period_start_m: _PERIOD
    period_end_m: _PERIOD
    start_m: _POSITION
    end_m: _POSITION
    fade_m: _FADE | None = None

    def __post_init__(self) -> None:
        _check_order(self.start_m, self.end_m)


def _check_order(start: float, end: float | None) -> None:
    if end is not None and not start < end:
        raise ValueError(f"ends at {end} m, an end after its start at {start} m is needed")


if TYPE_CHECKING:
    _SET_POINT = dict[str, Any]
else:  # checked as one of these, and kept as the table that it is
    _SET_POINT = Annotated[NoSetPoint | Sine | Sweep, Field(discriminator="kind"), data.AS_GIVEN]


@data.table
class Scenario:
    """One experiment; see the head of data/scenarios.toml for the fields and their units."""

    name: str
    track: str
    speed_kmh: Annotated[Number, between(0.5, 450.0, "km/h")]
    end_m: Annotated[Number, between(1.0, 1e5, "m")]
    paper: str = ""
    good: str = "dry"
    poor: str = "poor"
    poor_share: _SHARES = ()
    poor_share_left: _SHARES = ()
    poor_share_right: _SHARES = ()
    force_kN: _FORCES = ()
    set_point: _SET_POINT = field(default_factory=lambda: {"kind": "none"})
    stop_kmh: Annotated[Number, between(0.0, 450.0, "km/h")] | None = None

    def __post_init__(self) -> None:
        if self.poor_share and self.poor_share_left and self.poor_share_right:
            raise ValueError("has poor_share beside that of both rails, which hides it")
        if self.stop_kmh is not None and not self.stop_kmh < self.speed_kmh:
            raise ValueError(
                f"stops below {self.stop_kmh} km/h, less than its speed of {self.speed_kmh} km/h is needed"
            )

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
        return data.build(Scenario, vars(self) | changes, "scenario")

    def check(self, vehicle: Vehicle) -> None:
        """Refuse wrong fields and set points beyond the flangeway of a vehicle (InputError)."""
        self.but()
        amplitude = abs(self.set_point.get("amplitude_mm", 0.0))
        if vehicle.contact.profile != "cone" and amplitude > FLANGEWAY:
            raise InputError(
                f"scenario {self.name}: set_point.amplitude_mm = {amplitude:g}, up to {FLANGEWAY:g} mm lie inside the "
                "flangeway of S1002 on 60E1"
            )

    def route(self, irregularities=None, line=None) -> route.Route:
        """Lay set point, adhesion and demand along the track, see `railrepro.track.route.lay`."""
        left, right = self.poor_shares
        track = load_track(self.track_file())
        way = route.lay(
            track,
            reference=self.reference(),
            poor=(_ramps(left), _ramps(right)),
            force=_steps(self.force_kN),
            irregularities=irregularities,
            line=line,
        )
        if self.end_m > way.length:
            raise InputError(
                f"scenario {self.name}: end_m = {self.end_m} lies beyond track {self.track} ({way.length} m)"
            )
        return replace(way, length=self.end_m)

    def track_file(self) -> str:
        """Name of the track, or its CSV: below the checkout if it is there, else from the working directory."""
        file = paths.source(self.track)
        return str(file) if self.track.endswith(".csv") and file.is_file() else self.track

    def reference(self) -> ca.Function | None:
        """Lateral set point over the coordinate, if there is one."""
        point = dict(self.set_point)
        kind = point.pop("kind")
        if kind == "none":
            return None
        shape, amplitude = {"sine": route.sine, "sweep": route.sweep}[kind], 1e-3 * point.pop("amplitude_mm")
        return shape(amplitude, **{name.removesuffix("_m"): value for name, value in point.items()})


def _ramps(points):
    table = np.array(points, dtype=float)
    return lambda p: np.interp(p, table[:, 0], table[:, 1])


def _steps(points):
    table = np.array([[-np.inf, 0.0], *points], dtype=float)
    return lambda p: 1e3 * table[np.searchsorted(table[:, 0], p, side="right") - 1, 1]


def load_scenarios(path: Path | str | None = None) -> Entries[Scenario]:
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
    file = data.location(path, paths.source("data/scenarios.toml"))
    content = data.read(file)
    for name, entry in content.items():
        if isinstance(entry, dict):
            entry["name"] = name
    return Entries(data.build(dict[str, Scenario], content, file.name), "data/scenarios.toml")


def load_scenario(name: str) -> Scenario:
    """One scenario of data/scenarios.toml by name; InputError lists the known names otherwise."""
    scenarios = load_scenarios()
    if not isinstance(name, str) or name not in scenarios:
        raise InputError(f"scenario {name!r} is not known; there are {sorted(scenarios)}")
    return scenarios[name]
