"""The page on coupling: its programs run as they stand and drive the trajectory of a run."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from railrepro import paths
from railrepro.compile import cache
from railrepro.control import interface
from railrepro.control.ndi import NDI
from railrepro.export.controller import TORQUES, Export
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario

pytest.importorskip("fmpy")
PAGE = (paths.NOTEBOOKS / "book/couple.md").read_text()


def block(language):
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    return found


@pytest.fixture(autouse=True)
def quickly_compiled_elsewhere(monkeypatch, tmp_path):
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
    monkeypatch.chdir(tmp_path)


def test_the_program_of_the_page_drives_the_trajectory_of_a_run():
    names = {}
    exec(compile(block("python"), "couple.md", "exec"), names)
    series = simulate.run(names["scenario"], NDI(30.0, 20.0, 0.8)).series
    expected = series[["front.p", "front.y"]].to_numpy()[1:]
    assert np.abs(expected[:, 1]).max() > 1e-4
    n = min(len(expected), len(names["path"]))
    assert n > 850
    assert np.array(names["path"][:n]) == pytest.approx(expected[:n], abs=1e-9)

    car, controller, moved = names["Unit"]("car.fmu"), names["Unit"]("controller.fmu"), []
    for k in range(n):  # both at once: what the page says of a Jacobi master
        measured, torques = car.get(interface.MEASURED), controller.get(TORQUES)
        controller.set(interface.MEASURED, measured)
        car.set(TORQUES, torques)
        for unit in (controller, car):
            unit.unit.doStep(1e-3 * k, 1e-3)
        moved.append(car.get(["front.y"])[0])
    assert 1e-6 < np.abs(np.array(moved) - expected[:n, 1]).max() < 1e-5


def test_the_c_of_the_page_compiles_and_steers_back():
    route = load_scenario("sine_tracking").but(set_point={"kind": "none"}, end_m=50.0).route()
    Export(NDI(30.0, 20.0, 0.8), route).write_source("controller.c")
    Path("main.c").write_text(block("c"))
    subprocess.run([cache.compiler(), "-O0", "-w", "main.c", "-o", "main", "-lm"], check=True)
    done = subprocess.run(["./main"], capture_output=True, text=True, check=True)
    front_le, front_ri, rear_le, rear_ri = map(float, done.stdout.split())
    assert front_le < 0 < front_ri  # 1 mm to the right of the set point, so to the left
    assert rear_le == pytest.approx(0, abs=1e-3) and rear_ri == pytest.approx(0, abs=1e-3)
