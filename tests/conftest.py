"""Shared settings: no display, single-threaded linear algebra, the committed results."""

import os

import pytest

os.environ.setdefault("MPLBACKEND", "agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("RAILREPRO_STORE", "off")  # tests run what they test
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("RAILREPRO_WORKERS", "1")


@pytest.fixture(scope="session")
def nominal():
    """Where the numbers of the report come from."""
    from railrepro.evidence.claims.nominal import Nominal

    return Nominal()


@pytest.fixture(scope="session")
def table(nominal):
    """All statements as they are judged on the committed results."""
    from railrepro.evidence.report import claims

    return claims.evaluate(nominal)
