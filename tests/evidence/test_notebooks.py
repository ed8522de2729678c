"""Every notebook of the chain runs with small parameters and writes what it declares; quick ones run in full."""

import pytest

from railrepro import paths
from railrepro.evidence.chain import chain, compare


@pytest.mark.parametrize("notebook", chain.chain().values(), ids=lambda notebook: notebook.name)
def test_notebook(notebook, tmp_path):
    """In a folder of its own: what a chapter reads is committed, not what another one wrote with small parameters."""
    parameters = notebook.parameters | notebook.test_parameters
    chain.run(notebook, parameters, tmp_path, tmp_path / "executed")
    assert all((tmp_path / product).stat().st_size > 0 for product in notebook.products)
    if not notebook.test_parameters:  # the real run, so numbers and images must be the committed ones
        pairs = [(paths.ROOT / product, tmp_path / product) for product in notebook.products]
        found = [(old, new, compare.compare(old, new, chain.tolerance())) for old, new in pairs]
        different = [
            f"  {old.name}: {compare.summary(entries)}\n    committed {old}\n    rerun     {new}"
            for old, new, entries in found
            if (entries["outcome"] == compare.DIFFERENT).any()
        ]
        assert not different, "\n".join(["other products than the committed ones:", *different, LOOK])


LOOK = """
Look at the difference before anything else: what moved, by how much, and which change of yours explains it.
Only when the new ones are right and the reason stands in the commit message, let `make figures` write them."""
