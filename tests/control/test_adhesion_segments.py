"""Steps of the adhesion law. With the error nu = f* - f (24) the torque changes by p sgn(nu) in regular operation (22),
(25). Where the switching function f' s' (21) shows that the maximum is passed, it falls whatever nu is (23). The
printed slip is negative in traction, so a stable wheel has f' s' < 0."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.creep import adhesion_maximum
from railrepro.contact.table import middle_patch
from railrepro.control.adhesion import AdhesionInputs, AdhesionMemory, AdhesionSettings
from railrepro.quantities import pack, symbols
from railrepro.simulation import bare_wheel
from railrepro.vehicle.parameters import load_vehicle

LAW = AdhesionSettings(raise_step=2.0, lower_step=5.0, drop_step=15.0, corridor=3e-3, filter_time=4e-3, dead_zone=1e-3)
LIMIT, LOAD, RADIUS, SPEED = 4000.0, 80e3, 0.45, 50.0
SET_POINT, SLIP = 0.05, 0.01
POLE = 1 / 5  # of the filter: 1 ms / (4 ms + 1 ms)
BELOW, INSIDE, ABOVE = (0.02, 0.02), (0.05, 0.05), (0.08, 0.08)
BACK, REST, AHEAD = (-1e-4, -1e-4), (0.0, 0.0), (1e-4, 1e-4)
REGULAR = {BELOW: (2.0, 1), INSIDE: (0.0, 2), ABOVE: (-5.0, 3)}
EDGES = {0.04701: (0.0, 2), 0.04699: (2.0, 1), 0.05299: (0.0, 2), 0.05301: (-5.0, 3), -0.08: (2.0, 1)}
GROUPS = {"q": AdhesionInputs, "memory": AdhesionMemory, "settings": AdhesionSettings}
VECTORS, (_Q, _MEMORY, _SETTINGS) = zip(*(symbols(group, name) for name, group in GROUPS.items()), strict=True)
_U, _KEPT, _SEGMENT = _SETTINGS.base_torque(_Q, _MEMORY)
FUNCTION = ca.Function("law", VECTORS, [_U, ca.vertcat(_U, *pack(_KEPT)), _SEGMENT])


def call(f, s, f_star, memory, settings=LAW, v=SPEED):
    """Next torque, memory (torque first) and segment; all as the controller sees them, slip as printed."""
    u, *filtered = memory
    q = AdhesionInputs(list(f), list(s), f_star, v, u, LOAD, LIMIT, RADIUS)
    u, kept, segment = FUNCTION(pack(q), filtered, pack(settings))
    return float(u), np.array(kept).ravel(), int(segment)


def change(adhesion, slip=REST, rise=REST, u=1000.0, settings=LAW, level=SLIP, v=SPEED):
    """Change of the torque, and segment, in traction, at adhesions of both wheels that have changed by `rise`, and at a
    slip of `-level` whose amount has changed by `slip`."""
    memory = [u, *(np.array(adhesion) - rise), *(np.array(slip) - level)]
    found, _, segment = call(adhesion, [-level] * 2, SET_POINT, memory, settings, v)
    return found - u, segment


near = st.floats(-0.1, 0.1)


@given(f=st.tuples(near, near), s=st.tuples(near, near), kept=st.tuples(near, near, near, near), u=st.floats(-4e3, 4e3))
def test_braking_is_the_mirror_image_of_traction(f, s, kept, u):
    f, s, memory = np.array(f), np.array(s), np.array([u, *kept])
    (found, kept, segment), mirror = call(f, s, SET_POINT, memory), call(-f, -s, -SET_POINT, -memory)
    assert (found, segment) == (-mirror[0], mirror[2]) and np.array_equal(kept, -mirror[1])


MEANS = {(0.02, 0.07): (2.0, 1), (0.03, 0.09): (-5.0, 3)}  # the mean of both wheels counts


@pytest.mark.parametrize(("adhesion", "found"), (REGULAR | {(f, f): of for f, of in EDGES.items()} | MEANS).items())
def test_regular_steps(adhesion, found):
    """Estimates at rest: f' s' = 0 says nothing, the error of adhesion decides."""
    assert change(adhesion) == (pytest.approx(found[0]), found[1])


PAST = [(BACK, AHEAD), (AHEAD, BACK), ((-1e-4, 1e-4), AHEAD), ((1e-4, -1e-4), AHEAD)]  # one wheel is enough
STABLE = [(AHEAD, AHEAD), (BACK, BACK), (BACK, REST), (REST, AHEAD)]


@pytest.mark.parametrize("adhesion", REGULAR)
@pytest.mark.parametrize(("rise", "slip"), PAST + STABLE)
@pytest.mark.parametrize("level", [SLIP, 0.0, -SLIP])
def test_a_wheel_past_its_maximum_with_slip_in_the_direction_of_the_demand_drops_the_torque(
    adhesion, rise, slip, level
):
    step, segment = (-15.0, 3) if (rise, slip) in PAST and level > 0 else REGULAR[adhesion]
    assert change(adhesion, slip, rise, level=level) == (pytest.approx(step), segment)


@pytest.mark.parametrize(
    ("noise_speed", "v", "growth"),
    [(0.0, SPEED, 1.0), (100.0, 200.0, 1.0), (100.0, 25.0, 4.0), (100.0, 0.0, 100.0)],
)
def test_dead_zone_is_a_rate_of_the_filtered_slip_and_grows_as_its_noise_does(noise_speed, v, growth):
    settings = replace(LAW, noise_speed=noise_speed)
    for share, step in ((0.99, 2.0), (1.01, -15.0), (-0.99, 2.0), (-1.01, -15.0)):
        moved, rise = share * growth * LAW.dead_zone * CONTROL_PERIOD / POLE, -1e-4 * np.sign(share)
        assert change(BELOW, (moved, moved), (rise, rise), settings=settings, v=v)[0] == pytest.approx(step)


def test_a_demand_of_zero_counts_as_traction():
    u, _, segment = call([0.02, 0.02], [-0.02, -0.02], 0.0, [100.0, 0.03, 0.03, -0.01, -0.01])
    assert (u, segment) == (pytest.approx(85.0), 3)


@pytest.mark.parametrize(("u", "following"), [(16.0, 1.0), (7.0, 0.0), (0.0, 2.0), (-3.0, -1.0)])
def test_letting_go_ends_at_zero_torque(u, following):
    step, segment = change(BELOW, AHEAD, BACK, u=u)
    assert (u + step, segment) == (pytest.approx(following), 3)


@pytest.mark.parametrize(("adhesion", "u", "step"), [(BELOW, LIMIT - 1, 1.0), (ABOVE, 1 - LIMIT, -1.0)])
def test_the_torque_limit_ends_a_step(adhesion, u, step):
    assert change(adhesion, u=u)[0] == pytest.approx(step)


@pytest.mark.parametrize(
    ("f_star", "u", "following"),
    [(0.05, 1000.0, 1002.0), (0.05, 1801.5, 1800.0), (0.05, 2000.0, 1998.0), (0.2, 3999.0, 4000.0)],
)
def test_without_slip_control_the_torque_follows_the_demand(f_star, u, following):
    idle = replace(LAW, active=False)
    found, kept, _ = call([0.02, 0.02], [-0.01, -0.01], f_star, [u, 0.03, 0.03, -0.005, -0.005], idle)
    assert found == kept[0] == pytest.approx(following)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_bare_wheel_comes_to_its_set_point_or_to_its_maximum_and_moves_its_share_of_the_car(sign):
    vehicle, law, demand = load_vehicle(), AdhesionSettings(), sign * np.tile([0.05, 0.2], (6000, 1))
    poor = vehicle.adhesion["poor"]
    run = bare_wheel.simulate(vehicle, [bare_wheel.Case(law, poor)] * 2, 400 / 3.6, demand)
    late = sign * run.adhesion[-2000:]
    assert np.abs(late[:, 0] - 0.05).max() < 2 * law.corridor
    patch = *middle_patch(vehicle), vehicle.contact.shear_modulus
    peak, _ = adhesion_maximum(poor, 400 / 3.6, vehicle.wheel_load, *patch)
    assert late[:, 1].max() == pytest.approx(peak, rel=0.01) and late[:, 1].mean() > 0.9 * peak
    assert np.abs(run.slip[:, 1]).max() < 0.06
    gained = 1e-3 * 9.81 * np.cumsum(run.adhesion[:, 0])  # v' = g f
    assert run.speed[1:, 0] - 400 / 3.6 == pytest.approx(gained[:-1], abs=2e-2) and np.abs(gained).max() > 2.0
