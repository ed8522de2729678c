"""How the evidence is made and judged, on top of the library: runs, claims, uncertainty, report, chapters."""

import sys
from itertools import pairwise


def _refuse() -> None:
    """Refuse `python -m` with a module here, which would do nothing: all commands are `python -m railrepro COMMAND`."""
    if sys.argv[:1] != ["-m"]:
        return
    parts = (
        part if option == "-m" else part[2:] for option, part in pairwise(sys.orig_argv) if "-m" in (option, part[:2])
    )
    name = next(filter(None, parts), "")
    if name.startswith(f"{__name__}."):
        sys.exit(f"error: {name} is no command; `python -m railrepro --help` lists those there are")


_refuse()
