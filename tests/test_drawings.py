"""The schematics: wheels stand on rails, the symbols that the text explains are there, letters do not collide."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib import pyplot as plt

from railrepro.evidence.report import drawings, perspective
from railrepro.vehicle.parameters import load_vehicle

SYMBOLS = {
    "running_gear": (
        *("x_0", "x_{Tr}", "y_{Tr}", "z_{Tr}", "x_{Ax}", "y_{Ax}", "z_{Ax}", r"\boldsymbol{r}_{0Tr}(p)", "y_{TrAx}"),
        *(r"\psi_{Tr}", r"\psi_{TrAx}", r"\psi_{Ax}", r"\varphi_{Tr}", r"\varphi_{TrAx}", "z_{TrAx}", "F_{N,le}"),
        *("F_{x,ri}", "F_{y,ri}", r"\tau_{le}", r"\omega_{ri}", r"\mathcal{F}_{Train}", r"\boldsymbol{r}_{TrAx}"),
    ),
    "simplified_model": (
        *(r"\psi_{CB}", r"\psi_{Tr}(p)", r"\psi_{Tr}(p - L_{CB})", "L_{CB}", "k_{s_z}", "k_{d_z}", "k_{s_x}"),
        *("k_{d_x}", "m_{CB}", "J_{Ax_z}", r"\boldsymbol{J}_W", "r_{ri}", "y_{le}", r"\delta_0", r"\Gamma", "$b$"),
        *("y_{TrAx}", r"\psi_{TrAx}", r"\varphi_{TrAx}", r"\omega_j", r"\tau_{ri}", r"\psi_{Ax}", "$x"),
    ),
    "control_structure": (
        *("F_x^*", "y^*", r"\theta", r"\boldsymbol{x}_k^d", "u^d", r"\Delta u", r"\tau_{ri}", r"\hat f_{x_j}"),
        *(r"\hat s_{x_j}", r"\hat{\boldsymbol{x}}", "1 kHz", "every $T$", "integration", "adhesion"),
    ),
}


@pytest.fixture(params=SYMBOLS)
def drawn(request):
    figure = getattr(drawings, request.param)()
    yield request.param, figure
    plt.close(figure)


def test_symbols_of_the_text_are_there(drawn):
    name, figure = drawn
    written = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert [symbol for symbol in SYMBOLS[name] if symbol not in written] == []


def test_letters_are_large_inside_and_apart(drawn):
    _, figure = drawn
    figure.canvas.draw()
    texts = [text for text in figure.axes[0].texts if text.get_text()]
    assert min(text.get_fontsize() for text in texts) >= 7 and figure.get_size_inches()[0] <= 7
    boxes = {text.get_text(): text.get_window_extent() for text in texts if not text.get_rotation()}
    page = figure.bbox
    assert [t for t, b in boxes.items() if b.x0 < 0 or b.y0 < 0 or b.x1 > page.x1 or b.y1 > page.y1] == []
    assert [pair for pair in combinations(boxes, 2) if boxes[pair[0]].overlaps(boxes[pair[1]])] == []


@pytest.mark.parametrize("displacement", [0.0, 0.09, -0.09])
def test_wheels_stand_on_the_rails_and_the_larger_radius_is_on_the_side_of_the_displacement(displacement):
    view = drawings.RearView((0.0, 0.0), 0.12, displacement)
    for side in (-1, 1):
        assert view.inside(view.contact(side))[1] == pytest.approx(view.reach(side), abs=5e-3)
    assert np.sign(round(view.reach(1) - view.reach(-1), 9)) == np.sign(displacement)
    assert np.sign(view.axle.angle - view.track.angle) == -np.sign(displacement)


def test_right_and_down_are_where_a_reader_from_behind_expects_them():
    level = drawings.Place((1.0, 2.0))
    assert level(1.0, 0.0) == pytest.approx((2.0, 2.0)) and level(0.0, 1.0) == pytest.approx((1.0, 1.0))
    canted = drawings.Place((0.0, 0.0), np.radians(10))
    assert canted(1.0)[1] < 0 and canted(0.0, 1.0)[0] < 0


def test_what_is_farther_away_is_drawn_smaller_and_the_aimed_point_is_in_the_centre():
    view = perspective.View((9.0, 6.5, -2.1), (-2.6, 0.0, -1.2), 8.4, (3.3, 1.72))
    near, far = (np.ptp(view([(x, 0.0, -1.0), (x, 0.0, 0.0)])[:, 1]) for x in (0.0, -14.0))
    assert near > 1.5 * far > 0
    assert view((-2.6, 0.0, -1.2)) == pytest.approx((3.3, 1.72))
    right, up = view((-2.6, -0.1, -1.2)) - view.centre, view((-2.6, 0.0, -1.3)) - view.centre
    assert right[0] > 0 and up[1] > 0  # the eye looks back at the car: its left is on the right of the paper


def test_wheels_of_the_perspective_stand_on_the_rails():
    vehicle = load_vehicle()
    for gear in (0.0, -vehicle.body.gear_spacing):
        left, right = (np.array(perspective.contact(vehicle, gear, side)) for side in (-1, 1))
        assert right[1] - left[1] == vehicle.gear.contact_base and left[2] == right[2] == 0.0


def test_names_of_the_perspective_are_large_inside_and_apart():
    figure = perspective.car()
    figure.canvas.draw()
    boxes = {text.get_text(): text.get_window_extent() for text in figure.axes[0].texts if text.get_text()}
    page = figure.bbox
    assert {"car body", "front running gear", "rear running gear", "wheel motor"} <= set(boxes)
    assert [t for t, b in boxes.items() if b.x0 < 0 or b.y0 < 0 or b.x1 > page.x1 or b.y1 > page.y1] == []
    assert [pair for pair in combinations(boxes, 2) if boxes[pair[0]].overlaps(boxes[pair[1]])] == []
    plt.close(figure)
