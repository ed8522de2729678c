"""Parallel studies: tasks that run in threads, and simulations that processes or a Dask cluster compute for them. A
thread of `ordered_map` reads results from `store`, and hands what is missing to a process with `work`. Other threads
run only while it waits, because two threads must not use CasADi's objects at a time. Results do not depend on the
number of processes or the cluster, because random seeds belong to the task."""

import multiprocessing
import os
import re
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
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
_FEW = 4  # Largest number of tasks for which no processes are started: that would take longer than the tasks
_around = threading.local()  # Has the attribute `pool`, an executor, in the threads of `ordered_map`
_turn = threading.Lock()
"""Held by the thread of `ordered_map` that runs: reference counts of CasADi's objects are not atomic."""


def workers() -> int:
    """Number of local processes for simulations: environment variable RAILREPRO_WORKERS, 1 to 4096, default one per
    core. InputError for another value."""
    given = os.environ.get("RAILREPRO_WORKERS", str(os.cpu_count() or 1))
    if not (given.isascii() and given.isdigit() and 1 <= int(given) <= 4096):
        raise InputError(f"RAILREPRO_WORKERS={given!r}, a whole number from 1 to 4096 is needed")
    return int(given)


@contextmanager
def executor() -> Iterator[futures.Executor]:
    """Context manager of the processes that compute simulations: processes of the Dask scheduler at the address in the
    environment variable RAILREPRO_DASK, or else local ones (`workers`). Local ones stay for the next study; an
    exception (also Ctrl-C) ends them. InputError if no scheduler answers, or the package distributed is missing."""
    if address := os.environ.get("RAILREPRO_DASK"):
        with _client(address) as client:
            yield client.get_executor(pure=False, retries=0)
        return
    pool = _processes(workers())
    try:
        yield pool
    except BaseException:
        _processes.cache_clear()
        _kill(pool)
        raise


def _client(address: str):
    """Client of the Dask scheduler at an address."""
    if not re.fullmatch(r"(tcp|tls|ucx|wss?)://[^/\s]+:\d+", address):
        needed = "the address of a Dask scheduler such as tcp://127.0.0.1:8786 is needed"
        raise InputError(f"RAILREPRO_DASK={address!r}, {needed}")
    try:
        from distributed import Client

        return Client(address, timeout=10, set_as_default=False)
    except ImportError as error:
        needed = "the package distributed is needed (pip install railrepro[cluster])"
        raise InputError(f"RAILREPRO_DASK is set, for which {needed}: {error}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"no Dask scheduler answers at RAILREPRO_DASK={address}: {error}") from error


def _pool(workers: int) -> futures.ProcessPoolExecutor:
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        os._exit(1)  # a process of a study that reads a script without guard; `_ENDED` says what to do
    context = multiprocessing.get_context("spawn")
    return futures.ProcessPoolExecutor(workers, mp_context=context, initializer=_follow_the_parent)


_processes = lru_cache(_pool)


def _kill(pool: futures.ProcessPoolExecutor) -> None:
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    for process in processes:
        process.kill()


def _follow_the_parent() -> None:
    """Ignore interrupts, which the parent process handles, and end with it, also when it is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None, "this runs in a worker"

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _pools(apart: bool) -> Iterator[list[futures.Executor]]:
    """Context manager of the executors of the threads of a study, one for each thread."""
    if apart and not os.environ.get("RAILREPRO_DASK"):
        local = [_pool(1) for _ in range(workers())]
        try:
            yield [*local]
        finally:
            for pool in local:
                _kill(pool)
        return
    with executor() as shared:
        cluster = getattr(shared, "_client", None)
        processes = max(len(cluster.ncores()), 1) if cluster else getattr(shared, "_max_workers", 1)
        yield 2 * processes * [shared]  # so that each process finds its next run waiting


def ordered_map(task: Callable, arguments: Sequence, title: str, quiet: bool = False, apart: bool = False) -> list:
    """Call `task` with each of `arguments` in parallel; returns the results in the order of the arguments. Each call
    runs in a thread; what it calls by `work` runs in a process: of a pool on this machine (`workers` of them), or of
    the Dask cluster in the environment variable RAILREPRO_DASK. Without a cluster, up to 4 arguments (any number if
    `workers` is 1) are computed in this process, unless a pool runs already. With `apart`, also for few arguments, each
    thread has a local process of its own, which ends with the study: for code that may end its process or never return;
    a cluster ignores `apart`. `title` names the progress bar, `quiet` leaves it out. A task must not call
    `ordered_map`. InputError when a process ended or imported another version of railrepro."""
    assert not hasattr(_around, "pool"), "a task would wait for itself"
    local = not apart and not os.environ.get("RAILREPRO_DASK") and not _processes.cache_info().currsize
    if local and (len(arguments) <= _FEW or workers() == 1):
        return [task(argument) for argument in tqdm(arguments, title, leave=False, disable=quiet, delay=2.0)]

    def called(argument):
        with _turn:
            return task(argument)

    with _pools(apart) as pools:
        threads = futures.ThreadPoolExecutor(len(pools), initializer=lambda: setattr(_around, "pool", pools.pop()))
        try:
            calls = [threads.submit(called, argument) for argument in arguments]
            for done in tqdm(futures.as_completed(calls), title, len(calls), leave=False, disable=quiet):
                done.result()
            return [one.result() for one in calls]
        except (futures.BrokenExecutor, futures.CancelledError) as error:
            raise InputError(_LOST if os.environ.get("RAILREPRO_DASK") else _ENDED) from error
        finally:
            threads.shutdown(wait=False, cancel_futures=True)


def work(function: Callable, *arguments, limit: float | None = None):
    """Return `function(*arguments)`. In a task of `ordered_map` a process of `executor` computes it, else this one. In
    a task: TimeoutError after `limit` seconds, BrokenExecutor when the process ended."""
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
    """Result of a function; InputError where this process imported other code than `asked` (`_code`)."""
    if _code(function) != asked:
        raise InputError(_OTHER_CODE)
    return function(*arguments)
