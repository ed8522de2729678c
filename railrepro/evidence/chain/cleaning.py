"""What is taken out of notebooks: of committed ones all that a run adds, of executed ones what differs between runs."""

from __future__ import annotations

from pathlib import Path

import nbformat
from nbconvert.preprocessors import ClearMetadataPreprocessor, ClearOutputPreprocessor

from railrepro import paths

_KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def strip(path: Path) -> None:
    """Remove outputs, execution counts and metadata but tags; name cells c01, c02, …"""
    notebook = nbformat.read(path, 4)
    clearing = ClearOutputPreprocessor(), ClearMetadataPreprocessor(preserve_cell_metadata_mask={("tags",)})
    for step in clearing:
        notebook, _ = step.preprocess(notebook, {})
    for i, cell in enumerate(notebook.cells):
        cell["id"] = f"c{i + 1:02d}"
    notebook.metadata = nbformat.from_dict({"kernelspec": _KERNEL, "language_info": {"name": "python"}})
    nbformat.write(notebook, path)


def strip_all() -> None:
    """Strip every notebook of the checkout."""
    for path in sorted(paths.NOTEBOOKS.glob("*.ipynb")):
        strip(path)


def deterministic(path: Path) -> None:
    """Remove what differs between two equal runs: times, metadata of papermill, ids of injected cells."""
    notebook = nbformat.read(path, 4)
    notebook.metadata.pop("papermill", None)
    for i, cell in enumerate(notebook.cells):
        for key in ("papermill", "execution"):
            cell.metadata.pop(key, None)
        if "injected-parameters" in cell.metadata.get("tags", []):
            cell["id"] = f"injected-{i}"
        if cell.cell_type == "code":
            cell.outputs = [o for o in cell.outputs if o.get("name") != "stderr"]
    nbformat.write(notebook, path)
