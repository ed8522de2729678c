"""Hashes of code: they are the same in every Python, and no cache returns results of other code."""

import os
import subprocess
import sys

import pytest

from railrepro import code

SNIPPETS = {
    'def f(a):\n    """Sine."""\n\n    return -a  # sign\n': "def f(a):\n    return -a",
    'x = f"{d["a"]}"  # nested quotes of 3.12\n': 'x = f"{d["a"]}"',
    'y = f"""{x}\n# text\n\n   """\n': 'y = f"""{x}\n# text\n\n   """',
    "@a  # b\n@c('#')\n\n\nclass D:\n    r'''Raw \\d.''' \n    e: int = 1\n    '''After.'''\n": (
        "@a\n@c('#')\nclass D:\n    e: int = 1"
    ),
    "match x:\n    case {'#': [1, *_]}:  # first\n        pass\n": "match x:\n    case {'#': [1, *_]}:\n        pass",
    'f(\n    """argument"""\n)\nx = \\\n"""value"""\n': 'f(\n    """argument"""\n)\nx = \\\n"""value"""',
    "x = 'it''s \\' #' # it's\r\n": "x = 'it''s \\' #'",
}


def test_the_content_of_a_text_has_no_comment_docstring_or_empty_line():
    assert {text: code.content(text) for text in SNIPPETS} == SNIPPETS


RUNS = "from railrepro.studies import experiment"
LED = [
    ("simulation/simulate.py", "from railrepro import simulate"),
    ("simulation/simulate.py", "import os, railrepro as r"),
    ("simulation/simulate.py", "from railrepro import (\n *)"),
    ("control/mpc.py", "from railrepro.control import (\n    ndi,\n    mpc as n,\n)"),
    ("control/mpc.py", "if x:\n    from railrepro.control \\\n        import mpc"),
    ("control/__init__.py", "import os, railrepro.control.mpc as n"),
    ("own/lqg.py", "from railrepro.control.registry import guidance"),  # found by its name
    *((home, RUNS) for home in ("car/car.c", "control/solvers/riccati.c", "compile/lanes.h", "code.py")),
]


@pytest.mark.parametrize(("home", "text"), LED)
def test_imports_are_followed_in_all_forms(home, text):
    assert f"railrepro/{home}" in code.reached(text)


def test_only_imported_modules_are_reached():
    assert "railrepro/simulation/simulate.py" not in code.reached("from railrepro import paths, InputError")
    assert code.reached('"""from railrepro.control import mpc"""\n# import railrepro\n') == {}
    assert not [name for name in code.reached(RUNS) if "/report/" in name or "fmi" in name]
    assert not any(name.startswith("railrepro/own") for name in code.reached("from railrepro.car import equations"))


def test_the_version_depends_on_every_source_that_computes_a_run_and_on_no_other(monkeypatch):
    before, own = code.version(), code._source_hash
    changed = {}
    for name in code._FILES:
        monkeypatch.setattr(code, "_source_hash", lambda one, name=name: own(one) if one != name else "other")
        changed[name] = code.version.__wrapped__() != before
    asking = ("evidence", "studies", "tuning")
    assert changed == {name: not (name.split("/")[1] in asking or name in code.DRAWING) for name in changed}
    assert set(code.DRAWING) <= set(changed)


def python(folder, *arguments):
    """Start a process of the checkout that runs `PROGRAM`."""
    around = {name: value for name, value in os.environ.items() if not name.startswith("RAILREPRO")}
    around["PYTHONPATH"] = str(folder)
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    return subprocess.Popen([sys.executable, "-c", PROGRAM, *arguments], cwd=folder, env=around, text=True, **pipes)


def fade(folder, before, after):
    """Change a constant of the control law."""
    file = folder / "railrepro/control/law.py"
    text = file.read_text()
    assert text.count(f"GUIDANCE_FADE = {before}") == 1
    file.write_text(text.replace(f"GUIDANCE_FADE = {before}", f"GUIDANCE_FADE = {after}"))


EDITED = "railrepro was edited after this process imported it"
PROGRAM = """
import sys
import casadi as ca
from railrepro import code
from railrepro.compile import codegen
from railrepro.studies import store
def wait(moment):
    if moment == sys.argv[1]:
        print("now", flush=True)
        sys.stdin.readline()
def fade():
    wait("between key and import")
    from railrepro.control.law import GUIDANCE_FADE
    wait("between import and key")
    return GUIDANCE_FADE
def build():
    return ca.Function("fade", [], [ca.DM(early or fade())])
build.__module__ = "railrepro.anywhere"
early = fade() if sys.argv[1] == "between import and key" else None
print(float(codegen.stored(build)()()["o0"]))
row, _ = store.entry(store.key("railrepro.control.law", "fade"), lambda: ({"fade": early or fade()}, None))
print(row["fade"], code.unchanged())
"""


@pytest.mark.parametrize(
    ("moment", "answers", "printed", "new"),
    [
        ("between import and key", "\n", "1.0\n1.0 False\n", "2.0"),  # the new code must not get the old value
        ("between key and import", "\n\n", "200.0\nnow\n200.0 False\n", "1.0"),  # nor the restored code the new one
    ],
)
def test_a_process_whose_code_was_edited_stores_nothing(copy, moment, answers, printed, new):
    old = python(copy, moment)
    assert old.stdout.readline() == "now\n"
    fade(copy, "1.0", "200.0")
    output, errors = old.communicate(answers, timeout=120)
    assert output == printed and errors.count(EDITED) == 1
    fade(copy, "200.0", new)
    assert python(copy, "").communicate(timeout=120) == (f"{new}\n{new} True\n", "")
