"""Faults on purpose in a small chain of notebooks: kills, Ctrl-C, a disk that takes no more.

Survived means: one sentence where a person is told, products whole, no process left, and the next run ends as if
nothing had been.
"""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from functools import partial

import psutil
import pytest
from chapters import write_notebook

from railrepro import paths

pytestmark = pytest.mark.slow
MAKE = ["make", "--no-print-directory", "-j2", f"PY={sys.executable}", "VENV=build/ready"]
CHAIN = """
[[notebook]]
name = "01_first"
title = "writes a table and, slowly, a second one"
writes = ["data/results/one.csv", "data/results/two.csv"]
[[notebook]]
name = "02_second"
title = "writes a third one"
writes = ["data/results/three.csv"]
"""
FIRST = """import casadi as ca
import time
from railrepro import paths
from railrepro.compile import codegen
x = ca.SX.sym("x")
twice = codegen.compiled(ca.Function("twice", [x], [2 * x]))
twice.arguments[0][:] = 21.0
paths.product("data/results/one.csv").write_text(f"a\\n{twice()[0][0]}\\n")
while (hold := paths.ROOT / "hold").exists():
    (paths.ROOT / "held").touch()
    time.sleep(0.1) if hold.read_text() == "in Python" else sum(range(10**12))
paths.product("data/results/two.csv").write_text("b\\n" + "1\\n" * 20000)
"""
SECOND = "from railrepro import paths\npaths.product('data/results/three.csv').write_text('c')"


class Toy:
    """A checkout with two small notebooks and the library of this one."""

    def __init__(self, folder):
        self.folder = folder
        for name in ("notebooks", "data", "figures", "build"):
            (folder / name).mkdir(parents=True)
        for name in ("railrepro", "Makefile", "environment.lock", "pyproject.toml"):
            (folder / name).symlink_to(paths.ROOT / name)
        (folder / "build/ready").touch()
        (folder / "notebooks/chain.toml").write_text(CHAIN)
        write_notebook(folder / "notebooks", [FIRST], "01_first")
        write_notebook(folder / "notebooks", [SECOND], "02_second")
        self.run()
        self.whole = self.products()

    def started(self, command=MAKE, **options):
        """A run of the chain in the environment of the caller without what this project sets."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("RAILREPRO", "MAKE", "MFLAGS"))}
        own = {"RAILREPRO_ROOT": str(self.folder), "RAILREPRO_CFLAGS": "-O0", "PYTHONDONTWRITEBYTECODE": "1"}
        pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        around = {"cwd": self.folder, "env": kept | own, "start_new_session": True}
        return subprocess.Popen([*command, "figures"], **around, **pipes, **options)

    def run(self, command=MAKE, **options):
        """What it says; it leaves no traceback."""
        said = self.started(command, **options).communicate()[1]
        assert "Traceback" not in said, said[-1500:]
        return said

    def held(self, how="in Python", **options):
        """A run of make whose first notebook waits in its middle."""
        self.forget()
        (self.folder / "held").unlink(missing_ok=True)
        (self.folder / "hold").write_text(how)
        started = self.started(**options)
        while not (self.folder / "held").exists():
            assert started.poll() is None
            time.sleep(0.1)
        return started

    def forget(self):
        """Make everything stale, but keep compiled code."""
        for name in ("build/stamps", "data/results", "figures"):
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def products(self):
        """All that lies in data and figures."""
        files = [file for top in ("data", "figures") for file in (self.folder / top).rglob("*") if file.is_file()]
        return {str(file.relative_to(self.folder)): file.read_bytes() for file in files}

    def processes(self):
        """Processes that work in the checkout."""
        return [one for one in psutil.process_iter(["cwd"]) if (one.info["cwd"] or "").startswith(str(self.folder))]

    def survives(self):
        """Nothing runs on, no product is half-written, and the next run makes all whole and leaves nothing behind."""
        while self.processes():  # the time limit of a test ends what never ends
            time.sleep(0.1)
        for name, content in self.products().items():
            assert name.endswith(("MANIFEST.csv", ".part")) or self.whole[name] == content, f"{name} is half-written"
        (self.folder / "hold").unlink(missing_ok=True)
        self.run()
        assert self.products() == self.whole
        left = [file for file in self.folder.rglob("*") if file.suffix in (".part", ".scratch", ".lock")]
        assert {file.name for file in left} <= {"chain.lock", "environment.lock"} and "running" not in self.run()


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    return Toy(tmp_path_factory.mktemp("faults") / "toy")


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("victim", "how"),
    [("make", "in Python"), ("make", "in C"), ("everything at once", "in Python")],
)
def test_a_kill(victim, how, toy):
    """Where interrupts are ignored, as behind `&` in a shell."""
    started = toy.held(how, preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_IGN))
    if victim == "make":
        started.kill()
    else:
        os.killpg(started.pid, signal.SIGKILL)
    assert "Traceback" not in started.communicate()[1]
    toy.survives()


@pytest.mark.timeout(300)
def test_an_interrupt_is_told_in_one_sentence(toy):
    # a job in the background of a shell hands down that it ignores Ctrl-C
    started = toy.held(preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL))
    os.killpg(started.pid, signal.SIGINT)
    said = started.communicate()[1].splitlines()
    expected = "make", "interrupted", "01_", "02_"
    assert not [line for line in said if not line.startswith(expected) and "stale" not in line], said
    toy.survives()


@pytest.mark.parametrize("room", [0, 3000, 30_000])
def test_a_file_that_the_disk_does_not_take(room, toy):
    """No file may be larger, as on a full disk: one sentence, products whole; with room again it goes on.

    Without make, which lets Python write byte code, and that would be cut off.
    """
    toy.forget()
    command = [sys.executable, "-m", "railrepro"]
    said = toy.run(command, preexec_fn=partial(resource.setrlimit, resource.RLIMIT_FSIZE, (room, room)))
    assert [line for line in said.splitlines() if "error: " in line], said
    toy.survives()
