"""Hashes of the code that this process runs, for the keys of caches: a result is stored under the code that computed
it. Files may be edited while a process imports them. They are therefore read when the package is imported, and checked
again before a cache is read or written. The content of a module is its text without comments, docstrings and empty
lines. A regular expression extracts it, so that all versions of Python give the same hash."""

import hashlib
import math
import os
import re
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path

PACKAGES = ("numpy", "scipy", "casadi", "pandas", "sympy", "matplotlib", "pillow")
"""Packages whose version may change a number or a figure."""
_FOLDER = os.path.dirname(__file__)
_ABOVE = ("railrepro/evidence/", "railrepro/tuning/", "railrepro/studies/")
"""Folders of modules that use runs. The key of a result that they compute from runs contains `reached_from`."""
DRAWING = ("railrepro/figures.py", "railrepro/simulation/plot.py")
"""Modules that draw a run. No number depends on them."""
_TOKEN = re.compile(  # `++`: a quote that nothing closes would take exponential time
    r"""(?P<start>(?<!\\\n)^[ \t]*[rR]?)?(?P<quote>"{3}|'{3}|"|')(?:[^\\"']++|\\.|(?!(?P=quote))["'])*+(?P=quote)"""
    r"(?P<end>(?=[ \t]*(?:$|\#)))?|(?P<comment>\#[^\n]*)|(?P<open>[(\[{])|(?P<close>[)\]}])",
    re.DOTALL | re.MULTILINE,
)
_EMPTY = re.compile(r"[ \t]*\n(?:[ \t]*\n)*")
_FROM = re.compile(r"^[ \t]*from[ \t]+(railrepro[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)
_IMPORT = re.compile(r"^[ \t]*import[ \t][^\n]*\brailrepro\b", re.MULTILINE)
_DOTTED = re.compile(r"\brailrepro(?:\.\w+)+")
"""Dotted name of a module, in an import or in a text that `pkgutil.resolve_name` takes."""


def signature(file: str | os.PathLike) -> tuple[int, int] | None:
    """Size of a file (bytes) and time of its last change (ns), which show an edit; None if there is no such file."""
    with suppress(OSError, ValueError):
        status = os.stat(file)
        return status.st_size, status.st_mtime_ns
    return None


_FILES = {
    f"railrepro{folder[len(_FOLDER) :]}/{name}": os.path.join(folder, name)
    for folder, _, names in os.walk(_FOLDER)
    for name in names
    if name.endswith((".py", ".c", ".h"))
}
"""Name of a source file, such as "railrepro/clock.py" -> its path."""
_SIGNATURES = {file: signature(file) for file in _FILES.values()}
_BYTES = {name: Path(file).read_bytes() for name, file in sorted(_FILES.items())}
_edited, _checked = False, -math.inf


def unchanged(within: float = 0.0) -> bool:
    """Whether no source file has changed since this process imported the package; else its results must not be cached.
    The first change prints a message to stderr. The result then stays False even if the file is restored, because a
    module may have been imported in between. The files are not checked again within `within` seconds."""
    global _edited, _checked
    if _edited or time.monotonic() - _checked < within:
        return not _edited
    _checked = time.monotonic()
    if any(signature(file) != before for file, before in _SIGNATURES.items()):
        _edited = True
        print(
            "railrepro was edited after this process imported it: caches are not used; "
            "restart the process (in Jupyter the kernel) to run the edited code",
            file=sys.stderr,
            flush=True,
        )
    return not _edited


def content(text: str) -> str:
    """Remove comments, docstrings (strings that are statements), empty lines, trailing blanks from Python source."""
    text = text.replace("\r\n", "\n")
    parts, code, depth, end = [], "", 0, 0
    for match in _TOKEN.finditer(text):
        code += text[end : match.start()]
        end = match.end()
        depth += bool(match["open"]) - bool(match["close"])
        if match["comment"] or (depth == 0 and match["start"] is not None and match["end"] is not None):
            continue
        if match["quote"]:
            parts += [_EMPTY.sub("\n", code), match[0]]
            code = ""
        else:
            code += match[0]
    return "".join([*parts, _EMPTY.sub("\n", code + text[end:])]).strip("\n")


def _imported(content: str) -> set[str]:
    """Return the source files of all modules that Python source imports or names, and of the packages around them."""
    from railrepro import FACADE  # the package imports this module first

    joined = content.replace("\\\n", " ")
    modules = set(_DOTTED.findall(joined))
    for package, names in _FROM.findall(joined):
        modules |= {f"{package}.{name}" for name in re.findall(r"(?:^|[(,])\s*(\w+|\*)", names)}
    if _IMPORT.search(joined) or "railrepro.*" in modules:  # any name of the facade may follow
        modules |= {f"railrepro.{name}" for name in FACADE}
    modules |= {home for name, home in FACADE.items() if f"railrepro.{name}" in modules}
    parts = [name.split(".") for name in modules]  # where the last part is no module, it is a name within one
    bases = {"/".join(part[:n]) for part in parts for n in range(1, len(part) + 1)}
    return {file for base in bases for file in (f"{base}.py", f"{base}/__init__.py") if file in _BYTES}


@cache
def _text(name: str) -> str:
    """Content of a module as this process imported it."""
    return content(_BYTES[name].decode())


@cache
def _source_hash(name: str) -> str:
    return hashlib.sha256(_text(name).encode() if name.endswith(".py") else _BYTES[name]).hexdigest()


@cache
def _next(name: str) -> frozenset[str]:
    """Return the source files that a module imports or names, and C sources in its folder; none for the facade."""
    if not name.endswith(".py") or name == "railrepro/__init__.py":
        return frozenset()
    folder = name.rpartition("/")[0]
    beside = {file for file in _BYTES if file.rpartition("/")[0] == folder and not file.endswith(".py")}
    return frozenset(_imported(_text(name)) | beside)


def reached(*texts: str) -> dict[str, str]:
    """Return all files of this package on which Python sources depend: those that the `texts` import, directly or
    through other modules, as a dict: name, such as "railrepro/clock.py" -> SHA-256. It is that of the `content` of a
    Python file, which comments and docstrings do not change, and that of the whole of a C file."""
    hashes: dict[str, str] = {}
    pending = [file for text in texts for file in _imported(content(text))]
    while pending:
        file = pending.pop()
        if file not in hashes:
            hashes[file] = _source_hash(file)
            pending += _next(file)
    return dict(sorted(hashes.items()))


@cache
def reached_from(module: str) -> str:
    """SHA-256 of a module of this package, named as in `__name__`, such as "railrepro.clock", and all files of the
    package that it imports, directly or not, except those that draw figures (`DRAWING`). It is a part of the key under
    which results of the module are stored, so that an edit makes them invalid."""
    return _joined(reached(f"from {module} import {module}"))


def _joined(names: Iterable[str]) -> str:
    """SHA-256 of the names and hashes of source files, except `DRAWING`."""
    lines = [f"{name} {_source_hash(name)}" for name in names if name not in DRAWING]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


@cache
def version() -> str:
    """SHA-256 of all sources that compute a run, as imported. Check `unchanged` before it is the key of a cache."""
    return _joined(name for name in _BYTES if not name.startswith(_ABOVE))


@cache
def packages() -> dict[str, str]:
    """Installed versions of packages that may change a number or a figure, such as NumPy: name -> version or ""."""
    from importlib import metadata  # takes long to import

    versions = dict.fromkeys(PACKAGES, "")
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return versions
