"""Archive of a release: the repository, and the closed-loop runs of Figs. 6 to 9 as data for other programs.

`python -m railrepro release` writes build/railrepro-VERSION.tar.gz by `git archive`. Its folder `runs` has, per figure,
the car on its route as an FMU, and per controller a CSV with a row per millisecond: the four torque commands, named as
the FMU's inputs, and its outputs `front.y` and `rear.y` before the step to which the torques belong. Stepped by 1 ms
with the torques of a file, the FMU gives its displacements to the last digit.
"""

from __future__ import annotations

import subprocess
from importlib.metadata import version
from pathlib import Path

import pandas as pd

from railrepro import paths
from railrepro.control.registry import PAPER_TRIO, with_r_times
from railrepro.data import InputError
from railrepro.evidence.runs import tuning
from railrepro.evidence.runs.experiment import Experiment
from railrepro.export.car import export_fmu
from railrepro.simulation.scenarios import Scenario, load_scenario

TEN_TIMES = "nmpc_r10"
"""Name of NMPC with ten times its tuned weight R."""
FIGURES = {
    "fig06": ("curve_entry_T3", PAPER_TRIO),
    "fig07": ("sine_tracking", PAPER_TRIO),
    "fig08": ("adhesion_loss", ("nmpc",)),
    "fig09": ("braking", ("nmpc", TEN_TIMES, "ndi")),
}
"""Figure -> name of its scenario, and its controllers."""


def exchanged(scenario: Scenario, controller: str) -> pd.DataFrame:
    """Simulate a controller with its tuned set of setting `paper`; returns one row per millisecond.

    Columns t_s; tau_front_le, tau_front_ri, tau_rear_le and tau_rear_ri, the torque commands (N m) as the inputs of the
    car's FMU; front.y and rear.y, the lateral positions (m). `controller` may be `TEN_TIMES`.
    """
    name = "nmpc" if controller == TEN_TIMES else controller
    parameters = tuning.load(name, tuning.PAPER)["parameters"]
    if controller == TEN_TIMES:
        parameters = with_r_times(parameters, 10.0)
    series = Experiment(scenario, name, parameters=parameters).run().series
    torques = {
        "tau_front_le": series["front.tau_long"] + series["front.du"],
        "tau_front_ri": series["front.tau_long"] - series["front.du"],
        "tau_rear_le": series["rear.tau_long"] + series["rear.du"],
        "tau_rear_ri": series["rear.tau_long"] - series["rear.du"],
    }
    return pd.DataFrame({"t_s": series["t_s"]} | torques | series[["front.y", "rear.y"]].to_dict("series"))


def write_runs(folder: Path) -> list[Path]:
    """Write the car's FMU and the runs (csv) of each of `FIGURES` to a folder; returns the paths of the files."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for figure, (name, controllers) in FIGURES.items():
        scenario = load_scenario(name)
        written.append(export_fmu(folder / f"{figure}_car.fmu", scenario.route(), scenario.speed))
        for controller in controllers:
            written.append(folder / f"{figure}_{controller}.csv")
            exchanged(scenario, controller).to_csv(written[-1], index=False)
            print(f"{written[-1].name}: {name}, {controller}")
    return written


def main() -> None:
    """Write build/railrepro-VERSION.tar.gz of committed files and runs; InputError when something is not committed."""
    root, name = paths.ROOT, f"railrepro-{version('railrepro')}"
    if subprocess.run(["git", "-C", root, "diff", "--quiet", "HEAD"]).returncode:
        raise InputError("release: there are changes that are not committed, or no git repository")
    files = write_runs(root / "build" / "runs")
    added = [f"--add-file={file}" for file in files]
    archive = root / "build" / f"{name}.tar.gz"
    prefixes = [f"--prefix={name}/runs/", *added, f"--prefix={name}/"]
    subprocess.run(["git", "-C", root, "archive", *prefixes, f"--output={archive}", "HEAD"], check=True)
    print(f"{archive.relative_to(root)}: {archive.stat().st_size / 1e6:.0f} MB")
