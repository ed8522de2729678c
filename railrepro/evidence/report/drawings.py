"""The schematics of the paper in our own hand: running gear, simplified model, control structure.

Drawn by code so that names and signs agree with the library, in inches on paper. Angles, cones and displacements are
exaggerated, but wheels stand on rails by the same geometry as in the model. Serves the paper's Figs. 1, 3 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon

from railrepro.evidence.report import figures
from railrepro.evidence.report.figures import BLACK, BLUE, GREEN, RED

GREY, STEEL, LIGHT, AMBER = "0.45", "0.62", "0.93", "#B07700"
SIZE = 9.0
"""Of letters (pt); notes are one smaller."""
WIDTH = 7.0
"""Of both columns (in)."""


class Place:
    """A frame on the paper: where an origin lies and where its axes point, both with length 1 in.

    Parameters
    ----------
    origin : array_like, shape (2,)
    angle : float
        From the right to the first axis, clockwise (rad), as yaw from above and roll from behind.
    """

    def __init__(self, origin: Sequence[float], angle: float = 0.0):
        self.origin, self.angle = np.asarray(origin, float), angle
        self.first = np.array([np.cos(angle), -np.sin(angle)])
        self.second = np.array([-np.sin(angle), -np.cos(angle)])

    def __call__(self, first: float, second: float = 0.0) -> np.ndarray:
        """The point on the paper of coordinates in this frame (in)."""
        return self.origin + first * self.first + second * self.second

    def placed(self, first: float, second: float, angle: float = 0.0) -> Place:
        """A frame whose origin is a point of this one, turned against it."""
        return Place(self(first, second), self.angle + angle)


def _canvas(height: float) -> tuple[Figure, Axes]:
    figure, axes = figures.new_figure(height=height, width=WIDTH)
    figure.set_layout_engine("none")
    axes.set_position((0, 0, 1, 1))
    axes.set(xlim=(0, WIDTH), ylim=(0, height))
    axes.axis("off")
    return figure, axes


def _text(axes: Axes, point, text: str, color=BLACK, size=SIZE, **look) -> None:
    look = {"ha": "center", "va": "center", "zorder": 6} | look
    axes.text(point[0], point[1], text, color=color, fontsize=size, **look)


def _line(axes: Axes, *points, color=BLACK, width=0.8, style="-", zorder=2) -> None:
    axes.plot(*np.transpose(points), color=color, linewidth=width, linestyle=style, zorder=zorder)


def _arrow(axes: Axes, start, end, color=BLACK, width=1.0, style="-|>", head=7.0, **more) -> None:
    look = {"arrowstyle": style, "mutation_scale": head, "color": color, "linewidth": width, "zorder": 5}
    axes.add_patch(FancyArrowPatch(start, end, shrinkA=0, shrinkB=0, **look | more))


def _shape(axes: Axes, points, face="white", edge=BLACK, width=0.8, zorder=2, **more) -> None:
    axes.add_patch(Polygon(points, closed=True, facecolor=face, edgecolor=edge, linewidth=width, zorder=zorder, **more))


def _frame(axes: Axes, place: Place, names: Sequence[str], lengths=(0.5, 0.4), color=BLACK, shift=((0, 0), (0, 0))):
    """Both axes of a frame with their names, and the third one pointing into the paper."""
    for axis, name, length, moved in zip(((1, 0), (0, 1)), names, lengths, shift, strict=True):
        end = place(*(length * a for a in axis))
        _arrow(axes, place(0, 0), end, color)
        _text(axes, end + 0.12 * (place.first if axis[0] else place.second) + np.array(moved), name, color)
    axes.add_patch(Circle(place(0, 0), 0.03, facecolor="white", edgecolor=color, linewidth=0.8, zorder=6))


def _angle(axes: Axes, centre, radius: float, first: float, last: float, name: str, color, away=0.14, turn=0.5) -> None:
    """Arc with an arrow from one angle to another (rad, clockwise from the right) and its name outside."""
    t = np.linspace(first, last, 40)
    points = np.asarray(centre) + radius * np.stack([np.cos(t), -np.sin(t)], axis=1)
    _line(axes, *points[:-4], color=color, zorder=4)
    _arrow(axes, points[-6], points[-1], color, 0.8, head=6)
    middle = first + turn * (last - first)
    _text(axes, np.asarray(centre) + (radius + away) * np.array([np.cos(middle), -np.sin(middle)]), name, color)


def _span(axes: Axes, start, end, name: str, color=BLACK, shift=(0.0, 0.0)) -> None:
    """A length between two points."""
    _arrow(axes, start, end, color, 0.7, "<|-|>", 5)
    _text(axes, (np.asarray(start) + np.asarray(end)) / 2 + np.array(shift), name, color)


def _spring(axes: Axes, start, end, color, width=0.055) -> None:
    start, end = np.asarray(start), np.asarray(end)
    along = end - start
    across = np.array([-along[1], along[0]]) / np.hypot(*along)
    sides = np.array([0, 0, 1, -1, 1, -1, 1, -1, 0, 0])
    shares = np.array([0, 0.2, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.8, 1])
    _line(axes, *(start + s * along + k * width * across for s, k in zip(shares, sides, strict=True)), color=color)


def _damper(axes: Axes, start, end, color, width=0.05) -> None:
    start, end = np.asarray(start), np.asarray(end)
    along = end - start
    across = width * np.array([-along[1], along[0]]) / np.hypot(*along)
    pot = [start + 0.7 * along + across, start + 0.35 * along + across]
    pot += [start + 0.35 * along - across, start + 0.7 * along - across]
    _line(axes, *pot, color=color)
    _line(axes, start, start + 0.35 * along, color=color)
    plate = start + 0.55 * along
    _line(axes, plate + 0.8 * across, plate - 0.8 * across, color=color, width=1.4)
    _line(axes, plate, end, color=color)


def _into_paper(axes: Axes, point, color, radius=0.055) -> None:
    """An arrow that points into the paper."""
    axes.add_patch(Circle(point, radius, facecolor="white", edgecolor=color, linewidth=1.0, zorder=6))
    d = radius * np.sqrt(0.5)
    for sign in (1, -1):
        _line(axes, point + np.array([-d, -sign * d]), point + np.array([d, sign * d]), color=color, zorder=7)


def _rails_from_above(axes: Axes, track: Place, half: float, radius: float, ahead: Sequence[float]) -> None:
    """Centre line and two rails of a right-hand curve through a track frame."""
    turn = np.linspace(*ahead, 80) / radius
    for side, look in ((0.0, {"color": GREY, "style": "-.", "width": 0.6}), *((s, {}) for s in (-half, half))):
        r = radius - side
        points = [track(r * np.sin(t), side + r * (1 - np.cos(t))) for t in turn]
        _line(axes, *points, **look or {"color": STEEL, "width": 3.0}, zorder=1)


def _wheel_from_above(axes: Axes, axle: Place, side: float, length: float, width: float) -> None:
    corners = [(a * length / 2, side + c * width / 2) for a, c in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    _shape(axes, [axle(*corner) for corner in corners], LIGHT, alpha=0.85)
    _shape(axes, [axle(*corner) for corner in corners], "none")


class RearView:
    """A gear from behind on its rails, by the geometry of eq. (10): cones roll the axle where it is displaced.

    Origin of the track frame on the paper, cant angle (rad), lateral displacement of the axle (in).
    """

    half, radius, slope = 0.85, 0.5, 0.3
    """Half of the contact base, nominal radius (in), slope of the cones."""
    inner, outer, bar = 0.2, 0.16, 0.08
    """Tread from the middle to both sides, half depth of the carrier (in)."""

    def __init__(self, origin: Sequence[float], cant: float = 0.12, displacement: float = 0.09):
        self.track, self.displacement = Place(origin, cant), displacement
        gamma = self.slope / (self.half - self.radius * self.slope)
        self.axle = self.track.placed(displacement, -self.radius, -gamma * displacement)
        gap = np.mean([self.inside(self.contact(side))[1] - self.reach(side) for side in (1, -1)])
        self.axle = self.track.placed(displacement, -self.radius + float(gap), -gamma * displacement)

    def inside(self, point) -> np.ndarray:
        """Coordinates of a point of the paper in the axle's frame."""
        away = np.asarray(point) - self.axle.origin
        return np.array([away @ self.axle.first, away @ self.axle.second])

    def contact(self, side: int) -> np.ndarray:
        """Where the wheel of a side (1 right, -1 left) touches its rail."""
        return self.track(side * self.half)

    def reach(self, side: int) -> float:
        """Radius of the cone where the rail is: the momentary rolling radius."""
        return self.radius + self.slope * (self.half - abs(self.inside(self.contact(side))[0]))

    def wheel(self, axes: Axes, side: int) -> None:
        """A wheel with its flange, above and below the axle."""
        rim = [(self.half - a, self.radius + self.slope * a) for a in (self.inner, -self.outer)]
        flange = self.radius + 0.15
        lower = [(self.half - self.inner - 0.1, flange), (self.half - self.inner - 0.03, flange), *rim]
        outline = [self.axle(side * a, r) for a, r in (*lower, *((a, -r) for a, r in reversed(lower)))]
        _shape(axes, outline, LIGHT)

    def rail(self, axes: Axes, side: int) -> None:
        """Head, web and foot of a rail."""
        right = [(0.05, 0.0), (0.085, 0.03), (0.085, 0.12), (0.025, 0.15), (0.025, 0.29), (0.12, 0.33), (0.12, 0.36)]
        outline = [*right, *((-a, d) for a, d in reversed(right))]
        _shape(axes, [self.track(side * self.half + a, d) for a, d in outline], STEEL, GREY)

    def suspended(self, axes: Axes, body: Place, name: str) -> None:
        """Carrier, half the car body above, and springs and dampers in between."""
        _shape(axes, [body(a, d) for a, d in ((-0.7, 0), (0.7, 0), (0.7, -0.3), (-0.7, -0.3))], LIGHT)
        _text(axes, body(0, -0.15), name)
        end, bar = self.half - self.inner - 0.1, self.bar
        _shape(axes, [self.axle(a, d) for a, d in ((-end, -bar), (end, -bar), (end, bar), (-end, bar))])
        for side in (-0.37, 0.37):
            _spring(axes, self.axle(side - 0.08, -self.bar), body(side - 0.08, 0), BLUE)
            _damper(axes, self.axle(side + 0.08, -self.bar), body(side + 0.08, 0), BLUE)


def running_gear() -> Figure:
    """Frames, displacements, angles, torques and contact forces, from above and from behind (paper Fig. 1)."""
    figure, axes = _canvas(3.25)
    _gear_from_above(axes)
    _gear_from_behind(axes)
    return figure


def _gear_from_above(axes: Axes) -> None:
    half, shift, yaw = 0.66, 0.12, np.radians(9)
    track = Place((1.75, 1.62), np.radians(10))
    axle, world = track.placed(0.0, shift, yaw), Place((0.2, 3.08))
    _rails_from_above(axes, track, half, 13.0, (-1.65, 1.85))
    _shape(axes, [axle(a, c) for a, c in ((0.08, -half), (0.08, half), (-0.08, half), (-0.08, -half))])
    for side, name in ((-1, "le"), (1, "ri")):
        _wheel_from_above(axes, axle, side * half, 0.72, 0.22)
        contact = axle(0.0, side * half)
        _arrow(axes, contact, axle(0.66, side * half), RED)
        _text(axes, axle(0.84, side * half - 0.08), rf"$F_{{x,{name}}}$", RED)
        _arrow(axes, contact, axle(0.0, side * half + 0.36), RED)
        _text(axes, axle(0.25, side * half + (0.26 if side < 0 else 0.3)), rf"$F_{{y,{name}}}$", RED)
        out = side * (half + 0.19)
        _arrow(axes, axle(-0.62, out), axle(-0.12, out), BLUE)
        _text(axes, axle(-0.38, side * (half + 0.31)), rf"$\tau_{{{name}}},\ \omega_{{{name}}}$", BLUE)
    _frame(axes, world, ("$x_0$", "$y_0$"), (0.4, 0.3))
    _arrow(axes, world(0, 0), track(0, 0), GREY, 0.8, linestyle=(0, (4, 2)))
    _text(axes, world(0.72, 0.3), r"$\boldsymbol{r}_{0Tr}(p)$", GREY)
    _line(axes, track(0, 0), track(0, 0) + np.array([1.95, 0.0]), color=GREY, style=":")
    _frame(axes, axle, ("$x_{Ax}$", "$y_{Ax}$"), (1.7, 0.4), BLUE, ((0.04, -0.02), (0.27, 0.12)))
    _frame(axes, track, ("$x_{Tr}$", "$y_{Tr}$"), (1.8, 0.34), shift=((0.06, 0.0), (-0.2, 0.17)))
    _angle(axes, track(0, 0), 1.0, 0.0, track.angle, r"$\psi_{Tr}$", GREEN, 0.15)
    _angle(axes, axle(0, 0), 1.25, track.angle, axle.angle, r"$\psi_{TrAx}$", GREEN, 0.2)
    _text(axes, (3.28, 1.74), r"$\psi_{Ax} = \psi_{Tr} + \psi_{TrAx}$", GREEN)
    for a in (0.0, shift):
        _line(axes, track(-0.1, a), track(-0.72, a), color=GREEN, width=0.5)
    _arrow(axes, track(-0.62, -0.2), track(-0.62, 0.0), GREEN, 0.8, head=5)
    _arrow(axes, track(-0.62, shift + 0.2), track(-0.62, shift), GREEN, 0.8, head=5)
    _text(axes, track(-0.85, 0.24), "$y_{TrAx}$", GREEN)
    _text(axes, track(-1.3, -0.19), "track path", GREY, SIZE - 1)
    _text(axes, (1.9, 0.1), "from above, $z$ points into the paper", GREY, SIZE - 1)


def _gear_from_behind(axes: Axes) -> None:
    view = RearView((5.1, 0.95))
    track, axle = view.track, view.axle
    _line(axes, track(-1.3), track(1.4), color=GREY, style="-.", width=0.6)
    view.suspended(axes, Place(axle(0.0, -0.95), track.angle / 2), "car body")
    _arrow(axes, axle(0.0, -0.88), axle(0.0, -0.45), BLUE, 1.6)
    _text(axes, axle(0.0, -0.33), r"$\mathcal{F}_{Train}$", BLUE)
    for side, name in ((-1, "le"), (1, "ri")):
        view.wheel(axes, side)
        view.rail(axes, side)
        touch = view.contact(side)
        plane = Place(touch, axle.angle - side * np.arctan(view.slope))
        _arrow(axes, touch, plane(0, -0.46), RED)
        _arrow(axes, touch, plane(0.4, 0), RED)
        _into_paper(axes, touch, RED)
        _text(axes, plane(0, -0.55) if side < 0 else plane(0.2, -0.4), rf"$F_{{N,{name}}}$", RED)
        _text(axes, plane(0.42, 0.13) if side < 0 else plane(0.56, -0.02), rf"$F_{{y,{name}}}$", RED)
        _text(axes, touch + np.array([-0.25, -0.19]), rf"$F_{{x,{name}}}$", RED)
        _text(axes, axle(side * (view.half + 0.41), -0.3), rf"$\tau_{{{name}}},\ \omega_{{{name}}}$", BLUE)
    _frame(axes, track, ("$y_{Tr}$", "$z_{Tr}$"), (0.36, 0.2), shift=((0.0, -0.08), (0.0, 0.0)))
    _span(axes, track(-0.38), track(-0.38, axle_height(view)), "$z_{TrAx}$", GREEN, (0.18, -0.05))
    _text(axes, (5.12, 0.36), r"$\boldsymbol{r}_{TrAx}^{\top} = [0,\ y_{TrAx},\ z_{TrAx}]$", GREEN)
    _frame(axes, axle, ("$y_{Ax}$", "$z_{Ax}$"), (0.3, 0.26), BLUE)
    for place, name in ((track, "Tr"), (axle, "TrAx")):
        _roll(axes, place, name)
    _text(axes, (5.12, 0.1), "from behind, $x$ points into the paper", GREY, SIZE - 1)


def _roll(axes: Axes, place: Place, name: str, away=1.05) -> None:
    """Roll angle of a frame against the horizontal, beside the right wheel."""
    start = place(away)
    _line(axes, start, place(away + 0.36), color=GREY, style="-.", width=0.6)
    _line(axes, start, start + np.array([0.36, 0]), color=GREY, style=":")
    _angle(axes, start, 0.31, 0.0, place.angle, rf"$\varphi_{{{name}}}$", GREEN, 0.22)


def simplified_model() -> Figure:
    """The control-oriented model: coordinates, constraints, springs and dampers (paper Fig. 3)."""
    figure, axes = _canvas(2.9)
    _model_from_above(axes)
    _model_from_behind(axes)
    return figure


def _model_from_above(axes: Axes) -> None:
    half, curve, spacing, shift, yaw = 0.42, 6.5, 1.75, 0.07, np.radians(8)
    track = Place((2.5, 1.42), np.radians(24))
    behind = track.placed(-curve * np.sin(spacing / curve), curve * (1 - np.cos(spacing / curve)), -spacing / curve)
    axle = track.placed(0, shift, yaw)
    along = track.origin - behind.origin
    body, length = Place((track.origin + behind.origin) / 2, -np.arctan2(along[1], along[0])), np.hypot(*along) / 2
    _rails_from_above(axes, track, half, curve, (-2.35, 1.15))
    for gear in (axle, behind):
        _shape(axes, [gear(a, c) for a, c in ((0.05, -half), (0.05, half), (-0.05, half), (-0.05, -half))])
        for side in (-half, half):
            _wheel_from_above(axes, gear, side, 0.42, 0.13)
    front, back, side = length - 0.4, -length - 0.15, 0.23
    _shape(axes, [body(*corner) for corner in ((front, -side), (front, side), (back, side), (back, -side))], LIGHT)
    _line(axes, body(-length), body(front), color=GREY, style="-.", width=0.6, zorder=3)
    _spring(axes, body(front, -0.16), axle(-0.05, -0.16), BLUE)
    _damper(axes, body(front, 0.16), axle(-0.05, 0.16), BLUE)
    _text(axes, body(front + 0.12, -0.34), "$k_{s_z}$", BLUE)
    _text(axes, body(front - 0.13, 0.12), "$k_{d_z}$", BLUE)
    _text(axes, body(-0.3, 0.12), "car body $m_{CB}$", rotation=-np.degrees(body.angle))
    _line(axes, behind(0), behind(0) + np.array([0.95, 0]), color=GREY, style=":", zorder=4)
    _angle(axes, behind(0), 0.75, 0.0, body.angle, r"$\psi_{CB}$", GREEN, 0.16)
    _line(axes, behind(0), behind(-0.6), color=GREY, zorder=4)
    _line(axes, behind(0), behind(0) - np.array([0.6, 0]), color=GREY, style=":", zorder=4)
    _angle(axes, behind(0), 0.5, np.pi, np.pi + behind.angle, "", GREEN)
    _text(axes, behind(-0.2, -0.6), r"$\psi_{Tr}(p - L_{CB})$", GREEN)
    _span(axes, behind(0) + 0.66 * body.second, track(0) + 0.66 * body.second, "$L_{CB}$", shift=(-0.03, -0.12))
    _line(axes, track(0), track(0) + np.array([1.05, 0]), color=GREY, style=":")
    _line(axes, track(0), track(1.05), color=GREY)
    _arrow(axes, axle(0), axle(1.15), BLUE)
    _text(axes, axle(1.3), r"$x,\ \psi_{Ax}$", BLUE)
    _angle(axes, track(0), 0.7, 0.0, track.angle, r"$\psi_{Tr}(p)$", GREEN, 0.26, 0.45)
    _angle(axes, axle(0), 0.9, track.angle, axle.angle, "", GREEN)
    _text(axes, axle(0.78, 0.15), r"$\psi_{TrAx}$", GREEN)
    for sign, name in ((-1, "le"), (1, "ri")):
        _text(axes, axle(0.26, sign * (half + 0.27)), rf"$\tau_{{{name}}},\ \omega_{{{name}}}$", BLUE)
    _text(axes, (2.0, 0.1), r"rolling: $\dot y_{TrAx} = \dot x\,\sin\psi_{TrAx}$ (9), $\omega_j$ by (12)", GREY)


def _model_from_behind(axes: Axes) -> None:
    view = RearView((5.1, 0.9))
    track, axle = view.track, view.axle
    body = Place(axle(0.0, -0.95), track.angle / 2)
    view.suspended(axes, body, "half car body $m_{CB}/2$")
    _text(axes, body(-0.6, 0.14), "$k_{s_x}$", BLUE)
    _text(axes, body(0.62, 0.14), "$k_{d_x}$", BLUE)
    _text(axes, axle(0), r"$m,\ J_{Ax_x},\ J_{Ax_z}$")
    for side, name in ((-1, "le"), (1, "ri")):
        view.wheel(axes, side)
        across, touch = view.inside(view.contact(side))[0], view.contact(side)
        _shape(axes, [touch, track(side * view.half - 0.05, 0.2), track(side * view.half + 0.05, 0.2)], STEEL, GREY)
        _text(axes, axle(side * (view.half - 0.02), -0.25), r"$\boldsymbol{J}_W$")
        _span(axes, axle(across, 0), touch, f"$r_{{{name}}}$", shift=(0.12 * side, 0.05))
        _span(axes, axle(0, 0.2), axle(across, 0.2), f"$y_{{{name}}}$", shift=(-0.14 * side, -0.1))
    for a in (0.0, view.displacement):
        _line(axes, track(a, 0.02), track(a, 0.22), color=GREEN, width=0.5)
    _arrow(axes, track(-0.2, 0.14), track(0, 0.14), GREEN, 0.8, head=5)
    _arrow(axes, track(view.displacement + 0.2, 0.14), track(view.displacement, 0.14), GREEN, 0.8, head=5)
    _text(axes, track(view.displacement + 0.4, 0.14), "$y_{TrAx}$", GREEN)
    _line(axes, track(-0.7), track(0.65), color=GREY, style="-.", width=0.6)
    _span(axes, track(-view.half, 0.32), track(view.half, 0.32), "$b$", shift=(0.0, -0.1))
    _roll(axes, axle, "TrAx")
    touch = view.contact(1)
    cone, level = Place(touch, axle.angle - np.arctan(view.slope)), Place(touch, axle.angle)
    _line(axes, touch, cone(0.62), color=GREY, style="--")
    _line(axes, touch, level(0.62), color=GREY, style="--")
    _angle(axes, touch, 0.5, level.angle, cone.angle, r"$\delta_0$", GREEN)
    _text(axes, (5.1, 0.1), r"conic wheels: $\varphi_{TrAx} = -\Gamma\,y_{TrAx} + \varphi_{Tr}$ (10)", GREY)


def control_structure() -> Figure:
    """Signals and rates: set points, adhesion control, lateral control, integration rule, car (paper Fig. 4)."""
    figure, axes = _canvas(3.0)
    top, low, rule = 2.2, 0.95, 1.55
    _box(axes, (0.6, top), (0.95, 0.56), "high level", note="set points of gears")
    _box(axes, (0.6, low), (0.95, 0.56), "database", note="track over $p$")
    _box(axes, (3.0, low - 0.06), (2.75, 1.12), "", BLUE)
    _text(axes, (2.95, low + 0.35), "lateral controller", BLUE)
    _text(axes, (3.0, low - 0.5), "or, in place of both, NDI: 1 kHz, track at $p$ only", GREY, SIZE - 1)
    _box(axes, (2.15, low - 0.1), (0.85, 0.5), "forecast", GREEN, "at $k = 0 \\ldots L$")
    _box(axes, (3.75, low - 0.1), (1.1, 0.5), "MPC", BLUE, "every $T$, some ms")
    _box(axes, (3.75, top), (1.1, 0.56), "adhesion\ncontroller", RED, "1 kHz")
    _box(axes, (5.3, rule), (0.8, 0.56), "integration\nrule", note="1 kHz")
    _box(axes, (6.5, rule), (0.75, 0.56), "car on\nits track", note="1 ms")
    _path(axes, (1.09, top), (3.18, top))
    _text(axes, (2.0, top + 0.11), "$F_x^*$")
    _path(axes, (0.6, top - 0.3), (0.6, 1.62), (2.15, 1.62), (2.15, low + 0.17))
    _text(axes, (1.3, 1.73), "$y^*$")
    _path(axes, (1.09, low - 0.1), (1.7, low - 0.1))
    _text(axes, (1.36, low + 0.01), r"$\theta$", GREEN)
    _path(axes, (2.6, low - 0.1), (3.18, low - 0.1), color=GREEN)
    _text(axes, (2.88, low + 0.03), r"$\boldsymbol{x}_k^d,\ \theta_k$", GREEN)
    _path(axes, (3.75, top - 0.3), (3.75, low + 0.52), color=RED)
    _text(axes, (3.88, 1.7), "$u^d$", RED)
    _path(axes, (4.32, top), (5.3, top), (5.3, rule + 0.3), color=RED)
    _text(axes, (4.8, top + 0.11), "$u^d$", RED)
    _path(axes, (4.32, low - 0.1), (5.3, low - 0.1), (5.3, rule - 0.3), color=BLUE)
    _text(axes, (4.85, low + 0.01), r"$\Delta u$", BLUE)
    _path(axes, (5.72, rule), (6.1, rule))
    _text(axes, (5.91, rule + 0.13), r"$\tau_{ri}, \tau_{le}$")
    _path(axes, (6.5, rule + 0.3), (6.5, 2.78), (3.75, 2.78), (3.75, top + 0.3))
    _text(axes, (5.1, 2.87), r"$\hat f_{x_j},\ \hat s_{x_j}$")
    _path(axes, (6.5, rule - 0.3), (6.5, 0.18), (3.0, 0.18), (3.0, low - 0.64))
    _text(axes, (4.9, 0.08), r"$\hat{\boldsymbol{x}}$, with $p$ in it: exact, or by sensors and filter")
    return figure


def _path(axes: Axes, *points, color=BLACK) -> None:
    """A signal along corners, with an arrow at its end."""
    _line(axes, *points, color=color, width=1.0)
    _arrow(axes, points[-2], points[-1], color)


def axle_height(view: RearView) -> float:
    """Coordinate of the axle's middle normal to the track plane, down (in)."""
    return float((view.axle.origin - view.track.origin) @ view.track.second)


def _box(axes: Axes, centre, size, text: str, color=BLACK, note: str = "") -> None:
    (x, y), (w, h) = centre, size
    look = {"boxstyle": "round,pad=0.02", "facecolor": "white", "edgecolor": color, "zorder": 3}
    axes.add_patch(FancyBboxPatch((x - w / 2, y - h / 2), w, h, **look))
    up = (0.08 if "\n" in text else 0.09) if note else 0.0
    _text(axes, (x, y + up), text, linespacing=1.0)
    _text(axes, (x, y - (0.2 if "\n" in text else 0.1)), note, GREY, SIZE - 1)
