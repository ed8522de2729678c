"""Runs of several controllers side by side: simulate, tabulate and draw them, as the chapters of the book do.

Lists make a study: `compare("sine_tracking", PAPER_TRIO, speed_kmh=[80, 160])` simulates each controller at each speed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from railrepro.control.ndi import NDI
from railrepro.control.registry import CONTROLLERS, PAPER, tuned, with_r_times
from railrepro.evidence.claims import calibrated
from railrepro.evidence.claims.setup import ProbeSetup, setup
from railrepro.evidence.report import figures
from railrepro.evidence.report.sentences import sentences
from railrepro.evidence.runs.experiment import run_all
from railrepro.model.control_model import PSI_AX, PSI_TRAX, STATES, XDOT, X, Y
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.vehicle.parameters import load_vehicle

__all__ = [
    "Comparison",
    "calibrated",
    "compare",
    "figures",
    "gain_ratio",
    "sentences",
]  # one line imports what a chapter needs
QUANTITIES = {
    **{"rmse_mm": ("rmse_y", 1e3), "rmse_rear_mm": ("rmse_y_rear", 1e3), "drift_mm": ("mean_error_last_third", 1e3)},
    **{"largest_error_mm": ("largest_error", 1e3), "delay_m": ("delay", 1.0), "effort_Nm": ("effort_du", 1.0)},
    **{"largest_slip_permille": ("largest_slip", 1e3), "stopping_distance_m": ("stopping_distance", 1.0)},
}
"""Quantity with its unit -> column of `Comparison.rows` (SI) and factor from SI to that unit."""
PANELS = {
    "y": ("$y$ (mm)", ["y_m"], 1e3, "y_ref_m"),
    "error": ("error (mm)", ["error_m"], 1e3, ""),
    "creep": ("creep angle (mrad)", ["creep_rad"], 1e3, ""),
    "du": (r"$\Delta u$ (N m)", ["du_Nm"], 1.0, ""),
    "torque": ("right torque (N m)", ["tau_ri_Nm"], 1.0, ""),
    "torques": ("torques (kN m)", ["tau_ri_Nm", "tau_le_Nm"], 1e-3, ""),
    "adhesion": ("adhesion (-)", ["fx_ri", "fx_le"], 1.0, "f_star"),
    "slip": ("slip (‰)", ["sx_ri", "sx_le"], -1e3, ""),
    "speed": ("speed (km/h)", ["v_mps"], 3.6, ""),
}
"""Panel -> label of its axis, columns of `Comparison.series` (right wheel first), factor from SI, set point or ""."""
_DASHES = ("-", "--", ":", "-.")
_OF_SCENARIO = {field.name for field in fields(Scenario)}


@dataclass(frozen=True)
class Comparison:
    """Metrics and series of several runs, with tables and figures of them; made by `compare`.

    Attributes:
        rows (DataFrame): One row per run: its labels and its metrics in SI units, see `Experiment.values`.
        series (DataFrame): Time series of all runs below each other (`experiment.tidy`), with labels, controller and
            error_m (y - y_ref, m).
        labels (tuple of str): Names of the columns by which the runs differ, as ("speed_kmh", "controller").
    """

    rows: pd.DataFrame
    series: pd.DataFrame
    labels: tuple[str, ...]

    def __getitem__(self, quantity: str) -> pd.Series:
        """Series by run (index `labels`) of a key of `QUANTITIES`, in its unit, or of a column of `rows` (SI)."""
        column, factor = QUANTITIES.get(quantity, (quantity, 1.0))
        found = self.rows.set_index(list(self.labels))[column].rename(quantity)
        return found if factor == 1.0 else factor * found

    def table(self, *quantities: str) -> pd.DataFrame:
        """Table with a row per run (index `labels`) and a column per quantity, each as in `comparison[quantity]`."""
        return pd.DataFrame({name: self[name] for name in quantities})

    def data(self, *panels: str) -> pd.DataFrame:
        """The columns of `series` that `plot` draws for `panels` (keys of `PANELS`), with labels and p_m (m)."""
        named = [name for name in ("car", "setting", "scenario", "controller", *self.labels) if name in self.series]
        drawn = [name for panel in panels for name in (PANELS[panel][3], *PANELS[panel][1]) if name]
        return self.series[list(dict.fromkeys([*named, "p_m", *drawn]))]

    def plot(self, *panels: str, columns: str = "", height: float = 1.3, more: int = 0) -> tuple[Figure, np.ndarray]:
        """Draw panels below each other over the track coordinate (m); returns figure and axes, shape (rows, columns).

        Args:
            panels (str): Keys of `PANELS`, one per row.
            columns (str): Name of a label, as "car", each value of which has a column of panels; "" is one column.
            height (float): Height of a row (in).
            more (int): Number of empty rows below, for other diagrams.
        """
        shown = self.rows[columns].unique() if columns else [""]
        width = figures.WIDTH if len(shown) == 1 else figures.HALF
        grid = {"sharey": "row", "squeeze": False, "height": height, "width": width}
        figure, axes = figures.new_figure(len(panels) + more, len(shown), **grid)
        for column, value in zip(axes.T, shown, strict=True):
            upper, lowest = column[: len(panels)], column[len(panels) - 1]
            for axis in upper[:-1]:
                axis.sharex(lowest)
                axis.tick_params(labelbottom=False)
            self.draw(upper, panels, self.series[self.series[columns] == value] if columns else self.series)
            column[0].set_title(str(value), fontsize=7, linespacing=1.0)
            for line in [line for axis in upper if len(shown) > 1 for line in axis.lines]:
                line.set_linewidth(0.7 * line.get_linewidth())
            lowest.set_xlabel("track coordinate (m)")
        for row, panel in zip(axes, panels, strict=False):
            row[0].set_ylabel(PANELS[panel][0])
        figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=2, loc="outside upper center")
        return figure, axes

    def draw(self, axes: Sequence[Axes], panels: Sequence[str], series: pd.DataFrame) -> None:
        """Draw runs over the track coordinate (m) into existing `axes`, one for each of `panels` (keys of `PANELS`).

        `series` has rows of `self.series`. The left wheel is paler than the right one.
        """
        labels = [name for name in self.labels if name == "controller" or series[name].nunique() > 1] or ["controller"]
        drawn: list[str] = []
        for values, run in series.groupby(labels, sort=False):
            name = run["controller"].iloc[0]
            look = figures.LOOKS[name].line
            if labels != ["controller"]:  # other runs of the same controller differ by the style of their line
                dashes = _DASHES[drawn.count(name) % 4] if name in drawn else look["linestyle"]
                look = look | {"label": ", ".join(map(str, values)), "linestyle": dashes}
            drawn.append(name)
            for axis, panel in zip(axes, panels, strict=True):
                _, (first, *second), factor, _ = PANELS[panel]
                for column in second:
                    axis.plot(run["p_m"], factor * run[column], **look | {"alpha": 0.4, "label": None})
                axis.plot(run["p_m"], factor * run[first], **look)
        for axis, panel in zip(axes, panels, strict=True):
            if reference := PANELS[panel][3]:
                axis.plot(run["p_m"], PANELS[panel][2] * run[reference], **figures.LOOKS["set point"].line)


def compare(
    scenario: str | Scenario | list | Mapping[str, Scenario], controllers: Sequence[str] | Mapping[str, str | dict],
    setting: str | list = PAPER, *, car: Mapping[str, ProbeSetup] | None = None, solver: str = "rti",
    noise_seed: int = 101, stride: int = 20, **changes,
) -> Comparison:  # fmt: skip
    """Simulate controllers in a scenario; an argument given as a list gives a run per value, in all combinations.

    Args:
        scenario (str, Scenario, list or mapping): Name in data/scenarios.toml or a `Scenario`; a list of these, or a
            mapping of names to scenarios.
        controllers (sequence or mapping): Keys of `CONTROLLERS`; or name in tables -> key, or -> dict with the key
            controller, and as needed r_times (factor on R) and fields of `Experiment`.
        setting (str or list): Setting of comparison whose tuned sets are taken; `loop` has sensors.
        car (mapping, optional): Name -> `ProbeSetup`, each with own car, controllers, scenarios (`calibrated.cars()`).
        solver (str): Solver of NMPC: rti, gauss_newton or ipopt.
        noise_seed (int): Random seed of the sensors in the setting `loop`.
        stride (int): Every n-th control cycle (1 ms) is kept in the series.
        changes: Fields of `Scenario`, each a value or a list of values; and fields of `Experiment` for all runs.
    """
    cases = controllers if isinstance(controllers, Mapping) else {name: name for name in controllers}
    cases = {name: case if isinstance(case, dict) else {"controller": case} for name, case in cases.items()}
    if not isinstance(scenario, Mapping):
        scenario = {getattr(one, "name", one): one for one in _listed(scenario)}
    varied = {name: value for name, value in changes.items() if isinstance(value, list)}
    grid = {"car": list(car or [""]), "setting": _listed(setting), "scenario": list(scenario), **varied}
    experiments = []
    for *values, case in product(*grid.values(), cases):
        of = dict(zip(grid, values, strict=True))
        given = changes | {name: of[name] for name in varied}
        more = {name: value for name, value in given.items() if name not in _OF_SCENARIO} | cases[case]
        name, factor = more.pop("controller"), more.pop("r_times", None)
        world = car[of["car"]] if car else setup({}, of["setting"], controllers=[name], seed=noise_seed)
        if factor is not None:
            more["parameters"] = with_r_times(world.parameters[name], factor(world) if callable(factor) else factor)
        driven = scenario[of["scenario"]]
        if not isinstance(driven, Scenario):
            driven = world.scenario(driven) if car else load_scenario(driven)
        driven = driven.but(**{name: value for name, value in given.items() if name in _OF_SCENARIO})
        label = {key: value for key, value in of.items() if key != "scenario" or len(scenario) > 1} | {"case": case}
        more = {"options": CONTROLLERS[name].quick and {"solver": solver}} | more
        experiments.append(world.experiment(driven, name, label=label, stride=stride, **more))
    rows, series = run_all(experiments, "runs")
    assert series is not None, "a stride keeps rows"
    series = series.assign(error_m=series["y_m"] - series["y_ref_m"])
    last = "case" if isinstance(controllers, Mapping) else "controller"
    levels = [name for name, values in grid.items() if len(values) > 1 or name in varied]
    return Comparison(rows, series, (*levels, last))


def _listed(given) -> list:
    return given if isinstance(given, list) else [given]


def gain_ratio(controller: str, setting: str, speed: float) -> float:
    """Ratio k1 / k0 (s) of a tuned controller at a speed (m/s): torque per lateral rate over torque per displacement.

    With a creep angle psi of the wheels, which no model here knows, the steady error in a curve is -(k1 / k0) v psi.
    `controller` is NDI, which has these gains, or a predictive one, whose gains follow from the torques that it plans
    first for a turned and for a displaced gear. `setting` ("paper", "equal" or "loop") chooses its tuned set.
    """
    guidance = tuned(controller, setting=setting)
    if isinstance(guidance, NDI):
        return guidance.gains()["k1"] / guidance.gains()["k0"]
    straight = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=3.6 * speed)
    asked, centred, small = guidance(load_vehicle(), straight.route(), 0), np.zeros(len(STATES)), 1e-4
    centred[[X, XDOT]] = 100.0, speed
    displaced, turned = centred.copy(), centred.copy()
    displaced[Y] = turned[PSI_AX] = turned[PSI_TRAX] = small
    return asked.plan(turned, 0.0) / asked.plan(displaced, 0.0) / speed
