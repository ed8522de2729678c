"""The car as a component: step it with four motor torques, read named outputs and energies, linearise it.

For users with controllers and loops of their own; the project's experiments use `railrepro.simulation.exchange`, which
keeps the control law in the compiled loop. Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pandas as pd

from railrepro.car import equations
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.contact.table import contact_table
from railrepro.simulation import exchange
from railrepro.track import route
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
        States `equations.STATES`, inputs the motor torque commands of `equations.WHEELS`, outputs
        `equations.car().outputs` (SI).
    """

    a: pd.DataFrame
    b: pd.DataFrame
    c: pd.DataFrame
    d: pd.DataFrame


class SteppedCar:
    """The multibody car on a route, advanced by the caller.

    Attributes
    ----------
    state : ndarray, shape (44,)
        See `equations.STATES`; writable.
    torque : ndarray, shape (4,)
        Motor torque commands in the order of `equations.WHEELS`, traction-positive (N m).
    time : float
        Simulated time (s).
    """

    def __init__(self, way: route.Route | str, speed: float, vehicle: Vehicle | None = None, good="dry", poor="poor"):
        vehicle = vehicle or load_vehicle()
        self.way = route.lay(load_track(way)) if isinstance(way, str) else way
        self.table = contact_table(vehicle.contact.profile, vehicle)
        self.parameters = equations.parameter_vector(vehicle, good, poor)
        self.state, self.torque, self.time = equations.rest_state(vehicle, self.table, speed), np.zeros(4), 0.0
        self._contacts = self.table.cells()
        self._rows = self.way.rows_at(self.state[[0, 12, 24]])
        shared = [self.state, self.torque, np.zeros(3 * len(route.COLUMNS)), np.zeros(4 * equations.CONTACT_COLUMNS)]
        shared.append(self.parameters)
        self._shared, self._h = shared, np.zeros(1)
        car = equations.car()
        self._places = np.zeros(7)
        bindings = (
            (car.coordinates, [shared[0], shared[2], shared[4]], [self._places]),
            (car.output, shared, None),
            (car.step, [*shared, self._h], None),
        )
        library = exchange.compiled_car()
        if library is None:
            self._calls = [codegen.InterpretedFunction(*binding) for binding in bindings]
        else:
            self._calls = [codegen.CompiledFunction(library, *binding) for binding in bindings]
        for _ in range(2):
            self._look_up()

    def _look_up(self) -> None:
        self._calls[0]()
        table = self.table
        self._shared[2][:] = self.way.rows_at(self._places[:3]).ravel()
        index = np.clip((self._places[3:] - table.start) / table.step, 0, len(self._contacts) - 1).astype(int)
        self._shared[3][:] = self._contacts[index].ravel()

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
        self._h[:] = period
        for _ in range(exchanges):
            self._look_up()
            new, _ = self._calls[2]()
            if not (np.abs(new) < _LARGEST).all():
                worst = int(np.argmax(~(np.abs(new) < _LARGEST)))
                raise ArithmeticError(
                    f"{equations.STATES[worst]} = {new[worst]:.3g} left all bounds after t = {self.time:.3f} s, "
                    f"p = {self.state[12]:.1f} m"
                )
            self.state[:] = new
            self.time += period

    @property
    def outputs(self) -> dict[str, float]:
        """Positions, wheel loads, creepages, contact forces by name (`equations.car().outputs`, SI)."""
        self._look_up()
        return dict(zip(equations.car().outputs, self._calls[1]()[0].tolist(), strict=True))

    @property
    def energies(self) -> dict[str, float]:
        """Mechanical energy (J), motor power and losses (W), see `ENERGIES`."""
        self._look_up()
        return dict(zip(ENERGIES, np.array(equations.car().energy(*self._inputs())).ravel().tolist(), strict=True))

    def _inputs(self) -> list[np.ndarray]:
        state, torque, rows, contacts, parameters = self._shared
        return [state, torque, rows.reshape(3, -1).T, contacts.reshape(4, -1).T, parameters]

    def linearise(self) -> Linearisation:
        """Linear model about the present state and torques, track and contact cells held."""
        self._look_up()
        car, inputs = equations.car(), self._inputs()
        x, u = ca.SX.sym("x", len(equations.STATES)), ca.SX.sym("u", 4)
        rate, output = car.rate(x, u, *inputs[2:]), car.output(x, u, *inputs[2:])
        jacobians = [ca.jacobian(f, v) for f in (rate, output) for v in (x, u)]
        a, b, c, d = (np.array(m) for m in ca.Function("linear", [x, u], jacobians)(*inputs[:2]))
        states, wheels, outputs = list(equations.STATES), list(equations.WHEELS), list(car.outputs)
        return Linearisation(
            pd.DataFrame(a, states, states),
            pd.DataFrame(b, states, wheels),
            pd.DataFrame(c, outputs, states),
            pd.DataFrame(d, outputs, wheels),
        )
