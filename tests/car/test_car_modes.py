"""Suspension of the car against hand formulas: damped modes, heights of springs and links, sway in an arc."""

import numpy as np
import pytest

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.control.ndi import NDI
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

V = load_vehicle()
BODY, GEAR, SPRING = V.body, V.gear, V.suspension
BELOW = BODY.cg_height - SPRING.height
"""Depth of the secondary springs below the body's centre of gravity (m)."""
TO_LINK = BODY.cg_height - V.wheel.radius
"""Depth of the traction link below the body's centre of gravity (m)."""


def modes(matrix):
    """Frequency (Hz) and damping ratio (-) of the oscillations of dx/dt = matrix x, ascending, shape (n, 2)."""
    poles = np.linalg.eigvals(matrix)
    poles = poles[poles.imag > 1e-6]
    return np.array(sorted(zip(np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles), strict=True)))


def hand_modes(inertia, lever, stiffness, damping):
    """Modes of coordinates q with lateral deflection lever @ q at the four springs, and further springs, dampers."""
    square, inverse, unit = 4 * np.outer(lever, lever), np.diag(1 / np.array(inertia)), np.eye(len(inertia))
    stiffness, damping = SPRING.k_y * square + stiffness, SPRING.c_y * square + damping
    return modes(np.block([[0 * unit, unit], [-inverse @ stiffness, -inverse @ damping]]))


def test_body_against_free_carriers_without_friction():
    """Sway: body, its roll, both carriers alike. Yaw: body, opposite carriers, their yaw. Cylinders are not guided."""
    car = SteppedCar("T5", 50.0, load_vehicle(**{"contact.profile": "cone", "wheel.cone_angle": 1e-6}))
    for i, name in enumerate(equations.PARAMETERS):
        if name.endswith(".mu0"):
            car.parameters[i] = 1e-12
    found = modes(car.linearise().a.to_numpy())
    hung = BODY.mass * V.gravity * BELOW  # the weight stands on the springs
    roll = np.diag([0, 2 * SPRING.roll_stiffness - hung, 0]), np.diag([0, 2 * SPRING.roll_damping, 0])
    sway = hand_modes([BODY.mass, BODY.inertia_x, 2 * GEAR.mass], [1, -BELOW, -1], *roll)
    turn = 2 * np.outer([1, 0, -1], [1, 0, -1])
    turned = SPRING.yaw_stiffness * turn, SPRING.yaw_damping * turn
    inertia = [BODY.inertia_z, 2 * GEAR.mass, 2 * GEAR.inertia_z]
    yaw = hand_modes(inertia, [BODY.gear_spacing / 2, -1, 0], *turned)
    assert len(sway) == 2 and len(yaw) == 2
    for mode in (*sway, *yaw):
        assert np.abs(found / mode - 1).max(axis=1).min() < 5e-3


def test_springs_and_link_act_at_their_heights():
    """A displacement of the front carrier turns bodies by force times height, and by the preload off centre."""
    car = SteppedCar("T5", 50.0, V)
    car.step(steps=1000)
    rolling = car.linearise().a
    preload = BODY.mass * V.gravity / 2
    above_axle = SPRING.height - V.wheel.radius
    expected = {
        ("body.wy", "front.s"): (SPRING.link_stiffness * TO_LINK + 2 * SPRING.k_x * BELOW) / BODY.inertia_y,
        ("body.wy", "front.vx"): (SPRING.link_damping * TO_LINK + 2 * SPRING.c_x * BELOW) / BODY.inertia_y,
        ("front.wy", "front.s"): (preload + 2 * SPRING.k_x * above_axle) / GEAR.inertia_y,
        ("body.wx", "front.y"): -2 * SPRING.k_y * BELOW / BODY.inertia_x,
        ("body.wx", "front.vy"): -2 * SPRING.c_y * BELOW / BODY.inertia_x,
        ("front.wx", "body.y"): (preload + 2 * SPRING.k_y * above_axle) / GEAR.inertia_x,
        ("body.wy", "front.z"): -SPRING.k_z * BODY.gear_spacing / BODY.inertia_y,
    }
    assert {place: rolling.loc[place] for place in expected} == pytest.approx(expected, rel=1e-4)


def test_pitch_rods_turn_a_rolled_carrier_in_yaw():
    """The reaction about z_body x x_carrier times the relative roll turns about the yaw axis of the carrier."""
    turning, usual = [], SPRING.pitch_stiffness
    for factor in (1.0, 2.0):
        car = SteppedCar("T5", 20.0, load_vehicle(**{"suspension.pitch_stiffness": factor * usual}))
        car.state[equations.indices("body.phi", "body.pitch")] = 5e-3, 2e-3
        turning.append(np.array(car.model.rate(*car.inputs())).ravel()[equations.INDEX["front.wz"]])
    assert (turning[1] - turning[0]) * GEAR.inertia_z == pytest.approx(usual * 5e-3 * 2e-3, rel=1e-3)


@pytest.mark.parametrize(("track", "clearance"), [("T2", None), ("T3", None), ("T4", None), ("T4", 0.035)])
def test_sway_of_the_body_in_an_arc(track, clearance):
    """Offset and roll of the body, without and with bump stops; the rails carry weight and centrifugal force."""
    bumps = clearance is not None
    vehicle = load_vehicle(**{"suspension.bump_clearance": clearance}) if bumps else V
    geometry = load_track(track)
    scenario = load_scenario(f"curve_entry_{track}").but(set_point={"kind": "none"}, end_m=geometry.length)
    run = simulate.run(scenario, NDI(integral=0.05), vehicle=vehicle)
    assert not run.failed
    assert (run.series["front.sway"].abs().max() > vehicle.suspension.bump_clearance) == bumps
    log = run.series.tail(1500).mean()
    _, kappa, phi, *_ = geometry.interpolate(np.array([geometry.length]))[:, 0]
    centrifugal, weight = BODY.mass * log["front.v"] ** 2 * kappa, BODY.mass * V.gravity
    outwards = centrifugal * np.cos(phi) - weight * np.sin(phi)
    pressed = centrifugal * np.sin(phi) + weight * np.cos(phi)
    deflection = outwards / (4 * SPRING.k_y)
    if bumps:
        stops = 2 * SPRING.bump_stiffness
        deflection = (outwards + stops * clearance) / (4 * SPRING.k_y + stops)
    roll = outwards * BELOW / (2 * SPRING.roll_stiffness - pressed * BELOW)
    versine = BODY.gear_spacing**2 * kappa / 8
    assert log["body.phi"] == pytest.approx(-roll, rel=0.02)
    assert log["body.y"] - versine == pytest.approx(-(deflection + BELOW * roll), rel=0.02)
    load, creep, angle = (log[[f"{wheel}.{name}" for wheel in equations.WHEELS]] for name in ("N", "Fy", "angle"))
    load, creep, angle = load.to_numpy(), creep.to_numpy(), np.array([-1, 1, -1, 1]) * angle.to_numpy()
    down, sideways = (load @ np.cos(angle) + creep @ np.sin(angle)), (creep @ np.cos(angle) - load @ np.sin(angle))
    over_body = 1 + 2 * GEAR.mass / BODY.mass
    assert down == pytest.approx(over_body * pressed, rel=2e-3)
    assert sideways == pytest.approx(over_body * outwards, abs=300)
