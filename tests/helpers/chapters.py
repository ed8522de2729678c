"""Small notebooks for tests of the chain."""

import json

CELLS = [
    "from railrepro import paths",
    "value = 1  # anything",
    "path = paths.product('data/results/out.csv')\npath.write_text(f'a\\n{value}\\n')\nprint(value)",
]
"""Cells of the notebook of the fixture `tiny`."""


def write_notebook(folder, cells, name="01_tiny"):
    """Write a notebook of code cells, of which the second one, if any, has the parameters."""
    entries = []
    for i, source in enumerate(cells):
        tags = {"tags": ["parameters"]} if i == 1 else {}
        cell = {"cell_type": "code", "id": f"c{i}", "metadata": tags, "source": source}
        entries.append(cell | {"outputs": [], "execution_count": None})
    metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    content = {"cells": entries, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}
    (folder / f"{name}.ipynb").write_text(json.dumps(content))


def write_chain(folder, contents, head=""):
    """Notebooks of a checkout, name -> text of the cell that makes the product data/NAME; `head` begins chain.toml."""
    entries = [f'[[notebook]]\nname = "{name}"\ntitle = "x"\nwrites = ["data/{name}"]\n' for name in contents]
    (folder / "notebooks/chain.toml").write_text(head + "".join(entries))
    for name, text in contents.items():
        write_notebook(folder / "notebooks", [*CELLS[:2], text], name)
