"""One frame of a film as a figure: what the page shows, drawn by matplotlib for stills and movies."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from railrepro.car.equations import GEARS, SIDES, WHEELS
from railrepro.evidence.film.scene import AHEAD, BEHIND, Comparison, Frame
from railrepro.evidence.report import figures

TAIL = 0.4
"""How long the trace of a creep force stays (s)."""
_TRACES = {"front.y_mm": "$y$ (mm)", "front.du_Nm": "$\\Delta u$ (N m)", "adhesion": "adhesion\nutilisation (%)"}
_KEY = (
    "solid circle: friction limit now, dotted: largest of the run; dot: creep force (forward to the right), "
    f"line: its last {TAIL:g} s\nvertical bar: adhesion utilisation; horizontal bar: wheel torque, zero in the middle"
)


class Picture:
    """A figure of a film; `show` turns it to another frame.

    Attributes
    ----------
    figure : Figure
    """

    def __init__(self, film: Comparison):
        self.figure, whole = figures.new_figure(height=5.6, width=7.0)
        whole.remove()
        ratios = (1.1, 2.2, 0.25, *(0.75 for _ in _TRACES))
        grid = self.figure.add_gridspec(len(ratios), 2, height_ratios=ratios)
        self._stages = []
        for i, shot in enumerate(film.shots):
            plan, dials = (self.figure.add_subplot(grid[row, i]) for row in range(2))
            self._stages.append(_Stage(film, shot, plan, dials))
        key = self.figure.add_subplot(grid[2, :])
        key.set_axis_off()
        key.text(0.5, 0.5, _KEY, fontsize=6.5, ha="center", va="center", linespacing=1.3)
        self._traces = _Traces(film, [self.figure.add_subplot(grid[3 + i, :]) for i in range(len(_TRACES))])

    def show(self, frame: int) -> None:
        """Turn to a frame; a run that has ended stays at its last one."""
        for stage in self._stages:
            stage.show(min(frame, len(stage.shot.table) - 1))
        self._traces.show(frame)


class _Stage:
    """Plan view and creep circles of one shot."""

    def __init__(self, film: Comparison, shot: Frame, plan: Axes, dials: Axes):
        self.shot, self._film, self._plan = shot, film, plan
        self._values = {str(name): shot.table[name].to_numpy() for name in shot.table}
        self._half = 4 * film.scales["y_mm"]
        for axis in (plan, dials):
            axis.set_axis_off()
        self._plan.set(xlim=(-BEHIND, AHEAD), ylim=(1.45 * self._half, -1.45 * self._half))
        self._plan.set_title(shot.label, fontsize=8, color=shot.color, loc="left")
        self._head = self._plan.text(0.2, 1.03, "", transform=self._plan.transAxes, fontsize=6, va="bottom")
        for side in (-self._half, self._half):
            self._plan.axhline(side, color="0.45", linewidth=1.5, zorder=0)
        drawn = {"color": shot.color, "solid_capstyle": "butt"}
        self._poor = [self._plan.plot([], [], color=figures.SKY, linewidth=2.5)[0] for _ in SIDES]
        (self._wanted,) = self._plan.plot([], [], color=figures.BLACK, linestyle=":", label="set point")
        (self._gone,) = self._plan.plot([], [], color=shot.color, linewidth=0.7, label="path of the front running gear")
        self._axles = [self._plan.plot([], [], linewidth=1.5, **drawn)[0] for _ in GEARS]
        self._wheels = [self._plan.plot([], [], linewidth=4, **drawn)[0] for _ in WHEELS]
        (self._sleepers,) = self._plan.plot([], [], color="0.9", linewidth=2, zorder=-1)
        self._dials = {wheel: _Dial(film, shot, wheel, dials) for wheel in WHEELS}
        dials.set(xlim=(-3.3, 3.9), ylim=(3.0, -2.95), aspect="equal")
        plan.legend(fontsize=6, handlelength=1.5, loc="center right", labelspacing=0.2, bbox_to_anchor=(1.0, 0.72))

    def show(self, k: int) -> None:
        value, way, half = {name: column[k] for name, column in self._values.items()}, self._film.way, self._half
        p = value["front.p_m"]
        window = way[(way["p_m"] > p - BEHIND - 1) & (way["p_m"] < p + AHEAD + 1)]
        place = window["p_m"].to_numpy() - p
        self._wanted.set_data(place, window["y_ref_mm"])
        for line, side, y in zip(self._poor, SIDES, (-half, half), strict=True):
            line.set_data(place, np.where(window[f"poor_{side}"] > 0.01, y, np.nan))
        posts = place[window["p_m"] % 5 == 0]
        self._sleepers.set_data(np.repeat(posts, 3), np.tile([-1.2 * half, 1.2 * half, np.nan], posts.size))
        past = slice(np.searchsorted(self._values["front.p_m"], p - BEHIND), k + 1)
        self._gone.set_data(self._values["front.p_m"][past] - p, self._values["front.y_mm"][past])
        for gear, axle, wheels in zip(GEARS, self._axles, (self._wheels[:2], self._wheels[2:]), strict=True):
            x, y, slope = value[f"{gear}.p_m"] - p, value[f"{gear}.y_mm"], value[f"{gear}.psi_mrad"]
            axle.set_data([x, x], [y - half, y + half])
            for wheel, side in zip(wheels, (-half, half), strict=True):
                wheel.set_data([x - 1.3, x + 1.3], [y + side - 1.3 * slope, y + side + 1.3 * slope])
        error = value["front.y_mm"] - value["front.y_ref_mm"]
        self._head.set_text(f"p = {p:.0f} m, {value['v_kmh']:.0f} km/h, error {error:.2f} mm")
        for dial in self._dials.values():
            dial.show(k, self._values)


class _Dial:
    """Creep circle, adhesion gauge and torque bar of one wheel, in units of the largest bound of the film."""

    def __init__(self, film: Comparison, shot: Frame, wheel: str, axis: Axes):
        gear, side = wheel.split("_")
        self._wheel, self._scales = wheel, film.scales
        self._x, self._y = (1.85 if gear == "front" else -1.95), (-1.55 if side == "le" else 1.45)
        self._tail_frames = max(round(TAIL / (film.times[1] - film.times[0])), 1)
        center = self._x, self._y
        self._bound = Circle(center, 1.0, facecolor="0.94", edgecolor="0.3", linewidth=0.6)
        axis.add_patch(self._bound)
        axis.add_patch(Circle(center, 1.0, fill=False, edgecolor="0.6", linestyle=":", linewidth=0.6))
        cross = [-1, 1, np.nan, 0, 0], [0, 0, np.nan, -1, 1]
        axis.plot(self._x + np.array(cross[0]), self._y + np.array(cross[1]), color="0.8", linewidth=0.4)
        (self._tail,) = axis.plot([], [], color=shot.color, alpha=0.45, linewidth=0.8)
        (self._force,) = axis.plot([], [], color=shot.color, linewidth=1.4, marker="o", markersize=2.5, markevery=[1])
        axis.add_patch(Rectangle((self._x + 1.15, self._y - 1), 0.18, 2, color="0.9"))
        axis.add_patch(Rectangle((self._x - 1, self._y + 1.1), 2, 0.13, color="0.9"))
        self._gauge = Rectangle((self._x + 1.15, self._y + 1), 0.18, 0, color=shot.color)
        self._torque = Rectangle((self._x, self._y + 1.1), 0, 0.13, color=shot.color)
        axis.add_patch(self._gauge)
        axis.add_patch(self._torque)
        name = f"{gear} gear, {'left' if side == 'le' else 'right'} wheel"
        axis.text(self._x, self._y - 1.08, name, fontsize=6, ha="center", va="bottom")
        self._used = axis.text(self._x + 1.42, self._y + 0.95, "", fontsize=6)
        self._told = axis.text(self._x + 1.15, self._y + 1.25, "", fontsize=6, va="center")

    def show(self, k: int, values: dict[str, np.ndarray]) -> None:
        own = {name.removeprefix(f"{self._wheel}."): value for name, value in values.items()}
        unit = 1 / self._scales["force_kN"]
        self._bound.set_radius(max(own["bound_kN"][k] * unit, 0.01))
        past = slice(max(k - self._tail_frames, 0), k + 1)
        x, y = self._x + unit * own["Fx_kN"][past], self._y + unit * own["Fy_kN"][past]
        self._tail.set_data(x, y)
        self._force.set_data([self._x, x[-1]], [self._y, y[-1]])
        used, torque = own["adhesion_percent"][k], own["tau_Nm"][k]
        self._gauge.set_height(-2 * min(used, 100) / 100)
        self._torque.set_width(torque / self._scales["torque_Nm"])
        self._used.set_text(f"{used:.0f} %")
        self._told.set_text(f"{torque:.0f} N m")


class _Traces:
    """Curves of both shots over time with a cursor."""

    def __init__(self, film: Comparison, axes: list[Axes]):
        self._film, self._cursors = film, [axis.axvline(0.0, color="0.2", linewidth=0.7) for axis in axes]
        for axis, (name, label) in zip(axes, _TRACES.items(), strict=True):
            for shot in film.shots:
                look = figures.CONTROLLER_STYLE[shot.controller] | {"linewidth": 0.9}
                axis.plot(shot.table["t_s"], _trace(shot, name), **look)
            axis.set(ylabel=label, xlim=(0, film.times[-1]))
            axis.yaxis.label.set_size(6.5)
            axis.tick_params(labelsize=6, labelbottom=axis is axes[-1])
        table = max((shot.table for shot in film.shots), key=len)
        axes[0].plot(table["t_s"], table["front.y_ref_mm"], **figures.CONTROLLER_STYLE["set point"])
        axes[0].legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.95), fontsize=6, borderpad=0)
        axes[-1].set_xlabel("time (s)", fontsize=6.5)

    def show(self, frame: int) -> None:
        time = self._film.times[frame]
        for cursor in self._cursors:
            cursor.set_xdata([time, time])


def _trace(shot: Frame, name: str) -> np.ndarray:
    if name == "adhesion":
        return shot.table[[f"{wheel}.adhesion_percent" for wheel in WHEELS]].to_numpy().max(axis=1)
    return shot.table[name].to_numpy()


def draw(film: Comparison, frame: int | None = None) -> Figure:
    """A frame as a figure; default `Film.still`."""
    picture = Picture(film)
    picture.show(film.still() if frame is None else frame)
    return picture.figure
