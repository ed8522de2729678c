"""Exported controllers: coupled with the car's FMU they give the run of `simulate`, also with other parameters."""

import re
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
from units import Instance

from railrepro import paths
from railrepro.compile import cache
from railrepro.control import interface
from railrepro.control.ndi import NDI
from railrepro.control.registry import guidance
from railrepro.estimation.sensors import readings
from railrepro.export import live
from railrepro.export.car import INPUTS, export_fmu
from railrepro.export.controller import Export
from railrepro.model.parameters import PARAMETERS
from railrepro.own.lqg import LqgPreview
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

SCENARIO = load_scenario("curve_entry_T3").but(end_m=70.0)
MPC = {"q_psi_TrAx": 1.0, "q_psidot_Ax": 1e-3, "r": 1e-11, "q_terminal": 10.0, "period_ms": 10, "horizon_s": 0.4}
REAL_TIME = {"solver": "rti"}
GUIDANCE = {
    "ndi": NDI(30.0, 20.0, 0.8, integral=0.05, rates=True),
    "nmpc_observer": guidance("nmpc_observer", MPC | {"observer": 0.05}, REAL_TIME),
    "ltv_mpc": guidance("ltv_mpc", MPC),
    "ltv_mpc_printed": guidance("ltv_mpc_printed", MPC),
    "lqg_preview": LqgPreview(),
}
COUPLED = [(name, False) for name in GUIDANCE] + [(name, True) for name in ("ndi", "nmpc_observer", "lqg_preview")]
LAW, BRISK = NDI(30.0, 20.0, 0.8), NDI(40.0, 40.0, 1.0)
Y = ["front.y", "rear.y"]


@pytest.fixture(autouse=True, scope="module")
def quickly_compiled():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
        yield


@pytest.fixture(scope="module")
def units(tmp_path_factory):
    folder, route = tmp_path_factory.mktemp("units"), SCENARIO.route()
    return {
        "car": export_fmu(folder / "car.fmu", route, SCENARIO.speed),
        "ndi": Export(LAW, route).write_fmu(folder / "ndi.fmu"),
        "nmpc": Export(guidance("nmpc", MPC, REAL_TIME), route).write_fmu(folder / "nmpc.fmu"),
        "lqg": Export(GUIDANCE["lqg_preview"], route).write_fmu(folder / "lqg.fmu"),
    }


def paths_of(run):
    return run.series[Y].to_numpy()[:-1]


def block(language):
    """The only program in a language on the page about coupling."""
    page = (paths.NOTEBOOKS / "book/couple.md").read_text()
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    return found


@pytest.fixture
def printed(tmp_path, monkeypatch):
    """Function that returns the output of a C program which includes the exported source of a law."""
    monkeypatch.chdir(tmp_path)

    def output(program, law, route):
        Export(law, route).write_source("controller.c")
        Path("main.c").write_text(program)
        subprocess.run([cache.compiler(), "-O0", "-w", "main.c", "-o", "main", "-lm"], check=True)
        return subprocess.run(["./main"], capture_output=True, text=True, check=True).stdout

    return output


def coupled(car, controller, cycles):
    """Lateral positions of both gears under a master that steps the controller before the car."""
    found = []
    for _ in range(cycles):
        found.append(car.get(Y))
        controller.set(interface.MEASURED, car.get(interface.MEASURED))
        controller.step()
        car.set(INPUTS, controller.get(INPUTS))
        car.step()
    return np.array(found)


@pytest.mark.parametrize(("name", "sensed"), COUPLED)
def test_car_and_controller_coupled_in_fmpy_give_the_run(units, name, sensed, tmp_path):
    sensors = readings(seed=3) if sensed else None
    expected = paths_of(simulate.run(SCENARIO, GUIDANCE[name], sensors=sensors))
    export = Export(GUIDANCE[name], SCENARIO.route(), sensors=sensors)
    controller = Instance(export.write_fmu(tmp_path / "controller.fmu"))
    assert np.abs(expected).max() > 1e-4
    assert coupled(Instance(units["car"]), controller, len(expected)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "changed", "law"),
    [
        ("ndi", {f"lateral.{key}": value for key, value in BRISK.gains().items()}, BRISK),
        ("nmpc", {"cost.r": 10 * MPC["r"]}, guidance("nmpc", MPC | {"r": 10 * MPC["r"]}, REAL_TIME)),
    ],
)
def test_fmus_with_other_parameters_give_the_run_with_the_same_change(units, name, changed, law):
    scenario = SCENARIO.but(speed_kmh=250.0)
    plant = load_vehicle(**{"body.mass": 30000.0, "drive.lag": 0.008, "adhesion.dry.mu0": 0.2})
    expected = paths_of(simulate.run(scenario, law, plant_vehicle=plant))
    in_fmu = {"body.mass": 30000.0, "drive.lag": 0.008, "adhesion.good.mu0": 0.2, "speed": scenario.speed}
    found = coupled(Instance(units["car"], parameters=in_fmu), Instance(units[name], parameters=changed), len(expected))
    assert (found == expected).all()
    unchanged = paths_of(simulate.run(scenario, law))
    assert abs(unchanged[: len(found)] - expected[: len(unchanged)]).max() > 1e-6


@pytest.mark.parametrize(("inertia", "counts"), [(1e-300, [0, 2, 4]), (1e3, [0, 0, 0])])
def test_samples_that_are_not_solved_are_counted(units, inertia, counts):
    """A prediction model with the smaller inertia overflows."""
    parameters = dict.fromkeys(("belief.J_z", "belief.J_Wz", "belief.J_Wy"), inertia)
    car, controller, found = Instance(units["car"]), Instance(units["nmpc"], parameters=parameters), []
    for cycles in (0, 1, 10):
        coupled(car, controller, cycles)
        found.append(controller.count("fallbacks"))
    assert found == counts


def test_a_law_that_returns_nan_is_an_error_and_gives_no_torque(tmp_path):
    class Root:
        def torque(self, q):
            return 1e6 * (q.y + 1e-3) ** 0.5

    controller = Instance(Export(Root(), SCENARIO.route()).write_fmu(tmp_path / "root.fmu"))
    controller.set(["front.v", "front.y"], [77.8, 0.0])
    controller.step()
    assert min(map(abs, controller.get(INPUTS)[:2])) > 1000
    controller.set(["front.y"], [-2e-3])
    with controller.refused():
        controller.step()
    assert controller.get(INPUTS) == [0.0] * 4


@pytest.mark.parametrize("which", ["ndi", "nmpc", "lqg"])
def test_a_state_continues_bit_for_bit_in_the_same_and_in_another_instance(units, which):
    files = units["car"], units[which]
    pair = [Instance(file) for file in files]
    coupled(*pair, 40)
    states, times = [one.slave.getFMUState() for one in pair], [one.time for one in pair]
    packed = [one.slave.serializeFMUState(state) for one, state in zip(pair, states, strict=True)]
    expected = coupled(*pair, 60)
    for one, state, time in zip(pair, states, times, strict=True):
        one.slave.setFMUState(state)
        one.slave.freeFMUState(state)
        one.time = time
    assert (coupled(*pair, 60) == expected).all()
    others = [Instance(file) for file in files]
    for one in pair:  # a serialised state must not point to their memory
        one.slave.freeInstance()
    for one, content, time in zip(others, packed, times, strict=True):
        one.slave.setFMUState(one.slave.deserializeFMUState(content))
        one.time = time
    assert (coupled(*others, 60) == expected).all()
    for content in (b"?" + packed[0][1:], packed[0][:-1], b""):
        with others[0].refused():
            others[0].slave.deserializeFMUState(content)


def test_a_forecast_as_printed_is_exported():
    fmu = Export(guidance("nmpc", MPC, variant="D4"), SCENARIO.route()).fmu()
    values = {one.name: one.value for one in fmu.parameters}
    assert values["forecast.rear.acceleration_per_torque"] < 0 < values["forecast.rear.m_CB"]


def test_a_value_out_of_range_is_refused_and_a_reset_restores_parameters(units):
    wrong = [("car", "body.mass", 1.0), ("ndi", "adhesion.corridor", -0.1), ("nmpc", "cost.period", 0.02)]
    wrong += [("car", "tau_front_le", -100001.0), *(("nmpc", f"{gear}.v", -5.0) for gear in ("front", "rear"))]
    wrong += [("nmpc", name, value) for name in interface.MEASURED for value in (np.nan, np.inf, -1e9)]
    wrong += [("ndi", "lateral.k0", 0.0), ("ndi", "adhesion.active", 2.0), ("ndi", "model.r_0", 0.0)]
    wrong += [("nmpc", "cost.r", -1.0), ("nmpc", "cost.q_y_TrAx", 0.0), ("nmpc", "limit.lateral", 1.0)]
    wrong += [("nmpc", f"belief.{name}", value) for name in PARAMETERS for value in (-1e15, np.nan)]
    wrong += [("nmpc", f"belief.{name}", 0.0) for name in ("m", "J_z", "r_0", "b", "g")]
    for unit, name, value in wrong:
        instance = Instance(units[unit], begun=False)
        with instance.refused() as said:
            instance.begin({name: value})
        assert name in said[0]
    car = Instance(units["car"], parameters={"speed": 50.0})
    assert car.get(["front.v", "speed"]) == [50.0, 50.0]
    before = car.get(["front.p"])
    car.step(0.05)
    car.slave.reset()
    assert car.get(["speed", "front.v", "front.p"]) == [SCENARIO.speed, SCENARIO.speed, *before]


def test_exports_contain_the_licences_of_their_parts(units, tmp_path):
    exported = [Export(LAW, SCENARIO.route()).write_source(tmp_path / "controller.c").read_text(), live.page({})]
    exported += [zipfile.ZipFile(units[name]).read("sources/all.c").decode() for name in ("car", "ndi", "nmpc")]
    for text in exported:
        assert "Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved." in text
        assert "is freely granted, provided that this notice is preserved." in " ".join(text.split())
    assert Path(live.__file__).with_name("page").joinpath("uPlot.LICENSE").read_text() in live.page({})


def test_the_program_of_the_page_gives_the_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(block("python"), "couple.md", "exec"), names)
    expected = simulate.run(names["scenario"], LAW).series[["front.p", "front.y"]].to_numpy()[1:]
    assert len(expected) > 850 and np.abs(expected[:, 1]).max() > 1e-4
    n = min(len(expected), len(names["path"]))
    assert np.array(names["path"][:n]) == pytest.approx(expected[:n], abs=1e-9)


SPOILT = """
#include <stdio.h>
#include "controller.c"

int main(void) {
  static controller_t c, other;
  const double bad[] = {NAN, INFINITY, -1e300};
  int wrong = 0;
  controller_reset(&c), controller_reset(&other);
  for (int ms = 0; ms < 30; ++ms) {
    c.measured[MEASURED_FRONT_V] = c.measured[MEASURED_REAR_V] = 77.8, c.measured[MEASURED_FRONT_Y] = 1e-3;
    for (int i = 0; i < N_INPUT + N_PARAMETER; ++i)
      for (int k = 0; k < 3; ++k) {
        double *number = i < N_INPUT ? c.measured + i : c.parameters + (i - N_INPUT), kept = *number;
        *number = bad[k], wrong += controller_step(&c) != CONTROLLER_REFUSED, *number = kept;
        for (int wheel = 0; wheel < N_OUTPUT; ++wheel) wrong += c.torque[wheel] != 0;
      }
    memcpy(other.measured, c.measured, sizeof c.measured);
    wrong += controller_step(&c) != CONTROLLER_OK || controller_step(&other) != CONTROLLER_OK || !c.torque[0];
    wrong += memcmp(c.torque, other.torque, sizeof c.torque) != 0;
    const controller_t copy = other;
    memset(&other, 0xff, sizeof other), other = copy;
  }
  printf("%d", wrong);
  return 0;
}
"""


@pytest.mark.parametrize("law", [LAW, guidance("nmpc", MPC, REAL_TIME)], ids=["ndi", "nmpc"])
def test_the_c_refuses_invalid_numbers_without_a_change_of_its_state(law, printed):
    assert printed(SPOILT, law, SCENARIO.route()) == "0"


def test_the_c_of_the_page_steers_back_and_needs_no_more_than_mathematics(printed):
    route = load_scenario("sine_tracking").but(set_point={"kind": "none"}, end_m=50.0).route()
    front_le, front_ri, rear_le, rear_ri = map(float, printed(block("c"), LAW, route).split())
    assert front_le < 0 < front_ri  # 1 mm to the right of the set point, so to the left
    assert rear_le == pytest.approx(0, abs=1e-3) and rear_ri == pytest.approx(0, abs=1e-3)
    if shutil.which("nm") is None:
        pytest.skip("it steers back; without nm the symbols that it needs are unknown")
    subprocess.run([cache.compiler(), "-O1", "-w", "-c", "controller.c"], check=True)
    lines = subprocess.run(["nm", "-u", "controller.o"], capture_output=True, text=True, check=True).stdout.splitlines()
    needed = {line.split()[-1] for line in lines if not line.split()[-1].startswith("_")}
    assert needed <= {"sqrt", "floor", "memcpy", "memset", "memmove"}
