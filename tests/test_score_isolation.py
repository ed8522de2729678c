"""Who wants to fool the score: each trick is a controller of a file, and none gets points or stops the score."""

import json
import subprocess
import sys
import time

import casadi as ca
import numpy as np
import pytest

from railrepro import paths
from railrepro.control import lateral
from railrepro.evidence.score import card, guest, host, suite
from railrepro.evidence.score.entry import NOTHING, Entry, entry, load_class, made
from railrepro.evidence.score.trial import Trial
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario

PLAN = """
import ctypes, gc, json, os, signal, socket, subprocess, sys, time
{}
class Mine:
    period = 0.005
    def __init__(self, vehicle, route, gear):
        self.route = route
    def plan(self, x_hat, u_d):
        {}
"""
CASE = suite.Case("short", "equal", load_scenario("curve_entry_T3").but(end_m=15.0), group="short")
BRAKING = load_scenario("braking").but(end_m=15.0, poor_share=((0.0, 1.0),), side_force_kN=((0.0, 1.0),))
PID = str(paths.ROOT / "examples/pid.py")
FOOL = '{"scenario": "short", "failure": "", "rmse_y": 0.0, "effort_du": 0.0}'
INTO_PIPES = f"""
for number in range(3, 64):
    try: os.write(number, b'{FOOL}\\n')
    except OSError: pass
os._exit(0)"""
FORGED = 'os.write(3, b\'{"torque": 0.0, "seconds": 0.0}\\n\' * 100000)'
linux = pytest.mark.skipif(sys.platform != "linux", reason="the filter of system calls is Linux's")


def driven(folder, text, processor=2.0, wall=5.0):
    """Row of a file and how long it took (s)."""
    file = folder / "own.py"
    file.write_text(text)
    begin = time.monotonic()
    return Trial(Entry("own.py", str(file)), CASE, processor, wall)(), time.monotonic() - begin


TRICKS = {
    "a row for every descriptor": (PLAN.format(INTO_PIPES, "return 0.0"), "failed"),
    "half an answer": (PLAN.format("os.write(3, b'{\"steps\": ')\ntime.sleep(1e6)", "return 0.0"), "more than 5 s"),
    "a flood of answers": (PLAN.format("while True: os.write(3, b'x' * 65536)", "return 0.0"), "took more than"),
    "no answer and no reading": (PLAN.format("", FORGED + "; time.sleep(1e6)"), "more than 5 s"),
    "a forged law": (PLAN.format("os.write(3, b'{\"steps\": [[9999, [0], [0], 0]], \"gains\": {}, \"memory\": [], "
                                 "\"slow\": false}\\n')", "return 0.0"), "handed over what is no law"),
    "sleeps with signals blocked": (
        PLAN.format("signal.setitimer(signal.ITIMER_REAL, 0)\nsignal.pthread_sigmask(signal.SIG_BLOCK, range(1, 64))",
                    "time.sleep(1e6)"), "took more than 5 s"),
    "loops with signals ignored": (
        PLAN.format("signal.signal(signal.SIGXCPU, signal.SIG_IGN)", "while True: pass"), "took more than"),
    "too much memory": (PLAN.format("", "return float(len(bytearray(2_400_000_000)))"), "(Mine.plan): MemoryError"),
    "a crash": (PLAN.format("", "ctypes.string_at(0)"), "ended the process by signal SIGSEGV"),
}  # fmt: skip
ONLY_LINUX = {
    "a fork": "os.fork()",
    "a command": "subprocess.run(['true'])",
    "kills who asks": "os.kill(os.getppid(), signal.SIGKILL)",
    "kills all": "os.kill(-1, signal.SIGKILL)",
    "calls somebody": "socket.socket()",
    "writes a file": "open('/tmp/railrepro-fooled', 'w')",
    "empties this one": "os.open(__file__, os.O_RDONLY | os.O_TRUNC)",
    "removes this one": "os.unlink(__file__)",
}


@pytest.mark.parametrize("what", TRICKS)
def test_a_trick_is_a_failure_and_ends_in_time(what, tmp_path):
    text, said = TRICKS[what]
    row, seconds = driven(tmp_path, text)
    assert said in row["failure"] and "rmse_y" not in row and seconds < 30
    assert card.judged([row | {"nothing": 1.0, "best": 0.0, "limit": 0.0}])["points"].tolist() == [0.0]


@linux
@pytest.mark.parametrize("what", ONLY_LINUX)
def test_what_reaches_beyond_the_process_is_refused(what, tmp_path):
    row, _ = driven(tmp_path, PLAN.format("", ONLY_LINUX[what]))
    assert row["failure"].startswith("own.py, line 9 (Mine.plan): PermissionError: [Errno 1]")
    assert Trial(entry(PID), CASE)()["failure"] == ""  # whoever asks is still there
    assert (tmp_path / "own.py").read_text()


def test_patched_metrics_change_nothing(tmp_path):
    patch = """
from railrepro.evidence.runs.experiment import Experiment
from railrepro.simulation import metrics, simulate
Experiment.row = Experiment.values = lambda self, run: {"rmse_y": 0.0, "effort_du": 0.0, "failed": False}
metrics.summary = metrics.rmse = lambda *_: 0.0
simulate.run = None"""
    honest, fooling = (driven(tmp_path, PLAN.format(text, "return 100.0"))[0] for text in ("", patch))
    times = {"sample_median", "sample_p99", "sample_max", "series"}
    assert honest["rmse_y"] > 1e-4
    assert {k: honest[k] for k in honest.keys() - times} == pytest.approx(
        {k: fooling[k] for k in honest.keys() - times}, nan_ok=True
    )


def test_the_state_of_the_car_is_nowhere_in_the_process(tmp_path):
    look = """frames, frame = [], None if hasattr(Mine, "seen") else sys._getframe()
        Mine.seen = True
        while frame:
            frames += [*frame.f_locals, *(type(v).__name__ for v in frame.f_locals.values())]
            frame = frame.f_back
        names = {*frames, *(type(thing).__name__ for thing in gc.get_objects() if frames)}
        found = names & {"Exchange", "CarStepper", "Run", "Trial", "Experiment", "Case"}
        return 1000.0 * len(found)"""
    row, _ = driven(tmp_path, PLAN.format("", look))
    nothing = Trial(Entry(NOTHING), CASE)()
    assert row["failure"] == "" and row["rmse_y"] == nothing["rmse_y"] and row["effort_du"] == 0.0


def test_a_controller_knows_neither_friction_nor_irregularities(tmp_path):
    rough = suite.Case(
        "rough", "equal", BRAKING, group="rough",
        irregular={"spectrum": "en_B_300", "seed": 1},
    )  # fmt: skip
    file = tmp_path / "own.py"
    hidden = "['lateral', 'ddvertical', 'gauge', 'poor_le', 'side_force']"
    show = f"""from railrepro.track.route import INDEX
        found = [float(abs(self.route.cells[:, INDEX[n]]).max()) for n in {hidden} + ['force', 'y_ref']]
        raise ValueError([value > 0 for value in found])"""
    file.write_text(PLAN.format("", show))
    row = Trial(Entry("own.py", str(file)), rough)()
    assert "ValueError: [False, False, False, False, False, True, True]" in row["failure"]


@linux
def test_nothing_is_inherited_but_one_channel(tmp_path):
    (tmp_path / "held.txt").write_text("")
    with (tmp_path / "held.txt").open() as held:
        import os

        os.set_inheritable(held.fileno(), True)
        row, _ = driven(tmp_path, PLAN.format("", "raise ValueError(*os.listdir('/proc/self/fd'))"))
    numbers = row["failure"].partition("ValueError: ")[2]
    assert len(json.loads(numbers.replace("'", '"').replace("(", "[").replace(")", "]"))) == 5  # and that of the list


def test_a_guest_ends_with_who_asks(tmp_path):
    file = tmp_path / "own.py"
    file.write_text(PLAN.format("", "time.sleep(1e6)"))
    code = f"""
from railrepro.evidence.score import host
guest = host.Guest({str(file)!r}, "equal")
print(guest._process, flush=True)
import os
os.kill(os.getpid(), 9)"""
    found = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=paths.ROOT)
    process = int(found.stdout)
    from railrepro.parent_death import alive

    for _ in range(50):
        if not alive(process):
            break
        time.sleep(0.1)
    assert not alive(process)


def test_a_handed_over_law_is_the_law():
    for setting in ("equal", "loop"):
        guidance = made(load_class(paths.ROOT / "examples/pid.py"), setting)
        whole = host.HandedLaw(json.loads(json.dumps(guest.operations(guidance))))
        scenario = load_scenario("curve_entry_T3").but(end_m=15.0)
        here, there = (simulate.run(scenario, each).series["front.du"].to_numpy() for each in (guidance, whole))
        np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "changed",
    [
        {"steps": None},
        {"steps": [[ca.OP_CALL, [0], [0], 0.0]]},
        {"steps": [[ca.OP_INPUT, [0, 99], [0], 0.0]]},
        {"steps": [[ca.OP_CONST, [], [0], "much"]]},
        {"steps": []},
        {"steps": [[0]]},
        {"gains": {"k": float("inf")}},
        {"gains": {"k": [1]}},
        {"memory": [1]},
        {"memory": "held"},
    ],
)
def test_what_is_no_law_is_refused(changed):
    law = guest.operations(lateral.Held()) | changed
    with pytest.raises(host.Fault, match="handed over"):
        lateral.kind(host.HandedLaw(law))
