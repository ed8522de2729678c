"""The car as a component: step it with four motor torques, read named outputs and energies, linearise it.

For users with controllers and loops of their own; the project's experiments use the compiled loop of
`railrepro.simulation.closed_loop`. Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

import math
import reprlib
import warnings
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pandas as pd

from railrepro.car import equations
from railrepro.car.stepper import CarStepper
from railrepro.clock import CONTROL_PERIOD
from railrepro.contact.table import ContactTable, contact_table
from railrepro.data import InputError, above, between, require
from railrepro.track.route import Route, lay
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import Vehicle, load_vehicle

LARGEST_TORQUE = 1e5
"""Largest torque command that a car takes (N m), the largest limit that a vehicle file may state."""
LARGEST_SPEED = 125.0
"""Largest initial speed (m/s)."""
DERAILED = 0.030
"""Lateral displacement at which a gear derails (m)."""
_LARGEST = 1e7
"""No state of a car that moves grows beyond this (SI)."""
_PLACE = equations.INDEX["front.s"]
_TABLE_COLUMNS = ["shift_m", "effective_radius_m", "angle_rad", "rolling_radius_m", "rail_contact_m", "semi_axis_x_m"]
_TABLE_COLUMNS += ["semi_axis_y_m", "c11", "c22", "c23", "c33", "normal_stiffness"]
_LATERAL = equations.indices(*(f"{gear}.y" for gear in equations.GEARS))
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

    Parameters
    ----------
    route : Route or str
        Or the name of a track.
    speed : float
        Initial speed (m/s).
    vehicle : Vehicle, optional
        Default: data/vehicle.toml.
    good, poor : str
        Adhesion sets of the rail and of its slippery places.
    table : ContactTable, optional
        Wheel-rail contact of all wheels; default that of the vehicle's profile. Its semi-axes hold at the vehicle's
        `contact.nominal_load`.

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
    left_rail, beyond_end : str
        Which gear derailed first, when and where, and that the front gear is beyond the end of the track, one
        sentence each; empty before.

    Raises
    ------
    InputError
        Unknown track or adhesion set, impossible speed, or anything but a route, a vehicle and a contact table.
    """

    def __init__(
        self,
        route: Route | str,
        speed: float,
        vehicle: Vehicle | None = None,
        good: str = "dry",
        poor: str = "poor",
        table: ContactTable | None = None,
    ):
        vehicle = load_vehicle() if vehicle is None else vehicle
        self.route = lay(load_track(route)) if isinstance(route, str) else route
        require("route", self.route, Route)
        require("vehicle", vehicle, Vehicle)
        require("speed", speed, above(0.0, LARGEST_SPEED, "m/s"))
        self.table, self.time = contact_table(vehicle.contact.profile, vehicle) if table is None else table, 0.0
        _require_table(self.table)
        state = equations.rest_state(vehicle, self.table, speed)
        self._car = CarStepper(equations.parameter_vector(vehicle, good, poor), self.table, self.route, state)
        self.state, self.torque, self.parameters = self._car.state, self._car.torque, self._car.parameters
        self.model, self.left_rail, self.beyond_end = self._car.model, "", ""

    def step(self, torque=None, steps: int = 1, period: float = CONTROL_PERIOD) -> None:
        """Advance by some steps with the torques held; one warning when a gear derails.

        Parameters
        ----------
        torque : array_like, shape (4,), optional
            Motor torque commands (N m), at most `LARGEST_TORQUE`; default the last ones.
        steps : int
        period : float
            Length of a step, up to 10 control cycles (s).

        Raises
        ------
        InputError
            An argument that is not of this kind or beyond its range.
        ArithmeticError
            One sentence with time, state and track coordinate when a state is no longer finite or absurdly large;
            `state` is that of the last good step.
        """
        require("steps", steps, between(0, math.inf), whole=True)
        require("period", period, above(0.0, 10 * CONTROL_PERIOD, "s"))
        if torque is not None:
            self.torque[:] = _torques(torque)
        self._car.period[:] = period
        start = self.time
        for done in range(steps):
            if self._car.run(1, _LARGEST):
                self.time = start + (done + 1) * period
                if not self.left_rail:
                    self._tell_derailment()
                if not self.beyond_end and self.state[_PLACE] > self.route.length:
                    self.beyond_end = (
                        f"the car is beyond the end of its track, {self.route.length:g} m, at t = {self.time:.3f} s; "
                        "it goes on as at its last point"
                    )
                    warnings.warn(self.beyond_end, stacklevel=2)
                continue
            new = self._car.next_state
            worst = int(np.argmax(~(np.abs(new) < _LARGEST)))
            raise ArithmeticError(
                f"{self.model.states[worst]} = {new[worst]:.3g} left all bounds after t = {self.time:.3f} s, "
                f"p = {self.outputs['front.p']:.1f} m"
            )

    def _tell_derailment(self) -> None:
        for gear, y in zip(equations.GEARS, self.state[_LATERAL], strict=True):
            if abs(y) >= DERAILED:
                self.left_rail = (
                    f"{gear} gear derailed, |y| = {1e3 * abs(y):.1f} mm at t = {self.time:.3f} s, "
                    f"p = {self.outputs[f'{gear}.p']:.1f} m"
                )
                warnings.warn(self.left_rail, stacklevel=3)
                return

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


def _require_table(table) -> None:
    """Refuse what is no contact table with a uniform grid around zero and finite numbers, with an InputError."""
    require("table", table, ContactTable)
    missing = [name for name in _TABLE_COLUMNS if name not in table.frame]
    if missing:
        raise InputError(f"contact table {table.name}: column {missing[0]} is missing; needed are {_TABLE_COLUMNS}")
    numbers = table.frame[_TABLE_COLUMNS].to_numpy(dtype=float)
    step = np.diff(numbers[:, 0])
    if not np.isfinite(numbers).all() or len(step) == 0 or not np.allclose(step, step[0], rtol=1e-6, atol=0.0):
        raise InputError(f"contact table {table.name}: finite numbers on a uniform grid of shift_m are needed")
    if not numbers[0, 0] < 0.0 < numbers[-1, 0]:
        raise InputError(f"contact table {table.name}: shift_m must reach to both sides of zero")


def _torques(torque) -> np.ndarray:
    """Torque commands as an array; InputError when they are not four numbers within `LARGEST_TORQUE`."""
    try:
        found = np.array(torque)
    except ValueError:  # lists of different length
        found = np.array(None)
    numbers = found.dtype.kind in "iuf" and found.shape == (len(equations.WHEELS),)
    if not numbers or not (np.abs(found) <= LARGEST_TORQUE).all():
        raise InputError(
            f"torque is {reprlib.repr(torque)}, {len(equations.WHEELS)} numbers of at most {LARGEST_TORQUE:g} N m are "
            "needed"
        )
    return found
