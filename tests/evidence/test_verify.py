"""Verification: every product is compared whatever one notebook says, and other compilers are other cache entries."""

import os
import subprocess
import sys

import pandas as pd
import pytest
from chapters import write_notebook

from railrepro import paths
from railrepro.compile import codegen
from railrepro.evidence.chain import chain, compare, verify

CHAIN = """
[verify]
relative = 1e-5
image_rms = 2.0
not_compared = ["seconds"]
[[verify.own]]
table = "one.csv"
column = "loose"
rows = "a > 2"
relative = 1e-2
why = "it is loose"
[[notebook]]
name = "01_one"
title = "one"
writes = ["data/one.csv", "data/late.csv"]
[[notebook]]
name = "02_two"
title = "two"
writes = ["data/two.csv"]
"""
WRITE = "from railrepro import paths\npaths.product('data/{}').write_text('{}')"


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """Two notebooks; the first fails between its products."""
    for folder in ("notebooks", "data", "build"):
        (tmp_path / folder).mkdir()
    for name in ("ROOT", "DATA", "FIGURES", "NOTEBOOKS", "BUILD"):
        monkeypatch.setattr(paths, name, tmp_path if name == "ROOT" else tmp_path / name.lower())
    os.symlink(codegen.__file__.rsplit("/railrepro/", 1)[0] + "/railrepro", tmp_path / "railrepro")
    folder = tmp_path / "notebooks"
    (folder / "chain.toml").write_text(CHAIN)
    rows = "a,loose,seconds\\n1,100,1\\n3,{},9\\n"
    cells = [WRITE.format("one.csv", rows.format("200.5")), "assert False, 'odd'", WRITE.format("late.csv", "a\\n1\\n")]
    write_notebook(folder, cells, "01_one")
    write_notebook(folder, [WRITE.format("two.csv", "a\\n1\\n2.5\\n")], "02_two")
    committed = {"one": "a,loose,seconds\n1,100,1\n3,200,2\n", "late": "a\n1\n", "two": "a\n1\n2\n"}
    for name, text in committed.items():
        (tmp_path / "data" / f"{name}.csv").write_text(text)
    return tmp_path


def test_one_failing_notebook_hides_nothing(checkout):
    total, findings = verify.rerun(chain.chain().values(), paths.BUILD / "verify")
    assert any("01_one" in line and "odd" in line for line in findings)
    assert any(line.startswith("data/two.csv") and "2.0e-01 in a" not in line and " in a" in line for line in findings)
    assert not any(line.startswith(("data/one.csv", "data/late.csv")) for line in findings)
    assert (total.different, total.near) == (1, 1)
    assert total.largest == pytest.approx(0.25)
    assert (checkout / "data/two.csv").read_text() == "a\n1\n2\n"


@pytest.mark.parametrize(("header", "different"), [("metric", 1), ("quantity", 1), ("name", 0)])
def test_each_metric_of_a_tidy_table_has_its_own_scale(tmp_path, header, different):
    tolerance = {"relative": 1e-3, "image_rms": 2.0, "not_compared": []}
    for name, small in (("old", 0.001), ("new", 0.0011)):
        (tmp_path / f"{name}.csv").write_text(f"{header},value\nrmse_y,0.002\nrmse_y,{small}\neffort_du,1000\n")
    found = compare.compare(tmp_path / "old.csv", tmp_path / "new.csv", tolerance)
    assert found.different == different
    assert not different or found.where == "value of rmse_y" and found.largest == pytest.approx(0.05)


def test_a_column_is_as_large_as_its_largest_number_of_either_sign(tmp_path):
    tolerance = {"relative": 1e-3, "image_rms": 2.0, "not_compared": []}
    for name, small in (("old", 1.0), ("new", 1.05)):
        (tmp_path / f"{name}.csv").write_text(f"torque\n-100\n{small}\n")
    found = compare.compare(tmp_path / "old.csv", tmp_path / "new.csv", tolerance)
    assert (found.same, found.near, found.different) == (1, 1, 0) and found.largest == pytest.approx(5e-4)


@pytest.mark.parametrize("own", compare.verify_tolerance()["own"], ids=lambda own: f"{own['table']} {own['column']}")
def test_an_own_tolerance_is_for_some_rows_of_a_product(own):
    tables = [
        paths.ROOT / name for notebook in chain.chain().values() for name in notebook.products if name.endswith(".csv")
    ]
    file = next(file for file in tables if file.name == own["table"])
    table, tolerance = pd.read_csv(file), compare.verify_tolerance()
    limits = compare.limits(table, file.name, own["column"], tolerance)
    wide = limits == own["relative"]
    assert own["relative"] > tolerance["relative"] and wide.any() and ("rows" not in own) == wide.all()
    assert (limits[~wide] == tolerance["relative"]).all()
    assert (compare.limits(table, "another.csv", own["column"], tolerance) == tolerance["relative"]).all()


def test_flags_are_part_of_the_cache_key(tmp_path):
    script = "from railrepro.compile import codegen; print(codegen.build('int nothing(void) { return 0; }'))"
    objects = set()
    for flags in ("-O2", "-O0", "-O2 -march=native"):
        environment = os.environ | {"RAILREPRO_CFLAGS": flags, "RAILREPRO_ROOT": str(tmp_path)}
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        )
        objects.add(done.stdout.strip())
    assert len(objects) == 3
