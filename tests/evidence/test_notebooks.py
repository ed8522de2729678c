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
        different = differing(notebook, tmp_path)
        assert not different, "\n".join(
            [f"{notebook.name} gives other products than the committed ones:", *different, LOOK]
        )


LOOK = """
Look at the difference before anything else: what moved, by how much, and which change of yours explains it.
Open both figures, and both tables at the column named above. Only when the new ones are right and the reason stands
in the commit message does `make figures` write them in place of the committed ones."""


def differing(notebook, root):
    """A line for every product that is not that of the checkout: which, its largest difference, and in which column."""
    tolerance, lines = compare.verify_tolerance(), []
    for product in notebook.products:
        if product.endswith(compare.SUFFIXES):
            found = compare.compare(paths.ROOT / product, root / product, tolerance)
            if found.different:
                here, there = paths.ROOT / product, root / product
                lines.append(f"  {product}: {found}\n    committed {here}\n    rerun     {there}")
    return lines


def test_a_different_product_is_told_with_its_column_before_any_advice_to_renew(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "ROOT", tmp_path / "checkout")
    for folder, value in (("checkout", 2.0), ("rerun", 2.5)):
        (tmp_path / folder / "data").mkdir(parents=True)
        (tmp_path / folder / "data" / "one.csv").write_text(f"a,b\n1,{value}\n")
    monkeypatch.setattr(compare, "verify_tolerance", lambda: {"relative": 1e-5, "not_compared": []})
    (line,) = differing(chain.Notebook("01_one", "one", writes=("data/one.csv",)), tmp_path / "rerun")
    assert "data/one.csv: 1 same, 0 within tolerance, 1 different; largest difference 2.5e-01 in b" in line
    assert LOOK.index("Look at the difference") < LOOK.index("make figures")
