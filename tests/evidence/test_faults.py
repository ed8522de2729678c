"""Kill and Ctrl-C in a chain of one notebook: no process is left, products are complete, and the next run ends as if
nothing had happened."""

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
title = "writes a table and slowly a second one"
writes = ["data/results/one.csv", "data/results/two.csv"]
"""
FIRST = """from railrepro import paths
paths.product("data/results/one.csv").write_text("a\\n42.0\\n")
if (paths.ROOT / "hold").exists():
    (paths.ROOT / "held").touch()
    sum(range(10**12))  # in C, so it cannot be interrupted
paths.product("data/results/two.csv").write_text("b\\n" + "1\\n" * 20000)
"""


class Toy:
    """A checkout with one small notebook and this library."""

    def __init__(self, folder):
        self.folder = folder
        for name in ("notebooks", "data", "figures", "build", "temporary"):
            (folder / name).mkdir(parents=True)
        for name in ("railrepro", "Makefile", "environment.lock", "pyproject.toml"):
            (folder / name).symlink_to(paths.ROOT / name)
        (folder / "build/ready").touch()
        (folder / "notebooks/chain.toml").write_text(CHAIN)
        write_notebook(folder / "notebooks", [FIRST], "01_first")
        self.started().communicate()
        self.whole = self.products()

    def started(self, **options):
        """Start the chain in the environment of the caller without the variables of this project."""
        around = {key: text for key, text in os.environ.items() if not key.startswith(("RAILREPRO", "MAKE", "MFLAGS"))}
        around |= {"TMPDIR": str(self.folder / "temporary"), "RAILREPRO_ROOT": str(self.folder)}
        around |= {"RAILREPRO_CFLAGS": "-O0", "PYTHONDONTWRITEBYTECODE": "1"}
        options |= {"cwd": self.folder, "env": around, "start_new_session": True, "text": True}
        command = ["make", f"PY={sys.executable}", "VENV=build/ready", "figures"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, **options)

    def held(self, on_interrupt):
        """Start make and wait until its notebook is between its two products."""
        for name in ("build/stamps", "data/results", "figures"):  # all is stale, but compiled code stays
            shutil.rmtree(self.folder / name, ignore_errors=True)
        (self.folder / "held").unlink(missing_ok=True)
        (self.folder / "hold").touch()
        # a background job of a shell ignores Ctrl-C, and so do its children
        started = self.started(preexec_fn=partial(signal.signal, signal.SIGINT, on_interrupt))
        while not (self.folder / "held").exists():
            assert started.poll() is None
            time.sleep(0.1)
        return started

    def products(self):
        """Dict from the name of each file in data to its content."""
        return {file.name: file.read_bytes() for file in (self.folder / "data").rglob("*") if file.is_file()}

    def survives(self):
        """No process is left, no product is half-written, and the next run completes all products."""
        inside = str(self.folder)
        while [one for one in psutil.process_iter(["cwd"]) if (one.info["cwd"] or "").startswith(inside)]:
            time.sleep(0.1)  # until the time limit of the test
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


def test_a_kill_of_make_ends_its_processes(toy):
    started = toy.held(signal.SIG_IGN)
    started.kill()
    assert "Traceback" not in started.communicate()[1]
    toy.survives()


def test_ctrl_c_prints_one_sentence(toy):
    started = toy.held(signal.SIG_DFL)
    os.killpg(started.pid, signal.SIGINT)
    lines = started.communicate()[1].splitlines()
    expected = "make", "interrupted", "01_"
    assert not [line for line in lines if not line.startswith(expected) and "stale" not in line], lines
    toy.survives()
