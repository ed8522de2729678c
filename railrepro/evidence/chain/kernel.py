"""The kernel that executes a notebook: silent on stderr, interrupted like any program, ended with who started it."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

from jupyter_client.manager import AsyncKernelManager

from railrepro import parent_death
from railrepro.files import write

PARENT = "RAILREPRO_KERNEL_PARENT"
"""Environment variable with the number of the process that a kernel ends with."""
_SETTINGS = f"""import os, runpy
runpy.run_path({parent_death.__file__!r})["follow"](int(os.environ["{PARENT}"]))
c = get_config()
c.IPKernelApp.log_level = 50
"""
_STDERR = "stderr"
_LONGEST_SOCKET = 100
"""Characters that the name of a Unix socket may have (104 to 108 by system)."""


class Kernel(AsyncKernelManager):
    """Kernel manager that remembers the processes it started and the folders of their sockets.

    Sockets are files of a folder of its own: of TCP ports the manager can only guess which stay free until the kernel
    takes them, and kernels that start side by side then end with "address already in use" now and then.
    """

    started: ClassVar[list[subprocess.Popen]] = []
    folders: ClassVar[list[str]] = []

    @staticmethod
    def prepare(folder: Path) -> None:
        """Write the settings that a kernel reads when it starts: no notices, and the end with its parent."""
        write(folder / "profile_default" / "ipython_kernel_config.py", _SETTINGS)

    async def _async_start_kernel(self, **options) -> None:
        # nbclient takes interrupts for itself and ends in an error of its own; Python's way ends everything
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            with suppress(RuntimeError, ValueError):
                loop.remove_signal_handler(number)
        folder = tempfile.mkdtemp(prefix="railrepro-")
        self.folders.append(folder)
        if len(folder) + len("/kernel-5") <= _LONGEST_SOCKET:
            self.transport, self.ip = "ipc", f"{folder}/kernel"
        with open(f"{folder}/{_STDERR}", "wb") as stderr:
            await super()._async_start_kernel(**options, stderr=stderr)
        process = getattr(self.provisioner, "process", None)
        if process is not None:
            self.started.append(process)

    start_kernel = _async_start_kernel  # type: ignore[assignment]

    @classmethod
    def last_words(cls) -> str:
        """Last line that a kernel wrote to stderr, "" when none did."""
        lines = [
            line
            for folder in cls.folders
            for line in Path(folder, _STDERR).read_text(errors="replace").splitlines()
            if line.strip()
        ]
        return lines[-1].strip() if lines else ""

    @classmethod
    def end_all(cls) -> None:
        """End kernels that are still there, after an interrupt for instance; each is the head of its own group."""
        while cls.started:
            process = cls.started.pop()
            if process.poll() is None:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        while cls.folders:
            shutil.rmtree(cls.folders.pop(), ignore_errors=True)
