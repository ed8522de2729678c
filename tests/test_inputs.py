"""Wrong input gives a message of one line: calls, commands, the environment, interrupts. inputs.toml has wrong calls
(`refused`) and wrong commands with variables of the environment in front (`told`), for what the ranges of fields do not
cover. `…` separates parts of a message."""

import importlib
import os
import re
import shlex
import signal
import subprocess
import sys
import tomllib
import warnings
from functools import partial
from pathlib import Path

import inputs
import pytest
from program import python

import railrepro
from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.data import InputError, above, between
from railrepro.evidence import commands as command

TABLE = tomllib.loads(Path(__file__).with_name("inputs.toml").read_text(encoding="utf-8"))
NAMES = {name: getattr(railrepro, name) for name in railrepro.FACADE} | vars(inputs)


def rows(section):
    """Calls or commands of a section with their messages."""
    return [pytest.param(*row, id=row[0]) for row in TABLE[section].items()]


def holds(said, parts):
    """Whether a text is one line with all parts in their order."""
    return re.search(".*".join(map(re.escape, parts.split("…"))), said) and len(said.splitlines()) == 1


@pytest.mark.parametrize(("call", "sentence"), rows("refused"))
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_refused_in_one_sentence(call, sentence, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((InputError, ArithmeticError)) as refused:
        eval(call, dict(NAMES))
    assert holds(str(refused.value), sentence), refused.value


@pytest.mark.parametrize(("words", "sentence"), rows("told"))
def test_told_in_one_sentence_before_anything_starts(words, sentence, capsys, monkeypatch):
    around = [word for word in words.split() if "=" in word]
    for name, value in (word.split("=") for word in around):
        monkeypatch.setenv(name, value)
    try:
        code = command.main(shlex.split(words)[len(around) :])
    except SystemExit as ended:
        code = ended.code
    said = capsys.readouterr().err
    assert code in (1, 2) and said.startswith("error: ") and holds(said, sentence), said


@pytest.mark.parametrize(
    ("quantity", "inside", "outside"),
    [
        (above(1.0, 2.0, "m"), (1.001, 2.0), (1.0, 2.001, -1.5)),
        (between(1.0, 2.0, "m"), (1.0, 2.0), (0.999, 2.001)),
        (above(1.0, 2.0, "m", signed=True), (1.001, -2.0), (1.0, -1.0, 2.001, -2.001, 0.0)),
    ],
)
def test_a_range_has_the_stated_ends(quantity, inside, outside):
    for value in inside:
        quantity.check(value)
    for value in outside:
        with pytest.raises(ValueError, match=" is needed"):
            quantity.check(value)


def test_text_is_read_as_utf_8_in_any_locale():
    """The page and the C sources contain letters beyond ASCII."""
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = python("-c", "from railrepro.export import live; live.page({})", **ascii_only)
    assert done.returncode == 0, done.stderr[-500:]


def test_every_command_leads_to_a_function():
    offered = command.parser()._subparsers._group_actions[0].choices
    for parser in offered.values():
        module, _, function = parser.get_default("call").partition(":")
        assert callable(getattr(importlib.import_module(module), function)), parser.prog


@pytest.mark.parametrize("where", [">/dev/full", ">&-"])
def test_lost_output_is_an_error(where):
    line = f"{sys.executable} -m railrepro --help {where}"
    done = subprocess.run(line, shell=True, cwd=paths.ROOT, capture_output=True, text=True)
    assert done.returncode == 1 and done.stderr.startswith("error: ") and len(done.stderr.splitlines()) == 1


def test_a_stepped_car_that_derails_warns_once():
    car = SteppedCar("T3", 77.8, inputs.CONES)  # no flange holds it
    car.step([300, -300, 300, -300], steps=100)
    assert car.left_rail == ""
    with pytest.warns(UserWarning, match=r"gear derailed, \|y\| = 30\.\d mm at t = 0\.2\d\d s, p = ") as said:
        car.step(steps=400)
    assert [str(warning.message) for warning in said] == [car.left_rail] and said[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        car.step(steps=10)


HERE = "print('here', flush=True); signal.pause()"
LOADS = "import signal\ndef load(*_):\n    " + HERE + "\nloads = load\nTOMLDecodeError = ValueError"


@pytest.mark.parametrize(
    ("module", "text", "ended"),
    [
        ("numpy", f"import signal; {HERE}", (-signal.SIGINT, "")),
        ("tomllib", LOADS, (130, "interrupted; nothing half-written, run again to resume\n")),
    ],
)
def test_an_interrupted_command_prints_one_sentence_or_nothing(module, text, ended, tmp_path):
    """A module in place of that of the same name waits for the interrupt when it is imported or called."""
    (tmp_path / f"{module}.py").write_text(text)
    # A shell makes its jobs in the background ignore Ctrl-C.
    around = {"preexec_fn": partial(signal.signal, signal.SIGINT, signal.SIG_DFL), "cwd": tmp_path}
    around["env"] = os.environ | {"PYTHONPATH": f"{tmp_path}:{paths.ROOT}"}
    line, pipe = [sys.executable, "-m", "railrepro", "figures"], subprocess.PIPE
    process = subprocess.Popen(line, stdout=pipe, stderr=pipe, text=True, **around)
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGINT)
    assert (process.communicate()[1], process.returncode) == ended[::-1]
