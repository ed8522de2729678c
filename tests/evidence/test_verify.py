"""Comparison of the products of two runs: each number has its scale, and one notebook that fails hides nothing."""

import pytest
from chapters import write_chain

from railrepro import paths
from railrepro.compile import cache
from railrepro.evidence.chain import chain, compare

VERIFY = """
[verify]
relative = 1e-5
not_compared = ["seconds"]
own = [{ table = "02_two", column = "loose", rows = "a > 2", relative = 1e-2, why = "it is loose" }]
"""


@pytest.mark.parametrize("column", ["loose", "*"])
def test_one_failing_notebook_hides_nothing(column, tiny, capsys):
    rows = "a,loose,seconds\n1,100{},{}\n3,200{},{}\n"
    write = f"paths.product('data/02_two').write_text({rows.format('.2', 1, '.5', 9)!r})"
    write_chain(tiny, {"01_one": "assert False, 'odd'", "02_two": write}, VERIFY.replace("loose", column, 1))
    committed = {"01_one": "a\n1\n", "02_two": rows.format("", 1, "", 2)}
    for name, text in committed.items():
        (tiny / "data" / name).write_text(text)
    assert chain.verify() == 1
    failed, *others = capsys.readouterr().out.splitlines()[-3:]
    assert failed.startswith("not reproduced: 01_one: ") and "odd" in failed
    for line, counts in zip(others, ("01_one: 0 same, 0 within", "02_two: 4 same, 1 within"), strict=True):
        assert line.startswith(f"not reproduced: data/{counts} tolerance, 1 different")
    assert {name: (tiny / "data" / name).read_text() for name in committed} == committed


@pytest.mark.parametrize(
    ("old", "new", "counts", "where", "largest"),
    [
        ("metric,value\ny,2\ny,1\ndu,1e6\n", "metric,value\ny,2\ny,1.1\ndu,1e6\n", (5, 0, 1), "value of y", 0.05),
        ("name,value\ny,2\ny,1\ndu,1e6\n", "name,value\ny,2\ny,1.1\ndu,1e6\n", (5, 1, 0), "value", 1e-7),
        ("torque\n-100\n1\n", "torque\n-100\n1.15\n", (1, 0, 1), "torque", 1.5e-3),
        ("a\n1\n2\n", 'a\n1\n""\n', (1, 0, 1), "a", float("inf")),
        ("a\n1\n", "b\n1\n", (0, 0, 1), "its rows or columns", float("inf")),
        ("a\n1\n", "", (0, 0, 1), "new.csv, which is missing", float("inf")),
    ],
)
def test_numbers_are_compared_with_the_largest_of_their_column_and_metric(tmp_path, old, new, counts, where, largest):
    (tmp_path / "old.csv").write_text(old)
    if new:
        (tmp_path / "new.csv").write_text(new)
    found = compare.compare(tmp_path / "old.csv", tmp_path / "new.csv", compare.Tolerance(relative=1e-3))
    assert tuple((found["outcome"] == outcome).sum() for outcome in compare.OUTCOMES) == counts
    worst = found.iloc[found["apart"].argmax()]
    assert (worst["name"], worst["apart"]) == (where, pytest.approx(largest))


def test_flags_are_part_of_the_cache_key(tmp_path, monkeypatch):
    monkeypatch.setattr(paths, "BUILD", tmp_path)
    objects = set()
    for flags in ("-O2", "-O0", "-O2 -march=native"):
        monkeypatch.setenv("RAILREPRO_CFLAGS", flags)
        objects.add(cache.build("int nothing(void) { return 0; }"))
    assert len(objects) == 3
