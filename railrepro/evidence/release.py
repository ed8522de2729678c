"""Archive of a release: the repository, and the closed-loop runs of Figs. 6 to 9 as data for other programs. Its folder
`runs` has, per figure, the car on its route as an FMU, and per controller a CSV with one row per millisecond: the four
torque commands, named as the inputs of the FMU, and its outputs `front.y` and `rear.y` before the step with these
torques. Stepped by 1 ms with the torques of a file, the FMU gives its displacements to the last digit."""

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
"""Figure -> name of its scenario, names of its controllers."""


def exchanged(scenario: Scenario, controller: str) -> pd.DataFrame:
    """Simulate a controller with the parameters tuned for perfect measurements, and return what it and the car
    exchange, to check the car's FMU (`export_fmu`), one row per millisecond. `controller` is a key of
    `registry.CONTROLLERS` or "nmpc_r10" (R of NMPC times 10). Columns: t_s (s); torque commands named as the inputs of
    the FMU, tau_front_le to tau_rear_ri (N m); displacements front.y, rear.y (m)."""
    name, factor = ("nmpc", 10.0) if controller == TEN_TIMES else (controller, 1.0)
    tuned = parameters(name)
    series = Experiment(scenario, name, parameters=with_r_times(tuned, factor) if "r" in tuned else tuned).run().series
    columns = {"t_s": series["t_s"]}
    for gear in ("front", "rear"):
        common, du = series[f"{gear}.tau_long"], series[f"{gear}.du"]
        columns |= {f"tau_{gear}_le": common + du, f"tau_{gear}_ri": common - du}
    return pd.DataFrame(columns).join(series[["front.y", "rear.y"]])


def write_runs(folder: Path) -> list[Path]:
    """Write all files into one `folder`: for each of Figs. 6 to 9 the car on its route as an FMU, as fig06_car.fmu, and
    a table of `exchanged` per controller, as fig06_nmpc.csv. Returns their paths."""
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
    """Command `release`: write build/railrepro-VERSION.tar.gz, the committed files and the runs of Figs. 6 to 9
    (`write_runs`); InputError when a committed file was edited."""
    root, name = paths.ROOT, f"railrepro-{__version__}"
    if subprocess.run(["git", "-C", root, "diff", "--quiet", "HEAD"]).returncode:
        raise InputError("release: there are uncommitted changes, or this is no git repository")
    archive, added = root / f"build/{name}.tar.gz", [f"--add-file={file}" for file in write_runs(root / "build/runs")]
    prefixes = [f"--prefix={name}/runs/", *added, f"--prefix={name}/"]
    subprocess.run(["git", "-C", root, "archive", *prefixes, f"--output={archive}", "HEAD"], check=True)
    print(f"{archive.relative_to(root)}: {archive.stat().st_size / 1e6:.0f} MB")
