"""Stability margins of all tuned sets: the longest added delay, and the disk margin at four speeds."""

from __future__ import annotations

from bisect import bisect_left
from itertools import product

import numpy as np
import pandas as pd

from railrepro import paths
from railrepro.control.registry import CONTROLLERS, LOOP, SETTINGS, SHOWN, parameters, tuned
from railrepro.data import write
from railrepro.estimation.sensors import load_loop
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies import store
from railrepro.studies.executor import ordered_map, work
from railrepro.studies.experiment import Experiment
from railrepro.tuning.cost import driven
from railrepro.tuning.margin import disk_margin, sensitivity
from railrepro.vehicle.parameters import load_vehicle

LONGEST_MS = 15
"""Longest delay that is tried (ms)."""
_KMH = (100.0, 200.0, 300.0, 400.0)


def delay_margin(setting: str, controller: str) -> float:
    """Largest delay (s) added to the torque command with which no wheel touches its flange at 400 km/h on poor rail.

    Whole milliseconds up to `LONGEST_MS` are tried, by bisection. NaN if a flange is touched without added delay.
    `setting` ("paper", "equal", "loop") and `controller` (key of `registry.CONTROLLERS`) select the tuned set.
    """
    sensors = {"seed": 101} | ({} if setting == LOOP else {"perfect": True})
    scenario, quick = load_scenario("adhesion_loss").but(end_m=600.0), CONTROLLERS[controller].quick

    def fails(delay_ms: int) -> bool:
        delayed = sensors | {"inverter.delay": 1e-3 * delay_ms}
        run = Experiment(scenario, controller, options=quick, setting=setting, sensors=delayed)
        return run.measured(driven)[0]["failed"]

    if fails(0):  # some then survive a delay
        return float("nan")
    return 1e-3 * (bisect_left(range(LONGEST_MS + 1), True, lo=1, key=fails) - 1)


def peaks(setting: str, controller: str, speed_kmh: float) -> dict:
    """Dict peak_sensitivity (max |S| at the torque), disk_margin (-) of a tuned controller; inf and 0 if unstable."""
    around = load_loop() if setting == LOOP else None
    read = controller, speed_kmh, parameters(controller, setting), around, load_vehicle()
    key = store.key(__name__, "sensitivity", read)
    return store.entry(key, lambda: work(_peaks, setting, controller, speed_kmh))[0]


def _peaks(setting: str, controller: str, speed_kmh: float) -> store.Entry:
    guidance = tuned(controller, CONTROLLERS[controller].quick, setting)
    found = sensitivity(guidance, speed_kmh, {"seed": 101} if setting == LOOP else None)
    largest, margin = (float("inf"), 0.0) if found is None else (float(np.abs(found).max()), disk_margin(found))
    return {"peak_sensitivity": largest, "disk_margin": margin}, None


def main() -> None:
    """Write data/results/margins.csv (`delay_margin`) and sensitivity.csv (`peaks`) of the controllers `SHOWN`."""
    pairs = [*product(SETTINGS, SHOWN)]
    loops = [(*pair, speed) for pair in pairs for speed in _KMH]
    delays = ordered_map(lambda pair: delay_margin(*pair), pairs, "delay margins")
    found = ordered_map(lambda case: peaks(*case), loops, "sensitivity")
    margins = pd.DataFrame(pairs, columns=["setting", "controller"]).assign(delay_margin_s=delays)
    measured = pd.DataFrame(loops, columns=["setting", "controller", "speed_kmh"]).join(pd.DataFrame(found))
    for name, rows in {"margins": margins, "sensitivity": measured}.items():
        write(paths.product(f"data/results/{name}.csv"), rows.to_csv(index=False, float_format="%.6g"))
