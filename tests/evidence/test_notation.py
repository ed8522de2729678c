"""Every Python name in the notation table exists."""

import pkgutil
import re

import pandas as pd

from railrepro import paths

TABLE = pd.read_csv(paths.DATA / "notation.csv", keep_default_na=False)
WORDS = set(re.findall(r"\w+", "\n".join(file.read_text() for file in (paths.ROOT / "railrepro").rglob("*.py"))))


def known(name):
    """Whether a name of the library is there, or the words of another one (column of a run, key of the car) occur."""
    home, _, last = name.rpartition(".")
    if not name.startswith("railrepro."):
        return set(name.split(".")) <= WORDS
    owner = pkgutil.resolve_name(home)
    return hasattr(owner, last) or last in getattr(owner, "__annotations__", {})


def test_every_name_exists():
    names = {entry.rpartition(" ")[2] for cell in TABLE["python"] for entry in re.split("[,;] ", cell)}
    assert len(names) > 100
    assert [name for name in sorted(names) if not known(name)] == []
