"""The side of the score: it drives the car and measures, and asks the process of a controller (`guest`) for torques.

Nothing of a stranger's file runs here, and nothing of what it answers is believed beyond numbers: a law comes as a list
of arithmetic operations of which a new expression is made, a sample as one torque. A controller that does not answer in
time is killed with its group of processes.
"""

from __future__ import annotations

import base64
import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from functools import lru_cache
from math import isfinite

import casadi as ca
import numpy as np

from railrepro.control import lateral
from railrepro.control.predictive import Solve
from railrepro.evidence.score import guest
from railrepro.schema import is_number
from railrepro.track.irregularity import CHANNELS
from railrepro.track.route import INDEX, Route

PROCESSOR, WALL = 20.0, 60.0
"""Time limits of a controller in a drive: of its processor, and of the clock while it is waited for (s)."""
NOT_FINITE, LARGEST = "not_finite", 1e12
"""State of a handed-over law that counts exchanges with a torque beyond all bounds (N m)."""
_LONGEST_ANSWER = 16 * 2**20
_UNARY = (
    *(
        ca.OP_ASSIGN,
        ca.OP_NEG,
        ca.OP_EXP,
        ca.OP_LOG,
        ca.OP_SQRT,
        ca.OP_SQ,
        ca.OP_TWICE,
        ca.OP_SIN,
        ca.OP_COS,
        ca.OP_TAN,
    ),
    *(ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH),
    *(ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FABS, ca.OP_SIGN, ca.OP_NOT, ca.OP_INV, ca.OP_ERF, ca.OP_LOG1P, ca.OP_EXPM1),
)
_BINARY = (
    *(ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV, ca.OP_POW, ca.OP_CONSTPOW, ca.OP_FMOD, ca.OP_COPYSIGN, ca.OP_ATAN2),
    *(ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_FMIN, ca.OP_FMAX, ca.OP_IF_ELSE_ZERO),
    *(ca.OP_HYPOT, ca.OP_REMAINDER),
)


class Fault(Exception):
    """What a controller did wrong, in one sentence."""


class _Nursery:
    """The process that forks those of the controllers; one for each process that scores."""

    def __init__(self) -> None:
        self.channel, theirs = socket.socketpair()
        self.channel.settimeout(60.0)
        threads = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
        subprocess.Popen(
            [sys.executable, "-m", guest.__name__, str(theirs.fileno())], pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL, env=os.environ | threads, start_new_session=True,
        )  # fmt: skip
        theirs.close()

    def number(self) -> int:
        """What it reports next: the number of a process, or how one ended."""
        found = self.channel.recv(4)
        if len(found) < 4:
            _nursery.cache_clear()
            raise Fault("ended the process that started it")
        return int.from_bytes(found, "big")


@lru_cache(1)
def _nursery() -> _Nursery:
    return _Nursery()


class Guest:
    """A confined process with the controller of a file.

    Parameters
    ----------
    file : str
    setting : str
    processor, wall : float
        Time limits (s).

    Attributes
    ----------
    law : dict
        Its law, see `guest.operations`, and whether it is also `slow`.
    """

    def __init__(self, file: str, setting: str, processor: float = PROCESSOR, wall: float = WALL):
        self._limits, self._left, self._rest = (processor, wall), wall, b""
        self._nursery, (self._channel, theirs) = _nursery(), socket.socketpair()
        with theirs:
            socket.send_fds(self._nursery.channel, [str(processor).encode()], [theirs.fileno()])
        self._process: int | None = self._nursery.number()
        self.law = self.ask(file=file, setting=setting)

    def ask(self, **request) -> dict:
        """Its answer to a request.

        Raises
        ------
        Fault
            When it reports one, answers nothing sensible, takes too long, or has ended. The process is gone then.
        """
        begin = time.monotonic()
        try:
            self._channel.settimeout(max(self._left, 1e-3))
            with suppress(BrokenPipeError):
                self._channel.sendall(json.dumps(request).encode() + b"\n")
            answer = json.loads(self._line(begin + self._left))
            if not isinstance(answer, dict):
                raise ValueError
            if "failure" in answer:
                raise Fault(" ".join(str(answer["failure"]).split())[:300] or "failed")
        except TimeoutError:
            self.close()
            raise Fault(f"took more than {self._limits[1]:g} s") from None
        except (ValueError, RecursionError):
            self.close()
            raise Fault("answered what is no answer") from None
        except Fault:
            self.close()
            raise
        self._left -= time.monotonic() - begin
        return answer

    def _line(self, deadline: float) -> bytes:
        while b"\n" not in self._rest:
            self._channel.settimeout(max(deadline - time.monotonic(), 1e-3))
            try:
                more = self._channel.recv(2**20)
            except ConnectionResetError:
                more = b""
            if not more:
                raise Fault(self._ended())
            self._rest += more
            if len(self._rest) > _LONGEST_ANSWER or time.monotonic() > deadline:
                raise TimeoutError
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _ended(self) -> str:
        """How the process ended."""
        status, self._process = self._nursery.number(), None
        if not os.WIFSIGNALED(status):
            return "ended the process"
        if os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
            return f"took more than {self._limits[0]:g} s of the processor"
        return f"ended the process by signal {signal.Signals(os.WTERMSIG(status)).name}"

    def close(self) -> None:
        """Kill the process and its group."""
        self._channel.close()
        if self._process is None:
            return
        for kill in (os.kill, os.killpg):
            with suppress(ProcessLookupError, PermissionError):
                kill(self._process, signal.SIGKILL)
        self._process = None
        self._nursery.number()


class HandedLaw:
    """A law of the 1 kHz exchange made anew of handed-over operations; it counts torques that are not finite.

    Parameters
    ----------
    law : dict
        See `guest.operations`.

    Raises
    ------
    Fault
        When it is not made of arithmetic.
    """

    def __init__(self, law: dict):
        steps, gains, memory = (law.get(name) for name in ("steps", "gains", "memory"))
        if not isinstance(steps, list) or len(steps) > guest.LONGEST or not isinstance(gains, dict):
            raise Fault("handed over what is no law")
        if not isinstance(memory, list) or not all(isinstance(name, str) for name in (*memory, *gains)):
            raise Fault("handed over what is no law")
        if not all(is_number(value) and isfinite(value) for value in gains.values()):
            raise Fault("handed over a gain that is no number")
        self._steps, self._gains, self._own = steps, gains, tuple(memory)
        self.memory = (*memory, NOT_FINITE)

    def gains(self) -> dict[str, float]:
        """See `LateralLaw.gains`."""
        return dict(self._gains)

    def torque(self, q) -> tuple[ca.SX, dict]:
        """See `LateralLaw.torque`."""
        named = lateral.GEAR, lateral.ROAD, self._own, self._gains, lateral.MODEL
        groups = [[getattr(q, name) for name in names] for names in named]
        try:
            results = _evaluated(self._steps, groups)
            du, following = results[0, 0], {name: results[1, i] for i, name in enumerate(self._own)}
        except (LookupError, TypeError, ValueError):
            raise Fault("handed over what is no law") from None
        lost = 1 - (ca.fabs(du) < LARGEST)
        return du, following | {NOT_FINITE: getattr(q, NOT_FINITE) + lost}


def _evaluated(steps: list, groups: list) -> dict[tuple[int, int], ca.SX]:
    """Outputs of operations by (output, element); zero where nothing was put out."""
    slots: dict[int, ca.SX] = {}
    results: dict[tuple[int, int], ca.SX] = {}
    for name, inputs, outputs, constant in steps:
        if name == ca.OP_CONST:
            slots[outputs[0]] = ca.SX(float(constant))
        elif name == ca.OP_INPUT:
            slots[outputs[0]] = groups[inputs[0]][inputs[1]]
        elif name == ca.OP_OUTPUT:
            results[outputs[0], outputs[1]] = slots[inputs[0]]
        elif name in _UNARY:
            slots[outputs[0]] = ca.SX.unary(name, slots[inputs[0]])
        elif name in _BINARY:
            slots[outputs[0]] = ca.SX.binary(name, slots[inputs[0]], slots[inputs[1]])
        else:
            raise ValueError
    return results


class HandedGuidance(HandedLaw):
    """The same with slower controllers in a process of their own, one for both gears of a drive.

    Parameters
    ----------
    law : dict
    start : callable
        Starts a `Guest`.
    """

    def __init__(self, law: dict, start):
        super().__init__(law)
        self._start, self._guest = start, None

    def __call__(self, vehicle, route: Route, gear: int) -> RemoteController:
        if gear == 0:
            self.close()
            self._guest = self._start()
            cells = base64.b64encode(known(route).cells.tobytes()).decode()
            self._made = self._guest.ask(cells=cells, length=float(route.length))
        return RemoteController(self._guest, gear, self._made)

    def close(self) -> None:
        """End the process of the last drive."""
        if self._guest is not None:
            self._guest.close()
            self._guest = None


def known(route: Route) -> Route:
    """What a controller may know of a route: no irregularities, friction, profiles of the rails, side forces."""
    cells = np.array(route.cells)
    hidden = (*CHANNELS, "poor_le", "poor_ri", "second_profile", "side_force")
    names = [name for name in INDEX if name.lstrip("d") in hidden or name in hidden]
    cells[:, [INDEX[name] for name in names]] = 0.0
    return Route(cells, route.length)


class RemoteController:
    """A slower controller of one gear that lives in a confined process; see `lateral.SlowController`.

    Attributes
    ----------
    period : float
        Sampling time (s).
    stats : list of Solve
        Times of its samples as its process reports them (s).
    """

    def __init__(self, guest_: Guest, gear: int, made: dict):
        self._guest, self._gear, self._told, self.stats = guest_, gear, {}, []
        try:
            self.period, asks = float(made["periods"][gear]), list(made["asks"])
        except (LookupError, TypeError, ValueError):
            raise Fault("answered what is no answer") from None
        if "notice" in asks:
            self.notice = lambda *values: self._told.update(notice=[np.asarray(v).tolist() for v in values])
        if "read" in asks:
            self.read = lambda values, delay: self._told.update(read=[np.asarray(values).tolist(), delay])

    def plan(self, x_hat: np.ndarray, u_d: float) -> float:
        """See `SlowController.plan`."""
        answer = self._guest.ask(gear=self._gear, plan=x_hat.tolist(), base=float(u_d), **self._told)
        if type(answer.get("torque")) not in (int, float) or not is_number(answer.get("seconds")):
            raise Fault("answered what is no answer")
        self.stats.append(Solve(float(answer["seconds"]), 0, False))
        return float(answer["torque"])
