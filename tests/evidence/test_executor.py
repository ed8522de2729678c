"""Processes and threads of a study: results do not depend on them, and the loss of one is reported."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Barrier

import psutil
import pytest
from program import python

from railrepro import code, numerics, paths
from railrepro.data import InputError
from railrepro.studies import executor as executors
from railrepro.studies.executor import executor, ordered_map, work


@pytest.fixture(autouse=True)
def processes(monkeypatch):
    """Studies of any size have two processes of their own."""
    monkeypatch.setattr(executors, "_FEW", 0)
    monkeypatch.setenv("RAILREPRO_WORKERS", "2")


RUN = """
import numpy, hashlib
from railrepro import load_scenario, simulate, tuned
run = simulate(load_scenario("curve_entry_T3").but(end_m=20.0), tuned("lqg_preview"))
print(hashlib.sha256(run.series.to_numpy().tobytes()).hexdigest())
"""


def test_the_last_digits_of_a_run_do_not_depend_on_the_number_of_threads():
    few, more = (python("-c", RUN, OMP_NUM_THREADS=n, OPENBLAS_NUM_THREADS=n).stdout for n in "14")
    assert few == more != ""


@pytest.mark.parametrize("given", [{}, {"OPENBLAS_CORETYPE": "Nehalem", "OMP_NUM_THREADS": "4"}])
def test_a_command_fixes_what_decides_the_last_digits_before_numpy_is_loaded(given, monkeypatch):
    script = (
        "import os, sys; from railrepro.__main__ import main; loaded = 'numpy' in sys.modules\n"
        "main(['score', 'none']); print(loaded, *(os.environ.get(name, '') for name in sys.argv[1:]))"
    )
    names = [*numerics.ALWAYS, *numerics.WITH_AVX2]
    for name in names:
        monkeypatch.delenv(name, raising=False)
    done = python("-c", script, *names, **given)
    wanted = numerics.ALWAYS | dict.fromkeys(numerics.WITH_AVX2, "")
    if "avx2" in Path("/proc/cpuinfo").read_text():
        wanted |= numerics.WITH_AVX2 | {name: given[name] for name in given if name in numerics.WITH_AVX2}
    assert done.stdout.splitlines()[-1] == " ".join(["False", *wanted.values()])


def test_tasks_run_one_at_a_time_but_wait_side_by_side(monkeypatch):
    """CasADi's objects must not be used by two threads at a time."""
    inside, crowds, meeting = [], [], Barrier(4)

    def task(number):
        work(meeting.wait, 20)  # passes when all four tasks wait
        inside.append(number)
        time.sleep(0.02)
        crowds.append(len(inside))
        inside.pop()
        return number

    monkeypatch.setattr(executors, "executor", lambda: ThreadPoolExecutor(4))
    assert ordered_map(task, range(4), "outer", quiet=True) == [0, 1, 2, 3]
    assert set(crowds) == {1}, "two tasks ran side by side"


def test_a_killed_worker_is_reported_in_one_sentence_and_the_next_study_has_others():
    with pytest.raises(InputError, match="was killed"):
        ordered_map(partial(work, signal.raise_signal), [signal.SIGKILL], "killed", quiet=True)
    assert ordered_map(partial(work, abs), [0, -1], "again", quiet=True) == [0, 1]


def test_a_study_apart_has_processes_of_its_own_which_end_with_it(monkeypatch):
    """For code that may end its process or never come back."""
    monkeypatch.setattr(executors, "_FEW", 9)
    before = set(psutil.Process().children(recursive=True))
    assert os.getpid() not in ordered_map(lambda _: work(os.getpid), [0, 1], "apart", quiet=True, apart=True)
    for function, fault in ((partial(work, time.sleep, limit=1), TimeoutError), (partial(work, os._exit), InputError)):
        with pytest.raises(fault):
            ordered_map(function, [300], "apart", quiet=True, apart=True)
    left = set(psutil.Process().children(recursive=True)) - before
    assert not [one for one in psutil.wait_procs(left, timeout=60)[1] if "spawn_main" in " ".join(one.cmdline())]


def test_workers_of_other_code_are_refused(monkeypatch):
    """As those that start after an edit."""
    for version in ("other", None):
        monkeypatch.setattr(code, "version", lambda version=version: version)
        with pytest.raises(InputError, match="imported other code"):
            ordered_map(partial(work, abs), [0, -1], "other", quiet=True)


def test_a_script_without_guard_says_what_to_do(tmp_path):
    script = tmp_path / "own.py"
    script.write_text(
        "from railrepro.studies.executor import ordered_map, work\n"
        "ordered_map(lambda x: work(abs, x), range(8), 'own', quiet=True)\n"
    )
    done = python(str(script))
    assert done.returncode == 1 and 'calls the library outside of if __name__ == "__main__":' in done.stderr
    assert done.stderr.count("Traceback") <= 3, "the processes of the study say nothing"
    script.write_text(script.read_text().replace("range(8)", "range(4)"))
    assert python(str(script)).returncode == 0, "a few runs need no process of their own"


HOLDING = """
import os, time
from railrepro.studies.executor import ordered_map, work
def hold(_):
    os.write(1, f"{os.getpid()}\\n".encode())
    time.sleep(600)
if __name__ == "__main__":
    ordered_map(lambda number: work(hold, number), range(5), "hold", quiet=True)
"""


def test_workers_end_with_a_killed_parent(tmp_path):
    (tmp_path / "hold.py").write_text(HOLDING)
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)}
    command = [sys.executable, str(tmp_path / "hold.py")]
    parent = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    workers = [psutil.Process(int(parent.stdout.readline())) for _ in "ab"]
    parent.kill()
    assert not psutil.wait_procs(workers, timeout=120)[1]


def test_a_study_runs_on_a_dask_cluster(monkeypatch):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        monkeypatch.setenv("RAILREPRO_DASK", cluster.scheduler_address)
        assert ordered_map(partial(work, abs), [0, -1, 2], "first", quiet=True) == [0, 1, 2]
        assert os.getpid() not in ordered_map(lambda _: work(os.getpid), range(4), "elsewhere", quiet=True)
    monkeypatch.setenv("RAILREPRO_DASK", "tcp://127.0.0.1:1")
    with pytest.raises(InputError, match="no Dask scheduler answers at RAILREPRO_DASK"), executor():
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="the package distributed is needed"), executor():
        pass
