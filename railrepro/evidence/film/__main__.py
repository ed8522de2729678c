"""`python -m railrepro.evidence.film curve_entry_T3 nmpc ndi`: page and movie in build/film, for `make film`."""

from __future__ import annotations

import argparse
import sys

from railrepro import paths
from railrepro.control.registry import REGISTERED
from railrepro.errors import InputError, told
from railrepro.evidence.film import movie, page
from railrepro.evidence.film.scene import film
from railrepro.evidence.runs import tuning
from railrepro.files import write
from railrepro.simulation.scenarios import load_scenario

DEFAULT = ("curve_entry_T3", "sine_tracking", "adhesion_loss", "braking")
"""Scenarios that are filmed when none is named."""
ALL = "all"
"""Stands for them."""
CONTROLLERS = ("nmpc", "ndi")


def main(arguments: list[str]) -> None:
    """Film one scenario or the usual ones; each page and movie is told where it is."""
    parser = argparse.ArgumentParser("python -m railrepro.evidence.film", description="Two controllers side by side.")
    parser.add_argument("scenario", nargs="?", default=ALL, help=f"key of scenarios.toml; default {', '.join(DEFAULT)}")
    parser.add_argument("controllers", nargs="*", help=f"two registered names; default {' '.join(CONTROLLERS)}")
    parser.add_argument("--setting", default=tuning.EQUAL, help=f"one of {', '.join(tuning.SETTINGS)}; default equal")
    parser.add_argument("--no-movie", action="store_true", help="only the page")
    given = parser.parse_args(arguments)
    names = DEFAULT if given.scenario == ALL else (given.scenario,)
    controllers = tuple(given.controllers or CONTROLLERS)
    _check(names, controllers, given.setting)
    folder = paths.BUILD / "film"
    for name in names:
        shown = film(name, controllers, given.setting)
        stem = "-".join((name, *controllers, *((given.setting,) if given.setting != tuning.EQUAL else ())))
        write(folder / f"{stem}.html", page.html(shown))
        print(f"written: {folder / stem}.html", flush=True)
        if not given.no_movie:
            print(f"written: {movie.save(shown, folder, stem)}", flush=True)


def _check(names: tuple[str, ...], controllers: tuple[str, ...], setting: str) -> None:
    """Refuse unknown names before the first run (InputError)."""
    for name in names:
        load_scenario(name)
    for controller in controllers:
        if controller not in tuple(REGISTERED):
            raise InputError(f"controller {controller!r} is not known; there are {sorted(REGISTERED)}")
    if setting not in tuning.SETTINGS:
        raise InputError(f"setting {setting!r} is not known; there are {list(tuning.SETTINGS)}")


if __name__ == "__main__":
    sys.exit(told(lambda: main(sys.argv[1:])))
