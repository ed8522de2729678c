"""Parallel studies: functions called in threads, whose simulations are computed by processes or a Dask cluster.

Threads of `ordered_map` look results up in `store`; what they hand to `work` is computed by a process, and only
meanwhile do other threads run: two threads must not use CasADi's objects at a time. Results do not depend on the number
of processes or the cluster, because random seeds belong to the task.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    as_completed,
)
from contextlib import contextmanager
from functools import lru_cache

from tqdm import tqdm

from railrepro import code
from railrepro.data import InputError

_ENDED = (
    "a process of the study was killed, by the system when memory ran out or by a user: run again to resume; or the "
    'script that starts the study, which its processes read, calls the library outside of if __name__ == "__main__":'
)
_LOST = "the Dask cluster was lost; start it and run again to resume"
_OTHER_CODE = (
    "a process of the study imported other code of railrepro than the one that sends the runs, because it was edited "
    "meanwhile or another machine has another version; restart (in Jupyter the kernel) and run again to resume"
)

_NO_ADDRESS = "RAILREPRO_DASK={!r}, the address of a Dask scheduler such as tcp://127.0.0.1:8786 is needed"
_NO_DASK = "RAILREPRO_DASK is set, for which the package distributed is needed (pip install railrepro[cluster]): {}"

_FEW = 4
"""Number of tasks up to which this process computes them itself: processes of its own would start for longer."""
_around = threading.local()
"""In a thread of `ordered_map`: its `pool`."""
_turn = threading.Lock()
"""Held by the thread of `ordered_map` that runs: reference counts of CasADi's objects are not atomic."""


def workers() -> int:
    """Number of local processes: RAILREPRO_WORKERS, default one per core. InputError unless it is 1 to 4096."""
    given = os.environ.get("RAILREPRO_WORKERS", str(os.cpu_count() or 1))
    if not (given.isascii() and given.isdigit() and 1 <= int(given) <= 4096):
        raise InputError(f"RAILREPRO_WORKERS={given!r}, a whole number from 1 to 4096 is needed")
    return int(given)


@contextmanager
def executor() -> Iterator[Executor]:
    """Context manager of the processes that compute simulations, as an `Executor`.

    With the environment variable RAILREPRO_DASK, an address, the processes are those of this Dask scheduler. Else they
    are local (`workers`); they stay for the next study, and an exception (also Ctrl-C) ends them. InputError if the
    address is none, distributed is not installed, or the scheduler is silent.
    """
    if address := os.environ.get("RAILREPRO_DASK"):
        with _cluster(address) as pool:
            yield pool
        return
    pool = _processes(workers())
    try:
        yield pool
    except BaseException:
        _processes.cache_clear()
        _kill(pool)
        raise


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    if not re.fullmatch(r"(tcp|tls|ucx|wss?)://[^/\s]+:\d+", address):
        raise InputError(_NO_ADDRESS.format(address))
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError(_NO_DASK.format(error)) from error
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at RAILREPRO_DASK={address}: {error}") from error
    with client:
        yield client.get_executor(pure=False, retries=0)


def _pool(workers: int) -> ProcessPoolExecutor:
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(1)  # a process of a study that reads a script without guard; `_ENDED` says what to do
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_follow_the_parent)


_processes = lru_cache(_pool)


def _kill(pool: ProcessPoolExecutor) -> None:
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()


@contextmanager
def _pools(apart: bool) -> Iterator[list[Executor]]:
    """Context manager of the executors of the threads of a study, one for each thread."""
    if apart and not os.environ.get("RAILREPRO_DASK"):
        own = [_pool(1) for _ in range(workers())]
        try:
            yield [*own]
        finally:
            for pool in own:
                _kill(pool)
        return
    with executor() as shared:
        cluster = getattr(shared, "_client", None)
        processes = max(len(cluster.ncores()), 1) if cluster else getattr(shared, "_max_workers", 1)
        yield 2 * processes * [shared]  # so that each process finds its next run waiting


def _follow_the_parent() -> None:
    """Leave interrupts to the parent process, and end with it, also when it was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None, "this runs in a worker"

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def ordered_map(task: Callable, arguments: Sequence, title: str, quiet: bool = False, apart: bool = False) -> list:
    """Call `task` with each of `arguments` in parallel; returns the results in the order of the arguments.

    Each call has a thread of its own; the processes of `executor` compute what it hands to `work`. A few tasks, and all
    of them where there is one process, are computed here. With `apart` they are not: each thread has a local process of
    its own, for code that may end its process or never come back, and all of these end with the study. `title` names
    the progress bar, `quiet` leaves it out. A task must not call `ordered_map`. InputError when a process ended or
    imported another version of railrepro.
    """
    assert not hasattr(_around, "pool"), "a task would wait for itself"
    local = not apart and not os.environ.get("RAILREPRO_DASK") and not _processes.cache_info().currsize
    if local and (len(arguments) <= _FEW or workers() == 1):
        return [task(argument) for argument in tqdm(arguments, title, leave=False, disable=quiet, delay=2.0)]

    def called(argument):
        with _turn:
            return task(argument)

    with _pools(apart) as pools:
        threads = ThreadPoolExecutor(len(pools), initializer=lambda: setattr(_around, "pool", pools.pop()))
        try:
            futures = [threads.submit(called, argument) for argument in arguments]
            for done in tqdm(as_completed(futures), title, len(futures), leave=False, disable=quiet):
                done.result()
            return [future.result() for future in futures]
        except (BrokenExecutor, CancelledError) as error:
            raise InputError(_LOST if os.environ.get("RAILREPRO_DASK") else _ENDED) from error
        finally:
            threads.shutdown(wait=False, cancel_futures=True)


def work(function: Callable, *arguments, limit: float | None = None):
    """Return `function(*arguments)`; in a task of `ordered_map` a process of `executor` computes it, else this one.

    In a task TimeoutError after `limit` seconds, and BrokenExecutor when the process ended.
    """
    pool = getattr(_around, "pool", None)
    if pool is None:
        return function(*arguments)
    future = pool.submit(_checked, _code(function), function, *arguments)
    _turn.release()  # others run while this one waits
    try:
        return future.result(limit)
    finally:
        _turn.acquire()


def _code(function: Callable) -> tuple[str, str]:
    """Hashes of the code that this process imported, as far as a function can reach it."""
    return code.version(), code.reached_from(function.__module__)


def _checked(asked: tuple, function: Callable, *arguments):
    """Result of a function; InputError where this process imported other code than was asked."""
    if _code(function) != asked:
        raise InputError(_OTHER_CODE)
    return function(*arguments)
