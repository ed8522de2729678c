"""The runs of the benchmark: scenario, setting, and the random numbers of a seed.

A seed draws noise and biases of the sensors, irregularities, and the car that differs from the one the controller
believes in. For development there is the published seed; the leaderboard ranks by the mean of several others.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Annotated

import casadi as ca
import numpy as np

from railrepro import data, paths
from railrepro.clock import CONTROL_PERIOD
from railrepro.control import lateral
from railrepro.estimation import sensors
from railrepro.evidence.runs.laws import wrapped
from railrepro.evidence.runs.tuning import EQUAL, LOOP, SEED
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.vehicle.parameters import sample_ranges

JUDGED_ON = (EQUAL, LOOP)
"""Setting of the benchmark."""
MISMATCH = ("body.mass", "gear.mass", "gear.inertia_z", "wheel.spin_inertia", "suspension.k_x")
MISMATCH += ("suspension.c_x", "suspension.k_y", "drive.lag")
"""Parameters that the car has and its controller does not know, drawn over the ranges of data/vehicle.toml."""
_PATCH = ((0.0, 0.0), (299.5, 0.0), (300.5, 1.0), (499.5, 1.0), (500.5, 0.0))
_CURVES = {"T1": 200.0, "T2": 600.0, "T3": 600.0, "T4": 700.0}
_SINE = {100: 400.0, 250: 600.0, 400: 800.0}
QUICK = ("curve_T3", "braking_patch")
"""Runs of a small suite."""
MARGINS = "margins"
"""Group of the runs with more delay or a slower drive, which count as one case together."""
_DELAYS, _LAGS = (3, 6, 9, 12), (20, 30, 40, 50)
"""Delay on top of that of the loop and time constant of the drive (ms)."""
_RAILS = {"dry": "sine_tracking", "poor": "adhesion_loss"}
_MARGINS_END = 400.0
LOST, _LARGEST = "lost_cycles", 1e12
"""Memory of `CountedLaw`, and the torque (N m) from which one counts as not finite."""


@data.table
class Draws:
    """Content of data/score.toml."""

    published: SEED
    ranked: Annotated[tuple[SEED, ...], data.NOT_EMPTY, data.DISTINCT]


@lru_cache
def draws() -> Draws:
    """The published seed, and those that the leaderboard ranks by."""
    return data.build(Draws, data.read(paths.source("data/score.toml")), "score.toml")


@dataclass(frozen=True)
class Case:
    """One run in some setting.

    Attributes
    ----------
    name, setting : str
    scenario : Scenario
    irregular, plant, sensors : dict
        As `experiment.Experiment` has them.
    group : str
        Cases of a group count as one.
    delay : float
        Delay of the differential torque where no sensors are, whose inverter has it otherwise (s).
    """

    name: str
    setting: str
    scenario: Scenario
    irregular: dict = field(default_factory=dict)
    plant: dict = field(default_factory=dict)
    sensors: dict = field(default_factory=dict)
    group: str = ""
    delay: float = 0.0


def cases(seed: int, names: tuple[str, ...] | None = None) -> list[Case]:
    """All runs of the suite, or those of some names, then without the margins."""
    found = []
    for setting in JUDGED_ON:
        sensors = {"seed": seed} if setting == LOOP else {}
        found += [
            Case(name, setting, *run, sensors, name)
            for name, run in _runs(seed).items()
            if names is None or name in names
        ]
        if names is None:
            found += _margins(setting, seed)
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


def _margins(setting: str, seed: int) -> list[Case]:
    """Runs at 400 km/h with rising delay and lag; with sensors each has another seed."""
    found = []
    for rail, scenario in _RAILS.items():
        short = load_scenario(scenario).but(end_m=_MARGINS_END)
        changes = [(f"lag_{ms}ms", {"drive.lag": 1e-3 * ms}, 0.0) for ms in _LAGS]
        changes += [(f"delay_{ms}ms", {}, 1e-3 * ms) for ms in _DELAYS]
        found += [
            Case(f"{name}_{rail}", setting, short, plant=plant, group=MARGINS, delay=delay)
            for name, plant, delay in changes
        ]
    if setting == EQUAL:
        return found
    seeds = ({"seed": (seed + 1 + k) % 2**31, "inverter.delay": case.delay} for k, case in enumerate(found))
    return [replace(case, sensors=sensors, delay=0.0) for case, sensors in zip(found, seeds, strict=True)]


class DelayedLaw:
    """A 1 kHz law whose torque acts some control cycles later; a `lateral.LateralLaw`.

    Parameters
    ----------
    law : lateral.LateralLaw
    delay : float
        Up to the largest of the margins (s).
    """

    def __init__(self, law: lateral.LateralLaw, delay: float):
        self._law, self._cycles = law, delay / CONTROL_PERIOD
        self._line = tuple(f"delayed_{k}" for k in range(max(_DELAYS)))
        self.memory = (*getattr(law, "memory", ()), *self._line)

    def gains(self) -> dict[str, float]:
        """See `LateralLaw.gains`."""
        return {**lateral.gains_of(self._law), "delay_ticks": self._cycles}

    def torque(self, q: SimpleNamespace) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        du, following = lateral.answer(self._law, q)
        line = [du, *(getattr(q, name) for name in self._line)]
        return sensors.delayed(line, q.delay_ticks), following | dict(zip(self._line, line[:-1], strict=True))


class CountedLaw:
    """A 1 kHz law that counts in `LOST` how often its torque was not finite, which the torque limit would hide."""

    def __init__(self, law: lateral.LateralLaw):
        self._law = law
        self.memory = (*getattr(law, "memory", ()), LOST)

    def gains(self) -> dict[str, float]:
        """See `LateralLaw.gains`."""
        return lateral.gains_of(self._law)

    def torque(self, q: SimpleNamespace) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        du, following = lateral.answer(self._law, q)
        return du, following | {LOST: getattr(q, LOST) + 1 - (ca.fabs(du) < _LARGEST)}


def delayed(guidance: lateral.Guidance, delay: float) -> lateral.Guidance:
    """A guidance whose torque acts later (s), see `DelayedLaw`."""
    return wrapped(guidance, lambda law: DelayedLaw(law, delay))


def counted(guidance: lateral.Guidance) -> lateral.Guidance:
    """A guidance whose 1 kHz law counts torques that are not finite; InputError when it is no guidance."""
    law, _ = lateral.split(guidance)
    lateral.signature(law)
    return guidance if isinstance(law, lateral.ZeroOrderHold) else wrapped(guidance, CountedLaw)


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
    runs["cone"] = curve, {}, {"contact.profile": "cone"}
    runs |= {f"mismatch_{k}": (curve, {}, mismatch(seed, k)) for k in (1, 2)}
    return runs
