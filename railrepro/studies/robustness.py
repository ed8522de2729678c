"""Heavy grids and samples behind the notebooks: stability over speed, friction and tuning; robustness of the verdicts.

`python -m railrepro.studies.robustness [stability] [robustness]` writes data/results/stability_map.csv,
robustness_samples.csv and robustness_claims.csv. Every finished run is kept in build/study, so an interrupted study
goes on where it was. Serves the question what the paper's unpublished parameters decide.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from railrepro import paths
from railrepro.control.registry import CONTROLLERS, EMPHASIS, OURS, PAPER_TRIO, guidance, with_r_times
from railrepro.control.slip import SlipSettings
from railrepro.errors import InputError, told
from railrepro.files import write
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies import tuning
from railrepro.studies.executor import executor, ordered_map
from railrepro.studies.experiment import Experiment
from railrepro.studies.fingerprint import fingerprint
from railrepro.studies.swarm import run_cost
from railrepro.track.alignment import alignments
from railrepro.track.table import build_table, write_table
from railrepro.vehicle.parameters import load_vehicle, sample_ranges

SAMPLES, SEED = 32, 2026
SCENARIOS = ("curve_entry_T3", "sine_tracking", "braking", "adhesion_loss")
"""What the studies drive, in variations."""


def _kept(call: Callable, arguments: Sequence, folder: Path, title: str, quiet: bool = False) -> list[dict]:
    """Evaluate on the executor, one JSON file per finished argument; files of equal arguments are taken as they are."""
    start = [tuning.load(name)["parameters"] for name in PAPER_TRIO]
    here = fingerprint([load_scenario(name) for name in SCENARIOS], load_vehicle(), start)
    files = [folder / f"{hashlib.sha256((here + repr(a)).encode()).hexdigest()[:20]}.json" for a in arguments]
    rows = [_stored(file) for file in files]
    missing = [i for i, row in enumerate(rows) if row is None]
    if missing:
        with executor() as pool:
            tasks = [(call, arguments[i], files[i]) for i in missing]
            for i, row in zip(missing, ordered_map(pool, _keep, tasks, title, quiet), strict=True):
                rows[i] = row
    return rows


def _stored(file: Path) -> dict | None:
    """A finished row; None when there is none, or a broken one."""
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        return kept["row"] if kept["sha256"] == _digest(kept["row"]) else None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _digest(row: dict) -> str:
    return hashlib.sha256(json.dumps(row).encode()).hexdigest()


def _keep(task: tuple[Callable, object, Path]) -> dict:
    call, argument, file = task
    row = json.loads(json.dumps(call(argument)))
    write(file, json.dumps({"row": row, "sha256": _digest(row)}))
    return row


def _row(experiment: Experiment) -> dict:
    names = ("rmse_y", "largest_error", "effort_du", "largest_slip", "utilisation", "failed", "failed_at_m")
    row, _ = experiment()
    return {**experiment.label, **{name: _plain(row.get(name)) for name in names}}


def _plain(value):
    return None if value is None else bool(value) if isinstance(value, bool | np.bool_) else float(value)


def stability(
    speeds_kmh=(100, 200, 300, 400), sets=("dry", "wet", "poor", "very_poor"), factors=(0.1, 1, 10, 100),
    periods_ms=(5, 10, 20), poles=(10, 20, 30, 45, 70), quiet: bool = False,
) -> pd.DataFrame:  # fmt: skip
    """Whether the car stays on the rail: speed, adhesion set, R and sampling time of NMPC, pole of NDI, ours with the
    paper's adhesion law and with slip control; rolling and at the adhesion maximum.

    Returns
    -------
    DataFrame
        speed_kmh, adhesion, drive, controller, r_factor, period_ms, pole, rmse_y, …, failed, failed_at_m.
    """
    tuned = tuning.load("nmpc")["parameters"]
    experiments = []
    for speed, name, drive in product(speeds_kmh, sets, ("rolling", "at the maximum")):
        force = 0.0 if drive == "rolling" else 30.0
        scenario = load_scenario("adhesion_loss").but(
            speed_kmh=float(speed), good=name, poor=name, force_kN=((0.0, force),), end_m=4.5 * speed / 3.6
        )
        label = {"speed_kmh": speed, "adhesion": name, "drive": drive}
        for factor, period in product(factors, periods_ms):
            parameters = with_r_times(tuned, factor) | {"period_ms": period}
            own = label | {"controller": "nmpc", "r_factor": factor, "period_ms": period}
            experiments.append(Experiment(scenario, "nmpc", own, parameters, CONTROLLERS["nmpc"].quick))
        for pole in poles:
            parameters = {"pole": pole, "frequency": pole, "damping": 1.0}
            experiments.append(Experiment(scenario, "ndi", label | {"controller": "ndi", "pole": pole}, parameters))
        for slip in (None, SlipSettings()):
            own = label | {"controller": OURS if slip is None else f"{OURS}_slip"}
            experiments.append(Experiment(scenario, OURS, own, adhesion=slip))
    return pd.DataFrame(_kept(_row, experiments, paths.BUILD / "study" / "stability", "stability", quiet))


@dataclass(frozen=True)
class Sample:
    """One draw of what the paper does not publish."""

    number: int
    vehicle: tuple[tuple[str, float], ...]
    profile: str
    good: str
    variant: str
    amplitude_mm: float
    period_start_m: float
    period_end_m: float
    clothoid_factor: float


def draw(count: int = SAMPLES, seed: int = SEED) -> list[Sample]:
    """Quasi-random samples (scrambled Sobol) over the ranges of vehicle.toml and the open choices of experiments."""
    ranges = {k: v for k, v in sample_ranges().items() if not k.startswith("adhesion.")}
    extra = ("profile", "good", "variant", "amplitude_mm", "period_start_m", "period_end_m", "clothoid_factor")
    points = stats.qmc.Sobol(len(ranges) + len(extra), seed=seed).random(count)
    samples = []
    for number, point in enumerate(points):
        vehicle = tuple((k, lo + u * (hi - lo)) for u, (k, (lo, hi)) in zip(point, ranges.items(), strict=False))
        u = dict(zip(extra, point[len(ranges) :], strict=True))
        samples.append(
            Sample(
                number,
                vehicle,
                "cone" if u["profile"] < 0.5 else "s1002",
                "dry" if u["good"] < 0.5 else "wet",
                "corrected" if u["variant"] < 0.75 else "printed",
                1.0 + 4.0 * u["amplitude_mm"],
                100.0 + 100.0 * u["period_start_m"],
                30.0 + 50.0 * u["period_end_m"],
                0.6 + 0.9 * u["clothoid_factor"],
            )
        )
    return samples


def _curve(sample: Sample, folder: str):
    """Curve entry on T3 with another clothoid and sweep."""
    original = alignments()["T3"]
    straight, clothoid, *rest = original.segments
    clothoid = replace(clothoid, length=clothoid.length * sample.clothoid_factor)
    file = Path(folder) / "T3.csv"
    write_table(build_table(replace(original, segments=(straight, clothoid, *rest))), file)
    base = load_scenario("curve_entry_T3")
    point = base.set_point | {"period_start_m": sample.period_start_m, "period_end_m": sample.period_end_m}
    return base.but(
        track=str(file), end_m=400.0, good=sample.good, set_point=point | {"amplitude_mm": sample.amplitude_mm}
    )


def evaluate(sample: Sample) -> dict:
    """All runs of a sample: a small retuning of each controller, then what the claims need; values in SI."""
    changes = dict(sample.vehicle)
    vehicle, plant = load_vehicle(**changes), load_vehicle(**changes, **{"contact.profile": sample.profile})
    task = tuning.load_task()
    sine = load_scenario("sine_tracking").but(end_m=300.0, good=sample.good)

    def run(scenario, name, parameters):
        variant = {"variant": sample.variant} if CONTROLLERS[name].preview else {}
        law = guidance(name, parameters, CONTROLLERS[name].quick, **variant)
        return simulate.run(scenario, law, vehicle=vehicle, plant_vehicle=plant)

    with tempfile.TemporaryDirectory() as folder:
        curve = _curve(sample, folder)
        row = {"number": sample.number}
        chosen = {}
        for name in PAPER_TRIO:
            base, best = tuning.load(name)["parameters"], np.inf
            preview = CONTROLLERS[name].preview
            scales = (0.1, 1.0, 10.0) if preview else (0.7, 1.0, 1.4)
            for scale in scales:
                keys = ("r",) if preview else ("pole", "frequency")
                parameters = base | {key: base[key] * scale for key in keys}
                runs = {s.name: run(s, name, parameters) for s in (curve, sine)}
                cost = sum(run_cost(runs[s.name], s, task.cost)[0] for s in (curve, sine))
                if cost < best:
                    best, chosen[name] = cost, parameters
                    on_curve, on_sine = runs[curve.name], runs[sine.name]
            row |= {
                f"{name}.curve": metrics.rmse(on_curve.series),
                f"{name}.delay": metrics.delay(on_curve.series),
                f"{name}.drift": float(np.mean(metrics.lateral_error(on_curve.series)[-len(on_curve.series) // 3 :])),
                f"{name}.sine400": metrics.rmse(on_sine.series),
                f"{name}.failed": bool(on_curve.failed or on_sine.failed),
                f"{name}.sine160": metrics.rmse(run(sine.but(speed_kmh=160.0), name, parameters=chosen[name]).series),
            }
        brake = load_scenario("braking").but(speed_kmh=80.0, good=sample.good, end_m=900.0)
        soft = with_r_times(chosen["nmpc"], 100)
        for label, name, parameters in (
            ("ndi", "ndi", chosen["ndi"]),
            ("nmpc", "nmpc", chosen["nmpc"]),
            ("nmpc_soft", "nmpc", soft),
        ):
            done = run(brake, name, parameters)
            row |= {f"brake.{label}.rmse": metrics.rmse(done.series), f"brake.{label}.failed": bool(done.failed)}
            row |= {f"brake.{label}.distance": metrics.stopping_distance(done.series)}
        loss = load_scenario("adhesion_loss").but(end_m=450.0)
        lost = run(loss, "nmpc", with_r_times(chosen["nmpc"], EMPHASIS))  # as in the adhesion notebook
        values = metrics.longitudinal(lost.series, loss, plant)
        row |= {"loss.failed": bool(lost.failed), "loss.slip": values["largest_slip"][0]}
        row |= {"loss.utilisation": values["utilisation"][0]}
        row |= {"loss.error": float(np.abs(metrics.lateral_error(lost.series)).max())}
    return {name: _plain(value) for name, value in row.items()}


def _limits() -> dict[str, float]:
    """Limits of the claims by id, in the units of data/claims.toml, which also judges the nominal results."""
    file = paths.source("data/claims.toml")
    return {identity: claim["tolerance"] for identity, claim in tomllib.loads(file.read_text()).items()}


def _holds(t: pd.DataFrame) -> dict[str, pd.Series]:
    """For each claim that the samples can answer: whether it holds, per sample."""
    limit = _limits()
    n, p, d = (f"{name}." for name in PAPER_TRIO)
    ok = ~t[n + "failed"].astype(bool)
    curve = {name: t[name + "curve"].where(~t[name + "failed"].astype(bool), np.inf) for name in (n, p, d)}
    slope = {name: t[name + "sine400"] - t[name + "sine160"] for name in (n, p, d)}
    stopped = ~(t["brake.nmpc.failed"].astype(bool) | t["brake.nmpc_soft.failed"].astype(bool))
    shorter = t["brake.nmpc_soft.distance"] < t["brake.nmpc.distance"]
    worst = t[["brake.nmpc.rmse", "brake.nmpc_soft.rmse"]].max(axis=1)
    longest = t[["brake.nmpc.distance", "brake.nmpc_soft.distance"]].max(axis=1)
    return {
        "C05": ok & (curve[n] < limit["C05"] * curve[d]) & (curve[p] < limit["C05"] * curve[d]),
        "C06": ok & (curve[n] < limit["C06"] * curve[p]) & (curve[n] < limit["C06"] * curve[d]),
        "C07": ok & (curve[p] > 1.02 * curve[n]),
        "C08": ok & (t[n + "delay"].abs() < limit["C08"]),
        "C11": ok & (1e3 * t[n + "drift"].abs() > limit["C11"]),
        "C17": ok & (t[n + "sine400"] < t[p + "sine400"]) & (t[p + "sine400"] < t[d + "sine400"]),
        "C18": ok & np.logical_and.reduce([slope[name] > 0 for name in slope]),
        "C19": ok & (slope[d] > limit["C19"] * slope[n]) & (slope[d] > limit["C19"] * slope[p]),
        "C20": ok & (t[n + "sine400"] < t[d + "sine400"]) & (t[n + "sine160"] < t[d + "sine160"]),
        "C23": t["loss.slip"] < limit["C23"],
        "C28": ~t["loss.failed"].astype(bool) & (1e3 * t["loss.error"] < limit["C28"]),
        "C30": stopped & shorter & (t["brake.nmpc_soft.rmse"] > t["brake.nmpc.rmse"]),
        "C31": stopped & (worst < limit["C31"] * t["brake.ndi.rmse"]),
        "C32": stopped & (longest - t["brake.ndi.distance"] < limit["C32"]),
    }  # fmt: skip


def verdicts(table: pd.DataFrame, samples: Sequence[Sample]) -> pd.DataFrame:
    """Share of samples in which each claim holds, with Wilson's 95 % interval, and the parameters that decide it."""
    own = [{k: v for k, v in vars(s).items() if k not in ("vehicle", "number")} for s in samples]
    factors = pd.DataFrame([dict(s.vehicle) | o for s, o in zip(samples, own, strict=True)])
    factors = factors.apply(lambda column: pd.factorize(column, sort=True)[0] if column.dtype == object else column)
    rows = []
    for identity, holds in _holds(table).items():
        interval = stats.binomtest(int(holds.sum()), len(holds)).proportion_ci(0.95, "wilson")
        deciding = ""
        if holds.nunique() > 1:
            ranks = factors.apply(lambda column, holds=holds: stats.spearmanr(column, holds.astype(float)).statistic)
            strongest = ranks.abs().sort_values(ascending=False).index[:3]
            threshold = 2.6 / np.sqrt(len(holds))
            deciding = ", ".join(f"{name} {ranks[name]:+.2f}" for name in strongest if abs(ranks[name]) > threshold)
        row = {"id": identity, "share": holds.mean(), "low": interval.low, "high": interval.high}
        rows.append(row | {"samples": len(holds), "decided_by": deciding})
    return pd.DataFrame(rows)


def robustness(count: int = SAMPLES, quiet: bool = False) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Samples and verdicts of the robustness study."""
    samples = draw(count)
    table = pd.DataFrame(_kept(evaluate, samples, paths.BUILD / "study" / "robustness", "robustness", quiet))
    return table, verdicts(table, samples)


def main(names: list[str]) -> None:
    """Run the named studies, or all, and write their tables; a number asks for that many robustness samples."""
    counts = [int(name) for name in names if name.isdigit()]
    names = [name for name in names if not name.isdigit()]
    unknown = set(names) - {"stability", "robustness"}
    if unknown:
        raise InputError(f"study {min(unknown)!r} is not known; there are stability and robustness")
    if "stability" in names or not names:
        write(paths.product("data/results/stability_map.csv"), stability().to_csv(index=False, float_format="%.6g"))
    if "robustness" in names or not names:
        table, found = robustness(*counts)
        write(paths.product("data/results/robustness_samples.csv"), table.to_csv(index=False, float_format="%.6g"))
        write(paths.product("data/results/robustness_claims.csv"), found.to_csv(index=False, float_format="%.4g"))
        print(found.to_string(index=False))


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
