"""Processes that end with those who started them, also when these were killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
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
