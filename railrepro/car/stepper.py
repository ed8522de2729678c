"""The car on a route, one control cycle at a time: `car.c` over the generated functions.

Serves the paper's section Simulation Environment.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro.car import equations
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.contact.table import ContactTable
from railrepro.track.route import CELL, COLUMNS, INDEX, Route


class _Lookup(ctypes.Structure):
    _fields_ = [
        ("cells", ctypes.c_void_p),
        ("start", ctypes.c_double),
        ("step", ctypes.c_double),
        ("n", ctypes.c_longlong),
        ("width", ctypes.c_longlong),
        ("row", ctypes.c_void_p),
    ]


class _Car(ctypes.Structure):
    _fields_ = [
        *((name, codegen.Call) for name in ("coordinates", "output", "step")),
        ("places", ctypes.c_void_p),
        ("lookups", ctypes.c_void_p),
        ("n_lookups", ctypes.c_longlong),
        ("state", ctypes.c_void_p),
        ("next", ctypes.c_void_p),
        *((name, ctypes.c_longlong) for name in ("n_states", "substeps")),
    ]


def functions() -> tuple[ca.Function, ca.Function, ca.Function]:
    """The functions behind a step: coordinates, output, step."""
    car = equations.car()
    return car.coordinates, car.output, car.step


@codegen.stored
def _generated() -> str:
    """C source of the functions."""
    return codegen.source_text(functions())


def c_text() -> str:
    """Hand-written C around the generated functions."""
    return Path(codegen.__file__).with_name("call.h").read_text() + Path(__file__).with_name("car.c").read_text()


@lru_cache(maxsize=1)
def library() -> ctypes.CDLL:
    """The car as a shared object."""
    loaded = codegen.library(_generated(), c_text())
    loaded.car_run.restype = ctypes.c_longlong
    return loaded


class CarStepper:
    """Buffers of one car on one route, and what advances them.

    Parameters
    ----------
    parameters : array_like
        See `equations.parameter_vector`.
    table : ContactTable
        Wheel-rail contact.
    route : Route
    state : array_like
        Initial state.
    substeps : int
        Steps in a control cycle. One is enough for the motion and for ideal rails. On irregular rails it overestimates
        the largest unloading of a wheel below 20 Hz by up to 1.3 %, two steps by 0.1 %.

    Attributes
    ----------
    model : Car
        The equations behind it.
    state, next_state : ndarray, shape (len(model.states),)
        Plant state; `state` is writable.
    torque : ndarray, shape (4,)
        Motor torque commands of `equations.WHEELS`, traction-positive (N m); writable.
    period : ndarray, shape (1,)
        Time of a step (s); writable.
    rows : ndarray, shape (3, len(route.COLUMNS))
        Track cells of `equations.BODIES`.
    contacts : ndarray, shape (4, len(CELL_COLUMNS))
        Contact cells of `equations.WHEELS`.
    outputs : ndarray
        Values of `model.outputs` as last measured.
    functions : dict
        The functions on these buffers by name: coordinates, output, step.
    pointer : ctypes pointer
        The car for the functions of `car.c`.
    """

    def __init__(self, parameters, table: ContactTable, route: Route, state, substeps: int = 1):
        self.state, self.torque = np.array(state, dtype=float), np.zeros(len(equations.WHEELS))
        self.model, self.substeps = equations.car(), substeps
        self.next_state, self.period = np.zeros_like(self.state), np.array([CONTROL_PERIOD / substeps])
        self.rows = np.zeros((len(equations.BODIES), len(COLUMNS)))
        self.contacts = np.zeros((len(equations.WHEELS), equations.CONTACT_COLUMNS))
        self.parameters = np.array(parameters, dtype=float)
        self._places = np.zeros(len(self.rows) + len(self.contacts))
        self.outputs = np.zeros(len(self.model.outputs))
        self._cells = np.ascontiguousarray(route.cells)
        self._contact_cells, self._contact_grid = table.cells(), (table.start, table.step)
        common = [self.state, self.torque, self.rows.reshape(-1), self.contacts.reshape(-1), self.parameters]
        bindings = {
            "coordinates": ([self.state, self.rows.reshape(-1), self.parameters], [self._places]),
            "output": (common, [self.outputs]),
            "step": ([*common, self.period], [self.next_state, np.zeros_like(self.state)]),
        }
        self._library = library()
        self.functions = {
            name: codegen.CompiledFunction(self._library, getattr(self.model, name), *binding)
            for name, binding in bindings.items()
        }
        self.pointer = ctypes.byref(self._structure())
        for _ in range(2):  # the look-up of contacts uses the irregularities of the rows found before
            self.look_up()

    def _tables(self) -> Iterator[tuple]:
        """Cells, start and step (m) of their grid, and the buffer of the cell, by look-up."""
        for row in self.rows:
            yield self._cells, self._cells[0, INDEX["p"]], CELL, row
        for row in self.contacts:
            yield self._contact_cells, *self._contact_grid, row

    def _structure(self) -> _Car:
        tables = []
        for cells, start, step, row in self._tables():
            tables.append(_Lookup(cells.ctypes.data, start, step, len(cells), cells.shape[1], row.ctypes.data))
        self._lookups = (_Lookup * len(tables))(*tables)
        calls = (function.call for function in self.functions.values())
        places, lookups = self._places.ctypes.data, ctypes.addressof(self._lookups)
        state, following = self.state.ctypes.data, self.next_state.ctypes.data
        return _Car(*calls, places, lookups, len(tables), state, following, self.state.size, self.substeps)

    def c_functions(self) -> tuple[ctypes.c_void_p, ...]:
        """Addresses of `car_measure` and `car_advance` for callers written in C."""
        return tuple(ctypes.cast(f, ctypes.c_void_p) for f in (self._library.car_measure, self._library.car_advance))

    def look_up(self) -> None:
        """Cells of track and contacts at the present state."""
        self._library.car_look_up(self.pointer)

    def measure(self) -> np.ndarray:
        """Outputs at the present state, in the order of `model.outputs`."""
        self.look_up()
        self.functions["output"]()
        return self.outputs

    def run(self, n: int, largest: float) -> int:
        """Up to n steps with the torques held, as long as each state stays below `largest`; how many were taken."""
        return self._library.car_run(self.pointer, ctypes.c_longlong(n), ctypes.c_double(largest))

    def inputs(self) -> tuple[np.ndarray, ...]:
        """Arguments x, u, rows, contacts, par of the functions of the equations at the present state, copied."""
        self.look_up()
        return tuple(a.copy() for a in (self.state, self.torque, self.rows.T, self.contacts.T, self.parameters))
