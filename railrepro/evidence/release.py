"""Archive of a release: the repository, and the closed-loop runs of Figs. 6 to 9 as data for other programs.

Its folder `runs` has, per figure, the car on its route as an FMU, and per controller a CSV with a row per millisecond:
the four torque commands, named as the FMU's inputs, and its outputs `front.y` and `rear.y` before the step to which the
torques belong. Stepped by 1 ms with the torques of a file, the FMU gives its displacements to the last digit.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import pandas as pd

from railrepro import __version__, paths
from railrepro.control.registry import PAPER_TRIO, parameters, with_r_times
from railrepro.data import InputError
from railrepro.export.car import export_fmu
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.studies.experiment import Experiment

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
    """Simulate a controller with its tuned set of the setting `paper`; returns one row per millisecond.

    `controller` is a key of `registry.CONTROLLERS`, or `TEN_TIMES`: NMPC with ten times its weight R. Columns: time
    (s), torque commands of the wheels as the FMU's inputs (N m), lateral positions of the gears (m).
    """
    name, factor = ("nmpc", 10.0) if controller == TEN_TIMES else (controller, 1.0)
    tuned = parameters(name)
    series = Experiment(scenario, name, parameters=with_r_times(tuned, factor) if "r" in tuned else tuned).run().series
    torques = {
        "tau_front_le": series["front.tau_long"] + series["front.du"],
        "tau_front_ri": series["front.tau_long"] - series["front.du"],
        "tau_rear_le": series["rear.tau_long"] + series["rear.du"],
        "tau_rear_ri": series["rear.tau_long"] - series["rear.du"],
    }
    return pd.DataFrame({"t_s": series["t_s"]} | torques | series[["front.y", "rear.y"]].to_dict("series"))


def write_runs(folder: Path) -> list[Path]:
    """Per figure of `FIGURES` write FIGURE_car.fmu and FIGURE_CONTROLLER.csv (`exchanged`) to a folder; their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for figure, (driven, controllers) in FIGURES.items():
        scenario = load_scenario(driven)
        files.append(export_fmu(folder / f"{figure}_car.fmu", scenario.route(), scenario.speed))
        for controller in controllers:
            files.append(folder / f"{figure}_{controller}.csv")
            exchanged(scenario, controller).to_csv(files[-1], index=False)
    return files


def main() -> None:
    """Write build/railrepro-VERSION.tar.gz: committed files (InputError if one was edited), files of `write_runs`."""
    root, name = paths.ROOT, f"railrepro-{__version__}"
    if subprocess.run(["git", "-C", root, "diff", "--quiet", "HEAD"]).returncode:
        raise InputError("release: there are changes that are not committed, or no git repository")
    archive, added = root / f"build/{name}.tar.gz", [f"--add-file={file}" for file in write_runs(root / "build/runs")]
    prefixes = [f"--prefix={name}/runs/", *added, f"--prefix={name}/"]
    subprocess.run(["git", "-C", root, "archive", *prefixes, f"--output={archive}", "HEAD"], check=True)
    print(f"{archive.relative_to(root)}: {archive.stat().st_size / 1e6:.0f} MB")
