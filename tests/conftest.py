"""Shared settings: no display, linear algebra as the commands have it, the committed results."""

import os

import pytest

from railrepro import numerics

numerics.fix()  # before a test imports NumPy
os.environ.setdefault("MPLBACKEND", "agg")
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
