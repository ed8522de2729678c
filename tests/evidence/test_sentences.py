"""Sentences of chapters: when one is false, what a reader sees, and that a false one fails the chain."""

import json
import subprocess

import numpy as np
import pandas as pd
from chapters import write_notebook

from railrepro.evidence.chain import chain
from railrepro.evidence.report import sentences

SAYS = """from railrepro import paths
from railrepro.evidence.report.sentences import checked, sentences
paths.product("data/results/out.csv").write_text("a")
with sentences() as says:
    says(f"The value is {value}.", value < 3)
    says("One over it is positive.", 1 / value > 0)
checked()"""


def test_a_sentence_needs_all_of_its_conditions_and_one_at_least():
    table = pd.DataFrame({"a": [True, True]})
    for conditions, true in [([True], True), ([np.array([True, False])], False), ([table, 1 < 2], True), ([[]], False)]:
        said = sentences.Sentences()
        said("It holds.", *conditions)
        said("It does not.")
        assert said == [("It holds.", true), ("It does not.", False)], conditions


def run(capfd):
    """Exit code of the chain and the last line that it printed."""
    return chain.figures(), capfd.readouterr().err.splitlines()[-1]


def commit(folder, says):
    """Write the notebook with value = 2 and commit all."""
    write_notebook(folder / "notebooks", ["", "value = 2", says])
    git = ["git", "-C", folder, "-c", "user.name=a", "-c", "user.email=a@b"]
    for arguments in (["init", "-q"], ["add", "notebooks", "data"], ["commit", "-qm", "a"]):
        subprocess.run([*git, *arguments], check=True)


def shown(folder):
    cells = json.loads((folder / "build/notebooks/01_tiny.ipynb").read_text())["cells"]
    return "".join("".join(output["data"]["text/markdown"]) for cell in cells for output in cell["outputs"])


def test_changed_values_mark_a_sentence_and_the_chain_names_it(tiny, capfd):
    commit(tiny, SAYS)
    code, line = run(capfd)
    assert code == 0 and line.startswith("01_tiny: done in ")
    assert shown(tiny).startswith("The value is 2. One over it is positive.<small>")
    assert ": 2. False: none." in shown(tiny)
    write_notebook(tiny / "notebooks", ["", "value = 4", SAYS])
    assert run(capfd) == (0, "01_tiny: does not hold with these values: The value is 4.")
    assert shown(tiny).startswith(f"<mark>**{sentences.MARK}:** The value is 4.</mark> One over it")
    assert ": 2. False: 1." in shown(tiny)
    write_notebook(tiny / "notebooks", ["", "value = 0", SAYS])
    assert run(capfd)[1].startswith("01_tiny: does not hold with these values: ")
    assert "need values that are missing (ZeroDivisionError: division by zero)" in shown(tiny)


def test_with_the_committed_values_a_false_sentence_fails_the_chain(tiny, capfd):
    (tiny / "data/in.txt").write_text("a")
    reading = SAYS.replace("value < 3", "(paths.DATA / 'in.txt').read_text() == 'a'")
    commit(tiny, reading)
    (tiny / "data/in.txt").write_text("b")
    assert run(capfd) == (0, "01_tiny: does not hold with these values: The value is 2.")
    (tiny / "data/results/out.csv").unlink()
    commit(tiny, reading)
    assert chain.figures() == 1 and not (tiny / "data/results/out.csv").exists()
    assert "01_tiny: does not hold with the committed values: The value is 2." in capfd.readouterr().err
