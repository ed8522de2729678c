"""Parallel studies: plain functions side by side, whose runs go to local processes or to a Dask cluster.

`ordered_map` calls a function of each argument in a thread of its own. What such a function hands to `work` is computed
by a process, and only then do others of these threads run: CasADi's objects must not be used by two threads at a time.
Results are looked up and stored by the caller (`store`), so that a worker needs neither disk nor folder.
Set `RAILREPRO_DASK=tcp://host:port` to use a running Dask scheduler; without it, one process per core is used
(`RAILREPRO_WORKERS` changes the number). Results never depend on the choice, because seeds belong to the task.
"""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager, suppress
from functools import lru_cache

from tqdm import tqdm

from railrepro import code
from railrepro.data import InputError

PATIENCE = 15.0
"""Time without scheduler or worker after which a cluster is lost (s)."""
_LOOK = 1.0
"""Time between two looks at the cluster (s)."""
_ENDED = (
    "a process of the study was killed, by the system when memory ran out or by a user: run again to resume; or the "
    'script that starts the study, which its processes read, calls the library outside of if __name__ == "__main__":'
)
_LOST = "the Dask scheduler, or all its workers, are lost; start them and run again to resume"
_OTHER_CODE = (
    "a process of the study imported other code of railrepro than the one that sends the runs: it was edited "
    "meanwhile, or another machine has another version; restart both (in Jupyter the kernel) and run again to resume"
)


class _Around(threading.local):
    """What a thread of `ordered_map` works for."""

    pool: Executor | None = None
    ended: threading.Event


_around = _Around()
_turn = threading.Lock()
"""Held by the thread of `ordered_map` that runs: reference counts of CasADi's objects are not atomic."""


@contextmanager
def _waiting() -> Iterator[None]:
    """Let other threads run while this one waits."""
    held = _around.pool is not None
    if held:
        _turn.release()
    try:
        yield
    finally:
        if held:
            _turn.acquire()


@contextmanager
def executor() -> Iterator[Executor]:
    """The configured executor. Local processes stay for the next block, as starting them takes seconds; a block that
    ends with an exception (also Ctrl-C) ends them.

    Raises
    ------
    InputError
        When the settings are wrong, no Dask scheduler answers, or it is lost with all its workers.
    """
    address = os.environ.get("RAILREPRO_DASK")
    if address:
        with _cluster(address) as pool:
            yield pool
        return
    workers = os.environ.get("RAILREPRO_WORKERS", str(os.cpu_count() or 1))
    if not (workers.isascii() and workers.isdigit() and 1 <= int(workers) <= 4096):
        raise InputError(f"RAILREPRO_WORKERS={workers!r}, a whole number from 1 to 4096 is needed")
    pool = _processes(int(workers))
    try:
        yield pool
    except BaseException:
        _processes.cache_clear()
        processes = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()
        raise


@contextmanager
def _cluster(address: str) -> Iterator[Executor]:
    import logging

    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("RAILREPRO_DASK is set, but the package distributed is not installed") from error
    # what goes wrong is reported by `ordered_map`, in one sentence
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    logging.getLogger("tornado").setLevel(logging.CRITICAL)
    if not re.fullmatch(r"[a-z]+://[^/:\s]+:\d{1,5}/?", address):
        raise InputError(f"no Dask scheduler answers at RAILREPRO_DASK={address}, tcp://host:port is needed")
    try:
        client = Client(address, timeout=10, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at RAILREPRO_DASK={address} ({error})") from error
    try:
        yield client.get_executor(pure=False, retries=0)
    finally:
        with suppress(Exception):  # a lost scheduler cannot be left in order
            client.close(timeout=2)


@lru_cache
def _processes(workers: int) -> ProcessPoolExecutor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=context, initializer=_follow_the_parent)


def _follow_the_parent() -> None:
    """Leave interrupts to the parent process, and end with it, also when it was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None, "this runs in a worker"

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def ordered_map(pool: Executor, task: Callable, arguments: Sequence, title: str, quiet: bool = False) -> list:
    """Call `task` with each argument, side by side, with a progress bar.

    Parameters
    ----------
    pool : Executor
    task : callable
        Function of one argument; what it hands to `work` is computed by the processes of the pool.
    arguments : sequence
    title : str
        Text of the progress bar.
    quiet : bool
        No progress bar.

    Returns
    -------
    list
        Results in the order of the arguments.

    Raises
    ------
    InputError
        When a local process ended or runs other code, or the Dask scheduler or all its workers are lost for `PATIENCE`.
    """
    ended = threading.Event()
    threads = ThreadPoolExecutor(2 * max(_workers(pool), 1))  # so that each process finds its next run waiting
    try:
        futures = [threads.submit(_called, pool, ended, task, argument) for argument in arguments]
        with _waiting(), tqdm(total=len(futures), desc=title, disable=quiet, leave=False) as bar:
            _follow(pool, futures, bar)
        return [future.result() for future in futures]
    except (BrokenExecutor, CancelledError) as error:
        raise InputError(_ENDED if isinstance(pool, ProcessPoolExecutor) else _LOST) from error
    except Exception as error:
        if type(error).__module__.partition(".")[0] == "distributed":
            raise InputError(f"{_LOST} ({type(error).__name__})") from error
        raise
    finally:
        ended.set()
        threads.shutdown(wait=False, cancel_futures=True)


def _follow(pool: Executor, futures: list[Future], bar: tqdm) -> None:
    """Show how many are done until all are; raise what the first that fails raises."""
    waiting, seen = set(futures), time.monotonic()
    while waiting:
        done, waiting = wait(waiting, _LOOK, "FIRST_COMPLETED")
        for future in done:
            future.result()
        bar.update(len(done))
        if done or _workers(pool):
            seen = time.monotonic()
        elif time.monotonic() - seen > PATIENCE:
            raise InputError(_LOST)


def _workers(pool: Executor) -> int:
    """Number of the workers of a pool; 0 where a scheduler reports none or does not answer."""
    client = getattr(pool, "_client", None)
    if client is None:
        return getattr(pool, "_max_workers", 1)
    try:
        return len(client.sync(client.scheduler.identity, n_workers=-1, callback_timeout=5)["workers"])
    except TimeoutError:  # a scheduler that loads the modules of a task answers late; a lost one has no connection
        return int(client.status == "running")
    except Exception:  # any other error counts as no answer; time decides
        return 0


def _called(pool: Executor, ended: threading.Event, task: Callable, argument):
    """Result of a task, in a thread."""
    with _turn:
        _around.pool, _around.ended = pool, ended
        try:
            return task(argument)
        finally:
            _around.pool = None


def work(function: Callable, *arguments):
    """Result of a function of a module, from a process of the pool within `ordered_map`, else computed here."""
    if _around.pool is None:
        return function(*arguments)
    future = _around.pool.submit(_checked, _code(function), function, *arguments)
    with _waiting():
        while not wait([future], _LOOK).done:
            if _around.ended.is_set():  # whoever waits for this has gone; a lost cluster never answers
                raise CancelledError
    return future.result()


def _code(function: Callable) -> tuple[str | None, dict[str, str] | None]:
    """Code that this process imported, as far as a function can reach it."""
    return code.version(), code.reached(f"from {function.__module__} import {function.__module__}")


def _checked(asked: tuple, function: Callable, *arguments):
    """Result of a function; InputError where this process imported other code than was asked."""
    if None in asked or _code(function) != asked:
        raise InputError(_OTHER_CODE)
    return function(*arguments)
