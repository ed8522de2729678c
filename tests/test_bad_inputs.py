"""Bad inputs of the library and of the command line: one sentence each, no traceback, no silence."""

import inspect
import math
import os
import signal
import subprocess
import sys
import warnings
from functools import partial

import numpy as np
import pytest

from railrepro import paths
from railrepro.car.component import SteppedCar
from railrepro.control.adhesion import AdhesionSettings
from railrepro.control.law import EstimateSettings
from railrepro.control.ndi import NDI
from railrepro.control.registry import guidance
from railrepro.errors import InputError
from railrepro.estimation.sensors import Readings, load_loop
from railrepro.evidence.runs import experiment, pso, tuning
from railrepro.simulation import simulate
from railrepro.simulation.scenarios import load_scenario
from railrepro.track import table as tables
from railrepro.track.alignment import Alignment, Segment
from railrepro.track.irregularity import irregularities
from railrepro.track.rough import rough_track
from railrepro.vehicle.parameters import load_vehicle

NMPC = {"q_psi_TrAx": 1.0, "q_psidot_Ax": 1.0, "r": 1e-11, "q_terminal": 1.0, "period_ms": 10, "horizon_s": 0.3}
THREE = {"pole": 20.0, "frequency": 20.0, "damping": 1.0}


def scenario(**changes):
    return load_scenario("curve_entry_T3").but(**{"end_m": 5.0} | changes)


OPTIONS = set(inspect.signature(simulate.run).parameters)


def drive(law=None, **changes):
    options = {name: changes.pop(name) for name in OPTIONS & set(changes)}
    return simulate.run(scenario(**changes), NDI() if law is None else law, **options)


def rough(**channels):
    return irregularities(WAY).assign(**channels)


def experience(irregular=None, preview=None):
    irregular = {"seed": 1} if irregular is None else irregular
    known = {} if preview is None else preview
    return experiment.Experiment(scenario(), "ndi", parameters=THREE, irregular=irregular, preview=known)()


def swarm(dimensions=None, particles=3, iterations=3, seed=1):
    dimensions = [pso.Dimension("x", 0, 1)] if dimensions is None else dimensions
    return pso.minimise(lambda sets, limits: [1.0] * len(sets), dimensions, particles, iterations, seed)


WAY = np.arange(0.0, 100.0, 0.5)
FLAT = np.zeros((4, WAY.size))
FAULT = {"kind": "alignment_fault", "start": 40.0, "length": 20.0, "amplitude": 4e-3}
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
        lambda: experiment.Experiment(scenario(), "ndi", parameters=THREE, vehicle={"x": 3})(),
        "override 'x'",
    ),
    "a scenario by its name": (lambda: simulate.run("curve_entry_T3", NDI()), "scenario is 'curve_entry_T3'"),
    "no scenario": (lambda: simulate.run(None, NDI()), "scenario is None"),
    "a vehicle by its path": (
        lambda: drive(vehicle="data/vehicle.toml"),
        "vehicle is 'data/vehicle.toml'.*class Vehicle",
    ),
    "a plant that is a table": (lambda: drive(plant_vehicle={"body.mass": 3}), "plant_vehicle is {"),
    "no controller": (lambda: simulate.run(scenario(), None), "guidance None"),
    "a class as controller": (lambda: drive(NDI), "guidance <class"),
    "a negative share": (lambda: drive(fixed_share=-0.1), "fixed_share = -0.1, a number from 0 to 1"),
    "a share beyond all": (lambda: drive(fixed_share=1.5), "fixed_share = 1.5"),
    "a share that is no number": (lambda: drive(fixed_share=math.nan), "fixed_share = nan"),
    "a share that is a text": (lambda: drive(fixed_share="half"), "fixed_share is 'half'"),
    "a run too long to log": (
        lambda: simulate.run(scenario(track="T5", speed_kmh=0.5, end_m=600.0), NDI()),
        r"600 m at 0.5 km/h take 4320 s, up to \d+ s fit into a log of 2 GiB",
    ),
    "no substeps": (lambda: drive(substeps=0), "substeps = 0, a number from 1"),
    "half a substep": (lambda: drive(substeps=1.5), "substeps is 1.5, a whole number"),
    "substeps that are a truth value": (lambda: drive(substeps=True), "substeps is True"),
    "a loop in place of readings": (lambda: drive(sensors=load_loop()), "sensors is Loop.*class Readings"),
    "a law of adhesion that is a text": (lambda: drive(adhesion="slip"), "adhesion is 'slip'"),
    "estimates that are a table": (lambda: drive(estimate={"lag": 1}), "estimate is {'lag': 1}"),
    "a negative step of torque": (lambda: AdhesionSettings(raise_step=-1), "raise_step = -1, a number from 0 to"),
    "a drop that is no number": (lambda: AdhesionSettings(drop_step=math.nan), "AdhesionSettings: drop_step = nan"),
    "a lowering that is a text": (lambda: AdhesionSettings(lower_step="x"), "lower_step is 'x', a number in N m"),
    "a corridor beyond all": (lambda: AdhesionSettings(corridor=2.0), "corridor = 2.0, a number from 0 to 1 "),
    "a huge filter time": (lambda: AdhesionSettings(filter_time=1e9), "filter_time = .*, a number from 0 to 10 s"),
    "an infinite dead zone": (lambda: AdhesionSettings(dead_zone=math.inf), "dead_zone = inf"),
    "a law that is half active": (lambda: AdhesionSettings(active=0.5), "active is 0.5, .*bool"),
    "negative noise": (lambda: EstimateSettings(noise_f=-0.1), "noise_f = -0.1, a number from 0 to 10"),
    "noise that is no number": (lambda: EstimateSettings(noise_s=math.nan), "EstimateSettings: noise_s = nan"),
    "a bias that is a text": (lambda: EstimateSettings(bias_f="x"), "bias_f is 'x'"),
    "a huge bias": (lambda: EstimateSettings(bias_s=-1e9), "bias_s = .*, a number from -10 to 10"),
    "a negative lag": (lambda: EstimateSettings(lag=-1.0), "lag = -1.0, a number from 0 to 100 s"),
    "a line that is a text": (lambda: drive(line="straight"), "line is 'straight', a pair"),
    "a line that is a number": (lambda: drive(line=3.0), "line is 3.0, a pair"),
    "a line without derivatives": (lambda: drive(line=(WAY, 0 * WAY)), r"shapes \(200,\) and \(200,\), \(m,\) and"),
    "an empty line": (lambda: drive(line=([], np.zeros((4, 0)))), r"shapes \(0,\) and \(4, 0\)"),
    "a line at no numbers": (lambda: drive(line=(WAY * math.nan, FLAT)), "line: the coordinates must be finite"),
    "a line that is no number": (lambda: drive(line=(WAY, FLAT + math.inf)), "the set points finite"),
    "a line backwards": (lambda: drive(line=(WAY[::-1], FLAT)), "finite and increasing"),
    "irregularities that are a list": (lambda: drive(irregularities=[1, 2]), r"irregularities is \[1, 2\]"),
    "irregularities beyond the flangeway": (
        lambda: drive(irregularities=rough(lateral_m=0.025)),
        "lateral_m = 0.025 at p = 0 m, -0.02 to 0.02 is allowed",
    ),
    "irregularities in millimetres": (lambda: drive(irregularities=rough(vertical_m=3.0)), "vertical_m = 3 at p = 0 m"),
    "irregularities that are no numbers": (lambda: drive(irregularities=rough(gauge_m=math.nan)), "gauge_m = nan"),
    "irregularities out of order": (lambda: drive(irregularities=rough()[::-1]), "finite and increasing"),
    "rails of one row": (lambda: drive(irregularities=rough().iloc[:1]), "have 1 row, at least 2"),
    "coordinates that are no numbers": (lambda: irregularities([0.0, math.nan, 2.0]), r"p\[1\] is nan"),
    "infinite coordinates": (lambda: irregularities([0.0, 1.0, math.inf]), r"p\[2\] is inf"),
    "coordinates out of order": (lambda: irregularities([0.0, 2.0, 1.0]), r"p\[2\] is 1.0, finite and increasing"),
    "no coordinates": (lambda: irregularities([]), r"p is \[\], a list of track coordinates"),
    "coordinates that are a text": (lambda: irregularities("0 to 100"), "p is '0 to 100'"),
    "coordinates that are a number": (lambda: irregularities(100.0), "p is 100.0"),
    "a seed of rails that is a text": (lambda: irregularities(WAY, seed="x"), "seed is 'x', a whole number"),
    "a negative seed of rails": (lambda: irregularities(WAY, seed=-1), "seed = -1, a number from 0 on"),
    "half a seed of rails": (lambda: irregularities(WAY, seed=1.5), "seed is 1.5"),
    "a spectrum that there is not": (lambda: irregularities(WAY, "smooth"), "spectrum 'smooth' is not known"),
    "a spectrum that is a list": (lambda: irregularities(WAY, ["erri_low"]), "is not known"),
    "a wavelength that is no number": (lambda: irregularities(WAY, shortest=math.nan), "shortest is nan"),
    "a wavelength that is a text": (lambda: irregularities(WAY, longest="far"), "longest is 'far'"),
    "an infinite wavelength": (lambda: irregularities(WAY, longest=math.inf), "longest is inf"),
    "wavelengths below twice the sampling": (
        lambda: irregularities(WAY, shortest=0.8),
        "step of 0.5 m, up to 0.4 m is allowed for wavelengths of 0.8 m",
    ),
    "an argument of rails that there is not": (lambda: rough_track(WAY, colour=1), "irregular: 'colour' is not known"),
    "a seed beside a file": (lambda: rough_track(WAY, file="a.csv", seed=1), "irregular: 'seed' is not known"),
    "a file that is a number": (lambda: rough_track(WAY, file=3), "file is 3"),
    "a file that there is not": (lambda: rough_track(WAY, file="nowhere.csv"), "nowhere.csv"),
    "rails at coordinates that are a text": (lambda: rough_track("here", file="a.csv"), "p is 'here'"),
    "defects that are a text": (lambda: rough_track(WAY, defects="dip"), "defects are 'dip'"),
    "a defect that is a text": (lambda: rough_track(WAY, defects=["dip"]), "defect kind 'dip'"),
    "a defect without height": (
        lambda: rough_track(WAY, defects=[{"kind": "dip", "start": 9, "length": 9}]),
        "'depth' is",
    ),
    "a defect with another key": (lambda: rough_track(WAY, defects=[FAULT | {"x": 1}]), "alignment_fault: 'x' is not"),
    "a fault beyond the flangeway": (
        lambda: rough_track(WAY, defects=[FAULT | {"amplitude": 0.04}]),
        "lateral_m = 0.0",
    ),
    "a fault that is a text": (lambda: rough_track(WAY, defects=[FAULT | {"amplitude": "4"}]), "height is '4'"),
    "a fault that is no number": (lambda: rough_track(WAY, defects=[FAULT | {"amplitude": math.nan}]), "height = nan"),
    "a place that is a text": (lambda: rough_track(WAY, defects=[FAULT | {"start": "9"}]), "place is '9'"),
    "rails that are a text": (lambda: experience(irregular="erri_low"), "irregular: is 'erri_low', a table"),
    "rails with another key": (lambda: experience(irregular={"colour": 1}), "irregular: 'colour' is not known"),
    "a preview with another key": (lambda: experience(preview={"colour": 1}), "preview: 'colour' is not known"),
    "a preview that is a number": (lambda: experience(preview=1.0), "preview: is 1.0, a table"),
    "a preview of an ideal track": (
        lambda: experience(irregular={}, preview={"share": 1.0}),
        "preview: the track is ideal",
    ),
    "a preview share that is a text": (lambda: experience(preview={"share": "all"}), "share is 'all'"),
    "a preview blurred by no number": (lambda: experience(preview={"smoothing_m": math.nan}), "smoothing_m = nan"),
    "a preview without play": (lambda: experience(preview={"limit": -1.0}), "limit is -1.0"),
    "a preview error that is a text": (lambda: experience(preview={"amplitude_error": "x"}), "amplitude_error is 'x'"),
    "readings with a negative seed": (lambda: Readings(load_loop(), -1), "Readings: seed = -1"),
    "readings with half a seed": (lambda: Readings(load_loop(), 0.5), "Readings: seed is 0.5"),
    "readings with a seed that is a text": (lambda: Readings(load_loop(), "1"), "Readings: seed is '1'"),
    "readings with a seed that is a truth value": (lambda: Readings(load_loop(), True), "Readings: seed is True"),
    "readings of a path": (lambda: Readings("sensors.toml"), "Readings: loop is 'sensors.toml'"),
    "readings of nothing": (lambda: Readings(None), "Readings: loop is None"),
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
    assert run.failed and "derailed" in run.ended


CARS = {
    "a negative speed": ({"speed": -3.0}, {}, "speed is -3.0"),
    "no speed": ({"speed": 0.0}, {}, "speed is 0.0"),
    "a speed that is no number": ({"speed": math.nan}, {}, "speed is nan"),
    "an absurd speed": ({"speed": 5e3}, {}, "speed is 5000.0, a number above 0 and up to 125 m/s"),
    "a speed that is a text": ({"speed": "50"}, {}, "speed is '50', a number in m/s"),
    "a speed that is a truth value": ({"speed": True}, {}, "speed is True"),
    "a good set that there is not": ({"good": "ice"}, {}, "adhesion set 'ice' is not known; there are .*'dry'"),
    "a poor set that is a list": ({"poor": ["dry"]}, {}, "adhesion set .*'dry'.* is not known"),
    "a track that there is not": ({"route": "T99"}, {}, "'T99' is not in tracks.toml"),
    "a track that is a number": ({"route": 3}, {}, "route is 3, an object of the class Route"),
    "a vehicle that is a path": ({"vehicle": "vehicle.toml"}, {}, "vehicle is 'vehicle.toml'"),
    "three torques": ({}, {"torque": [1, 2, 3]}, "torque is .*, 4 numbers of at most 100000 N m"),
    "one torque": ({}, {"torque": 300.0}, "torque is 300.0, 4 numbers"),
    "torques as a table": ({}, {"torque": [[1, 2], [3, 4]]}, "4 numbers"),
    "torques of different length": ({}, {"torque": [[1, 2], [3]]}, "4 numbers"),
    "a torque that is a text": ({}, {"torque": "much"}, "torque is 'much'"),
    "torques that are texts": ({}, {"torque": ["1", "2", "3", "4"]}, "4 numbers"),
    "a torque that is no number": ({}, {"torque": [math.nan, 0, 0, 0]}, "torque is .*nan"),
    "an infinite torque": ({}, {"torque": [math.inf, 0, 0, 0]}, "torque is .*inf"),
    "an absurd torque": ({}, {"torque": [1e9, 0, 0, 0]}, "torque is .*1000000000.0, .* at most 100000 N m"),
    "fewer than no exchanges": ({}, {"exchanges": -3}, "exchanges = -3, a number from 0 on"),
    "half an exchange": ({}, {"exchanges": 0.5}, "exchanges is 0.5, a whole number"),
    "exchanges that are a text": ({}, {"exchanges": "ten"}, "exchanges is 'ten'"),
    "a negative step": ({}, {"period": -1e-3}, "period is -0.001"),
    "no step": ({}, {"period": 0.0}, "period is 0.0"),
    "a step that is no number": ({}, {"period": math.nan}, "period is nan"),
    "an absurd step": ({}, {"period": 5.0}, "period is 5.0, a number above 0 and up to 0.01 s"),
}


@pytest.mark.parametrize("what", CARS)
def test_the_car_answers_in_one_sentence_and_stays_where_it_is(what):
    build, step, sentence = CARS[what]
    with pytest.raises(InputError, match=sentence) as refused:
        SteppedCar(**{"route": "T5", "speed": 50.0} | build).step(**step)
    assert len(str(refused.value).splitlines()) == 1


def test_a_stepped_car_that_leaves_the_rail_says_so_once():
    car = SteppedCar("T3", 77.8)
    car.step([300, -300, 300, -300], exchanges=100)
    assert car.left_rail == ""
    with pytest.warns(UserWarning, match=r"gear derailed, \|y\| = 30\.\d mm at t = 0\.2\d\d s, p = ") as said:
        car.step(exchanges=400)
    assert [str(warning.message) for warning in said] == [car.left_rail] and said[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        car.step(exchanges=10)


MODULE = "railrepro"
COMMANDS = {
    "a notebook that there is not": (("chain", "run", "99_none"), "is not in chain.toml"),
    "a variant that there is not": (("chain", "variants", "v9"), "variant 'v9' is not known"),
    "a controller to tune that there is not": (("tune", "pid"), "'pid' is neither setting"),
    "a study that there is not": (("robustness", "luck"), "study 'luck' is not known"),
    "a table that there is not": (("bench", "luck"), "table 'luck' is not known"),
}


@pytest.mark.parametrize("what", COMMANDS)
def test_the_command_line_answers_in_one_sentence(what):
    arguments, sentence = COMMANDS[what]
    environment = os.environ | {"PYTHONPATH": str(paths.ROOT)}
    command = [sys.executable, "-m", MODULE, *arguments]
    done = subprocess.run(command, env=environment, cwd=paths.ROOT, capture_output=True, text=True)
    assert done.returncode == 1 and sentence in done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr


def interrupted(folder, *command):
    """Exit code and stderr of a command that gets Ctrl-C when it writes its first line."""
    environment = os.environ | {"PYTHONPATH": f"{folder}:{paths.ROOT}"}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A job in the background of a shell hands down that it ignores Ctrl-C.
    listens = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen([sys.executable, *command], env=environment, cwd=folder, preexec_fn=listens, **pipes)
    assert process.stdout.readline() == "here\n"
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    return process.returncode, said


HERE = "print('here', flush=True); time.sleep(60)"


def test_an_interrupt_while_a_command_imports_is_silent(tmp_path):
    (tmp_path / "numpy.py").write_text(f"import time; {HERE}")
    assert interrupted(tmp_path, "-m", MODULE, "tune") == (-signal.SIGINT, "")


def test_an_interrupt_of_a_command_is_told_in_one_sentence(tmp_path):
    (tmp_path / "tomllib.py").write_text(
        "import time\ndef load(*_):\n    " + HERE + "\nloads = load\nTOMLDecodeError = ValueError"
    )
    assert interrupted(tmp_path, "-m", MODULE, "chain", "fresh") == (
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
