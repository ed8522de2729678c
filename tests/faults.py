"""Faults on purpose, in a small chain of notebooks: `make faults` prints what was tried and what survived it.

Kills at random seconds and in a long call, Ctrl-C, a full disk, a planted cache; `make faults SHORT=1` tries some of
them. Survived means: one sentence where a person is told, products whole, no process left, and the next run ends as if
nothing had been.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MAKE = ["make", "--no-print-directory", "-j2", f"PY={sys.executable}", "VENV=build/ready"]
CHAIN = """
[[notebook]]
name = "01_first"
title = "writes a table and, slowly, a second one"
writes = ["data/results/one.csv", "data/results/two.csv"]
minutes = 0.1
[[notebook]]
name = "02_second"
title = "reads the first table, draws a figure"
after = ["01_first"]
writes = ["data/results/three.csv"]
figures = ["fig01_three"]
minutes = 0.1
"""
FIRST = """import casadi as ca
import time
from railrepro import paths
from railrepro.compile import codegen
x = ca.SX.sym("x")
twice = codegen.compiled(ca.Function("twice", [x], [2 * x]))
twice.arguments[0][:] = 21.0
paths.product("data/results/one.csv").write_text(f"a\\n{twice()[0][0]}\\n")
time.sleep(1.0)
paths.product("data/results/two.csv").write_text("b\\n" + "1\\n" * 20000)
"""
SECOND = """from railrepro import paths
text = paths.source("data/results/one.csv").read_text()
paths.product("data/results/three.csv").write_text(text)
for suffix in ("png", "csv"):
    paths.product(f"figures/fig01_three.{suffix}").write_text(text)
"""


USUAL = 15.0
"""Time of the first run of the toy chain on an idle machine (s)."""
slow = 1.0
"""How many times slower this machine was at the first run; all times are that many times longer, and none shorter."""


def toy(folder: Path) -> Path:
    """A checkout with two small notebooks and the library of this one."""
    for name in ("notebooks", "data", "figures", "build"):
        (folder / name).mkdir(parents=True)
    shutil.copytree(ROOT / "railrepro", folder / "railrepro", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("Makefile", "environment.lock", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "build/ready").touch()
    (folder / "notebooks/chain.toml").write_text(CHAIN)
    for name, text in (("01_first", FIRST), ("02_second", SECOND)):
        cell = {"cell_type": "code", "id": "c01", "metadata": {}, "source": text}
        cell |= {"outputs": [], "execution_count": None}
        kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
        content = {"cells": [cell], "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
        (folder / f"notebooks/{name}.ipynb").write_text(json.dumps(content))
    return folder


class Lost(AssertionError):
    """What did not survive."""


def run(folder: Path, *goals: str, code: int | None = 0, seconds: float = 120, **environment: str) -> str:
    """Output of make in the toy checkout; it must end in time and with this code, and without a traceback."""
    done = subprocess.run(
        [*MAKE, *goals], cwd=folder, env=clean(environment), capture_output=True, text=True, timeout=slow * seconds
    )
    said = done.stdout + done.stderr
    if "Traceback" in said or (code is not None and done.returncode != code):
        raise Lost(f"make {' '.join(goals)} ended with {done.returncode}: {said[-1500:]}")
    return said


def clean(changes: dict) -> dict:
    """Environment without what this project sets, one thread, no optimisation."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("RAILREPRO", "MAKE", "MFLAGS"))}
    return kept | {"RAILREPRO_CFLAGS": "-O0", "PYTHONDONTWRITEBYTECODE": "1"} | changes


def products(folder: Path) -> dict[str, str]:
    """Hashes of all that lies in data and figures."""
    files = [file for top in ("data", "figures") for file in sorted((folder / top).rglob("*")) if file.is_file()]
    return {str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def leftovers(folder: Path) -> list[str]:
    """What killed processes left where runs write: scratch files, folders and locks."""
    patterns, places = ("*.part", "*.scratch", "*.lock", ".*.part"), ("build", "data", "figures")
    found = {path for place in places for pattern in patterns for path in (folder / place).rglob(pattern)}
    return sorted(str(path.relative_to(folder)) for path in found)


def processes(folder: Path) -> list[int]:
    """Processes that work in the toy checkout."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if Path(os.readlink(process / "cwd")).is_relative_to(folder):
                found.append(int(process.name))
        except OSError:
            continue
    return found


def check_whole(folder: Path, whole: dict[str, str]) -> None:
    """Each product is the old one or the new one, which are the same, or not there yet."""
    for name, digest in products(folder).items():
        if not name.endswith(("MANIFEST.csv", ".part")) and whole.get(name) != digest:
            raise Lost(f"{name} is half-written")


def check_next_run(folder: Path, whole: dict[str, str]) -> None:
    """The next run makes everything whole and leaves nothing behind."""
    run(folder, "figures")
    if products(folder) != whole:
        raise Lost("the next run gives other products")
    if leftovers(folder):
        raise Lost(f"left behind: {leftovers(folder)}")
    said = run(folder, "figures")
    if "running" in said:
        raise Lost("what was whole ran again")


def make_stale(folder: Path) -> None:
    """Forget runs and products, keep the compiled code now and then."""
    shutil.rmtree(folder / "build/stamps", ignore_errors=True)
    for name in ("data/results", "figures"):
        shutil.rmtree(folder / name, ignore_errors=True)
    if random.random() < 0.3:
        shutil.rmtree(folder / "build/compiled", ignore_errors=True)


def wait_for_orphans(folder: Path) -> None:
    """Nothing lives on for more than 5 s, longer on a busy machine."""
    end = time.monotonic() + 5.0 * slow
    while processes(folder) and time.monotonic() < end:
        time.sleep(0.1)
    if left := processes(folder):
        said = [Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:80] for process in left]
        for process in left:
            os.kill(process, signal.SIGKILL)
        raise Lost(f"orphans after {5.0 * slow:.0f} s: {said}")


def kill_at_random(folder: Path, whole: dict[str, str], victim: str, number: int) -> str:
    """Kill make, the process of a notebook or its kernel after some time."""
    random.seed(number)
    make_stale(folder)
    started = subprocess.Popen(
        [*MAKE, "figures"], cwd=folder, env=clean({}), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        start_new_session=True, text=True,
    )  # fmt: skip
    moment = slow * random.uniform(0.3, 9.0)
    try:
        started.wait(moment)
    except subprocess.TimeoutExpired:
        if victim == "make":
            started.kill()
        elif victim == "everything at once":
            os.killpg(started.pid, signal.SIGKILL)
        else:
            pattern = {"the notebook's process": b"railrepro\0chain\0one", "the kernel": b"ipykernel_launcher"}[victim]
            for process in processes(folder):
                try:
                    if pattern in Path(f"/proc/{process}/cmdline").read_bytes():
                        os.kill(process, signal.SIGKILL)
                except OSError:
                    continue
    if victim in ("make", "everything at once"):
        started.wait()
        wait_for_orphans(folder)
    said = started.communicate(timeout=60 * slow)[1]
    wait_for_orphans(folder)
    if "Traceback" in said:
        raise Lost(said[-1500:])
    check_whole(folder, whole)
    check_next_run(folder, whole)
    return f"after {moment:.1f} s"


def interrupt(folder: Path, whole: dict[str, str], number: int) -> str:
    """Ctrl-C: the whole group gets SIGINT; one sentence per process, no traceback, nothing left behind."""
    random.seed(100 + number)
    make_stale(folder)
    started = subprocess.Popen(
        [*MAKE, "figures"], cwd=folder, env=clean({}), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        start_new_session=True, text=True,
    )  # fmt: skip
    moment = slow * random.uniform(1.5, 7.0)
    try:
        started.wait(moment)
    except subprocess.TimeoutExpired:
        os.killpg(started.pid, signal.SIGINT)
    said = started.communicate(timeout=30 * slow)[1]
    wait_for_orphans(folder)
    strange = [
        line for line in said.splitlines()
        if not line.startswith(("make", "interrupted", "01_", "02_")) and "stale" not in line
    ]  # fmt: skip
    if strange:
        raise Lost("said " + " | ".join(strange)[:1500])
    check_whole(folder, whole)
    check_next_run(folder, whole)
    return f"after {moment:.1f} s"


def planted(folder: Path, whole: dict[str, str], how: str) -> None:
    """The cache holds what this user did not compile."""
    cache = folder / "build/compiled"
    for target in cache.glob("*.so"):
        if how == "cut off":
            target.write_bytes(target.read_bytes()[:5000])
        elif how == "another object with its own hash":
            subprocess.run(["cc", "-shared", "-fPIC", "-x", "c", "-", "-o", target], input=b"int x;", check=True)
        elif how == "of another user":
            os.chown(target, 65534, 65534)
        else:
            target.chmod(0o666)
            cache.chmod(0o777)
    shutil.rmtree(folder / "build/stamps")
    run(folder, "figures")
    if any(target.stat().st_uid != os.getuid() or target.stat().st_mode & 0o022 for target in cache.glob("*.so")):
        raise Lost("the planted object is still there")
    check_next_run(folder, whole)


def full_disk(folder: Path, whole: dict[str, str], room: int) -> str:
    """A file system with so many bytes left: one sentence, products whole; with room again it goes on."""
    ballast = folder / "ballast"
    make_stale(folder)
    free = os.statvfs(folder)
    try:
        with ballast.open("wb") as stream:
            stream.write(b"\0" * max(0, free.f_bavail * free.f_frsize - room))
    except OSError:
        pass
    said = run(folder, "figures", code=None)
    check_whole(folder, whole)
    ballast.unlink()
    check_next_run(folder, whole)
    sentences = [line for line in said.splitlines() if line.startswith("error: ") or "rror" in line]
    return sentences[0][:90] if sentences else "enough"


def only_shown(folder: Path, whole: dict[str, str]) -> None:
    """make -n changes nothing on disk."""
    shutil.rmtree(folder / "build/stamps", ignore_errors=True)
    before = {str(file): file.lstat().st_mtime_ns for file in folder.rglob("*")}
    for goal in ("figures", "fig01", "report", "html", "test"):
        run(folder, "-n", goal)
    if {str(file): file.lstat().st_mtime_ns for file in folder.rglob("*")} != before:
        raise Lost("make -n changed something")
    check_next_run(folder, whole)


LONG_CALL = "sum(range(10**10))"
"""Minutes in one call of C, during which no thread of the process comes to anything."""


def kill_in_a_long_call(folder: Path, whole: dict[str, str]) -> None:
    """Kill make where interrupts are ignored, as behind `&` in a shell, while a kernel cannot look after itself."""
    notebook = folder / "notebooks/01_first.ipynb"
    text = notebook.read_text()
    notebook.write_text(text.replace("time.sleep(1.0)", f"paths.product('data/here').touch(); {LONG_CALL}"))
    make_stale(folder)
    ignores = partial(signal.signal, signal.SIGINT, signal.SIG_IGN)
    started = subprocess.Popen(
        [*MAKE, "figures"], cwd=folder, env=clean({}), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True, preexec_fn=ignores,
    )  # fmt: skip
    end = time.monotonic() + 60 * slow
    while not list(folder.glob("build/staging/*/data/here")) and time.monotonic() < end:
        time.sleep(0.1)
    started.kill()
    started.wait()
    notebook.write_text(text)
    wait_for_orphans(folder)
    check_whole(folder, whole)
    check_next_run(folder, whole)


SHORT = ("kill make", "kill in a long call", "Ctrl-C number 1", "cache cut off")
"""What a short run tries, each by kind and name, once."""


def chosen_faults(folder: Path, small: Path | None, short: bool):
    """`all_faults`, or those of a short run."""
    left = set(SHORT)
    for kind, name, call in all_faults(folder, small):
        if not short:
            yield kind, name, call
        elif f"{kind} {name}" in left:
            left.remove(f"{kind} {name}")
            yield kind, name, call
            if not left:
                return


def all_faults(folder: Path, small: Path | None):
    """Kind, name and call of every fault, in the order in which they are tried."""
    global slow
    whole: dict[str, str] = {}
    begin = time.monotonic()
    run(folder, "figures", seconds=1800)
    slow = max(1.0, (time.monotonic() - begin) / USUAL)
    whole |= products(folder)
    for number in range(8):
        victim = ("make", "everything at once", "the notebook's process", "the kernel")[number % 4]
        yield "kill", victim, lambda v=victim, n=number: kill_at_random(folder, whole, v, n)
    yield "kill", "in a long call", lambda: kill_in_a_long_call(folder, whole)
    for number in range(3):
        yield "Ctrl-C", f"number {number + 1}", lambda n=number: interrupt(folder, whole, n)
    for how in ("cut off", "another object with its own hash", "open to others", "of another user"):
        if how != "of another user" or os.getuid() == 0:
            yield "cache", how, lambda h=how: planted(folder, whole, h)
    yield "make", "-n", lambda: only_shown(folder, whole)
    if small is not None:
        for room in (0, 3000, 30_000, 120_000):
            yield "full disk", f"{room} bytes left", lambda r=room: full_disk(small, whole, r)


def main() -> int:
    """Try all faults; 1 when one of them does not survive."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    if set(sys.argv[1:]) - {"--short"}:
        sys.exit("faults takes --short or nothing")
    short = "--short" in sys.argv
    parent = Path(tempfile.mkdtemp(prefix="railrepro-faults-"))
    mounted = parent / "small"
    mounted.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=12m", "railrepro-faults", str(mounted)]
    small = subprocess.run(mount, capture_output=True).returncode == 0 if os.getuid() == 0 and not short else False
    tried: dict[str, list[int]] = {}
    begin = time.monotonic()
    try:
        for kind, name, call in chosen_faults(toy(parent / "toy"), toy(mounted / "toy") if small else None, short):
            count = tried.setdefault(kind, [0, 0])
            try:
                said = call()
            except (Lost, subprocess.TimeoutExpired) as error:
                count[0] += 1
                print(f"LOST      {kind:9s} {name}: {error}", flush=True)
                continue
            if said is not False:
                count[0] += 1
                count[1] += 1
                print(f"survived  {kind:9s} {name} {said if isinstance(said, str) else ''}".rstrip(), flush=True)
    finally:
        if small:
            subprocess.run(["umount", "-l", str(mounted)])
        shutil.rmtree(parent, ignore_errors=True)
    print(f"\n{'fault':10s} tried survived")
    for kind, (number, survived) in tried.items():
        print(f"{kind:10s} {number:5d} {survived:8d}")
    number, survived = (sum(column) for column in zip(*tried.values(), strict=True))
    print(f"{'all':10s} {number:5d} {survived:8d}   {(time.monotonic() - begin) / 60:.1f} min")
    if not small and not short:
        print("no full disk was tried: a small file system can be mounted by root only")
    return int(survived < number)


if __name__ == "__main__":
    sys.exit(main())
