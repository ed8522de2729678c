"""The car agrees with the same car in Exudyn, with our creep law and with one of its own; its rails and
its contact agree with ours; both take the pitch reaction about the same axis."""

import math
from dataclasses import astuple, replace

import exudyn_car
import numpy as np
import pandas as pd
import pytest
import second_opinion

from railrepro.contact.creep import polach, spin_moment
from railrepro.contact.table import cone_patch
from railrepro.data import InputError
from railrepro.track.alignment import Alignment, Segment, alignments
from railrepro.track.irregularity import irregularities
from railrepro.track.table import Track, build_table
from railrepro.vehicle.parameters import load_vehicle

MISSING = "the group `bench` is installed by `make test-extras`"


def our_creep(vehicle, _stiffness, load, nu_x, nu_y, spin, slip_speed):
    """The creep law of the core as the second car takes it."""
    a, b, kalker = cone_patch(vehicle)
    scale = ((load + 1) / vehicle.contact.nominal_load) ** (1 / 3)
    rail = astuple(vehicle.adhesion["dry"])
    law = (nu_x, nu_y, spin, load, scale * a, scale * b, *kalker, vehicle.contact.shear_modulus, *rail, slip_speed)
    return *polach(*law), spin_moment(*law)


@pytest.mark.parametrize(("law", "usual", "short"), [(our_creep, 3e-4, 1e-5), (exudyn_car.creep, 0.02, 0.02)])
def test_straight_pulse_agrees_with_exudyn(law, usual, short):
    """With our creep law the step errors of both integrators remain, first of the contact modes; a law of its own
    differs where ours adds spin to creepages before it looks at their direction."""
    pytest.importorskip("exudyn", reason=MISSING)
    case = replace(second_opinion.CASES[0], seconds=0.5)
    table = second_opinion.compare(case.name, second_opinion.replay(case, law=law))
    table = table.set_index(["car_step_ms", "quantity"])
    moved = table.loc["1"]
    assert moved.loc["lateral position", "largest"] > 1e-3
    assert (moved["relative"] < usual).all()
    assert (table.loc["0.05", "relative"] < short).all()
    assert (table["step_error"] < 3e-4).all() and table.loc[("1", "wheel load"), "step_error"] > 1e-6


def test_guard_tells_the_torque_that_it_adds():
    """A path that the car leaves by 1 mm is steered back, and the comparison shows by how much."""
    series = pd.DataFrame({name: np.zeros(3) for name in second_opinion.MEASURED})
    series = series.assign(**{"front.v": 50.0, "front.tau_long": 7.0, "rear.tau_long": 7.0})
    series = series.assign(**dict.fromkeys(second_opinion.GUIDED, 20.0))
    guard = second_opinion._Guard(second_opinion.CASES[1], series, load_vehicle())
    off = np.zeros(12)
    off[0] = 1e-3
    torques = [guard(k, off) for k in range(3)]
    front, rear = guard.guided()["front.du"], guard.guided()["rear.du"]
    assert (front < 20.0).all() and (np.diff(front) < 0).all()
    assert rear == pytest.approx(np.full(3, 20.0))
    assert torques[2] == pytest.approx([7 + front[2], 7 - front[2], 27.0, -13.0])


@pytest.mark.parametrize("radius", [0.43, 0.46, 0.5])
def test_contact_of_the_second_car_agrees_with_ours(radius):
    """The same ellipse from other integrals; Kalker's coefficients by another interpolation between his rows."""
    vehicle = load_vehicle(**{"wheel.radius": radius})
    a, b, coefficients = exudyn_car.patch(vehicle)
    ours = cone_patch(vehicle)
    assert (a, b) == pytest.approx(ours[:2], rel=1e-6)
    assert coefficients == pytest.approx(ours[2], rel=6e-3)


def test_second_car_refuses_a_contact_beyond_its_rows():
    with pytest.raises(InputError, match="wheel.radius = 0.9 m"):
        exudyn_car.patch(load_vehicle(**{"wheel.radius": 0.9}))


def test_small_creepages_make_kalkers_linear_forces_on_the_second_car():
    vehicle = load_vehicle(**{"adhesion.dry.k_s": 1.0})
    a, b, (c11, c22, c23, c33) = exudyn_car.patch(vehicle)
    unit, root, load = vehicle.contact.shear_modulus * a * b, np.sqrt(a * b), vehicle.contact.nominal_load
    stiffness = exudyn_car.Stiffness(c11 * a * b, c22 * a * b, c23 * (a * b) ** 1.5, c33 * (a * b) ** 2)
    found = [float(v) for v in exudyn_car.creep(vehicle, stiffness, load, 1e-6, 2e-6, 1e-4, 1e-5)]
    expected = [-c11 * 1e-6, -c22 * 2e-6 - root * c23 * 1e-4, root * (c23 * 2e-6 - root * c33 * 1e-4)]
    assert found == pytest.approx(unit * np.array(expected), rel=1e-4)
    slides = exudyn_car.creep(vehicle, stiffness, load, 0.3, 0.4, 0.0, 50.0)
    friction = vehicle.adhesion["dry"].mu0 * vehicle.adhesion["dry"].a_ratio
    assert float(np.hypot(slides[0], slides[1])) == pytest.approx(friction * load, rel=0.02)


BENDS = (
    Segment(40.0, (1 / 600, 1 / 300), (0.02, 0.06), (0.0, 0.01)),
    Segment(55.0, (1 / 300, 1 / 500), (0.06, 0.0), (0.01, 0.02)),
)


@pytest.mark.parametrize("alignment", [*(alignments()[name] for name in ("T1", "T4")), Alignment("bends", BENDS)])
def test_rails_of_the_second_car_lie_where_ours_do(alignment):
    """Integrated curvature against the tables of the track, before, along and behind it."""
    track = Track(alignment.name, build_table(alignment))
    columns = pd.DataFrame(exudyn_car.Rails(alignment).at(np.arange(-20.0, track.length + 20.0, 7.3)))
    columns.columns = exudyn_car._STATION
    assert pytest.approx(track.position(columns["p"]), abs=1e-9) == columns[list("xyz")].to_numpy().T
    angles = columns[["psi", "kappa", "phi", "dphi", "eps", "deps"]].to_numpy().T
    assert angles == pytest.approx(track.interpolate(columns["p"]), abs=1e-12)


def test_irregular_rails_of_the_second_car_follow_their_samples():
    p = np.arange(0.0, 200.0, 0.5)
    rough = irregularities(p)
    rails = exudyn_car.Rails(alignments()["T5"], rough)
    columns = pd.DataFrame(rails.at(p + 1e-9), columns=exudyn_car._STATION)
    behind = pd.DataFrame(rails.at([-5.0, 250.0]), columns=exudyn_car._STATION)
    for channel, column in exudyn_car._CHANNELS.items():
        assert (behind[[channel, "d" + channel]] == 0.0).all(axis=None)
        assert columns[channel].to_numpy() == pytest.approx(rough[column].to_numpy(), abs=1e-12)
        ahead = sum(columns["d" * k + channel] * 0.5**k / math.factorial(k) for k in range(4))
        assert ahead[:-1].to_numpy() == pytest.approx(rough[column].to_numpy()[1:], abs=1e-12)


def test_pitch_reaction_acts_about_vertical_of_body_and_axis_of_carrier():
    vehicle, rails = load_vehicle(), exudyn_car.Rails(alignments()["T5"])
    places, roll, pitch = np.array([14.0, 0.0]), 0.02, 0.003

    def gear_yaw_torque(pitched):
        motion = np.zeros((18, 3))
        motion[9:] = np.eye(3).reshape(9, 1)
        motion[0] = (7.0, *places)
        motion[2] = -vehicle.body.cg_height, -vehicle.wheel.radius, -vehicle.wheel.radius
        tilt = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        motion[9:, 0] = tilt.ravel(order="F")
        nose = np.array([[np.cos(pitched), 0, np.sin(pitched)], [0, 1, 0], [-np.sin(pitched), 0, np.cos(pitched)]])
        motion[9:, 1] = nose.ravel(order="F")
        stations, cells = rails.at(places).T, exudyn_car.cones(weightless).at(np.zeros(4)).T
        loads, *_ = exudyn_car.forces(weightless).call([motion, np.zeros((3, 4)), stations, cells, places, np.zeros(4)])
        return float(loads[5, 1])

    springs = ("k_x", "k_y", "k_z", "link_stiffness", "antiroll_stiffness")
    weightless = load_vehicle(**{f"suspension.{name}": 1e-6 for name in springs}, **{"environment.gravity": 1e-9})
    axis = np.cross((0, -np.sin(roll), np.cos(roll)), (np.cos(pitch), 0, -np.sin(pitch)))
    expected = -vehicle.suspension.pitch_stiffness * np.sin(pitch) * np.cos(roll) * axis[2]
    assert abs(expected) > 100.0
    assert gear_yaw_torque(pitch) == pytest.approx(expected, rel=1e-6)
