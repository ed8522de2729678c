"""The car as a component: stepping, linearisation, FMI unit."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.car.fmu import export_fmu
from railrepro.compile import codegen
from railrepro.control import law
from railrepro.simulation import exchange
from railrepro.track import route
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

TORQUE = np.array([300.0, -300.0, 150.0, -150.0])


def test_stepping_gives_what_the_exchange_gives():
    car = SteppedCar("T3", 50.0)
    way, vehicle = route.lay(load_track("T3")), load_vehicle()
    control = law.control_law(vehicle, None, lateral=0.03, track_end=way.length, stop_speed=-1.0)
    start = equations.rest_state(vehicle, car.table, 50.0)
    coupled = exchange.Exchange(equations.parameter_vector(vehicle), car.table, way, control, start)
    coupled.held[:] = 20.0
    log = coupled.run(500)
    for row in log:
        car.step(
            [
                row[coupled.columns.index(f"{wheel[:-3]}.du")] * (1 if wheel.endswith("le") else -1)
                for wheel in equations.WHEELS
            ]
        )
    assert np.allclose(car.state, coupled.state, rtol=1e-12, atol=1e-12)


def test_linearisation_predicts_a_small_step():
    car = SteppedCar("T5", 60.0)
    car.step(exchanges=2000)
    model, before = car.linearise(), car.state.copy()
    assert list(model.a.columns) == list(equations.STATES) and list(model.b.columns) == list(equations.WHEELS)
    names = list(equations.STATES)
    car.step(TORQUE, period=1e-5)
    lag = load_vehicle().drive.lag
    rise = (car.state - before)[names.index("tau.front_le")]
    assert rise == pytest.approx(model.b.loc["tau.front_le", "front_le"] * TORQUE[0] * 1e-5, rel=2e-3)
    assert model.b.loc["tau.front_le", "front_le"] == pytest.approx(1 / lag)


def test_energies_and_outputs_are_named():
    car = SteppedCar("T5", 50.0)
    car.step(TORQUE, 200)
    assert car.energies["motor_W"] == pytest.approx(
        sum(car.outputs[f"{w}.tau"] * car.outputs[f"{w}.w"] for w in equations.WHEELS), rel=1e-3
    )
    assert car.outputs["front_le.N"] > 5e4


def test_a_broken_state_is_named_and_kept_out():
    car = SteppedCar("T5", 50.0)
    car.step(exchanges=10)
    good = car.state.copy()
    with pytest.raises(ArithmeticError, match=r"left all bounds after t = 0\.01\d s, p = "):
        car.step([np.nan, 0, 0, 0], 5)
    assert np.isfinite(car.state).all() and np.isfinite(good).all()


@pytest.mark.skipif(codegen.compiler() is None, reason="an FMU holds compiled code")
def test_fmu_runs_in_fmpy_to_the_same_trajectory(tmp_path, monkeypatch):
    fmpy = pytest.importorskip("fmpy")
    car = SteppedCar("T3", 60.0)
    # a second of the unit needs no optimised code, which takes ten times as long to compile and gives the same bits
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
    file = export_fmu(tmp_path / "car.fmu", "T3", 60.0)
    names = [f"tau_{wheel}" for wheel in equations.WHEELS]
    signal = np.array([(0.0, *TORQUE), (2.0, *TORQUE)], dtype=[("time", float), *((n, float) for n in names)])
    found = fmpy.simulate_fmu(
        str(file), stop_time=1.0, output_interval=0.01, input=signal, output=["front.y", "body.phi"]
    )
    car.step(TORQUE, 1000)
    assert found["front.y"][-1] == pytest.approx(car.outputs["front.y"], rel=1e-9, abs=1e-12)
    assert found["body.phi"][-1] == pytest.approx(car.outputs["body.phi"], rel=1e-9, abs=1e-12)
    assert np.abs(found["front.y"]).max() > 1e-4
