"""Several cars side by side in vector registers: each run as alone, to the bit, at a third of its time or less.

Runs of one structure, each with its own states, parameters, gains, road, length, advance in one stream (`lanes.c`). A
run is a generator that asks for exchanges. Within `together` the runs of several tasks meet in one process: tasks take
turns, one at a time, until all wait for exchanges, which then go side by side; where a run ends, the next one moves up.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Generator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from railrepro.car import stepper
from railrepro.compile import codegen
from railrepro.simulation.exchange import Exchange

LANES = 4
"""Cars side by side, as in lanes.h."""
_BLOCK = 250
"""Most exchanges between two looks whether a run ended and another one can take its place."""
Steps = Generator[tuple[Exchange, int], np.ndarray, Any]
"""A run: it asks for exchanges of its car, is sent their log, and returns its outcome."""


class _Beside(ctypes.Structure):
    _fields_ = [("wide", ctypes.c_void_p), ("n", ctypes.c_longlong), ("own", ctypes.c_void_p * LANES)]


class _Wide(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("evaluate", "arg", "res")]


_FUNCTIONS = ("coordinates", "output", "law", "step")
_BUFFERS = ("state", "measured", "memory", "next_state", "outputs", "record", "next_memory", "margins")
_SIZES = ("n_state", "n_memory", "n_outputs", "n_record", "n_margins", "n_measured")


class _SideBySide(ctypes.Structure):
    _fields_ = [
        *((name, _Wide) for name in _FUNCTIONS),
        ("car", ctypes.c_void_p * LANES),
        ("all", ctypes.c_void_p),
        ("n_all", ctypes.c_longlong),
        *((name, ctypes.c_void_p) for name in ("places", "rows", "shares", *_BUFFERS)),
        *((name, ctypes.c_longlong) for name in _SIZES),
        ("sensed", ctypes.c_void_p),
    ]


def _loaded(text: str, level: str = "-Og") -> ctypes.CDLL:
    library = codegen.library(text, level=level)
    assert library is not None, "exchanges that go side by side are compiled"
    return library


@lru_cache(maxsize=2)
def _car(two_stage: bool) -> ctypes.CDLL:
    return _loaded(_car_text(two_stage), "-O1")  # half the time of -Og to run, half of -O2 to compile


@codegen.stored
def _car_text(two_stage: bool) -> str:
    return codegen.wide_text(stepper.functions(two_stage))


@lru_cache
def _law(function: ca.Function) -> ctypes.CDLL:
    return _loaded(codegen.wide_text([function]))


@lru_cache(maxsize=1)
def _driver() -> ctypes.CDLL:
    text = codegen.wide_text([]) + stepper.c_text() + Path(__file__).with_name("lanes.c").read_text()
    return _loaded(text)


def _aligned(n: int) -> np.ndarray:
    """Room for n numbers of every car, as vector registers want it."""
    room, line = np.zeros(n * LANES + 8), 64
    first = -room.ctypes.data % line // room.itemsize
    return room[first : first + n * LANES]


class SideBySide:
    """Buffers of up to `LANES` exchanges of one structure side by side.

    Parameters
    ----------
    exchanges : sequence of Exchange
        Compiled ones with the same `structure`.
    """

    def __init__(self, exchanges: Sequence[Exchange]):
        self.exchanges, first = tuple(exchanges), exchanges[0]
        owned = [each.buffers() for each in (*exchanges, *[first] * (LANES - len(exchanges)))]
        self._wide = {name: _aligned(array.size) for name, array in owned[0].items()}
        self._all = (_Beside * len(self._wide))(*(
            _Beside(wide.ctypes.data, wide.size // LANES, tuple(each[name].ctypes.data for each in owned))
            for name, wide in self._wide.items()
        ))  # fmt: skip
        self._owner = sorted((array.ctypes.data, array.nbytes, name) for name, array in owned[0].items())
        libraries = {"law": _law(first.control.function)}
        self._kept: list[Any] = []
        calls = [self._call(first.functions[name], libraries.get(name, _car(first.two_stage))) for name in _FUNCTIONS]
        pointers = [exchanges[i if i < len(exchanges) else 0].car.pointer for i in range(LANES)]
        cars = [ctypes.cast(pointer, ctypes.c_void_p).value for pointer in pointers if pointer is not None]
        rows, shares = first.car.cells_and_shares()
        sizes = [owned[0][name.removeprefix("n_")].size for name in _SIZES]
        self._sensed = np.array(first.sensed, dtype=np.int64)
        self._c = _SideBySide(
            *calls, (ctypes.c_void_p * LANES)(*cars), ctypes.addressof(self._all), len(self._all),
            self._wide["places"].ctypes.data, self._pointers(rows), self._pointers(shares),
            *(self._wide[name].ctypes.data for name in _BUFFERS), *sizes, self._sensed.ctypes.data,
        )  # fmt: skip
        self._done = (ctypes.c_longlong * LANES)()

    def run(self, n: int) -> list[np.ndarray]:
        """Up to n exchanges of each; what `Exchange.run` gives."""
        logs = [np.empty((n, len(each.columns))) for each in self.exchanges]
        pointers = (ctypes.c_void_p * LANES)(*(log.ctypes.data for log in logs))
        _driver().lanes_run(ctypes.byref(self._c), ctypes.c_longlong(n), pointers, self._done)
        return [each.took(log, done) for each, log, done in zip(self.exchanges, logs, self._done, strict=False)]

    def _place(self, array: np.ndarray | None) -> int | None:
        """Address side by side of an array of the first exchange, which may be part of a buffer."""
        if array is None:
            return None
        for address, length, name in self._owner:
            if 0 <= array.ctypes.data - address < length:
                return self._wide[name].ctypes.data + LANES * (array.ctypes.data - address)
        raise ValueError("a buffer of an exchange is not known")

    def _pointers(self, arrays: Sequence[np.ndarray | None]) -> int:
        self._kept.append((ctypes.c_void_p * len(arrays))(*map(self._place, arrays)))
        return ctypes.addressof(self._kept[-1])

    def _call(self, function: codegen.CompiledFunction, library: ctypes.CDLL) -> _Wide:
        evaluate = ctypes.cast(getattr(library, f"{function.name}_wide"), ctypes.c_void_p)
        return _Wide(evaluate, self._pointers(function.arguments), self._pointers(function.results))


class _Job:
    """A run on its way: what it asks for, what it got of that, how it ended."""

    def __init__(self, steps: Steps):
        self.steps, self.ended, self.outcome = steps, False, None
        self.rows: list[np.ndarray] = []
        self.error: BaseException | None = None
        self._go(lambda: next(steps))

    def _go(self, on: Callable) -> None:
        try:
            self.exchange, self.asked = on()
            self.rows = []
        except StopIteration as end:
            self.outcome, self.ended = end.value, True
        except BaseException as error:  # raised again in the thread of the task
            self.error, self.ended = error, True

    def take(self, rows: np.ndarray) -> None:
        """Rows of some exchanges."""
        self.asked -= len(rows)
        self.rows.append(rows)
        if self.exchange.ended or self.asked == 0:
            log = self.rows[0] if len(self.rows) == 1 else np.concatenate(self.rows)
            self._go(lambda: self.steps.send(log))


class _Meeting:
    """Runs of several threads, of which one works at a time."""

    def __init__(self, threads: int):
        self.turn, self.threads = threading.Condition(), threads
        self._jobs: list[_Job] = []
        self._beside: SideBySide | None = None

    def run(self, steps: Steps) -> Any:
        """Outcome of a run; the caller has the turn."""
        job = _Job(steps)
        self._jobs.append(job)
        while not job.ended:
            if len(self._jobs) < self.threads:
                self.turn.wait()
            else:
                self._advance()
                self.turn.notify_all()
        if job in self._jobs:
            self._jobs.remove(job)
        if job.error is not None:
            raise job.error
        return job.outcome

    def _advance(self) -> None:
        """Until a run ends: the one that came first, and others of its structure."""
        while not any(job.ended for job in self._jobs):
            kind = self._jobs[0].exchange.structure
            group = [job for job in self._jobs if job.exchange.structure == kind][:LANES]
            n = min(_BLOCK, *(job.asked for job in group))
            exchanges = tuple(job.exchange for job in group)
            if len(group) == 1 or kind is None:
                group[0].take(exchanges[0].run(n))
                continue
            if self._beside is None or self._beside.exchanges != exchanges:
                self._beside = SideBySide(exchanges)
            for job, rows in zip(group, self._beside.run(n), strict=True):
                job.take(rows)
        self._jobs = [job for job in self._jobs if not job.ended]


_meeting: _Meeting | None = None


def drive(steps: Steps) -> Any:
    """Outcome of a run: alone, or side by side with others of a `together`."""
    if _meeting is not None:
        return _meeting.run(steps)
    job = _Job(steps)
    while not job.ended:
        job.take(job.exchange.run(job.asked))
    if job.error is not None:
        raise job.error
    return job.outcome


def together(task: Callable, arguments: Sequence) -> list:
    """Evaluate `task` on each argument; the runs that they `drive` go side by side.

    Tasks take turns where they wait for exchanges, so no two of them work at a time.
    """
    global _meeting
    if len(arguments) < 2 or _meeting is not None or codegen.compiler() is None:
        return [task(argument) for argument in arguments]
    threads = min(2 * LANES, len(arguments))
    meeting, found, errors, left = _Meeting(threads), {}, [], iter(enumerate(arguments))

    def work() -> None:
        with meeting.turn:
            try:
                for i, argument in left:
                    found[i] = task(argument)
            except BaseException as error:  # reported by the caller
                errors.append(error)
                for _ in left:
                    pass
            finally:
                meeting.threads -= 1
                meeting.turn.notify_all()

    _meeting = meeting
    try:
        workers = [threading.Thread(target=work, daemon=True) for _ in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    finally:
        _meeting = None
    if errors:
        raise errors[0]
    return [found[i] for i in range(len(arguments))]
