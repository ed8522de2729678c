"""Folders and moves of a chain that may be killed at any time: nothing is left that its next run would not remove."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from railrepro.data import InputError, alone


@contextmanager
def written() -> Iterator[None]:
    """Turn a failing write (disk full, no permission) into one sentence; InputError."""
    try:
        yield
    except OSError as error:
        where = error.filename2 or error.filename or "a file"
        raise InputError(f"{where}: cannot be written ({error.strerror or error}); what was there is intact") from error


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
def scratch(folder: Path, name: str) -> Iterator[Path]:
    """A folder for one process at a time, gone afterwards; those that killed processes left in `folder` go first."""
    folder.mkdir(parents=True, exist_ok=True)
    for lock in folder.glob("*.lock"):
        with alone(lock, wait=False) as free:
            if free:
                shutil.rmtree(lock.with_suffix(".scratch"), ignore_errors=True)
                lock.unlink(missing_ok=True)
    lock = folder / f"{name}.lock"
    with alone(lock):
        place = lock.with_suffix(".scratch")
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(mode=0o700)
        try:
            yield place
        finally:
            shutil.rmtree(place, ignore_errors=True)
            lock.unlink(missing_ok=True)
