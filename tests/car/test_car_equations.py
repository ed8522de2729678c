"""The car's equations at single states: drive limits, named outputs, parameters, start."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.track import route
from railrepro.track.alignment import Alignment, Segment
from railrepro.track.table import Track, build_table
from railrepro.vehicle.parameters import load_vehicle

CONES = load_vehicle(**{"contact.profile": "cone"})


def at(speed=20.0, way="T5", **values):
    """A car on cones in its initial state but for `values`, with double underscores for dots."""
    car = SteppedCar(way, speed, CONES)
    for name, value in values.items():
        car.state[equations.INDEX[name.replace("__", ".")]] = value
    return car


def rates(car, **commands):
    """Derivatives of the states under these torque commands of wheels."""
    car.torque[:] = [commands.get(wheel, 0.0) for wheel in equations.WHEELS]
    return np.array(car.model.rate(*car.inputs())).ravel()


@pytest.mark.parametrize(
    ("command", "rim_speed", "given", "fraction"),
    [
        (1000.0, 20.0, 1000.0, 1.0),
        (5000.0, 20.0, 4000.0, 1.0),
        (3000.0, -0.1, 3000.0, 1.0),
        (-3000.0, 0.1, -3000.0, 0.5),
        (-3000.0, -0.02, 3000.0, 0.1),
        (-5000.0, -20.0, 4000.0, 1.0),
        (-3000.0, 0.0, -3000.0, 0.0),
    ],
)
def test_the_drive_gives_what_its_limit_and_standstill_allow(command, rim_speed, given, fraction):
    """The limit is 4 kN m. A driving torque acts forwards, a braking one against the rotation, down to rest."""
    rate = rates(at(w__rear_le=rim_speed / 0.46, tau__rear_le=200.0), rear_le=command)
    assert rate[equations.INDEX["tau.rear_le"]] == pytest.approx(fraction * (given - 200.0) / 0.005)
    assert rate[equations.indices("tau.front_le", "tau.front_ri", "tau.rear_ri")] == pytest.approx(0.0)


@pytest.mark.parametrize("profile", ["cone", "s1002"])
def test_at_the_start_no_body_is_accelerated(profile):
    """Springs and rails carry the weight; spin creep of the wheels leaves a hundred newtons per running gear."""
    car = SteppedCar("T5", 20.0, load_vehicle(**{"contact.profile": profile}))
    rate = rates(car)
    turns = ("vx", "vy", "vz", "wx", "wy", "wz")
    names = [f"{body}.{name}" for body in equations.BODIES for name in turns] + [f"w.{w}" for w in equations.WHEELS]
    assert rate[equations.indices(*names)] == pytest.approx(0.0, abs=0.05)


def test_heading_and_yaw_rate_are_absolute_and_speed_is_along_the_track():
    """Measured quantities of a running gear on an arc of 500 m, 2 mm and 10 mrad off the track."""
    table = build_table(Alignment("arc", (Segment(100.0, (2e-3, 2e-3), (0.0, 0.0), (0.0, 0.0)),)), heading=0.3)
    way, beside = route.lay(Track("arc", table)), {"front__y": 2e-3, "front__psi": 0.01, "front__s": 5.0}
    found = at(way=way, front__wz=0.07, front__vy=0.1, body__psi=-0.01, **beside).outputs
    expected = {"front.p": 5.0, "front.psi_Ax": 0.3 + 5 * 2e-3 + 0.01, "front.psi_TrAx": 0.01, "front.y": 2e-3}
    expected |= {"front.v": 20.0 / (1 - 2e-3 * 2e-3), "front.psidot_Ax": 0.07, "rear.psidot_Ax": 0.0}
    assert {name: found[name] for name in expected} == pytest.approx(expected, rel=1e-12, abs=1e-12)
    to_body = {"front.yaw_to_body": 0.01 + 0.01 + 5 * 2e-3, "rear.yaw_to_body": 0.01}  # before the arc it is straight
    assert {name: found[name] for name in to_body} == pytest.approx(to_body, rel=1e-6)


@pytest.mark.parametrize(("speed", "slip"), [(20.0, -0.01), (0.5, -0.5 * 0.01)])
def test_adhesion_and_slip_of_a_driven_wheel(speed, slip):
    """A wheel that turns 1 % too fast; below 1 m/s the slip refers to 1 m/s."""
    rolling = at(speed).outputs["front_le.w"]
    found = at(speed, w__front_le=1.01 * rolling, tau__front_le=123.0).outputs
    assert found["front_le.sx"] == pytest.approx(slip, rel=1e-9)
    assert found["front_le.adhesion"] == pytest.approx(found["front_le.Fx"] / found["front_le.N"], rel=2e-5)
    assert found["front_le.Fx"] > 1e3
    assert found["front_ri.sx"] == pytest.approx(0.0, abs=1e-12)
    assert (found["front_le.w"], found["front_le.tau"]) == (pytest.approx(1.01 * rolling), 123.0)


@pytest.mark.parametrize(("side", "sign"), [("le", -1), ("ri", 1)])
def test_yaw_slides_a_contact_by_its_place_in_the_table(side, sign):
    """S1002 off centre, where the contacts are 5 and 7 mm from where they are when the wheel is centred."""
    car, slid, y = SteppedCar("T5", 40.0), [], 1.5e-3
    car.state[equations.INDEX["front.y"]] = y
    for turn in (0.0, 0.01):
        car.state[equations.INDEX["front.wz"]] = turn
        slid.append(40.0 * car.outputs[f"front_{side}.nu_x"])
    table = car.table.frame
    place = np.interp(sign * y, table["shift_m"], table["rail_contact_m"])
    assert (slid[0] - slid[1]) / 0.01 == pytest.approx(sign * (0.75 + place) - y, abs=2e-5) and abs(place) > 4e-3


def test_creep_stiffness_grows_with_the_ellipse_under_load():
    """Both axes with the cube root of the load."""
    load, stiffness, speed = [], [], at().outputs["front_le.w"]
    rest = at().state[equations.INDEX["front.z"]]
    for deeper in (0.0, 4e-5):
        low, high = (at(front__z=rest + deeper, w__front_le=speed + w).outputs for w in (-0.01, 0.01))
        load.append(low["front_le.N"])
        stiffness.append(high["front_le.Fx"] - low["front_le.Fx"])
    assert stiffness[1] / stiffness[0] == pytest.approx((load[1] / load[0]) ** (2 / 3), rel=2e-3)
    assert load[1] > 1.5 * load[0]
