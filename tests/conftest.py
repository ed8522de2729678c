"""Shared settings: no display, single-threaded linear algebra, what stays together when tests run side by side."""

import os

import pytest

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("RAILREPRO_STORE", "off")  # tests run what they test
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("RAILREPRO_WORKERS", "1")


@pytest.fixture(scope="module")
def nominal():
    """Where the numbers of report and article come from."""
    from railrepro.evidence.claims.nominal import Nominal

    return Nominal()


@pytest.fixture(scope="module")
def table(nominal):
    """All statements as they are judged on the committed results."""
    from railrepro.evidence.report import claims

    return claims.evaluate(nominal)


LONG = ("test_notebooks", "test_bench", "test_tuning", "test_claims", "test_adding", "test_bad_inputs", "test_misuse")
"""Files whose tests start first, so that what comes last is short and all workers end together."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file stays with one worker, which keeps its fixtures; each notebook goes alone."""
    from xdist.scheduler import LoadScopeScheduling

    class Files(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            file = nodeid.partition("::")[0]
            return nodeid if file.endswith("test_notebooks.py") else file

    config.option.loadscopereorder = False
    return Files(config, log)


def pytest_collection_modifyitems(items):
    """What takes longest comes first."""
    items.sort(key=_turn)


def _turn(item):
    place = LONG.index(item.path.stem) if item.path.stem in LONG else len(LONG)
    notebook = getattr(item, "callspec", None) and item.callspec.params.get("notebook")
    return place, -notebook.minutes if notebook else 0.0
