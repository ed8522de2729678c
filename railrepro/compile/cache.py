"""From C source text to a shared object, cached by content.

The key of the cache is the full source text, the compiler with its version and flags, and the architecture, so that a
changed model meets no stale object. Processes that need the same object at the same time wait for the one that compiles
it.

By default nothing but 256-bit registers is asked of the processor, where it has them, and products and sums are not
fused, so that compilers and processors round alike. Very long sources are optimised less: a tenth of the time to
compile, for a tenth more to run. `RAILREPRO_CFLAGS` replaces these flags, for example by "-O0 -g". The source stays
beside its object, to be read.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shutil
import stat
import subprocess
import sys
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from railrepro import paths
from railrepro.data import InputError, alone, write
from railrepro.numerics import has_avx2

_LONG = 1_500_000
"""Length from which a source counts as long: cars with frames, and units, which hold their tables."""
_SLOW = 200_000
"""Length from which the compiler takes seconds: cars and predictive controllers."""
_ALWAYS = ("-fPIC", "-shared", "-fno-math-errno", "-w")
PACKAGED = "ziglang"
"""Name of the C compiler in a Python package (extra `compiler`); the environment variable `CC` may be set to this."""
WEBASSEMBLY = (
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-mcpu=generic", "-msimd128", "-O2"),
    *("-ffp-contract=off", "-fno-math-errno", "-w"),
)
"""Flags of the packaged compiler for modules of WebAssembly, which give the same bits as shared objects."""


class CompilerError(InputError):
    """Exception: the C compiler is missing or fails, or there is no folder for its objects."""


@lru_cache(maxsize=1)
def compiler() -> str:
    """Path of the C compiler, or `PACKAGED`: the one that `CC` names, else the first found of cc, gcc and `PACKAGED`.

    Raises:
        CompilerError: When there is none.
    """
    asked = os.environ.get("CC")
    for name in [asked] if asked else ["cc", "gcc", PACKAGED]:
        if command := found(name):
            return command
    tried = f"CC={asked!r}" if asked else "cc, gcc"
    raise CompilerError(f"no C compiler was found ({tried}): `pip install railrepro[compiler]` brings one")


def found(name: str) -> str | None:
    """Path of the program `name` on PATH, or for `PACKAGED` this name; None when it is not installed."""
    if name == PACKAGED:
        return name if importlib.util.find_spec(name) else None
    return shutil.which(name)


def _call(command: str) -> list[str]:
    """How a compiler is called. The flags of the packaged one that are given later win; without the first of these,
    objects would be for this very processor."""
    if command != PACKAGED:
        return [command]
    place = cache_folder() / "zig"
    # zig asks CC where the headers are
    environment = ["-u", "CC", f"ZIG_GLOBAL_CACHE_DIR={place}", f"ZIG_LOCAL_CACHE_DIR={place}"]
    portable = ["-mcpu=baseline", "-fno-sanitize=undefined", "-g0"]
    return ["env", *environment, sys.executable, "-m", PACKAGED, "cc", *portable]


def flags(portable: bool = False, length: int = 0) -> tuple[str, ...]:
    """Compiler flags for a source of `length` characters: `RAILREPRO_CFLAGS`, else the default, and those always given.

    `portable` code runs on any processor of the architecture, unless `RAILREPRO_CFLAGS` asks for more.
    """
    wide = " -mavx2" if has_avx2() and not portable else ""
    default = f"{'-O2' if length < _LONG else '-Og'} -ffp-contract=off{wide}"
    return (*os.environ.get("RAILREPRO_CFLAGS", default).split(), *_ALWAYS)


@lru_cache
def identity(command: str, options: tuple[str, ...]) -> str:
    """Text of all that an object depends on besides its source: version of the compiler, its flags, the architecture.

    Raises:
        CompilerError: When the compiler does not tell its version.
    """
    try:
        done = subprocess.run([*_call(command), "--version"], capture_output=True, text=True, check=True, timeout=30)
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError) as error:
        raise CompilerError(f"the C compiler {command} does not answer to --version ({error})") from error
    return "\n".join((done.stdout.partition("\n")[0], " ".join(options), platform.machine()))


def cache_folder() -> Path:
    """Folder of the compiled objects: `build/compiled` of a checkout, without one in the user's cache.

    What lies in it is run, so it has to be the user's own, and nobody else may write it.

    Raises:
        CompilerError: When there is no such folder.
    """
    home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "railrepro" / "compiled"
    folder = home if paths.INSTALLED else paths.BUILD / "compiled"
    with suppress(OSError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022:
            return folder
    raise CompilerError(f"{folder}: a folder that you alone can write is needed for compiled code")


def build(text: str, portable: bool = False, webassembly: bool = False) -> Path:
    """Path of the shared object, or module of WebAssembly, of a C source text: from the cache, or compiled into it.

    Args:
        text (str): Complete C source.
        portable (bool): For any processor of the architecture, see `flags`.
        webassembly (bool): A module of WebAssembly, by the packaged compiler with the flags `WEBASSEMBLY`.

    Raises:
        CompilerError: When there is no compiler or no folder, or when the compiler refuses the source.
    """
    if webassembly and not found(PACKAGED):
        raise CompilerError("modules of WebAssembly need `pip install railrepro[compiler]`")
    command = PACKAGED if webassembly else compiler()
    options = WEBASSEMBLY if webassembly else flags(portable, len(text))
    key = hashlib.sha256((text + "\0" + identity(command, options)).encode()).hexdigest()[:24]
    target = cache_folder() / f"{key}.so"
    lock = target.with_suffix(".lock")
    if not target.is_file():
        with alone(lock):
            if not target.is_file():  # another process may have compiled it meanwhile
                _compile([*_call(command), *options], text, target)
            lock.unlink(missing_ok=True)  # who waits for it finds the object
    return target


def _compile(command: list[str], text: str, target: Path) -> None:
    """Compile the source, which stays beside its object, and put the object in place in one step."""
    if len(text) > _SLOW:
        print("compiling for this machine, once; it takes up to half a minute", file=sys.stderr, flush=True)
    source, output = target.with_suffix(".c"), target.with_suffix(".part")
    write(source, text)
    call = [*command, str(source), "-o", str(output), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, errors="replace")
    if done.returncode or not output.is_file():
        said = done.stderr.strip()[:300] or "no object"
        raise CompilerError(f"{command[0]} refused the generated source {source}: {said}")
    os.replace(output, target)
