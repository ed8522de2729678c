"""From C source text to a shared object, cached by content.

The key of the cache is the source text, the compiler with its version and flags, and the architecture. Processes that
need the same object wait for the one that compiles it. By default 256-bit registers are used where the processor has
them, and products and sums are not fused, so that all processors round alike. Very long sources are optimised less.
`RAILREPRO_CFLAGS` replaces these flags, for example by "-O0 -g". The source stays beside its object.
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
"""C compiler from a Python package (extra `compiler`); the environment variable `CC` may name it."""
WEBASSEMBLY = (
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-mcpu=generic", "-msimd128", "-O2"),
    *("-ffp-contract=off", "-fno-math-errno", "-w"),
)
"""Flags of the packaged compiler for modules of WebAssembly, which give the same bits as shared objects."""


class CompilerError(InputError):
    """The C compiler is missing or fails, or there is no folder for compiled objects."""


@lru_cache(maxsize=1)
def compiler() -> str:
    """Path of the C compiler, or the name "ziglang" for the one in a Python package. CompilerError if there is none.
    The environment variable `CC` decides. Without it the first one installed of cc, gcc and ziglang is taken."""
    asked = os.environ.get("CC")
    for name in [asked] if asked else ["cc", "gcc", PACKAGED]:
        if command := found(name):
            return command
    if asked:
        raise CompilerError(f"there is no C compiler CC={asked!r}: without CC cc and gcc are looked for")
    raise CompilerError("no C compiler was found (cc, gcc): `pip install railrepro[compiler]` brings one")


def found(name: str) -> str | None:
    """Path of the program `name` on PATH, None if it is not installed. For "ziglang", which is a compiler in a Python
    package, this name itself in place of a path."""
    if name == PACKAGED:
        return name if importlib.util.find_spec(name) else None
    return shutil.which(name)


def _call(command: str) -> list[str]:
    """Command line of a compiler. The flags of the packaged one that are given later win; without the first of these,
    objects would be for this very processor."""
    if command != PACKAGED:
        return [command]
    place = cache_folder() / "zig"
    # zig asks CC where the headers are
    environment = ["-u", "CC", f"ZIG_GLOBAL_CACHE_DIR={place}", f"ZIG_LOCAL_CACHE_DIR={place}"]
    portable = ["-mcpu=baseline", "-fno-sanitize=undefined", "-g0"]
    return ["env", *environment, sys.executable, "-m", PACKAGED, "cc", *portable]


def flags(portable: bool = False, length: int = 0) -> tuple[str, ...]:
    """Compiler flags as a tuple of str: those in `RAILREPRO_CFLAGS` or a default, then flags that are always given.

    Args:
        portable (bool): Whether the default leaves out AVX2, for code that runs on any processor.
        length (int): Length of the source (characters). From 1.5 million on the default is -Og in place of -O2.
    """
    wide = " -mavx2" if has_avx2() and not portable else ""
    default = f"{'-O2' if length < _LONG else '-Og'} -ffp-contract=off{wide}"
    return (*os.environ.get("RAILREPRO_CFLAGS", default).split(), *_ALWAYS)


@lru_cache
def identity(command: str, options: tuple[str, ...]) -> str:
    """Text that identifies a compilation apart from its source: version of the compiler, flags, processor architecture.

    `command` is the compiler as from `compiler`, `options` are the flags. CompilerError if `command --version` fails.
    """
    try:
        done = subprocess.run([*_call(command), "--version"], capture_output=True, text=True, check=True, timeout=30)
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError) as error:
        raise CompilerError(f"the C compiler {command} does not answer to --version ({error})") from error
    return "\n".join((done.stdout.partition("\n")[0], " ".join(options), platform.machine()))


def cache_folder() -> Path:
    """Folder of the compiled objects: `build/compiled` of a checkout, for an installed package in the user's cache. Its
    content is executed. CompilerError if the folder does not belong to the user or others may write to it."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "railrepro" / "compiled"
    folder = home if paths.INSTALLED else paths.BUILD / "compiled"
    with suppress(OSError):
        folder.parent.mkdir(parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022:
            return folder
    raise CompilerError(f"{folder}: a folder that you alone can write is needed for compiled code")


def build(text: str, portable: bool = False, webassembly: bool = False, triple: str = "") -> Path:
    """Path of the object compiled from a C source text. It is compiled only if it is not in the cache.

    CompilerError if there is no compiler or no folder, or if the compiler refuses the source.

    Args:
        text (str): Complete C source.
        portable (bool): Make a shared object for any processor of the architecture, see `flags`.
        webassembly (bool): Make a WebAssembly module with the packaged compiler, instead of a shared object.
        triple (str): Another platform, for which the packaged compiler makes the object, such as "x86_64-windows-gnu".
    """
    if (webassembly or triple) and not found(PACKAGED):
        wanted = f"shared objects for {triple}" if triple else "modules of WebAssembly"
        raise CompilerError(f"{wanted} need `pip install railrepro[compiler]`")
    command = PACKAGED if webassembly or triple else compiler()
    options = WEBASSEMBLY if webassembly else flags(portable, len(text))
    options = ("-target", triple, *options) if triple else options
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
        print("compiling, once; it takes up to half a minute", file=sys.stderr, flush=True)
    source, output = target.with_suffix(".c"), target.with_suffix(".part")
    write(source, text)
    call = [*command, str(source), "-o", str(output), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, errors="replace")
    if done.returncode or not output.is_file():
        said = done.stderr.strip()[:300] or "no object"
        raise CompilerError(f"{command[0]} refused the generated source {source}: {said}")
    os.replace(output, target)
