"""Faults on purpose in a chain of one notebook: kills and Ctrl-C.

Survived means: one sentence where a person is told, products whole, no process left, and the next run ends as if
nothing had been.
"""

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

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
CHAIN = """
[[notebook]]
name = "01_first"
title = "writes a table and, slowly, a second one"
writes = ["data/results/one.csv", "data/results/two.csv"]
"""
FIRST = """from railrepro import paths
paths.product("data/results/one.csv").write_text("a\\n42.0\\n")
if (paths.ROOT / "hold").exists():
    (paths.ROOT / "held").touch()
    sum(range(10**12))  # in C, which nothing interrupts
paths.product("data/results/two.csv").write_text("b\\n" + "1\\n" * 20000)
"""


class Toy:
    """A checkout with one small notebook and the library of this one."""

    def __init__(self, folder):
        self.folder = folder
        for name in ("notebooks", "data", "figures", "build"):
            (folder / name).mkdir(parents=True)
        for name in ("railrepro", "Makefile", "environment.lock", "pyproject.toml"):
            (folder / name).symlink_to(paths.ROOT / name)
        (folder / "build/ready").touch()
        (folder / "notebooks/chain.toml").write_text(CHAIN)
        write_notebook(folder / "notebooks", [FIRST], "01_first")
        self.started().communicate()
        self.whole = self.products()

    def started(self, **options):
        """A run of the chain in the environment of the caller without what this project sets."""
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("RAILREPRO", "MAKE", "MFLAGS"))}
        (self.folder / "temporary").mkdir(exist_ok=True)
        own = {
            "TMPDIR": str(self.folder / "temporary"),
            "RAILREPRO_ROOT": str(self.folder),
            "RAILREPRO_CFLAGS": "-O0",
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        command = ["make", f"PY={sys.executable}", "VENV=build/ready", "figures"]
        around = {"cwd": self.folder, "env": kept | own, "start_new_session": True, "stdout": subprocess.DEVNULL}
        return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **around, **options)

    def held(self, on_interrupt):
        """A run of make whose notebook waits in its middle."""
        self.forget()
        (self.folder / "held").unlink(missing_ok=True)
        (self.folder / "hold").touch()
        # a job in the background of a shell hands down that it ignores Ctrl-C
        started = self.started(preexec_fn=partial(signal.signal, signal.SIGINT, on_interrupt))
        while not (self.folder / "held").exists():
            assert started.poll() is None
            time.sleep(0.1)
        return started

    def forget(self):
        """Make everything stale, but keep compiled code."""
        for name in ("build/stamps", "data/results", "figures"):
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def products(self):
        """All that lies in data."""
        files = [file for file in (self.folder / "data").rglob("*") if file.is_file()]
        return {file.name: file.read_bytes() for file in files}

    def survives(self):
        """Nothing runs on, no product is half-written, and the next run makes all whole and leaves nothing behind."""
        inside = str(self.folder)
        while [one for one in psutil.process_iter(["cwd"]) if (one.info["cwd"] or "").startswith(inside)]:
            time.sleep(0.1)  # the time limit of a test ends what never ends
        for name, content in self.products().items():
            assert name.endswith(("MANIFEST.csv", ".part")) or self.whole[name] == content, f"{name} is half-written"
        (self.folder / "hold").unlink(missing_ok=True)
        self.started().communicate()
        assert self.products() == self.whole
        assert "running" not in self.started().communicate()[1] and not list(self.folder.rglob("*.part"))
        assert not list((self.folder / "temporary").glob("*railrepro*"))


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    return Toy(tmp_path_factory.mktemp("faults") / "toy")


def test_a_kill_of_make_ends_all_that_it_started(toy):
    started = toy.held(signal.SIG_IGN)
    started.kill()
    assert "Traceback" not in started.communicate()[1]
    toy.survives()


def test_an_interrupt_is_told_in_one_sentence(toy):
    started = toy.held(signal.SIG_DFL)
    os.killpg(started.pid, signal.SIGINT)
    said = started.communicate()[1].splitlines()
    expected = "make", "interrupted", "01_"
    assert not [line for line in said if not line.startswith(expected) and "stale" not in line], said
    toy.survives()
