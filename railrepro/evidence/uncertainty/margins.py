"""Stability margins of each tuned controller, and its measured sensitivity.

`python -m railrepro margins` writes data/results/margins.csv and sensitivity.csv. Nothing is
linearised by hand: the loop runs as it is, with sampling, filter and latency, and is disturbed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.clock import CONTROL_PERIOD
from railrepro.control import lateral
from railrepro.control.registry import CONTROLLERS, SHOWN
from railrepro.data import write
from railrepro.estimation.sensors import load_loop, readings
from railrepro.evidence.runs import store, tuning
from railrepro.evidence.runs.executor import executor, ordered_map, work
from railrepro.evidence.runs.experiment import Experiment
from railrepro.evidence.runs.swarm import driven
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import Vehicle, load_vehicle

WINDOW, SETTLED = 4.0, 2.0
"""Length of the window that is analysed and time before it (s); all frequencies are whole multiples of 1 / WINDOW."""
FREQUENCIES = (
    *(0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 12.0, 14.0, 16.0),
    *(18.0, 20.0, 24.0, 28.0, 32.0),
)
"""Frequencies of the disturbance (Hz)."""
AMPLITUDE = 20.0
"""Amplitude of each sine of the disturbance (N m), well above resolution and well below limits."""
LINEAR = 0.5
"""Least share of the power of the response that lies at the disturbed frequencies in a stable loop."""
RAILS = {"dry": ("sine_tracking", 600.0), "poor": ("adhesion_loss", 600.0)}
"""Scenario at 400 km/h and its end (m) by rail."""
_KMH = (100.0, 200.0, 300.0, 400.0)


class ProbedLaw:
    """`lateral.LateralLaw` that adds `multisine` times `amplitude` (N m) to the differential torque of a guidance."""

    def __init__(self, guidance: lateral.Guidance, amplitude: float):
        (self._law, self._factory), self._amplitude = lateral.split(guidance), amplitude
        self.memory = (*getattr(self._law, "memory", ()), "probe_ticks")

    def gains(self) -> dict[str, float]:
        """Gains by name: those of the 1 kHz law of the guidance, and probe_amplitude (N m)."""
        return {**lateral.gains_of(self._law), "probe_amplitude": self._amplitude}

    def torque(self, q: SimpleNamespace) -> tuple[ca.SX, dict]:
        """Disturbed differential torque (N m) and next states of the law by name; `q` as in `LateralLaw.torque`."""
        du, following = lateral.answer(self._law, q)
        signal = q.probe_amplitude * multisine(q.probe_ticks * CONTROL_PERIOD, ca.sin)
        return du + signal, following | {"probe_ticks": q.probe_ticks + 1}


class _WithControllers(ProbedLaw):
    """One that holds the torque of slower controllers, whose factory it is."""

    def __call__(self, vehicle, route, gear: int) -> lateral.SlowController:
        return self._factory(vehicle, route, gear)


def multisine(t, sine: Callable = np.sin):
    """Sum over `FREQUENCIES` of sine(2 pi f t - phase), t in s, in the shape of t. Source: Schroeder 1970 (phases)."""
    count = len(FREQUENCIES)
    return sum(sine(2 * np.pi * f * t - np.pi * k * (k + 1) / count) for k, f in enumerate(FREQUENCIES))


def probed(guidance: lateral.Guidance, amplitude: float) -> lateral.Guidance:
    """Guidance with `multisine` times `amplitude` (N m) added to its differential torque, see `ProbedLaw`."""
    return (_WithControllers if callable(guidance) else ProbedLaw)(guidance, amplitude)


def disk_margin(values: np.ndarray) -> float:
    """Symmetric disk margin a (-) of the complex `sensitivity` S at several frequencies, a = 1 / max |S - 1/2|.

    The gain may change by (2 - a) / (2 + a) to (2 + a) / (2 - a), or the phase by 2 atan(a / 2) (rad).

    Source: Seiler, Packard and Gahinet 2020.
    """
    return float(1 / np.abs(values - 0.5).max())


def sensitivity(
    guidance, speed_kmh: float, sensors: dict | None = None, vehicle: Vehicle | None = None
) -> np.ndarray | None:
    """Measure the sensitivity S = 1 / (1 + L) at the differential torque of the front gear, on straight dry track.

    Complex, shape (len(FREQUENCIES),): differential torque over disturbance, from the difference of a run with and one
    without disturbance at `speed_kmh`. `guidance` and `vehicle` as in `simulate.run`, `sensors` are arguments of
    `sensors.readings`; their noise is equal in both runs and cancels. None when a run fails or the loop is unstable.
    """
    end = (WINDOW + SETTLED + 0.1) * speed_kmh / 3.6
    scenario = load_scenario("sine_tracking").but(set_point={"kind": "none"}, speed_kmh=speed_kmh, end_m=end)
    seen = readings(**sensors) if sensors else None
    first, count, found = round(SETTLED / CONTROL_PERIOD), round(WINDOW / CONTROL_PERIOD), []
    for amplitude in (0.0, AMPLITUDE):
        run = simulate.run(scenario, probed(guidance, amplitude), vehicle=vehicle, sensors=seen)
        if run.failed:
            return None
        found.append(run.series["front.du"].to_numpy()[: first + count])
    answer = (found[1] - found[0])[first:] / AMPLITUDE
    early, late = (np.sqrt(np.mean(half**2)) for half in np.split(answer, 2))
    torque = np.fft.rfft(answer)
    disturbance = np.fft.rfft(multisine((first + np.arange(count)) * CONTROL_PERIOD))
    lines = np.round(np.array(FREQUENCIES) * WINDOW).astype(int)
    answered = np.sum(np.abs(torque[lines]) ** 2) / np.sum(np.abs(torque) ** 2)
    stable = answered > LINEAR and late < 2 * early
    return torque[lines] / disturbance[lines] if stable else None


QUANTITIES = {
    "delay": ("inverter.delay", 0.0, 15e-3, 1e-3, "s"),
    "lag": ("drive.lag", 5e-3, 0.1, 2.5e-3, "s"),
    "gain": ("inverter.gain", 1.0, 5.0, 0.1, "-"),
}
"""Quantities that are raised until the car derails or reaches the flanges: extra delay, lag of the drive, torque over
its command. Each with its key, begin and end of the search, resolution and unit."""


def survived(fails: Callable[[float], bool], nominal: float, largest: float, resolution: float) -> float:
    """Largest value of a quantity for which `fails(value)` is false, by bisection between `nominal` and `largest`.

    Bisection ends at `resolution`; all numbers have the unit of the quantity. Returns nan when `nominal` fails,
    `largest` when this value does not fail.
    """
    if fails(nominal):
        return float("nan")
    low, high = nominal, largest
    if not fails(high):
        return high
    while high - low > 1.01 * resolution:
        steps = round((high - low) / resolution) // 2
        middle = low + max(steps, 1) * resolution
        low, high = (low, middle) if fails(middle) else (middle, high)
    return low


def largest(setting: str, controller: str, rail: str, quantity: str) -> float:
    """Largest value of a quantity (key of `QUANTITIES`, in its unit) with which a tuned controller avoids the flanges.

    `setting` ("paper", "equal", "loop") and `controller` (key of `registry.CONTROLLERS`) select the tuned parameters,
    `rail` is a key of `RAILS`. nan when the controller fails at the start of the search, see `survived`.
    """
    name, end = RAILS[rail]
    key, *bounds, _ = QUANTITIES[quantity]
    sensors = {"seed": 101} | ({} if setting == tuning.LOOP else {"perfect": True})
    quick = CONTROLLERS[controller].quick
    run = Experiment(load_scenario(name).but(end_m=end), controller, options=quick, setting=setting, sensors=sensors)

    def fails(value: float) -> bool:
        of_car = {"plant": {key: value}} if key.startswith("drive.") else {"sensors": sensors | {key: value}}
        return replace(run, **of_car).measured(driven)[0]["failed"]

    return survived(fails, *bounds)


def peaks(setting: str, controller: str, speed_kmh: float) -> dict:
    """Keys peak_sensitivity (max |S|), disk_margin (-) of a tuned controller; inf, 0 where `sensitivity` is None."""
    around = load_loop() if setting == tuning.LOOP else None
    read = controller, speed_kmh, tuning.load(controller, setting)["parameters"], around, load_vehicle()
    key = store.key(__name__, "sensitivity", read)
    return store.entry(key, lambda: work(_peaks, setting, controller, speed_kmh))[0]


def _peaks(setting: str, controller: str, speed_kmh: float) -> store.Entry:
    guidance = tuning.tuned(controller, CONTROLLERS[controller].quick, setting)
    found = sensitivity(guidance, speed_kmh, {"seed": 101} if setting == tuning.LOOP else None)
    largest, margin = (float("inf"), 0.0) if found is None else (float(np.abs(found).max()), disk_margin(found))
    return {"peak_sensitivity": largest, "disk_margin": margin}, None


def main() -> None:
    """Measure all tuned controllers and write data/results/margins.csv and sensitivity.csv."""
    pairs = [*product(tuning.SETTINGS, SHOWN)]
    survivals = [(*pair, rail, quantity) for pair in pairs for rail in RAILS for quantity in QUANTITIES]
    loops = [(*pair, speed) for pair in pairs for speed in _KMH]
    with executor() as pool:
        values = ordered_map(pool, lambda case: largest(*case), survivals, "margins")
        found = ordered_map(pool, lambda case: peaks(*case), loops, "sensitivity")
    table = pd.DataFrame(survivals, columns=["setting", "controller", "rail", "quantity"]).assign(largest=values)
    table["unit"] = [QUANTITIES[name][-1] for name in table["quantity"]]
    measured = pd.DataFrame(loops, columns=["setting", "controller", "speed_kmh"]).join(pd.DataFrame(found))
    for name, rows in {"margins": table, "sensitivity": measured}.items():
        write(paths.product(f"data/results/{name}.csv"), rows.to_csv(index=False, float_format="%.6g"))
