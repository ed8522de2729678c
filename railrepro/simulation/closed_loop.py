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
_READ = [STATES.index(name) for name in names(interface.ReadGear)]
"""States of a gear that sensors read."""
SAMPLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, *[ctypes.POINTER(ctypes.c_double)] * 2, ctypes.c_double)
"""Function of a slower controller, see `planner_slot_t` of loop.c: differential torque (N m) from the address of its
memory, states of its gear (6,), readings of it (3,), see `interface.ReadGear`, and base torque (N m)."""


class _Vector(ctypes.Structure):
    _fields_ = [("values", ctypes.c_void_p), ("n", ctypes.c_longlong)]


class _Copy(ctypes.Structure):
    _fields_ = [("to", ctypes.c_void_p), ("from_", ctypes.c_void_p), ("n", ctypes.c_longlong)]


class _Loop(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("car", "measure", "advance")),
        ("law", codegen.Call),
        ("sensed", ctypes.c_void_p),
        *((name, _Vector) for name in ("measured", "outputs", "record", "margins")),
        ("carried", _Copy),
        ("planners", ctypes.c_void_p),
        *((name, ctypes.c_longlong) for name in ("n_planners", "every")),
    ]


class _Planner(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("sample", "self", "held", "base", "seen")]


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    """The loop as a shared object."""
    sizes = codegen.defines({"STATES": len(STATES), "READINGS": len(_READ)})
    loaded = codegen.library((), codegen.PREAMBLE + sizes + Path(__file__).with_name("loop.c").read_text())
    loaded.loop_run.restype = ctypes.c_longlong
    return loaded


def _addresses(array: np.ndarray, places) -> np.ndarray:
    """Addresses of entries of an array, in the shape of their indices."""
    return array.ctypes.data + array.itemsize * np.asarray(places, dtype=np.int64)


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
        self.car, self.control, self.cycles, self.ended = car, control, 0, False
        car.look_up()
        signature, outputs = control.signature, car.model.outputs
        self.state, self.held = car.state, np.zeros(len(GEARS))
        self.columns = (*outputs, *signature.record)
        measured, record, self._margins = (
            np.zeros(len(entries)) for entries in (interface.MEASURED, signature.record, interface.MARGINS)
        )
        self.memory, following = np.zeros(len(signature.memory)), np.zeros(len(signature.memory))
        first = equations.BODIES.index(GEARS[0])
        cells = car.rows[first : first + len(GEARS)].reshape(-1)
        self._law = codegen.CompiledFunction(
            control.library(),
            control.function,
            [measured, cells, self.held, np.array(control.gains), self.memory],
            [car.torque, following, record, self._margins],
        )
        sensed = [outputs.index(name) for name in interface.MEASURED]
        exact, memory = unpack(interface.Measured, sensed), indices(signature.Memory)
        states, self._of_gears = np.array([pack(exact.front), pack(exact.rear)]), (memory.front, memory.rear)
        self._exact = np.hstack([states, states[:, _READ]])
        self._seen = car.measured, self._exact
        if signature.sensed:
            self._seen = self.memory, np.array([pack(gear.estimated) + pack(gear.read) for gear in self._of_gears])
        self._sensed = _addresses(car.measured, sensed)
        vectors = (measured, car.measured, record, self._margins)
        self._loop = _Loop(
            ctypes.cast(car.pointer, ctypes.c_void_p), *car.c_functions(), self._law.call, self._sensed.ctypes.data,
            *(_Vector(vector.ctypes.data, vector.size) for vector in vectors),
            _Copy(self.memory.ctypes.data, following.ctypes.data, following.size),
        )  # fmt: skip

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
        if not self.cycles:  # before anything is estimated
            array, places = self._seen
            array[places] = self.car.measure()[self._exact]
        blocks = [np.empty((0, len(self.columns)))]
        for first in range(0, n, _BLOCK):
            rows = np.empty((min(_BLOCK, n - first), len(self.columns)))
            address = ctypes.c_void_p(rows.ctypes.data)
            count, before = ctypes.c_longlong(len(rows)), ctypes.c_longlong(self.cycles)
            done = _library().loop_run(ctypes.byref(self._loop), count, address, before)
            self.cycles += done
            self.ended = done < len(rows)
            blocks.append(rows[: done + 1])
            if self.ended:
                break
        return np.concatenate(blocks)

    def connect(self, planners: Sequence[tuple[int, int]], every: int) -> None:
        """Let slower controllers of both gears plan before the law, every so many cycles.

        They see what `measured_states` gives, and with sensors the readings.

        Parameters
        ----------
        planners : sequence of (int, int)
            Per gear the address of its function, see `SAMPLE`, and that of its memory.
        every : int
        """
        seen = _addresses(*self._seen)
        base = _addresses(self.memory, [gear.u for gear in self._of_gears])
        held = _addresses(self.held, range(len(GEARS)))
        slots = [
            _Planner(*planner, int(held[g]), int(base[g]), seen[g].ctypes.data) for g, planner in enumerate(planners)
        ]
        self._connected = seen, (_Planner * len(slots))(*slots)  # the loop uses their memory
        self._loop.planners, self._loop.n_planners = ctypes.addressof(self._connected[1]), len(slots)
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
        array, places = self._seen if self.cycles else (self.car.measured, self._exact)
        return array[places[:, : len(STATES)]]
