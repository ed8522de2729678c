"""Workers that are lost, schedulers that are killed, and threads that must not matter."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from threading import Barrier, Thread

import pytest
from program import python

from railrepro import numerics, paths
from railrepro.data import InputError, alone
from railrepro.evidence.runs import executor as executors
from railrepro.evidence.runs.executor import executor, ordered_map, work


def wait_for(file):
    """Return when a file is there."""
    while not Path(file).exists():
        time.sleep(0.05)


def held_up(task):
    """A number after `released` is in a folder; until then a file says which process works on it."""
    folder, number = task
    Path(folder, str(os.getpid())).touch()
    wait_for(Path(folder, "released"))
    return number


def end_itself(_):
    """A worker that is killed."""
    os.kill(os.getpid(), signal.SIGKILL)


PRODUCT = """
import numpy as np
from railrepro.numerics import one_thread
x = np.random.default_rng(0).random(10**6)
with one_thread(): print(float(x @ x).hex())
"""


def test_the_last_digits_of_linear_algebra_do_not_depend_on_the_number_of_threads():
    few, more = (python("-c", PRODUCT, OMP_NUM_THREADS=n, OPENBLAS_NUM_THREADS=n).stdout for n in "12")
    assert few == more != ""


@pytest.mark.parametrize("given", [{}, {"OPENBLAS_CORETYPE": "Nehalem", "OMP_NUM_THREADS": "4"}])
def test_a_command_fixes_what_decides_the_last_digits_before_numpy_is_loaded(given, monkeypatch):
    script = (
        "import os, sys; from railrepro.__main__ import main; loaded = 'numpy' in sys.modules\n"
        "main(['score', '--describe']); print(loaded, *(os.environ.get(name, '') for name in sys.argv[1:]))"
    )
    names = [*numerics.ALWAYS, *numerics.WITH_AVX2]
    for name in names:
        monkeypatch.delenv(name, raising=False)
    done = python("-c", script, *names, **given)
    wanted = numerics.ALWAYS | dict.fromkeys(numerics.WITH_AVX2, "")
    if "avx2" in Path("/proc/cpuinfo").read_text():
        wanted |= numerics.WITH_AVX2 | {name: given[name] for name in given if name in numerics.WITH_AVX2}
    assert done.stdout.splitlines()[-1] == " ".join(["False", *wanted.values()])


def test_tasks_run_one_at_a_time_but_wait_side_by_side():
    """CasADi's objects must not be used by two threads at a time; a map within a task must not wait for itself."""
    inside, crowds, meeting = [], [], Barrier(4)

    def busy(number):
        inside.append(number)
        time.sleep(0.02)
        crowds.append(len(inside))
        inside.pop()
        return number

    def task(number):
        work(meeting.wait, 20)  # passes when all four tasks wait
        return busy(number) + sum(ordered_map(pool, busy, [1, 2], "inner", quiet=True))

    with ThreadPoolExecutor(4) as pool:
        assert ordered_map(pool, task, range(4), "outer", quiet=True) == [3, 4, 5, 6]
    assert set(crowds) == {1}, "two tasks ran side by side"


def test_a_killed_worker_is_told_in_one_sentence_and_the_next_study_has_others(monkeypatch):
    monkeypatch.setenv("RAILREPRO_WORKERS", "2")
    with pytest.raises(InputError, match="was killed"), executor() as pool:
        ordered_map(pool, partial(work, end_itself), [1, 2], "killed", quiet=True)
    with executor() as pool:
        assert ordered_map(pool, partial(work, abs), [0, -1], "again", quiet=True) == [0, 1]


def test_a_script_without_guard_is_told_what_to_do(tmp_path):
    script = tmp_path / "own.py"
    script.write_text(
        "from railrepro.evidence.runs.executor import executor, ordered_map, work\n"
        "with executor() as pool:\n    ordered_map(pool, lambda x: work(abs, x), [1, 2], 'own', quiet=True)\n"
    )
    done = python(str(script), RAILREPRO_WORKERS="2")
    assert done.returncode == 1 and 'calls the library outside of if __name__ == "__main__":' in done.stderr


HOLDING = """
import sys, time
from functools import partial
from pathlib import Path
from railrepro.data import alone
from railrepro.evidence.runs.executor import executor, ordered_map, work
def hold(lock):
    with alone(Path(lock)):
        Path(lock + ".held").touch()
        time.sleep(600)
if __name__ == "__main__":
    with executor() as pool:
        ordered_map(pool, partial(work, hold), sys.argv[1:], "hold", quiet=True)
"""


@pytest.mark.timeout(120)
def test_workers_end_with_a_killed_parent(tmp_path):
    script, locks = tmp_path / "hold.py", [tmp_path / "one", tmp_path / "two"]
    script.write_text(HOLDING)
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT), "RAILREPRO_WORKERS": "2"}
    parent = subprocess.Popen([sys.executable, str(script), *map(str, locks)], env=environment)
    for lock in locks:
        wait_for(f"{lock}.held")
    parent.kill()
    parent.wait()
    for lock in locks:
        with alone(lock):  # waits until its worker has ended
            pass


class Cluster:
    """A scheduler and two workers as processes."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = os.environ | {"PYTHONPATH": ":".join(sys.path)}
        self.processes = [self.started("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")]
        self.processes += [self.started("dask_worker", "--no-nanny", "--no-dashboard", "--nthreads", "1") for _ in "ab"]
        while not (folder / "scheduler.json").exists() or not (folder / "scheduler.json").read_text():
            time.sleep(0.1)
        self.address = json.loads((folder / "scheduler.json").read_text())["address"]
        with pytest.importorskip("distributed").Client(self.address) as client:
            client.wait_for_workers(len(self.processes) - 1, timeout=120)  # else the kill may come first

    def started(self, program, *options):
        """A process of Dask in a session of its own."""
        command = [sys.executable, "-m", f"distributed.cli.{program}", *options]
        command += ["--scheduler-file", str(self.folder / "scheduler.json")]
        quiet = {"env": self.environment, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen(command, cwd=self.folder, start_new_session=True, **quiet)

    def kill_at_work(self, folder, *which):
        """Kill some processes, from a thread, when both workers are at work; then let what is left go on."""

        def kill():
            for worker in self.processes[1:]:
                wait_for(folder / str(worker.pid))
            for i in which:
                os.killpg(self.processes[i].pid, signal.SIGKILL)
                self.processes[i].wait()
            if len(which) < 2 and which != (0,):
                (folder / "released").touch()

        thread = Thread(target=kill, daemon=True)
        thread.start()
        return thread


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    made = Cluster(tmp_path)
    monkeypatch.setenv("RAILREPRO_DASK", made.address)
    monkeypatch.setattr(executors, "PATIENCE", 5.0)
    yield made
    for process in made.processes:
        if process.poll() is None:
            process.kill()
            process.wait()


@pytest.mark.parametrize("lost", [(0,), (1, 2), (1,)], ids=["the scheduler", "all workers", "one worker"])
def test_a_lost_cluster_is_told_in_one_sentence_and_a_lost_worker_changes_nothing(lost, cluster, tmp_path, capfd):
    thread = cluster.kill_at_work(tmp_path, *lost)
    told = pytest.raises(InputError, match="are lost; start them and run again")
    with nullcontext() if lost == (1,) else told, executor() as pool:
        assert ordered_map(pool, partial(work, abs), [0, -1], "first", quiet=True) == [0, 1]
        held = [(str(tmp_path), i) for i in range(8)]
        assert ordered_map(pool, partial(work, held_up), held, "lost", quiet=True) == list(range(8))
    thread.join()
    assert "Traceback" not in "".join(capfd.readouterr())
