"""Parameters of the FMUs: a run with them equals `simulate` with the same change; out of range they get a sentence."""

import pytest
from test_export import MPC, SCENARIO, coupled
from units import Instance, fmpy

from railrepro.control.ndi import NDI
from railrepro.control.registry import guidance
from railrepro.export.car import export_fmu
from railrepro.export.controller import Export
from railrepro.simulation import simulate
from railrepro.vehicle.parameters import load_vehicle

LAW = NDI(30.0, 20.0, 0.8)
BRISK = NDI(40.0, 40.0, 1.0)
CAR = {"body.mass": 30000.0, "drive.lag": 0.008, "adhesion.good.mu0": 0.2}
IN_VEHICLE = {"body.mass": 30000.0, "drive.lag": 0.008, "adhesion.dry.mu0": 0.2}


@pytest.fixture(scope="module")
def units(tmp_path_factory):
    folder = tmp_path_factory.mktemp("units")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
        route = SCENARIO.route()
        return {
            "car": export_fmu(folder / "car.fmu", route, SCENARIO.speed),
            "ndi": Export(LAW, route).write_fmu(folder / "ndi.fmu"),
            "nmpc": Export(guidance("nmpc", MPC, {"solver": "rti"}), route).write_fmu(folder / "nmpc.fmu"),
        }


def of_mpc(**changes):
    return guidance("nmpc", MPC | changes, {"solver": "rti"})


@pytest.mark.parametrize(
    ("name", "changed", "law"),
    [
        ("ndi", {f"lateral.{key}": value for key, value in BRISK.gains().items()}, BRISK),
        ("nmpc", {"cost.r": 10 * MPC["r"]}, of_mpc(r=10 * MPC["r"])),
    ],
)
def test_units_with_parameters_drive_as_a_run_with_the_same_change(units, name, changed, law):
    scenario = SCENARIO.but(speed_kmh=250.0)
    run = simulate.run(scenario, law, plant_vehicle=load_vehicle(**IN_VEHICLE))
    car = Instance(units["car"], parameters=CAR | {"speed": scenario.speed})
    found = coupled(car, Instance(units[name], parameters=changed), len(run.series) - 1)
    expected = run.series[["front.y", "rear.y"]].to_numpy()[:-1]
    assert (found == expected).all()
    unchanged = simulate.run(scenario, law).series["front.y"].to_numpy()
    assert abs(unchanged[: len(found)] - expected[:, 0][: len(unchanged)]).max() > 1e-6


@pytest.mark.parametrize(
    ("unit", "name", "value"),
    [
        ("car", "body.mass", 1.0),
        ("car", "speed", 1e3),
        ("ndi", "adhesion.corridor", -0.1),
        ("nmpc", "cost.period", 0.02),
    ],
)
def test_a_parameter_out_of_range_is_refused_with_a_sentence(units, unit, name, value):
    with pytest.raises(fmpy.fmi1.FMICallException):
        Instance(units[unit], parameters={name: value})


def test_a_parameter_is_set_before_initialisation_ends_and_a_reset_forgets_it(units):
    car = Instance(units["car"], parameters={"speed": 50.0})
    assert car.get(["front.v", "speed"]) == [50.0, 50.0]
    with pytest.raises(fmpy.fmi1.FMICallException):
        car.set(["speed"], [40.0])
    assert car.said == ["a parameter is set before initialisation ends, not later"]
    car.slave.reset()
    assert car.get(["speed"]) == [SCENARIO.speed]


def test_a_set_point_and_a_force_demand_of_ones_own_are_laid_on_the_road(units):
    """Elementary functions of C and of NumPy differ in their last digits, so the paths do."""
    sine = {"kind": "sine", "amplitude_mm": 2.0, "start_m": 5.0, "period_m": 50.0}
    laid = {"kind": 1, "amplitude": 2e-3, "start": 5.0, "period_start": 50.0}
    expected = simulate.run(SCENARIO.but(set_point=sine), LAW).series[["front.y", "rear.y"]].to_numpy()[:-1]
    controller = Instance(units["ndi"], parameters={f"set_point.{name}": value for name, value in laid.items()})
    found = coupled(Instance(units["car"]), controller, len(expected))
    assert abs(expected).max() > 1e-3
    assert found == pytest.approx(expected, abs=1e-12)
