"""Slip control of our own on a wheel with inertia, drive lag and Polach's creep: hold, seek, mirror, let go."""

from dataclasses import astuple
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.creep import polach
from railrepro.contact.table import cone_patch
from railrepro.control.adhesion import LongitudinalInputs
from railrepro.own.slip import SlipMemory, SlipSettings
from railrepro.quantities import pack, symbols
from railrepro.vehicle.parameters import load_vehicle

V = load_vehicle()
LOAD, RADIUS, INERTIA = V.contact.nominal_load, V.wheel.radius, V.wheel.spin_inertia


@lru_cache
def law(mass=1e9):  # the speed stays
    """(f, s, demand, v, ticks, settings, memory) -> u, memory, segment; the torque is the first state of the memory."""
    f, s, memory_ = ca.SX.sym("f", 2), ca.SX.sym("s", 2), ca.SX.sym("memory", 9)
    f_star, v, ticks = ca.SX.sym("f_star"), ca.SX.sym("v"), ca.SX.sym("t")
    settings_, settings = symbols(SlipSettings, "settings")
    u, *rest = ca.vertsplit(memory_)
    q = LongitudinalInputs(
        ca.vertsplit(f), ca.vertsplit(s), f_star, v, ticks, u, LOAD, V.drive.torque_limit, RADIUS, INERTIA, mass
    )
    u, kept, segment = settings.base_torque(q, SlipMemory(*rest))
    return ca.Function("law", [f, s, f_star, v, ticks, settings_, memory_], [u, ca.vertcat(u, *pack(kept)), segment])


@lru_cache
def curve(adhesion, speed):
    """Slip, and adhesion over slip."""
    slip, shear = np.linspace(0, 0.1, 2001), V.contact.shear_modulus
    a, b, kalker = cone_patch(V)
    found = [
        polach(-x, 0.0, 0.0, LOAD, a, b, *kalker, shear, *astuple(V.adhesion[adhesion]), speed * x)[0] for x in slip
    ]
    return slip, np.array(found, dtype=float) / LOAD


def ride(rail, speed, demand, settings=None, seconds=6.0, noise=0.0, uneven=0.0):
    """A gear whose wheels slip alike, but for `uneven`, on rails by time: columns u, f, slip of the mean, segment."""
    gains = pack(settings or SlipSettings())
    memory, torque, slip, generator, rows = np.zeros(9), 0.0, 0.0, np.random.default_rng(1), []
    for k in range(round(seconds / CONTROL_PERIOD)):
        over, adhesion = curve(rail(k * CONTROL_PERIOD), speed)
        used = np.sign(slip) * np.interp(abs(slip), over, adhesion)
        seen = slip * np.array([1 + uneven, 1 - uneven]) + 0.25 * noise * generator.standard_normal(2)
        f = used + noise * generator.standard_normal(2)
        u, memory, segment = law()(f, -seen, demand, speed, k, gains, memory)
        memory = np.array(memory).ravel()
        rows.append((float(u), used, slip, float(segment)))
        torque += CONTROL_PERIOD / V.drive.lag * (float(u) - torque)
        slip += CONTROL_PERIOD * RADIUS / (INERTIA * speed) * (torque - RADIUS * LOAD * used)
    return np.array(rows)


@pytest.mark.parametrize("adhesion", ["poor", "very_poor"])
@pytest.mark.parametrize("kmh", [100, 400])
def test_it_finds_nearly_the_maximum_on_rails_and_speeds_that_it_does_not_know(adhesion, kmh):
    most = curve(adhesion, kmh / 3.6)[1].max()
    last = ride(lambda t: adhesion, kmh / 3.6, 0.2, seconds=10.0)[6000:]
    assert 0.92 < last[:, 1].mean() / most < 0.99
    assert last[:, 2].max() < 0.03 and (kmh == 100 or set(last[:, 3]) <= {2.0, 3.0})  # at 100 km/h the motor ends first


def test_with_noise_it_finds_the_same():
    quiet, loud = (ride(lambda t: "poor", 111.0, 0.2, noise=noise)[3000:, 1].mean() for noise in (0.0, 2e-3))
    assert loud == pytest.approx(quiet, rel=0.02)


def test_without_seeking_it_holds_the_limit():
    settings = SlipSettings(start=0.008, seek=0.0, swing=0.0)
    assert ride(lambda t: "poor", 111.0, 0.2, settings)[-1, 2] == pytest.approx(0.008, rel=0.01)


@pytest.mark.parametrize("sign", [1, -1])
def test_at_the_limit_the_torque_also_turns_the_wheel_as_fast_as_the_car_gains_speed(sign):
    """Newton for half a car of 16 t and for a wheel that goes on rolling: v' = 2 F/m, J v'/r_0 = tau - r_0 F."""
    mass, adhesion, settings = 16e3, 0.1, SlipSettings(seek=0.0, swing=0.0)
    gains, memory, held = pack(settings), np.zeros(9), law(mass + 2 * INERTIA / RADIUS**2)
    seen = [sign * adhesion] * 2, [-sign * settings.start] * 2
    for k in range(3000):
        u, memory, segment = held(*seen, sign * 0.2, 50.0, k, gains, memory)
    force = adhesion * LOAD
    assert float(segment) != 1
    assert sign * float(u) == pytest.approx(RADIUS * force + INERTIA * 2 * force / mass / RADIUS, rel=1e-6)


def test_a_rolling_wheel_whose_load_is_higher_than_nominal_is_not_held_back():
    """Adhesion is force over true load: a tenth more of it is 290 N m here, the limit is but 260 N m away."""
    gains, memory, demand = pack(SlipSettings(swing=0.0)), np.zeros(9), 1.1 * 0.08
    for k in range(3000):
        u, memory, segment = law()([0.08] * 2, [-1e-3] * 2, demand, 12.0, k, gains, memory)
    assert float(segment) == 1 and float(u) == pytest.approx(RADIUS * 1.1 * LOAD * 0.08)


def test_braking_is_the_mirror_image_of_traction():
    drive, brake = (ride(lambda t: "poor", 50.0, sign * 0.2, seconds=2.0) for sign in (1, -1))
    assert np.allclose(drive[:, :3], -brake[:, :3], atol=1e-9) and drive[-1, 0] > 1000


def test_a_demand_below_the_limit_is_followed_with_its_ramp():
    rows = ride(lambda t: "dry", 50.0, 0.05, seconds=1.5)
    wanted = 0.05 * RADIUS * LOAD
    assert rows[-1, 0] == pytest.approx(wanted) and (rows[:, 3] == 1).all()
    assert np.diff(rows[:, 0]).max() == pytest.approx(2.0)


def test_a_sudden_loss_of_adhesion_is_caught():
    rows = ride(lambda t: "dry" if t < 3 else "very_poor", 50.0, 0.12, seconds=4.0)
    assert rows[3000:, 2].max() < 0.03 and rows[-1, 2] < 0.02 and (rows[:, 0] >= 0).all()


def test_a_single_wheel_that_slips_lowers_the_torque():
    even, uneven = (ride(lambda t: "poor", 50.0, 0.2, SlipSettings(seek=0.0, swing=0.0), 2.0, uneven=u) for u in (0, 2))
    assert uneven[-1, 2] < 0.8 * even[-1, 2]
