"""The chain: staleness, whole products, failing cells, determinism, clean notebooks."""

import re
import sys
import types

import psutil
import pytest
from chapters import CELLS, write_notebook

from railrepro import code, paths
from railrepro.data import InputError
from railrepro.evidence.chain import chain
from railrepro.evidence.runs import store

COMMITTED, SCENARIOS = paths.ROOT, "data/scenarios.toml"


def test_products_appear_once_and_again_when_deleted_or_changed(tiny, capfd):
    product = tiny / "data/results/out.csv"
    assert chain.figures() == 0
    assert product.read_text() == "a\n1\n"
    manifest = (tiny / "data/MANIFEST.csv").read_text()
    assert "data/results/out.csv" in manifest and "01_tiny" in manifest
    assert "01_tiny: done; 0 left" in capfd.readouterr().err
    children = psutil.Process().children(recursive=True)
    assert not [one for one in children if "ipykernel_launcher" in one.cmdline()], "a kernel ends with its notebook"
    (tiny / "data/MANIFEST.csv").write_text("path,sha256,made_by,inputs_sha256,seed\ndata/old.csv,0,01_tiny,0,\n")
    assert chain.figures() == 0
    assert capfd.readouterr().err == "0 of 1 notebooks are stale\n"
    assert (tiny / "data/MANIFEST.csv").read_text() == manifest
    product.unlink()
    executed = (tiny / "build/notebooks/01_tiny.ipynb").read_bytes()
    chain.figures(["01"])
    assert product.exists() and (tiny / "build/notebooks/01_tiny.ipynb").read_bytes() == executed
    write_notebook(tiny / "notebooks", [CELLS[0], "value = 2", CELLS[2]])
    chain.refresh(chain.chain()["01_tiny"])
    assert product.read_text() == "a\n2\n"


@pytest.mark.parametrize("ending", ["1", "os._exit(1)"])
def test_what_a_kernel_writes_beside_its_cells_is_shown_where_it_ends_early(tiny, capfd, ending):
    write_notebook(tiny / "notebooks", [*CELLS, f"import os; os.write(2, b'of a socket'); {ending}"])
    failed = bool(chain.figures())
    assert ("of a socket" in capfd.readouterr().err) == failed == (ending != "1")


def test_executed_notebooks_are_identical_bytes(tiny):
    executed = []
    for _ in range(2):
        chain.run(chain.chain()["01_tiny"], {"value": 5}, tiny / "elsewhere", tiny / "build" / "nb")
        executed.append((tiny / "build/nb/01_tiny.ipynb").read_bytes())
    assert executed[0] == executed[1]
    assert (tiny / "elsewhere/data/results/out.csv").read_text() == "a\n5\n", "the parameter of this run"
    assert not (tiny / "data/results/out.csv").exists()


@pytest.mark.parametrize(
    ("last", "sentence"),
    [
        ("import sys\nsys.exit(0)", "failed with|not executed|did not write"),
        ("import os\nos.write(2, b'of a socket')\nos._exit(1)", "the kernel did not start or ended before its time"),
        ("pass", "did not write data/results/out.csv"),
        (None, "01_tiny: has no parameter 'speed'"),
    ],
)
def test_failures_name_the_place_and_leave_the_old_product(tiny, last, sentence, capfd):
    chain.refresh(chain.chain()["01_tiny"])
    if last is None:
        with open(tiny / "notebooks/chain.toml", "a") as file:
            file.write("parameters = { speed = 1 }\n")
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], last or CELLS[2]])
    with pytest.raises(InputError, match=sentence) as failed:
        chain.refresh(chain.chain()["01_tiny"])
    assert "\n" not in str(failed.value)
    assert ("of a socket" in capfd.readouterr().err) == ("before its time" in sentence)
    assert (tiny / "data/results/out.csv").read_text() == "a\n1\n"


ENTRY = '[[notebook]]\nname = "{0}"\ntitle = "x"\nwrites = ["data/{1}"]\n'


def test_a_notebook_reads_no_product_of_another_and_one_that_fails_stops_no_other(tiny, capfd):
    writes, reads = "paths.product('data/{}').write_text('a\\n1\\n')", "open(paths.source('data/{}')).read()"
    contents = {
        "01_a": (writes.format("01_a"),),
        "02_b": (reads.format("01_a"), writes.format("02_b")),
        "03_c": ("1 / 0",),
        "04_d": (writes.format("04_d"), reads.format("04_d"), reads.format("in.txt")),
    }
    (tiny / "notebooks/chain.toml").write_text("".join(ENTRY.format(name, name) for name in contents))
    for name, lines in contents.items():
        write_notebook(tiny / "notebooks", [CELLS[0], "v = 1", "\n".join(lines)], name)
    for name in ("01_a", "in.txt"):
        (tiny / "data" / name).write_text("0")
    assert chain.figures(jobs=2) == 1
    told = capfd.readouterr().err
    assert "4 of 4 notebooks are stale" in told and "Traceback" not in told
    assert "error: 02_b: reads data/01_a, which 01_a writes" in told
    assert "error: 03_c: cell 3 failed with ZeroDivisionError: division by zero (kept build/notebooks/03_c.f" in told
    assert [(tiny / "data" / name).exists() for name in contents] == [True, False, False, True]
    rows = (tiny / "data/MANIFEST.csv").read_text().split()[1:]
    assert [row.split(",")[:3:2] for row in rows] == [["data/01_a", "01_a"], ["data/04_d", "04_d"]]
    (tiny / "data/in.txt").write_text("5")
    assert chain.why_stale(chain.chain()["04_d"]) == "data/in.txt"


def test_only_the_entries_that_a_chapter_reads_make_it_stale(tiny):
    entry, file = '[{}]\ntrack = "T1"\nspeed_kmh = 40\nend_m = {}\n', tiny / SCENARIOS
    one, two, new = entry.format("one", 5), entry.format("two", 8), entry.format("new", 9)
    file.write_text(one + two)
    loads = {"01_one": "load_scenario('one').end_m", "02_all": "sum(s.end_m for s in load_scenarios().values())"}
    (tiny / "notebooks/chain.toml").write_text("".join(ENTRY.format(name, name) for name in loads))
    for name, read in loads.items():
        text = f"from railrepro.simulation.scenarios import load_scenario, load_scenarios\nvalue = {read}\n"
        text += f"paths.product('data/{name}').write_text(str(value))"
        write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], text], name)
    assert chain.figures(jobs=2) == 0
    for text, whys in {
        one + two: ["", ""],
        "# a remark\n" + one + two: ["", ""],
        one.replace("5", "6") + two: [f"{SCENARIOS} [one]"] * 2,
        one + two.replace("8", "7"): ["", f"{SCENARIOS} [two]"],
        one + two + new: ["", f"{SCENARIOS}, names of entries and 1 more"],
        "not TOML": [f"{SCENARIOS} and 1 more", f"{SCENARIOS} and 3 more"],
    }.items():
        file.write_text(text)
        assert [chain.why_stale(notebook) for notebook in chain.chain().values()] == whys, text


def test_an_input_that_is_edited_while_a_chapter_runs_makes_it_stale(tiny):
    (tiny / "data/in.txt").write_text("1")
    edit = "import time\nfile = paths.ROOT / 'data/in.txt'\nfile.read_text()\ntime.sleep(0.1)\nfile.write_text('2')\n"
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], edit + CELLS[2]])
    chain.refresh(chain.chain()["01_tiny"])
    assert chain.why_stale(chain.chain()["01_tiny"]) == chain.EDITED


def test_a_stale_chapter_names_what_changed(tiny, monkeypatch):
    monkeypatch.setattr(store, "machine", store.machine.__wrapped__)
    monkeypatch.delenv("RAILREPRO_CFLAGS", raising=False)
    notebook, product, known = chain.chain()["01_tiny"], tiny / "data/results/out.csv", code._source_hash
    assert chain.why_stale(notebook) == "it has not run here"
    with monkeypatch.context() as patch:
        patch.setattr(code, "unchanged", lambda: False)
        chain.figures()
    assert chain.why_stale(notebook) == chain.EDITED and not (tiny / "data/MANIFEST.csv").exists()
    chain.figures()
    found = chain.inputs(notebook, {})
    (tiny / "environment.lock").write_text("ruff==0.1\n")
    assert chain.why_stale(notebook) == ""
    for file, text, why in (
        (product, "other", "data/results/out.csv was changed or is missing"),
        (notebook.path, notebook.path.read_text().replace("value = 1", "value = 2"), "its cells"),
        (notebook.stamp, '{"inputs": {}, "products": {}}', "it has not run here"),
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
    assert chain.inputs(notebook, {}) == found, "the machine is no part of a manifest"
    monkeypatch.setattr(code, "packages", lambda: {"numpy": "another one"})
    assert chain.inputs(notebook, {}) != found


def test_committed_notebooks_are_in_the_chain_and_clean():
    assert sorted(path.stem for path in paths.NOTEBOOKS.glob("*.ipynb")) == list(chain.chain())
    for notebook in chain.chain().values():
        code = [cell for cell in chain.cells(notebook) if cell["cell_type"] == "code"]
        assert not any(cell["outputs"] or cell["execution_count"] for cell in code), notebook.name
        assert sum("parameters" in cell["metadata"].get("tags", []) for cell in code) == 1, notebook.name
        assert not any(re.search(r"import \*|sys\.path|/home/|/root/", cell["source"]) for cell in code), notebook.name


def test_what_runs_by_hand_leaves_committed_products_as_they_are(tiny, monkeypatch):
    monkeypatch.setenv("RAILREPRO_OUTPUT", "")
    assert paths.product("data/one.csv") == tiny / "data/one.csv"
    shell = types.SimpleNamespace(user_ns={})
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setenv("JPY_SESSION_NAME", "notebooks/06_curve_entry.ipynb")
    written = paths.product("data/results/one.csv")
    assert written == tiny / "build/tried/06_curve_entry/data/results/one.csv"
    written.write_text("tried")
    assert paths.source("data/results/one.csv") == written
    monkeypatch.setenv("RAILREPRO_OUTPUT", str(tiny / "staging"))
    assert paths.product("data/one.csv") == tiny / "staging/data/one.csv"


def test_chapters_run_with_a_car_of_ones_own_beside_what_is_committed(tiny, tmp_path, capfd):
    mine = tmp_path / "mine.toml"
    mine.write_text((COMMITTED / "data/vehicle.toml").read_text().replace("value = 26000.0", "value = 24000.0"))
    last = """from railrepro import load_vehicle
from railrepro.evidence.report.sentences import sentences
mass = load_vehicle().body.mass
with sentences() as says: says(f"The body has {mass / 1e3:.0f} t.", mass == 26000)
paths.product("data/results/out.csv").write_text(f"a\\n{mass}\\n")"""
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], last])
    assert chain.drive(mine) == 0
    assert "01_tiny: does not hold on this car: The body has 24 t." in capfd.readouterr().err
    assert (tiny / "build/tried/mine/data/results/out.csv").read_text() == "a\n24000.0\n"
    assert not (tiny / "data/results/out.csv").exists()
    with pytest.raises(InputError, match="nowhere.toml"):
        chain.drive(tmp_path / "nowhere.toml")
