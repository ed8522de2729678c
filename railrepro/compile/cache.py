"""From C source text to a shared object, cached by content. The key of the cache is the source text, the compiler with
its version and flags, and the architecture. Processes that need the same object wait for the one that compiles it. The
source stays beside its object. An object is loaded only with its seal, a hash of its name and content that needs a
secret key of the user. One that is damaged, or that another user or an archive brought, is compiled again."""

import hashlib
import hmac
import importlib.util
import os
import platform
import shutil
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path

from railrepro import paths
from railrepro.data import InputError, alone, write
from railrepro.numerics import has_avx2

_SLOW = 200_000
"""Length of a source text from which compiling takes seconds, as for the car and the predictive controllers."""
_ALWAYS = ("-fPIC", "-shared", "-fno-math-errno", "-w")
PACKAGED = "ziglang"
"""Name of the C compiler from a Python package (extra `compiler`)."""
_KEY = 32  # Length of the user's key in bytes
WEBASSEMBLY = (
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-mcpu=generic", "-msimd128", "-O2"),
    *("-ffp-contract=off", "-fno-math-errno", "-w"),
)
"""Flags of the packaged compiler for WebAssembly modules, which give the same bits as shared objects."""


@lru_cache(maxsize=1)
def compiler() -> str:
    """Find the C compiler: the one that the environment variable `CC` names, or without this variable the first
    installed of cc, gcc and ziglang. Returns its path, or "ziglang" for this Python package. InputError if there is
    none, or if `CC` names one that is not installed."""
    given = os.environ.get("CC")
    for name in [given] if given else ["cc", "gcc", PACKAGED]:
        if command := found(name):
            return command
    if given:
        raise InputError(f"there is no C compiler CC={given!r}: without CC cc and gcc are looked for")
    raise InputError("no C compiler was found (cc, gcc): `pip install railrepro[compiler]` brings one")


def found(name: str) -> str | None:
    """Return the path of the program `name`, None if it is not installed. For "ziglang" (Python) it is the name."""
    if name == PACKAGED:
        return name if importlib.util.find_spec(name) else None
    return shutil.which(name)


def _call(command: str) -> list[str]:
    """Begin the command line of a compiler, without source and flags. For the packaged one flags override these."""
    if command != PACKAGED:
        return [command]
    folder = user_folder() / "zig"
    # without CC, which zig would ask for its headers
    environment = ["-u", "CC", f"ZIG_GLOBAL_CACHE_DIR={folder}", f"ZIG_LOCAL_CACHE_DIR={folder}"]
    portable = ["-mcpu=baseline", "-fno-sanitize=undefined", "-g0"]  # the default is this very processor
    return ["env", *environment, sys.executable, "-m", PACKAGED, "cc", *portable]


def flags(portable: bool = False) -> tuple[str, ...]:
    """Return the compiler flags: from the environment variable `RAILREPRO_CFLAGS`, such as "-O0 -g", else a default,
    and always "-fPIC -shared -fno-math-errno -w". By default products and sums are not fused, so that all processors
    round alike. AVX2 is used if the processor has it, but not with `portable`."""
    wide = " -mavx2" if has_avx2() and not portable else ""
    return (*os.environ.get("RAILREPRO_CFLAGS", f"-O2 -ffp-contract=off{wide}").split(), *_ALWAYS)


@lru_cache
def identity(command: str, options: tuple[str, ...]) -> str:
    """Text for the key of a compiled object: version of the compiler `command` (a result of `compiler`), the flags
    `options` and the architecture. InputError if `command --version` fails."""
    try:
        done = subprocess.run([*_call(command), "--version"], capture_output=True, text=True, check=True, timeout=30)
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError) as error:
        raise InputError(f"the C compiler {command} does not answer to --version ({error})") from error
    return "\n".join((done.stdout.partition("\n")[0], " ".join(options), platform.machine()))


def folders(name: str) -> Iterator[Path]:
    """Yield the possible places of a cache folder `name`: in `build` of a checkout, then in the user's cache. Folders
    are made if need be. A folder that other users can write, or that nobody can, is left out."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # stays relative where there is no home
    places = [] if paths.INSTALLED else [paths.BUILD / name]
    places += [Path(home, "railrepro", name)] if os.path.isabs(home) else []
    for folder in places:
        with suppress(OSError):
            folder.parent.mkdir(parents=True, exist_ok=True)
            folder.mkdir(mode=0o700, exist_ok=True)
            status = folder.lstat()
            private = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
            if private and os.access(folder, os.W_OK):
                yield folder


def cache_folder() -> Path:
    """Return the folder of the compiled objects, the first of `folders`. InputError if there is none."""
    for folder in folders("compiled"):
        return folder
    raise InputError("compiled code needs a folder that you alone can write: build or ~/.cache/railrepro")


def user_folder() -> Path:
    """Return the folder in the user's cache, for the secret key and what must not come with a copied checkout;
    `cache_folder` if it is not writable."""
    return [cache_folder(), *folders("compiled")][-1]


def seal(name: str, content: bytes) -> bytes:
    """Compute the seal of a cached file with this name and content: 32 bytes that only this user's secret key gives
    (HMAC), so that a file from others is not loaded. The key is made at the first use and stays in `user_folder`. If
    `user_folder` is `cache_folder`, seals show damage, but not that objects and key came from others."""
    return hmac.digest(_key(user_folder() / "key"), name.encode() + b"\0" + content, "sha256")


@lru_cache
def _key(file: Path) -> bytes:
    try:
        with alone(file):  # processes that start together have one key
            if file.stat().st_size != _KEY:
                file.chmod(0o600)
                file.write_bytes(os.urandom(_KEY))
            return file.read_bytes()
    except OSError as error:
        raise InputError(f"{file}: cannot be made or read ({error.strerror})") from error


def _is_sealed(target: Path) -> bool:
    """Check whether an object exists and has the seal of this user."""
    with suppress(OSError):
        return hmac.compare_digest(target.with_suffix(".seal").read_bytes(), seal(target.name, target.read_bytes()))
    return False


def build(text: str, portable: bool = False, webassembly: bool = False, triple: str = "") -> Path:
    """Compile a C source text, unless its object is in the cache with its seal, and return the path of the shared
    object. A `portable` object runs on any processor of the architecture. With `webassembly` it is a WebAssembly
    module; a `triple`, such as "x86_64-windows-gnu", names another platform. Both need the Python package ziglang.
    InputError if there is no compiler or no folder, or the compiler refuses the source."""
    if (webassembly or triple) and not found(PACKAGED):
        product = f"shared objects for {triple}" if triple else "modules of WebAssembly"
        raise InputError(f"{product} need `pip install railrepro[compiler]`")
    command = PACKAGED if webassembly or triple else compiler()
    options = WEBASSEMBLY if webassembly else flags(portable)
    options = ("-target", triple, *options) if triple else options
    key = hashlib.sha256((text + "\0" + identity(command, options)).encode()).hexdigest()[:24]
    target = cache_folder() / f"{key}.so"
    lock = target.with_suffix(".lock")
    if not _is_sealed(target):
        with alone(lock):
            if not _is_sealed(target):  # another process may have compiled it meanwhile
                _compile([*_call(command), *options], text, target)
            lock.unlink(missing_ok=True)  # a process that waits for it finds the object
    return target


def build_ahead(text: str) -> None:
    """Start to compile a C source text in a thread. `build` then waits for the object, or tries again and raises."""

    def attempt() -> None:
        with suppress(InputError):
            build(text)

    threading.Thread(target=attempt).start()


@cache
def _announce() -> None:
    print("compiling, once; it takes up to half a minute", file=sys.stderr, flush=True)


def _compile(command: list[str], text: str, target: Path) -> None:
    """Compile a source text; object and seal appear when they are complete, the source stays beside them."""
    if len(text) > _SLOW:
        _announce()
    source, output = target.with_suffix(".c"), target.with_suffix(".part")
    write(source, text)
    call = [*command, str(source), "-o", str(output), "-lm"]
    done = subprocess.run(call, capture_output=True, text=True, errors="replace")
    if done.returncode or not output.is_file():
        reason = done.stderr.strip()[:300] or "no object"
        raise InputError(f"{command[0]} refused the generated source {source}: {reason}")
    write(target.with_suffix(".seal"), seal(target.name, output.read_bytes()))
    os.replace(output, target)
