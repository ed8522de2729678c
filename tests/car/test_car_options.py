"""What the car has on request: wheelsets, gauge, substeps, the floor; its pitch rods."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.control.ndi import NDI
from railrepro.data import InputError
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import route
from railrepro.track.irregularity import CHANNELS, irregularities
from railrepro.track.rough import rough_track
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

CONE = {"contact.profile": "cone"}


def lay(**channels):
    """T5 with channels that rise within 20 m from p = 30 m on and stay."""
    p = np.arange(0.0, 900.0, route.CELL)
    rise = np.clip((p - 30) / 20, 0, 1)
    frame = pd.DataFrame({"p_m": p} | {c: channels.get(name, 0.0) * rise for name, c in CHANNELS.items()})
    return route.lay(load_track("T5"), irregularities=frame)


def balance(car, cycles):
    """Change of the mechanical energy and the work of motors and losses, by stepping (J)."""
    rows = [car.energies]
    for _ in range(cycles):
        car.step()
        rows.append(car.energies)
    table = pd.DataFrame(rows)
    work = np.trapezoid(table["motor_W"] - table["damping_W"] - table["creep_W"], dx=1e-3)
    return table["mechanical_J"].iloc[-1] - table["mechanical_J"].iloc[0], work


def test_pitch_rods_turn_a_rolled_carrier_in_yaw():
    """About z_body x x_carrier the reaction has the part (reaction x relative roll) about the carrier's yaw axis."""
    pitch, roll, turning = 2e-3, 5e-3, {}
    for factor in (1.0, 2.0):
        usual = load_vehicle().suspension.pitch_stiffness
        vehicle = load_vehicle(**{"suspension.pitch_stiffness": factor * usual})
        car = SteppedCar("T5", 20.0, vehicle)
        car.state[equations.indices("body.phi", "body.pitch")] = roll, pitch
        turning[factor] = np.array(car.model.rate(*car.inputs())).ravel()[equations.INDEX["front.wz"]]
    part = (turning[2.0] - turning[1.0]) * vehicle.gear.inertia_z
    assert part == pytest.approx(usual * pitch * roll, rel=1e-3)


def test_axle_damping_makes_a_wheelset():
    """On cones it runs in Klingel's wave, 2 pi sqrt(b r / (2 delta)) long; independent wheels stay where they are."""
    vehicle = load_vehicle(**CONE, **{"gear.axle_damping": 1e6, "suspension.k_x": 1e3})
    wave = 2 * np.pi * np.sqrt(vehicle.gear.contact_base * vehicle.wheel.radius / (2 * vehicle.wheel.cone_angle))
    ways = {}
    for name, own in (("wheelset", vehicle), ("free", load_vehicle(**CONE))):
        car = SteppedCar("T5", 5.0, own)
        car.state[equations.indices("front.y")] = 2e-3
        while car.outputs["front.y"] > 0 and car.outputs["front.p"] < wave:
            car.step(steps=10)
        ways[name] = car.outputs["front.p"]
    assert ways["wheelset"] == pytest.approx(wave / 4, rel=0.1)
    assert ways["free"] >= wave


def test_wider_gauge_sinks_cones_and_slows_them_less():
    """Rails 4 mm wider apart touch cones 2 mm further out, where these are smaller: radius less by 2 mm tan(delta)."""
    vehicle = load_vehicle(**CONE)
    plain, wide = (SteppedCar(lay(gauge=gauge), 20.0, vehicle) for gauge in (0.0, 4e-3))
    for car in (plain, wide):
        car.step(steps=8000)
    less = 2e-3 * np.tan(vehicle.wheel.cone_angle)
    sunk = {car: car.state[equations.INDEX["front.z"]] for car in (plain, wide)}
    assert sunk[wide] - sunk[plain] == pytest.approx(less, rel=0.02)
    ratio = (
        wide.outputs["front_le.w"] / wide.outputs["front.v"] / plain.outputs["front_le.w"] * plain.outputs["front.v"]
    )
    assert ratio - 1 == pytest.approx(less / vehicle.wheel.radius, rel=0.05)


@pytest.mark.parametrize(("channel", "size"), [("lateral", 2e-3), ("gauge", 4e-3), ("vertical", 3e-3)])
def test_rails_that_move_do_no_work_of_their_own(channel, size):
    car = SteppedCar(lay(**{channel: size}), 30.0, load_vehicle())
    change, work = balance(car, 2500)
    assert change == pytest.approx(work, rel=0.03, abs=1.0)


def test_substeps_sharpen_the_loads_and_leave_the_control_cycle_alone():
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=300, end_m=120)
    rough = irregularities(np.arange(0.0, 120.0, route.CELL))
    runs = {n: simulate.run(scenario, NDI(), irregularities=rough, substeps=n).series for n in (1, 2, 4, 16)}
    assert len({len(series) for series in runs.values()}) == 1
    error = {n: np.abs(runs[n]["front_le.N"] - runs[16]["front_le.N"]).max() for n in (1, 2, 4)}
    assert error[4] < error[2] / 1.5 < error[1] / 2


def test_floor_accelerations_are_those_of_points_in_space():
    """Second differences of the floor's place, less gravity, in axes of the body, while the car sways."""
    vehicle = load_vehicle()
    car = SteppedCar(lay(lateral=8e-3, crosslevel=4e-3), 30.0, vehicle)
    car.step(steps=1200)
    lever = np.array([vehicle.body.gear_spacing / 2, 0.0, vehicle.body.cg_height - vehicle.body.floor_height])
    places, h = [], 1e-3
    for _ in range(3):
        state = dict(zip(car.model.states, car.state, strict=True))
        centre = np.array([state["body.s"], state["body.y"], state["body.z"]])  # a straight level track
        angles = [state[f"body.{name}"] for name in ("psi", "pitch", "phi")]
        attitude = Rotation.from_euler("ZYX", angles).as_matrix()
        places.append(centre + attitude @ lever)
        if len(places) == 2:
            felt, turned = car.outputs, attitude
        car.step(period=h)
    acceleration = (places[0] - 2 * places[1] + places[2]) / h**2
    expected = turned.T @ (acceleration - [0, 0, vehicle.gravity])
    assert [felt[f"floor_front.a{axis}"] for axis in "xyz"] == pytest.approx(expected, abs=2e-3)
    assert abs(expected[1]) > 0.02


def test_a_planned_line_is_added_to_the_set_point():
    at = np.arange(20.0, 60.0, 2.0)
    cubic = np.array([1e-3 + 0 * at, 2e-5 + 0 * at, -1e-6 + 0 * at, 3e-8 + 0 * at])
    reference = route.sine(2e-3, 150.0)
    plain, both = (route.lay(load_track("T5"), reference, line=line) for line in (None, (at, cubic)))
    inside, outside = np.array([31.25]), np.array([10.0, 70.0])
    d = 1.0  # cells begin every half metre: the one at 31 m lies 1 m behind the coordinate 30 m
    start = 1e-3 + 2e-5 * d - 1e-6 * d**2 / 2 + 3e-8 * d**3 / 6
    slope = 2e-5 - 1e-6 * d + 3e-8 * d**2 / 2
    expected = start + slope * 0.25 + (-1e-6 + 3e-8 * d) * 0.25**2 / 2 + 3e-8 * 0.25**3 / 6
    added = both.reference_at(inside)[0] - plain.reference_at(inside)[0]
    assert added == pytest.approx([expected], rel=1e-9)
    assert np.array_equal(both.reference_at(outside), plain.reference_at(outside))


def test_rough_track_adds_defects_and_reads_files(tmp_path):
    p = np.arange(0.0, 200.0, route.CELL)
    plain = rough_track(p, spectrum="en_B_300", seed=3)
    fault = {"kind": "alignment_fault", "start": 80.0, "length": 20.0, "amplitude": 4e-3}
    added = rough_track(p, spectrum="en_B_300", seed=3, defects=[fault])["lateral_m"] - plain["lateral_m"]
    assert added.max() == pytest.approx(4e-3, rel=1e-6) and added[p < 79].abs().max() == 0
    plain.to_csv(tmp_path / "measured.csv", index=False)
    middle = (p > 40) & (p < 150)
    assert np.allclose(rough_track(p, file=str(tmp_path / "measured.csv"))[middle], plain[middle], atol=1e-12)
    with pytest.raises(InputError, match="defects.1: Input tag 'hole' found using 'kind'"):
        rough_track(p, defects=[{"kind": "hole"}])


def test_preview_makes_the_set_point_follow_the_rails():
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=160, end_m=200)
    numbers = {"pole": 30.0, "frequency": 30.0, "damping": 1.0}
    errors = {}
    for name, known in (("none", {}), ("exact", {"share": 1.0}), ("late", {"localisation_error_m": 10.0})):
        experiment = Experiment(
            scenario, "ndi_feedforward", parameters=numbers, irregular={"spectrum": "en_B_300"}, preview=known
        )
        errors[name] = experiment()[0]["rail_rmse_y"]
    assert errors["exact"] < 0.6 * errors["none"] and errors["late"] > 1.5 * errors["exact"]
