"""Car and control law coupled at 1 kHz: one call runs many control cycles.

The loop of `loop.c` runs over the compiled car and the compiled law.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from railrepro.car import equations
from railrepro.car.component import SteppedCar
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import interface, law
from railrepro.model.control_model import STATES
from railrepro.quantities import GEARS, indices, names, pack, unpack

_BLOCK = 10_000
"""Control cycles whose log is allocated at once."""


class _Copy(ctypes.Structure):
    _fields_ = [("to", ctypes.c_void_p), ("from_", ctypes.c_void_p), ("n", ctypes.c_longlong)]


def _copy(source: np.ndarray, to: np.ndarray | None = None) -> _Copy:
    return _Copy(None if to is None else to.ctypes.data, source.ctypes.data, source.size)


class _Loop(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("car", "measure", "advance")),
        ("law", codegen.Call),
        *((name, ctypes.c_void_p) for name in ("sensed", "logged", "carried")),
        *((name, ctypes.c_longlong) for name in ("n_sensed", "n_logged", "n_carried")),
        ("margins", ctypes.c_void_p),
        ("n_margins", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("first", "later")),
        *((name, ctypes.c_longlong) for name in ("n_first", "n_later")),
        ("planners", ctypes.c_void_p),
        *((name, ctypes.c_longlong) for name in ("n_planners", "every")),
    ]


SAMPLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, *[ctypes.POINTER(ctypes.c_double)] * 2, ctypes.c_double)
"""Function of a slower controller, see `planner_slot_t` of loop.c: differential torque (N m) from the address of its
memory, states of its gear (6,), readings of it (3,), see `interface.ReadGear`, and base torque (N m)."""


class _Planner(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("sample", "self", "state", "read", "base", "held")]


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """The loop as a shared object."""
    loaded = codegen.library((), codegen.PREAMBLE + Path(__file__).with_name("loop.c").read_text())
    loaded.loop_run.restype = ctypes.c_longlong
    return loaded


class ClosedLoop:
    """The car on a route under a control law; `run` advances it by whole control cycles of 1 ms.

    Attributes
    ----------
    car : SteppedCar
    control : ControlLaw
    state : ndarray
        Plant state, that of the car; writable.
    held : ndarray, shape (2,)
        Differential torques of a slower lateral controller, front and rear (N m); writable.
    memory : ndarray
        States of the law, see `law.LawSignature.memory`.
    columns : tuple of str
        Names of the columns that `run` returns.
    """

    def __init__(self, car: SteppedCar, control: law.ControlLaw):
        self.car = car
        car.look_up()
        self.state, self.held = self.car.state, np.zeros(len(GEARS))
        self.control, self.cycles, self.ended = control, 0, False
        outputs = self.car.model.outputs
        self.columns = (*outputs, *control.signature.record)
        self.sensed = [outputs.index(name) for name in interface.MEASURED]
        measured = unpack(interface.Measured, self.sensed)
        self._states = np.array([pack(measured.front), pack(measured.rear)])
        memory, self._estimated = indices(control.signature.Memory), None
        gears = memory.front, memory.rear
        if control.signature.sensed:
            self._estimated, self._read = (
                np.array([pack(getattr(gear, part)) for gear in gears]) for part in ("estimated", "read")
            )
        self._base = [g.u for g in gears]
        self.memory, self._gains = np.zeros(len(control.signature.memory)), np.array(control.gains)
        self._next_memory, self._record = np.zeros_like(self.memory), np.zeros(len(control.signature.record))
        self._measured, self._margins = np.zeros(len(interface.MEASURED)), np.zeros(len(interface.MARGINS))
        first = equations.BODIES.index(GEARS[0])
        cells = self.car.rows[first : first + len(GEARS)].reshape(-1)
        binding = (
            control.function,
            [self._measured, cells, self.held, self._gains, self.memory],
            [self.car.torque, self._next_memory, self._record, self._margins],
        )
        self._law = codegen.CompiledFunction(control.library(), *binding)
        self._driver, self._loop = _library(), self._structure()

    def run(self, n: int) -> np.ndarray:
        """Advance by up to n control cycles.

        Parameters
        ----------
        n : int
            Number of control cycles of 1 ms.

        Returns
        -------
        ndarray, shape (m, len(columns))
            One row per cycle, taken before its step. m = n, or the run ended early: the last row then shows where,
            `ended` is true and `state` is that of the last row.
        """
        blocks = [np.empty((0, len(self.columns)))]
        for first in range(0, n, _BLOCK):
            rows = np.empty((min(_BLOCK, n - first), len(self.columns)))
            address = ctypes.c_void_p(rows.ctypes.data)
            count, before = ctypes.c_longlong(len(rows)), ctypes.c_longlong(self.cycles)
            done = self._driver.loop_run(ctypes.byref(self._loop), count, address, before)
            self.cycles += done
            self.ended = done < len(rows)
            blocks.append(rows[: done + 1])
            if self.ended:
                break
        return np.concatenate(blocks)

    def connect(self, planners: Sequence[tuple[int, int]], every: int) -> None:
        """Let slower controllers of both gears plan before the law, every so many cycles.

        Parameters
        ----------
        planners : sequence of (int, int)
            Per gear the address of its function, see `SAMPLE`, and that of its memory.
        every : int
        """
        read = [STATES.index(name) for name in names(interface.ReadGear)]
        states, readings = np.zeros((len(GEARS), len(STATES))), np.zeros((len(GEARS), len(read)))
        of_car = self._states, self._states[:, read]
        exact = self.car.measured, of_car
        sensed = exact if self._estimated is None else (self.memory, (self._estimated, self._read))
        first, later = (
            [
                _copy(source[i : i + 1], to[k : k + 1])
                for places, to in zip(groups, (states.reshape(-1), readings.reshape(-1)), strict=True)
                for k, i in enumerate(places.ravel())
            ]
            for source, groups in (exact, sensed)
        )
        base, held = [self.memory[at:] for at in self._base], [self.held[g:] for g in range(len(GEARS))]
        slots = [
            _Planner(*planner, *(array.ctypes.data for array in shared))
            for planner, *shared in zip(planners, states, readings, base, held, strict=True)
        ]
        arrays = (_Copy * len(first))(*first), (_Copy * len(later))(*later), (_Planner * len(slots))(*slots)
        self._connected = states, readings, arrays  # the loop uses their memory
        self._loop.first, self._loop.later, self._loop.planners = (ctypes.addressof(array) for array in arrays)
        self._loop.n_first, self._loop.n_later, self._loop.n_planners = len(first), len(later), len(slots)
        self._loop.every = every

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return self.cycles * CONTROL_PERIOD

    @property
    def margins(self) -> dict[str, float]:
        """Distance to each limit of the run, see `interface.MARGINS`."""
        return dict(zip(interface.MARGINS, self._margins.tolist(), strict=True))

    def measured_states(self) -> np.ndarray:
        """States of front and rear gear as last measured, shape (2, 6), in the order of the control model.

        With sensors, as the law saw them in the cycle before.
        """
        if self._estimated is None or not self.cycles:
            return self.car.measured[self._states]
        return self.memory[self._estimated]

    def _structure(self) -> _Loop:
        outputs = self.car.measured
        sensed = [_copy(outputs[j : j + 1], self._measured[i : i + 1]) for i, j in enumerate(self.sensed)]
        logged = [_copy(outputs), _copy(self._record)]
        carried = [_copy(self._next_memory, self.memory)]
        self._copies = [(_Copy * len(group))(*group) for group in (sensed, logged, carried)]
        addresses = (ctypes.addressof(copies) for copies in self._copies)
        return _Loop(
            ctypes.cast(self.car.pointer, ctypes.c_void_p), *self.car.c_functions(), self._law.call, *addresses,
            *map(len, self._copies), self._margins.ctypes.data, self._margins.size,
        )  # fmt: skip
