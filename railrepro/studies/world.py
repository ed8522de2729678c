"""A car with its controllers and their sensors: what all runs of one comparison have in common."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from railrepro.control.registry import CONTROLLERS, LOOP, PAPER, parameters
from railrepro.simulation.scenarios import Scenario, load_scenario
from railrepro.studies.experiment import Experiment
from railrepro.vehicle.parameters import Vehicle, load_vehicle


@dataclass(frozen=True)
class World:
    """Car, controllers and sensors from which `experiment` makes runs. `parameters` maps a controller to its tuning
    parameters by name, which were tuned for the `setting` "paper" (exact measurements) or "loop" (sensors). `vehicle`
    and `plant` map dotted names of vehicle parameters to changed values, in `plant` only for the simulated car, unknown
    to its controllers. `sensors` are arguments of `sensors.readings`, {} for none."""

    parameters: dict[str, dict]
    setting: str = PAPER
    vehicle: dict = field(default_factory=dict)
    plant: dict = field(default_factory=dict)
    sensors: dict = field(default_factory=dict)

    def experiment(self, scenario: Scenario, controller: str, parameters: dict | None = None, **more) -> Experiment:
        """Make the `Experiment` of a scenario with a controller (key of `registry.CONTROLLERS`) on this car.
        `parameters`, if not empty, take the place of all tuning parameters of the controller. `more` are further fields
        of `Experiment`; entries of `vehicle` and `plant` are added to those of this `World`."""
        given = {"options": CONTROLLERS[controller].quick, "sensors": self.sensors, "setting": self.setting} | more
        given |= {name: getattr(self, name) | more.get(name, {}) for name in ("vehicle", "plant")}
        given["parameters"] = parameters or self.parameters[controller]
        return Experiment(scenario, self.driver(controller), **given)

    def driver(self, controller: str) -> str:
        """Key of `registry.CONTROLLERS` that `experiment` runs for `controller`: here itself. The subclass `ProbeSetup`
        overrides it: the paper leaves open which linear model LTV-MPC has, so for "ltv_mpc_printed", its name in all
        statements, a probe may run the variant "ltv_mpc"."""
        return controller

    def car(self) -> Vehicle:
        """Vehicle parameters of the simulated car, with the changes of `vehicle` and `plant`."""
        return load_vehicle(**self.vehicle | self.plant)

    def scenario(self, name: str) -> Scenario:
        """Scenario of data/scenarios.toml by name."""
        return load_scenario(name)


def world(controllers: Iterable[str], setting: str = PAPER, seed: int = 101) -> World:
    """Make the `World` of the car of data/vehicle.toml with the controllers tuned in a setting, "paper" (exact
    measurements) or "loop" (sensors, whose noise has the random `seed`)."""
    sets = {name: dict(parameters(name, setting)) for name in controllers}
    return World(sets, setting, sensors={"seed": seed} if setting == LOOP else {})
