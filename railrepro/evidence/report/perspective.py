"""The car on its track in perspective: which body is where, to scale apart from the outline of the car body.

Serves the paper's Fig. 1; frames and symbols are drawn in `railrepro.evidence.report.drawings`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from railrepro.evidence.report import figures
from railrepro.evidence.report.drawings import BLUE, GREEN, LIGHT, RED, SIZE, STEEL, _arrow, _text
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_WIDTH, _HEIGHT = 7.0, 3.6
_BODY_WIDTH, _BODY_HEIGHT = 2.8, 3.0
"""Outline of the car body (m), for the eye only: no equation has it."""
_TREAD, _FLANGE, _MOTOR = 0.13, 0.03, 0.2
"""Width of a wheel, height of its flange, radius of a motor (m)."""


class View:
    """Central projection from an eye to the paper; x forward, y right, z down (m).

    The target is the point that falls on the centre of the paper, the scale inches on paper of what is as large as its
    distance.
    """

    def __init__(self, eye: Sequence[float], target: Sequence[float], scale: float, centre: Sequence[float]):
        self.eye, self.scale, self.centre = np.asarray(eye, float), scale, np.asarray(centre, float)
        ahead = np.asarray(target, float) - self.eye
        self.ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(self.ahead, (0.0, 0.0, -1.0))
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.right, self.ahead)

    def __call__(self, points) -> np.ndarray:
        """Places on the paper (in), shape (..., 2), of points in space (m), shape (..., 3)."""
        away = np.asarray(points, float) - self.eye
        depth = (away @ self.ahead)[..., None]
        return self.centre + self.scale * np.stack([away @ self.right, away @ self.up], axis=-1) / depth


def car() -> Figure:
    """Rails, both running gears with their four wheels and motors, and the car body."""
    figure, axes = figures.new_figure(height=_HEIGHT, width=_WIDTH)
    figure.set_layout_engine("none")
    axes.set_position((0, 0, 1, 1))
    axes.set(xlim=(0, _WIDTH), ylim=(0, _HEIGHT))
    axes.axis("off")
    vehicle = load_vehicle()
    view = View((9.0, 6.5, -2.1), (-2.6, 0.0, -1.2), 8.4, (3.3, 1.72))
    _track(axes, view, vehicle)
    _body(axes, view, vehicle, behind=True)
    for place in (-vehicle.body.gear_spacing, 0.0):
        _gear(axes, view, vehicle, place)
    _body(axes, view, vehicle, behind=False)
    _names(axes, view, vehicle)
    return figure


def contact(vehicle: Vehicle, gear: float, side: int) -> tuple[float, float, float]:
    """Where the wheel of a side (1 right, -1 left) of the gear at a place along the track stands (m)."""
    return gear, side * vehicle.gear.contact_base / 2, 0.0


def _face(axes: Axes, view: View, points, face="white", edge="0.2", zorder=2.0, **look) -> None:
    look = {"linewidth": 0.7} | look
    axes.add_patch(Polygon(view(points), closed=True, facecolor=face, edgecolor=edge, zorder=zorder, **look))


def _track(axes: Axes, view: View, vehicle: Vehicle) -> None:
    half, begin, end = vehicle.gear.contact_base / 2, -22.0, 4.5
    for x in np.arange(begin, end, 0.6):
        corners = ((x, -1.25), (x, 1.25), (x + 0.25, 1.25), (x + 0.25, -1.25))
        _face(axes, view, [(a, b, 0.17) for a, b in corners], "0.9", "0.8", 0.5)
    for side in (-half, half):
        top = [(begin, side - 0.035, 0), (end, side - 0.035, 0), (end, side + 0.035, 0), (begin, side + 0.035, 0)]
        web = [(begin, side + 0.035, 0), (end, side + 0.035, 0), (end, side + 0.035, 0.17), (begin, side + 0.035, 0.17)]
        _face(axes, view, web, "0.72", "0.45", 0.8)
        _face(axes, view, top, STEEL, "0.45", 0.9)


def _circle(x: float, y: float, z: float, radius: float, turn=(0.0, 2 * np.pi)) -> np.ndarray:
    """Points of a circle about the lateral axis, shape (60, 3)."""
    t = np.linspace(*turn, 60)
    return np.stack([x + radius * np.sin(t), np.full_like(t, y), z - radius * np.cos(t)], axis=1)


def _drum(axes: Axes, view: View, span: tuple[float, float], middle, radius: float, face, zorder: float) -> None:
    """A cylinder about the lateral axis between two coordinates y, of which the eye sees the right end."""
    x, z = middle
    left, right = (_circle(x, y, z, radius) for y in span)
    outline, turn = view(np.concatenate([left, right])), np.linspace(0, 2 * np.pi, 180)
    hull = outline[np.argmax(outline @ np.stack([np.cos(turn), np.sin(turn)]), axis=0)]
    axes.add_patch(Polygon(hull, closed=True, facecolor=face, edgecolor="0.2", linewidth=0.7, zorder=zorder))
    _face(axes, view, right, face, zorder=zorder + 0.01)


def _gear(axes: Axes, view: View, vehicle: Vehicle, x: float) -> None:
    """Carrier, motors, wheels and springs from the left to the right, as the eye is on the right."""
    radius, spring, order = vehicle.wheel.radius, vehicle.suspension.half_spacing, 2.0 if x < 0 else 3.0
    left, right = (contact(vehicle, x, side)[1] for side in (-1, 1))
    width, lip, motor = _TREAD / 2, 0.03, 0.4
    parts = [  # from, to (m), radius, face
        (-spring - 0.08, left - width, 0.07, LIGHT), (left - width, left + width, radius, "white"),
        (left + width, left + width + lip, radius + _FLANGE, "0.85"),
        (left + width + lip, left + width + motor, _MOTOR, BLUE),
        (left + width + motor, right - width - motor, 0.1, LIGHT),
        (right - width - motor, right - width - lip, _MOTOR, BLUE),
        (right - width - lip, right - width, radius + _FLANGE, "0.85"), (right - width, right + width, radius, "white"),
        (right + width, spring + 0.08, 0.07, LIGHT),
    ]  # fmt: skip
    for k, (begin, end, size, face) in enumerate(parts):
        _drum(axes, view, (begin, end), (x, -radius), size, face, order + 0.05 * k)
    coil = np.linspace(0, 1, 120)
    for y, zorder in ((-spring, order), (spring, order + 0.6)):
        height = -radius - 0.07 - coil * (vehicle.suspension.height - radius - 0.07)
        turns = 2 * np.pi * 5 * coil
        winding = np.stack([x + 0.08 * np.cos(turns), y + 0.08 * np.sin(turns), height], axis=1)
        axes.plot(*view(winding).T, color="0.2", linewidth=0.8, zorder=zorder)


def _body(axes: Axes, view: View, vehicle: Vehicle, behind: bool) -> None:
    """Outline of the car body, its floor before the gears are drawn."""
    middle, half = -vehicle.body.gear_spacing / 2, _BODY_WIDTH / 2
    back, front = middle - vehicle.body.length / 2, middle + vehicle.body.length / 2
    low, high = -vehicle.suspension.height, -_BODY_HEIGHT
    floor = [(back, -half, low), (front, -half, low), (front, half, low), (back, half, low)]
    right = [(back, half, low), (front, half, low), (front, half, high), (back, half, high)]
    face = [(front, -half, low), (front, half, low), (front, half, high), (front, -half, high)]
    roof = [(back, -half, high), (front, -half, high), (front, half, high), (back, half, high)]
    for corners in (floor,) if behind else (right, face, roof):
        _face(axes, view, corners, LIGHT, "0.55", 1.5 if behind else 4.5, alpha=0.8 if behind else 0.35)


def _names(axes: Axes, view: View, vehicle: Vehicle) -> None:
    """Names with lines to what they mean, torques and directions."""
    radius, half, spring = vehicle.wheel.radius, vehicle.gear.contact_base / 2, vehicle.suspension.half_spacing
    pointer = {"arrowstyle": "-", "color": "0.3", "linewidth": 0.6, "shrinkA": 1, "shrinkB": 0}
    pointed = {
        "independently\nrotating wheel": ((0.0, half + _TREAD / 2, -0.15), (2.2, 0.4)),
        "wheel motor": ((0.1, -0.5, -0.4), (6.4, 1.3)),
        "suspension": ((0.0, spring + 0.08, -0.75), (2.35, 0.86)),
        "rear running gear": ((-vehicle.body.gear_spacing, 0.0, -0.35), (0.95, 0.75)),
        "car body": ((-4.0, _BODY_WIDTH / 2, -2.2), (2.6, 3.3)),
        "front running gear": ((0.0, -half - 0.1, -0.3), (6.4, 0.9)),
    }
    box = {"bbox": {"facecolor": "white", "edgecolor": "none", "pad": 1.5}, "linespacing": 1.0}
    for name, (point, place) in pointed.items():
        axes.annotate("", view(point), place, arrowprops=pointer, zorder=5.5)
        _text(axes, place, name, size=SIZE - 1, **box)
    origin, shifts = view((1.3, 0.0, 0.0)), ((0.02, -0.12), (-0.1, -0.04))
    for name, end, shift in zip(("$x$, speed", "$y$"), ((2.4, 0.0, 0.0), (1.3, 0.6, 0.0)), shifts, strict=True):
        _arrow(axes, origin, view(end), GREEN)
        _text(axes, view(end) + shift, name, GREEN, SIZE - 1)
    for side, name in ((-1, "le"), (1, "ri")):
        arc = view(_circle(0.0, side * (half + _TREAD), -radius, 0.8 * radius, (-0.9, 0.9)))
        axes.plot(*arc[:-3].T, color=RED, linewidth=1.2, zorder=5)
        _arrow(axes, arc[-5], arc[-1], RED)
        _text(axes, arc[30] + (0.0, 0.12), rf"$\tau_{{{name}}}$", RED, SIZE - 1)
