"""Scenarios: track, speed, adhesion, set point and force demand of a run. Serves the paper's section Test Tracks."""

import warnings
from dataclasses import field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import casadi as ca
import numpy as np
from pydantic import Field

from railrepro import data, paths
from railrepro.data import InputError, Number, above, between
from railrepro.track import route
from railrepro.track.alignment import GRAVITY
from railrepro.track.table import load_track

_AMPLITUDE = Annotated[Number, above(0.01, 20.0, "mm", signed=True)]
"""The upper bound is beyond any flangeway (S1002 on 60E1 touches at 6 to 8 mm). The lower bound refuses metres."""
_PERIOD = Annotated[Number, between(2 * route.CELL, 1e5, "m")]
_POSITION = Annotated[Number, between(-1e5, 1e5, "m")]
_FADE = Annotated[Number, above(0.0, 1e5, "m")]
_SHARES = Annotated[tuple[tuple[_POSITION, Annotated[Number, between(0.0, 1.0)]], ...], data.INCREASING]
_FORCES = Annotated[tuple[tuple[_POSITION, Annotated[Number, between(-500.0, 500.0, "kN")]], ...], data.INCREASING]


@data.table
class NoSetPoint:
    """Set point y* = 0, of the `kind` "none": the gears are to follow the centre line of the track."""

    kind: Literal["none"]


@data.table
class Sine:
    """Sinusoidal lateral set point of wavelength `period_m` (m) from `start_m` to `end_m` (m; None: without end). Its
    amplitude (mm) rises and falls over `fade_m` (m; None: 30 m)."""

    kind: Literal["sine"]
    amplitude_mm: _AMPLITUDE
    period_m: _PERIOD
    start_m: _POSITION
    end_m: _POSITION | None = None
    fade_m: _FADE | None = None


@data.table
class Sweep:
    """Lateral set point whose wavelength changes from `period_start_m` at `start_m` to `period_end_m` at `end_m` (m).
    Its amplitude (mm) rises and falls over `fade_m` (m; None: 30 m)."""

    kind: Literal["sweep"]
    amplitude_mm: _AMPLITUDE
    period_start_m: _PERIOD
    period_end_m: _PERIOD
    start_m: _POSITION
    end_m: _POSITION
    fade_m: _FADE | None = None


if TYPE_CHECKING:
    _SET_POINT = dict[str, Any]
else:  # checked as one of these, but stored as a dict
    _SET_POINT = Annotated[NoSetPoint | Sine | Sweep, Field(discriminator="kind"), data.AS_GIVEN]


@data.table
class Scenario:
    """One experiment, an entry of data/scenarios.toml.

    Attributes:
        name, paper (str): Name of the entry; figure or section of the paper.
        track (str): Name in data/tracks.toml, or path of a CSV for `railrepro.track.table.read_table`.
        speed_kmh (float): Initial speed (km/h).
        end_m, stop_kmh (float): The run ends when the front gear reaches `end_m` (m) or its speed falls to `stop_kmh`
            (km/h). Without `stop_kmh` it ends when the car stands.
        good, poor (str): Adhesion sets of the rail and of its slippery stretches: keys of `Vehicle.adhesion`.
        poor_share (tuple of pairs): Points (p (m), share of the set `poor` (0 to 1)), linear in between.
        poor_share_left, poor_share_right (tuple of pairs): Replace `poor_share` on one rail.
        force_kN (tuple of pairs): Steps (p (m), force demand per running gear from p on (kN, traction positive)).
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
        if not isinstance(self.set_point, dict):
            raise ValueError(f"set_point is {self.set_point!r}, a dict with these fields is needed")
        start, end = self.set_point.get("start_m"), self.set_point.get("end_m")
        if end is not None and not start < end:
            raise ValueError(f"set_point ends at {end} m, an end after its start at {start} m is needed")

    @property
    def speed(self) -> float:
        """Initial speed (m/s)."""
        return self.speed_kmh / 3.6

    @property
    def stop_speed(self) -> float:
        """Speed at which the run ends (m/s), 0 without `stop_kmh`."""
        return (self.stop_kmh or 0.0) / 3.6

    @property
    def poor_shares(self) -> tuple[tuple, tuple]:
        """Points (p (m), share of the poor adhesion set (0 to 1)) for the left and for the right rail: a pair."""
        both = self.poor_share or ((0.0, 0.0),)
        return self.poor_share_left or both, self.poor_share_right or both

    def but(self, **changes) -> Self:
        """Copy the scenario with the fields in `changes` replaced. InputError for a wrong field or value."""
        return replace(self, **changes)

    def route(self, irregularities=None, line=None) -> route.Route:
        """Make the `Route` along the track of the scenario, of the length `end_m`. InputError if the track is shorter.
        Without `irregularities`, a DataFrame with p_m, lateral_m, vertical_m, crosslevel_rad and gauge_m, the rails are
        ideal. `line`, added to the set point, is a pair of arrays as from `preview.plan`: coordinates (m), shape (m,);
        set point (m) and its first three derivatives there, shape (4, m). A warning says where more than 1.5 m/s2 of
        lateral acceleration remain unbalanced at the initial speed."""
        left, right = map(np.transpose, self.poor_shares)
        poor = (lambda p: np.interp(p, *left), lambda p: np.interp(p, *right))
        starts, forces = np.transpose([(-np.inf, 0.0), *self.force_kN])

        def force(p: np.ndarray) -> np.ndarray:
            return 1e3 * forces[np.searchsorted(starts, p, side="right") - 1]

        laid = route.lay(load_track(self.track_file()), self.reference(), poor, force, irregularities, line)
        if self.end_m > laid.length:
            fault = f"end_m = {self.end_m} lies beyond track {self.track} ({laid.length} m)"
            raise InputError(f"scenario {self.name}: {fault}")
        p, kappa, phi = laid.cells[:, [route.INDEX[name] for name in ("p", "kappa", "phi")]].T
        unbalanced = np.where(p <= self.end_m, self.speed**2 * kappa - GRAVITY * np.sin(phi), 0.0)
        worst = int(np.argmax(np.abs(unbalanced)))
        if abs(unbalanced[worst]) > 1.5:
            found = f"{unbalanced[worst]:.1f} m/s2 remain unbalanced at p = {p[worst]:g} m and {self.speed_kmh:g} km/h"
            warnings.warn(f"scenario {self.name}: {found}; railways allow some 1 m/s2", stacklevel=2)
        return replace(laid, length=self.end_m)

    def track_file(self) -> str:
        """Return `track` for `load_track`: unchanged for a name; for a CSV its path in the checkout, or unchanged if
        the checkout does not have it, so that it is read from the working folder."""
        file = paths.source(self.track)
        return str(file) if self.track.endswith(".csv") and file.is_file() else self.track

    def reference(self) -> ca.Function | None:
        """Make the lateral set point a CasADi function from track coordinate p (m) to y* (m); None for "none"."""
        point = {"end_m": 1e6, "fade_m": 30.0}
        point |= {name: value for name, value in self.set_point.items() if value is not None}
        if point["kind"] == "none":
            return None
        kind, first, last = 1, "period_m", "period_m"
        if point["kind"] == "sweep":
            kind, first, last = 2, "period_start_m", "period_end_m"
        where = point["start_m"], point["end_m"], point["fade_m"]
        return route.reference(route.SetPoint(kind, 1e-3 * point["amplitude_mm"], point[first], point[last], *where))


def load_scenarios(path: Path | str | None = None) -> paths.Entries[Scenario]:
    """Read the scenarios of a TOML file (default data/scenarios.toml) as a dict by name. InputError for a wrong one."""
    file = data.location(path, paths.source("data/scenarios.toml"))
    content = data.read(file)
    for name, entry in content.items():
        if isinstance(entry, dict):
            entry["name"] = name
    return paths.Entries(data.build(dict[str, Scenario], content, file.name), "data/scenarios.toml")


def load_scenario(name: str) -> Scenario:
    """Read one scenario of data/scenarios.toml by its name. InputError, with the known names, for another name."""
    scenarios = load_scenarios()
    if not isinstance(name, str) or name not in scenarios:
        raise InputError(f"scenario {name!r} is not known; there are {sorted(scenarios)}")
    return scenarios[name]
