"""Plant and fast control law coupled at 1 kHz: one call runs many exchanges.

With a C compiler the loop of `loop.c` runs over generated functions; without one the same loop runs in Python over the
same functions in CasADi's virtual machine, slower, with equal results up to rounding.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np

from railrepro.car import equations
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.compile import codegen
from railrepro.contact.table import ContactTable
from railrepro.control import law
from railrepro.track import route


class _Lookup(ctypes.Structure):
    _fields_ = [
        ("cells", ctypes.c_void_p),
        ("start", ctypes.c_double),
        ("step", ctypes.c_double),
        ("n", ctypes.c_longlong),
        ("width", ctypes.c_longlong),
        ("row", ctypes.c_void_p),
    ]


class _Copy(ctypes.Structure):
    _fields_ = [("to", ctypes.c_void_p), ("from_", ctypes.c_void_p), ("n", ctypes.c_longlong)]


@lru_cache(maxsize=1)
def _functions() -> tuple:
    car = equations.car()
    return car.coordinates, car.output, law.law(), car.step


@lru_cache(maxsize=1)
def compiled_car() -> ctypes.CDLL | None:
    """Car, fast law and loop as one shared object; None without a C compiler."""
    extra = Path(codegen.__file__).with_name("call.h").read_text() + Path(__file__).with_name("loop.c").read_text()
    return codegen.library(_functions(), extra)


class Exchange:
    """The car on a route under the fast law; `run` advances it by whole exchanges of 1 ms.

    Attributes
    ----------
    state : ndarray, shape (44,)
        Plant state, see `equations.STATES`; writable.
    held : ndarray, shape (2,)
        Differential torques of a slower lateral controller, front and rear (N m); writable.
    memory : ndarray
        Memory of the fast law, see `law.MEMORY`.
    columns : tuple of str
        Names of the columns that `run` returns.
    time : float
        Simulated time (s).
    functions : list
        The four functions behind an exchange, on shared buffers: places, outputs, fast law, step.
    """

    def __init__(self, car_parameters, table: ContactTable, way: route.Route, gains, state, compiled: bool = True):
        coordinates, output, fast_law, step = _functions()
        self.columns = (*equations.car().outputs, *law.RECORD)
        self.state, self.held = np.array(state, dtype=float), np.zeros(2)
        self.memory = np.zeros(len(law.MEMORY))
        self.exchanges = 0
        self._par, self._gains = np.array(car_parameters, dtype=float), np.array(gains, dtype=float)
        self._rows, self._contacts = np.zeros((3, len(route.COLUMNS))), np.zeros((4, equations.CONTACT_COLUMNS))
        self._places, self._y = np.zeros(7), np.zeros(len(equations.car().outputs))
        self._command, self._record = np.zeros(4), np.zeros(len(law.RECORD))
        self._margins = np.zeros(fast_law.nnz_out(3))
        self._next_state, self._next_memory = np.zeros_like(self.state), np.zeros_like(self.memory)
        self._error, self._h = np.zeros(len(equations.STATES)), np.array([EXCHANGE_PERIOD])
        self._way = np.ascontiguousarray(way.cells)
        self._table = np.ascontiguousarray(table.cells())
        self._table_grid = (table.start, table.step)
        rows, contacts = self._rows.reshape(-1), self._contacts.reshape(-1)
        common = (self.state, self._command, rows, contacts, self._par)
        bindings = (
            (coordinates, [self.state, rows, self._par], [self._places]),
            (output, list(common), [self._y]),
            (
                fast_law,
                [self._y, rows, self.held, self._gains, self.memory],
                [self._command, self._next_memory, self._record, self._margins],
            ),
            (step, [*common, self._h], [self._next_state, self._error]),
        )
        self._library = compiled_car() if compiled else None
        if self._library is None:
            self.functions = [codegen.InterpretedFunction(*binding) for binding in bindings]
        else:
            self.functions = [codegen.CompiledFunction(self._library, *binding) for binding in bindings]
            self._prepare_loop()
        for _ in range(2):  # the look-up of contacts uses the irregularities of the rows found before
            self._look_up()

    def run(self, n: int) -> np.ndarray:
        """Advance by up to n exchanges.

        Parameters
        ----------
        n : int
            Number of exchanges of 1 ms.

        Returns
        -------
        ndarray, shape (m, len(columns))
            One row per exchange, taken before its step. m = n, or the run ended early: the last row then shows where,
            `ended` is true and `state` is that of the last row.
        """
        rows = np.empty((n, len(self.columns)))
        done = self._run_python(rows) if self._library is None else self._run_compiled(rows)
        self.exchanges += done
        self.ended = done < n
        return rows[: min(done + 1, n)]

    ended = False

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return self.exchanges * EXCHANGE_PERIOD

    @property
    def margins(self) -> np.ndarray:
        """Distance to each limit of the run, `law.law` order: lateral front, lateral rear, track end, speed."""
        return self._margins

    def inputs(self) -> tuple[np.ndarray, ...]:
        """Arguments x, u, rows, contacts, par of the functions of `equations.car()` at the present state."""
        self._look_up()
        return (
            self.state.copy(),
            self._command.copy(),
            self._rows.T.copy(),
            self._contacts.T.copy(),
            self._par.copy(),
        )

    def measure(self) -> np.ndarray:
        """Outputs at the present state, in the order of `equations.car().outputs`."""
        if self._library is None:
            self._look_up()
            self.functions[1]()
        elif self._library.railrepro_measure(*self._surroundings):
            raise ArithmeticError("the outputs of the car could not be evaluated")
        return self._y

    def _tables(self):
        for i in range(3):
            yield self._places[i], self._way, self._way[0, 0], route.CELL, self._rows[i]
        for i in range(4):
            yield self._places[3 + i], self._table, *self._table_grid, self._contacts[i]

    def _look_up(self) -> None:
        self.functions[0]()
        for place, cells, start, step, row in self._tables():
            cell = (place - start) / step
            row[:] = cells[int(min(max(cell, 0), len(cells) - 1)) if np.isfinite(cell) else 0]

    def _run_python(self, rows: np.ndarray) -> int:
        for k in range(len(rows)):
            self._look_up()
            self.functions[1]()
            self.functions[2]()
            rows[k] = np.concatenate([self._y, self._record])
            if not (self._margins > 0).all() or not np.isfinite(rows[k]).all():
                return k
            self.functions[3]()
            self.state[:], self.memory[:] = self._next_state, self._next_memory
        return len(rows)

    def _prepare_loop(self) -> None:
        def copies(*pairs):
            return (_Copy * len(pairs))(
                *(_Copy(to if to is None else to.ctypes.data, source.ctypes.data, source.size) for to, source in pairs)
            )

        self._c_calls = (codegen.Call * 4)(*(function.call for function in self.functions))
        self._c_lookups = (_Lookup * 7)(
            *(
                _Lookup(cells.ctypes.data, start, step, len(cells), cells.shape[1], row.ctypes.data)
                for _, cells, start, step, row in self._tables()
            )
        )
        self._c_log = copies((None, self._y), (None, self._record))
        self._c_carry = copies((self.state, self._next_state), (self.memory, self._next_memory))
        places, margins = (ctypes.c_void_p(array.ctypes.data) for array in (self._places, self._margins))
        self._surroundings = self._c_calls, places, self._c_lookups, ctypes.c_longlong(7)
        self._rest = margins, ctypes.c_longlong(self._margins.size), self._c_log, ctypes.c_longlong(2)
        self._loop = self._library.railrepro_run
        self._loop.restype = ctypes.c_longlong

    def _run_compiled(self, rows: np.ndarray) -> int:
        count, to, n_carry = ctypes.c_longlong(len(rows)), ctypes.c_void_p(rows.ctypes.data), ctypes.c_longlong(2)
        return self._loop(count, *self._surroundings, *self._rest, to, self._c_carry, n_carry)
