"""Experiments as data: a scenario names track, speed, adhesion, set point and demand, and lays its route. Serves the
paper's section Test Tracks and the captions of Figs. 6 to 9."""

from __future__ import annotations

import warnings
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
from railrepro.track.alignment import GRAVITY
from railrepro.track.table import load_track

_AMPLITUDE = Annotated[Number, above(0.01, 20.0, "mm", signed=True)]
"""Up to beyond any flangeway (S1002 on 60E1 touches at 6 to 8 mm; a cone has none, but derails at 30 mm), and more than
what is stated in metres by mistake."""
_PERIOD = Annotated[Number, between(2 * route.CELL, 1e5, "m")]
_POSITION = Annotated[Number, between(-1e5, 1e5, "m")]
_FADE = Annotated[Number, above(0.0, 1e5, "m")]
_SHARES = Annotated[tuple[tuple[_POSITION, Annotated[Number, between(0.0, 1.0)]], ...], data.INCREASING]
_FORCES = Annotated[tuple[tuple[_POSITION, Annotated[Number, between(-500.0, 500.0, "kN")]], ...], data.INCREASING]


@data.table
class NoSetPoint:
    """Entry for the set point y* = 0, with the `kind` "none": the gears are to follow the centre line of the track."""

    kind: Literal["none"]


@data.table
class Sine:
    """Entry for a sinusoidal lateral set point, see `railrepro.track.route.SetPoint`. `kind` is "sine".

    Attributes:
        amplitude_mm, period_m (float): Amplitude (mm), wavelength (m).
        start_m, end_m (float): Track coordinates between which it acts (m); without `end_m` it has no end.
        fade_m (float): Length over which the amplitude rises and falls (m); without it 30 m.
    """

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
    """Entry for a lateral set point with a varying wavelength, see `railrepro.track.route.SetPoint`. `kind` is "sweep".

    `period_start_m` and `period_end_m` are the wavelengths at start and end; all else as in `Sine`, but `end_m` is
    needed.
    """

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
    """One experiment, an entry of data/scenarios.toml.

    Attributes:
        name, paper (str): Name of the entry; figure or section of the paper.
        track (str): Name in data/tracks.toml, or path of a CSV for `railrepro.track.table.read_table`.
        speed_kmh (float): Initial speed (km/h).
        end_m, stop_kmh (float): The run ends when the front gear reaches `end_m` (m), or its speed falls to `stop_kmh`
            (km/h), without which it ends when the car stands.
        good, poor (str): Names of the two adhesion sets of the vehicle.
        poor_share (tuple of pairs): Points (p (m), share of the set `poor` (0 to 1)), linear in between, for both
            rails.
        poor_share_left, poor_share_right (tuple of pairs): Replace `poor_share` on one rail.
        force_kN (tuple of pairs): Pairs (p (m), force demand per running gear (kN, traction positive)), each held from
            its p to the next.
        set_point (dict): Lateral set point, with the fields of `NoSetPoint`, `Sine` or `Sweep`.
    """

    name: data.Name
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
        if self.stop_kmh is not None and not self.stop_kmh < self.speed_kmh:
            raise ValueError(f"stops below {self.stop_kmh} km/h, less than its speed {self.speed_kmh} km/h is needed")

    @property
    def speed(self) -> float:
        """Initial speed (m/s)."""
        return self.speed_kmh / 3.6

    @property
    def stop_speed(self) -> float:
        """Speed at which the run ends (m/s). Without `stop_kmh` it is 0: standstill."""
        return (self.stop_kmh or 0.0) / 3.6

    @property
    def poor_shares(self) -> tuple[tuple, tuple]:
        """Pair (left rail, right rail): each a tuple of points (p (m), share of the poor adhesion set (0 to 1))."""
        both = self.poor_share or ((0.0, 0.0),)
        return self.poor_share_left or both, self.poor_share_right or both

    def but(self, **changes) -> Scenario:
        """Copy with the fields in `changes` replaced. InputError as from the constructor."""
        return replace(self, **changes)

    def route(self, irregularities=None, line=None) -> route.Route:
        """`Route` of length `end_m` along the track of the scenario. InputError if the track is shorter.
        `irregularities` and `line` (a planned set point) are as in `railrepro.track.route.lay`; default none. Warns
        where more than 1.5 m/s2 of lateral acceleration remain unbalanced at the initial speed."""
        left, right = self.poor_shares
        track, poor = load_track(self.track_file()), (_ramps(left), _ramps(right))
        way = route.lay(track, self.reference(), poor, _steps(self.force_kN), irregularities, line)
        if self.end_m > way.length:
            raise InputError(
                f"scenario {self.name}: end_m = {self.end_m} lies beyond track {self.track} ({way.length} m)"
            )
        p, kappa, phi = way.cells[:, [route.INDEX[name] for name in ("p", "kappa", "phi")]].T
        unbalanced = np.where(p <= self.end_m, self.speed**2 * kappa - GRAVITY * np.sin(phi), 0.0)
        worst = int(np.argmax(np.abs(unbalanced)))
        if abs(unbalanced[worst]) > 1.5:
            found = f"{unbalanced[worst]:.1f} m/s2 remain unbalanced at p = {p[worst]:g} m and {self.speed_kmh:g} km/h"
            warnings.warn(f"scenario {self.name}: {found}; railways allow some 1 m/s2", stacklevel=2)
        return replace(way, length=self.end_m)

    def track_file(self) -> str:
        """Argument for `load_track`: the name of the track, or the path of its CSV. A relative path is looked for in
        the checkout first, then in the working folder."""
        file = paths.source(self.track)
        return str(file) if self.track.endswith(".csv") and file.is_file() else self.track

    def reference(self) -> ca.Function | None:
        """Lateral set point as a CasADi function from track coordinate p (m) to y* (m). None if `kind` is "none"."""
        point = {name: value for name, value in self.set_point.items() if value is not None}
        if point["kind"] == "none":
            return None
        kind, period = (1, "period_m") if point["kind"] == "sine" else (2, "period_start_m")
        periods = point[period], point.get("period_end_m", point[period])
        ends = point["start_m"], point.get("end_m", 1e6), point.get("fade_m", 30.0)
        return route.reference(route.SetPoint(kind, 1e-3 * point["amplitude_mm"], *periods, *ends))


def _ramps(points):
    table = np.array(points, dtype=float)
    return lambda p: np.interp(p, table[:, 0], table[:, 1])


def _steps(points):
    table = np.array([[-np.inf, 0.0], *points], dtype=float)
    return lambda p: 1e3 * table[np.searchsorted(table[:, 0], p, side="right") - 1, 1]


def load_scenarios(path: Path | str | None = None) -> Entries[Scenario]:
    """All scenarios of a TOML file as a dict by name; default data/scenarios.toml. InputError for a wrong entry."""
    file = data.location(path, paths.source("data/scenarios.toml"))
    content = data.read(file)
    for name, entry in content.items():
        if isinstance(entry, dict):
            entry["name"] = name
    return Entries(data.build(dict[str, Scenario], content, file.name), "data/scenarios.toml")


def load_scenario(name: str) -> Scenario:
    """One scenario of data/scenarios.toml by its name. InputError, with the known names, for another one."""
    scenarios = load_scenarios()
    if not isinstance(name, str) or name not in scenarios:
        raise InputError(f"scenario {name!r} is not known; there are {sorted(scenarios)}")
    return scenarios[name]
