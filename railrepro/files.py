"""Writing and locking files: whole or not at all, and nothing left behind that the next run would not take away."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from railrepro.errors import InputError


@contextmanager
def written() -> Iterator[None]:
    """Turn a failing write (disk full, no permission) into one sentence; InputError."""
    try:
        yield
    except OSError as error:
        where = error.filename2 or error.filename or "a file"
        raise InputError(f"{where}: cannot be written ({error.strerror or error}); what was there is intact") from error


def write(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all.

    The scratch file beside it has one name, so that the next write takes over what a killed one left.

    Raises
    ------
    InputError
        When it cannot be written; what was there is intact.
    """
    data = content.encode() if isinstance(content, str) else content
    scratch = path.with_name(f".{path.name}.part")
    with written():
        path.parent.mkdir(parents=True, exist_ok=True)
        with alone(scratch) as guard:
            assert guard is not None, "waiting locks are given"
            try:
                os.ftruncate(guard, 0)
                with os.fdopen(os.dup(guard), "wb") as stream:
                    stream.write(data)
                os.chmod(scratch, 0o666 & ~_umask())
                os.replace(scratch, path)
            except OSError as error:
                error.filename = error.filename or str(path)
                raise


def move(source: Path, target: Path) -> None:
    """Put a file in place in one step, also from another file system; OSError when that fails."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        scratch = target.with_name(f".{target.name}.part")
        try:
            shutil.copyfile(source, scratch)
            os.replace(scratch, target)
        except OSError:
            scratch.unlink(missing_ok=True)
            raise


@contextmanager
def alone(lock: Path, wait: bool = True) -> Iterator[int | None]:
    """Hold a lock file against other processes; a process that dies lets it go.

    Parameters
    ----------
    lock : Path
        Made when it is missing, gone afterwards.
    wait : bool
        False gives None instead of waiting for another process.

    Yields
    ------
    int or None
        The open file.
    """
    while True:
        guard = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(guard, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            same = os.path.samestat(os.fstat(guard), os.stat(lock))
        except BlockingIOError:
            os.close(guard)
            yield None
            return
        except FileNotFoundError:
            same = False
        except BaseException:
            os.close(guard)
            raise
        if same:
            break
        os.close(guard)  # who held it before took the file away
    try:
        yield guard
    finally:
        if _still(guard, lock):
            lock.unlink(missing_ok=True)  # before it is let go: who opens it now starts again
        os.close(guard)


@contextmanager
def scratch(folder: Path, name: str) -> Iterator[Path]:
    """A folder for one process at a time, gone afterwards; those that killed processes left in `folder` go first."""
    folder.mkdir(parents=True, exist_ok=True)
    for lock in folder.glob("*.lock"):
        with alone(lock, wait=False) as held:
            if held is not None:
                shutil.rmtree(lock.with_suffix(".scratch"), ignore_errors=True)
    with alone(folder / f"{name}.lock"):
        place = folder / f"{name}.scratch"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(mode=0o700)
        try:
            yield place
        finally:
            shutil.rmtree(place, ignore_errors=True)


def _still(guard: int, lock: Path) -> bool:
    """Whether a lock file is still the one that was opened; it may have become what was to be written."""
    try:
        return os.path.samestat(os.fstat(guard), os.stat(lock))
    except OSError:
        return False


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
