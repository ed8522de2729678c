"""The process of a controller that comes from a file: it answers questions, and knows nothing of car and score.

Run as a module it waits for sockets: for each one it forks a confined copy of itself that talks JSON, a line each.
First the file and the setting, answered by the law of the 1 kHz exchange as a list of operations; then, for a slower
controller, the track ahead, and after it every sample. Who asks, drives and measures is `host`.
"""

from __future__ import annotations

import base64
import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from math import isfinite
from pathlib import Path

import casadi as ca
import numpy as np

from railrepro.control import lateral
from railrepro.errors import InputError
from railrepro.evidence.score import confine
from railrepro.evidence.score.entry import fault, load_class, made
from railrepro.track.route import COLUMNS, Route
from railrepro.vehicle.parameters import load_vehicle

LONGEST = 20_000
"""Most operations of a law."""


def operations(law: lateral.LateralLaw) -> dict:
    """A 1 kHz law as plain values: `gains`, `memory`, and `steps` of (operation, inputs, outputs, constant).

    Raises
    ------
    InputError
        When it is not well formed, holds a constant that is no number, or too many operations.
    """
    kind, owner = lateral.kind(law), type(law).__name__
    function, steps = kind.function, []
    if function.n_instructions() > LONGEST:
        raise InputError(f"lateral law {owner}: {function.n_instructions()} operations, {LONGEST} are the most")
    for i in range(function.n_instructions()):
        name = function.instruction_id(i)
        constant = function.instruction_constant(i) if name == ca.OP_CONST else 0.0
        if not isfinite(constant):
            raise InputError(
                f"lateral law {owner}: torque() holds the constant {constant}; its arguments are symbols, of which "
                "the functions of `math` make nan and those of `casadi` expressions"
            )
        steps.append((name, function.instruction_input(i), function.instruction_output(i), constant))
    return {"steps": steps, "gains": lateral.gains_of(law), "memory": list(kind.memory)}


def answers(requests: Iterator[dict]) -> Iterator[dict]:
    """Answers of a controller; the first request names its file and setting."""
    first = next(requests)
    file, own = Path(first["file"]), None
    try:
        own = load_class(file)
        guidance = made(own, first["setting"])
        law, factory = lateral.split(guidance)
        yield operations(law) | {"slow": factory is not None}
        ahead = next(requests)
        cells = np.frombuffer(base64.b64decode(ahead["cells"])).reshape(-1, len(COLUMNS))
        vehicle, route = load_vehicle(), Route(cells, ahead["length"])
        controllers = [factory(vehicle, route, gear) for gear in range(2)]
        for controller in controllers:
            lateral.check_controller(controller)
        asks = [name for name in ("notice", "read") if hasattr(controllers[0], name)]
        yield {"periods": [controller.period for controller in controllers], "asks": asks}
        for request in requests:
            yield _sample(controllers[request["gear"]], request)
    except (Exception, SystemExit) as error:  # a stranger's controller may raise whatever it likes
        yield {"failure": fault(error, file, own)}


def _sample(controller: lateral.SlowController, request: dict) -> dict:
    """Torque of one sample (N m), and the time of the processor that it took (s)."""
    begin = time.thread_time()
    if "notice" in request:
        controller.notice(*(np.array(values) for values in request["notice"]))
    if "read" in request:
        values, delay = request["read"]
        controller.read(np.array(values), delay)
    torque = lateral.planned(controller.plan(np.array(request["plan"]), request["base"]))
    return {"torque": torque, "seconds": time.thread_time() - begin}


def _serve(descriptor: int, processor: float) -> None:
    confine.confine(processor, descriptor)
    with socket.socket(fileno=confine.CHANNEL).makefile("rw", encoding="utf-8") as stream:
        for answer in answers(json.loads(line) for line in stream):
            stream.write(json.dumps(answer) + "\n")
            stream.flush()


def main(number: int) -> None:
    """Fork one confined process at a time; report its number and, when it has ended, its status."""
    confine.die_with_parent()
    with socket.socket(fileno=number) as channel:
        while True:
            limit, descriptors, *_ = socket.recv_fds(channel, 64, 1)
            if not limit:
                return
            child = os.fork()
            if child == 0:
                try:
                    _serve(descriptors[0], float(limit))
                finally:
                    os._exit(0)
            os.close(descriptors[0])
            channel.sendall(child.to_bytes(4, "big"))
            channel.sendall(os.waitpid(child, 0)[1].to_bytes(4, "big"))


if __name__ == "__main__":
    main(int(sys.argv[1]))
