"""Car and control law coupled at 1 kHz: one call runs many control cycles. The loop of `loop.c` runs over the compiled
car and the control cycle of `railrepro.control.cycle`."""

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
from railrepro.compile import codegen
from railrepro.control import cycle, interface, law
from railrepro.quantities import names

_BLOCK = 10_000
"""Control cycles whose log is allocated at once."""
_SOURCE = Path(__file__).with_name("loop.c").read_text()
_MEASURED = [names(Outputs).index(name) for name in interface.MEASURED]
"""Outputs of the car that the law measures."""


@lru_cache
def library(signature: law.LawSignature) -> tuple[ctypes.CDLL, Any]:
    """Compile `loop.c` with the 1 kHz law of this signature; returns the shared object and the ctypes class of its
    `loop_t`."""
    text = codegen.PREAMBLE + cycle.c_text(signature, len(names(signature.Gains)))
    text += codegen.defines({"MEASURED_OF_OUTPUT": "{" + ", ".join(map(str, _MEASURED)) + "}"})
    loaded = codegen.library((law.function(signature),), text + _SOURCE)
    loaded.loop_run.restype = ctypes.c_longlong
    _, controller = cycle.structures(signature)
    return loaded, codegen.structure("loop_t", _SOURCE, {}, car_fn=ctypes.c_void_p, controller_t=controller)


class ClosedLoop:
    """The car on a route under a control law. `run` advances both by whole control cycles of 1 ms.

    Attributes:
        car (SteppedCar): The simulated car on its route.
        control (ControlLaw): The 1 kHz law of both gears, from `railrepro.control.law.control_law`.
        ended (bool): Whether the last `run` reached a limit.
        state (ndarray, shape (len(car.model.states),)): State of the car (SI), the array `car.state`; writable.
        held (ndarray, shape (2,)): Last differential torques of slower controllers, front and rear gear (N m);
            writable.
        memory (ndarray): States of the law (SI), in the order of the names `control.signature.memory`; writable.
        columns (tuple of str): Columns that `run` returns: outputs of the car, then what the law logs.
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
        """Advance by n control cycles of 1 ms, or fewer when a limit is reached (see `margins`).

        Returns an array with one row per cycle and the columns `columns` (SI), taken before the car advances. When a
        limit is reached, `ended` is True, and the last row and `state` are at the limit.
        """
        blocks = []
        for first in range(0, n, _BLOCK):
            rows = np.empty((min(_BLOCK, n - first), len(self.columns)))
            count, address = ctypes.c_longlong(len(rows)), ctypes.c_void_p(rows.ctypes.data)
            done = self._library.loop_run(ctypes.byref(self._loop), count, address)
            self.ended = done < len(rows)
            blocks.append(rows[: done + 1])
            if self.ended:
                break
        return blocks[0] if len(blocks) == 1 else np.concatenate([np.empty((0, len(self.columns))), *blocks])

    def connect(self, planners: Sequence[tuple[int, int]], every: int) -> None:
        """Register a slower controller for each gear, which `run` calls before the law every `every` cycles of 1 ms.

        `planners` holds a pair for the front and one for the rear gear: addresses (int) of a C function of type
        `railrepro.control.cycle.SAMPLE` and of its memory. With sensors this function gets the estimated states of the
        previous cycle.
        """
        slot, _ = cycle.structures(self.control.signature)
        self._c.every = every
        for g, planner in enumerate(planners):
            self._c.planner[g] = slot(*planner)

    @property
    def margins(self) -> dict[str, float]:
        """Distances to the limits of a run as a dict, keys as in `interface.Margins`. The run ends when one is not
        positive."""
        return dict(zip(interface.MARGINS, self._margins.tolist(), strict=True))
