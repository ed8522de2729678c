"""Bad inputs that are no row of inputs.toml: what happens in runs, interrupts, and the environment of a command."""

import os
import signal
import subprocess
import sys
import warnings
from functools import partial

import pytest

from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.data import InputError
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import table as tables
from railrepro.track.alignment import Alignment, Segment
from railrepro.vehicle.parameters import load_vehicle


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


def test_a_cant_ramp_that_is_too_short_is_refused(monkeypatch):
    level, ramp = (0.0, 0.0), (0.0, 0.1)
    segments = (
        Segment(20.0, level, level, level),
        Segment(5.0, level, ramp, level),
        Segment(90.0, level, (0.1, 0.1), level),
    )
    built = tables.Track("short", tables.build_table(Alignment("short", segments)))
    monkeypatch.setattr("railrepro.simulation.scenarios.load_track", lambda name: built)
    with pytest.raises(InputError, match=r"changes by 30 mm/m at p = 2\d(\.\d)? m, up to 10 mm/m is allowed"):
        scenario().route()


def test_a_stepped_car_that_leaves_the_rail_says_so_once():
    car = SteppedCar("T3", 77.8, load_vehicle(**{"contact.profile": "cone"}))  # no flange holds it
    car.step([300, -300, 300, -300], steps=100)
    assert car.left_rail == ""
    with pytest.warns(UserWarning, match=r"gear derailed, \|y\| = 30\.\d mm at t = 0\.2\d\d s, p = ") as said:
        car.step(steps=400)
    assert [str(warning.message) for warning in said] == [car.left_rail] and said[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        car.step(steps=10)


MODULE = "railrepro"


def interrupted(folder, *command):
    """Exit code and stderr of a command that gets Ctrl-C when it writes its first line."""
    environment = os.environ | {"PYTHONPATH": f"{folder}:{paths.ROOT}"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A job in the background of a shell hands down that it ignores Ctrl-C.
    listens = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen([sys.executable, *command], env=environment, cwd=folder, preexec_fn=listens, **pipes)
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    return process.returncode, said


HERE = "print('here', flush=True); signal.pause()"


def test_an_interrupt_while_a_command_imports_is_silent(tmp_path):
    (tmp_path / "numpy.py").write_text(f"import signal; {HERE}")
    assert interrupted(tmp_path, "-m", MODULE, "tune") == (-signal.SIGINT, "")


def test_an_interrupt_of_a_command_is_told_in_one_sentence(tmp_path):
    (tmp_path / "tomllib.py").write_text(
        "import signal\ndef load(*_):\n    " + HERE + "\nloads = load\nTOMLDecodeError = ValueError"
    )
    assert interrupted(tmp_path, "-m", MODULE, "chain", "run") == (
        130,
        "interrupted; nothing half-written, run again to resume\n",
    )


ENVIRONMENT = {
    "workers that are no number": ({"RAILREPRO_WORKERS": "many"}, "RAILREPRO_WORKERS='many'"),
    "no scheduler": ({"RAILREPRO_DASK": "tcp://127.0.0.1:9"}, "no Dask scheduler answers"),
    "an address that is none": ({"RAILREPRO_DASK": "nonsense"}, "no Dask scheduler answers"),
}


@pytest.mark.parametrize("what", ENVIRONMENT)
def test_a_wrong_environment_is_told_in_one_sentence(what, tmp_path):
    changes, sentence = ENVIRONMENT[what]
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)} | changes
    done = subprocess.run(
        [sys.executable, "-m", MODULE, "tune", "ndi"], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 1 and sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
