"""A film as MP4 where ffmpeg is installed, else as GIF where Pillow is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import animation

from railrepro.errors import InputError
from railrepro.evidence.film.picture import Picture
from railrepro.evidence.film.scene import Comparison
from railrepro.files import written

RATE = 8
"""Frames per second."""
PICTURES = 80
"""Pictures of a movie, spread over the film."""


def coder() -> tuple[str, str]:
    """Suffix and matplotlib's writer of what can be written here; InputError when nothing can."""
    for suffix, writer in (("mp4", "ffmpeg"), ("gif", "pillow")):
        if animation.writers.is_available(writer):
            return suffix, writer
    raise InputError("no movie: neither ffmpeg nor Pillow is here; the page needs neither")


def save(film: Comparison, folder: Path, name: str) -> Path:
    """Write the movie FOLDER/NAME.mp4 or .gif, whole or not at all; its path."""
    suffix, writer = coder()
    target, part = folder / f"{name}.{suffix}", folder / f".{name}.part.{suffix}"
    picture = Picture(film)
    try:
        with written():
            folder.mkdir(parents=True, exist_ok=True)
            picture.show(0)
            picture.figure.draw_without_rendering()
            picture.figure.set_layout_engine("none")  # laid out once; later frames have the same axes
            with animation.writers[writer](fps=RATE).saving(picture.figure, str(part), dpi=110) as movie:
                for frame in np.linspace(0, film.times.size - 1, min(PICTURES, film.times.size)).astype(int):
                    picture.show(int(frame))
                    movie.grab_frame()
            part.replace(target)
    finally:
        part.unlink(missing_ok=True)
    return target
