"""What a film shows: the numbers of finished runs at common instants, in the units in which they are drawn.

Serves the paper's Figs. 6 to 9, in motion.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from railrepro.car.equations import GEARS, SIDES, WHEELS
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.contact.creep import falling_friction
from railrepro.errors import InputError
from railrepro.evidence.report.figures import CONTROLLER_STYLE, GREEN
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.score.entry import entry
from railrepro.evidence.score.suite import Case
from railrepro.evidence.score.trial import driven_file
from railrepro.schema import between, require
from railrepro.simulation import metrics
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.simulation.simulate import Run
from railrepro.track.route import INDEX, Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_COUNT = between(2, 100_000)
FRAMES = 600
"""Frames of a film unless given otherwise."""
SEED = 101
"""Seed of the sensors in the setting `loop`, as in the other chapters."""
AHEAD, BEHIND = 30.0, 24.0
"""Length of track that is shown behind and ahead of the front gear (m)."""
_GEAR = {"p_m": ("p", 1.0), "y_mm": ("y", 1e3), "y_ref_mm": ("y_ref", 1e3), "psi_mrad": ("psi_TrAx", 1e3),
         "du_Nm": ("du", 1.0)}  # fmt: skip
_WHEEL = {"Fx_kN": ("Fx", 1e-3), "Fy_kN": ("Fy", 1e-3), "tau_Nm": ("tau", 1.0), "slip_percent": ("sx", 100.0)}
WIDEST = 10.0
"""Displacement beyond which nothing is drawn (mm), a little more than the flangeway."""


@dataclass(frozen=True)
class Frame:
    """One controller's run as it is drawn.

    Attributes
    ----------
    controller, label, color : str
    table : DataFrame
        One row per frame: t_s, v_kmh; per gear `front.y_mm` and so on; per wheel `front_le.Fx_kN`, the friction bound
        `front_le.bound_kN` and the adhesion in use `front_le.adhesion_percent`.
    told : str
        Why the run ended and how well the front gear followed, one sentence.
    """

    controller: str
    label: str
    color: str
    table: pd.DataFrame
    summary: str


@dataclass(frozen=True)
class Comparison:
    """Runs of one scenario side by side.

    Attributes
    ----------
    title : str
    shots : tuple of Shot
    way : DataFrame
        Every metre of the way: p_m, x_m and y_m in space, y_ref_mm, poor_le and poor_ri (share of the poor rail).
    times : ndarray
        Time of each frame (s); a shot that ended early has fewer rows.
    """

    title: str
    shots: tuple[Frame, ...]
    way: pd.DataFrame
    times: np.ndarray

    @property
    def scales(self) -> dict[str, float]:
        """Largest drawn displacement (mm), creep force (kN) and wheel torque (N m) of all shots."""

        def largest(names: list[str]) -> float:
            return max(float(np.abs(shot.table[names].to_numpy()).max()) for shot in self.shots)

        lateral = largest([f"{gear}.{name}" for gear in GEARS for name in ("y_mm", "y_ref_mm")])
        force, torque = (largest([f"{wheel}.{name}" for wheel in WHEELS]) for name in ("bound_kN", "tau_Nm"))
        return {"y_mm": min(max(lateral, 0.1), WIDEST), "force_kN": force, "torque_Nm": max(torque, 1.0)}

    def still(self) -> int:
        """Frame in the middle half of the film in which the runs differ most in the front gear's position."""
        rows = min(len(shot.table) for shot in self.shots)
        y = np.array([shot.table["front.y_mm"].iloc[:rows] for shot in self.shots])
        first = rows // 4
        return first + int(np.argmax(np.ptp(y[:, first : max(rows - first, first + 1)], axis=0)))


def film(scenario: str, controllers: tuple[str, ...], setting: str = tuning.EQUAL, frames: int = FRAMES) -> Comparison:
    """Drive two controllers through a scenario and put the runs side by side.

    Parameters
    ----------
    scenario : str
        Key of data/scenarios.toml.
    controllers : tuple of str
        Two keys of `registry.REGISTERED`, or files with a controller, see `score.entry`.
    setting : str
        Whose tuned parameters are taken; in the setting `loop` also the sensors.
    frames : int
        About so many frames.

    Raises
    ------
    InputError
        Unknown names, or not two controllers.
    """
    driven = load_scenario(scenario)
    require("frames", frames, _COUNT, whole=True)
    require("controllers", controllers, (tuple, list))
    if len(set(controllers)) != 2 or len(controllers) != 2:
        raise InputError(f"a film shows two different controllers, found {list(controllers)}")
    sensors = {"seed": SEED} if setting == tuning.LOOP else {}
    chosen = {each.name: each for each in map(entry, controllers)}
    for name, each in chosen.items():
        if not each.file:
            tuning.load(name, setting)  # refused before the first of them is driven
    runs = {
        name: driven_file(each, Case(scenario, setting, driven, sensors=sensors))
        if each.file
        else Experiment(driven, name, setting=setting, sensors=sensors).run()
        for name, each in chosen.items()
    }
    return compose(driven, runs, load_vehicle(), frames, f"{scenario} in the setting {setting}")


def compose(scenario: Scenario, runs: Mapping[str, Run], vehicle: Vehicle, frames: int, title: str) -> Comparison:
    """A film of finished runs.

    Parameters
    ----------
    scenario : Scenario
    runs : mapping of str to Run
        By controller.
    vehicle : Vehicle
        The car that was driven.
    frames : int
    title : str
    """
    require("frames", frames, _COUNT, whole=True)
    require("scenario", scenario, Scenario)
    require("vehicle", vehicle, Vehicle)
    if not isinstance(runs, Mapping) or not runs or not all(isinstance(run, Run) for run in runs.values()):
        raise InputError(f"a film shows at least one run by the name of its controller, found {reprlib.repr(runs)}")
    longest = max(len(run.series) for run in runs.values())
    stride, way = max(longest // frames, 1), scenario.route()
    times = np.arange(0, longest, stride) * EXCHANGE_PERIOD
    shots = tuple(_shot(name, run, stride, scenario, way, vehicle) for name, run in runs.items())
    return Comparison(title, shots, _way(way), times)


def _shot(name: str, run: Run, stride: int, scenario: Scenario, way: Route, vehicle: Vehicle) -> Frame:
    look = CONTROLLER_STYLE.get(name, {"label": name, "color": GREEN})
    rows = run.series.iloc[::stride].reset_index(drop=True)
    columns = {"t_s": rows["t_s"], "v_kmh": 3.6 * rows["front.v"]}
    for gear in GEARS:
        columns |= {f"{gear}.{new}": factor * rows[f"{gear}.{old}"] for new, (old, factor) in _GEAR.items()}
    for wheel in WHEELS:
        columns |= {f"{wheel}.{new}": factor * rows[f"{wheel}.{old}"] for new, (old, factor) in _WHEEL.items()}
        columns[f"{wheel}.bound_kN"] = 1e-3 * friction_bound(rows, wheel, scenario, way, vehicle)
        adhesion = np.hypot(rows[f"{wheel}.Fx"], rows[f"{wheel}.Fy"]) / (rows[f"{wheel}.N"] + 1)
        speed = rows[f"{wheel.split('_')[0]}.v"].to_numpy()
        largest = metrics.adhesion_limit(speed, _poor(rows, wheel, way), scenario, vehicle)
        columns[f"{wheel}.adhesion_percent"] = 100 * adhesion / largest
    summary = f"RMSE of y {1e3 * metrics.rmse(run.series):.2f} mm; {run.ended}"
    return Frame(name, look["label"], look["color"], pd.DataFrame(columns), summary)


def _poor(rows: pd.DataFrame, wheel: str, way: Route) -> np.ndarray:
    """Share of the poor rail under a wheel (-), shape (n,)."""
    gear, side = wheel.split("_")
    return way.rows_at(rows[f"{gear}.p"].to_numpy())[:, INDEX[f"poor_{side}"]]


def friction_bound(series: pd.DataFrame, wheel: str, scenario: Scenario, way: Route, vehicle: Vehicle) -> np.ndarray:
    """Largest creep force that friction allows a wheel at its sliding speed and load (N), shape (n,).

    The bound of the car's own contact law; the sliding speed is that of the logged creepages.
    """
    share, speed = _poor(series, wheel, way), series[f"{wheel.split('_')[0]}.v"].to_numpy()
    sets = vehicle.adhesion[scenario.good], vehicle.adhesion[scenario.poor]
    mu0, a_ratio, b_decay = (
        (1 - share) * getattr(sets[0], key) + share * getattr(sets[1], key) for key in ("mu0", "a_ratio", "b_decay")
    )
    rolling = np.hypot(speed, vehicle.contact.rest_speed)
    sliding = rolling * np.hypot(series[f"{wheel}.nu_x"], series[f"{wheel}.nu_y"]).to_numpy()
    return falling_friction(np, mu0, a_ratio, b_decay, sliding) * series[f"{wheel}.N"].to_numpy()


def _way(route: Route) -> pd.DataFrame:
    """The way in steps of a metre from behind its start to beyond its end."""
    p = np.arange(-BEHIND - 1, route.length + AHEAD + 1)
    cells = route.rows_at(p)
    columns = {f"{name}_m": cells[:, INDEX[name]] for name in ("x", "y")}
    poor = {f"poor_{side}": cells[:, INDEX[f"poor_{side}"]] for side in SIDES}
    return pd.DataFrame({"p_m": p, **columns, "y_ref_mm": 1e3 * route.reference_at(p)[0], **poor})
