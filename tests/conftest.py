"""Shared settings: no display, single-threaded linear algebra, what stays together when tests run side by side."""

import os

import pytest

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("RAILREPRO_WORKERS", "1")


LONG = ("test_notebooks", "test_bench", "test_tuning", "test_claims", "test_adding", "test_bad_inputs")
"""Files whose tests start first, so that what comes last is short and all workers end together."""


@pytest.hookimpl(tryfirst=True)  # xdist reads the groups in the same hook
def pytest_collection_modifyitems(items):
    """A file stays with one worker, which keeps its fixtures; notebooks go alone, those that take longest first."""
    items.sort(key=_turn)
    for item in items:
        item.add_marker(pytest.mark.xdist_group(item.name if _notebook(item) else item.path.stem))


def _turn(item):
    place = LONG.index(item.path.stem) if item.path.stem in LONG else len(LONG)
    return place, -_notebook(item).minutes if _notebook(item) else 0.0


def _notebook(item):
    """The notebook that a test runs, or None."""
    return getattr(item, "callspec", None) and item.callspec.params.get("notebook")
