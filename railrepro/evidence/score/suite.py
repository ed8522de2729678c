"""The runs of the benchmark: what is driven, in which setting, and what a seed draws.

A seed draws noise and biases of the sensors, irregularities, and the car that differs from the one the controller
believes in. The published table uses `SEED`; another seed tells whether a controller was fitted to that draw.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from railrepro.evidence.runs.tuning import EQUAL, LOOP
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.vehicle.parameters import sample_ranges

SEED = 1001
"""Seed of the published table; tuning and the notebooks use others."""
JUDGED_ON = (EQUAL, LOOP)
"""Setting of the benchmark."""
MISMATCH = ("body.mass", "gear.mass", "gear.inertia_z", "wheel.spin_inertia", "wheel.cone_angle", "suspension.k_x")
MISMATCH += ("suspension.c_x", "suspension.k_y", "drive.lag")
"""Parameters that the car has and its controller does not know, drawn over the ranges of data/vehicle.toml."""
_PATCH = ((0.0, 0.0), (299.5, 0.0), (300.5, 1.0), (499.5, 1.0), (500.5, 0.0))
_CURVES = {"T1": 200.0, "T2": 600.0, "T3": 600.0, "T4": 700.0}
_SINE = {100: 400.0, 250: 600.0, 400: 800.0}
QUICK = ("curve_T3", "braking_patch")
"""Runs of a small suite."""


@dataclass(frozen=True)
class Case:
    """One run in some setting.

    Attributes
    ----------
    name, setting : str
    scenario : Scenario
    irregular, plant, sensors : dict
        As `experiment.Experiment` has them.
    """

    name: str
    setting: str
    scenario: Scenario
    irregular: dict = field(default_factory=dict)
    plant: dict = field(default_factory=dict)
    sensors: dict = field(default_factory=dict)


def cases(seed: int = SEED, names: tuple[str, ...] | None = None) -> list[Case]:
    """All runs of the suite, or those of some names."""
    found = []
    for setting in JUDGED_ON:
        sensors = {"seed": seed} if setting == LOOP else {}
        found += [
            Case(name, setting, *run, sensors) for name, run in _runs(seed).items() if names is None or name in names
        ]
    return found


def mismatch(seed: int, number: int) -> dict[str, float]:
    """A car within the ranges of the parameters `MISMATCH`."""
    ranges = sample_ranges()
    draw = np.random.default_rng((seed, number)).random(len(MISMATCH))
    return {
        name: low + float(u) * (high - low)
        for name, u in zip(MISMATCH, draw, strict=True)
        for low, high in [ranges[name]]
    }


def _runs(seed: int) -> dict[str, tuple[Scenario, dict, dict]]:
    """Scenario, irregularities and unknown changes of the car, by name."""
    curves = {name: load_scenario(f"curve_entry_{name}") for name in _CURVES}
    runs = {f"curve_{name}": (curves[name].but(end_m=end), {}, {}) for name, end in _CURVES.items()}
    sine = load_scenario("sine_tracking")
    runs |= {f"sine_{v}": (sine.but(speed_kmh=float(v), end_m=end), {}, {}) for v, end in _SINE.items()}
    pulled = sine.but(track="T3", speed_kmh=280.0, end_m=600.0, force_kN=((0.0, 17.0),))
    runs["loss_one_side"] = pulled.but(poor_share_left=_PATCH), {}, {}
    runs["loss_both_sides"] = pulled.but(poor_share=_PATCH), {}, {}
    runs["braking_patch"] = load_scenario("braking").but(poor_share=_PATCH, end_m=1450.0), {}, {}
    curve = curves["T3"].but(end_m=500.0)
    runs["irregular"] = curve, {"spectrum": "en_B_300", "seed": seed}, {}
    runs["s1002"] = curve, {}, {"contact.profile": "s1002"}
    runs |= {f"mismatch_{k}": (curve, {}, mismatch(seed, k)) for k in (1, 2)}
    return runs
