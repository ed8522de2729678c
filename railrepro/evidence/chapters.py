"""What the chapters of the book share besides `railrepro`: sentences with their conditions, figures with one look,
lines of the library, the calibrated car, and the ratio of gains that explains the steady error."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable

import numpy as np

from railrepro import figures
from railrepro.control.ndi import NDI
from railrepro.control.registry import tuned
from railrepro.evidence.claims import calibrated
from railrepro.evidence.report.sentences import sentences
from railrepro.model.control_model import PSI_AX, PSI_TRAX, STATES, XDOT, X, Y
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

__all__ = ["calibrated", "figures", "gain_ratio", "sentences", "source"]


def source(*of: Callable) -> None:
    """Display the lines of functions or classes of the library, without their docstrings, as they run."""
    from IPython.display import Markdown, display  # the library does without it

    for each in of:
        lines = textwrap.dedent(inspect.getsource(each)).splitlines()
        left_out: set[int] = set()
        for node in ast.walk(ast.parse("\n".join(lines))):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node) is not None:
                left_out |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
        code = "\n".join(line for number, line in enumerate(lines, 1) if number not in left_out)
        display(Markdown(f"`{each.__module__}.{each.__qualname__}`\n\n```python\n{code}\n```"))


def gain_ratio(controller: str, setting: str, speed: float) -> float:
    """Ratio k1 / k0 (s) of a tuned controller at a speed (m/s): torque per lateral rate over torque per displacement.

    With a creep angle psi of the wheels, which no model here knows, the steady error in a curve is -(k1 / k0) v psi.
    `controller` is NDI, which has these gains, or a predictive one, whose gains follow from the torques that it plans
    first for a turned and for a displaced gear. `setting` ("paper" or "loop") chooses its tuned set.
    """
    guidance = tuned(controller, setting=setting)
    if isinstance(guidance, NDI):
        return guidance.gains()["k1"] / guidance.gains()["k0"]
    straight = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=3.6 * speed)
    asked, centred, small = guidance(load_vehicle(), straight.route(), 0), np.zeros(len(STATES)), 1e-4
    centred[[X, XDOT]] = 100.0, speed
    displaced, turned = centred.copy(), centred.copy()
    displaced[Y] = turned[PSI_AX] = turned[PSI_TRAX] = small
    return asked.plan(turned, 0.0) / asked.plan(displaced, 0.0) / speed
