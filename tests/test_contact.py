"""Real profiles, elastic averaging, Hertz: against values computed independently from the standards."""

import numpy as np
import pytest

from railrepro.contact import normal, profiles
from railrepro.contact.table import (
    CELL_COLUMNS,
    ContactTable,
    contact_table,
    equivalent_conicity,
    in_cell,
    rigid_contact,
)
from railrepro.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def table():
    return contact_table("s1002", load_vehicle(**{"contact.profile": "s1002"})).frame


@pytest.mark.parametrize(
    ("shift", "position", "slope", "radius"),
    [
        (-3, 757.3, 0.0110, 424.789),
        (0, 753.3, 0.0242, 424.906),
        (1, 741.7, 0.0708, 425.472),
        (5, 737.3, 0.127, 426.285),
    ],
)
def test_rigid_points(shift, position, slope, radius):
    found = rigid_contact([1e-3 * shift], 0.425).iloc[0]
    assert 1e3 * found["position_m"] == pytest.approx(position, abs=0.06)
    assert found["tan_angle"] == pytest.approx(slope, abs=5e-4)
    assert 1e3 * found["rolling_radius_m"] == pytest.approx(radius, abs=0.002)


def test_profiles_meet_their_check_points():
    depth = profiles.rail_head(1e-3 * np.array([10, 20, 26, 30, 35]))
    assert 1e3 * depth == pytest.approx([0.1667, 1.086, 2.256, 3.940, 9.849], abs=2e-3)
    height, slope = profiles.s1002(np.array([0.0]))
    assert height[0] == 0.0 and slope[0] == pytest.approx(-3.358537058e-2)


def test_equivalent_conicity_under_load(table):
    found = equivalent_conicity(table["shift_m"], table["rolling_radius_m"], 3e-3)
    assert found == pytest.approx(0.171, abs=0.01)
    cone = equivalent_conicity(table["shift_m"], 0.05 * table["shift_m"], 3e-3)
    assert cone == pytest.approx(0.05, rel=1e-3)


def test_radius_is_the_integral_of_the_angle(table):
    climb = np.gradient(table["effective_radius_m"], table["shift_m"])
    inside = table["shift_m"].between(-0.008, 0.005).to_numpy()
    assert climb[inside] == pytest.approx(np.tan(table["angle_rad"])[inside], abs=5e-3)


def test_elastic_averaging_has_no_jump(table):
    inside = table[table["shift_m"].between(-0.005, 0.005)]
    assert np.abs(np.diff(inside["rail_contact_m"])).max() < 1.5e-3  # a rigid contact jumps by 12 mm
    assert (inside[["semi_axis_x_m", "semi_axis_y_m", "c11", "c22", "c23"]] > 0).all().all()


def test_cells_give_the_table_back_by_name(table):
    cells = dict(zip(CELL_COLUMNS, ContactTable("s1002", table).cells().T, strict=True))
    shift = table["shift_m"].to_numpy()
    at_start, inside = in_cell(cells, 0.0), in_cell(cells, 3e-5)
    assert np.array_equal(cells["shift"], shift[:-1])
    assert np.array_equal(at_start["effective_radius"], table["effective_radius_m"][:-1])
    assert np.array_equal(at_start["slope"], np.tan(table["angle_rad"][:-1]))
    at_end = in_cell(cells, np.diff(shift))
    assert at_end["effective_radius"] == pytest.approx(table["effective_radius_m"][1:].to_numpy(), rel=1e-14)
    assert at_end["slope"] == pytest.approx(np.tan(table["angle_rad"][1:].to_numpy()), rel=1e-9)
    for column in table.columns.drop(["shift_m", "effective_radius_m", "angle_rad", "approach_m"]):
        expected = np.interp(shift[:-1] + 3e-5, shift, table[column])
        assert inside[column.removesuffix("_m")] == pytest.approx(expected, rel=1e-12), column


def test_hertz_of_equal_curvatures_is_a_circle():
    modulus = normal.contact_modulus(2.1e11, 0.28)
    a, b, approach = normal.hertz(2.0, 2.0, 8e4, modulus)
    radius = (3 * 8e4 * 0.5 / (4 * modulus)) ** (1 / 3)
    assert [a, b] == pytest.approx([radius, radius], rel=1e-3)
    assert approach == pytest.approx(radius**2 / 0.5, rel=1e-3)


def test_half_space_agrees_with_hertz():
    modulus, cell = normal.contact_modulus(2.1e11, 0.28), 4e-4
    grid = np.arange(-0.012, 0.012, cell)
    gap = grid[:, None] ** 2 + 0.75 * grid[None, :] ** 2
    pressure, approach = normal.half_space_pressure(gap, 8e4, cell, modulus)
    a, b, exact = normal.hertz(2.0, 1.5, 8e4, modulus)
    assert approach == pytest.approx(exact, rel=0.02)
    assert pressure.max() == pytest.approx(1.5 * 8e4 / (np.pi * a * b), rel=0.05)
