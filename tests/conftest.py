"""Shared settings: no display, single-threaded linear algebra, what stays together when tests run side by side."""

import os

import pytest

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("RAILREPRO_WORKERS", "1")


def pytest_collection_modifyitems(items):
    """A file stays with one worker, which keeps its fixtures; notebooks go alone and first, as they take longest."""
    items.sort(key=lambda item: item.path.stem != "test_notebooks")
    for item in items:
        alone = item.path.stem == "test_notebooks"
        item.add_marker(pytest.mark.xdist_group(item.name if alone else item.path.stem))
