"""The car as an FMU: valid, its own GUID, portable, with an answer to every input, several at a time, anywhere."""

import ctypes
import math
import re
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest
from units import Instance, fmi2

from railrepro.compile import cache
from railrepro.control.ndi import NDI
from railrepro.data import InputError
from railrepro.export.car import export_fmu
from railrepro.export.controller import Export
from railrepro.export.fmu import PLATFORMS
from railrepro.simulation.scenarios import load_scenario
from railrepro.vehicle.parameters import load_vehicle

TORQUE, Y = ["tau_front_le"], ["front.y"]
CALLS = ("Instantiate", "DoStep", "SetReal", "GetReal", "GetInteger", "SetFMUstate", "DeSerializeFMUstate", "Terminate")
CONE, LAG = {"contact.profile": "cone"}, {"drive.lag": 0.1}


@pytest.fixture(scope="module")
def unit(tmp_path_factory):
    """A car on T5, on cones, which have no flange, compiled without optimisation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
        return export_fmu(tmp_path_factory.mktemp("unit") / "car.fmu", "T5", 60.0, load_vehicle(**CONE))


def description(unit):
    return ElementTree.fromstring(zipfile.ZipFile(unit).read("modelDescription.xml"))


def test_an_fmu_is_valid_and_holds_sources_that_compile_to_the_interface(unit, tmp_path):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(unit)) == []
    with zipfile.ZipFile(unit) as archive:
        source = archive.extract("sources/all.c", tmp_path)
    assert source.endswith(description(unit).find("CoSimulation/SourceFiles/File").get("name"))
    library = ctypes.CDLL(str(cache.build(Path(source).read_text(), portable=True)))
    assert library.fmi2DoStep and library.fmi2SetReal


def test_the_guid_follows_the_content(unit, tmp_path, monkeypatch):
    guids = [description(unit).get("guid")]
    monkeypatch.setattr(cache, "build", lambda *text, **how: unit)
    for route, speed, changes in [("T5", 60.0, {}), ("T3", 60.0, {}), ("T5", 61.0, {}), ("T5", 60.0, LAG)]:
        file = export_fmu(tmp_path / "car.fmu", route, speed, load_vehicle(**CONE | changes))
        guids.append(description(file).get("guid"))
    assert guids[0] == guids[1] and len(set(guids)) == 4


def test_no_flag_asks_for_more_than_any_processor_has(monkeypatch):
    monkeypatch.delenv("RAILREPRO_CFLAGS", raising=False)
    assert not any(flag.startswith(("-march", "-mavx", "-mtune")) for flag in cache.flags(portable=True))


@pytest.mark.parametrize("value", [math.nan, math.inf, -100001.0])
def test_a_torque_out_of_range_is_refused_with_a_sentence(value, unit):
    car = Instance(unit, "car")
    with car.refused() as said:
        car.set(TORQUE, [value])
    assert TORQUE[0] in said[0]
    car.step()
    assert math.isfinite(*car.get(Y))


def test_a_reset_car_begins_anew_and_an_unknown_variable_is_refused(unit):
    car = Instance(unit, "car")
    before = car.get(["front.p", *Y])
    car.step(0.05)
    assert car.get(["front.p"])[0] > before[0] + 2
    car.slave.reset()
    assert car.get(["front.p", *Y]) == before
    car.references["beyond"] = max(car.references.values()) + 1
    with car.refused():
        car.get(["beyond"])


def test_a_car_that_leaves_all_bounds_says_so(unit):
    car = Instance(unit, "car", parameters={"body.mass": 1e4})
    car.set(TORQUE, [1e5])
    with car.refused():
        for _ in range(400):
            car.step(0.05)


def test_calls_out_of_order_are_errors(unit):
    car = Instance(unit, "car", begun=False)
    calls = car.slave
    for call in (car.step, calls.exitInitializationMode, calls.terminate):
        with car.refused():
            call()
    car.begin(startTime=2.0, stopTime=2.003)
    for call in (calls.setupExperiment, calls.enterInitializationMode, calls.exitInitializationMode):
        with car.refused():
            call()
    with car.refused():
        car.step()  # at 0 s
    car.time = 2.0
    car.step()
    for time, length in ((2.0, 0.001), (2.002, 0.001), (2.001, 0.003)):  # repeated, left out, beyond the stop time
        with car.refused():
            calls.doStep(time, length)
    car.step(0.002)
    calls.terminate()
    for call in (calls.terminate, car.step, lambda: car.set(TORQUE, [1.0])):
        with car.refused():
            call()
    assert math.isfinite(*car.get(Y))


def test_another_guid_or_model_exchange_gives_no_instance(unit):
    car = Instance(unit, "car")
    with pytest.raises(Exception, match="instantiate"):
        Instance(unit, "car", guid="{0}")
    made, callbacks, slave = car.slave.fmi2Instantiate, ctypes.byref(car.slave.callbacks), car.slave
    for guid, kind in ((b"{0}", fmi2.fmi2CoSimulation), (slave.guid.encode(), fmi2.fmi2ModelExchange)):
        car.said.clear()
        assert made(b"car", kind, guid, b"", callbacks, 0, 0) is None
        assert len(car.said) == 1


def test_what_is_no_path_and_no_platform_is_refused():
    for path in (None, 3.0, ["car.fmu"]):
        with pytest.raises(InputError, match="path of a file is"):
            export_fmu(path, "T5", 60.0, load_vehicle(**CONE))
    for platforms in ("win64", (), ["win32"], 5, [[]]):
        with pytest.raises(InputError, match="platforms is"):
            export_fmu("car.fmu", "T5", 60.0, load_vehicle(**CONE), platforms=platforms)


@pytest.mark.skipif(None in map(cache.found, (cache.PACKAGED, "objdump")), reason="`make test-extras` has the compiler")
def test_an_fmu_holds_libraries_of_other_platforms(tmp_path, monkeypatch):
    """They are linked here, not run: the interface is complete."""
    monkeypatch.setenv("RAILREPRO_CFLAGS", "-O0 -ffp-contract=off")
    needed = {f"fmi2{call}" for call in CALLS}
    file = Export(NDI(), load_scenario("curve_entry_T3").route()).write_fmu(tmp_path / "ndi.fmu", tuple(PLATFORMS))
    with zipfile.ZipFile(file) as archive:
        archive.extractall(tmp_path)
    of_windows, of_mac, _ = sorted(tmp_path.glob("binaries/*/railrepro_controller.*"), key=lambda path: path.suffix)
    listed = subprocess.run(["objdump", "-p", of_windows], capture_output=True, text=True, check=True).stdout
    assert set(re.findall(r"\] (fmi2\w+)$", listed, re.MULTILINE)) >= needed
    mac = of_mac.read_bytes()
    assert mac[:4] == b"\xcf\xfa\xed\xfe" and all(b"_" + call.encode() + b"\0" in mac for call in needed)


def test_a_platform_without_its_compiler_is_one_sentence(monkeypatch):
    monkeypatch.setattr(cache, "found", lambda name: None)
    with pytest.raises(InputError, match="compiler"):
        cache.build("", triple="x86_64-windows-gnu")
