"""The 1 kHz law: inputs of its adhesion law and of a lateral law, demand, fading, margins, record."""

from itertools import product

import numpy as np
import pytest

from railrepro.control import interface, lateral, law
from railrepro.control.adhesion import AdhesionSettings
from railrepro.quantities import GEARS, SIDES, WHEELS
from railrepro.track.route import CELL, COLUMNS, INDEX
from railrepro.vehicle.parameters import load_vehicle

LIMITS = {"lateral_limit": 0.03, "track_end": 900.0, "stop_speed": 0.1}
SEEN = (*lateral.GEAR, *lateral.ROAD, *lateral.MODEL)
SPEED, PLACES = 40.0, {"front": 30.2, "rear": 16.3}


class Probe:
    """A lateral law whose torque is one of the quantities it is given, in units of 1/`scale`; its memory counts."""

    memory = ("calls",)

    def __init__(self, **scales):
        self.gains = lambda: {f"scale_{name}": scales.get(name, 0.0) for name in SEEN}

    def torque(self, q):
        return sum(getattr(q, f"scale_{name}") * getattr(q, name) for name in SEEN), {"calls": q.calls + 1}


FUNCTION = law.function(law.LawSignature(lateral.signature(Probe())))


def cells():
    """One cell per gear with random columns that starts a little before the gear."""
    rows = np.random.default_rng(8).normal(0, 1e-3, (len(COLUMNS), len(GEARS)))
    rows[INDEX["p"]] = [PLACES[gear] - 0.3 * CELL for gear in GEARS]
    rows[INDEX["force"]] = 0.0
    return rows


def measured(**values):
    """Outputs of a car that rolls at `SPEED` without forces."""
    moving = {f"{gear}.p": PLACES[gear] for gear in GEARS} | {f"{gear}.v": SPEED for gear in GEARS}
    return dict.fromkeys(interface.MEASURED, 0.0) | moving | values


def call(y, rows=None, held=(0.0, 0.0), memory=None, adhesion=None, guidance=None):
    """Command by wheel, memory, record and margins by name."""
    control = law.control_law(load_vehicle(), guidance or Probe(), adhesion, **LIMITS)
    before = dict.fromkeys(control.signature.memory, 0.0) | (memory or {})
    inputs = [*y.values()], cells() if rows is None else rows, held, control.gains, [*before.values()]
    names = (WHEELS, control.signature.memory, control.signature.record, interface.MARGINS)
    groups = zip(names, FUNCTION(*inputs), strict=True)
    return [dict(zip(group, np.array(values).ravel(), strict=True)) for group, values in groups]


def seen_by(gear, name, scale, y=None, **inputs):
    """The quantity of that name which the lateral law of a gear gets."""
    record = call(measured(**(y or {})), guidance=Probe(**{name: scale}), **inputs)[2]
    return record[f"{gear}.du"] / scale


@pytest.mark.parametrize("gear", GEARS)
def test_a_lateral_law_sees_its_gear_the_road_there_and_the_heading_of_the_body_between_both(gear):
    rows, d, own = cells(), 0.3 * CELL, GEARS.index(gear)
    column = {name: rows[i] for name, i in INDEX.items()}
    psi = column["psi"] + column["kappa"] * d + column["dkappa"] * d**2 / 2
    kappa = column["kappa"] + column["dkappa"] * d
    expected = {"psi_Tr": psi[own], "dpsi_dp": kappa[own], "ddpsi_dp": column["dkappa"][own]}
    expected |= {f"{name}_Tr": (column[name] + d * column[f"d{name}"])[own] for name in ("phi", "eps")}
    expected |= {f"d{name}_dp": column[f"d{name}"][own] for name in ("phi", "eps")}
    expected |= {"psi_CB": psi.mean(), "dpsi_dp_CB": kappa.mean()}
    terms = {"y_ref": 1, "dy_ref": 1, "ddy_ref": 2, "dddy_ref": 6}
    shape = np.polynomial.Polynomial([column[name][own] / n for name, n in terms.items()])
    expected |= {name: shape.deriv(k)(d) for k, name in enumerate(terms)}
    assert set(expected) == set(lateral.ROAD)
    for name, value in expected.items():
        assert seen_by(gear, name, 1e4) == pytest.approx(value, rel=1e-9), name
    outputs = {"x": "p", "psi_Ax": "psi_Ax", "v": "v", "yaw_rate": "psidot_Ax", "y": "y", "psi": "psi_TrAx"}
    values = {f"{g}.{name}": 20.0 + 7 * i + k for i, g in enumerate(GEARS) for k, name in enumerate(outputs.values())}
    for name, output in outputs.items():
        assert seen_by(gear, name, 1.0, y=values) == pytest.approx(values[f"{gear}.{output}"])
    assert seen_by(gear, "held", 1.0, held=(11.0, 12.0)) == pytest.approx([11.0, 12.0][own])


def test_the_acceleration_of_a_gear_is_the_pull_of_two_wheels_on_half_a_car():
    """Half a car of 32 t and two wheels of 60 kg m2 on 0.46 m weigh 16567 kg; 1 kN m each pulls with 4348 N."""
    idle, rows = AdhesionSettings(active=False, raise_step=1.0), cells()
    rows[INDEX["force"]] = 2 * 1000.0 / 0.46
    found = seen_by("rear", "xddot", 1e3, rows=rows, memory={"rear.u": 1000.0}, adhesion=idle)
    assert found == pytest.approx(2 * 1000.0 / 0.46 / (16_000 + 2 * 60 / 0.46**2), rel=1e-9)


def test_the_nominal_vehicle_of_the_lateral_laws():
    tan, inertia = np.tan(0.025), 2000.0 + 60.0 * 1.5**2 / 2 / 0.46**2
    expected = {"J_eff": inertia, "k_sz": 60e3, "k_dz": 10e3, "J_Wy": 60.0, "r_0": 0.46, "b": 1.5, "tan_delta": tan}
    expected |= {"gamma": tan / (0.75 - 0.46 * tan), "m_x_eff": 16_000 + 2 * 60 / 0.46**2, "tau_max": 4000.0}
    assert set(expected) == set(lateral.MODEL)
    for name, value in expected.items():
        assert seen_by("front", name, 1e3 / value) == pytest.approx(value, rel=1e-12), name


@pytest.mark.parametrize("force", [5e3, -5e3])
def test_the_demand_is_shared_by_two_wheels_of_eight_tonnes(force):
    """5 kN are 0.0319 of the axle load of 156.96 kN, and 1150 N m at each wheel of 0.46 m."""
    idle, rows = AdhesionSettings(active=False, raise_step=1e6), cells()
    rows[INDEX["force"]] = [force, 2 * force]
    command, memory, record, _ = call(measured(), rows, adhesion=idle)
    for gear, share in (("front", 1), ("rear", 2)):
        assert record[f"{gear}.f_star"] == pytest.approx(share * force / 156_960)
        torque = share * force / 2 * 0.46
        assert [memory[f"{gear}.u"], record[f"{gear}.u_d"], record[f"{gear}.tau_long"]] == pytest.approx([torque] * 3)
        assert [command[f"{gear}_{side}"] for side in SIDES] == pytest.approx([torque] * 2)


def test_each_wheel_is_commanded_and_recorded_what_its_gear_decides():
    y = {"rear.y": 2e-3} | {f"front_{side}.adhesion": 0.2 for side in SIDES}
    command, memory, record, _ = call(measured(**y), held=(300.0, -500.0), guidance=Probe(held=1.0))
    assert [command[wheel] for wheel in WHEELS] == pytest.approx([300 - 5, -300 - 5, -500, 500])
    assert [record["front.du"], record["rear.du"]] == [300.0, -500.0]
    assert [record["front.segment"], record["rear.segment"]] == [3, 2]
    assert [memory["front.lateral.calls"], memory["rear.lateral.calls"], memory["ticks"]] == [1, 1, 1]
    assert call(measured(), memory={"ticks": 41.0})[1]["ticks"] == 42


@pytest.mark.parametrize(("speed", "share"), [(40.0, 1.0), (1.0, 1.0), (0.6, 0.6), (0.0, 0.0), (-0.5, 0.0)])
def test_a_wheel_that_stands_does_not_steer(speed, share):
    _, _, record, _ = call(measured(**{"front.v": speed}), held=(300.0, 300.0), guidance=Probe(held=1.0))
    assert record["front.du"] == pytest.approx(300 * share) and record["rear.du"] == 300.0


def test_margins_are_distances_to_the_limits():
    y = measured(**{"front.y": -0.01, "rear.y": 0.025, "front.p": 870.0, "rear.p": 856.0, "front.v": 0.3})
    expected = {"front.lateral": 0.02, "rear.lateral": 0.005, "track_end": 30.0, "stop_speed": 0.2}
    assert call(y)[3] == pytest.approx(expected | {"front.torque": 1.0, "rear.torque": 1.0})


def test_the_adhesion_law_gets_adhesion_and_slip_of_its_own_wheels():
    exact = {f"{wheel}.{name}": i for i, (wheel, name) in enumerate(product(WHEELS, ("adhesion", "sx")))}
    kept = call(measured(**exact), adhesion=AdhesionSettings(filter_time=4e-3))[1]  # 1 ms takes a fifth of the way
    filtered = [kept[f"{gear}.adhesion.{name}.{side}"] for gear in GEARS for side in SIDES for name in "fs"]
    assert 5 * np.array(filtered) == pytest.approx(np.arange(8))
