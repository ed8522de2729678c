"""Profiles, equivalent conicity, contact table, Hertz and elastic contact, against independent values."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rolling_contact import TABLE
from scipy.interpolate import CubicSpline, make_smoothing_spline
from scipy.special import ellipk

from railrepro.contact import creep, normal, profiles
from railrepro.contact import table as contact
from railrepro.vehicle.parameters import load_vehicle

EN_15302 = Path(__file__).parent / "reference/en15302"
MODULUS = 2.1e11 / 2 / (1 - 0.28**2)  # of steel


@pytest.fixture(scope="module")
def table():
    return contact.contact_table("s1002", load_vehicle(**{"contact.profile": "s1002"})).frame


def test_profiles_meet_their_check_points():
    depth = profiles.rail_head(1e-3 * np.array([10, 20, 26, 30, 35]))
    assert 1e3 * depth == pytest.approx([0.1667, 1.086, 2.256, 3.940, 9.849], abs=2e-3)
    height, slope = profiles.s1002(np.array([0.0]))
    assert height[0] == 0.0 and slope[0] == pytest.approx(-3.358537058e-2)


def reference(name, sign):
    """Lateral coordinates and heights (m) of a profile of EN 15302, smoothed against noise in its slopes."""
    lateral, height = np.loadtxt(EN_15302 / f"{name}.dat").T
    uniform = np.arange(np.ceil(10 * lateral[0]), np.floor(10 * lateral[-1]) + 1) / 10
    return 1e-3 * uniform, 1e-3 * sign * make_smoothing_spline(lateral, sign * height)(uniform)


@pytest.mark.parametrize(("case", "least"), [("E1 A", 66), ("E2 B", 66), ("E3 H", 63), ("E4 I", 66)])
def test_equivalent_conicity_of_the_reference_profiles(case, least):
    """Annex E of EN 15302: number of the 66 amplitudes of a case within the printed limits, to three digits."""
    case, wheel = case.split()
    lateral, height = reference(f"RUIC519{wheel}", -1)
    wheel, (across, depth) = CubicSpline(lateral, -height), reference("SUIC519A", 1)
    depth = depth.max() - depth
    inner = across < across[np.argmin(depth)]
    across = across - np.interp(0.014, depth[inner][::-1], across[inner][::-1]) + 1.43516 / 2
    position = np.arange(across[0], across[-1], 2e-5)
    rail = np.interp(position, across, depth)
    shift, radii = np.arange(-8e-3, 8.01e-3, 5e-5), []
    for u in shift:
        up = wheel(position - profiles.TAPE_CIRCLE - u) - wheel(0.0)
        radii.append(0.46 + up[np.argmax(up - rail)])
    frame = pd.DataFrame({"shift_m": shift, "rolling_radius_m": radii})
    amplitude, _, high, low = np.loadtxt(EN_15302 / f"ben_{case}.dat").T[:4]
    found = np.array([contact.equivalent_conicity(frame, 1e-3 * a) for a in amplitude])
    inside = (low - 5e-4 <= found) & (found <= high + 5e-4)
    assert inside.sum() >= least, amplitude[~inside]


def test_cells_are_the_table_inside_and_go_on_along_their_tangent_beyond(table):
    """The effective radius stays the integral of its slope, the rolling radius has this slope, the rest is constant."""
    cells = dict(zip(contact.CELL_COLUMNS, contact.ContactTable(table).cells().T, strict=True))
    starts, width = table["shift_m"].to_numpy()[:-1], cells["width"]
    assert np.array_equal(cells["shift"], starts)
    for share in (0.0, 0.3, 1.0):
        inside = contact.in_cell(cells, share * width)
        for column in table.columns.drop(["shift_m", "effective_radius_m", "angle_rad"]):
            expected = np.interp(starts + share * width, table["shift_m"], table[column])
            assert inside[column.removesuffix("_m")] == pytest.approx(expected, rel=1e-12), column
    for share, rows in ((0.0, slice(-1)), (1.0, slice(1, None))):
        end, beyond = (contact.in_cell(cells, at * width) for at in (share, 60 * share - 30))
        assert end["effective_radius"] == pytest.approx(table["effective_radius_m"].to_numpy()[rows], rel=1e-14)
        assert end["slope"] == pytest.approx(np.tan(table["angle_rad"].to_numpy()[rows]), rel=1e-9)
        climb = end["slope"] * (59 * share - 30) * width
        for name in ("effective_radius", "rolling_radius"):
            assert beyond[name] - end[name] == pytest.approx(climb, abs=1e-10), name
        for name in ("slope", "rail_contact", "semi_axis_x", "semi_axis_y", "c11", "c33"):
            assert np.allclose(beyond[name], end[name], rtol=1e-7, atol=1e-9), name  # but for a picometre


def test_cone_stands_on_the_crown_of_the_rail():
    """Against Hertz by hand: wheel of 460 mm on a crown of 300 mm, 78.48 kN of steel on steel."""
    vehicle = load_vehicle(**{"contact.profile": "cone"})
    a, b, coefficients = contact.middle_patch(vehicle)
    assert [1e3 * a, 1e3 * b] == pytest.approx([6.635, 4.990], abs=2e-3)
    assert coefficients == pytest.approx((4.55, 4.14, 1.86, 0.99), abs=0.01)
    *_, of_cork = contact.middle_patch(load_vehicle(**{"contact.profile": "cone", "contact.poisson": 0.0}))
    assert of_cork == pytest.approx(creep.kalker_coefficients(a / b, 0.0))
    load = vehicle.contact.nominal_load
    e2 = 1 - (b / a) ** 2
    approach = 3 * load * ellipk(e2) / (2 * np.pi * a * MODULUS)
    assert vehicle.contact.normal_stiffness == pytest.approx(load / approach**1.5, rel=0.02)


def test_elastic_contact_of_one_curvature_is_hertz():
    position = np.arange(-0.02, 0.02, 2e-5)
    crown = position**2 / 2 / 0.3
    found = normal.elastic_contact(position, 0 * position, 0 * position, crown, 0.46, 8e4, MODULUS)
    a, b = normal.hertz(1 / 0.46, 1 / 0.3, 8e4, MODULUS)
    assert normal.hertz(1 / 0.3, 1 / 0.46, 8e4, MODULUS) == (b, a)
    for poisson in (0.28, 0.0):
        found_a, found_b, coefficients = creep.strip_coefficients(found.half_lengths, found.strips, poisson)
        assert (found_a, found_b) == pytest.approx((a, b), rel=0.01)
        assert coefficients == pytest.approx(creep.kalker_coefficients(a / b, poisson), rel=0.01)
    assert (found.position, found.slope) == pytest.approx((0, 0), abs=1e-9)


def test_table_is_that_of_half_spaces_on_the_real_profiles(table):
    """Against patches of squares, not of strips, without sliding. Coefficients differ by up to 8 %, c33 by 30 %."""
    theirs = pd.read_csv(TABLE).query("shift_m < 4.6e-3")
    shift = theirs.pop("shift_m")
    ours = {name: np.interp(shift, table["shift_m"], column) for name, column in table.items()}
    area = ours["semi_axis_x_m"] * ours["semi_axis_y_m"]
    assert np.tan(ours["angle_rad"]) == pytest.approx(theirs["slope"].to_numpy(), abs=5e-5)
    assert ours["rolling_radius_m"] == pytest.approx(theirs["rolling"].to_numpy(), abs=1.1e-5)
    of = {"along": ("c11", 1, 0.04), "across": ("c22", 1, 0.07), "spin": ("c23", 1.5, 0.08), "turn": ("c33", 2, 0.3)}
    for name, (coefficient, power, tolerance) in of.items():
        assert ours[coefficient] * area**power == pytest.approx(theirs[name].to_numpy(), rel=tolerance), name
