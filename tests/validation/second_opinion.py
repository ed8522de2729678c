"""Second opinion on the car: the same runs with the equations of the project and in the multibody code Exudyn. As a
script it writes data/results/second_opinion.csv (group `bench`). Serves the paper's section Simulation Environment."""

from collections.abc import Callable
from typing import NamedTuple

import exudyn_car
import numpy as np
import pandas as pd
from exudyn_car import MEASURED, STEP, ExudynCar, Rails
from tqdm import tqdm

from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.control.ndi import NDI
from railrepro.data import write
from railrepro.quantities import GEARS
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import route
from railrepro.track.alignment import alignments
from railrepro.track.irregularity import irregularities
from railrepro.vehicle.parameters import Vehicle, load_vehicle

AGREEMENT = 0.01  # difference relative to the largest value of a signal that counts as agreement
GUIDED = tuple(f"{gear}.du" for gear in GEARS)
_GUARD = 8.0
"""Fourfold pole of the feedback that keeps a replay on the recorded path (rad/s), far below those of the controllers.
Laterally the cars are integrators: without the integral a torque that differs by 1 N m moves them by 1 mm."""


class Case(NamedTuple):
    """A run of the project's car whose torques the Exudyn car gets."""

    name: str
    scenario: str
    seconds: float
    changes: dict = {}  # fields of the scenario
    pulses: float = 0.0  # differential torque, open loop (N m); 0: NDI with integral action, replayed with `_Guard`
    irregular: bool = False
    step: float = STEP  # of Exudyn (s); irregular rails excite the contact modes and need shorter ones


_STRAIGHT = {"set_point": {"kind": "none"}, "speed_kmh": 200}
CASES = (
    Case("straight pulses", "sine_tracking", 3.0, _STRAIGHT, pulses=30.0),
    Case("braking on T2", "braking", 22.0),
    *(Case(track, f"curve_entry_{track}", s) for track, s in (("T1", 17.5), ("T2", 13), ("T3", 7.5), ("T4", 6.2))),
    Case("irregular rails", "sine_tracking", 5.0, _STRAIGHT, irregular=True, step=1e-4),
)


class _Pulses:
    """Differential torque +, -, -, + of 0.1 s each, opposite on the rear gear: yaw goes and comes back."""

    period = CONTROL_PERIOD

    def __init__(self, amplitude: float, gear: int):
        self._count, self._amplitude = -100, amplitude * (1 - 2 * gear)

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        phase, self._count = self._count // 100, self._count + 1
        return self._amplitude * (1, -1, -1, 1)[phase] if 0 <= phase < 4 else 0.0


def record(case: Case, vehicle: Vehicle) -> tuple[pd.DataFrame, route.Route, Rails]:
    """Run the project's car: series (see `simulate.run`), its route, and the same rails for Exudyn."""
    scenario = load_scenario(case.scenario).but(**case.changes)
    rough = irregularities(np.arange(0.0, scenario.end_m, route.CELL)) if case.irregular else None
    guidance = (lambda _v, _w, gear: _Pulses(case.pulses, gear)) if case.pulses else NDI(integral=0.1)
    series = simulate.run(scenario, guidance, vehicle=vehicle, irregularities=rough).series
    return series[series["t_s"] < case.seconds], scenario.route(rough), Rails(alignments()[scenario.track], rough)


class _Guard:
    """Replay of the recorded commands, plus (not for pulses) a low-gain feedback to the recorded path. The free lateral
    motion is neutral, so differences would add up without it. The project's car at its usual step repeats its record
    exactly; its feedback is zero."""

    def __init__(self, case: Case, series: pd.DataFrame, vehicle: Vehicle):
        self._pulled = series[[f"{gear}.tau_long" for gear in GEARS]].to_numpy()
        self._steered, self._added = series[list(GUIDED)].to_numpy(), np.zeros((len(series), 2))
        self._path, self._speed = series[list(MEASURED[:4])].to_numpy(), series["front.v"].to_numpy()
        lever = (not case.pulses) * vehicle.wheel.radius / vehicle.gear.contact_base
        self._gain = lever * vehicle.effective_yaw_inertia
        self._before, self._sum = np.zeros(2), np.zeros(2)

    def __call__(self, k: int, measured: np.ndarray) -> np.ndarray:
        y, yaw = np.split(self._path[k] - measured[:4], 2)
        rate, self._before = (yaw - self._before) / CONTROL_PERIOD, yaw
        self._sum += _GUARD / 4 * CONTROL_PERIOD * y
        steered = 4 * _GUARD**3 / self._speed[k] * (y + self._sum) + 6 * _GUARD**2 * yaw + 4 * _GUARD * rate
        self._added[k] = self._gain * steered
        return (self._pulled[k][:, None] + np.outer(self._steered[k] + self._added[k], (1, -1))).ravel()

    def guided(self) -> dict[str, np.ndarray]:
        """Return the differential torque commands with the feedback (N m)."""
        return dict(zip(GUIDED, (self._steered + self._added).T, strict=True))


def replay(case: Case, law: Callable = exudyn_car.creep) -> dict[str, pd.DataFrame]:
    """Drive both cars on cones through a case; `law` is the creep law of the Exudyn car. Returns "exudyn", and the
    project's car by its step in ms, "1" and "0.05"; one row per cycle, `MEASURED` (SI) and the differential torque
    commands `GUIDED` with the feedback (N m)."""
    vehicle = load_vehicle(**{"contact.profile": "cone"})
    series, way, rails = record(case, vehicle)
    speed = series["front.v"].iloc[0]
    car, guard, log = SteppedCar(way, speed, vehicle), _Guard(case, series, vehicle), []
    for k in range(len(series)):
        outputs = car.outputs
        log.append(np.array([outputs[name] for name in MEASURED]))
        car.step(guard(k, log[-1]), 20, CONTROL_PERIOD / 20)
    short = pd.DataFrame(log, columns=MEASURED).assign(**guard.guided())
    other, guard = ExudynCar(vehicle, rails, speed, law), _Guard(case, series, vehicle)
    theirs = other.run(guard, len(series), case.step).assign(**guard.guided())
    return {"exudyn": theirs, "1": series[[*MEASURED, *GUIDED]].reset_index(drop=True), "0.05": short}


def compare(name: str, runs: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Compare the two cars in the runs of `replay`, for each quantity on its worst running gear or wheel. `largest` is
    the largest value of the project's signal, `difference` the largest difference, `relative` their ratio, `beyond` the
    share of samples that differ by more than `AGREEMENT`, `step_error` the largest difference of the project's own two
    runs over `largest`."""
    rows, theirs = [], _signals(runs["exudyn"])
    steps = {key: _signals(runs[key]) for key in ("1", "0.05")}
    for step, ours in steps.items():
        for (quantity, unit), signals in ours.items():
            size, error = np.abs(signals).max(axis=0), theirs[quantity, unit] - signals
            worst = int(np.argmax(np.abs(error).max(axis=0) / size))
            largest, rms = np.abs(error[:, worst]).max(), np.sqrt(np.mean(error[:, worst] ** 2))
            beyond = np.mean(np.abs(error) > AGREEMENT * size)
            coarse, fine = (run[quantity, unit][:, worst] for run in steps.values())
            own = np.abs(coarse - fine).max() / size[worst]
            rows.append((name, step, quantity, size[worst], largest, largest / size[worst], beyond, rms, own, unit))
    columns = "case car_step_ms quantity largest difference relative beyond rms step_error unit"
    return pd.DataFrame(rows, columns=columns.split())


def _signals(run: pd.DataFrame) -> dict[tuple[str, str], np.ndarray]:
    """(quantity, unit) -> signals of all running gears or wheels, shape (n, 2 or 4)."""
    y, yaw, speed, load = np.split(run[list(MEASURED)].to_numpy(), (2, 4, 8), axis=1)
    signals = {("lateral position", "m"): y, ("yaw angle to the track", "rad"): yaw, ("wheel speed", "rad/s"): speed}
    signals |= {("wheel speed, left - right", "rad/s"): speed[:, ::2] - speed[:, 1::2], ("wheel load", "N"): load}
    return signals | {("differential torque", "N m"): run[list(GUIDED)].to_numpy()}


if __name__ == "__main__":
    table = pd.concat([compare(case.name, replay(case)) for case in tqdm(CASES)], ignore_index=True)
    write(paths.product("data/results/second_opinion.csv"), table.to_csv(index=False, float_format="%.4g"))
    print(table.to_string(index=False, float_format="{:.3g}".format))
