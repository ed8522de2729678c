"""Car and control law coupled at 1 kHz: `loop.c` runs the compiled car and `railrepro.control.cycle` in C."""

import ctypes
import math
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from railrepro.car import component
from railrepro.car.outputs import Outputs
from railrepro.clock import CONTROL_PERIOD
from railrepro.compile import codegen
from railrepro.control import cycle, interface, law
from railrepro.data import between, require
from railrepro.quantities import names

_BLOCK = 10_000  # Most control cycles in one call of C
_LONGEST_CALL = 0.1
"""Duration of a call of C (s) above which the next ones get shorter: Python sees Ctrl-C between them."""
_SOURCE = Path(__file__).with_name("loop.c").read_text(encoding="utf-8")


@lru_cache
def library(signature: law.LawSignature) -> tuple[ctypes.CDLL, Any]:
    """Compile `loop.c`, the loop over car and control law, for a 1 kHz law with this signature (its equations without
    values of gains). Returns the loaded shared object, and the ctypes class of `loop_t`, the struct of the loop."""
    measured = ", ".join(str(names(Outputs).index(name)) for name in interface.MEASURED)
    text = codegen.PREAMBLE + cycle.c_text(signature, len(names(signature.Gains)))
    text += codegen.defines({"MEASURED_OF_OUTPUT": "{" + measured + "}"})
    loaded = codegen.library((law.function(signature),), text + _SOURCE)
    loaded.loop_run.restype = ctypes.c_longlong
    _, controller = cycle.structures(signature)
    return loaded, codegen.structure("loop_t", _SOURCE, {}, car_fn=ctypes.c_void_p, controller_t=controller)


class ClosedLoop:
    """The car on a route under a control law, simulated in control cycles of 1 ms.

    Attributes:
        car (SteppedCar): The simulated car on its route.
        control (ControlLaw): The 1 kHz law of both gears, from `railrepro.control.law.control_law`.
        ended (bool): Whether the last `run` reached a limit of `margins`.
        state (ndarray): State of the car (SI), the array `car.state`.
        held (ndarray, shape (2,)): Differential torques that slower controllers gave last, front and rear gear (N m);
            writable.
        memory (ndarray): States of the law (SI), in the order of the names `control.signature.memory`; writable.
        columns (tuple of str): Columns that `run` returns: outputs of the car such as "front.y", then signals of the
            law.
    """

    held = codegen.in_c("held")
    memory = codegen.in_c("memory")
    state = property(lambda self: self.car.state)

    def __init__(self, car: component.SteppedCar, control: law.ControlLaw):
        require("car", car, component.SteppedCar)
        require("control", control, law.ControlLaw)
        self.car, self.control, self.ended, signature = car, control, False, control.signature
        car.look_up()
        self.columns = (*car.model.outputs, *signature.record)
        self._library, of_loop = library(signature)
        of_car = component.library()
        functions = (ctypes.cast(function, ctypes.c_void_p) for function in (of_car.car_measure, of_car.car_advance))
        buffers = car.torque.ctypes.data, car.measured.ctypes.data, car.measured.size
        self._loop = of_loop(ctypes.addressof(car.c), *functions, *buffers)
        self._c = self._loop.control
        self._c.cells, self._c.n_cells = car.c.track, car.c.track_cells
        self._c.cell_start, self._c.cell_step = car.c.track_start, car.c.track_step
        self._arrays = codegen.arrays(self._c)
        parameters = self._arrays["parameters"]
        parameters[:] = codegen.for_c("control: gains", control.gains, parameters.shape)

    def run(self, n: int) -> np.ndarray:
        """Advance by n control cycles of 1 ms, or fewer if a limit of `margins` is reached. Returns an array with a row
        per cycle and the columns `columns` (SI): outputs of the car, and signals of the law for these outputs, before
        the car advances. If a limit ends the run, the last row is at the limit, with the answer of the law."""
        require("n", n, between(0, math.inf), whole=True)
        self.car.c.period = CONTROL_PERIOD / self.car.c.substeps  # `SteppedCar.step` may have had another one
        blocks, block = [np.empty((0, len(self.columns)))], 1
        while n > 0:
            rows = np.empty((min(block, n), len(self.columns)))
            count, address, begin = ctypes.c_longlong(len(rows)), ctypes.c_void_p(rows.ctypes.data), time.perf_counter()
            done = self._library.loop_run(ctypes.byref(self._loop), count, address)
            self.ended = done < len(rows)
            blocks.append(rows[: done + 1])
            if self.ended:
                break
            n -= len(rows)
            quick = time.perf_counter() - begin < _LONGEST_CALL
            block = min(2 * block, _BLOCK) if quick else max(block // 2, 1)
        return np.concatenate(blocks)

    def connect(self, planners: Sequence[tuple[int, int]], every: int) -> None:
        """Let `run` call slower controllers, such as MPC, of the front and the rear gear, each `every` control cycles
        (ms). For each controller `planners` has the addresses of a C function of the type
        `railrepro.control.cycle.SAMPLE` and of its memory. The function is called before the law acts: with sensors it
        gets the estimated states of the previous cycle."""
        slot, _ = cycle.structures(self.control.signature)
        self._c.every = every
        for g, planner in enumerate(planners):
            self._c.planner[g] = slot(*planner)

    @property
    def margins(self) -> dict[str, float]:
        """Distances to the limits of a run, which ends when one is not positive: front.lateral and rear.lateral, to
        derailment (m); track_end, of the front gear to the end of the route (m); stop_speed, speed of the front gear
        less the speed at which the run ends (m/s); front.torque, rear.torque: 0 if the torque is not finite, else 1."""
        return dict(zip(interface.MARGINS, self._arrays["margins"].tolist(), strict=True))
