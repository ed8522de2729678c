"""A controller taken away: coupled with the unit of the car it drives as in a run; its C needs nothing from outside."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from railrepro.compile import cache
from railrepro.control import interface
from railrepro.control.law import LawSettings
from railrepro.control.ndi import NDI
from railrepro.control.registry import guidance
from railrepro.estimation.sensors import readings
from railrepro.export.car import export_fmu
from railrepro.export.controller import TORQUES, Export
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario

SCENARIO = load_scenario("curve_entry_T3").but(end_m=70.0)
MPC = {"q_psi_TrAx": 1.0, "q_psidot_Ax": 1e-3, "r": 1e-11, "q_terminal": 10.0, "period_ms": 10, "horizon_s": 0.4}
GUIDANCE = {
    "ndi": NDI(30.0, 20.0, 0.8, integral=0.05, derivatives=3),
    "nmpc_observer": guidance("nmpc_observer", MPC | {"observer": 0.05}, {"solver": "rti"}),
    "ltv_mpc": guidance("ltv_mpc", MPC),
    "ltv_mpc_printed": guidance("ltv_mpc_printed", MPC),
    "lqg_preview": guidance("lqg_preview", {}),
}


@pytest.fixture(autouse=True)
def quickly_compiled(monkeypatch):
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")


def coupled(car, controller, cycles):
    """Lateral positions of both gears under a master that steps the controller before the car."""
    found = []
    for _ in range(cycles):
        found.append(car.get(["front.y", "rear.y"]))
        controller.set(interface.MEASURED, car.get(interface.MEASURED))
        controller.step()
        car.set(TORQUES, controller.get(TORQUES))
        car.step()
    return np.array(found)


@pytest.mark.parametrize("name", GUIDANCE)
def test_car_and_controller_coupled_in_fmpy_drive_as_in_a_run(name, tmp_path):
    from units import Instance

    run = simulate.run(SCENARIO, GUIDANCE[name])
    route = SCENARIO.route()
    car = Instance(export_fmu(tmp_path / "car.fmu", route, SCENARIO.speed))
    controller = Instance(Export(GUIDANCE[name], route).write_fmu(tmp_path / "controller.fmu"))
    expected = run.series[["front.y", "rear.y"]].to_numpy()[:-1]
    found = coupled(car, controller, len(expected))
    assert np.abs(expected).max() > 1e-4
    assert found == pytest.approx(expected, abs=1e-9)  # asked for is 1e-6


def driven(source, folder, series):
    """Torques of the C of a controller that measures what a run measured, and the names that it wants from outside."""
    file = folder / "controller.c"
    file.write_text(source + "\nunsigned long size(void) { return sizeof(controller_t); }\n")
    options = ["-O1", "-ffp-contract=off", "-shared", "-fPIC", "-w", file, "-o", file.with_suffix(".so"), "-lm"]
    subprocess.run([cache.compiler(), *options], check=True)
    library = ctypes.CDLL(str(file.with_suffix(".so")))
    memory = ctypes.create_string_buffer(library.size())
    numbers = np.frombuffer(memory, dtype=float, count=len(interface.MEASURED) + len(TORQUES))
    library.controller_reset(memory)
    torques = []
    for row in series[list(interface.MEASURED)].to_numpy():
        numbers[: len(interface.MEASURED)] = row
        assert library.controller_step(memory) == 0
        torques.append(numbers[len(interface.MEASURED) :].copy())
    if shutil.which("nm") is None:
        return np.array(torques), None
    wanted = subprocess.run(
        ["nm", "-D", "--undefined-only", file.with_suffix(".so")], capture_output=True, text=True
    ).stdout
    return np.array(torques), {line.split()[-1].partition("@")[0] for line in wanted.splitlines()}


@pytest.mark.parametrize("name", ["ndi", "nmpc_observer"])
def test_the_c_behind_sensors_gives_the_torques_of_a_run_and_needs_nothing(name, tmp_path):
    seen = readings(seed=3)
    series = simulate.run(SCENARIO, GUIDANCE[name], sensors=seen).series
    source = Export(GUIDANCE[name], SCENARIO.route(), settings=LawSettings(sensors=seen)).source()
    torques, wanted = driven(source, tmp_path, series)
    du = (torques[:, 0] - torques[:, 1]) / 2
    late = round(seen.loop.latency.command / 1e-3)
    recorded = series["front.du"].to_numpy()
    assert np.abs(recorded).max() > 10
    assert du[late:] == pytest.approx(recorded[: len(recorded) - late], abs=1e-6)
    if wanted is None:
        pytest.skip("the torques are right; there is no nm to tell what the object needs")
    mathematics = {"sin", "cos", "tan", "sqrt", "exp", "log", "fabs", "floor", "fmin", "fmax", "atan", "atan2", "pow"}
    assert {name for name in wanted if not name.startswith("_")} <= mathematics | {
        "tanh",
        "memcpy",
        "memset",
        "memmove",
    }
