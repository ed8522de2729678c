"""Rerun the chain on this machine and compare its products with the committed ones."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from railrepro import paths
from railrepro.data import InputError
from railrepro.evidence.chain import compare
from railrepro.evidence.chain.chain import Notebook, chain, run
from railrepro.evidence.chain.files import written
from railrepro.evidence.runs import store

QUICK_MINUTES = 0.65
"""Longest stated run time of a notebook of the quick rerun (minutes)."""
MARK = ".railrepro-output"
"""File in a folder that this library made for output and may therefore empty."""


def rerun(notebooks: Sequence[Notebook], root: Path) -> tuple[compare.Comparison, list[str]]:
    """Run notebooks beside the checkout and compare all their products with the committed ones.

    Parameters
    ----------
    notebooks : sequence of Notebook
    root : Path
        Folder for the products of the rerun; emptied first, see `emptied`.

    Returns
    -------
    total : Comparison
    findings : list of str
        One line per notebook that failed and per product that differs; empty is good.
    """
    os.environ[store.FOLDER] = "off"  # a rerun computes
    emptied(root)
    tolerance, total, findings = compare.verify_tolerance(), compare.Comparison(), []
    for notebook in notebooks:
        print(f"{notebook.name}: running, about {notebook.minutes:g} min", file=sys.stderr, flush=True)
        try:
            run(notebook, notebook.parameters, root, root / "notebooks", keep_going=True)
        except InputError as error:
            findings.append(str(error))
        for product in notebook.products:
            if product.endswith(compare.SUFFIXES):
                result = compare.compare(paths.ROOT / product, root / product, tolerance)
                total += result
                print(f"{product}: {result}", flush=True)
                findings += [f"{product}: {result}"] if result.different else []
    return total, findings


def emptied(folder: Path) -> None:
    """Make a folder empty, and mark it as one that may be emptied again.

    Raises
    ------
    InputError
        When it holds anything and was not made by this function, or cannot be written; what was there is intact.
    """
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise InputError(f"{folder}: is no folder, an empty or a new one is needed")
    with written():
        if folder.is_dir() and any(folder.iterdir()):
            if not (folder / MARK).is_file():
                raise InputError(f"{folder}: holds files that no run of railrepro wrote; name an empty or a new folder")
            shutil.rmtree(folder)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MARK).touch()


def verify(quick: bool = False, into: Path | None = None) -> int:
    """Rerun the chain and print what differs; 1 when a notebook fails or a product is beyond its tolerance, else 0.

    `quick` takes the notebooks of at most `QUICK_MINUTES`; the products land in `into` (default build/verify), a folder
    that is empty or of an earlier rerun.
    """
    notebooks = [notebook for notebook in chain().values() if not quick or notebook.minutes <= QUICK_MINUTES]
    total, findings = rerun(notebooks, into or paths.BUILD / "verify")
    print(f"all: {total}")
    for line in findings:
        print(f"not reproduced: {line}")
    return int(bool(findings))
