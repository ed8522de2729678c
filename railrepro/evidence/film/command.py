"""`python -m railrepro film curve_entry_T3 nmpc mine.py`: page and movie in build/film, for `make film`."""

from __future__ import annotations

from collections.abc import Sequence

from railrepro import paths
from railrepro.errors import InputError
from railrepro.evidence.film import movie, page
from railrepro.evidence.film.scene import film
from railrepro.evidence.runs import tuning
from railrepro.evidence.score.entry import entry
from railrepro.files import write
from railrepro.simulation.scenarios import load_scenario

DEFAULT = ("curve_entry_T3", "sine_tracking", "adhesion_loss", "braking")
"""Scenarios that are filmed when none is named."""
ALL = "all"
"""Stands for them."""
CONTROLLERS = ("nmpc", "ndi")


def main(
    scenario: str = ALL, controllers: Sequence[str] = (), setting: str = tuning.EQUAL, with_movie: bool = True
) -> None:
    """Film one scenario or the usual ones; prints where each page and movie is."""
    names = DEFAULT if scenario == ALL else (scenario,)
    controllers = tuple(controllers or CONTROLLERS)
    _check(names, controllers, setting)
    folder, files = paths.BUILD / "film", tuple(entry(controller).name for controller in controllers)
    for name in names:
        shown = film(name, controllers, setting)
        stem = "-".join((name, *files, *((setting,) if setting != tuning.EQUAL else ())))
        write(folder / f"{stem}.html", page.html(shown))
        print(f"written: {folder / stem}.html", flush=True)
        if with_movie:
            print(f"written: {movie.save(shown, folder, stem)}", flush=True)


def _check(names: tuple[str, ...], controllers: tuple[str, ...], setting: str) -> None:
    """Refuse unknown names before the first run (InputError)."""
    for name in names:
        load_scenario(name)
    for controller in controllers:
        entry(controller)
    if setting not in tuning.SETTINGS:
        raise InputError(f"setting {setting!r} is not known; there are {list(tuning.SETTINGS)}")
