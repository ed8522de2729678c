"""Every notebook of the chain runs with small parameters and writes what it declares."""

import pytest

from railrepro import pipeline


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("products")


@pytest.mark.parametrize("notebook", pipeline.chain(), ids=lambda notebook: notebook.name)
def test_notebook(notebook, root):
    parameters = notebook.parameters | notebook.test_parameters
    pipeline.run_notebook(notebook, parameters, root, root / "executed")
    assert all((root / product).stat().st_size > 0 for product in notebook.products)
