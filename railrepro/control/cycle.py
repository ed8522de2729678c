"""The control cycle of both gears in C, for runs and export: slower controllers when they are due, then the 1 kHz law.
Serves the paper's Fig. 4."""

import ctypes
from functools import lru_cache
from pathlib import Path
from typing import Any

from railrepro.compile import codegen
from railrepro.control import interface, law
from railrepro.model.control_model import STATES
from railrepro.quantities import GEARS, WHEELS, indices, names
from railrepro.track.route import COLUMNS

SAMPLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, *[ctypes.POINTER(ctypes.c_double)] * 2, ctypes.c_double)
"""Type of the C function of a slower controller: (address of its memory, states (6,) of its gear as
`control_model.STATES`, readings (3,) as `interface.READ`, base torque (N m)) -> differential torque (N m)."""
SLOTS = Path(__file__).with_name("slots.c").read_text(encoding="utf-8")
"""C text that calls the slower controllers through pointers to functions of the type `SAMPLE`."""
_SOURCE = Path(__file__).with_suffix(".c").read_text(encoding="utf-8")


def _sizes(signature: law.LawSignature, parameters: int) -> dict[str, int]:
    counted = {"N_INPUT": interface.MEASURED, "N_OUTPUT": WHEELS, "N_MEMORY": signature.memory, "GEARS": GEARS}
    counted |= {"N_RECORD": signature.record, "N_MARGIN": interface.MARGINS, "N_CELL_COLUMNS": COLUMNS}
    return {size: len(names) for size, names in counted.items()} | {"N_PARAMETER": parameters}


def c_text(signature: law.LawSignature, parameters: int, planners: str = SLOTS) -> str:
    """C text of the control cycle of both gears, to be placed after the preamble call.h and the C generated from
    `law.function`. `parameters` is how many run-time parameters it has, numbers that may change without compiling
    again: one per name of `signature.Gains`, in an export also one per parameter of the slower controllers, such as
    weights of MPC. `planners` is the C of the slower controllers. In runs it is `SLOTS`, which calls each by the
    pointer that `ClosedLoop.connect` sets; an export passes the C of the controllers itself. In both cases it must
    define four symbols: planner_memory_t, the type of the memory m of one gear; planner_reset(m, gear, parameters),
    which initialises it; planner_link(m, gear, parameters, cells), which sets its pointers to run-time parameters and
    rows of the route; planner_sample(m, states, readings, base torque), which returns the differential torque (N m)."""
    measured, memory, read = indices(interface.Measured), indices(signature.Memory), interface.READ
    places: dict[str, int | str] = {"GEAR_MEASURED": measured.rear.p - measured.front.p, "BASE": memory.front.u}
    places |= {"GEAR_MEMORY": memory.rear.u - memory.front.u, "N_READINGS": len(read), "ESTIMATED": 0, "READ": 0}
    places |= {"READ_OF_STATE": "{" + ", ".join(str(STATES.index(name)) for name in read) + "}"}
    if isinstance(memory.front, law.SensedGearMemory):
        places |= {"ESTIMATED": memory.front.estimated.x, "READ": memory.front.read[0]}
    return codegen.defines(_sizes(signature, parameters) | places) + planners + _SOURCE


@lru_cache
def structures(signature: law.LawSignature) -> tuple[Any, Any]:
    """Make the ctypes classes of two C structs of the control cycle with a 1 kHz law: `planner_memory_t`, the memory of
    the slower controllers, and `controller_t`, the whole controller."""
    slot = codegen.structure("planner_memory_t", SLOTS, {}, sample_t=ctypes.c_void_p)
    sizes = _sizes(signature, len(names(signature.Gains)))
    return slot, codegen.structure("controller_t", _SOURCE, sizes, planner_memory_t=slot)
