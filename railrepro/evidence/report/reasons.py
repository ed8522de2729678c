"""Numbers in prose: placeholders of data/claims.toml and of the page, filled in from the results.

{equal: scenario/controller/metric unit} is a metric in some setting, {printed: what} a number of
data/paper_numbers.csv, {name} an entry of `NAMED`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.car.equations import BODIES, COORDINATES, WHEELS
from railrepro.errors import InputError
from railrepro.evidence.claims import statements
from railrepro.evidence.claims.nominal import Nominal
from railrepro.evidence.claims.statements import MissingEvidence
from railrepro.evidence.runs import tuning
from railrepro.evidence.uncertainty.robustness import LABELS, holds
from railrepro.simulation.scenarios import load_scenario

UNKNOWN = "n/a"
NAMED: dict[str, Callable[[Nominal], str]] = {}
_PLACE = re.compile(r"\{(?:(\w+): ([^{}/]+)/([^{}/]+)/(\w+)(?: (mm|m|%))?|printed: ([^{}]+)|(\w+))\}")
_PRINTED = "data/paper_numbers.csv"


def named(function: Callable[[Nominal], str]) -> Callable:
    """Register a number of the prose under the name of its function."""
    NAMED[function.__name__.strip("_")] = function
    return function


def filled(text: str, nominal: Nominal, linked: bool = False) -> str:
    """A text with its placeholders filled in; `linked`: each number is a Markdown link to the file that it comes from.

    Raises
    ------
    InputError
        When a placeholder names no number. One that the results do not have reads n/a.
    """

    def number(match: re.Match) -> str:
        setting, scenario, controller, metric, unit, printed, name = match.groups()
        if setting and setting not in tuning.SETTINGS:
            raise InputError(f"{match[0]}: {setting!r} is no setting; there are {', '.join(tuning.SETTINGS)}")
        if name and name not in NAMED:
            raise InputError(f"{match[0]}: is no number of the prose; there are {', '.join(sorted(NAMED))}")
        try:
            if printed:
                value, files = _printed(printed), [_PRINTED]
            elif name:
                value, files = nominal.traced(lambda: NAMED[name](nominal))
            else:
                value, files = nominal.traced(
                    lambda: quantity(nominal.evidence(setting)(scenario, controller, metric), unit or "")
                )
        except MissingEvidence:
            value, files = UNKNOWN, []
        return link(value, files) if linked else value

    return _PLACE.sub(number, text)


def link(value: str, files: list[str]) -> str:
    """A number as a Markdown link to the first of the files that it comes from; bare when there is none."""
    return f"[{value}]({files[0]})" if files and value != UNKNOWN else value


def _printed(what: str) -> str:
    """A number that the paper prints, with its unit."""
    table = pd.read_csv(paths.source(_PRINTED), dtype=str).set_index("what")
    if what not in table.index:
        raise InputError(f"{{printed: {what}}}: paper_numbers.csv has no such number")
    return f"{table.loc[what, 'paper']} {table.loc[what, 'unit']}".removesuffix(" -")


def quantity(value: float, unit: str = "") -> str:
    """A number with three digits, and its unit; "derailed" for an infinite one."""
    if np.isinf(value):
        return "derailed"
    if np.isnan(value):
        return UNKNOWN
    shown = {"mm": 1e3, "%": 100.0}.get(unit, 1.0) * value
    return (f"{shown:.3g}" if abs(shown) < 100 else f"{shown:.1f}".removesuffix(".0")) + (f" {unit}" if unit else "")


def _poles(nominal: Nominal) -> pd.DataFrame:
    """Error of NDI on T3 (mm) by its triple pole (rad/s), on the scale of NMPC."""
    return nominal.results("ndi_poles").sort_values("pole_radps", kind="stable")


@named
def _pole_follows(nominal: Nominal) -> str:
    """Triple pole from which NDI on T3 stays below 0.71 of the error of y = 0 (rad/s)."""
    table, idle = _poles(nominal), nominal.evidence("paper")("curve_entry_T3", "nothing", "rmse_y")
    limit = 0.71e3 * idle
    if table["rmse_mm"].iloc[-1] > limit or table["rmse_mm"].iloc[0] < limit:
        return UNKNOWN
    return f"{np.interp(-limit, -table['rmse_mm'], table['pole_radps']):.0f}"


@named
def _poles_ratio(nominal: Nominal) -> str:
    """Error of NDI over that of NMPC on T3 in the setting `paper`."""
    errors = [nominal.evidence("paper")("curve_entry_T3", name, "rmse_y") for name in ("ndi", "nmpc")]
    return quantity(errors[0] / errors[1])


@named
def _least_ndi(nominal: Nominal) -> str:
    """Least error of NDI on T3 over all its triple poles (mm)."""
    return quantity(_poles(nominal)["rmse_mm"].min())


@named
def _largest_pole(nominal: Nominal) -> str:
    return quantity(_poles(nominal)["pole_radps"].max())


@named
def _saved_paper(nominal: Nominal) -> str:
    """Stopping distance that the second setting of R saves in the setting `paper` (m)."""
    first, second = (
        nominal.evidence("paper")("braking", name, "stopping_distance") for name in ("nmpc", "nmpc, second R")
    )
    return quantity(first - second)


@named
def _drift_left(nominal: Nominal) -> str:
    """Share of the drift that NMPC of the setting `paper` keeps when its wheels nearly roll."""
    return quantity(statements.find("C13", nominal.evidence("paper")).value, "%")


@named
def _drift_left_equal(nominal: Nominal) -> str:
    return quantity(statements.find("C13", nominal.evidence("equal")).value, "%")


def _table_one(nominal: Nominal, track: str) -> str:
    return f"{nominal.results('table1').set_index('track').loc[track, 'b_sin_phi_m']:.4f}"


NAMED |= {f"table1_T{i}": partial(_table_one, track=f"T{i}") for i in (1, 2, 3, 4)}


@named
def _error_at_opposed_crests(nominal: Nominal) -> str:
    return quantity(nominal.evidence("paper")("curve_entry_T3", "nmpc", "error_at_opposed_crests"))


def _median(nominal: Nominal, solver: str, column: str = "median_ms") -> float:
    """Median over the scenarios of what a solver needs with NMPC of the setting `paper`."""
    return float(statements.usual_times(nominal.evidence("paper"), solver, column).median())


NAMED |= {
    "ipopt_ms": lambda nominal: quantity(_median(nominal, "ipopt")),
    "nmpc_ms": lambda nominal: quantity(_median(nominal, "gauss_newton")),
    "ltv_ms": lambda nominal: quantity(_median(nominal, "ltv_mpc")),
}


@named
def _time_ratio(nominal: Nominal) -> str:
    return quantity(_median(nominal, "gauss_newton") / _median(nominal, "ltv_mpc"))


@named
def _iterations(nominal: Nominal) -> str:
    """Iterations of one nonlinear problem over those of a linear one."""
    return quantity(
        _median(nominal, "gauss_newton", "iterations_median") / _median(nominal, "ltv_mpc", "iterations_median")
    )


@named
def _cones_left(nominal: Nominal) -> str:
    """How far below its limit C35 lies in the setting `paper` (%)."""
    return quantity(100 * (1 - statements.find("C35", nominal.evidence("paper")).value))


@named
def _reached_m(nominal: Nominal) -> str:
    table = nominal.results("adhesion_metrics").query("experiment == 'fig08'").set_index("case")["reached_m"]
    return quantity(table["NMPC, R x 10"])


@named
def _allocation_gain(nominal: Nominal) -> str:
    return quantity(100 * statements.find("C34", nominal.evidence("paper")).value)


def _preview_error(nominal: Nominal, error: str) -> str:
    table = nominal.results("preview_errors").query("controller == 'nmpc' and error == @error")["rail_rmse_y"]
    return quantity(float(table.iloc[0]), "mm") if len(table) else UNKNOWN


NAMED |= {
    "error_0m": lambda nominal: _preview_error(nominal, "0 m"),
    "error_2m": lambda nominal: _preview_error(nominal, "2 m"),
}


@named
def _forecast_shift(nominal: Nominal) -> str:
    """What the mean braking of Fig. 9 moves the forecast over the horizon of NMPC of the setting `paper` (cm)."""
    horizon = tuning.load("nmpc", tuning.PAPER)["parameters"]["horizon_s"]
    way = nominal.evidence(tuning.PAPER)("braking", "nmpc", "stopping_distance")
    return quantity(100 * load_scenario("braking").speed ** 2 / (2 * way) * horizon**2 / 2, "cm")


@named
def _degrees_of_freedom(nominal: Nominal) -> str:
    """Those of the bodies, and one per wheel."""
    nominal.results.file("railrepro/car/equations.py")
    return f"{len(BODIES) * len(COORDINATES) // 2 + len(WHEELS)}"


@named
def _errata(nominal: Nominal) -> str:
    return f"{len(pd.read_csv(nominal.results.file('data/discrepancies.csv')))}"


@named
def _designed_pole(nominal: Nominal) -> str:
    nominal.results.file("data/tuning.toml")
    return quantity(tuning.load("ndi", "paper")["parameters"]["pole"])


@named
def _swarms(nominal: Nominal) -> str:
    nominal.results.file("data/tuning.toml")
    return f"{len(tuning.load_task().budget['seeds'])}"


def _set_point(nominal: Nominal, scenario: str) -> str:
    """Amplitude and wavelengths of a scenario's set point."""
    nominal.results.file("data/scenarios.toml")
    point = load_scenario(scenario).set_point
    waves = [f"{value:g}" for key, value in point.items() if key.startswith("period")]
    return f"{point['amplitude_mm']:g} mm, {' to '.join(waves)} m"


NAMED |= {
    "sweep_on_t3": lambda nominal: _set_point(nominal, "curve_entry_T3"),
    "sine_on_t5": lambda nominal: _set_point(nominal, "sine_tracking"),
    "sine_on_poor": lambda nominal: _set_point(nominal, "adhesion_loss"),
}


@lru_cache(maxsize=1)
def _sampled(file: Path, _changed: int) -> pd.DataFrame:
    """Which statement holds in which sample of the setting `paper`, with the values drawn."""
    table = pd.read_csv(file)
    if not set(LABELS) <= set(table):
        raise MissingEvidence("robustness")
    table = table[table["setting"] == "paper"].reset_index(drop=True)
    drawn = [name for name in table if "/" not in name and name not in LABELS]
    return holds(table).join(table[drawn])


def _share(nominal: Nominal, identity: str, chosen: Callable[[pd.DataFrame], pd.Series]) -> str:
    """Share (%) of some samples of the setting `paper` in which a statement holds."""
    if nominal.results.optional("robustness_samples") is None:
        raise MissingEvidence("robustness")
    file = nominal.results.file("data/results/robustness_samples.csv")
    rows = _sampled(file, file.stat().st_mtime_ns)
    return quantity(100 * float(rows.loc[chosen(rows), identity].astype(float).mean()))


def _third(parameter: str, last: bool = False) -> Callable[[pd.DataFrame], pd.Series]:
    """The third of the samples with the smallest values of a parameter, or the largest."""

    def chosen(rows: pd.DataFrame) -> pd.Series:
        place = rows[parameter].rank(pct=True)
        return place > 2 / 3 if last else place <= 1 / 3

    return chosen


def _by_profile(nominal: Nominal, identity: str, profile: str) -> str:
    """Share (%) of the samples of the setting `paper` with a profile in which a statement holds."""
    table = nominal.results.optional("robustness_claims")
    if table is None or not {"id", "setting", profile} <= set(table):
        raise MissingEvidence("robustness")
    found = table.query("id == @identity and setting == 'paper'")[profile]
    return quantity(100 * float(found.iloc[0])) if len(found) else UNKNOWN


NAMED |= {
    "c12_s1002": lambda nominal: _by_profile(nominal, "C12", "s1002"),
    "c12_cones": lambda nominal: _by_profile(nominal, "C12", "cone"),
    "c30_s1002": lambda nominal: _by_profile(nominal, "C30", "s1002"),
    "c30_cones": lambda nominal: _by_profile(nominal, "C30", "cone"),
    "c31_smallest_r": lambda nominal: _share(nominal, "C31", _third("r_brake")),
    "c31_largest_r": lambda nominal: _share(nominal, "C31", _third("r_brake", last=True)),
    "c36_shortest_lag": lambda nominal: _share(nominal, "C36", _third("drive.lag")),
    "c36_longest_lag": lambda nominal: _share(nominal, "C36", _third("drive.lag", last=True)),
}
