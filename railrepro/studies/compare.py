"""Runs of several controllers side by side: simulate, tabulate and draw them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from railrepro import figures
from railrepro.control.registry import CONTROLLERS, PAPER, with_r_times
from railrepro.data import InputError
from railrepro.simulation import metrics, plot
from railrepro.simulation.scenarios import Scenario
from railrepro.studies.experiment import run_all
from railrepro.studies.world import World, world

QUANTITIES = {
    "rmse_mm": ("rmse_y", 1e3),
    "rmse_rear_mm": ("rmse_y_rear", 1e3),
    "drift_mm": ("mean_error_last_third", 1e3),
    "largest_error_mm": ("largest_error", 1e3),
    "delay_m": ("delay", 1.0),
    "effort_Nm": ("effort_du", 1.0),
    "largest_slip_permille": ("largest_slip", 1e3),
    "stopping_distance_m": ("stopping_distance", 1.0),
}
"""Quantity with its unit -> column of `Comparison.rows` (SI) and factor from SI to that unit."""
_DASHES = ("-", "--", ":", "-.")
_OF_SCENARIO = {field.name for field in fields(Scenario)}


@dataclass(frozen=True)
class Comparison:
    """Metrics and series of several runs, with tables and figures of them; made by `compare`. `rows` has one row per
    run: its labels and its metrics in SI units, such as rmse_y, delay, effort_du, failed (all in `Experiment.values`).
    `series` has the time series of the front running gear of all runs below each other: labels, controller, t_s,
    front.p, front.y, … `labels` are the columns by which the runs differ, as ("speed_kmh", "controller")."""

    rows: pd.DataFrame
    series: pd.DataFrame
    labels: tuple[str, ...]

    def __getitem__(self, quantity: str) -> pd.Series:
        """Values by run (index `labels`) of a quantity in the unit that its name ends with, as "rmse_mm", "delay_m" or
        "effort_Nm" (keys of `QUANTITIES`), or of a column of `rows` (SI). InputError for any other name."""
        column, factor = QUANTITIES.get(quantity, (quantity, 1.0))
        if column not in self.rows:
            raise InputError(f"quantity {quantity!r} is not known; there are {[*QUANTITIES]} and columns of `rows`")
        result = self.rows.set_index(list(self.labels))[column].rename(quantity)
        return result if factor == 1.0 else factor * result

    def table(self, *quantities: str) -> pd.DataFrame:
        """Table with a row per run (index `labels`) and a column per name in `quantities`: "rmse_mm", "delay_m",
        "effort_Nm", … (`QUANTITIES`), in the unit of the name, or a column of `rows` (SI)."""
        return pd.DataFrame({name: self[name] for name in quantities})

    def data(self, *panels: str) -> pd.DataFrame:
        """Table of what `plot` draws for `panels`, one row per row of `series`, with labels and track coordinate.
        Columns have the unit in their names, as p_m, y_m, y_ref_m."""
        named = [name for name in ("car", "setting", "scenario", "controller", *self.labels) if name in self.series]
        drawn = [name for panel in plot.chosen(panels) for name in (panel.reference, *panel.columns) if name]
        columns = [metrics.column("front", name) for name in ("p", *drawn)]
        return self.series[list(dict.fromkeys([*named, *columns]))].rename(columns=metrics.FILE_COLUMNS)

    def plot(self, *panels: str, columns: str = "", height: float = 1.3, more: int = 0) -> Figure:
        """Draw panels below each other over the track coordinate (m); returns the figure, which is not saved. `panels`
        are "y", "error", "du", "torques", "slip", … (`simulation.plot.PANELS`), one per row of `height` (in); default
        "y" and "error". `columns` is a label, as "car", whose values have a column of panels each; "" for one column.
        `more` is the number of empty rows below, for other diagrams."""
        names = panels or ("y", "error")
        chosen, shown = plot.chosen(names), self.rows[columns].unique() if columns else [""]
        width = figures.WIDTH if len(shown) == 1 else figures.HALF
        grid = {"sharey": "row", "squeeze": False, "height": height, "width": width}
        figure, axes = figures.new_figure(len(chosen) + more, len(shown), **grid)
        for column, value in zip(axes.T, shown, strict=True):
            upper, lowest = column[: len(chosen)], column[len(chosen) - 1]
            for axis in upper[:-1]:
                axis.sharex(lowest)
                axis.tick_params(labelbottom=False)
            self.draw(upper, names, self.series[self.series[columns] == value] if columns else self.series)
            column[0].set_title(str(value), fontsize=7, linespacing=1.0)
            for axis in upper if len(shown) > 1 else ():
                for line in axis.lines:
                    line.set_linewidth(0.7 * line.get_linewidth())
        plot.name_axes(figure, axes, chosen)
        return figure

    def draw(self, axes: Sequence[Axes], panels: Sequence[str], series: pd.DataFrame) -> None:
        """Draw runs over the track coordinate (m) into existing `axes`, one for each of `panels` ("y", "du", …). Drawn
        are the runs in the argument `series`: the attribute `series`, or rows of it. The left wheel is paler."""
        chosen = plot.chosen(panels)
        labels = [name for name in self.labels if name == "controller" or series[name].nunique() > 1] or ["controller"]
        drawn: list[str] = []
        for values, run in series.groupby(labels, sort=False):
            name = run["controller"].iloc[0]
            look = figures.LOOKS[name].line
            if labels != ["controller"]:  # runs of the same controller differ by the style of their line
                dashes = _DASHES[drawn.count(name) % 4] if name in drawn else look["linestyle"]
                look = look | {"label": ", ".join(map(str, values)), "linestyle": dashes}
            drawn.append(name)
            plot.draw(axes, chosen, run, look, "front")
        plot.draw_set_points(axes, chosen, run, "front")


def compare(
    scenario: str | Scenario | list | Mapping[str, Scenario],
    controllers: Sequence[str] | Mapping[str, str | dict],
    setting: str | list = PAPER,
    *,
    car: Mapping[str, World] | None = None,
    solver: str = "rti",
    noise_seed: int = 101,
    stride: int = 20,
    **changes,
) -> Comparison:
    """Simulate controllers in a scenario and return metrics and series as a `Comparison`. An argument given as a list
    gives a run per value, in all combinations. Each list or mapping is a label of the runs, also with one entry.

    Args:
        scenario (str, Scenario, list or mapping): Name in data/scenarios.toml or a `Scenario`; a list of these, or a
            mapping of names to scenarios.
        controllers (sequence or mapping): Keys of `CONTROLLERS`, as "nmpc", "ltv_mpc", "ndi"; or a mapping of names in
            tables to keys, or to dicts with the entry controller (a key) and, if needed, r_times (factor on the weight
            R of NMPC or LTV-MPC) and fields of `Experiment`.
        setting (str or list): Conditions for which the controllers were tuned: "paper", exact measurements; "loop",
            sensors with noise and delays, which the runs then have, too.
        car (mapping, optional): Name -> `World`: a changed car with the parameters of all `controllers` and with
            sensors, as `replace(world(["ndi"]), vehicle={"body.mass": 3e4})`. With a `World` noise_seed is unused and
            setting is only a label.
        solver (str): Solver of NMPC: rti, gauss_newton or ipopt.
        noise_seed (int): Random seed of the sensors in the setting "loop".
        stride (int): The series have every n-th control cycle (1 ms).
        changes: Fields of `Scenario`, as speed_kmh=[80, 400], each a value or a list; fields of `Experiment` for all
            runs, as plant={"drive.lag": 0.01} or ride=True.
    """
    last = "case" if isinstance(controllers, Mapping) else "controller"
    controllers = [controllers] if isinstance(controllers, str) else controllers
    cases = controllers if isinstance(controllers, Mapping) else {name: name for name in controllers}
    named = scenario if isinstance(scenario, Mapping) else {getattr(one, "name", one): one for one in _values(scenario)}
    varied = {name: value for name, value in changes.items() if isinstance(value, list)}
    grid = {"car": list(car or [""]), "setting": _values(setting), "scenario": list(named), **varied}
    listed = {"car": bool(car), "setting": isinstance(setting, list), "scenario": isinstance(scenario, list | Mapping)}
    labels = [name for name in grid if listed.get(name, True)]
    experiments = []
    for *values, case in product(*grid.values(), cases):
        point = dict(zip(grid, values, strict=True))
        given = changes | {name: point[name] for name in varied}
        more = {name: value for name, value in given.items() if name not in _OF_SCENARIO}
        more |= cases[case] if isinstance(cases[case], dict) else {"controller": cases[case]}
        name, factor = more.pop("controller"), more.pop("r_times", None)
        at = car[point["car"]] if car else world([name], point["setting"], noise_seed)
        if factor is not None:
            more["parameters"] = with_r_times(at.parameters[name], factor(at) if callable(factor) else factor)
        driven = named[point["scenario"]]
        driven = driven if isinstance(driven, Scenario) else at.scenario(driven)
        driven = driven.but(**{name: value for name, value in given.items() if name in _OF_SCENARIO})
        label = {key: value for key, value in point.items() if key != "scenario" or key in labels} | {"case": case}
        more = {"options": CONTROLLERS[name].quick and {"solver": solver}} | more
        experiments.append(at.experiment(driven, name, label=label, stride=stride, **more))
    rows, series = run_all(experiments, "runs")
    if series is None:
        raise InputError("compare: there is no run, because a list of what to simulate is empty or the stride is 0")
    return Comparison(rows, series, (*labels, last))


def _values(given) -> list:
    return given if isinstance(given, list) else [given]
