"""Car and control law coupled at 1 kHz: one call runs many control cycles.

The loop of `loop.c` runs over the compiled car and the control cycle of `railrepro.control.cycle`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from railrepro.car import component
from railrepro.car.component import SteppedCar
from railrepro.car.outputs import Outputs
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import cycle, interface, law
from railrepro.quantities import indices, names, pack, unpack

_BLOCK = 10_000
"""Control cycles whose log is allocated at once."""
_SOURCE = Path(__file__).with_name("loop.c").read_text()
_MEASURED = [names(Outputs).index(name) for name in interface.MEASURED]
"""Outputs of the car that the law measures."""


@lru_cache
def library(signature: law.LawSignature) -> tuple[ctypes.CDLL, Any]:
    """The loop under a law as a shared object, and its `loop_t`."""
    text = codegen.PREAMBLE + cycle.c_text(signature, len(names(signature.Gains)))
    text += codegen.defines({"MEASURED_OF_OUTPUT": "{" + ", ".join(map(str, _MEASURED)) + "}"})
    loaded = codegen.library((law.function(signature),), text + _SOURCE)
    loaded.loop_run.restype = ctypes.c_longlong
    _, controller = cycle.structures(signature)
    return loaded, codegen.structure("loop_t", _SOURCE, {}, car_fn=ctypes.c_void_p, controller_t=controller)


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
        self.car, self.control, self.ended = car, control, False
        car.look_up()
        signature, self.state = control.signature, car.state
        self.columns = (*car.model.outputs, *signature.record)
        self._library, of_loop = library(signature)
        of_car = component.library()
        functions = (ctypes.cast(function, ctypes.c_void_p) for function in (of_car.car_measure, of_car.car_advance))
        buffers = car.torque.ctypes.data, car.measured.ctypes.data, car.measured.size
        self._loop = of_loop(ctypes.addressof(car.c), *functions, *buffers)
        self._c = self._loop.control
        self._c.cells, self._c.n_cells = car.c.track, car.c.track_cells
        self._c.cell_start, self._c.cell_step = car.c.track_start, car.c.track_step
        found = codegen.arrays(self._c)
        found["parameters"][:] = control.gains
        self.held, self.memory, self._margins = found["held"], found["memory"], found["margins"]

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
            count, address = ctypes.c_longlong(len(rows)), ctypes.c_void_p(rows.ctypes.data)
            done = self._library.loop_run(ctypes.byref(self._loop), count, address)
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
            Per gear the address of its function, see `cycle.SAMPLE`, and that of its memory.
        every : int
        """
        slot, _ = cycle.structures(self.control.signature)
        self._c.every = every
        for g, planner in enumerate(planners):
            self._c.planner[g] = slot(*planner)

    @property
    def time(self) -> float:
        """Simulated time (s)."""
        return self._c.cycles * CONTROL_PERIOD

    @property
    def margins(self) -> dict[str, float]:
        """Distance to each limit of the run, see `interface.MARGINS`."""
        return dict(zip(interface.MARGINS, self._margins.tolist(), strict=True))

    def measured_states(self) -> np.ndarray:
        """States of front and rear gear as last measured, shape (2, 6), in the order of the control model.

        With sensors, as the law saw them in the cycle before.
        """
        signature = self.control.signature
        if signature.sensed and self._c.cycles:
            memory = indices(signature.Memory)
            return self.memory[np.array([pack(gear.estimated) for gear in (memory.front, memory.rear)])]
        measured = unpack(interface.Measured, _MEASURED)
        return self.car.measured[np.array([pack(measured.front), pack(measured.rear)])]
