"""Stability margin of a controller, from the sensitivity that is measured in the loop itself, without linearisation."""

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from railrepro.clock import CONTROL_PERIOD
from railrepro.control import lateral
from railrepro.control.registry import CONTROLLERS, guidance
from railrepro.estimation.sensors import load_loop, readings
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies import store
from railrepro.studies.executor import work
from railrepro.vehicle.parameters import Vehicle, load_vehicle

WINDOW, SETTLED = 6.0, 2.0
"""Length of the window that is analysed, and time before it (s). All frequencies are whole multiples of 1 / WINDOW."""
FREQUENCIES = tuple((np.r_[2:60:2, 60:120:4, 120:193:6] / WINDOW).tolist())
"""Frequencies of the disturbance (Hz), dense enough that no resonance of a searched loop fits between two of them."""
AMPLITUDE = 13.0
"""Amplitude of each sine of the disturbance (N m), well above resolution and well below limits."""


class _Probed:
    """1 kHz law of a guidance that adds `multisine` times `amplitude` (N m) to the differential torque."""

    def __init__(self, guidance: lateral.Guidance, amplitude: float):
        (self._law, self._factory), self._amplitude = lateral.split(guidance), amplitude
        self.memory = (*getattr(self._law, "memory", ()), "probe_ticks")

    def gains(self) -> dict[str, float]:
        return {**lateral.gains_of(self._law), "probe_amplitude": self._amplitude}

    def torque(self, q: lateral.Quantities) -> tuple[ca.SX, dict]:
        du, following = lateral.answer(self._law, q)
        signal = q.probe_amplitude * multisine(q.probe_ticks * CONTROL_PERIOD, ca.sin)
        return du + signal, following | {"probe_ticks": q.probe_ticks + 1}


class _ProbedFactory(_Probed):
    """The same for a guidance that is a factory of slower controllers, whose held torque is disturbed."""

    def __call__(self, *of_gear) -> lateral.SlowController:
        return self._factory(*of_gear)


def multisine(t, sine: Callable = np.sin):
    """Disturbance (-) that `sensitivity` adds to the torque, a sum of sines at 57 frequencies f from 1/3 to 32 Hz
    (`FREQUENCIES`): sine(2 pi f t - phase). `t` is a number, array or CasADi expression (s), and the result alike;
    `sine` is its sine function. Source: Schroeder 1970 (phases)."""
    count = len(FREQUENCIES)
    return sum(sine(2 * np.pi * f * t - np.pi * k * (k + 1) / count) for k, f in enumerate(FREQUENCIES))


def disk_margin(values: np.ndarray) -> float:
    """Symmetric disk margin a = 1 / max |S - 1/2| (-) from the complex sensitivity S at several frequencies. The loop
    gain may change by a factor of (2 - a) / (2 + a) to (2 + a) / (2 - a), or the phase by 2 atan(a / 2) (rad). Source:
    Seiler, Packard and Gahinet 2020."""
    return float(1 / np.abs(values - 0.5).max())


def sensitivity(
    law, speed_kmh: float, sensors: dict | None = None, vehicle: Vehicle | None = None
) -> np.ndarray | None:
    """Measure the sensitivity S = 1 / (1 + L) of the loop L, opened at the differential torque of the front gear, on
    straight dry track. It compares a run with the disturbance `multisine` to one without. Returns the complex ratio of
    torque to disturbance at `FREQUENCIES`, or None when a run fails or the loop is unstable. `law` is a lateral
    controller as from `registry.guidance`: an object with `torque(q)`, such as `NDI()`, or a factory, which makes a
    slower controller such as NMPC per gear. `vehicle` has the parameters of the simulated car, which the controller
    assumes, too; default data/vehicle.toml. `sensors` are arguments of `sensors.readings`; their noise cancels."""
    end = (WINDOW + SETTLED + 0.1) * speed_kmh / 3.6
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=speed_kmh, end_m=end)
    seen = readings(**sensors) if sensors else None
    probed = _ProbedFactory if callable(law) else _Probed
    first, count = round(SETTLED / CONTROL_PERIOD), round(WINDOW / CONTROL_PERIOD)

    def torque(amplitude: float, fraction: float = 1.0) -> np.ndarray | None:
        run = simulate.run(scenario.but(end_m=fraction * end), probed(law, amplitude), vehicle=vehicle, sensors=seen)
        return None if run.failed else run.series["front.du"].to_numpy()[: first + count]

    begin = torque(0.0, 0.1) if seen is None else None
    at_rest = begin is not None and not begin.any()  # a loop without noise that is at rest at first stays so
    disturbed, undisturbed = torque(AMPLITUDE), np.zeros(first + count) if at_rest else torque(0.0)
    if disturbed is None or undisturbed is None:
        return None
    response = (disturbed - undisturbed)[first:] / AMPLITUDE
    early, late = (np.sqrt(np.mean(half**2)) for half in np.split(response, 2))
    torques = np.fft.rfft(response)
    disturbance = np.fft.rfft(multisine((first + np.arange(count)) * CONTROL_PERIOD))
    lines = np.round(np.array(FREQUENCIES) * WINDOW).astype(int)
    linear = np.sum(np.abs(torques[lines]) ** 2) / np.sum(np.abs(torques) ** 2)  # part of the power
    stable = linear > 0.9 and late < 2 * early
    return torques[lines] / disturbance[lines] if stable else None


def peaks(
    controller: str, parameters: dict, speed_kmh: float, sensed: bool = False, vehicle: Vehicle | None = None
) -> dict:
    """Measure, or read from the store, the largest sensitivity of a controller with tuning `parameters` at a speed
    (km/h). Returns a dict: peak_sensitivity (max |S|) and disk_margin (-); inf and 0 if the loop is unstable or a run
    fails. `controller`: key of `CONTROLLERS`; `sensed`: whether it has sensors; `vehicle` None: data/vehicle.toml."""
    read = parameters, CONTROLLERS[controller].quick, speed_kmh, load_loop() if sensed else None
    key = store.key(__name__, "peaks", controller.removesuffix("_swarm"), *read, vehicle or load_vehicle())
    return store.entry(key, lambda: work(_peaks, controller, parameters, speed_kmh, sensed, vehicle))[0]


def _peaks(controller: str, parameters: dict, speed_kmh: float, sensed: bool, vehicle: Vehicle | None) -> store.Entry:
    law = guidance(controller, parameters, CONTROLLERS[controller].quick)
    try:
        measured = sensitivity(law, speed_kmh, {"seed": 101} if sensed else None, vehicle)  # any seed: noise cancels
    except (ArithmeticError, np.linalg.LinAlgError):
        measured = None
    if measured is None:
        return {"peak_sensitivity": float("inf"), "disk_margin": 0.0}, None
    return {"peak_sensitivity": float(np.abs(measured).max()), "disk_margin": disk_margin(measured)}, None


def smallest(
    controller: str,
    parameters: dict,
    speeds_kmh: Sequence[float],
    least: float = 0.0,
    sensed: bool = False,
    vehicle: Vehicle | None = None,
) -> float:
    """Smallest disk margin (-) over speeds of a controller (key of `CONTROLLERS`) with tuning `parameters`; the first
    below `least` ends the search. inf without speeds. `sensed`: with sensors; `vehicle` None: data/vehicle.toml."""
    margin = float("inf")
    for speed in speeds_kmh:
        margin = min(margin, peaks(controller, parameters, speed, sensed, vehicle)["disk_margin"])
        if margin < least:
            break
    return margin
