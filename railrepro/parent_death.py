"""Processes that end with those who started them, also when these were killed; run as a script it holds one command.

As a script it is used without the library: `python parent_death.py PARENT COMMAND …`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

LEADER = "RAILREPRO_LEADER"
"""Environment variable with the process number of the make that started all."""
_LOOK = 0.5
"""Time between two looks (s)."""


def alive(process: int) -> bool:
    """Whether a process is there and no zombie."""
    try:
        os.kill(process, 0)
        with open(f"/proc/{process}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except ProcessLookupError:
        return False
    except OSError:  # of another user, or a system without /proc
        return True


def descendants(process: int) -> list[int]:
    """Processes that one has started, and those that they have; none on a system without /proc."""
    children: dict[int, list[int]] = {}
    for name in filter(str.isdigit, os.listdir("/proc") if os.path.isdir("/proc") else ()):
        with suppress(OSError), open(f"/proc/{name}/stat") as file:
            children.setdefault(int(file.read().rpartition(")")[2].split()[1]), []).append(int(name))
    found = [process]
    for parent in found:
        found += children.get(parent, [])
    return found[1:]


def follow(leader: int, end: Callable[[], None] = lambda: os._exit(1)) -> None:
    """End when another process does: from a thread call `end` then, and when it has not helped for
    2 s `os._exit`, with all that this one has started."""

    def watch() -> None:
        while alive(leader):
            time.sleep(_LOOK)
        end()
        time.sleep(2.0)
        for process in descendants(os.getpid()):  # some are in a long call and cannot look after themselves
            with suppress(OSError):
                os.kill(process, signal.SIGKILL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True, name="parent death").start()


def follow_make() -> None:
    """End like after Ctrl-C when the make that started this is no more; nothing without one."""
    leader = os.environ.get(LEADER, "")
    if leader.isdigit():
        follow(int(leader), lambda: os.kill(os.getpid(), signal.SIGINT))


def run(command: Sequence[str], seconds: float) -> tuple[int, str]:
    """Run a command that ends with this process, and all that it starts with it.

    Parameters
    ----------
    command : sequence of str
    seconds : float
        Time limit (s).

    Returns
    -------
    code : int
    told : str
        What it wrote to stderr.

    Raises
    ------
    TimeoutError
        When it takes longer.
    """
    held = [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]
    process = subprocess.Popen(
        held, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    )
    try:
        _, on_stderr = process.communicate(timeout=seconds)
    except BaseException as error:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        if isinstance(error, subprocess.TimeoutExpired):
            raise TimeoutError(f"took longer than {seconds:g} s") from None
        raise
    return process.returncode, on_stderr.decode(errors="replace")


def _hold(parent: int, command: Sequence[str]) -> int:
    follow(parent, lambda: os.killpg(0, signal.SIGKILL))
    return subprocess.call(command)


if __name__ == "__main__":
    try:
        sys.exit(_hold(int(sys.argv[1]), sys.argv[2:]))
    except OSError as error:
        sys.exit(f"{error}")
