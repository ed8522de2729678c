"""The chain: staleness, whole products, failing cells, determinism, clean notebooks."""

import json
import re
import sys
import types

import psutil
import pytest
from chapters import CELLS, write_chain, write_notebook

from railrepro import code, paths
from railrepro.data import InputError
from railrepro.evidence.chain import chain
from railrepro.studies import store

SCENARIOS, HEAD = "data/scenarios.toml", CELLS[:2]


def test_products_appear_once_and_again_when_deleted_or_changed(tiny, capfd):
    product, manifest = tiny / "data/results/out.csv", tiny / "data/MANIFEST.csv"
    assert chain.figures() == 0
    assert product.read_text() == "a\n1\n"
    written = manifest.read_text()
    assert "data/results/out.csv" in written and "01_tiny" in written
    assert re.search(r"^01_tiny: done in \S+ min with \S+ GB; 0 left$", capfd.readouterr().err, re.M)
    children = psutil.Process().children(recursive=True)
    assert not [one for one in children if "ipykernel_launcher" in one.cmdline()], "a kernel ends with its notebook"
    manifest.write_text("path,sha256,made_by,inputs_sha256,seed\ndata/old.csv,0,01_tiny,0,\n")
    assert chain.figures() == 0
    assert capfd.readouterr().err == "0 of 1 notebooks are stale\n"
    assert manifest.read_text() == written
    product.unlink()
    executed = (tiny / "build/notebooks/01_tiny.ipynb").read_bytes()
    chain.figures(["01"])
    assert product.exists() and (tiny / "build/notebooks/01_tiny.ipynb").read_bytes() == executed


@pytest.mark.parametrize(
    ("last", "sentence"),
    [
        ("import sys\nsys.exit(0)", "did not write data/results/out.csv"),
        ("import os\nos._exit(1)", "its kernel did not start or ended early"),
    ],
)
def test_failures_name_the_place_and_leave_the_old_product(tiny, last, sentence):
    chain.refresh(chain.chain()["01_tiny"])
    write_notebook(tiny / "notebooks", [*HEAD, last])
    with pytest.raises(InputError, match=f"01_tiny: {sentence}"):
        chain.refresh(chain.chain()["01_tiny"])
    assert (tiny / "build/notebooks/01_tiny.failed.ipynb").exists()
    assert (tiny / "data/results/out.csv").read_text() == "a\n1\n"


def test_the_memory_of_a_notebook_is_that_of_its_kernel_and_of_what_that_starts(tiny):
    child = "hog = bytearray(3 * 10**8); hog[::4096] = b'x' * len(hog[::4096]); import time; time.sleep(1)"
    started = f"import subprocess, sys\nsubprocess.run([sys.executable, '-c', {child!r}])"
    write_notebook(tiny / "notebooks", [*CELLS, started])
    ran = chain.refresh(chain.chain()["01_tiny"])
    assert 0.35 < ran.memory_gb < 0.8 and ran.minutes > 1 / 60
    assert chain.last_run(chain.chain()["01_tiny"])["memory_gb"] == ran.memory_gb


def test_a_notebook_reads_no_product_of_another_and_one_that_fails_stops_no_other(tiny, capfd):
    writes, reads = "paths.product('data/{}').write_text('a\\n1\\n')\n", "open(paths.source('data/{}')).read()\n"
    contents = {"01_a": writes.format("01_a"), "02_b": reads.format("01_a") + writes.format("02_b"), "03_c": "1 / 0"}
    contents["04_d"] = writes.format("04_d") + reads.format("04_d") + reads.format("in.txt")
    write_chain(tiny, contents)
    for name in ("01_a", "in.txt"):
        (tiny / "data" / name).write_text("0")
    assert chain.figures() == 1
    said = capfd.readouterr().err
    assert "4 of 4 notebooks are stale" in said and "Traceback" not in said
    assert "error: 02_b: reads data/01_a, which 01_a writes" in said
    assert "error: 03_c: cell 3 failed with ZeroDivisionError: division by zero (outputs in " in said
    assert [(tiny / "data" / name).exists() for name in contents] == [True, False, False, True]
    rows = (tiny / "data/MANIFEST.csv").read_text().split()[1:]
    assert [row.split(",")[:3:2] for row in rows] == [["data/01_a", "01_a"], ["data/04_d", "04_d"]]
    (tiny / "data/in.txt").write_text("5")
    assert chain.why_stale(chain.chain()["04_d"]) == "data/in.txt"


def test_only_the_entries_that_a_chapter_reads_make_it_stale(tiny):
    entry, file = '[{}]\ntrack = "T1"\nspeed_kmh = 40\nend_m = {}\n', tiny / SCENARIOS
    one, two, new = entry.format("one", 5), entry.format("two", 8), entry.format("new", 9)
    file.write_text(one + two)
    text = "from railrepro.simulation.scenarios import load_scenario, load_scenarios\nvalue = {}\n"
    text += "paths.product('data/{}').write_text(str(value))"
    reads = {"01_one": "load_scenario('one').end_m", "02_all": "sum(s.end_m for s in load_scenarios().values())"}
    write_chain(tiny, {name: text.format(read, name) for name, read in reads.items()})
    assert chain.figures() == 0
    for edited, whys in {
        one + two: ["", ""],
        "# a remark\n" + one + two: ["", ""],
        one.replace("5", "6") + two: [f"{SCENARIOS} [one]"] * 2,
        one + two.replace("8", "7"): ["", f"{SCENARIOS} [two]"],
        one + two + new: ["", f"{SCENARIOS}, names of entries and 1 more"],
    }.items():
        file.write_text(edited)
        assert [chain.why_stale(each) for each in chain.chain().values()] == whys, edited


def test_an_input_that_is_edited_while_a_chapter_runs_makes_it_stale(tiny):
    (tiny / "data/in.txt").write_text("1")
    edit = "import time\nfile = paths.ROOT / 'data/in.txt'\nfile.read_text()\ntime.sleep(0.1)\nfile.write_text('2')\n"
    write_notebook(tiny / "notebooks", [*HEAD, edit + CELLS[2]])
    assert chain.figures() == 0
    assert chain.why_stale(chain.chain()["01_tiny"]) == chain.EDITED and not (tiny / "data/MANIFEST.csv").exists()


def test_a_stale_chapter_names_what_changed(tiny, monkeypatch):
    monkeypatch.setattr(store, "machine", store.machine.__wrapped__)
    monkeypatch.delenv("RAILREPRO_CFLAGS", raising=False)
    notebook, known = chain.chain()["01_tiny"], code._source_hash
    assert chain.why_stale(notebook) == "it has not run here"
    chain.figures()
    state = chain.inputs(notebook, {})
    assert chain.why_stale(notebook) == ""
    for file, text, why in (
        (tiny / "data/results/out.csv", "other", "data/results/out.csv was changed or is missing"),
        (notebook.path, notebook.path.read_text().replace("value = 1", "value = 2"), "its cells"),
        (notebook.stamp, "{", "it has not run here"),
    ):
        before = file.read_text()
        file.write_text(text)
        assert chain.why_stale(notebook) == why
        file.write_text(before)
    with monkeypatch.context() as patch:
        patch.setattr(code, "_source_hash", lambda name: "other" if name == "railrepro/paths.py" else known(name))
        assert chain.why_stale(notebook) == "railrepro/paths.py"
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    assert chain.why_stale(notebook) == "environment OPENBLAS_CORETYPE"
    assert chain.inputs(notebook, {}) == state, "the machine is no part of a manifest"
    monkeypatch.setattr(code, "packages", lambda: {"numpy": "another one"})
    assert chain.inputs(notebook, {}) != state


def test_committed_notebooks_are_in_the_chain_and_clean():
    assert sorted(path.stem for path in paths.NOTEBOOKS.glob("*.ipynb")) == list(chain.chain())
    written = [product for each in chain.chain().values() for product in each.products]
    assert len(written) == len(set(written)), "two notebooks write one product"
    for each in chain.chain().values():
        cells = [cell for cell in json.loads(each.path.read_text())["cells"] if cell["cell_type"] == "code"]
        assert not any(cell["outputs"] or cell["execution_count"] for cell in cells), each.name
        (chosen,) = [cell for cell in cells if "parameters" in cell["metadata"].get("tags", [])]
        for name in each.parameters | each.test_parameters:
            assert re.search(rf"^{name} = ", "".join(chosen["source"]), re.M), (each.name, name)


def test_what_runs_by_hand_leaves_committed_products_as_they_are(tiny, monkeypatch):
    monkeypatch.delenv("RAILREPRO_OUTPUT", raising=False)
    shell = types.SimpleNamespace(get_ipython=lambda: types.SimpleNamespace(user_ns={}))
    monkeypatch.setitem(sys.modules, "IPython", shell)
    monkeypatch.setenv("JPY_SESSION_NAME", "notebooks/06_curve_entry.ipynb")
    written = paths.product("data/results/one.csv")
    assert written == tiny / "build/tried/06_curve_entry/data/results/one.csv"
    written.write_text("tried")
    assert paths.source("data/results/one.csv") == written
