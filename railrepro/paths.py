"""Where things are; products can be redirected to another folder.

In a checkout inputs and products lie where one edits them: in its `data`, `figures`, `notebooks`, `build`. The checkout
is the folder above this package, or `RAILREPRO_ROOT`. An installed package has none: it carries a copy of the inputs
(pyproject.toml says which), and what it writes goes to the working folder.

With `RAILREPRO_OUTPUT` set, `product` writes below that folder and `source` prefers a file there, so notebooks run in
tests or in staging without touching committed products.
"""

from __future__ import annotations

import os
from pathlib import Path

from railrepro import reads, tried

_PACKAGE = Path(__file__).resolve().parent
_GIVEN = os.environ.get("RAILREPRO_ROOT")
INSTALLED = not _GIVEN and (_PACKAGE / "data").is_dir()
"""Whether there is no checkout, only a package with its copy of the inputs."""
ROOT = Path.cwd() if INSTALLED else Path(_GIVEN or _PACKAGE.parent)
"""The checkout, or the working folder where there is none."""
DATA, FIGURES, NOTEBOOKS, BUILD = (ROOT / name for name in ("data", "figures", "notebooks", "build"))
reads.follow(ROOT)


def product(relative: str) -> Path:
    """Path to write a product such as "data/results/fig06.csv"; its folder exists afterwards."""
    tried.redirect(ROOT)
    path = Path(os.environ.get("RAILREPRO_OUTPUT") or ROOT) / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def source(relative: str) -> Path:
    """Path to read an input or product from: below `RAILREPRO_OUTPUT` if it is there, else in the checkout.

    Without a checkout inputs are those of the package: a folder `data` where one works changes nothing.
    """
    redirected = os.environ.get("RAILREPRO_OUTPUT")
    places = [*([Path(redirected)] if redirected else []), *([_PACKAGE] if INSTALLED else [])]
    return next((place / relative for place in places if (place / relative).exists()), ROOT / relative)
