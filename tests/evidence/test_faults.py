"""Faults on purpose in a small chain of notebooks: kills, Ctrl-C, a full disk.

Survived means: one sentence where a person is told, products whole, no process left, and the next run ends as if
nothing had been.
"""

import contextlib
import hashlib
import os
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
title = "draws a figure"
writes = ["data/results/three.csv"]
figures = ["fig01_three"]
"""
FIRST = """import casadi as ca
import time
from railrepro import paths
from railrepro.compile import codegen
x = ca.SX.sym("x")
twice = codegen.compiled(ca.Function("twice", [x], [2 * x]))
twice.arguments[0][:] = 21.0
paths.product("data/results/one.csv").write_text(f"a\\n{twice()[0][0]}\\n")
while (paths.ROOT / "hold").exists(): (paths.ROOT / "held").touch(), HOLD
paths.product("data/results/two.csv").write_text("b\\n" + "1\\n" * 20000)
"""
SECOND = """from railrepro import paths
for product in ("data/results/three.csv", "figures/fig01_three.png", "figures/fig01_three.csv"):
    paths.product(product).write_text("c\\n3\\n")
"""
HOLDS = {"in Python": "time.sleep(0.1)", "in C": "sum(range(10**12))"}
"""How the first notebook waits in its middle while there is a file `hold`."""


class Toy:
    """A checkout with two small notebooks and the library of this one."""

    def __init__(self, folder):
        self.folder = folder
        for name in ("notebooks", "data", "figures", "build"):
            (folder / name).mkdir(parents=True)
        shutil.copytree(paths.ROOT / "railrepro", folder / "railrepro", ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("Makefile", "environment.lock", "pyproject.toml"):
            (folder / name).symlink_to(paths.ROOT / name)
        (folder / "build/ready").touch()
        (folder / "notebooks/chain.toml").write_text(CHAIN)
        write_notebook(folder / "notebooks", [FIRST.replace("HOLD", HOLDS["in Python"])], "01_first")
        write_notebook(folder / "notebooks", [SECOND], "02_second")
        self.run("figures")
        self.whole = self.products()

    def environment(self):
        """That of the caller without what this project sets, and without optimisation."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("RAILREPRO", "MAKE", "MFLAGS"))}
        return kept | {"RAILREPRO_CFLAGS": "-O0", "PYTHONDONTWRITEBYTECODE": "1"}

    def run(self, *goals, code=0):
        """What make says; it ends with this code and without a traceback."""
        command = [*MAKE, *goals]
        done = subprocess.run(command, cwd=self.folder, env=self.environment(), capture_output=True, text=True)
        said = done.stdout + done.stderr
        assert "Traceback" not in said and code in (None, done.returncode), said[-1500:]
        return said

    def held(self, **options):
        """A run of make whose first notebook waits in its middle."""
        self.forget()
        (self.folder / "held").unlink(missing_ok=True)
        (self.folder / "hold").touch()
        started = subprocess.Popen(
            [*MAKE, "figures"], cwd=self.folder, env=self.environment(), stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, start_new_session=True, text=True, **options,
        )  # fmt: skip
        while not (self.folder / "held").exists():
            assert started.poll() is None
            time.sleep(0.1)
        return started

    def forget(self):
        """Make everything stale, but keep compiled code."""
        shutil.rmtree(self.folder / "build/stamps", ignore_errors=True)
        for name in ("data/results", "figures"):
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def products(self):
        """Hashes of all that lies in data and figures."""
        files = [file for top in ("data", "figures") for file in (self.folder / top).rglob("*") if file.is_file()]
        return {str(f.relative_to(self.folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in sorted(files)}

    def processes(self):
        """Processes that work in the checkout."""
        found = psutil.process_iter(["cwd", "cmdline"])
        return [process for process in found if (process.info["cwd"] or "").startswith(str(self.folder))]

    def survives(self):
        """Nothing runs on, no product is half-written, and the next run makes all whole and leaves nothing behind."""
        while self.processes():  # the time limit of a test ends what never ends
            time.sleep(0.1)
        for name, digest in self.products().items():
            assert name.endswith(("MANIFEST.csv", ".part")) or self.whole[name] == digest, f"{name} is half-written"
        (self.folder / "hold").unlink(missing_ok=True)
        self.run("figures")
        assert self.products() == self.whole
        left = [f for place in ("build", "data", "figures") for f in (self.folder / place).rglob("*")
                if f.suffix in (".part", ".scratch", ".lock") and f.name != "chain.lock"]  # fmt: skip
        assert not left and "running" not in self.run("figures")


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    return Toy(tmp_path_factory.mktemp("faults") / "toy")


@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("victim", "how"), [*((v, "in Python") for v in ("make", "everything at once", "the kernel")), ("make", "in C")]
)
def test_a_kill(victim, how, toy):
    """Where interrupts are ignored, as behind `&` in a shell."""
    write_notebook(toy.folder / "notebooks", [FIRST.replace("HOLD", HOLDS[how])], "01_first")
    started = toy.held(preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_IGN))
    if victim == "make":
        started.kill()
    elif victim == "everything at once":
        os.killpg(started.pid, signal.SIGKILL)
    else:
        for process in toy.processes():
            if "ipykernel_launcher" in process.info["cmdline"]:
                process.kill()
    assert "Traceback" not in started.communicate()[1]
    write_notebook(toy.folder / "notebooks", [FIRST.replace("HOLD", HOLDS["in Python"])], "01_first")
    toy.survives()


@pytest.mark.timeout(300)
def test_an_interrupt_is_told_in_one_sentence(toy):
    started = toy.held()
    os.killpg(started.pid, signal.SIGINT)
    said = started.communicate()[1].splitlines()
    expected = "make", "interrupted", "01_", "02_"
    assert not [line for line in said if not line.startswith(expected) and "stale" not in line], said
    toy.survives()


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A checkout in a file system of 12 MB."""
    mounted = tmp_path_factory.mktemp("small")
    mount = ["mount", "-t", "tmpfs", "-o", "size=12m", "railrepro-faults", str(mounted)]
    if os.getuid() or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("a small file system can be mounted by root only")
    yield Toy(mounted / "toy")
    subprocess.run(["umount", "-l", str(mounted)])


@pytest.mark.parametrize("room", [0, 3000, 30_000, 120_000])
def test_a_full_disk(room, small):
    """With so many bytes left: one sentence, products whole; with room again it goes on."""
    small.forget()
    ballast, free = small.folder / "ballast", os.statvfs(small.folder)
    with contextlib.suppress(OSError):
        ballast.write_bytes(b"\0" * max(0, free.f_bavail * free.f_frsize - room))
    said = small.run("figures", code=None)
    assert [line for line in said.splitlines() if "error: " in line] or not small.products().keys() ^ small.whole.keys()
    ballast.unlink()
    small.survives()
