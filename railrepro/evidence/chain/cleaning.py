"""What is taken out of notebooks: of committed ones all that a run adds, of executed ones what differs between runs.

Committed ones also get the tag of cells that the book folds.
"""

from __future__ import annotations

from pathlib import Path

import nbformat
from nbconvert.preprocessors import ClearMetadataPreprocessor, ClearOutputPreprocessor

from railrepro import paths
from railrepro.evidence.chain import folding

_KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def strip(path: Path) -> None:
    """Remove outputs, execution counts and metadata but tags; fold the cells that a reader may skip."""
    notebook = nbformat.read(path, 4)
    clearing = ClearOutputPreprocessor(), ClearMetadataPreprocessor(preserve_cell_metadata_mask={("tags",)})
    for step in clearing:
        notebook, _ = step.preprocess(notebook, {})
    for cell in notebook.cells:
        tags = [tag for tag in cell.metadata.get("tags", []) if tag != folding.FOLDED]
        folded = cell.cell_type == "code" and folding.is_folded(cell.source)
        tags += [folding.FOLDED] * folded
        hidden = {"jupyter": {"source_hidden": True}} if folded else {}  # the same in JupyterLab
        cell.metadata = nbformat.from_dict(({"tags": tags} if tags else {}) | hidden)
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
