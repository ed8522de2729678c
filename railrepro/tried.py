"""Notebooks run by hand, as in JupyterLab: what they write goes beside the committed products, not over them.

Only the chain renews products: it runs notebooks whole, with their own parameters, and records where they come from.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

_said: set[int] = set()


def redirect(root: Path) -> None:
    """In an interactive session of a checkout send products to build/tried/NAME; says so once per cell.

    Parameters
    ----------
    root : Path
        The checkout. Where `RAILREPRO_OUTPUT` is set or there is no chain of notebooks nothing happens.
    """
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    tried = root / "build" / "tried"
    output = os.environ.get("RAILREPRO_OUTPUT")
    ours = output is not None and Path(output).parent == tried
    if shell is None or not (ours or (not output and (root / "notebooks" / "chain.toml").exists())):
        return
    if not ours:
        file = os.environ.get("JPY_SESSION_NAME") or shell.user_ns.get("__vsc_ipynb_file__") or "session"
        os.environ["RAILREPRO_OUTPUT"] = str(tried / Path(file).stem)  # worker processes inherit it
    if shell.execution_count not in _said:
        _said.add(shell.execution_count)
        folder = Path(os.environ["RAILREPRO_OUTPUT"]).relative_to(root)
        print(f"run by hand: products go to {folder}; `make figures` renews those in data and figures")
