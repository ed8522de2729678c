"""Multi-rate co-simulation: the car and the control law at 1 kHz, slower lateral controllers at their own period.
Serves the paper's Fig. 4 and section Simulation Environment."""

import ctypes
import itertools
import math
import reprlib
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from railrepro.car import component, equations
from railrepro.clock import CONTROL_PERIOD
from railrepro.control import cycle, interface, lateral, law
from railrepro.control.adhesion import AdhesionSettings
from railrepro.data import InputError, is_number, require
from railrepro.estimation.sensors import Loop, Readings
from railrepro.model.control_model import STATES, X
from railrepro.quantities import GEARS
from railrepro.simulation.closed_loop import ClosedLoop
from railrepro.simulation.metrics import FLANGE_ANGLE, FLANGEWAY, Part
from railrepro.simulation.scenarios import Scenario
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Run:
    """Result of a simulation.

    Attributes:
        series (DataFrame): One row per ms: t_s (s), then signals of car and control law (SI): front.p (track
            coordinate), front.y (displacement), front.y_ref (set point), front.du (differential torque), front_le.N
            (wheel load), …
        ended, failed (str, bool): Why the run ended; True if by derailment or by a number that is not finite.
        warnings (tuple of str): Sentences that say where the run first left the range in which a model is valid.
        controllers (tuple): Slower lateral controllers of both gears, such as MPC, whose attribute `fallbacks` counts
            samples without solution; () for a 1 kHz law.
        memory (dict): Name of a state of the control law -> its value at the end (SI).
    """

    series: pd.DataFrame
    ended: str
    failed: bool
    warnings: tuple[str, ...]
    controllers: tuple = ()
    memory: dict[str, float] = field(default_factory=dict, repr=False)

    def plot(self, *panels: str, gear: str = "front") -> "Figure":
        """Draw the run over the track coordinate (m) in a new figure, set points dotted. Needs the package matplotlib.
        `panels` are keys of `railrepro.simulation.plot.PANELS`, one per row: "y", "error", "du", "torques", "adhesion",
        "slip", "speed", …; `gear` is "front" or "rear"."""
        from railrepro.simulation import plot  # a run needs no Matplotlib

        return plot.figure_of(self.series, panels or ("y", "error"), gear)

    def __getstate__(self) -> dict:
        """Replace slower controllers, which may hold compiled code, by their class name and `fallbacks` in a pickle."""
        past = [{"name": type(one).__name__, "fallbacks": getattr(one, "fallbacks", 0)} for one in self.controllers]
        return vars(self) | {"controllers": tuple(SimpleNamespace(**one) for one in past)}


def run(
    scenario: Scenario,
    guidance: lateral.Guidance,
    *,
    vehicle: Vehicle | None = None,
    plant_vehicle: Vehicle | None = None,
    adhesion: AdhesionSettings | None = None,
    fixed_share: float = 0.0,
    sensors: Readings | None = None,
    irregularities: pd.DataFrame | None = None,
    line: tuple[np.ndarray, np.ndarray] | None = None,
    route: Route | None = None,
    substeps: int = 1,
) -> Run:
    """Simulate the car with its controllers through a scenario.

    Args:
        scenario (Scenario): Track, speed, rails, force demand and set point.
        guidance (LateralLaw or callable): Lateral control: a 1 kHz law such as `NDI()`, or a factory (vehicle, route,
            gear) of slower controllers, such as `NMPC`.
        vehicle (Vehicle): Parameters that the controllers assume of the car; default data/vehicle.toml.
        plant_vehicle (Vehicle): Parameters of the simulated car; default `vehicle`.
        adhesion (AdhesionSettings): Settings of the adhesion law; default `AdhesionSettings()`, with `sensors` changed
            by `sensors.loop.adhesion`.
        fixed_share (float): Share of the torque limit kept for the differential torque (-). With 0 this torque may use
            the whole limit, and the base torque gets the rest.
        sensors (Readings): Sensors between car and controllers; default exact measurements.
        irregularities, line: Irregular rails and planned set point, arguments of `Scenario.route`; default none.
        route (Route): Route of the run; default `scenario.route(irregularities, line)`.
        substeps (int): Integration steps of the car per millisecond; 2 for wheel unloading on irregular rails.

    InputError if an argument has a wrong type or value, or a vehicle lacks an adhesion set of the scenario;
    ArithmeticError if a slower lateral controller returns no finite number.
    """
    vehicle = load_vehicle() if vehicle is None else vehicle
    body = vehicle if plant_vehicle is None else plant_vehicle
    require("scenario", scenario, Scenario)
    require("vehicle", vehicle, Vehicle)
    require("plant_vehicle", body, Vehicle)
    route = scenario.route(irregularities, line) if route is None else route
    require("route", route, Route)
    lateral_law, factory = lateral.split(guidance)
    component.compile_ahead()
    controllers = lateral.controllers(factory, vehicle, route) if factory else ()
    settings = {"adhesion": adhesion, "fixed_share": fixed_share, "sensors": sensors, "substeps": substeps}
    loop = start(scenario, lateral_law, route, vehicle, body, **settings)
    longest = int(max(10.0, 10 * route.length / scenario.speed) / CONTROL_PERIOD)  # at a tenth of the speed
    log = _drive(loop, controllers, longest, sensors.loop if sensors else None)
    finite = np.isfinite(log).all()
    if not finite:  # the run ends at such a row, which `ended` names
        log = log[: np.argmin(np.isfinite(log).all(axis=1)) + 1]
    log = np.column_stack([np.arange(len(log)) * CONTROL_PERIOD, log])
    series = pd.DataFrame(log, columns=("t_s", *loop.columns), copy=False)
    ended, failed = _reason(loop, dict(zip(series, log[-1].tolist(), strict=True)))
    series = series if finite else series[:-1]
    memory = dict(zip(loop.control.signature.memory, loop.memory.tolist(), strict=True))
    return Run(series, ended, failed, _warnings(series, body), controllers, memory)


def start(
    scenario: Scenario, guidance: lateral.LateralLaw, route: Route, vehicle: Vehicle, plant_vehicle: Vehicle, **settings
) -> ClosedLoop:
    """Couple car and 1 kHz law (`guidance`) for a scenario, ready to run. The car starts in vertical equilibrium at the
    initial speed. The controllers assume `vehicle`; the car has the parameters `plant_vehicle`. `settings` are the
    arguments `adhesion`, `fixed_share`, `sensors` and `substeps` of `run`."""
    substeps = settings.pop("substeps", 1)
    settings |= {"lateral_limit": component.DERAILED, "track_end": route.length, "stop_speed": scenario.stop_speed}
    control = law.control_law(vehicle, guidance, **settings)
    car = component.SteppedCar(route, scenario.speed, plant_vehicle, scenario.good, scenario.poor, substeps=substeps)
    return ClosedLoop(car, control)


def _drive(loop: ClosedLoop, controllers: tuple, longest: int, sensors: Loop | None) -> np.ndarray:
    """Run to the end, with slower controllers at their period. Returns the log, shape (n, columns)."""
    if not controllers:
        return loop.run(longest)
    faults: list[BaseException] = []
    samples = [cycle.SAMPLE(_sample(*of_gear, sensors, faults)) for of_gear in zip(controllers, GEARS, strict=True)]
    planners = []
    for g, controller in enumerate(controllers):
        python = ctypes.cast(samples[g], ctypes.c_void_p).value or 0, 0
        planners.append(_compiled(controller, sensors, *controllers[:g]) or python)
    every = round(controllers[0].period / CONTROL_PERIOD)
    loop.connect(planners, every)
    log = loop.run(longest + -longest % every)  # whole samples
    if faults:
        raise faults[0]
    return log


def _compiled(controller: Any, *arguments: Any) -> tuple[int, int] | None:
    """Get the addresses of a slower controller in C, see `lateral.SlowController`; None if `plan` is to be called."""
    given = controller.compiled(*arguments) if hasattr(controller, "compiled") else None
    pair = isinstance(given, tuple) and [type(one) for one in given] == [int, int] and given[0] > 0
    if not pair and not (given is None and hasattr(controller, "plan")):
        needed = "a pair of addresses is needed, or None and a method plan"
        raise InputError(f"lateral controller {type(controller).__name__}: compiled() gave {given!r}, {needed}")
    return given


def _sample(controller: lateral.SlowController, gear: str, sensors: Loop | None, faults: list) -> Callable:
    """Make the function that samples a controller written in Python. An exception goes to `faults` and ends the run."""
    delay = sum(vars(sensors.latency).values()) + CONTROL_PERIOD if sensors else 0.0
    samples, n_readings = itertools.count(), len(interface.READ)

    def sample(_memory, state, read, base: float) -> float:
        try:
            x_hat, count = np.array(state[: len(STATES)]), next(samples)
            if faults or not np.isfinite([*x_hat, base]).all():
                return math.nan
            if sensors and count and hasattr(controller, "read"):  # nothing is read before the first cycle
                controller.read(np.array(read[:n_readings]), delay)
            torque = controller.plan(x_hat, base)
            if not is_number(torque):
                raise ArithmeticError(
                    f"the lateral controller of the {gear} gear returned {reprlib.repr(torque)} at t = "
                    f"{count * controller.period:.3f} s, p = {x_hat[X]:.1f} m; a finite number (N m) is needed"
                )
            return float(torque)
        except BaseException as fault:  # C does not pass it on
            faults.append(fault)
            return math.nan

    return sample


def _reason(loop: ClosedLoop, last: dict[str, float]) -> tuple[str, bool]:
    """Say why a run ended with this last row, and whether that is a failure."""
    at = f"at t = {last['t_s']:.3f} s, p = {last['front.p']:.1f} m"
    broken = [name for name, value in last.items() if not math.isfinite(value)]
    if broken:
        return f"{broken[0]} is not a finite number {at}", True
    passed = next((name for name, margin in loop.margins.items() if margin <= 0), "")
    gear, _, limit = passed.rpartition(".")
    if limit == "torque":
        return f"the lateral law of the {gear} gear gave no finite torque {at}", True
    if limit == "lateral":
        return f"{gear} gear derailed, |y| = {1e3 * abs(last[f'{gear}.y']):.1f} mm {at}", True
    stopped = "stop speed reached" if last["front.v"] > 0 else "the car stands"
    reasons = {"track_end": "end of the run", "stop_speed": stopped}
    return f"{reasons.get(limit, 'time limit reached')} {at}", False


def _warnings(series: pd.DataFrame, vehicle: Vehicle) -> tuple[str, ...]:
    """Say where the run first left the range in which a model is valid."""
    found: list[str] = []
    if series.empty:  # the first row of the run is not finite
        return ()

    def first(mask: np.ndarray, sentence: str) -> None:
        if mask.any():
            row = series.iloc[int(np.argmax(mask))]
            found.append(f"{sentence} at t = {row['t_s']:.3f} s, p = {row['front.p']:.1f} m")

    for name, wheel in ((name, Part(series, name)) for name in equations.WHEELS):
        first(wheel.N <= 0, f"{name} wheel lifts")
        first(np.abs(wheel.angle) > FLANGE_ANGLE, f"{name} wheel: its flange touches the rail")
    for name, gear in ((name, Part(series, name)) for name in GEARS):
        first(np.abs(gear.yaw_to_body) > vehicle.suspension.yaw_stop_angle, f"{name} gear is on its yaw end stop")
        if vehicle.contact.profile == "cone":
            beyond = np.abs(gear.y - gear.rail_y) > FLANGEWAY
            first(beyond, f"{name} gear is where flanges would touch, cones have none")
        first(gear.v < equations.SLIP_FLOOR, f"{name} gear is slower than the slip regularisation")
    return tuple(found)
