"""Setup of a probe, the runs that judge the statements: car, controllers and choices of experiments, by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Self

from railrepro.control.registry import LOOP, PAPER, PAPER_TRIO, guidance, with_r_times
from railrepro.data import InputError, above, require
from railrepro.evidence.claims.statements import BRAKE, MPC, NDI, T3
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.studies.world import World
from railrepro.track.alignment import Alignment, alignments
from railrepro.tuning import sets
from railrepro.tuning.task import triple_pole


@dataclass(frozen=True)
class ProbeSetup(World):
    """Car, controllers and sensors (a `World`) with the choices of the experiments that the paper leaves open.

    Attributes:
        amplitude_mm, period_start_m, period_end_m (float): Set point of Fig. 6: amplitude, first and last period.
        clothoid_factor (float): Factor on the length of the clothoid of T3 (-).
        r_loss, r_brake (float): Factors on the weight R of NMPC in Fig. 8 and in Fig. 9 (-).
        r_second (float): Further factor on R for the second NMPC of Fig. 9 (-).
        brake_sweep (dict): Changed fields of the set point of Fig. 9, as {"period_end_m": 30.0}.
        ltv (str): Controller that stands for LTV-MPC: "ltv_mpc_printed", as in the paper without the affine term of
            the linear model, or "ltv_mpc" with it.
    """

    amplitude_mm: float = 3.0
    period_start_m: float = 150.0
    period_end_m: float = 40.0
    clothoid_factor: float = 1.0
    r_second: float = 10.0
    r_loss: float = 1.0
    r_brake: float = 1.0
    brake_sweep: dict = field(default_factory=dict)
    ltv: str = "ltv_mpc_printed"

    def __post_init__(self) -> None:
        for name in ("clothoid_factor", "r_second", "r_loss", "r_brake"):
            require(f"ProbeSetup: {name}", getattr(self, name), above(0.0, 1e6))
        if self.ltv not in (allowed := (MPC[1], "ltv_mpc")):
            raise InputError(f"ltv is {self.ltv!r}, one of {allowed} is needed")

    def checked(self) -> Self:
        """Return this setup; InputError if car, controllers or scenarios refuse one of its values."""
        self.car(), self.scenario(T3), self.scenario(BRAKE)
        for name, parameters in self.parameters.items():
            guidance(name, parameters)
        return self

    def driver(self, controller: str) -> str:
        """Map a controller of the statements to its key in `registry.CONTROLLERS`: itself, `self.ltv` for LTV-MPC."""
        return self.ltv if controller == MPC[1] else controller

    def scenario(self, name: str) -> Scenario:
        """Load a scenario of data/scenarios.toml by name; Figs. 6 and 9 get the set points of this setup."""
        base = load_scenario(name)
        sweep = {key: getattr(self, key) for key in ("amplitude_mm", "period_start_m", "period_end_m")}
        chosen = {T3: sweep, BRAKE: self.brake_sweep}.get(name, {})
        return base.but(set_point=base.set_point | chosen)

    def stretched(self) -> Alignment | None:
        """Track T3, the length of its clothoid multiplied by `clothoid_factor`; None when the factor is 1."""
        if self.clothoid_factor == 1.0:
            return None
        straight, clothoid, *rest = alignments()["T3"].segments
        clothoid = replace(clothoid, length=clothoid.length * self.clothoid_factor)
        return replace(alignments()["T3"], segments=(straight, clothoid, *rest))


SWARM = "swarm"
COLUMNS = (PAPER, SWARM, LOOP)
"""Columns of verdicts, by how controllers are tuned and run: "paper" (exact measurements), "swarm" (the same, but NDI
has the poles that a particle swarm found, not the fastest within the stability margin), "loop" (sensors)."""
LTV_R, POLE, PROFILE, SWEEP = "ltv_mpc_printed.r", "ndi.pole", "profile", "brake_sweep"
_CHOICES = {one.name for one in fields(ProbeSetup)} - {one.name for one in fields(World)}
"""Fields of `ProbeSetup` that may be keys of the argument `values` of `setup`."""


def setting_of(column: str) -> str:
    """Return under which name, "paper" (exact measurements) or "loop" (sensors), the tuned parameters of a `column` of
    verdicts are stored: the column itself, but "paper" for "swarm", which differs from it only by the poles of NDI."""
    return PAPER if column == SWARM else column


def setup(values: Mapping[str, Any], column: str = PAPER, *, rank: int = 0, seed: int | None = None) -> ProbeSetup:
    """Make a `ProbeSetup`, with which `probe` simulates the runs that judge the statements: the nominal car, that of
    data/vehicle.toml not fitted to the statements, and its tuned controllers, with changed values by name.

    Args:
        values (mapping): Keys: attributes of `ProbeSetup`, as "r_loss" (factor on the weight R of NMPC in Fig. 8);
            "profile" (wheels of the simulated car, unknown to its controllers); "brake_sweep:FIELD", as
            "brake_sweep:period_end_m" (set point of Fig. 9); "CONTROLLER:PARAMETER", as "nmpc:r"; "ndi.pole" (triple
            pole, rad/s); "ltv_mpc_printed.r" (LTV-MPC has the weights of NMPC, but R times this value); parameters of
            the vehicle, as "wheel.radius".
        column (str): How controllers are tuned and run: "paper" (exact measurements), "swarm" (the same, but poles of
            NDI by particle swarm) or "loop" (sensors).
        rank (int): 0 for the final parameters, n for those of the tuning run of (n + 1)th lowest cost, if there is one.
        seed (int, optional): Seed of the sensors with "loop". Without it, and otherwise, controllers get true signals.

    InputError for an unknown key or column, or unless each factor (clothoid_factor, r_loss, r_brake, r_second,
    ltv_mpc_printed.r) is above 0 and at most 1e6. `ProbeSetup.checked` checks other values and the names of parameters.
    """
    require("column", column, str)
    if column not in COLUMNS:
        raise InputError(f"column {column!r} is not known; there are {list(COLUMNS)}")
    parameters, rest = {name: _tuned(name, column, rank) for name in PAPER_TRIO}, dict(values)
    if LTV_R in rest:
        require(LTV_R, rest[LTV_R], above(0.0, 1e6))
        parameters[MPC[1]] = with_r_times(parameters["nmpc"], rest.pop(LTV_R))
    if POLE in rest:
        parameters[NDI] = triple_pole(rest.pop(POLE))
    profile, sweep = rest.pop(PROFILE, ""), rest.pop(SWEEP, {})
    require(SWEEP, sweep, dict)
    choices: dict[str, Any] = {SWEEP: dict(sweep)}
    vehicle: dict[str, Any] = {}
    parts = parameters | choices
    for name, value in rest.items():
        part, colon, key = name.partition(":")
        if name in _CHOICES:
            choices[name] = value
        elif colon and part in parts:
            parts[part][key] = value
        elif "." in name and not colon:
            vehicle[name] = value
        else:
            raise InputError(f"{name!r} is no choice of the probe and no parameter of a controller or of the vehicle")
    plant = {"contact.profile": profile} if profile else {}
    sensors = {"seed": seed} if seed is not None and column == LOOP else {}
    return ProbeSetup(parameters, setting_of(column), vehicle, plant, sensors, **choices)


def _tuned(controller: str, column: str, rank: int) -> dict[str, Any]:
    by_swarm = f"{controller}_swarm" if column == SWARM and controller == NDI else controller
    tuned = sets.load(by_swarm, setting_of(column))
    swarms = sorted(tuned.get("swarms", []), key=lambda swarm: swarm["cost"])
    return dict(swarms[rank]["parameters"] if 0 < rank < len(swarms) else tuned["parameters"])
