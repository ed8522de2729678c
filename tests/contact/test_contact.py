"""Real profiles, elastic averaging, Hertz: against values computed independently from the standards."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rolling_contact import Rolling

from railrepro.contact import creep, normal, profiles
from railrepro.contact import table as contact
from railrepro.contact.fastsim import centring_forces, equivalent_conicity, rigid_contact
from railrepro.contact.points import read_pair
from railrepro.contact.table import (
    CELL_COLUMNS,
    ContactTable,
    cone_patch,
    contact_table,
    elastic_patch,
    in_cell,
    middle_patch,
    section,
)
from railrepro.vehicle.parameters import load_vehicle

EN_15302 = Path(__file__).parent / "reference/en15302"


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
    found = [equivalent_conicity(table, 1e-3 * amplitude) for amplitude in (1, 2, 3, 5)]
    # Radii of CONTACT at its reference position, which in a wide patch are not those of free rolling.
    assert found == pytest.approx([0.192, 0.185, 0.171, 0.187], rel=0.13)


@pytest.mark.parametrize(
    ("case", "wheel", "least"), [("E1", "A", 66), ("E2", "B", 66), ("E3", "H", 63), ("E4", "I", 66)]
)
def test_equivalent_conicity_of_the_reference_profiles(case, wheel, least, tmp_path, monkeypatch):
    """Annex E of EN 15302: 66 amplitudes a case, limits as printed, to three digits. Profiles are read as measured."""
    monkeypatch.setattr(profiles, "GAUGE", 1.43516)
    parts = {}
    for part, name in (("wheel", f"RUIC519{wheel}"), ("rail", "SUIC519A")):
        lateral, up = np.loadtxt(EN_15302 / f"{name}.dat").T
        parts[part] = pd.DataFrame({"part": part, "lateral_mm": lateral, "height_mm": -up if part == "wheel" else up})
    pd.concat(parts.values()).to_csv(tmp_path / "pair.csv", index=False)
    frame = rigid_contact(np.arange(-8e-3, 8.01e-3, 5e-5), 0.46, read_pair(tmp_path / "pair.csv"))
    amplitude, _, high, low = np.loadtxt(EN_15302 / f"ben_{case}.dat").T[:4]
    found = np.array([equivalent_conicity(frame, 1e-3 * a) for a in amplitude])
    inside = (low - 5e-4 <= found) & (found <= high + 5e-4)
    assert inside.sum() >= least, amplitude[~inside]


def test_radius_is_the_integral_of_the_angle(table):
    climb = np.gradient(table["effective_radius_m"], table["shift_m"])
    inside = table["shift_m"].between(-0.008, 0.005).to_numpy()
    assert climb[inside] == pytest.approx(np.tan(table["angle_rad"])[inside], abs=5e-3)


def test_cells_give_the_table_back_by_name(table):
    cells = dict(zip(CELL_COLUMNS, ContactTable(table).cells().T, strict=True))
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


def test_a_cell_goes_on_along_its_tangent_and_holds_the_rest(table):
    table = ContactTable(table)
    cells = dict(zip(CELL_COLUMNS, table.cells().T, strict=True))
    for beyond in (-30.0, -2.0, 3.0, 40.0):
        offset, small = beyond * table.step, 1e-8
        low, here, high = (in_cell(cells, offset + d) for d in (-small, 0.0, small))
        climb = (high["effective_radius"] - low["effective_radius"]) / (2 * small)
        assert climb == pytest.approx(here["slope"], abs=2e-7)
        end = in_cell(cells, 0.0 if beyond < 0 else table.step)
        for name in ("slope", "rail_contact", "semi_axis_x", "semi_axis_y", "c11", "c33"):
            assert np.allclose(here[name], end[name], rtol=1e-7, atol=1e-9), name  # but for a picometre
        assert here["semi_axis_y"].min() > 0
        further = here["effective_radius"] - end["effective_radius"]
        assert here["rolling_radius"] - end["rolling_radius"] == pytest.approx(further, abs=1e-10)


def test_cone_stands_on_the_crown_of_the_rail():
    """Hertz worked out by hand: wheel of 460 mm on a crown of 300 mm, 78.48 kN of steel on steel."""
    vehicle = load_vehicle()
    a, b, coefficients = cone_patch(vehicle)
    assert [1e3 * a, 1e3 * b] == pytest.approx([6.635, 4.990], abs=2e-3)
    assert coefficients == pytest.approx((4.55, 4.14, 1.86, 0.99), abs=0.01)
    assert middle_patch(load_vehicle(**{"contact.profile": "cone"})) == (a, b, coefficients)
    wider, _, _ = cone_patch(load_vehicle(**{"wheel.radius": 0.5}))
    assert wider > a
    modulus = normal.contact_modulus(vehicle.contact.young, vehicle.contact.poisson)
    load = vehicle.contact.nominal_load
    _, _, approach = normal.hertz(1 / vehicle.wheel.radius, 1 / profiles.CROWN_RADIUS, load, modulus)
    assert vehicle.contact.normal_stiffness == pytest.approx(load / approach**1.5, rel=0.02)


def elastic(shift, load=8e4):
    return elastic_patch(shift, 0.46, load, normal.contact_modulus(2.1e11, 0.28))


def ellipse(patch):
    """Semi-axes and creep coefficients of a patch."""
    a, b, coefficients = creep.strip_coefficients(patch.half_lengths, patch.strips)
    return a, b, *coefficients


def spin_force(patch, load, friction):
    """Lateral creep force of a wheel that rolls freely (N)."""
    spin = -np.sin(np.arctan(patch.slope)) / (0.46 + patch.height)
    return float(creep.polach(0.0, 0.0, spin, load, *ellipse(patch), 8.2e10, 1.0, 1.0, friction, 1.0, 0.0, 0.0)[1])


def test_elastic_contact_of_one_curvature_is_hertz():
    position = np.arange(-0.02, 0.02, 2e-5)
    crown = position**2 / 2 / 0.3
    modulus = normal.contact_modulus(2.1e11, 0.28)
    found = normal.elastic_contact(position, 0 * position, 0 * position, crown, 0.46, 8e4, modulus)
    a, b, approach = normal.hertz(1 / 0.46, 1 / 0.3, 8e4, modulus)
    assert ellipse(found) == pytest.approx([float(v) for v in (a, b, *creep.kalker_coefficients(a / b))], rel=0.01)
    assert found.approach == pytest.approx(approach, rel=0.01)
    assert (found.position, found.slope) == pytest.approx((0, 0), abs=1e-9)


@pytest.mark.parametrize("shift", [-3e-3, -1e-3, 1e-3, 1.2e-3, 1.5e-3, 3e-3, 4.5e-3])
def test_grid_of_the_elastic_contact_is_fine_enough(shift, monkeypatch):
    coarse = elastic(shift)
    monkeypatch.setattr(normal, "_CELLS", (60, 150))
    monkeypatch.setattr(normal, "_TOLERANCE", 1e-6)
    fine = elastic(shift)
    assert coarse.slope == pytest.approx(fine.slope, abs=1e-4)
    assert coarse.height == pytest.approx(fine.height, abs=2e-6)
    assert spin_force(coarse, 8e4, 0.3) == pytest.approx(spin_force(fine, 8e4, 0.3), rel=0.015)


def test_elastic_profiles_meet_published_values_at_80_kn():
    """Difference of the radii at the mean positions of a wheelset 1 mm off the centre: .64 mm rigid, .39 under load."""
    right, left = (profiles.s1002(elastic(shift).position - profiles.TAPE_CIRCLE - shift)[0] for shift in (1e-3, -1e-3))
    assert 1e3 * (right - left) == pytest.approx(0.39, abs=0.02)


def rolled(shift, load=8e4, friction=0.4):
    """The patch, and creep forces of half spaces on the real profiles over the radius of free rolling less nominal."""
    position, height, slope, rail_depth = section(shift)
    patch, modulus = elastic(shift, load), normal.contact_modulus(2.1e11, 0.28)
    cos, gap = np.cos(np.arctan(patch.slope)), (height - rail_depth).max() - height + rail_depth
    touching, half = patch.half_lengths > 0, patch.half_lengths.max()
    y = np.linspace(*(patch.position + cos * patch.strips[touching][[0, -1]] * 1.03), 44)
    x = np.linspace(-1.1 * half, 1.1 * half, 18)
    sides = x[1] - x[0], (y[1] - y[0]) / cos
    distance = cos * (x[:, None] ** 2 / 2 / 0.46 + np.interp(y, position, gap))
    pressure, _ = normal.half_space_pressure(distance, load, sides, modulus)
    touching = pressure > 0
    x, y = (grid[touching] for grid in np.meshgrid(x, y, indexing="ij"))
    height, slope = (np.interp(y, position, values) for values in (height, slope))
    cells, bound = Rolling(x, (y - patch.position) / cos, sides), friction * pressure[touching]
    return patch, lambda free: cells.load(bound, (free - height) / (0.46 + free), 0.0, -slope / 0.46)


@pytest.mark.parametrize("shift", [-2e-3, -1e-3, -2.5e-4, 0.0, 2.5e-4, 5e-4, 1e-3, 1.5e-3, 2e-3, 3e-3, 4e-3])
def test_rolling_radius_makes_no_longitudinal_force(shift):
    """Half spaces in steady rolling on the real profiles: to 10 micrometres; radii there change by 1.2 mm."""
    patch, load = rolled(shift)
    trials = patch.height + np.array([3e-5, -3e-5])
    forces = [load(free)[0] for free in trials]
    assert patch.height == pytest.approx(np.interp(0.0, forces, trials), abs=1e-5)


@pytest.mark.parametrize("load", [6e4, 1.1e5])
@pytest.mark.parametrize("shift", [1e-3, 2e-3, 4e-3])
def test_spin_forces_of_a_gear_beside_the_middle_against_half_spaces(shift, load):
    """The spin of both wheels pushes the gear on; its patches have one lobe or two."""
    ours, theirs = 0.0, 0.0
    for side in (1, -1):
        patch, force = rolled(side * shift, load, 0.3)
        ours += side * spin_force(patch, load, 0.3)
        theirs += side * force(patch.height)[1]
    assert ours / theirs == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(("shift", "published"), [(5e-4, 298), (1e-3, 535), (2e-3, 943), (3e-3, 1217), (4e-3, 1852)])
def test_a_gear_beside_the_middle_is_centred_as_published(shift, published):
    """Weight less spin of two free wheels at 80 kN each, friction .3; small differences of forces of kilonewtons.

    Source: CONTACT, free rolling.
    """
    net = sum(centring_forces(shift, load_vehicle(), 8e4, 0.3))
    assert net == pytest.approx(published, rel=0.15)


def test_points_of_standard_profiles_give_the_contact_of_the_standard_ones(tmp_path, monkeypatch):
    """Points every 0.3 mm on the wheel and 0.2 mm on the rail, to 10 nm; a rail has any origin."""
    lateral_, (position, depth) = np.arange(-0.06, 0.058, 3e-4), profiles.inclined_rail(401)
    parts = {"wheel": (lateral_, profiles.s1002(lateral_)[0]), "rail": (position - 0.8, 0.1 - depth)}
    rows = [pd.DataFrame({"part": part, "lateral_mm": 1e3 * s, "height_mm": 1e3 * z}) for part, (s, z) in parts.items()]
    pd.concat(rows).to_csv(tmp_path / "pair.csv", index=False, float_format="%.5f")
    monkeypatch.setattr(contact, "SHIFTS", np.array([-4e-3, -2e-3, 0.0, 2e-3, 4e-3]))
    material = 0.4601, 78480.0, 1.14e11, 9.2e10  # a radius of no other test: tables are cached
    mine = contact.pair_table(*material, read_pair(tmp_path / "pair.csv")).frame
    theirs = contact.pair_table(*material).frame
    assert np.allclose(mine["rolling_radius_m"], theirs["rolling_radius_m"], rtol=0, atol=5e-6)
    assert np.allclose(mine["angle_rad"], theirs["angle_rad"], rtol=0, atol=1e-3)
    assert np.allclose(mine["semi_axis_y_m"], theirs["semi_axis_y_m"], rtol=0.03)
