"""Where things are; products can be redirected to another folder.

In a checkout inputs and products lie where one edits them: in its `data`, `figures`, `notebooks`, `build`. The checkout
is the folder above this package, or `RAILREPRO_ROOT`. An installed package has none: it carries a copy of the inputs
(pyproject.toml says which), and what it writes goes to the working folder.

With `RAILREPRO_OUTPUT` set, `product` writes below that folder and `source` prefers a file there, so notebooks run in
tests or in staging without touching committed products. A notebook that is run by hand, as in JupyterLab, writes into
build/tried/NAME: only the chain, which runs notebooks whole and records where products come from, renews them.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

from railrepro import reads

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
    path = (_redirected() or ROOT) / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def source(relative: str) -> Path:
    """Path to read an input or product from: where products are redirected if it is there, else in the checkout.

    Without a checkout inputs are those of the package: a folder `data` where one works changes nothing.
    """
    redirected = _redirected()
    places = [*([redirected] if redirected else []), *([_PACKAGE] if INSTALLED else [])]
    return next((place / relative for place in places if (place / relative).exists()), ROOT / relative)


def _redirected() -> Path | None:
    """Folder that takes the products in place of the checkout."""
    given = os.environ.get("RAILREPRO_OUTPUT")
    if given:
        return Path(given)
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    if shell is None or not (NOTEBOOKS / "chain.toml").exists():
        return None
    notebook = os.environ.get("JPY_SESSION_NAME") or shell.user_ns.get("__vsc_ipynb_file__") or "session"
    return BUILD / "tried" / Path(notebook).stem
