"""A second opinion on the car: the same runs in our equations and in the public multibody code Exudyn.

`python -m railrepro.studies.second_opinion [case ...]` writes data/results/second_opinion.csv; needs the extra `bench`.
Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from tqdm import tqdm

from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.car.equations import WHEELS
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.control.ndi import NDI
from railrepro.errors import InputError, told
from railrepro.files import write
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies.exudyn_car import MEASURED, STEP, ExudynCar
from railrepro.track import route
from railrepro.track.irregularity import irregularities
from railrepro.vehicle.parameters import Vehicle, load_vehicle

SHORT_STEPS = 20
"""Steps of our car in an exchange when its own step error is to vanish."""
_GUARD = 5.0
"""Triple pole of the feedback that holds a replay on the recorded path (rad/s), far below those of the controllers."""


@dataclass(frozen=True)
class Case:
    """A run of our car whose torques Exudyn's car gets.

    Attributes
    ----------
    name, scenario : str
        Own name; name in data/scenarios.toml.
    seconds : float
        Length of the comparison (s).
    changes : dict
        Fields of the scenario to change.
    pulses : float
        Differential torque of open-loop pulses (N m); 0: NDI with integral action, replayed with `_guard`.
    irregular : bool
        Irregular rails.
    step : float
        Step of Exudyn (s); irregular rails need shorter ones.
    """

    name: str
    scenario: str
    seconds: float
    changes: dict = field(default_factory=dict)
    pulses: float = 0.0
    irregular: bool = False
    step: float = STEP


_STRAIGHT = {"set_point": {"kind": "none"}, "speed_kmh": 200}
CASES = (
    Case("straight pulses", "sine_tracking", 3.0, _STRAIGHT, pulses=30.0),
    Case("braking on T2", "braking", 22.0),
    *(Case(track, f"curve_entry_{track}", s) for track, s in (("T1", 17.5), ("T2", 13), ("T3", 7.5), ("T4", 6.2))),
    Case("irregular rails", "sine_tracking", 5.0, _STRAIGHT, irregular=True, step=1e-4),
)


AGREEMENT = 0.01
"""Difference relative to the largest value of a signal that counts as agreement (-)."""


class _Pulses:
    """Differential torque +, -, -, + of 0.1 s each, opposite on the rear gear: yaw goes and comes back."""

    period = EXCHANGE_PERIOD

    def __init__(self, amplitude: float, gear: int):
        self._count, self._amplitude = -100, amplitude * (1 - 2 * gear)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        phase, self._count = self._count // 100, self._count + 1
        return self._amplitude * (1, -1, -1, 1)[phase] if 0 <= phase < 4 else 0.0


def record(case: Case, vehicle: Vehicle) -> tuple[pd.DataFrame, route.Route]:
    """Our car's run, one row per exchange (see `simulate.run`), and the route it went."""
    scenario = load_scenario(case.scenario).but(**case.changes)
    rough = irregularities(np.arange(0.0, scenario.end_m, route.CELL)) if case.irregular else None
    guidance = (lambda _v, _w, gear: _Pulses(case.pulses, gear)) if case.pulses else NDI(integral=0.1)
    series = simulate.run(scenario, guidance, vehicle=vehicle, irregularities=rough).series
    return series[series["t_s"] < case.seconds], scenario.route(rough)


def _guard(case: Case, series: pd.DataFrame, vehicle: Vehicle) -> Callable:
    """Replay of the recorded commands, plus (not for pulses) a soft feedback to the recorded path.

    The free lateral motion is neutral, so differences would add up for ever. Our own car at its usual step repeats its
    record exactly; its feedback is zero.
    """
    commands = np.array(
        [series[f"{w[:-3]}.tau_long"] + (1 if w.endswith("le") else -1) * series[f"{w[:-3]}.du"] for w in WHEELS]
    ).T
    path, speed, before = series[list(MEASURED[:4])].to_numpy(), series["front.v"].to_numpy(), np.zeros(2)
    gain = (not case.pulses) * vehicle.wheel.radius / vehicle.gear.contact_base * vehicle.effective_yaw_inertia

    def law(k: int, measured: np.ndarray) -> np.ndarray:
        nonlocal before
        y, yaw = np.split(path[k] - measured[:4], 2)
        rate, before = (yaw - before) / EXCHANGE_PERIOD, yaw
        du = gain * (_GUARD**3 / speed[k] * y + 3 * _GUARD**2 * yaw + 3 * _GUARD * rate)
        return commands[k] + np.outer(du, (1, -1)).ravel()

    return law


def replay(case: Case, vehicle: Vehicle | None = None) -> dict[str, pd.DataFrame]:
    """Both cars through a case.

    Returns
    -------
    dict of DataFrame
        "exudyn", and our car by the length of its step in ms, "1" and "0.05"; one row per exchange, `MEASURED` (SI).
    """
    vehicle = vehicle or load_vehicle()
    series, way = record(case, vehicle)
    speed = series["front.v"].iloc[0]
    car, law, log = SteppedCar(way, speed, vehicle), _guard(case, series, vehicle), []
    for k in range(len(series)):
        outputs = car.outputs
        log.append(np.array([outputs[name] for name in MEASURED]))
        car.step(law(k, log[-1]), SHORT_STEPS, EXCHANGE_PERIOD / SHORT_STEPS)
    other = ExudynCar(vehicle, way, speed)
    theirs = other.run(_guard(case, series, vehicle), len(series), case.step)
    return {"exudyn": theirs, "1": series[list(MEASURED)], "0.05": pd.DataFrame(log, columns=MEASURED)}


def compare(name: str, runs: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Differences of the two cars in the runs of `replay`.

    Returns
    -------
    DataFrame
        case, car_step_ms, quantity, largest (value of our signal), difference (largest), relative (their ratio; of all
        gears or wheels the worst), beyond (share of samples that differ by more than `AGREEMENT`), rms (of the worst
        one's difference), unit.
    """
    rows = []
    for step in ("1", "0.05"):
        ours, theirs = (_signals(runs[key]) for key in (step, "exudyn"))
        for (quantity, unit), signals in ours.items():
            size, error = np.abs(signals).max(axis=0), theirs[quantity, unit] - signals
            worst = int(np.argmax(np.abs(error).max(axis=0) / size))
            largest, rms = np.abs(error[:, worst]).max(), np.sqrt(np.mean(error[:, worst] ** 2))
            beyond = np.mean(np.abs(error) > AGREEMENT * size)
            rows.append((name, step, quantity, size[worst], largest, largest / size[worst], beyond, rms, unit))
    columns = ("case", "car_step_ms", "quantity", "largest", "difference", "relative", "beyond", "rms", "unit")
    return pd.DataFrame(rows, columns=columns)


def _signals(run: pd.DataFrame) -> dict[tuple[str, str], np.ndarray]:
    """Quantity and unit -> signals of all gears or wheels, shape (n, 2 or 4)."""
    y, yaw, speed, load = np.split(run[list(MEASURED)].to_numpy(), (2, 4, 8), axis=1)
    signals = {("lateral position", "m"): y, ("yaw angle to the track", "rad"): yaw, ("wheel speed", "rad/s"): speed}
    return signals | {("wheel speed, left - right", "rad/s"): speed[:, ::2] - speed[:, 1::2], ("wheel load", "N"): load}


def main(names: list[str]) -> None:
    """Compare the named cases and print them, or all and write the table."""
    unknown = set(names) - {case.name for case in CASES}
    if unknown:
        raise InputError(f"case {min(unknown)!r} is not known; there are {[case.name for case in CASES]}")
    chosen = [case for case in CASES if case.name in names or not names]
    table = pd.concat([compare(case.name, replay(case)) for case in tqdm(chosen)], ignore_index=True)
    if not names:
        write(paths.product("data/results/second_opinion.csv"), table.to_csv(index=False, float_format="%.4g"))
    print(table.to_string(index=False, float_format="{:.3g}".format))


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
