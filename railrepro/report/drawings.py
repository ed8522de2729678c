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

from railrepro.report import figures
from railrepro.report.figures import BLACK, BLUE, GREEN, RED

GREY, STEEL, LIGHT, AMBER = "0.45", "0.62", "0.93", "#B07700"
SIZE = 8.0
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
    axes.text(*point, text, color=color, fontsize=size, **look)


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

    Parameters
    ----------
    origin : array_like, shape (2,)
        Of the track frame on the paper.
    cant, displacement : float
        Cant angle (rad), lateral displacement of the axle (in).
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
        end = self.half - self.inner - 0.1
        _shape(axes, [self.axle(a, d) for a, d in ((-end, -self.bar), (end, -self.bar), (end, self.bar), (-end, self.bar))])
        for side in (-0.37, 0.37):
            _spring(axes, self.axle(side - 0.08, -self.bar), body(side - 0.08, 0), BLUE)
            _damper(axes, self.axle(side + 0.08, -self.bar), body(side + 0.08, 0), BLUE)


def running_gear() -> Figure:
    """Frames, displacements, angles, torques and contact forces, from above and from behind (paper Fig. 1)."""
    figure, axes = _canvas(3.15)
    _gear_from_above(axes)
    _gear_from_behind(axes)
    return figure


def _gear_from_above(axes: Axes) -> None:
    half, shift, yaw = 0.66, 0.12, np.radians(9)
    track = Place((1.75, 1.62), np.radians(10))
    axle, world = track.placed(0.0, shift, yaw), Place((0.2, 2.95))
    _rails_from_above(axes, track, half, 13.0, (-1.65, 2.2))
    _shape(axes, [axle(a, c) for a, c in ((0.08, -half), (0.08, half), (-0.08, half), (-0.08, -half))])
    for side, name in ((-1, "le"), (1, "ri")):
        _wheel_from_above(axes, axle, side * half, 0.72, 0.22)
        contact = axle(0.0, side * half)
        _arrow(axes, contact, axle(0.66, side * half), RED)
        _text(axes, axle(0.86, side * half), rf"$F_{{x,{name}}}$", RED)
        _arrow(axes, contact, axle(0.0, side * half + 0.36), RED)
        _text(axes, axle(0.25, side * half + (0.26 if side < 0 else 0.3)), rf"$F_{{y,{name}}}$", RED)
        out = side * (half + 0.19)
        _arrow(axes, axle(-0.62, out), axle(-0.12, out), BLUE)
        _text(axes, axle(-0.38, side * (half + 0.31)), rf"$\tau_{{{name}}},\ \omega_{{{name}}}$", BLUE)
    _frame(axes, world, ("$x_0$", "$y_0$"), (0.4, 0.3))
    _arrow(axes, world(0, 0), track(0, 0), GREY, 0.8, linestyle=(0, (4, 2)))
    _text(axes, world(0.6, 0.28), r"$\boldsymbol{r}_{0Tr}$", GREY)
    _line(axes, track(0, 0), track(0, 0) + np.array([1.95, 0.0]), color=GREY, style=":")
    _frame(axes, axle, ("$x_{Ax}$", "$y_{Ax}$"), (1.7, 0.4), BLUE, ((0.04, -0.02), (0.19, 0.14)))
    _frame(axes, track, ("$x_{Tr}$", "$y_{Tr}$"), (1.8, 0.34), shift=((0.06, 0.0), (-0.13, 0.17)))
    _angle(axes, track(0, 0), 1.0, 0.0, track.angle, r"$\psi_{Tr}$", GREEN, 0.15)
    _angle(axes, axle(0, 0), 1.25, track.angle, axle.angle, r"$\psi_{TrAx}$", GREEN, 0.2)
    _text(axes, (2.95, 1.78), r"$\psi_{Ax} = \psi_{Tr} + \psi_{TrAx}$", GREEN)
    for a in (0.0, shift):
        _line(axes, track(-0.1, a), track(-0.72, a), color=GREEN, width=0.5)
    _arrow(axes, track(-0.62, -0.2), track(-0.62, 0.0), GREEN, 0.8, head=5)
    _arrow(axes, track(-0.62, shift + 0.2), track(-0.62, shift), GREEN, 0.8, head=5)
    _text(axes, track(-0.85, 0.24), "$y_{TrAx}$", GREEN)
    _text(axes, track(-1.3, -0.19), "track path", GREY, SIZE - 1)
    _text(axes, track(0.02, -0.16), "$p$", GREY)
    _text(axes, (1.9, 0.1), "from above, $z$ points into the paper", GREY, SIZE - 1)


def _gear_from_behind(axes: Axes) -> None:
    view = RearView((5.45, 0.85))
    track, axle = view.track, view.axle
    _line(axes, track(-1.35), track(1.5), color=GREY, style="-.", width=0.6)
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
        _text(axes, plane(0.21 if side < 0 else 0.2, -0.4), rf"$F_{{N,{name}}}$", RED)
        _text(axes, plane(0.42, 0.13) if side < 0 else plane(0.55, -0.02), rf"$F_{{y,{name}}}$", RED)
        _text(axes, touch + np.array([-0.27, -0.08]), rf"$F_{{x,{name}}}$", RED)
        _text(axes, axle(side * (view.half + 0.36), -0.3), rf"$\tau_{{{name}}},\ \omega_{{{name}}}$", BLUE)
    _frame(axes, track, ("$y_{Tr}$", "$z_{Tr}$"), (0.36, 0.3))
    _frame(axes, axle, ("$y_{Ax}$", "$z_{Ax}$"), (0.3, 0.26), BLUE)
    for place, angle, name, away in ((track, track.angle, "Tr", 1.05), (axle, axle.angle, "TrAx", 1.2)):
        start = place(away)
        _line(axes, start, start + np.array([0.5, 0]), color=GREY, style=":")
        _angle(axes, start, 0.4, 0.0, angle, rf"$\varphi_{{{name}}}$", GREEN)
    _text(axes, (5.4, 0.1), "from behind, $x$ points into the paper", GREY, SIZE - 1)


def simplified_model() -> Figure:
    """The control-oriented model: coordinates, constraints, springs and dampers (paper Fig. 3)."""
    figure, axes = _canvas(3.1)
    _model_from_above(axes)
    _model_from_behind(axes)
    return figure


def _model_from_above(axes: Axes) -> None:
    half, curve, spacing, shift, yaw = 0.42, 4.6, 1.75, 0.08, np.radians(12)
    track = Place((2.15, 1.42), np.radians(28))
    behind = track.placed(-curve * np.sin(spacing / curve), curve * (1 - np.cos(spacing / curve)), -spacing / curve)
    axle = track.placed(0, shift, yaw)
    _rails_from_above(axes, track, half, curve, (-2.35, 1.0))
    along = track.origin - behind.origin
    body = Place((track.origin + behind.origin) / 2, -np.arctan2(along[1], along[0]))
    length = np.hypot(*along) / 2
    for gear in (axle, behind):
        _shape(axes, [gear(a, c) for a, c in ((0.05, -half), (0.05, half), (-0.05, half), (-0.05, -half))])
        for side in (-half, half):
            _wheel_from_above(axes, gear, side, 0.42, 0.13)
    corners = ((length - 0.25, -0.24), (length - 0.25, 0.24), (-length - 0.2, 0.24), (-length - 0.2, -0.24))
    _shape(axes, [body(*corner) for corner in corners], LIGHT, alpha=0.8)
    _line(axes, body(-length), body(length), color=GREY, style="-.", width=0.6, zorder=3)
    _spring(axes, body(length - 0.25, -0.19), axle(-0.05, -0.19), BLUE)
    _damper(axes, body(length - 0.25, 0.19), axle(-0.05, 0.19), BLUE)


def _model_from_behind(axes: Axes) -> None:
    view = RearView((5.4, 0.75))
    view.rail(axes, 1)


def control_structure() -> Figure:
    """Signals and rates: set points, adhesion control, lateral control, integration rule, car (paper Fig. 4)."""
    figure, axes = _canvas(3.0)
    return figure


def _box(axes: Axes, centre, size, text: str, color=BLUE, note: str = "") -> None:
    (x, y), (w, h) = centre, size
    look = {"boxstyle": "round,pad=0.02", "facecolor": "white", "edgecolor": color, "zorder": 3}
    axes.add_patch(FancyBboxPatch((x - w / 2, y - h / 2), w, h, **look))
    _text(axes, (x, y + (0.1 if note else 0)), text)
    if note:
        _text(axes, (x, y - 0.1), note, GREY, SIZE - 1)
