"""Bad inputs of the library and of the command line: one sentence each, no traceback, no silence."""

import math
import os
import subprocess
import sys

import pytest

from railrepro import paths
from railrepro.control.ndi import NDI
from railrepro.control.registry import guidance
from railrepro.errors import InputError
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.studies import experiment, pso, tuning
from railrepro.track import table as tables
from railrepro.track.alignment import Alignment, Segment
from railrepro.vehicle.parameters import load_vehicle

NMPC = {"q_psi_TrAx": 1.0, "q_psidot_Ax": 1.0, "r": 1e-11, "q_terminal": 1.0, "period_ms": 10, "horizon_s": 0.3}
THREE = {"pole": 20.0, "frequency": 20.0, "damping": 1.0}


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


def drive(law=None, vehicle=None, **changes):
    return simulate.run(scenario(**changes), NDI() if law is None else law, vehicle=vehicle)


def swarm(dimensions=None, particles=3, iterations=3, seed=1):
    dimensions = [pso.Dimension("x", 0, 1)] if dimensions is None else dimensions
    return pso.minimise(lambda sets, limits: [1.0] * len(sets), dimensions, particles, iterations, seed)


SINE = {"kind": "sine", "amplitude_mm": 3, "period_m": 50, "start_m": 0}
LIBRARY = {
    "a scenario that is a number": (lambda: load_scenario(3), "scenario 3 is not known"),
    "a scenario that is a list": (lambda: load_scenario(["a"]), "is not known"),
    "a scenario that there is not": (lambda: load_scenario("curve"), "there are .*'curve_entry_T3'"),
    "a negative speed": (lambda: scenario(speed_kmh=-3), "speed_kmh = -3"),
    "a speed that is no number": (lambda: scenario(speed_kmh=math.nan), "speed_kmh = nan"),
    "a speed that is a truth value": (lambda: scenario(speed_kmh=True), "speed_kmh is True"),
    "a key that there is not": (lambda: scenario(colour=3), "unknown .*colour"),
    "an end beyond everything": (lambda: scenario(end_m=1e9), "end_m = "),
    "an end beyond the track": (lambda: drive(end_m=9e4), "lies beyond track"),
    "a track that there is not": (lambda: drive(track="T99"), "'T99' is not in tracks.toml"),
    "a CSV that there is not": (lambda: drive(track="nowhere.csv"), "nowhere.csv"),
    "an adhesion set that there is not": (lambda: drive(good="ice"), "adhesion set 'ice'"),
    "force steps out of order": (lambda: scenario(force_kN=((5, 1), (2, 3))), "increasing p_m"),
    "-30 MN": (lambda: scenario(force_kN=((0, -30000),)), "force outside"),
    "a set point beyond the flangeway": (
        lambda: drive(set_point=SINE | {"amplitude_mm": 15}, vehicle=load_vehicle(**{"contact.profile": "s1002"})),
        "set_point.amplitude_mm = 15, up to 8 mm",
    ),
    "a set point that ends before its start": (
        lambda: scenario(set_point=SINE | {"start_m": 9, "end_m": 5}),
        "end after its start",
    ),
    "a negative period": (lambda: scenario(set_point=SINE | {"period_m": -5}), "period_m = -5"),
    "a kind of set point that there is not": (lambda: scenario(set_point={"kind": "fun"}), "kind 'fun'"),
    "a stop faster than the start": (lambda: scenario(stop_kmh=300.0), "stops below 300"),
    "a pole that is no number": (lambda: drive(NDI(pole=math.nan)), "NDI: pole = nan"),
    "a negative pole": (lambda: NDI(pole=-3), "NDI: pole = -3"),
    "a pole that is a text": (lambda: NDI(pole="x"), "NDI: pole = 'x'"),
    "no damping": (lambda: NDI(damping=0), "NDI: damping = 0"),
    "an infinite frequency": (lambda: NDI(frequency=math.inf), "NDI: frequency = inf"),
    "nine derivatives": (lambda: NDI(derivatives=9), "derivatives = 9, one of"),
    "a controller by its name": (lambda: drive("ndi"), "'ndi'|controller|guidance"),
    "a controller that is a number": (lambda: drive(3), "3"),
    "a controller that there is not": (lambda: guidance("pid", {}), "'pid' is not known"),
    "parameters that are missing": (lambda: guidance("nmpc", {"r": 3}), "is missing"),
    "parameters too many": (lambda: guidance("ndi", THREE | {"x": 2}), "are not those it takes"),
    "no parameters": (lambda: guidance("ndi", None), "parameters are None"),
    "a weight that is no number": (lambda: guidance("nmpc", NMPC | {"r": math.nan}), "r is nan"),
    "a weight that is a text": (lambda: guidance("nmpc", NMPC | {"r": "x"}), "r is 'x'"),
    "no period": (lambda: guidance("nmpc", NMPC | {"period_ms": 0}), "are not those it takes"),
    "a negative sampling time": (lambda: guidance("nmpc", NMPC | {"period_ms": -5}), "horizon"),
    "a setting that there is not": (lambda: guidance("ndi", THREE, colour=1), "setting 'colour'"),
    "an option that there is not": (lambda: guidance("nmpc", NMPC, {"colour": 1}), "option 'colour'"),
    "options for an inversion": (lambda: guidance("ndi", THREE, {"solver": "rti"}), "takes no options"),
    "a solver that there is not": (lambda: drive(guidance("nmpc", NMPC, {"solver": "magic"})), "magic"),
    "a tuned set that there is not": (lambda: tuning.tuned("pid"), "no tuned set"),
    "a vehicle that there is not": (lambda: load_vehicle("nowhere.toml"), "nowhere.toml"),
    "a negative radius": (lambda: load_vehicle(**{"wheel.radius": -1}), "wheel.radius"),
    "a radius that is a text": (lambda: load_vehicle(**{"wheel.radius": "a"}), "wheel.radius"),
    "a parameter that there is not": (lambda: load_vehicle(**{"wheel.colour": 1}), "wheel.colour"),
    "a swarm without particles": (lambda: swarm(particles=0), "particles = 0"),
    "fewer than no iterations": (lambda: swarm(iterations=-3), "iterations = -3"),
    "a negative seed": (lambda: swarm(seed=-1), "seed = -1"),
    "a swarm without dimensions": (lambda: swarm([]), "no dimensions"),
    "a bound that is no number": (lambda: pso.Dimension("x", math.nan, 1), "bound nan"),
    "an infinite bound": (lambda: pso.Dimension("x", 0, math.inf), "bound inf"),
    "a bound that is a text": (lambda: pso.Dimension("x", "a", 1), "bound 'a'"),
    "bounds the wrong way round": (lambda: pso.Dimension("x", 2, 1), "do not span"),
    "an experiment without controller": (lambda: experiment.Experiment(scenario(), "pid")(), "pid"),
    "an experiment with another parameter": (
        lambda: experiment.Experiment(scenario(), "ndi", vehicle={"x": 3})(),
        "override 'x'",
    ),
}


@pytest.mark.parametrize("what", LIBRARY)
def test_the_library_answers_in_one_sentence(what):
    call, sentence = LIBRARY[what]
    with pytest.raises(InputError, match=sentence) as refused:
        call()
    assert len(str(refused.value).splitlines()) == 1


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


def test_a_car_that_leaves_the_rail_says_so():
    run = drive(NDI(pole=2000.0, frequency=2000.0, damping=0.1), end_m=200.0)
    assert run.failed and "left the rail" in run.ended


CHAIN, TUNING = "railrepro.chain", "railrepro.studies.tuning"
COMMANDS = {
    "a notebook that there is not": ((CHAIN, "run", "99_none"), "is not in chain.toml"),
    "a variant that there is not": ((CHAIN, "variants", "v9"), "variant 'v9' is not known"),
    "a controller to tune that there is not": ((TUNING, "pid"), "'pid' is not in tuning.toml"),
    "a study that there is not": (("railrepro.studies.robustness", "luck"), "study 'luck' is not known"),
    "a table that there is not": (("railrepro.studies.bench", "luck"), "table 'luck' is not known"),
}


@pytest.mark.parametrize("what", COMMANDS)
def test_the_command_line_answers_in_one_sentence(what):
    arguments, sentence = COMMANDS[what]
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)}
    command = [sys.executable, "-m", *arguments]
    done = subprocess.run(command, env=environment, cwd=paths.ROOT, capture_output=True, text=True)
    assert done.returncode == 1 and sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr


ENVIRONMENT = {
    "workers that are no number": ({"RAILREPRO_WORKERS": "many"}, "RAILREPRO_WORKERS='many'"),
    "no scheduler": ({"RAILREPRO_DASK": "tcp://127.0.0.1:9"}, "no Dask scheduler answers"),
    "an address that is none": ({"RAILREPRO_DASK": "nonsense"}, "no Dask scheduler answers"),
}


@pytest.mark.parametrize("what", ENVIRONMENT)
def test_a_wrong_environment_is_told_in_one_sentence(what, tmp_path):
    changes, sentence = ENVIRONMENT[what]
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)} | changes
    done = subprocess.run([sys.executable, "-m", TUNING, "ndi"], env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr
