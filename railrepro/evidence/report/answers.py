"""The filled answer sheet: which verdicts flip, and how far our curves are from digitised ones.

`make answers` (`python -m railrepro answers [FILE]`) reads data/answers.toml or another sheet, writes build/answers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from railrepro import paths
from railrepro.control.registry import with_r_times
from railrepro.errors import InputError
from railrepro.evidence.claims import answers, probe
from railrepro.evidence.claims.statements import LOSS, NDI, SOFTEST, T3
from railrepro.evidence.report import figures
from railrepro.evidence.runs.experiment import tidy
from railrepro.files import write
from railrepro.simulation import metrics
from railrepro.simulation.scenarios import Scenario, load_scenario

_X = {"fig06": "p_m", "fig07": "speed_kmh", "fig08": "p_m", "fig09": "p_m"}
_Y = {"fig06": "y_mm", "fig07": "rmse_mm", "fig08": "y_mm", "fig09": "y_mm"}
_NAMES = {"nmpc": "nmpc", "ltv_mpc": "ltv_mpc_printed", "ndi": NDI, "nmpc_second": SOFTEST}
_OF = {"fig08": ("nmpc",), "fig09": ("nmpc", "nmpc_second", "ndi")}


def digitised(name: str, file: Path) -> pd.DataFrame:
    """Curves of a figure of the paper: controller, x, y.

    Raises
    ------
    InputError
        When the file, a column, a controller or a number is not as needed.
    """
    x, y = _X[name], _Y[name]
    try:
        table = pd.read_csv(file)
    except (OSError, ValueError) as error:
        raise InputError(f"{file.name}: cannot be read as CSV ({error})") from error
    allowed = _OF.get(name, ("nmpc", "ltv_mpc", "ndi"))
    if not {"controller", x, y} <= set(table):
        raise InputError(f"{file.name}: has the columns {', '.join(table)}, needed are controller, {x}, {y}")
    unknown = set(table["controller"]) - set(allowed)
    if unknown:
        raise InputError(f"{file.name}: has the controller {min(unknown, key=str)!r}, allowed are {', '.join(allowed)}")
    values = table[[x, y]].apply(pd.to_numeric, errors="coerce")
    if values.empty or not np.isfinite(values).all(axis=None):
        raise InputError(f"{file.name}: {x} and {y} need finite numbers in each row")
    return pd.DataFrame({"controller": table["controller"], "x": values[x], "y": values[y]})


def ours(name: str, controllers: list[str], speeds: list[float], world: probe.ProbeSetup) -> dict[str, pd.DataFrame]:
    """Our curves of a figure by controller: x, y; a figure over speed is driven at the speeds that are asked for."""
    found = {}
    for controller in controllers:
        if name == "fig07":
            base = load_scenario("sine_tracking").but(good=world.good)
            errors = [_series(world, base.but(speed_kmh=float(v)), controller)[1] for v in speeds]
            found[controller] = pd.DataFrame({"x": speeds, "y": errors})
        else:
            series, _ = _series(world, _scenario(name, world), controller)
            found[controller] = pd.DataFrame({"x": series["p_m"], "y": 1e3 * series["y_m"]})
    return found


def _scenario(name: str, world: probe.ProbeSetup) -> Scenario:
    if name == "fig06":
        point = {key: getattr(world, key) for key in ("amplitude_mm", "period_start_m", "period_end_m")}
        base = load_scenario(T3)
        return base.but(good=world.good, set_point=base.set_point | point)
    return load_scenario(LOSS) if name == "fig08" else world.braking()


def _series(world: probe.ProbeSetup, scenario: Scenario, controller: str) -> tuple[pd.DataFrame, float]:
    """Series and error (mm) of a run; R as the figure has it."""
    key = _NAMES[controller] if controller != "nmpc_second" else "nmpc"
    parameters = world.parameters[key]
    if key == "nmpc":
        on = {LOSS: world.r_loss, "braking": world.r_brake * (world.r_second if controller != key else 1.0)}
        parameters = with_r_times(parameters, on.get(scenario.name, 1.0))
    run = world.experiment(scenario, key, parameters).run()
    return tidy(run.series, 1), 1e3 * metrics.rmse(run.series)


def distances(theirs: pd.DataFrame, own: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Root mean squared distance of our curves from digitised ones (mm), where both are: controller, rms_mm, points."""
    rows = []
    for controller, points in theirs.groupby("controller", sort=False):
        curve = own[str(controller)]
        inside = points[points["x"].between(curve["x"].min(), curve["x"].max())]
        apart = inside["y"] - np.interp(inside["x"], curve["x"], curve["y"])
        rms = float(np.sqrt(np.mean(apart**2))) if len(inside) else float("nan")
        rows.append({"controller": controller, "rms_mm": rms, "points": len(inside)})
    return pd.DataFrame(rows)


def overlay(name: str, theirs: pd.DataFrame, own: dict[str, pd.DataFrame]) -> Figure:
    """Digitised points over our curves."""
    figure, axes = figures.new_figure()
    for controller, curve in own.items():
        color = {"nmpc": figures.BLUE, "ndi": figures.RED}.get(controller, figures.GREEN)
        points = theirs[theirs["controller"] == controller]
        axes.plot(curve["x"], curve["y"], color=color, linewidth=0.8, label=f"{controller}, ours")
        axes.plot(points["x"], points["y"], "o", color=color, markersize=2.5, label=f"{controller}, the paper")
    axes.set(xlabel={"p_m": "track coordinate (m)"}.get(_X[name], "speed (km/h)"), ylabel="lateral position (mm)")
    if name == "fig07":
        axes.set_ylabel("RMSE of the lateral position (mm)")
    axes.legend()
    return figure


def main(sheet: str | None = None) -> None:
    """Read a sheet, drive what depends on its answers, print what flips; compare digitised curves."""
    read = answers.read(sheet)
    curves = {name: digitised(name, file) for name, file in read.curves.items()}
    if not read.answered and not curves:
        print(f"No slot is filled; write answers into {answers.SHEET} and run `make answers` again.")
        return
    world, folder = answers.setup(read.answered), paths.BUILD / "answers"
    if read.answered:
        found = answers.flips(read.answered)
        turned = found[found["before"] != found["after"]]
        write(folder / "verdicts.csv", found.to_csv(index=False))
        print(f"{len(read.answered)} answers, {len(found)} statements judged again, {len(turned)} verdicts flip:")
        for row in turned.itertuples():
            print(f"  {row.id}: {row.before} -> {row.after} ({row.statement})")
    for name, theirs in curves.items():
        own = ours(name, list(dict.fromkeys(theirs["controller"])), sorted(set(theirs["x"])), world)
        table = distances(theirs, own)
        print(f"{name}, distance of our curves from the digitised ones:\n{table.to_string(index=False)}")
        folder.mkdir(parents=True, exist_ok=True)
        overlay(name, theirs, own).savefig(folder / f"{name}.png")
