"""Where things are; products can be redirected to another folder.

With `RAILREPRO_OUTPUT` set, `product` writes below that folder and `source` prefers a file there, so notebooks run in
tests or in staging without touching committed products.
"""

from __future__ import annotations

import os
from pathlib import Path

from railrepro import tried

ROOT = Path(os.environ.get("RAILREPRO_ROOT") or Path(__file__).resolve().parent.parent)
DATA, FIGURES, NOTEBOOKS, BUILD = (ROOT / name for name in ("data", "figures", "notebooks", "build"))


def _output() -> Path:
    return Path(os.environ.get("RAILREPRO_OUTPUT") or ROOT)


def product(relative: str) -> Path:
    """Path to write a product such as "data/results/fig06.csv"; its folder exists afterwards."""
    tried.redirect(ROOT)
    path = _output() / relative
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def source(relative: str) -> Path:
    """Path to read an input or product from: below `RAILREPRO_OUTPUT` if it is there, else in the checkout."""
    redirected = _output() / relative
    return redirected if redirected.exists() else ROOT / relative
