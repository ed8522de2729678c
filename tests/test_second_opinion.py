"""Second opinions: the car agrees with the same car in Exudyn, and the optimum of the MPC with that of do-mpc."""

from dataclasses import replace

import numpy as np
import pytest

from railrepro.control.registry import mpc_settings
from railrepro.evidence.bench import exudyn_car, second_opinion
from railrepro.evidence.bench import speed as bench
from railrepro.evidence.runs import tuning
from railrepro.track import route
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import load_vehicle

MISSING = "the extra `bench` is installed by `make test-extras`"


def test_straight_pulse_agrees_with_exudyn():
    pytest.importorskip("exudyn", reason=MISSING)
    case = replace(second_opinion.CASES[0], seconds=0.5)
    table = second_opinion.compare(case.name, second_opinion.replay(case)).set_index(["car_step_ms", "quantity"])
    moved = table.loc["1"]
    assert moved.loc["lateral position", "largest"] > 1e-3
    # The straight has no kinks: what remains is the step error of both integrators, first of the contact modes.
    assert (moved["relative"] < 3e-4).all()
    assert (table.loc["0.05", "relative"] < 1e-5).all()


def test_pitch_reaction_acts_about_vertical_of_body_and_axis_of_carrier():
    vehicle, way = load_vehicle(), route.lay(load_track("T5"))
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
        cells = way.rows_at(places).T
        loads, *_ = exudyn_car.forces(weightless).call([motion, np.zeros((3, 4)), cells, places, np.zeros(4)])
        return float(loads[5, 1])

    springs = ("k_x", "k_y", "k_z", "link_stiffness", "antiroll_stiffness")
    weightless = load_vehicle(**{f"suspension.{name}": 1e-6 for name in springs}, **{"body.mass": 1e-3})
    axis = np.cross((0, -np.sin(roll), np.cos(roll)), (np.cos(pitch), 0, -np.sin(pitch)))
    expected = -vehicle.suspension.pitch_stiffness * np.sin(pitch) * np.cos(roll) * axis[2]
    assert abs(expected) > 100.0
    assert gear_yaw_torque(pitch) == pytest.approx(expected, rel=1e-6)


def test_do_mpc_finds_the_same_plan():
    pytest.importorskip("do_mpc", reason=MISSING)
    settings = mpc_settings(tuning.load("nmpc")["parameters"])
    found = bench.peer(load_vehicle(), settings, count=1)
    assert abs(found["first_torque_Nm"].iloc[0]) > 10.0
    assert found["largest_difference_Nm"].iloc[0] < 1e-4
