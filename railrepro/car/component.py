"""The car as a component: step it with four motor torques, read named outputs and energies, linearise it. Serves the
paper's section Simulation Environment."""

import copy
import ctypes
import warnings
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple, NoReturn, Self

import casadi as ca
import numpy as np
import pandas as pd

from railrepro.car import equations
from railrepro.car.outputs import DERAILED, Outputs
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import cache, codegen
from railrepro.compile.lanes import lanes_header, pairs_text
from railrepro.contact.table import CELL_COLUMNS, ContactTable, contact_table
from railrepro.data import above, between, require
from railrepro.quantities import names
from railrepro.track.route import CELL, COLUMNS, Route, lay
from railrepro.track.table import load_track
from railrepro.vehicle.parameters import Vehicle, load_vehicle

LARGEST_TORQUE = 1e5
"""Largest magnitude of a torque command (N m); also the largest torque limit in a vehicle file."""
LARGEST_SPEED = 125.0
"""Largest initial speed of a `SteppedCar` (m/s)."""
LARGEST_STATE = 1e7
"""Magnitude of a state (SI) at which `SteppedCar.step` raises an ArithmeticError."""
_LATERAL = equations.indices(*(f"{gear}.y" for gear in equations.GEARS))
ENERGIES = ("mechanical_J", "motor_W", "damping_W", "creep_W")
"""Keys of `SteppedCar.energies`: mechanical energy (J); power of the motors, losses in dampers and by creep (W)."""

_SOURCE = Path(__file__).with_name("car.c").read_text(encoding="utf-8")
_SIZES = {"N_STATE": len(equations.STATES), "N_OUTPUT": len(names(Outputs)), "N_PAR": len(equations.PARAMETERS)}
_SIZES |= {"BODIES": len(equations.BODIES), "WHEELS": len(equations.WHEELS)}
_SIZES |= {"N_CELL": len(COLUMNS), "N_CONTACT": len(CELL_COLUMNS)}
_Car = codegen.structure("car_t", _SOURCE, _SIZES)


@codegen.stored
def _pairs() -> str:
    """Write the C of the functions of the car, with front and rear running gear side by side in vector registers."""
    car = equations.car()
    written = (pairs_text(function, equations.mirrored()) for function in (car.coordinates, car.output, car.step))
    return lanes_header(2) + "".join(written)


def c_text(*more: ca.Function) -> str:
    """Write the C source of the car. It consists of the functions `more`, the functions of the equations of the car,
    and car.c, which calls the equations. `more` are CasADi functions that the caller's own C needs: the FMU passes
    `equations.rest`, which makes the initial state."""
    return codegen.source_text(more) + _pairs() + codegen.PREAMBLE + codegen.defines(_SIZES) + _SOURCE


def compile_ahead() -> None:
    """Start to compile the car in a thread, unless it is loaded already, so that the first `SteppedCar` waits less."""
    if not library.cache_info().currsize:
        cache.build_ahead(c_text())


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """Load the shared object with the functions of car.c, compiled or from the cache."""
    return ctypes.CDLL(str(cache.build(c_text())))


class Linearisation(NamedTuple):
    """Linear model dx/dt = A x + B u, y = C x + D u of deviations from an operating point (SI). Rows and columns are
    labelled by the states `Car.states` (x), torque commands `equations.WHEELS` (u) and outputs `Car.outputs` (y)."""

    a: pd.DataFrame
    b: pd.DataFrame
    c: pd.DataFrame
    d: pd.DataFrame


class SteppedCar:
    """The multibody car on a route, which the caller steps forward in time.

    Args:
        route (Route or str): Route, or the name of a track in data/tracks.toml, laid without irregularities.
        speed (float): Initial speed (m/s), above 0 up to 125.
        vehicle (Vehicle, optional): Parameters of the car; default data/vehicle.toml.
        good, poor (str): Adhesion sets of the rail and of its slippery stretches: keys of `vehicle.adhesion`.
        table (ContactTable, optional): Contact of wheel and rail; default the table of `vehicle.contact.profile`.
        substeps (int): Integration steps per millisecond in a `ClosedLoop`; `step` ignores it. On irregular rails one
            step overestimates the largest unloading of a wheel below 20 Hz by up to 1.3 %, two by 0.1 %.

    Attributes:
        model (Car): Equations of the car, with the names of states and outputs.
        route, table (Route, ContactTable): Track and contact table of the car, read only.
        state (ndarray, shape (len(model.states),)): Present state (SI), each entry up to 1e7 in magnitude.
        torque (ndarray, shape (4,)): Torque commands in the order of `equations.WHEELS` (N m), traction-positive, each
            up to 1e5 in magnitude.
        parameters (ndarray): Parameters of car, rail adhesion and gravity (SI) in the order of `equations.PARAMETERS`.
        measured (ndarray, shape (len(model.outputs),)): Values of `model.outputs` at the last call of `measure` (SI).
        c (ctypes.Structure): The struct `car_t` of car.c, which holds the arrays.
        time (float): Simulated time (s).
        left_rail (str): Sentence that says which running gear derailed first, when and where; "" while none has.

    The arrays `state`, `torque` and `parameters` are memory of the compiled car. Write to their entries, or assign all
    at once (`car.state = values`). `copy.copy(car)` is a second car in the same state that moves independently.

    InputError if an argument, or an array that is assigned, has a wrong type, name or shape or is out of range.
    """

    state = codegen.in_c("state", LARGEST_STATE)
    torque = codegen.in_c("torque", LARGEST_TORQUE)
    parameters = codegen.in_c("parameters")
    route = property(lambda self: self._route)
    table = property(lambda self: self._table)

    def __init__(
        self,
        route: Route | str,
        speed: float,
        vehicle: Vehicle | None = None,
        good: str = "dry",
        poor: str = "poor",
        table: ContactTable | None = None,
        substeps: int = 1,
    ):
        vehicle = load_vehicle() if vehicle is None else vehicle
        self._route = lay(load_track(route)) if isinstance(route, str) else route
        require("route", self.route, Route)
        require("vehicle", vehicle, Vehicle)
        self._table = contact_table(vehicle.contact.profile, vehicle) if table is None else table
        require("table", self.table, ContactTable)
        require("speed", speed, above(0.0, LARGEST_SPEED, "m/s"))
        require("substeps", substeps, between(1, 10_000), whole=True)
        parameters = equations.parameter_vector(vehicle, good, poor)
        self.time, self.left_rail, self.model, self._library = 0.0, "", equations.car(), library()
        track, profile = self.route.cells, self.table.cells()
        self._tables = track, profile  # C has their addresses
        of_car = _Car(
            period=CONTROL_PERIOD / substeps,
            substeps=substeps,
            track=track.ctypes.data,
            track_start=self.route.start,
            track_step=CELL,
            track_cells=len(track),
            profile=profile.ctypes.data,
            profile_start=profile[0, CELL_COLUMNS.index("shift")],
            profile_step=profile[0, CELL_COLUMNS.index("width")],
            profile_cells=len(profile),
        )
        self._hold(of_car)
        self.parameters = parameters
        self.state = equations.rest(self.table)(parameters, speed).nonzeros()
        self.look_up()

    def _hold(self, of_car: ctypes.Structure) -> None:
        """Use a struct `car_t` as the memory of this car."""
        self.c, self._pointer, self._arrays = of_car, ctypes.byref(of_car), codegen.arrays(of_car)
        self.measured = self._arrays["measured"]

    def __copy__(self) -> Self:
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        other._hold(_Car.from_buffer_copy(self.c))
        return other

    def __deepcopy__(self, _memo: dict) -> Self:
        return copy.copy(self)  # the tables and the library that both use do not change

    def __reduce__(self) -> NoReturn:
        raise TypeError("a SteppedCar cannot be pickled: send its route, speed and vehicle, and make it there")

    def look_up(self) -> None:
        """Update track data and contact geometry to the present `state`. Call it after you wrote to `state`."""
        for _ in range(2):  # contact cells depend on the irregularities in the track cells
            self._library.car_look_up(self._pointer)

    def measure(self) -> np.ndarray:
        """Evaluate `model.outputs` at the present state (SI) into `measured`, and return this array."""
        self._library.car_measure(self._pointer)
        return self.measured

    def step(self, torque=None, steps: int = 1, period: float = CONTROL_PERIOD) -> None:
        """Integrate the car over `steps` steps of the length `period` (s), above 0 up to 0.01, with constant `torque`
        commands (N m), shape (4,), by default the attribute `torque`. When |y| of a running gear first reaches 30 mm
        (derailment), a warning is issued and the simulation goes on. ArithmeticError if a state is not finite or
        reaches 1e7 (SI); `state` then holds the values before that step. InputError for a wrong argument."""
        require("steps", steps, between(0, np.inf), whole=True)
        require("period", period, above(0.0, 10 * CONTROL_PERIOD, "s"))
        if torque is not None:
            self.torque = torque
        self.c.period = period
        start = self.time
        for done in range(steps):
            self._library.car_look_up(self._pointer)
            self._library.car_next(self._pointer)
            following = self._arrays["next"]
            beyond = ~(np.abs(following) < LARGEST_STATE)
            if beyond.any():
                value = f"{self.model.states[beyond.argmax()]} = {following[beyond.argmax()]:.3g}"
                raise ArithmeticError(f"{value} left all bounds {self._at('front')}")
            self.state[:] = following
            self.time = start + (done + 1) * period
            lateral = np.abs(self.state[_LATERAL])
            if not self.left_rail and lateral.max() >= DERAILED:
                gear = equations.GEARS[lateral.argmax()]
                self.left_rail = f"{gear} gear derailed, |y| = {1e3 * lateral.max():.1f} mm {self._at(gear)}"
                warnings.warn(self.left_rail, stacklevel=2)

    def _at(self, gear: str) -> str:
        return f"at t = {self.time:.3f} s, p = {self.outputs[f'{gear}.p']:.1f} m"

    @property
    def outputs(self) -> dict[str, float]:
        """Outputs at the present state (SI) as a dict: name in `model.outputs`, such as "front.y" -> value."""
        return dict(zip(self.model.outputs, self.measure().tolist(), strict=True))

    @property
    def energies(self) -> dict[str, float]:
        """Energies at the present state as a dict: "mechanical_J", kinetic and potential energy (J); "motor_W", power
        of the motors; "damping_W" and "creep_W", power lost in dampers and by creep (W)."""
        return dict(zip(ENERGIES, np.array(self.model.energy(*self.inputs())).ravel().tolist(), strict=True))

    def inputs(self) -> tuple[np.ndarray, ...]:
        """Return copies of the five arguments of the functions of `Car` at the present state, a tuple of arrays (x, u,
        rows, contacts, par): state; torque commands (N m), shape (4,); a row of the route for each of the 3 bodies,
        shape (len(COLUMNS), 3); a row of the contact table for each wheel, (len(CELL_COLUMNS), 4); parameters."""
        self._library.car_look_up(self._pointer)
        rows, contacts = self._arrays["rows"].T, self._arrays["contacts"].T
        return tuple(a.copy() for a in (self.state, self.torque, rows, contacts, self.parameters))

    def linearise(self) -> Linearisation:
        """Make the `Linearisation` (A, B, C, D) of the car at the present state and torques, with the rows of route and
        contact table that apply there."""
        car, inputs = self.model, self.inputs()
        x, u = ca.SX.sym("x", len(car.states)), ca.SX.sym("u", len(equations.WHEELS))
        results = car.rate(x, u, *inputs[2:]), car.output(x, u, *inputs[2:])
        jacobians = [ca.jacobian(result, variable) for result, variable in product(results, (x, u))]
        matrices = ca.Function("linear", [x, u], jacobians)(*inputs[:2])
        labels = product((car.states, car.outputs), (car.states, equations.WHEELS))
        tables = zip(matrices, labels, strict=True)
        return Linearisation(*(pd.DataFrame(m.full(), list(row), list(column)) for m, (row, column) in tables))
