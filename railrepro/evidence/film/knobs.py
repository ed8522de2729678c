"""NMPC and NDI on one scenario with a few numbers to turn: weight, horizon, poles, speed, friction, delay.

Serves the notebook in which one plays with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pandas as pd

from railrepro.clock import EXCHANGE_PERIOD
from railrepro.control import lateral
from railrepro.control.registry import guidance, with_r_times
from railrepro.errors import InputError
from railrepro.estimation.sensors import LONGEST, late
from railrepro.evidence.runs import tuning
from railrepro.schema import above, between, require
from railrepro.simulation import metrics, simulate
from railrepro.simulation.scenarios import Scenario
from railrepro.vehicle.parameters import load_vehicle

CONTROLLERS = ("nmpc", "ndi")


@dataclass(frozen=True)
class Parameters:
    """What is turned; 1 and None leave a number as it was tuned, or as the scenario has it.

    Attributes
    ----------
    r, horizon, poles : float
        Factors on R and on the horizon of NMPC and on the poles of NDI (-).
    speed_kmh : float or None
    friction : float or None
        Coefficient of friction at rest (-), between those of the scenario's poor and good rail; it mixes both.
    delay_ms : float
        Time by which the differential torque acts later (ms).

    Raises
    ------
    InputError
        When a number is beyond its range.
    """

    r: float = 1.0
    horizon: float = 1.0
    poles: float = 1.0
    speed_kmh: float | None = None
    friction: float | None = None
    delay_ms: float = 0.0

    def __post_init__(self):
        for name, largest in (("r", 1e6), ("horizon", 10.0), ("poles", 10.0)):
            require(f"parameter {name}", getattr(self, name), above(0.0, largest))
        require("parameter delay_ms", self.delay_ms, between(0.0, 1e3 * LONGEST * EXCHANGE_PERIOD, "ms"))

    def scenario(self, scenario: Scenario) -> Scenario:
        """A scenario with this speed and friction."""
        require("scenario", scenario, Scenario)
        changes: dict = {} if self.speed_kmh is None else {"speed_kmh": self.speed_kmh}
        if self.friction is not None:
            adhesion = load_vehicle().adhesion
            low, high = adhesion[scenario.poor].mu0, adhesion[scenario.good].mu0
            require("parameter friction", self.friction, between(low, high))
            changes["poor_share"] = [[0, (high - self.friction) / (high - low)]]
        return scenario.but(**changes)

    def parameters(self, controller: str, setting: str) -> dict:
        """Tuned parameters of NMPC or NDI with the factors."""
        tuned = tuning.load(controller, setting)["parameters"]
        if controller == "nmpc":
            return with_r_times(tuned, self.r) | {"horizon_s": self.horizon * tuned["horizon_s"]}
        if controller == "ndi":
            return tuned | {name: self.poles * tuned[name] for name in ("pole", "frequency")}
        raise InputError(f"controller {controller!r} has no parameters here; there are {list(CONTROLLERS)}")


def turned(scenario: Scenario, knobs: Parameters, setting: str = tuning.EQUAL) -> dict[str, simulate.Run]:
    """Runs of `CONTROLLERS` with the parameters as they are set."""
    require("knobs", knobs, Parameters)
    driven = knobs.scenario(scenario)
    laws = {name: guidance(name, knobs.parameters(name, setting)) for name in CONTROLLERS}
    return {name: simulate.run(driven, delayed(law, 1e-3 * knobs.delay_ms)) for name, law in laws.items()}


def table(runs: dict[str, simulate.Run]) -> pd.DataFrame:
    """How the runs went: error, delay and torque of the front gear, or where a run derailed."""
    rows = {}
    for name, run in runs.items():
        followed = not run.failed
        rows[name] = {
            "RMSE of y (mm)": 1e3 * metrics.rmse(run.series) if followed else np.nan,
            "delay (m)": metrics.delay(run.series) if followed else np.nan,
            "torque, RMS (N m)": metrics.effort(run.series) if followed else np.nan,
            "off the rail at (m)": np.nan if followed else run.series["front.p"].iloc[-1],
        }
    return pd.DataFrame(rows).T


class _Late:
    """A 1 kHz law whose torque acts some exchanges later; a `lateral.LateralLaw`."""

    def __init__(self, law: lateral.LateralLaw, seconds: float):
        self._law, self._seconds = law, seconds
        self.memory = (*law.memory, *(f"late.{k}" for k in range(LONGEST)))

    def gains(self) -> dict[str, float]:
        """See `LateralLaw.gains`."""
        return {**self._law.gains(), "late.exchanges": self._seconds / EXCHANGE_PERIOD}

    def torque(self, gear: dict, track_ahead: dict, memory: dict, gain: dict, model: dict) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        du, following = self._law.torque(gear, track_ahead, memory, gain, model)
        line = [du, *(memory[f"late.{k}"] for k in range(LONGEST))]
        return late(line, gain["late.exchanges"]), following | {f"late.{k}": line[k] for k in range(LONGEST)}


class _LateSlow(_Late):
    """The same for a guidance with a slower controller."""

    def __init__(self, law: lateral.LateralLaw, factory: lateral.Factory, seconds: float):
        super().__init__(law, seconds)
        self._factory = factory

    def __call__(self, vehicle, route, gear: int) -> lateral.SlowController:
        return self._factory(vehicle, route, gear)


def delayed(guided: lateral.Guidance, seconds: float) -> lateral.Guidance:
    """A guidance whose differential torque acts later (s), at most `LONGEST` exchanges; nothing else changes."""
    law, factory = lateral.split(guided)
    return _Late(law, seconds) if factory is None else _LateSlow(law, factory, seconds)
