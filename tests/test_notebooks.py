"""Every notebook of the chain runs with small parameters and writes what it declares; quick ones run in full."""

import pytest

from railrepro import paths
from railrepro.chain import compare, graph, runner


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("products")


@pytest.mark.parametrize("notebook", graph.chain(), ids=lambda notebook: notebook.name)
def test_notebook(notebook, root):
    parameters = notebook.parameters | notebook.test_parameters
    runner.run_notebook(notebook, parameters, root, root / "executed")
    assert all((root / product).stat().st_size > 0 for product in notebook.products)
    if not notebook.test_parameters:  # the real run, so numbers and images must be the committed ones
        assert not differing(notebook, root), "products are stale, `make figures` renews them"


def differing(notebook, root):
    """Products that are not those of the checkout."""
    tolerance = graph.verify_tolerance()
    compared = [product for product in notebook.products if product.endswith(compare.SUFFIXES)]
    return [p for p in compared if compare.compare(paths.ROOT / p, root / p, tolerance).different]
