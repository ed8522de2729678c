"""From C source text to a shared object, cached by content.

The key of the cache is the full source text, the compiler with its version and flags, and the CPU where the flags ask
for this very one, so that neither a changed model nor a moved build folder can meet a stale object. Processes that need
the same object at the same time wait for the one that compiles it.

By default nothing but 256-bit registers is asked of the processor, where it has them, and products and sums are not
fused, so that compilers and processors round alike. `RAILREPRO_CFLAGS` replaces these flags, for example by
"-O2 -march=native". With `RAILREPRO_KEEP_SOURCE=1` the source stays beside its object, to be read.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from railrepro import paths
from railrepro.errors import InputError

PORTABLE_FLAGS = "-O2 -ffp-contract=off"
_ALWAYS = ("-fPIC", "-shared", "-fno-math-errno", "-w")


@lru_cache(maxsize=1)
def compiler() -> str | None:
    """Path of the C compiler, or None (also when `RAILREPRO_NO_COMPILER` is set)."""
    if os.environ.get("RAILREPRO_NO_COMPILER"):
        return None
    return shutil.which(os.environ.get("CC", "cc")) or shutil.which("gcc")


@lru_cache(maxsize=1)
def _processor() -> str:
    """What the system tells of the processor: model and features, sorted lines; empty where it does not."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "model name", "Features"))}))


def flags() -> tuple[str, ...]:
    """Flags of the compiler: `RAILREPRO_CFLAGS` or the default, and what a shared object needs."""
    wide = platform.machine() in ("x86_64", "AMD64") and "avx2" in _processor().split()
    default = PORTABLE_FLAGS + (" -mavx2" if wide else "")
    return (*os.environ.get("RAILREPRO_CFLAGS", default).split(), *_ALWAYS)


@lru_cache
def _version(command: str) -> str:
    """First line of what a compiler tells of itself."""
    try:
        done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise InputError(f"the C compiler {command} does not answer to --version ({error})") from error
    return done.stdout.partition("\n")[0]


def _machine(command: str) -> str:
    """What an object depends on besides its source: compiler, flags, processor where they are native to it."""
    cpu = _processor() if any("native" in flag for flag in flags()) else ""
    return "\n".join((_version(command), " ".join(flags()), platform.machine(), cpu))


def cache_folder() -> Path:
    """Folder of the compiled objects: `build/compiled`, or one below the temporary folder if that is read-only.

    Raises
    ------
    InputError
        When others can write the folder below the temporary one: what lies in it is run.
    """
    folder = paths.BUILD / "compiled"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    fallback = Path(tempfile.gettempdir()) / f"railrepro-compiled-{os.getuid()}"
    fallback.mkdir(mode=0o700, exist_ok=True)
    status = fallback.lstat()
    if fallback.is_symlink() or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise InputError(f"{fallback}: the cache of compiled code must be a folder that only you can write; remove it")
    return fallback


def build(text: str) -> Path:
    """Compile C source text to a shared object, or find it in the cache.

    Parameters
    ----------
    text : str
        Complete C source.

    Returns
    -------
    Path
        The shared object.

    Raises
    ------
    InputError
        When there is no compiler, or it refuses the source; the sentence names the kept source file.
    """
    command = compiler()
    if command is None:
        raise InputError("a C compiler is needed, and none was found (CC, cc, gcc)")
    key = hashlib.sha256((text + "\0" + _machine(command)).encode()).hexdigest()[:24]
    folder = cache_folder()
    target = folder / f"{key}.so"
    if not target.exists():
        with _alone(folder / f"{key}.lock"):
            if not target.exists():
                _compile(command, text, target)
    if os.environ.get("RAILREPRO_KEEP_SOURCE"):
        target.with_suffix(".c").write_text(text)
    return target


@contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Hold a lock file against other processes; a process that dies lets it go."""
    with lock.open("w") as guard:
        fcntl.flock(guard, fcntl.LOCK_EX)
        yield
    lock.unlink(missing_ok=True)


def _compile(command: str, text: str, target: Path) -> None:
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        source, output = Path(scratch, "source.c"), Path(scratch, "object.so")
        source.write_text(text)
        done = subprocess.run([command, *flags(), source, "-o", output, "-lm"], capture_output=True, text=True)
        if done.returncode or not output.exists():
            kept = target.with_suffix(".failed.c")
            shutil.copy(source, kept)
            told = done.stderr.strip()[:300] or "it wrote no object"
            raise InputError(f"{command} refused the generated source {kept}: {told}")
        os.replace(output, target)
