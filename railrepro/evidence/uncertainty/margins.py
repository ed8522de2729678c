"""Stability margins of all tuned controllers: the longest tolerated delay, and the disk margin at four speeds."""

from bisect import bisect_left
from itertools import product

import pandas as pd

from railrepro import paths
from railrepro.control.registry import BY_SWARM, CONTROLLERS, LOOP, PAPER, SHOWN, parameters
from railrepro.data import write
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies.executor import ordered_map
from railrepro.studies.experiment import Experiment
from railrepro.tuning.cost import driven
from railrepro.tuning.margin import peaks

LONGEST_MS = 15  # longest delay that is tried


def delay_margin(setting: str, controller: str) -> float:
    """Find the largest delay (s) added to the torque command with which no flange is touched at 400 km/h on poor rail.
    It is a whole number of ms up to 15 ms; NaN if a flange is touched without added delay. `setting`, "paper" (exact
    measurements) or "loop" (sensors), and `controller` (key of `registry.CONTROLLERS`) select tuned parameters."""
    sensors = {"seed": 101} | ({} if setting == LOOP else {"perfect": True})
    scenario, quick = load_scenario("adhesion_loss").but(end_m=600.0), CONTROLLERS[controller].quick

    def fails(delay_ms: int) -> bool:
        delayed = sensors | {"inverter.delay": 1e-3 * delay_ms}
        run = Experiment(scenario, controller, options=quick, setting=setting, sensors=delayed)
        return run.measured(driven)[0]["failed"]

    if fails(0):  # some then survive a delay
        return float("nan")
    return 1e-3 * (bisect_left(range(LONGEST_MS + 1), True, lo=1, key=fails) - 1)


def main() -> None:
    """Command `margins`: write two tables to data/results, both by tuned controller and setting ("paper": exact
    measurements, "loop": sensors). margins.csv has `delay_margin` (s, up to 0.015) at 400 km/h on poor rail, NaN if a
    flange is touched without delay. sensitivity.csv has a row per speed (100, 200, 300 and 400 km/h) with max |S| and
    disk margin (inf and 0 if unstable), and none over all speeds."""
    pairs = [*product([PAPER], (*SHOWN, *BY_SWARM)), *product([LOOP], SHOWN)]
    loops = [(*pair, speed) for pair in pairs for speed in (100.0, 200.0, 300.0, 400.0)]

    def sensitivity(case: tuple[str, str, float]) -> dict:
        setting, controller, speed = case
        return peaks(controller, parameters(controller, setting), speed, setting == LOOP)

    delays = ordered_map(lambda pair: delay_margin(*pair), pairs, "delay margins")
    curves = ordered_map(sensitivity, loops, "sensitivity")
    margins = pd.DataFrame(pairs, columns=["setting", "controller"]).assign(delay_margin_s=delays)
    measured = pd.DataFrame(loops, columns=["setting", "controller", "speed_kmh"]).join(pd.DataFrame(curves))
    for name, rows in {"margins": margins, "sensitivity": measured}.items():
        write(paths.product(f"data/results/{name}.csv"), rows.to_csv(index=False, float_format="%.6g"))
