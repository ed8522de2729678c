"""Rerun the chain on this machine and compare its products with the committed ones."""

from __future__ import annotations

import os
import shutil

from railrepro import paths
from railrepro.evidence.chain import compare
from railrepro.evidence.chain.chain import chain, rerun, tolerance
from railrepro.evidence.runs import store


def verify() -> int:
    """Run all notebooks in build/verify and print what differs from the committed products.

    Returns
    -------
    int
        1 when a notebook fails or a product is beyond its tolerance, else 0.
    """
    os.environ[store.FOLDER] = "off"  # a rerun computes
    root, total = paths.BUILD / "verify", compare.Comparison()
    shutil.rmtree(root, ignore_errors=True)
    findings = rerun(list(chain()), root)
    for product in [product for notebook in chain().values() for product in notebook.products]:
        result = compare.compare(paths.ROOT / product, root / product, tolerance())
        total += result
        print(f"{product}: {result}")
        findings += [f"{product}: {result}"] if result.different else []
    print(f"all: {total}")
    for line in findings:
        print(f"not reproduced: {line}")
    return int(bool(findings))
