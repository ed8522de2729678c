"""One executor for all parallel studies: local processes, or a Dask cluster when configured.

Set `RAILREPRO_DASK=tcp://host:port` to use a running Dask scheduler; without it, one process per core is used
(`RAILREPRO_WORKERS` changes the number). Results never depend on the choice, because seeds belong to the task.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import lru_cache

from tqdm import tqdm

from railrepro.errors import InputError


@contextmanager
def executor() -> Iterator[Executor]:
    """The configured executor. Local processes stay for the next block, as starting them takes seconds; a block that
    ends with an exception (also Ctrl-C) ends them.
    """
    address = os.environ.get("RAILREPRO_DASK")
    if address:
        try:
            from distributed import Client
        except ImportError as error:
            raise InputError("RAILREPRO_DASK is set, but the package distributed is not installed") from error
        try:
            client = Client(address, timeout=10)
        except (OSError, ValueError) as error:
            raise InputError(f"no Dask scheduler answers at RAILREPRO_DASK={address} ({error})") from error
        with client:
            yield client.get_executor(pure=False)
        return
    workers = os.environ.get("RAILREPRO_WORKERS", str(os.cpu_count() or 1))
    if not workers.isdigit() or int(workers) < 1:
        raise InputError(f"RAILREPRO_WORKERS={workers!r}, a whole number from 1 is needed")
    try:
        yield _processes(int(workers))
    except BaseException:
        _processes(int(workers)).shutdown(wait=False, cancel_futures=True)
        _processes.cache_clear()
        raise


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
    """Evaluate `task` on each argument with a progress bar.

    Parameters
    ----------
    pool : Executor
    task : callable
        Picklable function of one argument.
    arguments : sequence
    title : str
        Text of the progress bar.
    quiet : bool
        No progress bar.

    Returns
    -------
    list
        Results in the order of the arguments.
    """
    futures = {pool.submit(task, argument): i for i, argument in enumerate(arguments)}
    results = [None] * len(futures)
    for future in tqdm(as_completed(futures), total=len(futures), desc=title, disable=quiet, leave=False):
        results[futures[future]] = future.result()
    return results
