"""Sliders for the parameters in JupyterLab, and what they draw."""

from __future__ import annotations

import time
from collections.abc import Callable

import ipywidgets as widgets
from IPython.display import clear_output, display
from matplotlib.figure import Figure

from railrepro.errors import InputError
from railrepro.evidence.film.knobs import Parameters, turned
from railrepro.evidence.report import figures
from railrepro.simulation.scenarios import Scenario
from railrepro.simulation.simulate import Run
from railrepro.vehicle.parameters import load_vehicle


def curves(runs: dict[str, Run]) -> Figure:
    """Lateral position and differential torque of the front gear over the way."""
    figure, (upper, lower) = figures.new_figure(2, 1, height=1.7, width=7.0, sharex=True)
    for name, run in runs.items():
        rows, look = run.series.iloc[::10], figures.CONTROLLER_STYLE[name]
        upper.plot(rows["front.p"], 1e3 * rows["front.y"], **look)
        lower.plot(rows["front.p"], rows["front.du"], **look)
    longest = max((run.series for run in runs.values()), key=len).iloc[::10]
    upper.plot(longest["front.p"], 1e3 * longest["front.y_ref"], **figures.CONTROLLER_STYLE["set point"])
    upper.set(ylabel="y, to the right (mm)", ylim=_window(runs))
    lower.set(ylabel="differential torque (N m)", xlabel="track coordinate (m)")
    figure.legend(*upper.get_legend_handles_labels(), ncols=3, loc="outside upper center")
    return figure


def _window(runs: dict[str, Run]) -> tuple[float, float]:
    """Range of y (mm) that holds all curves, but not the last metres of one that derails."""
    largest = max(1e3 * run.series[f"front.{name}"].abs().max() for run in runs.values() for name in ("y", "y_ref"))
    room = min(1.1 * largest, 12.0)
    return -room, room


def panel(scenario: Scenario, setting: str, draw: Callable[[dict[str, Run]], Figure] = curves) -> widgets.Widget:
    """Sliders, a line that says how the runs went and how long they took, and the curves, which follow the sliders."""
    sliders, status, shown = _sliders(scenario), widgets.HTML(), widgets.Output()

    def follow(_change=None) -> None:
        begin = time.perf_counter()
        try:
            runs = turned(scenario, Parameters(**{name: slider.value for name, slider in sliders.items()}), setting)
        except InputError as error:
            status.value = str(error)
            return
        ended = "; ".join(f"<b>{name}</b>: {run.ended}" for name, run in runs.items())
        status.value = f"{ended} ({time.perf_counter() - begin:.1f} s for both)"
        figure = draw(runs)
        with shown:
            clear_output(wait=True)
            display(figure)

    for slider in sliders.values():
        slider.observe(follow, "value")
    follow()
    return widgets.VBox([widgets.HBox(list(sliders.values()), layout={"flex_flow": "row wrap"}), status, shown])


def _sliders(scenario: Scenario) -> dict[str, widgets.Widget]:
    """One slider per parameter, where the scenario has it; they answer when they are let go."""
    adhesion = load_vehicle().adhesion
    low, high = adhesion[scenario.poor].mu0, adhesion[scenario.good].mu0
    look = {"continuous_update": False, "style": {"description_width": "12em"}, "layout": {"width": "29em"}}
    factor = {"min": -2, "max": 2, "step": 0.1, "readout_format": ".3g"} | look
    return {
        "r": widgets.FloatLogSlider(1.0, description="NMPC: R, times", **factor | {"max": 4}),
        "horizon": widgets.FloatSlider(1.0, min=0.3, max=1.6, step=0.1, description="NMPC: horizon, times", **look),
        "poles": widgets.FloatSlider(1.0, min=0.3, max=4.0, step=0.1, description="NDI: poles, times", **look),
        "speed_kmh": widgets.FloatSlider(
            scenario.speed_kmh, min=100, max=400, step=10, description="speed (km/h)", **look
        ),
        "friction": widgets.FloatSlider(high, min=low, max=high, step=0.01, description="friction at rest (-)", **look),
        "delay_ms": widgets.FloatSlider(0.0, min=0, max=20, step=1, description="delay of torque (ms)", **look),
    }
