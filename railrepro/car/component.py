"""The car as a component: step it with four motor torques, read named outputs and energies, linearise it.

For users with controllers and loops of their own; the project's experiments use the compiled loop of
`railrepro.simulation.exchange`. Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pandas as pd

from railrepro.car import equations
from railrepro.car.stepper import CarStepper
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.contact.table import contact_table
from railrepro.track.route import Route, lay
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import Vehicle, load_vehicle

_LARGEST = 1e7
"""No state of a car that moves grows beyond this (SI)."""
ENERGIES = ("mechanical_J", "motor_W", "damping_W", "creep_W")


@dataclass(frozen=True)
class Linearisation:
    """dx = A x + B u, y = C x + D u about an operating point, with named rows and columns.

    Attributes
    ----------
    a, b, c, d : DataFrame
        States and outputs as in `SteppedCar.model`, inputs the motor torque commands of `equations.WHEELS` (SI).
    """

    a: pd.DataFrame
    b: pd.DataFrame
    c: pd.DataFrame
    d: pd.DataFrame


class SteppedCar:
    """The multibody car on a route, advanced by the caller.

    Attributes
    ----------
    model : Car
        The equations, with the names of states and outputs.
    state : ndarray, shape (len(model.states),)
        Writable.
    torque : ndarray, shape (4,)
        Motor torque commands in the order of `equations.WHEELS`, traction-positive (N m).
    time : float
        Simulated time (s).
    """

    def __init__(self, route: Route | str, speed: float, vehicle: Vehicle | None = None, good="dry", poor="poor"):
        vehicle = vehicle or load_vehicle()
        self.route = lay(load_track(route)) if isinstance(route, str) else route
        self.table, self.time = contact_table(vehicle.contact.profile, vehicle), 0.0
        state = equations.rest_state(vehicle, self.table, speed)
        self._car = CarStepper(equations.parameter_vector(vehicle, good, poor), self.table, self.route, state)
        self.state, self.torque, self.parameters = self._car.state, self._car.torque, self._car.parameters
        self.model = self._car.model

    def step(self, torque=None, exchanges: int = 1, period: float = EXCHANGE_PERIOD) -> None:
        """Advance by some exchanges with the torques held.

        Parameters
        ----------
        torque : array_like, shape (4,), optional
            Motor torque commands (N m); default the last ones.
        exchanges : int
        period : float
            Step (s).

        Raises
        ------
        ArithmeticError
            One sentence with time, state and track coordinate when a state is no longer finite or absurdly large;
            `state` is that of the last good exchange.
        """
        if torque is not None:
            self.torque[:] = torque
        self._car.period[:] = period
        done = self._car.run(exchanges, _LARGEST)
        self.time += done * period
        if done < exchanges:
            new = self._car.next_state
            worst = int(np.argmax(~(np.abs(new) < _LARGEST)))
            raise ArithmeticError(
                f"{self.model.states[worst]} = {new[worst]:.3g} left all bounds after t = {self.time:.3f} s, "
                f"p = {self.outputs['front.p']:.1f} m"
            )

    @property
    def outputs(self) -> dict[str, float]:
        """Positions, wheel loads, creepages, contact forces by name (`model.outputs`, SI)."""
        return dict(zip(self.model.outputs, self._car.measure().tolist(), strict=True))

    @property
    def energies(self) -> dict[str, float]:
        """Mechanical energy (J), motor power and losses (W), see `ENERGIES`."""
        return dict(zip(ENERGIES, np.array(self.model.energy(*self.inputs())).ravel().tolist(), strict=True))

    def inputs(self) -> tuple[np.ndarray, ...]:
        """Arguments x, u, rows, contacts, par of the functions of `model` at the present state."""
        return self._car.inputs()

    def linearise(self) -> Linearisation:
        """Linear model about the present state and torques, track and contact cells held."""
        car, inputs = self.model, self.inputs()
        x, u = ca.SX.sym("x", len(car.states)), ca.SX.sym("u", len(equations.WHEELS))
        rate, output = car.rate(x, u, *inputs[2:]), car.output(x, u, *inputs[2:])
        jacobians = [ca.jacobian(f, v) for f in (rate, output) for v in (x, u)]
        a, b, c, d = (np.array(m) for m in ca.Function("linear", [x, u], jacobians)(*inputs[:2]))
        states, wheels, outputs = list(car.states), list(equations.WHEELS), list(car.outputs)
        return Linearisation(
            pd.DataFrame(a, states, states),
            pd.DataFrame(b, states, wheels),
            pd.DataFrame(c, outputs, states),
            pd.DataFrame(d, outputs, wheels),
        )
