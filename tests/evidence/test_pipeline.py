"""The chain: staleness, whole products, failing cells, determinism, clean notebooks."""

import json
import re
import shutil
import sys
import types

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
    (tiny / "data/MANIFEST.csv").write_text("path,sha256,made_by,inputs_sha256,seed\ndata/old.csv,0,01_tiny,0,\n")
    assert chain.figures() == 0
    assert capfd.readouterr().err == "0 of 1 notebooks are stale\n"
    assert (tiny / "data/MANIFEST.csv").read_text() == manifest
    product.unlink()
    chain.figures(["01"])
    assert product.exists()
    write_notebook(tiny / "notebooks", [CELLS[0], "value = 2", CELLS[2]])
    chain.refresh(chain.chain()["01_tiny"])
    assert product.read_text() == "a\n2\n"


@pytest.mark.parametrize(("ending", "shown"), [("1", False), ("os._exit(1)", True)])
def test_what_a_kernel_writes_beside_its_cells_is_shown_where_it_ends_early(tiny, capfd, ending, shown):
    """A kernel that is asked to stop may write a traceback about its sockets."""
    write_notebook(
        tiny / "notebooks", [CELLS[0], CELLS[1], f"import os; os.write(2, b'of a socket'); {ending}", CELLS[2]]
    )
    assert chain.figures() == int(shown)
    assert ("of a socket" in capfd.readouterr().err) == shown


def test_executed_notebooks_are_identical_bytes(tiny):
    executed = []
    for _ in range(2):
        chain.run(chain.chain()["01_tiny"], {"value": 5}, tiny / "elsewhere", tiny / "build" / "nb")
        executed.append((tiny / "build/nb/01_tiny.ipynb").read_bytes())
    assert executed[0] == executed[1]
    assert not (tiny / "data/results/out.csv").exists()


@pytest.mark.parametrize(
    ("last", "sentence"),
    [
        ("import sys\nsys.exit(0)", "failed with|not executed|did not write"),
        ("pass", "did not write data/results/out.csv"),
        (None, "01_tiny: has no parameter 'speed'"),
    ],
)
def test_failures_name_the_place_and_leave_the_old_product(tiny, last, sentence):
    chain.refresh(chain.chain()["01_tiny"])
    if last is None:
        with open(tiny / "notebooks/chain.toml", "a") as file:
            file.write("parameters = { speed = 1 }\n")
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], last or CELLS[2]])
    with pytest.raises(InputError, match=sentence) as failed:
        chain.refresh(chain.chain()["01_tiny"])
    assert "\n" not in str(failed.value)
    assert (tiny / "data/results/out.csv").read_text() == "a\n1\n"


ENTRY = '[[notebook]]\nname = "{0}"\ntitle = "x"\nwrites = ["data/{1}"]\n'


def test_chain_refuses_what_two_notebooks_write(tiny):
    file = tiny / "notebooks" / "chain.toml"
    file.write_text(ENTRY.format("01_a", "x.csv") + ENTRY.format("02_b", "x.csv"))
    with pytest.raises(InputError, match="data/x.csv is written by 01_a and by 02_b"):
        chain.chain()
    file.write_text(ENTRY.format("01_a", "x.csv") + ENTRY.format("01_a", "y.csv"))
    with pytest.raises(InputError, match="01_a.ipynb is written by 01_a and by 01_a"):
        chain.chain()


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
    with pytest.raises(InputError, match="no notebook or figure of chain.toml begins with 'fig99'"):
        chain.figures(["fig99"])


def test_only_the_entries_that_a_chapter_reads_make_it_stale(tiny):
    file = shutil.copy(COMMITTED / SCENARIOS, tiny / SCENARIOS)
    loads = "from railrepro.simulation.scenarios import load_scenario\nvalue = load_scenario('curve_entry_T1').end_m\n"
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], loads + CELLS[2]])
    chain.refresh(chain.chain()["01_tiny"])
    notebook, text = chain.chain()["01_tiny"], file.read_text()
    assert chain.why_stale(notebook) == ""
    used = text.index("[curve_entry_T1]")
    for changed, why in (
        (text + text[used:].split("\n\n")[0].replace("curve_entry_T1", "curve_entry_new"), ""),
        ("# a remark\n" + text, ""),
        (text[:used] + text[used:].replace("speed_kmh = 40", "speed_kmh = 41", 1), f"{SCENARIOS} [curve_entry_T1]"),
        (text.replace("speed_kmh = 280", "speed_kmh = 281"), ""),
        ("not TOML", f"{SCENARIOS} and 1 more"),
    ):
        assert changed != text
        file.write_text(changed)
        assert chain.why_stale(notebook) == why, changed[:80]
    all_of_them = "from railrepro.simulation.scenarios import load_scenarios\nfound = load_scenarios()\n"
    all_of_them += "value = len([found['curve_entry_T1'], *found.values()])\n"
    file.write_text(text)
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], all_of_them + CELLS[2]])
    chain.refresh(chain.chain()["01_tiny"])
    file.write_text(text.replace("speed_kmh = 280", "speed_kmh = 281"))
    assert chain.why_stale(notebook).startswith(f"{SCENARIOS} [curve_entry_T3]")
    file.write_text(text + text[used:].split("\n\n")[0].replace("curve_entry_T1", "curve_entry_new"))
    assert SCENARIOS in chain.why_stale(notebook)


def test_an_input_that_is_edited_while_a_chapter_runs_makes_it_stale(tiny):
    (tiny / "data/in.txt").write_text("1")
    edit = "import time\nfile = paths.ROOT / 'data/in.txt'\nfile.read_text()\ntime.sleep(0.1)\nfile.write_text('2')\n"
    write_notebook(tiny / "notebooks", [CELLS[0], CELLS[1], edit + CELLS[2]])
    chain.refresh(chain.chain()["01_tiny"])
    assert chain.why_stale(chain.chain()["01_tiny"]) == chain.EDITED


def test_a_stale_chapter_names_what_changed(tiny, monkeypatch):
    monkeypatch.setattr(store, "machine", store.machine.__wrapped__)
    monkeypatch.delenv("RAILREPRO_CFLAGS", raising=False)
    notebook, product = chain.chain()["01_tiny"], tiny / "data/results/out.csv"
    assert chain.why_stale(notebook) == "it has not run here"
    chain.refresh(chain.chain()["01_tiny"])
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
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Nehalem")
    assert chain.why_stale(notebook) == "environment OPENBLAS_CORETYPE"
    assert chain.inputs(notebook, {}) == found, "the machine is no part of a manifest"
    monkeypatch.setattr(code, "packages", lambda: {"numpy": "another one"})
    assert chain.inputs(notebook, {}) != found


def test_a_stale_chapter_names_the_module_and_one_that_ran_while_code_was_edited_is_stale(tiny, monkeypatch):
    notebook = chain.chain()["01_tiny"]
    chain.refresh(notebook)
    with monkeypatch.context() as patch:
        known = code._source_hash
        patch.setattr(code, "_source_hash", lambda name: "other" if name == "railrepro/paths.py" else known(name))
        assert chain.why_stale(notebook) == "railrepro/paths.py"
    assert chain.why_stale(notebook) == ""
    with monkeypatch.context() as patch:
        patch.setattr(code, "unchanged", lambda: False)
        chain.figures()
    assert chain.why_stale(notebook) == chain.EDITED and not (tiny / "data/MANIFEST.csv").exists()
    chain.figures()
    assert chain.why_stale(notebook) == ""


def test_the_lock_pins_each_package_once_by_hash_and_without_addresses():
    text = (paths.ROOT / "environment.lock").read_text()
    pins = re.findall(r"^([a-z][^=]*)==\S+(.*)\\\n    --hash=sha256:", text, re.M)
    assert "://" not in text and len(pins) == len(set(pins)) == len(re.findall("^[a-zA-Z-]", text, re.M)) > 3


def test_committed_notebooks_are_in_the_chain_and_clean():
    files = sorted(paths.NOTEBOOKS.glob("*.ipynb"))
    assert [path.stem for path in files] == list(chain.chain())
    for path in files:
        content = json.loads(path.read_text())
        code = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
        text = "\n".join("".join(cell["source"]) for cell in code)
        assert not any(cell["outputs"] or cell["execution_count"] for cell in code), path.name
        assert sum("parameters" in cell["metadata"].get("tags", []) for cell in code) == 1, path.name
        assert not re.search(r"import \*|sys\.path|/home/|/root/", text), path.name
        assert len({cell["id"] for cell in content["cells"]}) == len(content["cells"]), path.name


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
