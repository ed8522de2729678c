"""The schematics of the paper in our own hand, as SVG and PNG: running gear, simplified model, control structure.

Drawn by code so that names and signs agree with the library. Serves the paper's Figs. 1, 3 and 4.
"""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch, Rectangle

from railrepro.report import figures


def _canvas(width: float, height: float, x: tuple[float, float], y: tuple[float, float]) -> tuple[Figure, Axes]:
    figure, axes = figures.new_figure(height=height, width=width)
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.axis("off")
    return figure, axes


def _arrow(axes: Axes, start, end, color=figures.BLACK, text="", shift=(0.0, 0.0), bend=0.0, width=1.0, size=7) -> None:
    style = f"arc3,rad={bend}"
    look = {"arrowstyle": "-|>", "mutation_scale": 8, "color": color, "linewidth": width, "zorder": 3}
    axes.add_patch(FancyArrowPatch(start, end, connectionstyle=style, **look))
    middle = (start[0] + end[0]) / 2 + shift[0], (start[1] + end[1]) / 2 + shift[1]
    axes.text(*middle, text, ha="center", va="center", color=color, fontsize=size)


def _box(axes: Axes, centre, size, text: str, color=figures.BLUE, note: str = "") -> None:
    (x, y), (w, h) = centre, size
    axes.add_patch(
        FancyBboxPatch((x - w / 2, y - h / 2), w, h, boxstyle="round,pad=0.02", facecolor="white", edgecolor=color)
    )
    axes.text(x, y + (0.12 if note else 0), text, ha="center", va="center", fontsize=7)
    if note:
        axes.text(x, y - 0.2, note, ha="center", va="center", fontsize=5.5, color="0.35")


def running_gear() -> Figure:
    """Frames and forces of a running gear from above: track frame, axle frame, torques, creep forces (paper Fig. 1)."""
    figure, axes = _canvas(4.2, 3.0, (-3.4, 3.6), (-2.7, 2.3))
    for y in (-1.5, 1.5):
        axes.plot([-3.3, 3.3], [y, y], color="0.6", linewidth=2)
    axes.plot([-1.5, 3.4], [0, 0], color="0.6", linestyle="-.", linewidth=0.7)
    turn, shift = 0.16, -0.25
    forward, right = (1.0, -turn), (-turn, -1.0)
    for sign, name in ((-1, "le"), (1, "ri")):
        x, y = 1.5 * sign * right[0], 1.5 * sign * right[1] + shift
        look = {"angle": -9, "rotation_point": "center", "facecolor": "0.85", "edgecolor": figures.BLACK}
        axes.add_patch(Rectangle((x - 0.6, y - 0.12), 1.2, 0.24, **look))
        _arrow(
            axes, (x, y), (x + 1.35 * forward[0], y + 1.35 * forward[1]), figures.RED, rf"$F_{{x,{name}}}$", (0.45, 0.2)
        )
        _arrow(axes, (x, y), (x + 0.7 * right[0], y + 0.7 * right[1]), figures.RED, rf"$F_{{y,{name}}}$", (0.32, -0.18))
        torque = rf"$\tau_{{{name}}},\ \omega_{{{name}}}$"
        axes.text(x - 0.72, y - 0.05, torque, fontsize=7, color=figures.BLUE, ha="right", va="center")
    ends = [-1.5 * right[0], 1.5 * right[0]], [-1.5 * right[1] + shift, 1.5 * right[1] + shift]
    axes.plot(*ends, color="0.75", linewidth=3, zorder=0)
    _arrow(axes, (0, shift), (2.6 * forward[0], 2.6 * forward[1] + shift), figures.BLUE, r"$x_{Ax}$", (1.45, -0.4))
    _arrow(axes, (-2.6, 0), (-1.7, 0), text=r"$x_{Tr}$", shift=(0, 0.18))
    _arrow(axes, (-2.6, 0), (-2.6, -0.9), text=r"$y_{Tr}$", shift=(0.22, 0))
    _arrow(axes, (-0.35, 0), (-0.35, shift - 0.12), figures.GREEN, r"$y_{TrAx}$", (-0.36, -0.05), size=6)
    _arrow(axes, (2.3, 0), (2.28, -0.62), figures.GREEN, r"$\psi_{TrAx}$", (0.42, 0.1), bend=-0.15)
    return figure


def simplified_model() -> Figure:
    """The control-oriented model: gear on rails, yaw spring and damper to the car body, two cones (paper Fig. 3)."""
    figure, axes = _canvas(4.6, 2.4, (-3.2, 4.2), (-1.6, 2.3))
    axes.add_patch(Rectangle((-2.6, 1.5), 5.2, 0.5, facecolor="0.93", edgecolor=figures.BLACK))
    axes.text(0, 1.75, r"half car body  $m_{CB}/2,\ \psi_{CB}$", ha="center", va="center", fontsize=7)
    axes.plot([0.0, 0.0], [1.5, 0.5], color=figures.BLUE, linestyle=":")
    axes.text(0.12, 1.0, r"$k_{s_z},\ k_{d_z}$ (yaw)", fontsize=7, color=figures.BLUE, va="center")
    axes.text(-0.12, 1.0, r"$k_{s_x},\ k_{d_x}$ (roll)", fontsize=7, color=figures.BLUE, va="center", ha="right")
    axes.add_patch(Rectangle((-2.0, 0.2), 4.0, 0.3, facecolor="0.93", edgecolor=figures.BLACK))
    axes.text(0, 0.35, r"carrier $m$, $J_{Ax}$", ha="center", va="center", fontsize=7)
    for sign, name in ((-1, "le"), (1, "ri")):
        xs = [sign * 1.75, sign * 2.35, sign * 2.35, sign * 1.75]
        axes.fill(xs, [0.95, 0.88, -0.53, -0.6], facecolor="white", edgecolor=figures.BLACK)
        axes.add_patch(Rectangle((sign * 2.05 - 0.1, -1.0), 0.2, 0.42, facecolor="0.6", edgecolor="none"))
        axes.text(sign * 2.05, 0.5, rf"$J_W,\ \tau_{{{name}}}$", fontsize=6, ha="center", va="center")
    _arrow(axes, (-2.05, -1.2), (2.05, -1.2), text="$b$", shift=(0, -0.2))
    _arrow(axes, (2.05, -1.2), (-2.05, -1.2))
    axes.text(2.55, -0.55, r"cone $\delta_0$: $\varphi_{Ax} = \varphi_{Tr} - \Gamma y_{TrAx}$", fontsize=6.5)
    _arrow(axes, (2.9, 0.35), (3.5, 0.35), text=r"$y$", shift=(0, 0.15))
    _arrow(axes, (2.9, 0.35), (2.9, -0.25), text=r"$z$", shift=(0.15, 0))
    return figure


def control_structure() -> Figure:
    """Signals and rates: set points, adhesion control, lateral control, integration rule, car (paper Fig. 4)."""
    figure, axes = _canvas(6.2, 2.5, (-0.4, 11.2), (-0.2, 4.4))
    _box(axes, (4.2, 3.3), (2.4, 1.0), "adhesion control", figures.RED, "1 kHz, per running gear")
    _box(axes, (4.2, 1.0), (2.4, 1.0), "lateral control", figures.BLUE, "MPC: every T; NDI: 1 kHz")
    _box(axes, (7.2, 2.15), (1.6, 1.0), "integration\nrule", figures.BLACK, "")
    axes.text(7.2, 1.45, "1 kHz", fontsize=5.5, color="0.35", ha="center")
    _box(axes, (9.8, 2.15), (1.5, 1.2), "car on track", figures.BLACK, "1 ms exchange")
    _box(axes, (1.0, 1.0), (1.5, 1.0), "preview", figures.GREEN, "track, set point")
    _arrow(axes, (1.75, 3.5), (2.98, 3.5), text=r"$F_x^*$", shift=(0, 0.2))
    _arrow(axes, (1.77, 1.0), (2.98, 1.0), figures.GREEN, r"$x^d_k,\ \theta_k$", (0, 0.22))
    _arrow(axes, (1.0, 2.6), (1.0, 1.53), text=r"$y^*(p)$, track", shift=(0, 0.68))
    _arrow(axes, (5.42, 3.3), (6.9, 2.68), figures.RED, r"$u^d$", (0.15, 0.2))
    _arrow(axes, (4.2, 2.78), (4.2, 1.53), figures.RED, r"$u^d$", (0.25, 0))
    _arrow(axes, (5.42, 1.0), (6.9, 1.63), figures.BLUE, r"$\Delta u$", (0.15, -0.2))
    _arrow(axes, (8.02, 2.15), (9.03, 2.15), text=r"$\tau_{ri}, \tau_{le}$", shift=(0, 0.22))
    axes.plot([9.8, 9.8, 4.2], [1.53, 0.0, 0.0], color=figures.BLACK, linewidth=1.0)
    _arrow(axes, (4.2, 0.0), (4.2, 0.47), text=r"measured state $\hat x$", shift=(1.6, -0.08))
    axes.plot([9.8, 9.8, 4.2], [2.77, 4.3, 4.3], color=figures.BLACK, linewidth=1.0)
    _arrow(axes, (4.2, 4.3), (4.2, 3.83), text=r"estimates $\hat f_x, \hat s_x$", shift=(1.6, 0.1))
    return figure
