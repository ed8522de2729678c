"""What the process of a controller may do: compute, read files, answer. No sandbox, see `make score` in the guide.

Limits of the system bound processor, memory and written files; on Linux (x86-64) a filter of system calls also refuses
new processes, signals to others, sockets, foreign memory and changes of files.
"""

from __future__ import annotations

import ctypes
import faulthandler
import os
import platform
import resource
import signal
import sys

MEMORY = 2 * 2**30
"""Address space of a controller's process (bytes)."""
CHANNEL = 3
"""Descriptor of the socket to who asks."""
_REFUSED = {
    **{"clone": 56, "fork": 57, "vfork": 58, "execve": 59, "kill": 62, "tkill": 200, "tgkill": 234, "ptrace": 101},
    **{"clone3": 435, "execveat": 322, "rt_sigqueueinfo": 129, "rt_tgsigqueueinfo": 297, "pidfd_send_signal": 424},
    **{"process_vm_readv": 310, "process_vm_writev": 311, "socket": 41, "connect": 42, "io_uring_setup": 425},
    **{"truncate": 76, "rename": 82, "mkdir": 83, "rmdir": 84, "creat": 85, "link": 86, "unlink": 87, "symlink": 88},
    **{"chmod": 90, "unlinkat": 263, "renameat": 264, "linkat": 265, "symlinkat": 266, "fchmodat": 268},
    **{"mkdirat": 258, "renameat2": 316, "openat2": 437, "setrlimit": 160, "prlimit64": 302, "prctl": 157},
}
_OPEN = {"open": (2, 1), "openat": (257, 2)}
"""Number, and the argument that holds the flags."""
_CHANGES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
_X86_64 = 0xC000003E
_LOAD, _EQUAL, _ABOVE, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW, _REFUSE = 0x7FFF0000, 0x00050000 | 1  # EPERM
_PR_SET_PDEATHSIG, _PR_SET_SECCOMP, _PR_SET_NO_NEW_PRIVS = 1, 22, 38


def die_with_parent() -> None:
    """Have the system kill this process when the one that started it ends; Linux only."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)


def confine(processor: float, keep: int) -> None:
    """Bound this process for good.

    Parameters
    ----------
    processor : float
        Seconds of the processor.
    keep : int
        The descriptor that stays open as `CHANNEL`; 0, 1 and 2 lead nowhere.
    """
    os.setsid()
    die_with_parent()
    faulthandler.disable()
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.dup2(keep, CHANNEL)
    os.closerange(CHANNEL + 1, 65536)
    seconds = int(processor) + 1
    limits = {"CPU": (seconds, seconds + 5), "AS": (MEMORY, MEMORY), "FSIZE": (0, 0), "CORE": (0, 0), "NPROC": (0, 0)}
    for name, limit in limits.items():
        if hasattr(resource, f"RLIMIT_{name}"):
            resource.setrlimit(getattr(resource, f"RLIMIT_{name}"), limit)
    for number in (signal.SIGXCPU, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    if sys.platform == "linux" and platform.machine() == "x86_64":
        _filter()


class _Instruction(ctypes.Structure):
    _fields_ = (("code", ctypes.c_uint16), ("yes", ctypes.c_uint8), ("no", ctypes.c_uint8), ("k", ctypes.c_uint32))


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_uint16), ("first", ctypes.POINTER(_Instruction)))


def _filter() -> None:
    """Load the filter of system calls; where the system has none, nothing changes. Source: seccomp(2)."""
    steps = [(_LOAD, 0, 0, 4), (_EQUAL, 1, 0, _X86_64), (_RETURN, 0, 0, _REFUSE), (_LOAD, 0, 0, 0)]
    steps += [(_ABOVE, 0, 1, 0x40000000), (_RETURN, 0, 0, _REFUSE)]
    for number in _REFUSED.values():
        steps += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _REFUSE)]
    for number, flags in _OPEN.values():
        steps += [(_EQUAL, 0, 4, number), (_LOAD, 0, 0, 16 + 8 * flags)]
        steps += [(_ANY_BIT, 0, 1, _CHANGES), (_RETURN, 0, 0, _REFUSE), (_RETURN, 0, 0, _ALLOW)]
    steps.append((_RETURN, 0, 0, _ALLOW))
    program = _Program(len(steps), (_Instruction * len(steps))(*steps))
    system = ctypes.CDLL(None)
    system.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    system.prctl(_PR_SET_SECCOMP, 2, ctypes.byref(program), 0, 0)
