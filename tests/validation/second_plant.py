"""The project's controllers on the independent car in Exudyn, on S1002 wheels, in closed loop.

As a script it drives both cars through the scenarios of Figs. 6 to 9 under the paper's controllers with the tuned sets
of the setting `paper`, probes both for the statements, and writes data/results/second_plant.csv and
second_plant_verdicts.csv (half an hour, group `bench`). The 1 kHz law with allocation and adhesion law is the
project's; bodies, integrator, rails, contact and creep are not (`exudyn_car`). Serves the paper's section Multi-Body
Simulation Results."""

import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from unittest import mock

import exudyn_car
import numpy as np
import pandas as pd
from tqdm import tqdm

from railrepro import paths
from railrepro.car.component import DERAILED
from railrepro.clock import CONTROL_PERIOD
from railrepro.control import interface, lateral, law
from railrepro.control.registry import CONTROLLERS, PAPER_TRIO, tuned
from railrepro.data import write
from railrepro.evidence.claims import probe, statements
from railrepro.evidence.claims.setup import setup
from railrepro.quantities import indices, pack
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.studies import store
from railrepro.track.alignment import alignments
from railrepro.track.route import Route
from railrepro.vehicle.parameters import Vehicle, load_vehicle

SCENARIOS = ("curve_entry_T2", "curve_entry_T3", "curve_entry_T4", "sine_tracking", "adhesion_loss", "braking")
PARTS = ("curve", "curves", "sine", "loss")  # of the probe; its sweeps of braking would take hours
SLOWEST = 36.0  # to which both cars brake (km/h): explicit steps of Exudyn are too long for creep below some 28 km/h


def run(
    scenario: Scenario, guidance, *, vehicle: Vehicle | None = None, plant_vehicle: Vehicle | None = None,
    adhesion=None, fixed_share: float = 0.0, substeps: int = 1, route: Route | None = None, **others,
) -> simulate.Run:  # fmt: skip
    """`simulate.run` with the second car: ideal rails, perfect measurements."""
    assert not any(others.values()), others
    vehicle = vehicle or load_vehicle()
    body, way = plant_vehicle or vehicle, route or scenario.route()
    lateral_law, factory = lateral.split(guidance)
    limits = {"lateral_limit": DERAILED, "track_end": way.length, "stop_speed": scenario.stop_speed}
    control = law.control_law(vehicle, lateral_law, adhesion, fixed_share, **limits)
    function = law.function(control.signature)
    planners = [factory(vehicle, way, gear) for gear in range(2)] if factory else []
    every = round(planners[0].period / CONTROL_PERIOD) if planners else 1
    memory, held, records, ended = np.zeros(len(control.signature.memory)), np.zeros(2), [], "time limit reached"
    of_memory, measured = indices(control.signature.Memory), indices(interface.Measured)
    base = [gear.u for gear in (of_memory.front, of_memory.rear)]
    gears = np.array([pack(measured.front), pack(measured.rear)])
    order = [exudyn_car.OBSERVED.index(name) for name in interface.MEASURED]

    def cycle(k: int, observed: np.ndarray) -> np.ndarray | None:
        nonlocal ended
        values = observed[order]
        if k % every == 0:
            for g, planner in enumerate(planners):
                held[g] = planner.plan(values[gears[g]], memory[base[g]])
        inputs = values, way.rows_at(values[gears[:, 0]]).T, held, control.gains, memory
        torque, memory[:], record, margins = (np.array(found).ravel() for found in function(*inputs))
        records.append(record)
        if (margins > 0).all():
            return torque
        ended = min(zip(margins, interface.MARGINS, strict=True))[1]
        return None

    rails = exudyn_car.Rails(alignments()[scenario.track])
    rail = scenario.poor if scenario.poor_share else scenario.good
    creep = partial(exudyn_car.creep, rail=rail)
    car = exudyn_car.ExudynCar(body, rails, scenario.speed, creep, exudyn_car.s1002())
    longest = max(10.0, 10.0 * way.length / scenario.speed)
    series = car.run(cycle, round(longest / CONTROL_PERIOD)).iloc[: len(records)]
    series = series.join(pd.DataFrame(records, columns=control.signature.record))
    series = series.assign(**{"front.rail_y": 0.0, "rear.rail_y": 0.0})
    series.insert(0, "t_s", np.arange(len(series)) * CONTROL_PERIOD)
    return simulate.Run(series, ended, ended.endswith("lateral"), (), tuple(planners))


PLANTS = {"project": simulate.run, "exudyn": run}


def driven(task: tuple[str, str, str]) -> dict:
    """Drive a scenario with a controller on a plant; the row of second_plant.csv."""
    name, controller, plant = task
    scenario = load_scenario(name)
    if scenario.stop_kmh is not None:
        scenario = scenario.but(stop_kmh=SLOWEST)
    series = PLANTS[plant](scenario, tuned(controller, CONTROLLERS[controller].quick)).series
    row = {"scenario": name, "controller": controller, "plant": plant, "rmse_mm": 1e3 * metrics.rmse(series)}
    row |= {"delay_m": metrics.delay(series), "effort_Nm": metrics.effort(series)}
    return row | {"way_m": metrics.stopping_distance(series), "flange": metrics.reaches_flange(series)}


def probed(task: tuple[str, str]) -> list[tuple]:
    """Run a part of the probe on one of the plants: rows (plant, scenario, controller, metric, value)."""
    part, plant = task
    with mock.patch.dict(os.environ, {store.FOLDER: "off"}), mock.patch.object(simulate, "run", PLANTS[plant]):
        found = probe.probe(setup({}), (part,))
    return [(plant, *key, value) for key, value in found.items()]


def verdicts(rows: list[tuple]) -> pd.DataFrame:
    """Judge the statements that the probes of both plants decide: columns id, statement, project, exudyn."""
    found = {}
    for plant in PLANTS:
        metrics_of = {tuple(key): value for of, *key, value in rows if of == plant}
        found[plant] = statements.findings(statements.Evidence(metrics_of))
    judged = []
    for identity, rule in statements.load().items():
        if all(identity in found[plant] for plant in PLANTS):
            verdict = {plant: rule.judge(found[plant][identity]) for plant in PLANTS}
            judged.append({"id": identity, "statement": rule.statement} | verdict)
    return pd.DataFrame(judged)


if __name__ == "__main__":
    tasks, parts = [*product(SCENARIOS, PAPER_TRIO, PLANTS)], [*product(PARTS, PLANTS)]
    with ProcessPoolExecutor() as pool:
        table = pd.DataFrame(tqdm(pool.map(driven, tasks), "runs", len(tasks)))
        rows = [row for rows in tqdm(pool.map(probed, parts), "probes", len(parts)) for row in rows]
    for name, found in {"second_plant": table, "second_plant_verdicts": verdicts(rows)}.items():
        write(paths.product(f"data/results/{name}.csv"), found.to_csv(index=False, float_format="%.5g"))
        print(found.to_string(index=False))
