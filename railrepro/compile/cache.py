"""From C source text to a shared object, cached by content.

The key of the cache is the full source text, the compiler with its version and flags, and the CPU where the flags ask
for this very one, so that neither a changed model nor a moved build folder can meet a stale object. Processes that need
the same object at the same time wait for the one that compiles it. An object is loaded as code only when it belongs to
the user, no other user can write it, and its content is what was stored; else it is made again.

By default nothing but 256-bit registers is asked of the processor, where it has them, and products and sums are not
fused, so that compilers and processors round alike. Very long sources are optimised less: a tenth of the time to
compile, for a tenth more to run. `RAILREPRO_CFLAGS` replaces these flags, for example by "-O2 -march=native",
`RAILREPRO_COMPILER_SECONDS` the time limits. With `RAILREPRO_KEEP_SOURCE=1` the source stays beside its object, to be
read.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
import platform
import shutil
import stat
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

from railrepro import files, parent_death, paths
from railrepro.errors import InputError

_PORTABLE = "-ffp-contract=off"
_LONG = 1_500_000
"""Length from which a source counts as long: cars with frames, and units, which hold their tables."""
_SLOW = 200_000
"""Length from which the compiler takes seconds: cars and predictive controllers."""
_ALWAYS = ("-fPIC", "-shared", "-fno-math-errno", "-w")
_NONE = "no C compiler was found (CC, cc, gcc): `pip install railrepro[compiler]` brings one"
_SECONDS, _PROBE_SECONDS = 600.0, 30.0
"""Time limits of a compilation and of the try whether a compiler works (s)."""
PACKAGED = "ziglang"
"""The compiler of a Python package, the extra `compiler`; `CC=ziglang` chooses it."""
_OTHERS = 0o022
"""Write permission of group and others."""


class CompilerError(InputError):
    """A compiler that does not do its work."""


@lru_cache(maxsize=1)
def compiler() -> str:
    """Path of a C compiler that works, or the name of the packaged one.

    Looked for are `CC`, cc, gcc, and the `PACKAGED` one. That there is no compiler `CC` is reported on stderr, once.

    Raises
    ------
    CompilerError
        When there is none, or the first one does not work.
    """
    command = next(filter(None, map(found, (os.environ.get("CC") or "cc", "gcc", PACKAGED))), None)
    asked = os.environ.get("CC")
    if command is None:
        raise CompilerError(_NONE)
    if asked and found(asked) is None:
        print(f"CC={asked!r} is no compiler that can be found; {command} is used", file=sys.stderr, flush=True)
        os.environ["CC"] = command  # reported once: processes that this one starts inherit it
    _object(command, "/* does it work? */\n", _PROBE_SECONDS, flags())
    return command


def found(name: str) -> str | None:
    """Path of a compiler, or the name of the packaged one; None when there is none."""
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


@lru_cache(maxsize=1)
def _processor() -> str:
    """What the system reports of the processor: model and features, sorted lines; empty where it does not."""
    file = Path("/proc/cpuinfo")
    lines = file.read_text().splitlines() if file.exists() else []
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "model name", "Features"))}))


def flags(portable: bool = False, length: int = 0, level: str = "-Og") -> tuple[str, ...]:
    """Flags of the compiler for a source of some length: `RAILREPRO_CFLAGS` or the default, and what an object needs.

    `level` is that of long sources.

    `portable` code runs on any processor of this kind, unless `RAILREPRO_CFLAGS` asks for more.
    """
    wide = not portable and platform.machine() in ("x86_64", "AMD64") and "avx2" in _processor().split()
    default = f"{'-O2' if length < _LONG else level} {_PORTABLE}" + (" -mavx2" if wide else "")
    return (*os.environ.get("RAILREPRO_CFLAGS", default).split(), *_ALWAYS)


@lru_cache
def _version(command: str) -> str:
    """First line of what a compiler reports of itself."""
    try:
        done = subprocess.run(
            [*_call(command), "--version"], capture_output=True, text=True, check=True, timeout=_seconds(_PROBE_SECONDS)
        )
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError) as error:
        raise CompilerError(f"the C compiler {command} does not answer to --version ({error})") from error
    return done.stdout.partition("\n")[0]


def _machine(command: str, options: tuple[str, ...]) -> str:
    """What an object depends on besides its source: compiler, flags, processor where they are native to it."""
    cpu = _processor() if any("native" in flag for flag in options) else ""
    return "\n".join((_version(command), " ".join(options), platform.machine(), cpu))


def identity(command: str) -> str:
    """What the objects of a compiler depend on besides their source, see `_machine`."""
    return _machine(command, flags())


def cache_folder() -> Path:
    """Folder of the compiled objects: `build/compiled` of a checkout that is the user's own, else in the user's cache.

    Raises
    ------
    InputError
        When the folder in the user's cache is open to others: what lies in it is run.
    CompilerError
        When neither folder can be written.
    """
    folder = paths.BUILD / "compiled"
    try:
        if not paths.INSTALLED:
            folder.mkdir(parents=True, exist_ok=True)
            if folder.stat().st_uid == os.getuid() and os.access(folder, os.W_OK):
                if folder.stat().st_mode & _OTHERS:
                    folder.chmod(0o755)
                return folder
    except OSError:
        pass  # a checkout that cannot be written is nothing wrong
    home = os.environ.get("XDG_CACHE_HOME", "")
    home = home if os.path.isabs(home) else os.path.expanduser("~/.cache")
    fallback = Path(home, "railrepro", "compiled")
    try:
        fallback.parent.mkdir(parents=True, exist_ok=True)
        fallback.mkdir(mode=0o700, exist_ok=True)
        status = fallback.lstat()
    except OSError as error:
        raise CompilerError(f"{fallback}: cannot be written ({error.strerror})") from error
    if stat.S_ISLNK(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise InputError(f"{fallback}: the cache of compiled code must be a folder of mode 700 of your own; remove it")
    return fallback


def build(text: str, portable: bool = False, level: str = "-Og") -> Path:
    """Compile C source text to a shared object, or find it in the cache.

    Parameters
    ----------
    text : str
        Complete C source.
    portable, level : optional
        See `flags`.

    Returns
    -------
    Path
        The shared object; it was loaded once for a try, and has the content that was stored then.

    Raises
    ------
    CompilerError
        When there is no compiler, when it refuses the source, takes too long or gives nothing that can be loaded, or
        when the object cannot be stored; the sentence names the kept source file.
    """
    return _object(compiler(), text, _SECONDS, flags(portable, len(text), level))


def _object(command: str, text: str, seconds: float, options: tuple[str, ...]) -> Path:
    key = hashlib.sha256((text + "\0" + _machine(command, options)).encode()).hexdigest()[:24]
    folder = cache_folder()
    target = folder / f"{key}.so"
    try:
        if not _intact(target):
            with files.scratch(folder, key) as scratch:
                if not _intact(target):
                    _compile(command, options, text, target, scratch, _seconds(seconds))
        if os.environ.get("RAILREPRO_KEEP_SOURCE"):
            files.write(target.with_suffix(".c"), text)
    except OSError as error:
        raise CompilerError(f"{target}: cannot be written ({error.strerror or error})") from error
    except InputError as error:
        raise CompilerError(str(error)) from error
    return target


def _seconds(usual: float) -> float:
    """Time limit (s): `RAILREPRO_COMPILER_SECONDS` or the usual one."""
    given = os.environ.get("RAILREPRO_COMPILER_SECONDS", "")
    if not given:
        return usual
    try:
        seconds = float(given)
    except ValueError:
        seconds = math.nan
    if not 0 < seconds < math.inf:
        raise InputError(f"RAILREPRO_COMPILER_SECONDS={given!r}, a number of seconds above 0 is needed")
    return seconds


def _digest(target: Path, content: bytes) -> str:
    return hashlib.sha256(target.name.encode() + b"\0" + content).hexdigest() + "\n"


def own_file(file: Path) -> bytes | None:
    """Content of a regular file that belongs to this user and that no other user can write; None for anything else."""
    try:
        with open(os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK), "rb") as stream:
            status = os.fstat(stream.fileno())
            own = stat.S_ISREG(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & _OTHERS
            return stream.read() if own else None
    except OSError:
        return None


def _intact(target: Path) -> bool:
    """Whether an object is there, the user's own, and what was stored."""
    content, digest = own_file(target), own_file(target.with_suffix(".sha256"))
    return content is not None and digest is not None and digest.decode(errors="replace") == _digest(target, content)


_TRIAL = "import ctypes, sys; sys.exit(getattr(ctypes.CDLL(sys.argv[1]), sys.argv[2])() != 42)"


@lru_cache(maxsize=1)
def _announce() -> None:
    """Report on stderr, once in a process, that it waits for the compiler."""
    text = "compiling for this machine, once: some 20 s for the car, 10 s for a predictive controller"
    print(text, file=sys.stderr, flush=True)


def _compile(command: str, options: tuple[str, ...], text: str, target: Path, scratch: Path, seconds: float) -> None:
    source, output, mark = scratch / "source.c", scratch / "object.so", f"railrepro_{target.stem}"
    source.write_text(f"{text}\nint {mark}(void) {{ return 42; }}\n")
    if len(text) > _SLOW:
        _announce()
    try:
        code, on_stderr = parent_death.run([*_call(command), *options, str(source), "-o", str(output), "-lm"], seconds)
        if code or not output.is_file():
            stored = target.with_suffix(".failed.c")
            files.write(stored, text)
            raise CompilerError(
                f"{command} refused the generated source {stored}: {on_stderr.strip()[:300] or 'no object'}"
            )
        # in a process of its own: junk can end the one that loads it
        if parent_death.run([sys.executable, "-I", "-S", "-c", _TRIAL, str(output), mark], seconds)[0]:
            raise CompilerError(f"the C compiler {command} gave an object that cannot be loaded")
    except TimeoutError as error:
        raise CompilerError(f"the C compiler {command} {error}") from error
    output.chmod(0o644)
    if target.is_dir():
        shutil.rmtree(target)
    files.write(target.with_suffix(".sha256"), _digest(target, output.read_bytes()))
    target.with_suffix(".sha256").chmod(0o644)
    os.replace(output, target)
